"""Folders for the working copies of large runs: one an attempt, seen by every worker that sees the data folder.

An attempt that was killed cannot remove its own. The next attempt of the run does, and whatever nobody has touched for a day any
large run does: a working copy is made within minutes, and an attempt that still used it would be behind its fence by then.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FORGOTTEN_S = 86_400.0


@contextmanager
def scratch_of(folder: Path, run_id: int, attempt: int) -> Iterator[Path]:
    """Make an attempt's folder below `folder`; it is gone at the end."""
    folder.mkdir(exist_ok=True)  # the data folder may have been moved away: it is not made anew
    for left in folder.glob("run-*-*"):
        if left.name.startswith(f"run-{run_id}-") or _age_s(left) > FORGOTTEN_S:
            shutil.rmtree(left, ignore_errors=True)
    own = folder / f"run-{run_id}-{attempt}"
    own.mkdir(exist_ok=True)
    try:
        yield own
    finally:
        shutil.rmtree(own, ignore_errors=True)


def _age_s(folder: Path) -> float:
    """How long ago anything was put into a folder or its folders."""
    try:
        return time.time() - max(path.stat().st_mtime for path in (folder, *folder.glob("*")))
    except OSError:  # it has just been removed
        return 0.0
