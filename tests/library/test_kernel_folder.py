"""Compiled kernels lie in one folder, whoever asks first and whatever was loaded before."""

import os
import subprocess
import sys

import pytest

from tests.effort import few_of

CALLS = (
    "bs.calibrate('no.csv', 'no.json')",
    "bs.check('no.csv', 'no.json')",
    "bs.assess('no.json', 'no.json')",
    "bs.load('no.json')",
    "bs.draw('no.json', 'rms')",
    "bs.read_telemetry({})",
    "bs.Sensor",
    "bs.Choice",
)
COMMANDS = ("calibrate", "choose", "match")


def folder_after(code, folder):
    """Run a line in a new process; returns the folder told to Numba, that of these kernels, and that of the settings."""
    code = (
        "import contextlib, os, sys\nfrom pathlib import Path\n"
        f"import boresight as bs\nwith contextlib.suppress(bs.BoresightError, SystemExit): {code}\n"
        "from boresight.settings import read_settings\nimport boresight.kernels.compilation, numba\n"
        "made = Path(sys.prefix) / 'kernels'\n"
        "print(os.environ['NUMBA_CACHE_DIR'], Path(numba.config.CACHE_DIR).parent,"
        " made if made.is_dir() else read_settings().kernel_folder)"
    )
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment = kept | {"BORESIGHT_DATA_FOLDER": str(folder)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize("call", few_of(CALLS, 2))
def test_a_first_call_of_the_library_tells_the_kernels_their_folder(call, tmp_path):
    assert len(folder_after(call, tmp_path)) == 1


@pytest.mark.parametrize("command", few_of(COMMANDS, 1))
def test_so_does_a_command(command, tmp_path):
    words = ["--out", "a.csv"] if command == "match" else []
    call = f"__import__('boresight.cli').cli.main([{command!r}, 'no.csv', '--sensor', 'no.json', *{words}])"
    assert len(folder_after(call, tmp_path)) == 1


def test_numba_may_be_loaded_before(tmp_path):
    assert len(folder_after("import numba; bs.read_sensor({})", tmp_path)) == 1


def test_without_a_folder_compiling_leaves_nothing_where_it_is_called(tmp_path):
    code = "from boresight.kernels.compilation import one_at_a_time\nwith one_at_a_time(): pass"
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    subprocess.run([sys.executable, "-c", code], env=environment, cwd=tmp_path, check=True)
    assert list(tmp_path.iterdir()) == []
