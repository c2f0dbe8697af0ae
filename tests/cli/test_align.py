"""`boresight align`: a tracker with a table of attitudes, its JSON, its schema, and its rotation in a table on board."""

import json

import numpy as np
import pytest

from boresight.uplink.table_definition import plain_definition
from tests.cli.conftest import accepted, assert_refused, read_rows, write_rows


@pytest.fixture
def aligned(boresight, simulated, calibration, tmp_path):
    """The simulated tracker, aligned with its own true attitudes."""
    rows = {row["time_utc"]: row for row in read_rows(simulated / "calibration.csv")}
    table = write_rows(tmp_path / "gyro.csv", list(rows.values()), ["time_utc", "q_x", "q_y", "q_z", "q_w"])
    words = (simulated / "calibration.csv", "--sensor-a", simulated / "sensor.json", "--parameters-a", calibration)

    def run(*more):
        return boresight("align", *words, "--reference", table, "--reference-sigma-arcsec", "2", *more)

    return run


def test_c_sd_of_a_reference_is_told_written_and_loaded(boresight, aligned, simulated, calibration, tmp_path):
    file = tmp_path / "alignment.json"
    done = accepted(aligned("--json", file))
    assert "quaternion x, y, z, w" in done.stdout
    found = json.loads(file.read_text())
    assert found["schema"] == "boresight.alignment/1"
    assert found["pairs_used"] > 30
    away = 2 * np.array(found["quaternion"][:3])  # the reference is the detector itself
    P = np.array(found["covariance_rad2"])[:3, :3]
    assert away @ np.linalg.solve(P, away) < 16
    assert accepted(boresight("schema", "alignment")).stdout.startswith("{")

    sensor = json.loads((simulated / "sensor.json").read_text())
    definition = plain_definition(sensor["camera_model"])
    first, definition["crc"] = definition["length_bytes"], None
    del definition["crc"]
    definition["length_bytes"] += 32
    definition["fields"] += [
        {"name": name.upper(), "alignment": name, "offset_bytes": first + 8 * place, "type": "float64"}
        for place, name in enumerate(("q_x", "q_y", "q_z", "q_w"))
    ]
    layout = tmp_path / "definition.json"
    layout.write_text(json.dumps(definition))
    words = ("--sensor", simulated / "sensor.json", "--definition", layout, "--out", tmp_path / "image.bin")
    assert_refused(boresight("table", "encode", calibration, *words), "alignment")
    accepted(boresight("table", "encode", calibration, "--alignment", file, *words))
    held = np.frombuffer((tmp_path / "image.bin").read_bytes()[first:], ">f8")
    np.testing.assert_array_equal(held, found["to_load"]["quaternion"])
    other = tmp_path / "other.json"
    other.write_text(json.dumps(sensor["initial"]))
    assert_refused(boresight("table", "encode", other, "--alignment", file, *words), "align again")


def test_an_alignment_of_one_frame_is_refused(boresight, simulated):
    done = boresight("align", simulated / "calibration.csv", "--sensor-a", simulated / "sensor.json")
    assert_refused(done, "reference", lines=1)
