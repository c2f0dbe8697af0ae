"""Warming: afterwards no run waits for the compiler."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from boresight.settings import read_settings, use_kernel_folder

RUNS = """
import sys
from dataclasses import replace
from pathlib import Path
import numpy as np
from boresight.kernels import workshop
from boresight.kernels.compilation import LOOPS
from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import METHODS, OPTIONS, CalibrationSettings
from boresight.simulation.scenes import calibration_scenario, simulate, validation_scenario
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.writing import write_parquet
from boresight.workers.tasks import warm

folder = Path(sys.argv[1])

warm(folder)
made = []
workshop._compile = made.extend
catalogue = load_catalogue(folder)
for name, scenario in (("fit", calibration_scenario(1)), ("held", validation_scenario(1))):
    write_parquet(simulate(replace(scenario, frames=8), np.random.default_rng(1), catalogue), folder / name)
for method in METHODS:
    for variant in OPTIONS["variant"].words:
        calibrate(
            read_telemetry(folder / "fit"),
            scenario.sensor,
            catalogue,
            CalibrationSettings(method=method, variant=variant),
            validation=read_telemetry(folder / "held"),
        )
undeclared = [
    (name, str(signature))
    for name, loop in LOOPS.items()
    for signature in loop.dispatcher.signatures
    if tuple(signature) != loop.signature(loop.find_camera(signature))
]
print(sorted(name for _, name, _ in made), undeclared, max(len(loop.dispatcher.signatures) for loop in LOOPS.values()))
"""


def test_nothing_is_compiled_for_a_run_after_warming(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", RUNS, str(tmp_path)], capture_output=True, text=True, check=True, env=dict(os.environ)
    )
    assert done.stdout.strip() == "[] [] 1"  # one camera was asked for, and every loop has one form for it


def test_the_demonstration_compiles_at_the_end_of_the_installation_where_it_looks_for_kernels() -> None:
    root = Path(__file__).resolve().parents[2]
    makefile = root / "Makefile"
    steps = subprocess.run(
        ["make", "--dry-run", "--always-make", "--directory", str(root), "demo"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    installed, compiled, served = (steps.index(step) for step in ("--editable", "boresight warm", "boresight demo"))
    assert installed < compiled < served
    assert "export NUMBA_CACHE_DIR" in makefile.read_text()


@pytest.fixture
def folder_used(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "environment"))

    def used(given: str | None = None) -> str:
        with pytest.MonkeyPatch.context() as patch:
            patch.delenv("NUMBA_CACHE_DIR", raising=False)
            if given is not None:
                patch.setenv("NUMBA_CACHE_DIR", given)
            use_kernel_folder(read_settings({"BORESIGHT_DATA_FOLDER": str(tmp_path / "data")}))
            return os.environ["NUMBA_CACHE_DIR"]

    return used


def test_a_command_uses_the_kernels_that_make_compiled_for_its_environment(folder_used, tmp_path):
    assert folder_used() == str(tmp_path / "data" / "kernels")
    (tmp_path / "environment" / "kernels").mkdir(parents=True)
    assert folder_used() == str(tmp_path / "environment" / "kernels")
    assert folder_used("elsewhere") == "elsewhere"
