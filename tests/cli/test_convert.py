"""`boresight convert`: files in, files out, and a refusal that says by how much."""

import json

import pytest

from boresight.simulation.sensors import wu_sensor
from boresight.telemetry.sensors import sensor_document

LENS = {"s": 1.0, "f_m": 0.016, "u0_px": 970.0, "v0_px": 550.0, "k1": -0.05, "k2": 0.02}


@pytest.fixture
def lens(tmp_path):
    parameters, sensor = tmp_path / "lens.json", tmp_path / "sensor.json"
    parameters.write_text(json.dumps(LENS))
    sensor.write_text(json.dumps(sensor_document(wu_sensor())))
    return parameters, "--sensor", sensor, "--to", "inverted_wang"


def test_a_lens_goes_to_the_other_model_and_back(boresight, lens, tmp_path):
    out, sensor = tmp_path / "there.json", tmp_path / "there.sensor.json"
    done = boresight("convert", *lens, "--out", out, "--sensor-out", sensor)
    assert done.exit_code == 0, done.stderr
    for word in ("misfit over the detector", "arcsec", "RMS", f"Wrote {out}", f"Wrote {sensor}"):
        assert word in done.stdout
    back = boresight("convert", out, "--sensor", sensor, "--to", "pinhole_radial", "--out", "-")
    assert back.exit_code == 0, back.stderr
    assert json.loads(back.stdout)["parameters"]["f_m"] == pytest.approx(0.016, rel=1e-6)


def test_a_misfit_over_what_is_allowed_is_refused_in_one_line_and_nothing_is_written(boresight, lens, tmp_path):
    done = boresight("convert", *lens, "--out", tmp_path / "out.json", "--allow-px", "1e-9")
    assert done.exit_code == 1
    assert done.stderr.count("\n") == 1
    assert "px (" in done.stderr
    assert "1e-09 px is allowed" in done.stderr
    assert not (tmp_path / "out.json").exists()


def test_what_is_read_is_not_written_over(boresight, lens):
    for place in (lens[0], lens[2]):
        before = place.read_bytes()
        done = boresight("convert", *lens, "--out", place)
        assert done.exit_code == 1
        assert "choose another name" in done.stderr
        assert place.read_bytes() == before


def test_a_calibration_keeps_its_covariance(boresight, calibration, simulated, tmp_path):
    words = ("convert", calibration, "--sensor", simulated / "sensor.json", "--to", "pinhole_radial")
    refused = boresight(*words, "--out", tmp_path / "out.json")
    assert refused.exit_code == 1
    assert "decentring" in refused.stderr
    done = boresight(*words, "--out", tmp_path / "out.json", "--allow-px", "50")
    assert done.exit_code == 0, done.stderr
    assert "cannot express" in done.stdout
    written = json.loads((tmp_path / "out.json").read_text())
    assert all(value > 0 for value in written["sigma"].values())
