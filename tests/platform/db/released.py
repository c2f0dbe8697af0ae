"""Stored installations of released versions: small ones from the tree, and of any size from the code in git's history.

A new release adds its commit and its archive: `python -m tests.platform.db.released VERSION` makes the latter.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
#: The commit of each released version.
RELEASED = {"0.1.0": "c831475f82b144c9759ab713d8e59df6ba9682a9"}


def unpack(version: str, folder: Path) -> Path:
    """Put the small installation of a version into a folder; returns its data folder."""
    with tarfile.open(HERE / f"{version}.tar.xz") as archive:
        # an archive of our own; without the filter, which Python 3.11.2 lacks, a newer one warns
        archive.extraction_filter = getattr(tarfile, "data_filter", None)
        archive.extractall(folder)  # noqa: S202 - see above
    return folder / "data"


def make(version: str, folder: Path, runs: int, records: int) -> Path:
    """Have a version's own code fill a data folder; skips where git's history is not here."""
    commit = RELEASED[version]
    source = folder / "source"
    source.mkdir()
    known = subprocess.run(
        ["git", "-C", str(ROOT), "cat-file", "-e", f"{commit}^{{commit}}"], check=False, capture_output=True
    )
    if known.returncode != 0:
        pytest.skip(f"the commit of version {version} is not in this copy of the history")
    tree = subprocess.run(["git", "-C", str(ROOT), "archive", commit], check=True, capture_output=True).stdout
    subprocess.run(["tar", "x", "-C", str(source)], input=tree, check=True)
    program = HERE / f"installation_of_{version.replace('.', '_')}.py"
    words = [sys.executable, str(program), str(folder / "data"), "--runs", str(runs), "--records", str(records)]
    environment = os.environ | {"PYTHONPATH": str(source / "backend"), "NUMBA_CACHE_DIR": str(folder / "kernels")}
    subprocess.run(words, check=True, env=environment)
    return folder / "data"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        made = make(sys.argv[1], Path(scratch), 20, 200)
        with tarfile.open(HERE / f"{sys.argv[1]}.tar.xz", "w:xz") as written:
            written.add(made, "data")
