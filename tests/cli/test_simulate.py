"""`boresight simulate` and `convert`: files in, files out, true to what is said beside them."""

import json

import pytest

from boresight.simulation.sensors import wu_sensor
from boresight.telemetry.sensors import sensor_document
from tests.cli.conftest import assert_refused


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
    assert_refused(done, lines=1)


def test_an_unknown_name_is_refused_with_the_names_there_are(boresight, tmp_path):
    done = boresight("simulate", "st16-7", "--out", tmp_path)
    assert_refused(done, "st16-1")


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
    assert_refused(done, "px (", "1e-09 px is allowed", lines=1)
    assert not (tmp_path / "out.json").exists()


def test_what_is_read_is_not_written_over(boresight, lens):
    for place in (lens[0], lens[2]):
        before = place.read_bytes()
        done = boresight("convert", *lens, "--out", place)
        assert_refused(done, "choose another name")
        assert place.read_bytes() == before


def test_a_calibration_keeps_its_covariance(boresight, calibration, simulated, tmp_path):
    words = ("convert", calibration, "--sensor", simulated / "sensor.json", "--to", "pinhole_radial")
    refused = boresight(*words, "--out", tmp_path / "out.json")
    assert_refused(refused, "decentring")
    done = boresight(*words, "--out", tmp_path / "out.json", "--allow-px", "50")
    assert done.exit_code == 0, done.stderr
    assert "cannot express" in done.stdout
    written = json.loads((tmp_path / "out.json").read_text())
    assert all(value > 0 for value in written["sigma"].values())
