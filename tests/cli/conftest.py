"""The command line in this process, over a data folder of its own."""

import csv
import json
import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from boresight.cli import main, output
from boresight.errors import BoresightError
from tests.stores import environment_in, url_in

FRAMES = 40


def accepted(done):
    assert done.exit_code == 0, done.stderr
    return done


#: The refusals that commands have printed, the newest last.
PRINTED: list[BoresightError] = []


@pytest.fixture(autouse=True)
def _printed(monkeypatch):
    show = output._print_refusal
    monkeypatch.setattr(output, "_print_refusal", lambda error: show(PRINTED.append(error) or error))


def assert_refused(done, *words, code=None, lines=None):
    assert done.exit_code == 1
    assert code is None or (PRINTED[-1].code, str(PRINTED[-1]) in done.stderr) == (code, True)
    assert [word for word in words if word not in done.stderr] == [], done.stderr
    assert lines in {None, done.stderr.count("\n")}


def read_rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def write_rows(path, rows, names=None):
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, names or rows[0].keys(), extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    return path


@pytest.fixture(scope="session")
def data_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("data")


@pytest.fixture
def boresight(data_folder, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(data_folder))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # the compiled loops stay where they are
    for name, value in environment_in(data_folder).items():
        monkeypatch.setenv(name, value)

    def run(*words, stdin=None):
        return CliRunner().invoke(main, [str(word) for word in words], input=stdin, catch_exceptions=False)

    return run


@pytest.fixture
def store(boresight, monkeypatch, tmp_path):
    monkeypatch.setenv("BORESIGHT_DATABASE_URL", url_in(tmp_path))
    return boresight


@pytest.fixture(scope="session")
def simulated(data_folder, tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulated")
    environment = {"BORESIGHT_DATA_FOLDER": str(data_folder), "NUMBA_CACHE_DIR": ""}
    words = ["simulate", "st16-4", "--out", str(folder), "--frames", str(FRAMES)]
    done = CliRunner(env=environment).invoke(main, words, catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return folder


@pytest.fixture(scope="session")
def calibration(simulated, data_folder):
    environment = {"BORESIGHT_DATA_FOLDER": str(data_folder), "NUMBA_CACHE_DIR": ""}
    path = simulated / "calibration.json"
    words = ["calibrate", simulated / "calibration.csv", "--sensor", simulated / "sensor.json", "--method", "sqrf"]
    words += ["--validate", simulated / "validation.csv", "--json", path]
    done = CliRunner(env=environment).invoke(main, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return path


@pytest.fixture(scope="session")
def calibration_result(calibration):
    return json.loads(calibration.read_text())


@pytest.fixture
def real_sky():
    beside = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "real-sky"
    folder = Path(os.environ.get("BORESIGHT_REAL_SKY", beside))
    if not folder.is_dir():
        pytest.skip("the real star fields are not here; BORESIGHT_REAL_SKY says where they are")
    return folder
