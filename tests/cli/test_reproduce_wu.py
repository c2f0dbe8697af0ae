"""`boresight reproduce wu`: a small study end to end, its files, and that it gives the same twice."""

import csv
import json
import os

import pytest
from click.testing import CliRunner

from boresight.cli import main


def _made(out, data_folder):
    words = ("reproduce", "wu", "--quick", "--frames", "60", "--sets", "2", "--processes", "1", "--out", str(out))
    kernels = os.environ.get("NUMBA_CACHE_DIR", "")  # the clock's process finds the compiled loops where this one does
    environment = {"BORESIGHT_DATA_FOLDER": str(data_folder), "NUMBA_CACHE_DIR": kernels}
    done = CliRunner(env=environment).invoke(main, words, catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return done


@pytest.fixture(scope="module")
def quick(data_folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("reproduced") / "out"
    return _made(out, data_folder), out


def test_a_quick_study_writes_report_json_and_csv_and_prints_its_verdicts(quick):
    done, out = quick
    assert {path.name for path in out.iterdir()} == {
        "wu.html", "wu.json", "wu-tables.csv", "wu-sets.csv", "wu-figures.csv",
    }  # fmt: skip
    for words in ("Table 2", "Table 3", "Table 4 (time)", "Figure 8"):
        assert words in done.stdout
    assert json.loads((out / "wu.json").read_text())["plan"]["frames"] == 60
    with (out / "wu-tables.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert all(line["ours"] and line["printed"] and line["verdict"] and line["row_reason"] for line in lines)
    with (out / "wu-sets.csv").open() as file:
        assert all(float(line["b_mean_arcsec"]) > 0 for line in csv.DictReader(file))


def test_the_same_command_gives_the_same_document_but_for_the_clock(quick, data_folder, tmp_path):
    _made(tmp_path / "again", data_folder)
    one, other = (json.loads((folder / "wu.json").read_text()) for folder in (quick[1], tmp_path / "again"))
    assert one.pop("timing").keys() == other.pop("timing").keys()
    assert one == other


@pytest.mark.parametrize(
    ("words", "said"), [(("--sensors", "3"), "leave out --sensors"), (("--frames", "12"), "more than 20")]
)
def test_a_study_that_cannot_be_is_refused_in_one_line(boresight, tmp_path, words, said):
    done = boresight("reproduce", "wu", "--quick", "--out", tmp_path / "out", *words)
    assert done.exit_code == 1
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
