"""`boresight reproduce`: a small study end to end, its files, and that it gives the same twice."""

import csv
import json
import math
import re

import numba
import pytest
from click.testing import CliRunner

from boresight.cli import main


def _words(out, processes):
    words = ("--quick", "--sensors", "4", "--frames", "20", "--processes", processes, "--out", out)
    return [str(word) for word in ("reproduce", "enright", *words)]


@pytest.fixture(scope="module")
def quick(data_folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("reproduced") / "out"
    environment = {"BORESIGHT_DATA_FOLDER": str(data_folder), "NUMBA_CACHE_DIR": ""}
    done = CliRunner(env=environment).invoke(main, _words(out, 1), catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return done, out


def test_a_quick_study_writes_report_json_and_csv_and_prints_its_verdicts(quick):
    done, out = quick
    names = {"enright.html", "enright.json", "enright-tables.csv", "enright-estimators.csv", "enright-figures.csv"}
    assert {path.name for path in out.iterdir()} == names
    assert "Table IV" in done.stdout
    assert "Figure 3a" in done.stdout
    document = json.loads((out / "enright.json").read_text())
    assert document["plan"]["frames"] == 20
    with (out / "enright-tables.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert {line["table"] for line in lines} == {"III", "IV", "V", "VI"}
    assert all(line["ours"] and line["printed"] and line["verdict"] and line["row_reason"] for line in lines)


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


def test_the_same_study_in_processes_of_its_own_gives_the_same_document(quick, data_folder, tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(data_folder))
    monkeypatch.setenv("NUMBA_CACHE_DIR", numba.config.CACHE_DIR)  # the processes find the loops compiled here
    done = CliRunner().invoke(main, _words(tmp_path / "again", 2), catch_exceptions=False)
    one, other = (json.loads((folder / "enright.json").read_text()) for folder in (quick[1], tmp_path / "again"))
    assert done.exit_code == 0
    assert one.pop("timing").keys() == other.pop("timing").keys()
    assert [key for key in one if not _agree(one[key], other[key])] == []


@pytest.mark.parametrize(
    ("words", "said"),
    [(("--sensors", "9"), "no sensor 9"), (("--sensors", "a"), "write it as 3,4")],
)
def test_a_study_that_cannot_be_is_refused_in_one_line(boresight, tmp_path, words, said):
    done = boresight("reproduce", "enright", "--quick", "--out", tmp_path / "out", *words)
    assert done.exit_code == 1
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
