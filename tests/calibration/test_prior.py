"""A calibration that starts from a former one: prior and new data are the joint problem, what both hold counts once."""

import json
from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import parse_calibration
from boresight.calibration.joint.passes import NamedTelemetry, join_sets
from boresight.calibration.joint.prior import PriorSource
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.calibration.result import trend_entry
from boresight.errors import RefusedInputError
from boresight.estimation import batch
from boresight.estimation.prior import Prior
from boresight.estimation.statistics.consistency import chi_square, nees
from tests.calibration.conftest import telemetry
from tests.calibration.test_joint import a_pass, together
from tests.estimation.fields import FREE, GROUND, SCALE, TRUTH, star_field, whitened
from tests.refusals import has_code

NOISE = {"prior_covariance": "noise"}


def run(sets, sensor, catalogue, prior=None, sha256s=None, **settings):
    chosen = CalibrationSettings(**{"match": "given", **settings})
    return calibrate(sets, sensor, catalogue, chosen, prior=prior, sha256s=sha256s)


@pytest.fixture(scope="module")
def first_set():
    return a_pass(21, day=0.0, frames=60)


@pytest.fixture
def former(first_set, sensor, catalogue):
    return run(join_sets([NamedTelemetry(first_set, "first.csv", "aa")]), sensor, catalogue)


def in_order(found):
    return np.array([found.parameters[name] for name in found.free]), np.array(found.covariance)


def apart(one, other):
    """Largest distance of two calibrations, sigmas of the second."""
    (x, _), (y, P) = in_order(one), in_order(other)
    return np.abs((x - y) / np.sqrt(np.diag(P))).max()


@pytest.mark.parametrize("method", ["batch", "sqrf", "ekf"])
def test_a_prior_and_new_data_are_the_joint_problem_of_both(former, first_set, sensor, catalogue, method):
    new = a_pass(22, day=30.0, frames=60)
    both = run(together(first_set, new), sensor, catalogue)
    found = run(new, sensor, catalogue, PriorSource(former), method=method, **NOISE)
    assert found.status == "converged"
    assert apart(found, both) < 0.15  # what the first set's curvature changes between its optimum and the joint one
    sigma, joint = (np.sqrt(np.diag(in_order(one)[1])) for one in (found, both))
    np.testing.assert_allclose(sigma, joint, rtol=0.05)
    assert 0.3 < np.mean([found.prior.share[name] for name in found.free]) < 0.7


def test_the_joint_problem_is_reached_exactly_when_the_prior_is_linearised_where_it_ends():
    """The first set's quadratic, taken at the joint optimum, leaves that optimum where it is."""
    one, other = (whitened(star_field(np.random.default_rng(seed), frames=40), GROUND) for seed in (31, 32))
    x = GROUND
    for _ in range(20):  # the same as a fit of both: each round one Newton step of the first, the second to its end
        seen = batch.normal_equations(one, x, FREE, SCALE)
        mean = x - SCALE * np.linalg.solve(seen.A, seen.b)
        x = batch.fit(other, x, FREE, SCALE, prior=Prior(mean, np.linalg.inv(seen.A)), rest=1e-12).x
    total = [batch.normal_equations(arcs, x, FREE, SCALE) for arcs in (one, other)]
    A, b = total[0].A + total[1].A, total[0].b + total[1].b
    step = np.linalg.solve(A, b) / np.sqrt(np.diag(np.linalg.inv(A)))
    assert np.abs(step).max() < 1e-9


def test_priors_in_a_row_know_as_much_as_all_data_at_once(former, sensor, catalogue):
    found, sets = former, []
    for seed in (41, 42, 43):
        sets.append(a_pass(seed, frames=30))
        source = PriorSource(parse_calibration(json.dumps(found.to_dict())), "former.json", "ff")
        found = run(sets[-1], sensor, catalogue, source, {"telemetry": str(seed)}, **NOISE)
    alone = run(together(*sets), sensor, catalogue)
    assert all(found.sigma[name] < alone.sigma[name] for name in found.free)
    assert found.prior.telemetry_sha256s == ["41", "42", "aa"]
    with pytest.raises(RefusedInputError, check=has_code("prior-holds-telemetry")):
        run(a_pass(9), sensor, catalogue, PriorSource(found), {"telemetry": "aa"})


def test_what_the_prior_holds_counts_once_in_a_joint_run_too(former, first_set, sensor, catalogue):
    new = a_pass(22, day=30.0)
    sets = [NamedTelemetry(first_set, "again.csv", "aa"), NamedTelemetry(new, "new.csv", "bb")]
    found = run(join_sets(sets), sensor, catalogue, PriorSource(former))
    alone = run(new, sensor, catalogue, PriorSource(former))
    assert found.parameters == alone.parameters
    assert [one.name for one in found.inputs.passes] == ["new.csv"]
    assert any("Not used" in one and "again.csv" in one for one in found.advice)
    with pytest.raises(RefusedInputError, check=has_code("prior-used-validation")):
        run(new, sensor, catalogue, PriorSource(former), {"validation": "aa"})


def test_a_prior_ages_by_its_times_and_inflates_and_fades(former, sensor, catalogue):
    new = a_pass(22, day=30.0)
    shares = []
    for settings in (
        {},
        {"prior_inflation": 3.0},
        {"prior_drift_sigma": 0.1},
        {"prior_drift_sigma": 0.1, "prior_age_days": 3e4},
    ):
        found = run(new, sensor, catalogue, PriorSource(former), **settings)
        shares.append(np.mean(list(found.prior.share.values())))
    assert shares == sorted(shares, reverse=True)
    aged = run(new, sensor, catalogue, PriorSource(former), prior_drift_sigma=0.1, **NOISE).prior
    assert aged.age_days == pytest.approx(30.0, abs=0.01)
    sigma = np.array([former.sigma[name] for name in former.free])
    expected = np.hypot(sigma, 0.1 * np.sqrt(aged.age_days) * SCALE)
    np.testing.assert_allclose(list(aged.sigma.values()), expected, rtol=1e-9)


def test_a_prior_of_later_stars_ages_as_much_as_one_of_earlier_stars(former, sensor, catalogue):
    """It ended at day 0; a camera that walks is as far from it 30 days before as 30 days after."""
    ages = [
        run(a_pass(22, day=day), sensor, catalogue, PriorSource(former), prior_drift_sigma=0.1).prior.age_days
        for day in (30.0, -30.0)
    ]
    np.testing.assert_allclose(ages, 30.0, atol=0.01)


def test_data_that_a_prior_holds_under_another_name_are_told_and_others_are_not(former, first_set, sensor, catalogue):
    """The SHA-256 is of a file; the same stars in another file differ from the prior by nothing, which chance does not do."""
    again = replace(first_set, row_px=np.round(first_set.row_px, 3), time_utc=None)
    for settings in (NOISE, {"prior_inflation": 3.0}, {"method": "sqrf"}):
        found = run(again, sensor, catalogue, PriorSource(former), {"telemetry": "bb"}, **settings)
        assert any("twice" in sentence for sentence in found.advice), settings
    for seed in range(70, 76):
        found = run(a_pass(seed, frames=60), sensor, catalogue, PriorSource(former), {"telemetry": "bb"}, **NOISE)
        assert not any("twice" in sentence for sentence in found.advice)


def test_data_within_the_times_of_a_prior_are_said_to_be(former, sensor, catalogue):
    within, after = (run(a_pass(22, day=day), sensor, catalogue, PriorSource(former)) for day in (0.0, 1.0))
    assert any("within the times of the prior" in sentence for sentence in within.advice)
    assert not any("within the times of the prior" in sentence for sentence in after.advice)


def test_a_camera_that_changed_since_is_said_to_contradict_the_prior(former, sensor, catalogue):
    moved = TRUTH.copy()
    moved[0] += 3e-6
    found = run(telemetry(23, truth=moved), sensor, catalogue, PriorSource(former))
    assert found.prior.agreement.p_value < 1e-6
    assert "prior_contradicted" in found.advice_codes
    same = run(telemetry(24), sensor, catalogue, PriorSource(former))
    assert same.prior.agreement.p_value > 1e-3


def test_a_filter_that_forgets_does_not_say_how_much_is_left_and_a_trend_leaves_either_out(former, sensor, catalogue):
    found = run(a_pass(22), sensor, catalogue, PriorSource(former), method="sqrf", variant="q")
    assert set(found.prior.share.values()) == {None}
    plain = run(a_pass(22), sensor, catalogue, PriorSource(former))
    assert "prior" in trend_entry(plain).left_out
    assert trend_entry(former).left_out is None


def test_results_without_a_prior_have_no_word_of_one(sensor, catalogue):
    document = run(a_pass(22), sensor, catalogue).to_dict()
    assert "prior" not in document
    assert "passes" not in document["inputs"]


@pytest.mark.parametrize(
    ("change", "settings", "said"),
    [
        ({"camera_model": "pinhole_radial"}, {}, "camera model pinhole_radial"),
        ({"sensor": "ST-9"}, {}, "of the sensor ST-9"),
        ({"status": "rank_deficient"}, {}, "ended rank deficient"),
        ({}, {"free": ("f_m",)}, "this run frees f_m. Give --free"),
        ({}, {"error": "cosine"}, "choose error 'arclength'"),
        ({}, {"prior_age_days": 3.0}, "give --prior-drift-sigma"),
    ],
)
def test_a_prior_that_cannot_be_used_is_refused(former, sensor, catalogue, change, settings, said):
    with pytest.raises(RefusedInputError, match=said):
        run(a_pass(22), sensor, catalogue, PriorSource(replace(former, **change)), **settings)


def test_a_prior_of_another_camera_is_refused_as_that_where_it_holds_the_telemetry_too(former, sensor, catalogue):
    other = PriorSource(replace(former, camera_model="pinhole_radial"), held=frozenset({"aa"}))
    with pytest.raises(RefusedInputError, match="camera model pinhole_radial"):
        run(a_pass(22), sensor, catalogue, other, {"telemetry": "aa"})


def test_an_age_that_nothing_tells_is_asked_for_and_settings_of_a_prior_need_one(former, sensor, catalogue):
    with pytest.raises(RefusedInputError, match="give --prior-age-days"):
        run(a_pass(22), sensor, catalogue, PriorSource(former), prior_drift_sigma=0.1)
    with pytest.raises(RefusedInputError, match="--prior-inflation"):
        run(a_pass(22), sensor, catalogue, prior_inflation=2.0)


def test_errors_after_a_prior_are_spread_as_its_covariance_says(sensor, catalogue):
    total, sets = 0.0, 100
    for seed in range(sets):
        arcs = [build_problem(telemetry(1000 + 2 * seed + k, frames=30), sensor, catalogue).arcs for k in range(2)]
        first = batch.fit(whitened(arcs[0], TRUTH), TRUTH, FREE, SCALE)
        prior = Prior(first.x, np.linalg.inv(first.A))
        fitted = batch.fit(whitened(arcs[1], TRUTH), first.x, FREE, SCALE, prior=prior)
        total += nees((fitted.x - TRUTH) / SCALE, np.linalg.inv(fitted.A + prior.A))
    assert chi_square(total, 8 * sets).consistent
