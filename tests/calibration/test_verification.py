"""Given stars are proposals: wrong ones are found, named and left out, and right ones stand."""

import math
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.matching import verification
from boresight.calibration.matching.verification import BY_NAME, BY_VOTE, compute_limit
from boresight.calibration.options import METHODS, CalibrationSettings
from boresight.calibration.problem import make_problem
from boresight.estimation.statistics.consistency import nees
from boresight.estimation.statistics.special import chdtri
from boresight.kernels.verification import verify_stars
from tests.calibration.sets import differences, field, in_memory, sky, st16, streamed, written
from tests.effort import few_of
from tests.estimation.fields import TRUTH

RNG = np.random.default_rng


def with_wrong(telemetry, share, seed, near=True):
    """Give some rows, at least one, the star of another row of their exposure, or of any; returns the set and which rows."""
    rng, n = RNG(seed), len(telemetry)
    rows = rng.choice(n, max(1, round(share * n)), replace=False)
    exposure = 2 * telemetry.frame + telemetry.exposure
    other = [
        rng.choice(np.flatnonzero((exposure == exposure[row]) if near else exposure != exposure[row])) for row in rows
    ]
    names = ("star_id", "ra_rad", "dec_rad")
    changed = {name: getattr(telemetry, name).copy() for name in names}
    for name, values in changed.items():
        values[rows] = getattr(telemetry, name)[other]
    wrong = np.zeros(n, np.bool_)
    wrong[rows] = changed["star_id"][rows] != telemetry.star_id[rows]
    return replace(telemetry, **changed), wrong


def calibrated(telemetry, catalogue, sensor=None, **settings):
    chosen = CalibrationSettings(**{"match": "given", **settings})
    with mock.patch("boresight.calibration.calibrate.evaluate_result", lambda found, *_: found):
        return calibrate(telemetry, sensor or st16(), catalogue, chosen)


def removed_rows(found, telemetry):
    rows = np.zeros(len(telemetry), np.bool_)
    rows[[one.row - telemetry.first_row for one in found.removed]] = True
    return rows


def normalised_error(found):
    names = found.covariance.names
    error = np.array([found.parameters[name] for name in names]) - TRUTH
    scale = st16().typical_sigma
    return nees(error / scale, np.array(found.covariance.matrix) / np.outer(scale, scale))


@pytest.mark.parametrize("near", [True, False])
@pytest.mark.parametrize("method", ["batch", "sqrf"])
def test_one_wrong_identity_is_named_and_the_estimate_is_that_without_it(catalogue, method, near):
    right = field(5, frames=60)
    telemetry, wrong = with_wrong(right, 0.0, 1, near)
    (row,) = np.flatnonzero(wrong)
    found = calibrated(telemetry, catalogue, method=method)
    (removed,) = found.removed
    assert (removed.row, removed.frame, removed.exposure) == (
        telemetry.first_row + row,
        telemetry.frame[row],
        telemetry.exposure[row],
    )
    assert removed.star_id == telemetry.star_id[row]
    assert removed.probability < 1e-6
    assert (found.removed_of.proposed, found.removed_of.removed) == (len(telemetry), 1)
    assert found.advice_codes[0] == "removed"
    assert found.advice[0].startswith("1 of 1,440 ")
    assert f"row {removed.row:,} (frame {removed.frame}, HIP {removed.star_id})" in found.advice[0]
    assert sum(item.count for item in found.left_out if item.what == "stars") == 1
    blank = replace(right, star_id=np.where(wrong, 0, right.star_id), ra_rad=np.where(wrong, np.nan, right.ra_rad))
    alone = calibrated(blank, catalogue, method=method)
    assert not alone.removed
    for name in found.free:
        assert abs(found.parameters[name] - alone.parameters[name]) < 0.02 * alone.sigma[name]


@pytest.mark.parametrize("sets", [pytest.param(4), pytest.param(150, marks=pytest.mark.full)])
@pytest.mark.parametrize(("share", "near"), [(0.03, True), (0.1, True), (0.1, False)])
def test_a_tenth_of_wrong_identities_leaves_an_honest_estimate(catalogue, sets, share, near):
    errors, found_of_wrong, wrongly, right = [], [], 0, 0
    for seed in range(sets):
        telemetry, wrong = with_wrong(field(seed, frames=60), share, seed, near)
        found = calibrated(telemetry, catalogue)
        removed = removed_rows(found, telemetry)
        errors.append(normalised_error(found))
        found_of_wrong.append((removed & wrong).sum() / wrong.sum())
        wrongly, right = wrongly + (removed & ~wrong).sum(), right + (~wrong).sum()
    low, high = (chdtri(8 * sets, p) / sets for p in (0.9995, 0.0005))
    assert low < np.mean(errors) < high
    assert np.mean(found_of_wrong) > 0.99
    assert wrongly < 0.002 * right


@pytest.mark.parametrize("sets", [pytest.param(6), pytest.param(400, marks=pytest.mark.full)])
def test_clean_sets_lose_fewer_than_one_star_in_ten_thousand_and_one_set_in_a_hundred_any(catalogue, sets):
    lost = [len(calibrated(field(1000 + seed, frames=40), catalogue).removed) for seed in range(sets)]
    assert sum(lost) < 1e-4 * 960 * sets + 1
    assert np.count_nonzero(lost) <= 0.01 * sets + 3 * math.sqrt(0.01 * sets)


def test_noise_that_is_stated_half_and_a_start_that_is_far_off_cost_no_star(catalogue):
    telemetry = field(3, frames=40)
    half = replace(st16(), centroid_sigma_px=st16().centroid_sigma_px / 2)
    assert not calibrated(telemetry, catalogue, half).removed
    start = st16().initial.copy()
    start[0] *= 1.3
    far = calibrated(telemetry, catalogue, replace(st16(), initial=start))
    assert far.status == "converged"
    assert not far.removed
    assert far.stars == len(telemetry)


def test_a_wrong_parity_in_the_sensor_file_refuses_no_star(catalogue):
    telemetry = field(3, frames=40, parity=-1)
    assert not calibrated(telemetry, catalogue, replace(st16(), parity=1)).removed


def test_directions_without_numbers_are_proposals_too(catalogue):
    telemetry, wrong = with_wrong(field(8, frames=40), 0.02, 2)
    found = calibrated(replace(telemetry, star_id=None), catalogue, match="rematch")
    assert (removed_rows(found, telemetry) == wrong).all()
    assert {one.star_id for one in found.removed} == {None}


@pytest.mark.parametrize("method", ["batch", "sqrf"])
def test_a_set_in_pieces_loses_the_same_stars_and_has_the_same_estimate(catalogue, tmp_path, method):
    telemetry, wrong = with_wrong(field(4, frames=60), 0.03, 3, near=False)
    path, telemetry = written(telemetry, tmp_path)
    choices = {"match": "given", "method": method}
    whole = in_memory(telemetry, st16(), catalogue, validation=telemetry, **choices)
    pieces = streamed(path, st16(), catalogue, 7, validation=telemetry, **choices)
    assert len(whole["removed"]) >= 0.99 * wrong.sum()
    assert whole["removed"] == pieces["removed"]
    assert whole["parameters"] == pieces["parameters"]
    assert not differences(
        {key: whole[key] for key in ("left_out", "evaluation", "validation", "trust")},
        {key: pieces[key] for key in ("left_out", "evaluation", "validation", "trust")},
    )


def test_matching_anew_lists_the_names_that_it_refused(catalogue):
    seen = sky(catalogue, frames=20)
    star_id = seen.true.copy()
    rows = RNG(0).choice(np.flatnonzero(star_id > 0), 5, replace=False)
    star_id[rows] = star_id[RNG(1).choice(np.flatnonzero(star_id > 0), 5, replace=False)]
    wrong = star_id != seen.true
    telemetry = replace(seen.telemetry, star_id=star_id)
    found = calibrate(telemetry, seen.sensor, catalogue, CalibrationSettings())
    listed = removed_rows(found, telemetry)
    assert listed[wrong].all()
    assert listed.sum() == found.matching.removed == found.removed_of.removed
    assert all(one.star_id == star_id[one.row - telemetry.first_row] and one.reason for one in found.removed)


def test_very_many_removed_stars_are_counted_and_the_first_are_listed(catalogue, monkeypatch):
    monkeypatch.setattr(verification, "MOST_LISTED", 3)
    telemetry, wrong = with_wrong(field(8, frames=40), 0.05, 2)
    found = calibrated(telemetry, catalogue)
    assert len(found.removed) == 3
    assert found.removed_of.removed == pytest.approx(wrong.sum(), abs=2)


def exposure_of(rng, n=9, p=4, sigma=1e-4):
    """Directions of an exposure near the z axis, seen under a small turn with errors of the parameters and noise."""
    c = rng.normal(size=(n, 3)) * 0.1 + [0, 0, 1]
    c /= np.linalg.norm(c, axis=1, keepdims=True)
    G = 1.5e-4 * rng.normal(size=(n, 3, p))
    G -= c[:, :, None] * np.einsum("na,nap->np", c, G)[:, None]
    s = c - G @ rng.normal(size=p) + sigma * rng.normal(size=(n, 3))  # s(x) of a wrong x: the truth is s + G w
    return s / np.linalg.norm(s, axis=1, keepdims=True), G, c


def brute_statistic(s, G, c, sigma, use, i):
    """t of star i from a dense fit of turn and parameters to the other stars in use, all by hand."""
    n, p = len(s), G.shape[2]
    e1 = np.cross([0.0, 1.0, 0.0], c)
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    T = np.stack([e1, np.cross(c, e1)], axis=1)
    r = np.einsum("nka,na->nk", T, s - c)
    turns = np.stack([np.cross(axis, c) for axis in np.eye(3)], axis=-1)
    H = np.concatenate([T @ turns, -T @ G], axis=2)
    prior = np.diag([0.0] * 3 + [1.0] * p)
    rest = [k for k in range(n) if use[k] and k != i]
    Lambda = prior + sum(H[k].T @ H[k] for k in rest) / sigma**2
    y = np.linalg.solve(Lambda, sum(H[k].T @ r[k] for k in rest) / sigma**2)
    innovation = r[i] - H[i] @ y
    S = sigma**2 * np.eye(2) + H[i] @ np.linalg.solve(Lambda, H[i].T)
    return innovation @ np.linalg.solve(S, innovation)


@pytest.mark.parametrize("seed", range(4))
def test_the_statistic_is_that_of_the_deleted_star_against_a_dense_fit_of_the_others(seed):
    sigma = 1e-4
    s, G, c = exposure_of(RNG(seed), sigma=sigma)
    c = c.copy()
    c[3] += [2e-3, -1e-3, 0.0]
    c /= np.linalg.norm(c, axis=1, keepdims=True)
    use, voted, t = np.zeros(9, np.bool_), np.zeros(9, np.bool_), np.empty(9)
    verify_stars(np.array([0, 9]), s, G, np.full(9, sigma), c, 4.5, compute_limit(5000), 0.0, use, voted, t)
    assert use.tolist() == [k != 3 for k in range(9)]
    brute = [brute_statistic(s, G, c, sigma, use, i) for i in range(9)]
    np.testing.assert_allclose(
        t[use], np.array(brute)[use], rtol=0.05, atol=0.02
    )  # first order about two nearby attitudes
    assert t[3] == pytest.approx(brute[3], rel=0.05)


@pytest.mark.parametrize("sets", [pytest.param(300), pytest.param(5000, marks=pytest.mark.full)])
def test_the_statistic_of_right_stars_is_chi_square_with_two_degrees_of_freedom(sets):
    sigma, values = 1e-4, []
    for seed in range(sets):
        rng = RNG([9, seed])
        s, G, c = exposure_of(rng, n=6, p=2, sigma=sigma)
        use, voted, t = np.zeros(6, np.bool_), np.zeros(6, np.bool_), np.empty(6)
        verify_stars(np.array([0, 6]), s, G, np.full(6, sigma), c, 4.5, 60.0, 0.0, use, voted, t)
        values.append(t[seed % 6])  # one star an exposure: they are independent
    below = np.sort(1 - np.exp(-np.array(values) / 2))
    distance = np.max(np.abs(below - (np.arange(sets) + 0.5) / sets))
    assert distance < 1.95 / math.sqrt(sets)  # Kolmogorov, one in a thousand


def test_arcs_without_some_rows_are_those_of_the_telemetry_without_them():
    telemetry = field(2, frames=20, stars=5)
    s_i = np.stack(
        [
            np.cos(telemetry.dec_rad) * np.cos(telemetry.ra_rad),
            np.cos(telemetry.dec_rad) * np.sin(telemetry.ra_rad),
            np.sin(telemetry.dec_rad),
        ],
        axis=-1,
    )
    arcs = make_problem(telemetry, st16(), s_i, 4).arcs
    rows = np.sort(RNG(3).choice(len(telemetry), 25, replace=False))
    blank = s_i.copy()
    blank[rows] = np.nan
    other = make_problem(telemetry, st16(), blank, 4).arcs
    without, few, _ = arcs.without(rows, 4)
    assert few == arcs.n_exposures - other.n_exposures > 0
    for name in ("frame", "frame_start", "star_start", "source_row", "row_px", "s_i"):
        np.testing.assert_array_equal(getattr(without, name), getattr(other, name))


def test_the_limit_costs_a_clean_set_in_a_hundred_a_star_and_a_small_one_less_than_one_star_in_ten_thousand():
    assert 5000 * math.exp(-compute_limit(5000) / 2) == pytest.approx(0.01)
    assert math.exp(-compute_limit(10) / 2) == pytest.approx(1e-4)


def test_a_star_of_a_far_field_is_refused_by_the_vote(catalogue):
    telemetry, wrong = with_wrong(field(8, frames=40), 0.02, 2, near=False)
    found = calibrated(telemetry, catalogue)
    assert {one.reason for one in found.removed} == {BY_VOTE}
    assert (removed_rows(found, telemetry) == wrong).all()


def named_twice(telemetry, rng, away_px):
    """Give a tenth of the exposures a detection more that bears a star of theirs, `away_px` off; returns the set and which rows."""
    exposure = 2 * telemetry.frame + telemetry.exposure
    chosen = rng.choice(np.unique(exposure), len(np.unique(exposure)) // 10, replace=False)
    of = np.array([rng.choice(np.flatnonzero(exposure == one)) for one in chosen])
    rows = np.sort(np.concatenate([np.arange(len(telemetry)), of]), kind="stable")
    second = np.append(False, np.diff(rows) == 0)
    columns = {name: values[rows] for name, values in vars(telemetry).items() if isinstance(values, np.ndarray)}
    for name, size in (
        ("row_px", st16().rows),
        ("col_px", st16().columns),
    ):  # toward the middle, so that it stays on the detector
        columns[name] = columns[name] + np.where(second, np.copysign(away_px, size / 2 - columns[name]), 0.0)
    return replace(telemetry, **columns), second


@pytest.mark.parametrize(("away_px", "reason"), [(300.0, BY_VOTE), (1.0, BY_NAME)])
def test_of_two_detections_under_one_star_the_nearer_keeps_it(catalogue, away_px, reason):
    right = field(9, frames=60)
    telemetry, second = named_twice(right, RNG(4), away_px)
    found, without = calibrated(telemetry, catalogue), calibrated(right, catalogue)
    removed = removed_rows(found, telemetry)
    exposure = 2 * telemetry.frame + telemetry.exposure
    assert removed.sum() == second.sum() == 12
    assert sorted(exposure[removed]) == sorted(exposure[second])  # one of each pair
    assert (removed & second).sum() >= 9  # so near the noise may bring the wrong one nearer
    assert reason in {one.reason for one in found.removed}
    for name in found.free:
        assert abs(found.parameters[name] - without.parameters[name]) < 0.3 * without.sigma[name]


def test_a_star_named_twice_is_found_where_it_is_in_files_too(catalogue, tmp_path):
    telemetry, _ = named_twice(field(9, frames=40), RNG(4), 1.0)
    path, whole = written(telemetry, tmp_path)
    one, other = in_memory(whole, st16(), catalogue, match="given"), streamed(path, st16(), catalogue, 7, match="given")
    assert len(one["removed"]) == 8
    assert differences(one["removed"], other["removed"]) == []


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("stars", few_of([12, 4], 1))
def test_a_set_of_wrong_identities_alone_ends_with_a_status_and_advice(catalogue, method, stars):
    telemetry, _ = with_wrong(field(3, frames=30, stars=stars), 1.0, 5, near=False)
    found = calibrated(telemetry, catalogue, method=method)
    assert found.status != "converged"
    assert found.advice


def test_exposures_that_are_all_lost_with_a_star_each_leave_too_few_stars(catalogue):
    telemetry = field(3, frames=30, stars=4)
    telemetry, _ = with_wrong(telemetry, 0.0, 1)
    last = np.arange(len(telemetry)) % 4 == 3
    wrong = replace(
        telemetry,
        ra_rad=np.where(last, np.roll(telemetry.ra_rad, 4), telemetry.ra_rad),
        dec_rad=np.where(last, np.roll(telemetry.dec_rad, 4), telemetry.dec_rad),
    )
    for method in ("batch", "sqrf"):
        found = calibrated(wrong, catalogue, method=method)
        assert found.status == "too_few_stars"
        assert len({(one.frame, one.exposure) for one in found.removed}) == len(telemetry) // 4
