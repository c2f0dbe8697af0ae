"""The mission of years, small: what it tells, that its truth is its own, and that a pass alone is the library's calibration."""

import numpy as np

import boresight as bs
from benchmarks import mission, requests
from boresight.settings import read_settings
from boresight.sky.catalogue import load_catalogue

SMALL = {"passes": 24, "years": 0.3, "frames": 12, "checkpoints": 2}


def test_a_mission_is_drawn_by_its_seed_and_changes_only_where_it_should():
    one, again, other = (mission.draw_mission(1, 40, 3.0, seed) for seed in (1, 1, 2))
    assert (one.x == again.x).all()
    assert not (one.x == other.x).all()
    assert (np.diff(one.days) > 0).all()
    still = mission.draw_mission(1, 40, 3.0, 1, changes=False)
    assert (still.x == still.x[0]).all()
    z = (one.x - one.scenario.truth) / one.scenario.sensor.typical_sigma
    place = list(one.scenario.sensor.free).index(one.step[0])
    after = int(np.searchsorted(one.days, one.step[1]))
    assert abs(z[after, place] - z[after - 1, place]) > 0.3 * mission.STEP


def test_a_pass_alone_is_what_the_library_calibrates():
    catalogue = load_catalogue(read_settings().catalogue_folder)
    flown = mission.draw_mission(1, 3, 0.1, 1)
    seen = mission.observe(flown, 12, 1, catalogue)
    telemetry = mission._pass(flown, 1, 12, 1, catalogue)
    found = bs.calibrate(telemetry, flown.scenario.sensor, match="given", progress=False)
    sigma = np.array(list(found.sigma.values()))
    assert np.abs((np.array(list(found.parameters.values())) - seen.alone[1].x) / sigma).max() < 0.01


def test_a_small_mission_tells_both_ways_the_steps_and_what_was_asked():
    found = mission.measure(lambda *_: None, sensors=(1,), **SMALL)
    assert found["checkpoints"] == 2 * len(found["steps"])
    assert [one["passes"] for one in found["windows"]] == [12, 24]
    assert all(one["joint_px"] > 0.0 for one in found["windows"])
    assert len(found["joint_sigma"]) == len(found["parameters"]) == 8
    assert {one["kept"] for one in found["limits"].values()} <= {True, False}


def test_small_missions_tell_what_a_policy_would_have_asked_and_what_was_to_be_expected():
    found = requests.measure(lambda *_: None, sensors=(1,), passes=24, years=0.3, frames=12)
    still = found["policy"]["nothing changes"]
    assert still["states"].get("ASKED", 0) <= 1
    assert still["requests_a_year"] == still["false_a_year"]
    assert still["expected_a_year"] == 0.001 * 23 / 0.3
    assert sum(found["policy"]["mission"]["states"].values()) == 23
    assert found["limits"]["requests a sensor and year where nothing changes"]["limit"] == 1 / 0.3
