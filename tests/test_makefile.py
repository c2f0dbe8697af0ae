"""The targets that run the tests: both halves run whatever the first finds, and either's failure fails the target."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("target", ["pytest", "postgresql"])
def test_a_failing_half_does_not_keep_the_other_from_running_and_fails_the_target(target: str, tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    command = ["make", "--dry-run", "--no-print-directory", "--directory", str(ROOT)]
    command += [f"--assume-old=.venv/{made}" for made in ("made/dev", "kernels/compiled")]
    outside = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    steps = subprocess.run(
        [*command, target, f"PYTEST=echo half >> {ran}; false"], capture_output=True, text=True, check=True, env=outside
    ).stdout
    script = "\n".join(line for line in steps.splitlines() if not line.startswith(".ci/machine"))
    done = subprocess.run(["bash", "-eu", "-o", "pipefail", "-c", script], check=False, cwd=tmp_path)
    assert ran.read_text().split() == ["half", "half"]
    assert done.returncode == 1
