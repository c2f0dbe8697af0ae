"""Parameters of a pass, walks and temperatures over several telemetry sets: the stacked problem, and the last pass in its light."""

import re
from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.estimate import Parameters, never
from boresight.calibration.joint.passes import NamedTelemetry, join_sets
from boresight.calibration.joint.passes_fit import fit_passes, list_places
from boresight.calibration.joint.variation import fit_variation, make_link
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.errors import RefusedInputError
from boresight.estimation.block_bordered import Linked, Regressed
from boresight.estimation.statistics.consistency import chi_square, nees
from tests.calibration.conftest import telemetry
from tests.calibration.sets import differences, written
from tests.calibration.test_joint import BEGIN, DAY, together
from tests.estimation.fields import FREE, GROUND, SCALE, TRUTH, whitened_plainly, whitened_rows
from tests.refusals import has_code

NAMES = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")
PARAMETERS = Parameters(FREE, SCALE)
#: Of the focal length, one typical sigma a pass, is far beyond the noise of a pass.
STEPS = np.array([0.0, 1.0, -1.0, 2.0])


def moved(steps, seed=50, frames=30, days=None, warm=None, stars=12):
    """Passes whose focal length is off the common one by so many typical sigmas."""
    sets = []
    for k, step in enumerate(steps):
        truth = TRUTH.copy()
        truth[0] += step * SCALE[0]
        one = telemetry(seed + k, frames=frames, truth=truth, stars=stars)
        if days is not None:
            one = replace(one, time_utc=BEGIN + days[k] * DAY + one.frame * np.timedelta64(1, "s"))
        if warm is not None:
            one = replace(one, temperature_c=np.full(len(one), warm[k]))
        sets.append(one)
    return sets


def problem_of(sets, sensor, catalogue):
    joint = together(*sets)
    return build_problem(joint.read(), sensor, catalogue), joint.passes


def run(sets, sensor, catalogue, **settings):
    return calibrate(together(*sets), sensor, catalogue, CalibrationSettings(**{"match": "given", **settings}))


def picked(K, own):
    shared = np.setdiff1d(np.arange(8), own)
    B = np.zeros((K, 8, len(shared) + K * len(own)))
    B[:, shared, np.arange(len(shared))] = 1.0
    for k in range(K):
        B[k, own, len(shared) + k * len(own) + np.arange(len(own))] = 1.0
    return B


@pytest.mark.parametrize("how", ["pass", "walk", "temperature"])
def test_the_fit_of_passes_is_the_dense_stacked_problem_within_1e_9_sigma(sensor, catalogue, how):
    warm, days = np.array([10.0, 14.0, 6.0, 18.0]), np.array([0, 3, 10, 40])
    problem, passes = problem_of(moved(STEPS, days=days, warm=warm), sensor, catalogue)
    settings = CalibrationSettings(vary=("f_m", "b2_per_m2"), vary_as=how, walk_sigma=0.3)
    own, ends = np.array([0, 4]), list_places(problem, passes)
    t = warm - warm.mean()
    by_temperature = Regressed(own, np.tile(t[:, None], (1, 2)))
    link = by_temperature if how == "temperature" else make_link(passes, own, settings)
    fitted = fit_passes(problem, ends, PARAMETERS, GROUND, link, never)
    assert fitted.converged
    z = (fitted.states - GROUND) / SCALE
    if how == "temperature":
        B = np.concatenate([np.tile(np.eye(8), (4, 1, 1)), t[:, None, None] * np.eye(8)[:, own]], axis=2)
        links = residuals = []
    else:
        B = picked(4, own)
        root = np.sqrt(link.W)
        links = [root[k][:, None] * (B[k, own] - B[k - 1, own]) for k in range(1, 4)]
        residuals = [root[k] * (z[k, own] - z[k - 1, own]) for k in range(1, 4)]
    e = [whitened_plainly(part, x) for part, x in zip(fitted.arcs.held, fitted.states, strict=True)]
    H = [
        whitened_rows(part, x, FREE, SCALE)[1] @ b
        for part, x, b in zip(fitted.arcs.held, fitted.states, B, strict=True)
    ]
    J = np.concatenate([*H, *links])
    step, *_ = np.linalg.lstsq(J, -np.concatenate([*e, *residuals]), rcond=None)
    P = np.linalg.inv(J.T @ J)
    assert np.abs(step / np.sqrt(np.diag(P))).max() < 1e-9
    for k, b in enumerate(B):
        np.testing.assert_allclose(fitted.solution.P[k], b @ P @ b.T, rtol=1e-7, atol=1e-9 * np.abs(P).max())


@pytest.mark.parametrize("how", ["pass", "walk"])
def test_the_numbers_are_those_of_the_last_pass_in_the_whole_problem(sensor, catalogue, how):
    sets = moved(STEPS, days=[0, 3, 10, 40])
    problem, passes = problem_of(sets, sensor, catalogue)
    settings = CalibrationSettings(vary=("f_m",), vary_as=how)
    fitted, _ = fit_variation(problem, passes, PARAMETERS, GROUND, settings, never)
    found = run(sets, sensor, catalogue, vary=("f_m",), vary_as=how)
    sigma = np.sqrt(np.diag(fitted.solution.P[-1])) * SCALE
    x = np.array([found.parameters[name] for name in NAMES])
    assert found.status == "converged"
    assert np.abs((x - fitted.states[-1]) / sigma).max() < 0.01
    np.testing.assert_allclose([found.sigma[name] for name in NAMES], sigma, rtol=1e-3)
    assert found.frames == passes[-1].frames
    assert len(found.inputs.passes) == len(found.variation.states) == 4
    assert found.prior.share["m0_px"] > 0.5


def test_what_changes_from_pass_to_pass_is_found_and_what_does_not_is_called_chance(sensor, catalogue):
    changed = run(moved(STEPS), sensor, catalogue, vary=("f_m",))
    states = changed.variation.states
    apart = np.array([one.parameters["f_m"] - TRUTH[0] for one in states]) / SCALE[0] - STEPS
    assert np.abs(apart / [one.sigma["f_m"] / SCALE[0] for one in states]).max() < 4
    assert changed.variation.test.p_value < 1e-9
    assert changed.variation.test.dof == 3
    still = run(moved([0, 0, 0]), sensor, catalogue, vary=("f_m",)).variation
    assert still.test.p_value > 1e-3


def test_a_slope_in_temperature_is_found_with_its_sigma(sensor, catalogue):
    warm, slope = np.array([5.0, 15.0, 10.0, 25.0]), 0.2
    found = run(moved(slope * warm, warm=warm), sensor, catalogue, vary=("f_m",), vary_as="temperature").variation
    assert abs(found.slope["f_m"] - slope * SCALE[0]) < 4 * found.slope_sigma["f_m"]
    assert found.reference_temperature_c == pytest.approx(warm.mean())
    assert found.test.p_value < 1e-9


WARM = np.array([-20.0, -12.0, -5.0, 0.0, 6.0, 11.0, 17.0, 25.0])


def test_the_degree_in_temperature_is_what_the_evidence_of_each_parameter_says(sensor, catalogue):
    curve = 0.05 * WARM + 0.004 * WARM**2
    found = run(
        moved(curve, warm=WARM, frames=15),
        sensor,
        catalogue,
        vary=("f_m", "m0_px"),
        vary_as="temperature",
        degree="auto",
    ).variation
    assert found.degree == {"f_m": 2, "m0_px": 0}
    reference = found.reference_temperature_c
    truth = np.array([0.05 + 0.008 * reference, 0.004]) * SCALE[0]
    assert np.abs((np.array(found.coefficients["f_m"]) - truth) / found.coefficient_sigma["f_m"]).max() < 4
    assert found.tests["f_m"].dof == 2
    assert found.tests["f_m"].p_value < 1e-9
    assert found.coefficients["m0_px"] == []
    at = [one.parameters["f_m"] for one in found.states]
    sigma = [one.sigma["f_m"] for one in found.states]
    assert np.abs((at - TRUTH[0] - curve * SCALE[0]) / sigma).max() < 4


def test_a_stated_degree_is_kept_and_one_that_the_temperatures_do_not_tell_is_refused(sensor, catalogue):
    found = run(
        moved(0.2 * WARM, warm=WARM, frames=15), sensor, catalogue, vary=("f_m",), vary_as="temperature", degree="3"
    )
    assert found.variation.degree == {"f_m": 3}
    assert found.variation.slope["f_m"] == found.variation.coefficients["f_m"][0]
    with pytest.raises(RefusedInputError, match="--degree", check=has_code("too-few-passes")):
        run(moved([0, 0], warm=[1.0, 5.0]), sensor, catalogue, vary=("f_m",), vary_as="temperature", degree="2")


def test_drift_a_day_is_found_with_its_test(sensor, catalogue):
    days = [0, 10, 25, 40, 80]
    found = run(
        moved(0.02 * np.array(days), days=days), sensor, catalogue, vary=("f_m", "n0_px"), vary_as="drift"
    ).variation
    assert abs(found.slope["f_m"] - 0.02 * SCALE[0]) < 4 * found.slope_sigma["f_m"]
    assert found.tests["f_m"].p_value < 1e-6
    assert found.tests["n0_px"].p_value > 1e-3
    assert found.reference_utc.startswith("2026-02-01")


def stepped(sizes, gaps, seed=70):
    """Ten passes three days apart whose focal length steps in some gaps."""
    k = np.arange(10)
    steps = sum(size * (k > gap) for size, gap in zip(sizes, gaps, strict=True)) + np.zeros(10)
    return moved(steps, seed=seed, frames=15, days=(3 * k).tolist())


def test_a_step_is_proposed_with_its_size_and_an_interval_for_its_date(sensor, catalogue):
    found = run(stepped([1.0], [5]), sensor, catalogue, vary=("f_m", "m0_px"), vary_as="step").variation
    (step,) = found.steps
    assert step.parameter == "f_m"
    assert abs(step.step - SCALE[0]) < 4 * step.sigma
    assert step.p_value < 1e-6
    assert np.datetime64(step.from_utc[:-1]) <= BEGIN + 15 * DAY + DAY // 100
    assert np.datetime64(step.to_utc[:-1]) >= BEGIN + 18 * DAY
    assert re.match(r"f stepped by \+.* ppm .*2026-01-", step.sentence)
    assert [one.parameters["f_m"] for one in found.states[:6]] == [found.states[0].parameters["f_m"]] * 6


def test_two_steps_are_found_and_none_where_nothing_stepped(sensor, catalogue):
    two = run(stepped([1.5, -2.0], [2, 6]), sensor, catalogue, vary=("f_m",), vary_as="step").variation
    assert len(two.steps) == 2
    assert sorted(np.sign([one.step for one in two.steps]).tolist()) == [-1.0, 1.0]
    still = run(stepped([], []), sensor, catalogue, vary=("f_m",), vary_as="step")
    assert still.variation.steps == []
    assert still.status == "converged"
    assert still.variation.test is None


def test_steps_at_events_are_those_that_are_beyond_chance(sensor, catalogue):
    events = ["2026-01-08T00:00:00Z", "2026-01-17T12:00:00Z"]
    found = run(stepped([1.0], [5]), sensor, catalogue, vary=("f_m",), vary_as="step", events=events).variation
    (step,) = found.steps
    assert step.event_utc == events[1]
    assert abs(step.step - SCALE[0]) < 4 * step.sigma
    assert step.sentence.endswith(f"at {events[1]}")


@pytest.mark.full
def test_a_walk_lies_between_one_camera_and_one_for_each_pass(sensor, catalogue):
    sets = moved(STEPS, days=[0, 1, 2, 3])
    sigma = [
        run(sets, sensor, catalogue, vary=("f_m",), vary_as="walk", walk_sigma=walk).sigma["f_m"]
        for walk in (1e-4, 0.01, 0.1, 10.0)
    ]
    assert sigma == sorted(sigma)
    alone = run(sets, sensor, catalogue, vary=("f_m",)).sigma["f_m"]
    alike = calibrate(together(*sets), sensor, catalogue, CalibrationSettings(match="given")).sigma["f_m"]
    assert sigma[-1] == pytest.approx(alone, rel=0.02)
    assert sigma[0] == pytest.approx(alike, rel=0.05)


def test_a_walk_that_nobody_states_is_estimated_with_its_interval(sensor, catalogue):
    rng, truth = np.random.default_rng(4), 0.5
    sets = moved(np.cumsum(truth * rng.normal(size=12)), frames=12, days=list(range(12)))
    found = run(sets, sensor, catalogue, vary=("f_m", "m0_px"), vary_as="walk").variation
    low, high = found.walk["f_m"].interval
    assert low < truth < high
    assert 0.3 < found.walk["f_m"].sigma < 1.0
    assert found.walk["m0_px"].interval[0] == 0.0
    assert found.walk["m0_px"].sigma < 0.3 * found.walk["f_m"].sigma


def test_a_walk_about_a_line_in_the_temperature_tells_both(sensor, catalogue):
    rng, warm, slope, walk = np.random.default_rng(9), 10.0 * np.sin(np.arange(14)), 0.2, 0.3
    steps = slope * warm + np.cumsum(walk * rng.normal(size=14))
    sets = moved(steps, frames=12, days=list(range(14)), warm=warm)
    by_both, by_walk = (
        run(sets, sensor, catalogue, vary=("f_m",), vary_as=how).variation for how in ("walk-and-temperature", "walk")
    )
    assert abs(by_both.slope["f_m"] - slope * SCALE[0]) < 4.0 * by_both.slope_sigma["f_m"]
    assert by_both.slope_sigma["f_m"] < 0.1 * slope * SCALE[0]
    assert by_both.tests["f_m"].p_value < 1e-6
    low, high = by_both.walk["f_m"].interval
    assert low < walk < high < by_walk.walk["f_m"].sigma  # which has to walk as far as the temperature leads
    assert by_both.states[-1].sigma["f_m"] < by_walk.states[-1].sigma["f_m"]


def test_a_filter_takes_the_other_passes_as_its_start(sensor, catalogue):
    sets = moved(STEPS)
    by_batch, by_filter = (run(sets, sensor, catalogue, vary=("f_m",), method=method) for method in ("batch", "sqrf"))
    assert by_filter.status == "converged"
    for name in NAMES:
        assert abs(by_filter.parameters[name] - by_batch.parameters[name]) < 0.3 * by_batch.sigma[name]
        assert by_filter.sigma[name] == pytest.approx(by_batch.sigma[name], rel=0.05)


def test_passes_in_files_give_the_numbers_of_passes_in_memory(sensor, catalogue, tmp_path):
    files = []
    for k, one in enumerate(moved([0, 1], frames=40)):
        (tmp_path / str(k)).mkdir()
        path, _ = written(one, tmp_path / str(k))
        files.append(NamedTelemetry(TelemetryFile(path, chunk_frames=16), f"pass {k}"))
    settings = CalibrationSettings(match="given", vary=("f_m",))
    whole, pieces = (
        calibrate(join_sets(files, large_rows=rows), sensor, catalogue, settings, scratch_folder=tmp_path)
        for rows in (10**9, 0)
    )
    assert differences(whole.to_dict(), pieces.to_dict()) == []


@pytest.mark.full
def test_errors_of_the_last_pass_are_spread_as_its_covariance_says(sensor, catalogue):
    rng, total, sets = np.random.default_rng(9), 0.0, 100
    link = Linked(np.array([0]), np.array([[0.0], [4.0], [4.0]]))
    for seed in range(sets):
        steps = np.cumsum(0.5 * rng.normal(size=3))
        problem, passes = problem_of(moved(steps, seed=2000 + 3 * seed, frames=12), sensor, catalogue)
        fitted = fit_passes(problem, list_places(problem, passes), PARAMETERS, TRUTH, link, never)
        truth = TRUTH.copy()
        truth[0] += steps[-1] * SCALE[0]
        total += nees((fitted.states[-1] - truth) / SCALE, fitted.solution.P[-1])
    assert chi_square(total, 8 * sets).consistent


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"vary": ("k1",)}, "k1 is not free, so it cannot vary: choose"),
        ({"vary": ("f_m",), "robust": "huber"}, "set error to 'arclength' and robust to 'none'"),
        ({"vary": ("f_m",), "vary_as": "temperature"}, "add the column"),
        ({"vary": ("f_m",), "vary_as": "walk"}, "add time_utc"),
        ({"vary": ("f_m",), "vary_as": "drift"}, "add time_utc"),
        ({"vary": ("f_m",), "vary_as": "step"}, "add time_utc"),
        ({"vary": ("f_m",), "degree": "2"}, "omit --degree"),
        ({"vary": ("f_m",), "events": ("2026-01-01",)}, "omit --events"),
    ],
)
def test_what_cannot_vary_is_refused(sensor, catalogue, settings, said):
    with pytest.raises(RefusedInputError, match=said):
        run(moved([0, 0]), sensor, catalogue, **settings)


def test_one_set_does_not_vary_and_a_pass_that_sees_too_little_is_named(sensor, catalogue):
    one = moved([0])[0]
    with pytest.raises(RefusedInputError, check=has_code("one-set-cannot-vary")):
        calibrate(one, sensor, catalogue, CalibrationSettings(match="given", vary=("f_m",)))
    thin = moved([0], seed=60)[0]
    thin = replace(thin, ra_rad=np.full(len(thin), np.nan), dec_rad=np.full(len(thin), np.nan), star_id=None)
    with pytest.raises(RefusedInputError, match="pass 1", check=has_code("pass-too-short")):
        run([one, thin], sensor, catalogue, vary=("f_m",))


def flown(walk=0.1, slope=0.1, step=1.5, seed=3, K=24):
    """Passes whose focal length walks, follows the temperature and steps after the twelfth."""
    rng, days = np.random.default_rng(seed), 3 * np.arange(K)
    warm = 15.0 + 8.0 * np.sin(days / 11.0) + rng.normal(0.0, 2.0, K)
    steps = slope * (warm - 15.0) + walk * np.cumsum(rng.normal(size=K)) + step * (np.arange(K) > 12)
    return moved(steps, seed=400, frames=12, days=days.tolist(), warm=warm), steps


def test_season_walk_and_step_are_told_apart_by_their_evidence(sensor, catalogue):
    sets, steps = flown()
    found = run(sets, sensor, catalogue, vary=("f_m", "m0_px"), vary_as="evidence")
    told = found.variation
    (step,) = told.steps
    assert step.parameter == "f_m"
    assert abs(step.step - 1.5 * SCALE[0]) < 4 * step.sigma
    assert np.datetime64(step.from_utc[:-1]) <= BEGIN + 37 * DAY
    assert np.datetime64(step.to_utc[:-1]) >= BEGIN + 39 * DAY
    assert abs(told.slope["f_m"] - 0.1 * SCALE[0]) < 4 * told.slope_sigma["f_m"]
    assert abs(told.slope["m0_px"]) < 4 * told.slope_sigma["m0_px"]
    assert abs(told.rate["m0_px"]) < 4 * told.rate_sigma["m0_px"]
    low, high = told.walk["f_m"].interval
    assert low < 0.1 / np.sqrt(3) < high
    now = TRUTH[0] + steps[-1] * SCALE[0]
    assert abs(found.parameters["f_m"] - now) < 4 * found.sigma["f_m"]
    alone = calibrate(sets[-1], sensor, catalogue, CalibrationSettings(match="given"))
    assert found.sigma["f_m"] < 0.7 * alone.sigma["f_m"]
    assert found.sigma["m0_px"] < 0.5 * alone.sigma["m0_px"]


def test_few_passes_without_temperature_are_a_walk_and_no_more(sensor, catalogue):
    told = run(moved(STEPS, days=[0, 3, 10, 40]), sensor, catalogue, vary=("f_m",), vary_as="evidence").variation
    assert (told.slope, told.rate, told.steps, told.compared) == (None, None, [], None)
    assert len(told.states) == 4


@pytest.mark.parametrize(
    ("kind", "steps"),
    [
        ("drift", 0.15 * np.arange(10)),
        ("steps", 3.0 * (np.arange(10) > 4)),
        ("walk", np.cumsum(0.2 * np.random.default_rng(5).normal(size=40))),
        ("none", np.zeros(10)),
    ],
)
def test_drift_steps_and_walk_are_held_against_one_another(sensor, catalogue, kind, steps):
    told = run(
        moved(steps, frames=15, days=(3 * np.arange(len(steps))).tolist()),
        sensor,
        catalogue,
        vary=("f_m",),
        vary_as="drift",
    ).variation
    assert [one.bic for one in told.compared] == sorted(one.bic for one in told.compared)
    assert {one.kind for one in told.compared} == {"none", "drift", "steps", "walk"}
    assert told.compared[0].kind == kind
    assert min(one.deviance for one in told.compared) == 0.0
    assert "these passes" in told.sentence
