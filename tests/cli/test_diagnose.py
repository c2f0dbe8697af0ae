"""`boresight diagnose`: the cause as JSON, and files mended that fit each other."""

import json
from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.diagnosis.result import CAUSES
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_csv


@pytest.fixture
def mistaken(catalogue, tmp_path):
    """Files of a sensor whose image is mirrored and whose axes are exchanged."""
    scenario = calibration_scenario(2, 10)
    stars = simulate(scenario, np.random.default_rng(4), catalogue)
    swapped = replace(stars, row_px=stars.col_px, col_px=stars.row_px, star_id=None)
    write_csv(swapped, tmp_path / "t.csv")
    (tmp_path / "s.json").write_text(json.dumps(sensor_document(scenario.sensor)))
    return tmp_path / "t.csv", tmp_path / "s.json"


def test_the_command_tells_the_cause_and_writes_files_that_fit(boresight, mistaken, tmp_path):
    telemetry, sensor = mistaken
    out, right, told = tmp_path / "mended.json", tmp_path / "right.csv", tmp_path / "d.json"
    done = boresight("diagnose", telemetry, "--sensor", sensor, "--out", out, "--out-telemetry", right, "--json", told)
    assert done.exit_code == 0, done.stderr
    document = json.loads(told.read_text())
    assert document["schema"] == "boresight.diagnosis/1"
    first = document["causes"][0]
    assert (first["name"], first["exposures"]) == ("swapped_axes", 20)
    assert first["exposures_solved"] > 15
    assert {cause["name"] for cause in document["causes"]} <= set(CAUSES)
    again = boresight("diagnose", right, "--sensor", out, "--json", "-")
    assert json.loads(again.stdout)["causes"][0]["name"] == "none"


@pytest.mark.parametrize("option", ["--out", "--out-telemetry"])
def test_what_is_read_is_never_written_over(boresight, mistaken, option):
    telemetry, sensor = mistaken
    place = sensor if option == "--out" else telemetry
    before = place.read_bytes()
    assert boresight("diagnose", telemetry, "--sensor", sensor, option, place).exit_code == 1
    assert place.read_bytes() == before
