"""A forecast foretells what the run then says: its sigmas, its weak directions, and what would mend them."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.advice import to_hold
from boresight.calibration.calibrate import calibrate
from boresight.calibration.evaluation.forecast import MOST_FRAMES, MOST_STARS, forecast
from boresight.calibration.options import METHODS, CalibrationSettings
from boresight.estimation.statistics.observability import WEAK
from boresight.telemetry.read.frames import Sample, read_sample
from boresight.telemetry.read.readers import read_telemetry
from boresight.telemetry.sensors import read_sensor
from boresight.telemetry.working_table import write_working_table
from tests.calibration.sets import case, field, simulated


def foretold_of(telemetry, sensor, catalogue, tmp_path, frames=MOST_FRAMES, **settings):
    table = tmp_path / str(len(list(tmp_path.iterdir())))  # a stored table never changes under its path
    write_working_table(telemetry, table)
    sample = read_sample(table, frames, MOST_STARS)
    return forecast(sample, sensor, catalogue, CalibrationSettings(**{"match": "given", **settings}))


def _sigma(judged):
    return np.sqrt(np.diag(judged.estimate.P)) * judged.parameters.scale


def over_sigma(foretold, judged):
    return np.array(list(foretold["sigma"].values())) / _sigma(judged)


@pytest.mark.parametrize("number", [1, 2, 3, 4, 5, 6])
def test_sigmas_foretold_from_a_tenth_of_the_frames_are_those_of_the_run(number, catalogue, tmp_path):
    run = simulated(catalogue, number, frames=1000, seed=7)
    foretold = foretold_of(run.telemetry, run.problem.sensor, catalogue, tmp_path, frames=100)
    assert (foretold["frames_sampled"], foretold["frames"]) == (100, 1000)
    np.testing.assert_allclose(over_sigma(foretold, run), 1, atol=0.1)


@pytest.mark.parametrize(
    "settings",
    [
        *({"method": method} for method in METHODS),
        {"method": "sqrf", "variant": "q"},
        {"method": "ekf", "forgetting_factor": 0.98},
        {"method": "sqrf", "free": ("f_m", "b2_per_m2"), "initial_sigma_scale": 0.001},
        {"robust": "huber"},
        {"error": "cosine"},
    ],
    ids=lambda settings: "-".join(map(str, settings.values())),
)
def test_every_method_s_sigmas_are_foretold_within_a_tenth(settings, sensor, catalogue, tmp_path):
    telemetry = field(1, frames=160)
    run = case(telemetry, sensor, catalogue, **settings)
    foretold = foretold_of(telemetry, sensor, catalogue, tmp_path, frames=80, **settings)
    atol = 0.2 if settings.get("variant") == "q" or settings.get("forgetting_factor") else 0.1  # the last frames' own
    np.testing.assert_allclose(over_sigma(foretold, run), 1, atol=atol)


def test_directions_foretold_to_be_weak_are_those_the_run_names_and_holding_what_it_says_leaves_none(
    catalogue, tmp_path
):
    run = simulated(catalogue, 3, frames=8, seed=2)
    sensor = run.problem.sensor
    foretold = foretold_of(run.telemetry, sensor, catalogue, tmp_path)
    made = calibrate(run.telemetry, sensor, catalogue, CalibrationSettings(match="given"))
    weak = [sigma for sigma in made["observability"]["sigma_of_direction"] if sigma > WEAK]
    assert foretold["weak"] == len(weak) > 0
    assert foretold["sentence"] == f"8 parameters, {len(weak)} weakly observable with this coverage."
    assert foretold["weak_directions"][0] == made["observability"]["weakest"]["sentence"]
    held = to_hold(run.estimate.A)
    left = tuple(name for place, name in enumerate(sensor.free) if place not in held)
    after = foretold_of(run.telemetry, sensor, catalogue, tmp_path, free=left)
    assert foretold["help"][0].startswith("Hold ")
    assert 0 < len(held) < 8
    assert after["weak"] == 0
    assert after["help"] == []
    assert after["sentence"] == f"{len(left)} parameter{'s' * (len(left) > 1)}, all observable with this coverage."


def test_so_many_frames_as_the_forecast_says_leave_no_weak_direction(sensor, catalogue, tmp_path):
    few = foretold_of(field(3, frames=6), sensor, catalogue, tmp_path)
    words = few["help"][-1].split()
    needed = int(words[1].replace(",", ""))
    assert few["help"][-1].startswith("About ")
    assert foretold_of(field(3, frames=int(1.2 * needed)), sensor, catalogue, tmp_path)["weak"] == 0
    assert foretold_of(field(3, frames=needed // 2), sensor, catalogue, tmp_path)["weak"] > 0


def test_stars_in_the_middle_alone_are_said_to_be_so(sensor, catalogue, tmp_path):
    telemetry = field(4, frames=30)
    row, col = telemetry.row_px - sensor.rows / 2, telemetry.col_px - sensor.columns / 2
    inner = (np.abs(row) < sensor.rows / 4) & (np.abs(col) < sensor.columns / 4)
    kept = {
        name: getattr(telemetry, name)[inner]
        for name in ("frame", "exposure", "row_px", "col_px", "star_id", "ra_rad", "dec_rad")
    }
    foretold = foretold_of(replace(telemetry, **kept), sensor, catalogue, tmp_path)
    assert foretold["weak"] > 0
    assert any("% of the way to the corner and lie in 16 of 36 parts" in sentence for sentence in foretold["help"])


def test_a_set_without_enough_stars_foretells_nothing_and_a_fit_that_does_not_rest_the_present_parameters(
    sensor, catalogue, tmp_path
):
    foretold = foretold_of(field(5, frames=3, stars=3), sensor, catalogue, tmp_path)
    assert set(foretold["sigma"].values()) == {None}
    assert foretold["weak"] is None
    assert "nothing was estimated; match more stars" in foretold["sentence"]
    foretold = foretold_of(field(6, frames=20), sensor, catalogue, tmp_path, max_iterations=1)
    assert foretold["at"] == "present"
    assert all(value is None or value > 0 for value in foretold["sigma"].values())


@pytest.mark.parametrize("free", [("f_m",), ("f_m", "b2_per_m2"), None])
def test_sigmas_of_the_real_star_fields_are_foretold_within_a_tenth(free, catalogue, real_sky):
    telemetry, sensor = read_telemetry(real_sky / "esa-5-frames.csv"), read_sensor(real_sky / "esa.sensor.json")
    settings = CalibrationSettings(free=free)
    foretold = forecast(Sample(telemetry, 5, 5), sensor, catalogue, settings)
    made = calibrate(telemetry, sensor, catalogue, settings)
    for name in made["free"]:
        assert foretold["sigma"][name] == pytest.approx(made["sigma"][name], rel=0.1)
    if free is None:
        said = " ".join(foretold["weak_directions"])
        assert "n0 and a1 move together" in said
        assert "m0 and a2 move together" in said
