"""`boresight simulate`: the files it writes agree with the truth beside them."""

import json

import pytest


def test_a_built_in_scenario_writes_everything_a_calibration_needs(simulated):
    names = {path.name for path in simulated.iterdir()}
    assert names >= {"sensor.json", "truth.json", "scenario.json", "calibration.csv", "validation.csv"}


def test_a_scenario_file_gives_the_same_set_as_the_scenario_it_was_written_from(boresight, simulated, tmp_path):
    done = boresight("simulate", simulated / "scenario.json", "--out", tmp_path)
    assert done.exit_code == 0
    assert (tmp_path / "calibration.csv").read_bytes() == (simulated / "calibration.csv").read_bytes()
    assert (tmp_path / "validation.csv").read_bytes() != (tmp_path / "calibration.csv").read_bytes()


def test_another_seed_gives_other_noise(boresight, simulated, tmp_path):
    boresight("simulate", simulated / "scenario.json", "--out", tmp_path, "--seed", "7")
    assert (tmp_path / "calibration.csv").read_bytes() != (simulated / "calibration.csv").read_bytes()


def test_parquet_is_written_on_request(boresight, tmp_path):
    boresight("simulate", "st16-1", "--out", tmp_path, "--frames", "5", "--format", "parquet")
    assert (tmp_path / "calibration.parquet").read_bytes()[:4] == b"PAR1"


@pytest.mark.parametrize("text", ["{", "[]", json.dumps({"sensor": 9})])
def test_a_bad_scenario_is_refused_in_one_line(boresight, tmp_path, text):
    scenario = tmp_path / "scenario.json"
    scenario.write_text(text)
    done = boresight("simulate", scenario, "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert done.stderr.count("\n") == 1


def test_an_unknown_name_is_refused_with_the_names_there_are(boresight, tmp_path):
    done = boresight("simulate", "st16-7", "--out", tmp_path)
    assert done.exit_code == 1
    assert "st16-1" in done.stderr
