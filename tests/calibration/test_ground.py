"""Calibrations from the ground: right with the site, biased and found out without it; the real field both ways."""

import numpy as np
import pytest

from benchmarks.ground import measure, real_field, scene
from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.errors import RefusedInputError
from boresight.simulation.scenes import parse_scenario, scenario_document, simulate
from tests.calibration.sets import write_in_groups


def test_a_site_takes_the_bias_away_and_without_it_refraction_is_the_cause(monkeypatch):
    monkeypatch.setenv("BORESIGHT_REAL_SKY", "nowhere")
    found = measure(lambda *_: None, sets=1, frames=60, elevations=((20, 60),))
    (ways,) = found["elevations"].values()
    assert ways["with site"]["focal_sigma"] < 4
    assert not ways["with site"]["noticed"]
    assert ways["without"]["focal_sigma"] > 6
    assert ways["without"]["focal_ppm"] == pytest.approx(-300, abs=100)
    assert ways["without"]["cause"] == 1.0
    assert ways["without"]["with_misfit"] < 3
    assert all(limit["kept"] for limit in found["limits"].values())


def test_the_real_field_holds_refraction_and_lacks_it_where_its_directions_are_left_out(real_sky, monkeypatch):
    monkeypatch.setenv("BORESIGHT_REAL_SKY", str(real_sky))
    assert [(one["noticed"], len(one["sentences"])) for one in real_field().values()] == [
        (False, 0),
        (True, 1),
        (False, 0),
    ]


@pytest.mark.full
def test_stars_of_nobody_knows_where_are_recognised_through_the_air(catalogue, catalogue_folder):
    scenario = scene(20, 40, 8, 3)
    telemetry = simulate(scenario, np.random.default_rng(3), catalogue)
    found = calibrate(
        type(telemetry)(
            frame=telemetry.frame, exposure=telemetry.exposure, row_px=telemetry.row_px, col_px=telemetry.col_px,
            time_utc=telemetry.time_utc, magnitude=telemetry.magnitude, sigma_px=telemetry.sigma_px,
        ),
        scenario.sensor, catalogue, CalibrationSettings(), cache_folder=catalogue_folder,
    )  # fmt: skip
    assert found.exposures >= 6
    assert found.chi2_per_dof < 1.3


@pytest.mark.full
def test_a_large_file_is_seen_through_the_air_as_a_set_in_memory_is(catalogue, tmp_path):
    scenario = scene(20, 60, 40, 2)
    telemetry = simulate(scenario, np.random.default_rng(2), catalogue)
    file = TelemetryFile(write_in_groups(telemetry, tmp_path, 100), large_rows=0, chunk_frames=15)
    whole = calibrate(telemetry, scenario.sensor, catalogue, CalibrationSettings())
    pieces = calibrate(file, scenario.sensor, catalogue, CalibrationSettings(), scratch_folder=tmp_path)
    for name, sigma in whole.sigma.items():
        if sigma is not None:
            assert pieces.parameters[name] == pytest.approx(whole.parameters[name], abs=0.1 * sigma)
    assert {one.name for one in pieces.assumptions} == {one.name for one in whole.assumptions}


def test_a_scenario_on_the_ground_is_written_and_read_again_and_a_wrong_one_refused():
    document = scenario_document(scene(20, 60, 5, 1))
    assert scenario_document(parse_scenario(document)) == document
    for wrong in ({"motion": "nadir"}, {"pointing_deg": 2}, {"pointing_deg": 60}):
        with pytest.raises(RefusedInputError):
            parse_scenario({**document, **wrong})
    with pytest.raises(RefusedInputError):
        parse_scenario({"sensor": 1, "motion": "ground"})
