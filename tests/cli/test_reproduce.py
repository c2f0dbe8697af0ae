"""`boresight reproduce`: a small study end to end, its files, and that it gives the same twice."""

import csv
import json
import math
import os
import re

import numba
import pytest
from click.testing import CliRunner

from boresight.cli import main
from tests.cli.conftest import assert_refused

STUDIES = {
    "enright": ("--sensors", "4", "--frames", "20"),
    "wu": ("--frames", "60", "--sets", "2"),
}


def _made(study, out, data_folder, processes=1):
    words = ("reproduce", study, "--quick", *STUDIES[study], "--processes", str(processes), "--out", str(out))
    kernels = os.environ.get("NUMBA_CACHE_DIR", "")  # other processes find the compiled loops where this one does
    environment = {"BORESIGHT_DATA_FOLDER": str(data_folder), "NUMBA_CACHE_DIR": kernels}
    done = CliRunner(env=environment).invoke(main, words, catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return done


@pytest.fixture(scope="module")
def enright(data_folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("reproduced") / "out"
    return _made("enright", out, data_folder), out


@pytest.fixture(scope="module")
def wu(data_folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("reproduced") / "out"
    return _made("wu", out, data_folder), out


def _table(out, study):
    with (out / f"{study}-tables.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert all(line["ours"] and line["printed"] and line["verdict"] and line["row_reason"] for line in lines)
    return {line["table"] for line in lines}


@pytest.mark.full
def test_a_quick_study_writes_report_json_and_csv_and_prints_its_verdicts(enright):
    done, out = enright
    names = {"enright.html", "enright.json", "enright-tables.csv", "enright-estimators.csv", "enright-figures.csv"}
    assert {path.name for path in out.iterdir()} == names
    assert "Table IV" in done.stdout
    assert "Figure 3a" in done.stdout
    assert json.loads((out / "enright.json").read_text())["plan"]["frames"] == 20
    assert _table(out, "enright") == {"III", "IV", "V", "VI", "text"}
    counted = re.search(r"Of (\d+) printed numbers", done.stdout)
    verdicts = json.loads((out / "enright.json").read_text())["verdicts"]
    assert int(counted[1]) == sum(verdicts.values())


@pytest.mark.full
def test_a_quick_study_of_wu_writes_the_same_and_its_sets(wu):
    done, out = wu
    names = {"wu.html", "wu.json", "wu-tables.csv", "wu-sets.csv", "wu-figures.csv"}
    assert {path.name for path in out.iterdir()} == names
    for words in ("Table 2", "Table 3", "Table 4 (time)", "Figure 8"):
        assert words in done.stdout
    assert json.loads((out / "wu.json").read_text())["plan"]["frames"] == 60
    assert _table(out, "wu")
    with (out / "wu-sets.csv").open() as file:
        assert all(float(line["b_mean_arcsec"]) > 0 for line in csv.DictReader(file))


NUMBER = re.compile(r"[-−+]?\d[\d.,]*(e[-+]?\d+)?")


def _agree(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(_agree(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(_agree, one, other))
    if isinstance(one, str):  # numbers in sentences are rounded, and may be rounded the other way
        return NUMBER.sub("#", one) == NUMBER.sub("#", str(other))
    if isinstance(one, float):
        return math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-9)
    return one == other


@pytest.mark.full
def test_the_same_study_in_processes_of_its_own_gives_the_same_document(enright, data_folder, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", numba.config.CACHE_DIR)  # the processes find the loops compiled here
    _made("enright", tmp_path / "again", data_folder, processes=2)
    one, other = (json.loads((folder / "enright.json").read_text()) for folder in (enright[1], tmp_path / "again"))
    assert one.pop("timing").keys() == other.pop("timing").keys()
    assert [key for key in one if not _agree(one[key], other[key])] == []


@pytest.mark.full
def test_the_same_command_gives_the_same_document_but_for_the_clock(wu, data_folder, tmp_path):
    _made("wu", tmp_path / "again", data_folder)
    one, other = (json.loads((folder / "wu.json").read_text()) for folder in (wu[1], tmp_path / "again"))
    assert one.pop("timing").keys() == other.pop("timing").keys()
    assert one == other


@pytest.mark.parametrize(
    ("study", "words", "said"),
    [
        ("enright", ("--sensors", "9"), "no sensor 9"),
        ("enright", ("--sensors", "a"), "write it like 3,4"),
        ("wu", ("--sensors", "3"), "omit --sensors"),
        ("wu", ("--frames", "12"), "more than 20"),
    ],
)
def test_a_study_that_cannot_be_is_refused_in_one_line(boresight, tmp_path, study, words, said):
    assert_refused(boresight("reproduce", study, "--quick", "--out", tmp_path / "out", *words), said, lines=1)
