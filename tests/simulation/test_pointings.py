"""A plan of pointings: its information is that of arclengths, its forecast comes true, and it keeps what it has to keep."""

import json
from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest
from click.testing import CliRunner

import boresight as bs
from benchmarks import pointings
from boresight.calibration.problem import build_problem
from boresight.cameras import CAMERA_MODELS
from boresight.cli import main
from boresight.estimation.batch import normal_equations
from boresight.simulation.orbits import sun_direction
from boresight.simulation.plans import make_plan
from boresight.simulation.pointings import (
    Candidates,
    Constraints,
    draw_pointings,
    exposure_information,
    moon_direction,
    plan_pointings,
    spread_over_sky,
)
from boresight.simulation.scenes import calibration_scenario, expose, simulate
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.schema import find_exposures
from tests.effort import effort

SCENE = replace(calibration_scenario(1, 40), exposures=1, false_stars=0.0, blanked_share=0.0)
SENSOR = replace(SCENE.sensor, initial=SCENE.truth)
CAMERA = CAMERA_MODELS[SENSOR.camera_model]
FREE = np.array([CAMERA.parameter_names.index(name) for name in SENSOR.free])
SCALE = SENSOR.typical_sigma[FREE]
HALF_HOUR = Constraints(start_utc=np.datetime64("2026-10-01T00:00:00", "us"), minutes=30.0, orbit=SCENE.orbit)
KNOWN = np.eye(len(FREE)) / 100.0


@pytest.fixture(scope="module")
def catalogue():
    return load_catalogue(None)


@pytest.fixture(scope="module")
def sky(catalogue):
    candidates = spread_over_sky(200, 4)
    return candidates, *exposure_information(candidates, SENSOR, SCENE.truth, FREE, SCALE, catalogue)


def test_the_information_of_exposures_is_that_of_their_arclengths(catalogue):
    scene = replace(SCENE, magnitude_limit=5.0)
    telemetry = simulate(scene, np.random.default_rng(1), catalogue)
    C = expose(scene).attitude[np.unique(find_exposures(telemetry).of_entry)]
    seen = np.isin(catalogue.hip, telemetry.star_id)
    # the same stars as were drawn: those that an exposure missed are few, and its neighbours see them
    few = replace(
        catalogue, **{name: getattr(catalogue, name)[seen] for name in ("hip", "ra_rad", "dec_rad", "magnitude")}
    )
    z, rows = C[:, 2], C[:, 0]
    east = np.stack([-z[:, 1], z[:, 0], np.zeros(len(z))], axis=-1) / np.hypot(z[:, 0], z[:, 1])[:, None]
    north = np.cross(z, east)
    roll = np.arctan2(np.einsum("ni,ni->n", rows, east), np.einsum("ni,ni->n", rows, north))
    candidates = Candidates(np.arctan2(z[:, 1], z[:, 0]), np.arcsin(z[:, 2]), roll)
    assert candidates.attitude == pytest.approx(C, abs=1e-9)
    problem = build_problem(telemetry, SENSOR, catalogue)
    A = normal_equations(problem.whitened(SCENE.truth), SCENE.truth, FREE, SCALE).A
    A_1, stars = exposure_information(candidates, SENSOR, SCENE.truth, FREE, SCALE, few)
    share = problem.arcs.n_stars / stars.sum()
    sigma, expected = (np.sqrt(np.diag(np.linalg.inv(one))) for one in (A_1.sum(axis=0) * share, A))
    assert sigma == pytest.approx(expected, rel=0.1)


def _observe(plan, candidates, catalogue, rng):
    attitude = candidates.attitude[np.repeat(plan.place, HALF_HOUR.exposures)]
    return pointings.observe(attitude, SENSOR, SCENE.truth, catalogue, rng)


@pytest.mark.full
def test_a_forecast_comes_true_in_the_claimed_sigmas_and_in_the_errors(sky, catalogue):
    candidates, A_1, _ = sky
    plan = plan_pointings(candidates, A_1, KNOWN, HALF_HOUR)
    sets = effort(8, 60)
    errors = []
    for seed in range(sets):
        found = bs.calibrate(
            _observe(plan, candidates, catalogue, np.random.default_rng(seed)), SENSOR, match="given", progress=False
        )
        claimed = np.array([found.sigma[name] for name in SENSOR.free]) / SCALE
        assert claimed == pytest.approx(plan.sigma[-1], rel=0.1)
        errors.append(
            (np.array([found.parameters[name] for name in SENSOR.free]) - SCENE.truth[FREE]) / claimed / SCALE
        )
    # a mean square of sets x parameters normals; parameters are correlated, so their number counts once
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / sets))


@pytest.mark.parametrize("criterion", ["A", "D"])
def test_a_plan_keeps_its_time_and_its_distances_and_holds_nothing_too_often(sky, criterion):
    candidates, A_1, _ = sky
    plan = plan_pointings(candidates, A_1, KNOWN, HALF_HOUR, criterion)
    assert len(plan.place) > 3
    assert np.bincount(plan.place).max() <= HALF_HOUR.visits
    begins = np.concatenate([[0.0], (plan.start_s + HALF_HOUR.dwell_s)[:-1]])
    assert plan.start_s - begins == pytest.approx(plan.slew_s)
    assert plan.start_s[-1] + HALF_HOUR.dwell_s <= 1800.0
    assert HALF_HOUR.allow(candidates.boresight[plan.place], plan.start_s).all()
    z = candidates.boresight[plan.place]
    for body, least in ((sun_direction, HALF_HOUR.sun_deg), (moon_direction, HALF_HOUR.moon_deg)):
        there = body(HALF_HOUR.start_utc + (plan.start_s * 1e6).astype("timedelta64[us]"))
        assert np.degrees(np.arccos(np.einsum("ni,ni->n", z, there))).min() >= least


@pytest.mark.full
def test_a_plan_is_better_than_chance_by_both_measures(sky):
    candidates, A_1, _ = sky
    drawn = [draw_pointings(candidates, A_1, KNOWN, HALF_HOUR, np.random.default_rng(seed)) for seed in range(10)]
    by_a, by_d = (plan_pointings(candidates, A_1, KNOWN, HALF_HOUR, criterion) for criterion in "AD")
    volume, variance = (lambda p: np.linalg.slogdet(p.A[-1])[1]), (lambda p: np.square(p.sigma[-1]).sum())
    assert volume(by_d) > max(map(volume, drawn))
    assert variance(by_a) < min(map(variance, drawn)) / 2.0


def _value(A, criterion):
    """The measure of a criterion, by eigenvalues."""
    e = np.linalg.eigvalsh(A)
    return np.log(e).sum() if criterion == "D" else -(1.0 / e).sum()


@pytest.mark.few(1)
@pytest.mark.parametrize("criterion", ["A", "D"])
def test_exchange_is_no_worse_than_greedy_choice_and_within_a_thousandth_of_every_plan_there_is(sky, criterion):
    candidates, A_1, _ = sky
    wanted = replace(HALF_HOUR, minutes=4.5, slew_deg_s=1e9, settle_s=0.0, sun_deg=0.0, moon_deg=0.0, orbit=None)
    all_plans = [
        list(one) for one in combinations_with_replacement(range(12), 4) if np.bincount(one).max() <= wanted.visits
    ]
    shares = []
    for seed in range(20):
        chosen = np.random.default_rng(seed).choice(len(candidates), 12, replace=False)
        few = Candidates(*(one[chosen] for one in (candidates.ra_rad, candidates.dec_rad, candidates.roll_rad)))
        A = wanted.exposures * A_1[chosen]
        greedy = []
        for _ in range(4):
            rest = [one for one in range(12) if greedy.count(one) < wanted.visits]
            greedy.append(max(rest, key=lambda one: _value(KNOWN + A[[*greedy, one]].sum(axis=0), criterion)))
        plan = plan_pointings(few, A_1[chosen], KNOWN, wanted, criterion)
        assert len(plan.place) == 4
        found, by_greed = (_value(KNOWN + A[one].sum(axis=0), criterion) for one in (plan.place, greedy))
        assert found >= by_greed - 1e-9
        best = max(_value(KNOWN + A[one].sum(axis=0), criterion) for one in all_plans)
        # as a share of the information a parameter: D by the root of the determinant, A by the sum of variances
        shares.append(
            [np.exp((one - best) / len(FREE)) if criterion == "D" else best / one for one in (found, by_greed)]
        )
    share, of_greed = np.min(shares, axis=0)
    assert share >= 0.999
    assert of_greed < 0.996  # greedy choice alone is not enough


def test_without_slews_a_plan_is_never_worse_than_the_best_pointing_held(sky):
    candidates, A_1, _ = sky
    free = replace(
        HALF_HOUR, slew_deg_s=90.0, settle_s=0.0, sun_deg=0.0, moon_deg=0.0, orbit=None, visits=100, minutes=8.0
    )
    plan = plan_pointings(candidates, A_1, KNOWN, free, "D")
    held = KNOWN + 7 * free.exposures * A_1  # the turns of eight pointings cost less than one dwell
    assert np.linalg.slogdet(plan.A[-1])[1] >= np.linalg.slogdet(held)[1].max()


def test_a_command_writes_pointings_and_a_document_and_starts_from_a_calibration(tmp_path):
    made = bs.simulate("st16-1", frames=40, seed=3)
    made.save(tmp_path)
    found = bs.calibrate(made.telemetry, made.sensor, progress=False)
    found.save(tmp_path / "cal.json")
    files = {"sensor": "sensor.json", "calibration": "cal.json", "out": "plan.csv", "json": "plan.json"}
    words = ["plan", "--start", "2026-10-01T00:00:00Z", "--minutes", "6", "--orbit", "570,97.8,10.5"]
    words += [word for name, file in files.items() for word in (f"--{name}", str(tmp_path / file))]
    done = CliRunner().invoke(main, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    document = json.loads((tmp_path / "plan.json").read_text())
    rows = (tmp_path / "plan.csv").read_text().splitlines()
    assert document["schema"] == "boresight.plan/1"
    assert len(rows) == 1 + len(document["pointings"])
    for name, before in document["sigma_before"].items():
        assert before == pytest.approx(found.reliable_sigma[name])
        assert document["sigma_after"][name] < before


def test_a_plan_of_a_sensor_file_without_distortion_is_that_of_a_lens_that_has_some(catalogue):
    plain = calibration_scenario(1).sensor
    assert not plain.initial[list(CAMERA.parameter_names).index("a1_rad")]
    found = make_plan(plain, None, None, replace(HALF_HOUR, minutes=10.0), "A", catalogue)
    assert found.weakest_after < 0.3


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"minutes": 0.0}, "minutes"),
        ({"visits": 0}, "visits"),
        ({"start": "yesterday"}, "start_utc"),
        ({"start": "now"}, "start_utc"),
        ({"criterion": "E"}, "'E'"),
        ({"orbit": {"altitude_km": 570.0}}, "node_hour"),
        ({"sun_deg": 120.0, "moon_deg": 120.0}, "candidate"),
        ({"moon": 3.0}, "'moon'"),
    ],
)
def test_what_makes_no_plan_is_refused_by_name(given, named):
    known = {"start": "2026-10-01T00:00:00Z", "minutes": 5.0} | given
    with pytest.raises(bs.RefusedInputError, match=named):
        bs.plan(SENSOR, known.pop("start"), known.pop("minutes"), progress=False, **known)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("ra_deg,dec_deg\n1,2\n", "roll_deg"),
        ("ra_deg,dec_deg,roll_deg\n1,2,3\n1,91,3\n", "row 3"),
        ("ra_deg,dec_deg,roll_deg\n1,,3\n", "row 2"),
        ("ra_deg,dec_deg,roll_deg\n2026-01-01,2,3\n", "2026-01-01"),
        ("ra_deg,dec_deg,roll_deg\n", "0"),
    ],
)
def test_a_list_of_candidates_is_refused_with_its_row(tmp_path, text, named):
    path = tmp_path / "candidates.csv"
    path.write_text(text)
    with pytest.raises(bs.RefusedInputError, match=named):
        bs.plan(SENSOR, "2026-10-01T00:00:00Z", 5.0, candidates=path, progress=False)


def test_a_plan_chooses_among_the_attitudes_of_a_list_only(catalogue):
    few = Candidates(*np.radians([[10.0, 120.0, 200.0], [5.0, -40.0, 60.0], [0.0, 30.0, 90.0]]))
    free = replace(HALF_HOUR, orbit=None, sun_deg=0.0, moon_deg=0.0)
    plan = make_plan(SENSOR, None, few, free, "A", catalogue)
    assert {round(one.ra_deg) for one in plan.pointings} <= {10, 120, 200}


@pytest.mark.full
def test_a_plan_passes_the_gate_before_chance_and_the_paper_s_set_do():
    (row,) = pointings.measure(lambda *_: None, sensors=(6,), draws=3, sets=2)["sensors"]
    assert row["forecast"]["claimed"] == pytest.approx([1.0] * len(FREE), rel=0.1)
    assert row["plan"]["minutes"] < min(row["chance_best"]["minutes"], row["paper"]["minutes"])
    assert row["plan"]["exposures"] < min(row["chance_best"]["exposures"], row["paper"]["exposures"])
