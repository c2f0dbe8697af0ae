"""The filters agree with one another, the batch, the textbook and their own covariance, also where they forget."""

import numpy as np
import pytest

from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.estimation import batch
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.metrics import arc_errors
from boresight.estimation.statistics.consistency import chi_square, nees
from tests.estimation.fields import (
    FREE,
    GROUND,
    SCALE,
    SIX,
    TRUTH,
    WU_START,
    WU_TRUTH,
    joined,
    star_field,
    whitened,
    whitened_plainly,
    whitened_rows,
    wu_field,
    wu_whitened,
)


def _filtered(field, method="sqrf", tuning=None, scale=10.0, pooled=True):
    field = pool_start(field, START_ARCS_PER_PARAMETER * 8) if pooled else field
    return FILTERS[method](field, start(GROUND, 8, scale), FREE, SCALE, tuning or Tuning())


@pytest.mark.parametrize("noise", [0.0, 0.02], ids=["no-q", "q"])
@pytest.mark.parametrize("linearisations", [1, 6])
@pytest.mark.parametrize("method", ["ekf", "sqrf"])
def test_every_form_of_the_extended_filter_equals_the_covariance_form(method, linearisations, noise):
    field = whitened(star_field(np.random.default_rng(11), frames=40), GROUND)
    tuning = Tuning(linearisations=linearisations, process_noise=noise)
    history, plain = _filtered(field, method, tuning), _filtered(field, "ekf", tuning)
    np.testing.assert_allclose((history.states - plain.states) / SCALE / plain.sigmas, 0, atol=1e-6)
    np.testing.assert_allclose(history.sigmas, plain.sigmas, rtol=1e-7)
    np.testing.assert_allclose(history.nis, plain.nis, rtol=1e-6)
    np.testing.assert_array_equal(history.dof, plain.dof)
    np.testing.assert_allclose(history.last.P, plain.last.P, atol=1e-8 * np.abs(plain.last.P).max())


@pytest.mark.parametrize("method", sorted(FILTERS))
def test_without_process_noise_a_filter_ends_where_the_batch_does(method):
    field = whitened(star_field(np.random.default_rng(12), frames=60), TRUTH)
    history = FILTERS[method](field, start(TRUTH, 8, 100.0), FREE, SCALE, Tuning())
    fitted = batch.fit(field, TRUTH, FREE, SCALE)
    sigma = batch.sigma_in_scale(fitted.A)
    # singular values leave out one or two of the numbers that the stars of an exposure hold, and so end a little beside
    np.testing.assert_allclose((history.last.x - fitted.x) / SCALE / sigma, 0, atol=0.4 if method == "svd" else 0.15)
    # early frames were linearised farther from the end, which moves sigmas by a few per cent
    np.testing.assert_allclose(history.sigmas[-1], sigma, rtol=0.08 if method == "svd" else 0.05)


@pytest.mark.parametrize(
    ("method", "tuning"), [("sqrf", Tuning()), ("ukf", Tuning(6, 0.02, 0.95))], ids=["sqrf", "ukf"]
)
def test_frames_in_parts_give_the_history_of_the_whole(method, tuning):
    field = whitened(star_field(np.random.default_rng(13), frames=12), TRUTH)
    run, begin = FILTERS[method], start(TRUTH, 8, 10.0)
    whole = run(field, begin, FREE, SCALE, tuning)
    first = run(field.frames(0, 5), begin, FREE, SCALE, tuning)
    second = run(field.frames(5, 12), first.last, FREE, SCALE, tuning)
    np.testing.assert_allclose(np.concatenate([first.states, second.states]), whole.states, rtol=1e-12)
    np.testing.assert_allclose(second.last.S, whole.last.S, rtol=1e-9, atol=1e-14)


def test_relinearised_the_filter_is_consistent_and_as_printed_it_is_far_over_confident():
    relinearised, printed = [], []
    for seed in range(30):
        field = whitened(star_field(np.random.default_rng(200 + seed), frames=60), GROUND)
        for tuning, pooled, errors in ((Tuning(), True, relinearised), (Tuning(linearisations=1), False, printed)):
            last = _filtered(field, tuning=tuning, pooled=pooled).last
            errors.append(nees((last.x - TRUTH) / SCALE, last.P))
    assert np.mean(relinearised) < 11  # 8 expected; R is taken at the start here, which alone costs a few per cent
    assert np.mean(printed) > 50


def test_pooling_the_first_frames_keeps_every_star_and_avoids_the_false_minimum_of_a_thin_frame():
    # 23 arcs over eight parameters, from ten sigmas off: this set has a minimum far from the truth
    fields = [whitened(star_field(np.random.default_rng(seed), frames=60), GROUND) for seed in range(60)]
    alone = [np.abs((_filtered(field, pooled=False).last.x - TRUTH) / SCALE).max() for field in fields]
    pooled = [np.abs((_filtered(field).last.x - TRUTH) / SCALE).max() for field in fields]
    assert max(alone) > 5
    assert max(pooled) < 1.5
    field = whitened(star_field(np.random.default_rng(16), frames=20), GROUND)
    pooled = pool_start(field, 160)
    assert pooled.n_stars == field.n_stars
    assert pooled.frame_start[-1] == field.frame_start[-1]
    merged = pooled.star_start[pooled.frame_start[1]]
    assert 2 * merged - 3 * pooled.frame_start[1] >= 160
    assert pooled.frame[0] == field.n_frames - pooled.n_frames


@pytest.mark.parametrize("method", sorted(FILTERS))
def test_process_noise_keeps_the_sigmas_open(method):
    field = whitened(star_field(np.random.default_rng(14), frames=80), TRUTH)
    quiet, noisy = (
        FILTERS[method](field, start(TRUTH, 8, 1.0), FREE, SCALE, Tuning(process_noise=q)).sigmas for q in (0.0, 0.05)
    )
    assert (noisy[-1] > quiet[-1]).all()
    assert (quiet[-1] < quiet[0]).all()


@pytest.mark.parametrize("method", sorted(FILTERS))
def test_a_state_that_runs_away_ends_the_history_there(method):
    field = whitened(star_field(np.random.default_rng(15), frames=6), GROUND)
    field.row_px[field.star_start[4]] = np.nan
    history = FILTERS[method](field, start(GROUND, 8, 10.0), FREE, SCALE, Tuning())
    assert not history.finite
    assert len(history.nis) == 2


SINGLE = Tuning(linearisations=1)


def _textbook(arcs, z, P, free, noise, forgetting=1.0):
    n, total = len(free), 0.0
    for k in range(arcs.n_frames):
        frame = arcs.frames(k, k + 1)
        P = P / forgetting + noise**2 * np.eye(n)
        spread = np.sqrt(n) * np.linalg.cholesky(P[::-1, ::-1])[::-1, ::-1]
        points = np.concatenate([z + spread.T, z - spread.T])
        states = np.tile(GROUND, (2 * n, 1))
        states[:, free] += points * SCALE[free]
        seen = np.array([whitened_plainly(frame, x) for x in states])
        e, d = seen.mean(axis=0), points - z
        P_ee = (seen - e).T @ (seen - e) / (2 * n) + np.eye(len(e))
        K = np.linalg.solve(P_ee, (seen - e).T @ d / (2 * n)).T
        z, P = z - K @ e, P - K @ P_ee @ K.T
        total += e @ np.linalg.solve(P_ee, e)
    return z, P, total


@pytest.mark.parametrize("free", [FREE, np.array([0, 1, 4])], ids=["all", "three"])
@pytest.mark.parametrize(("noise", "forgetting"), [(0.0, 1.0), (0.05, 1.0), (0.02, 0.9)])
def test_one_pass_is_the_textbook_filter(free, noise, forgetting):
    arcs = whitened(star_field(np.random.default_rng(1), frames=6), TRUTH)
    tuning = Tuning(linearisations=1, process_noise=noise, forgetting=forgetting)
    history = FILTERS["ukf"](arcs, start(GROUND, len(free), 5.0), free, SCALE[free], tuning)
    z, P, total = _textbook(arcs, np.zeros(len(free)), 25.0 * np.eye(len(free)), free, noise, forgetting)
    np.testing.assert_allclose(history.last.z, z, atol=1e-6)
    np.testing.assert_allclose(history.last.P, P, atol=1e-7 * np.abs(P).max())
    assert history.nis.sum() == pytest.approx(total, rel=1e-6)
    np.testing.assert_array_equal(history.linearisations, 1)


def test_near_the_truth_it_agrees_with_the_square_root_filter_and_draws_points_of_settled_frames_once():
    for seed in range(5):
        arcs = whitened(star_field(np.random.default_rng(20 + seed), frames=60), TRUTH)
        unscented, extended = (FILTERS[m](arcs, start(TRUTH, 8, 1.0), FREE, SCALE, Tuning()) for m in ("ukf", "sqrf"))
        assert np.abs((unscented.last.x - extended.last.x) / SCALE / extended.sigmas[-1]).max() < 0.1
        np.testing.assert_allclose(unscented.sigmas[-1], extended.sigmas[-1], rtol=0.03)
    arcs = whitened(star_field(np.random.default_rng(5), frames=80), TRUTH)
    passes = FILTERS["ukf"](arcs, start(TRUTH, 8, 1.0), FREE, SCALE, Tuning()).linearisations
    assert passes[0] > 1
    assert np.mean(passes[40:]) < 2.5


def test_iterated_it_is_consistent_from_a_far_start_and_in_one_pass_it_is_not():
    sets, iterated, single = 30, 0.0, []
    for seed in range(sets):
        arcs = whitened(star_field(np.random.default_rng(300 + seed), frames=60), TRUTH)
        arcs = pool_start(arcs, START_ARCS_PER_PARAMETER * 8)
        for tuning in (Tuning(), SINGLE):
            last = FILTERS["ukf"](arcs, start(GROUND, 8, 10.0), FREE, SCALE, tuning).last
            error = nees((last.x - TRUTH) / SCALE, last.P)
            if tuning is SINGLE:
                single.append(error)
            else:
                iterated += error
    assert chi_square(iterated, 8 * sets).consistent
    assert np.median(single) > 100


FOCAL = np.array([0])


def _forgotten(arcs, tuning, method="sqrf", free=FOCAL, spread=1.0):
    return FILTERS[method](arcs, start(TRUTH, len(free), spread), free, SCALE[free], tuning)


@pytest.mark.parametrize("method", sorted(FILTERS))
def test_the_information_is_the_geometric_sum_over_frames(method):
    arcs = whitened(star_field(np.random.default_rng(1), frames=60), TRUTH)
    share = 0.9
    claimed = np.linalg.inv(_forgotten(arcs, Tuning(forgetting=share), method, FREE, 0.1).last.P)
    held = 100.0 * np.eye(8) * share**60
    for k in range(60):
        frame = batch.normal_equations(arcs.frames(k, k + 1), TRUTH, FREE, SCALE)
        held += share ** (59 - k) * frame.A
    # the filter linearises where it stands, not at the truth
    assert np.linalg.eigvals(np.linalg.solve(held, claimed)).real == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("method", sorted(FILTERS))
def test_a_constant_parameter_comes_to_rest_at_the_information_of_that_many_frames(method):
    arcs = whitened(star_field(np.random.default_rng(2), frames=300), TRUTH)
    a_frame = batch.normal_equations(arcs, TRUTH, FOCAL, SCALE[FOCAL]).A[0, 0] / 300
    sigmas = _forgotten(arcs, Tuning(forgetting=0.9), method).sigmas[100:, 0]
    assert np.mean(sigmas**-2) == pytest.approx(a_frame * 10, rel=0.05)


@pytest.mark.parametrize("tuning", [Tuning(forgetting=0.97), Tuning(forgetting=0.95, process_noise=0.03)], ids=str)
def test_the_filters_agree_on_what_they_forget(tuning):
    arcs = whitened(star_field(np.random.default_rng(3), frames=50), GROUND)
    sqrf, ekf, ukf = (_forgotten(arcs, tuning, method, FREE).last for method in ("sqrf", "ekf", "ukf"))
    np.testing.assert_allclose(sqrf.P, ekf.P, atol=1e-8 * np.abs(ekf.P).max())
    sigma = np.sqrt(np.diag(ekf.P))
    np.testing.assert_allclose((sqrf.z - ekf.z) / sigma, 0, atol=1e-6)
    np.testing.assert_allclose((ukf.z - ekf.z) / sigma, 0, atol=0.25)


def test_errors_are_spread_as_least_squares_with_fading_weights_has_them():
    # a frame m frames old weighs lambda^m, so the error variance is (1 - lambda) / (1 + lambda) frames and the claim 1 - lambda
    share, squares = 0.8, []
    for seed in range(25):
        arcs = whitened(star_field(np.random.default_rng(40 + seed), frames=120), TRUTH)
        history = _forgotten(arcs, Tuning(forgetting=share))
        errors = (history.states[39::20, 0] - TRUTH[0]) / SCALE[0] / history.sigmas[39::20, 0]
        squares.append(np.mean(errors**2))
    spread = np.mean(squares)
    # 125 nearly independent errors: their mean square is known to 13 % (one sigma)
    assert spread == pytest.approx(1 / (1 + share), rel=0.4)


@pytest.mark.parametrize(
    "tuning", [Tuning(process_noise=0.03), Tuning(forgetting=0.9)], ids=["small process noise", "forgetting"]
)
@pytest.mark.parametrize("method", sorted(FILTERS))
def test_a_drifting_focal_length_is_followed_and_lags_where_nothing_is_forgotten(method, tuning):
    frames, a_frame = 120, 0.02 * SCALE[0]
    parts = []
    for k in range(frames):
        truth = TRUTH.copy()
        truth[0] += k * a_frame
        parts.append(whitened(star_field(np.random.default_rng([7, k]), frames=1, truth=truth), truth))
    arcs = joined(parts)
    end = TRUTH[0] + (frames - 1) * a_frame
    follows, lags = (_forgotten(arcs, choice, method) for choice in (tuning, Tuning()))
    assert abs(follows.last.x[0] - end) / SCALE[0] < 5 * follows.sigmas[-1, 0]
    assert abs(lags.last.x[0] - end) / SCALE[0] > 10 * lags.sigmas[-1, 0]


WU_SCALE = np.array([1e-3, 1e-4, 10.0, 10.0, 0.1, 0.5])


def test_the_rows_of_the_arcs_are_the_slopes_of_the_arcs():
    field = wu_whitened(wu_field(np.random.default_rng(1), frames=3), WU_TRUTH)
    band = np.zeros_like(field.band)
    band[:, 4] = 1.0
    e, H = whitened_rows(field, WU_TRUTH, SIX, WU_SCALE, band)
    np.testing.assert_allclose(e, arc_errors(field, WU_TRUTH), atol=1e-15)
    for p in SIX:
        step = np.zeros(6)
        step[p] = 1e-3 * WU_SCALE[p]
        slope = (arc_errors(field, WU_TRUTH + step) - arc_errors(field, WU_TRUTH - step)) / 2e-3
        np.testing.assert_allclose(H[:, p], slope, atol=1e-6 * np.abs(slope).max())


def test_errors_of_the_batch_are_spread_as_its_covariance_says_and_residuals_as_R_says():
    sets, total_nees, total_chi2, dof = 40, 0.0, 0.0, 0
    for seed in range(sets):
        field = wu_field(np.random.default_rng(500 + seed), frames=40)
        first = batch.fit(wu_whitened(field, WU_START), WU_START, SIX, WU_SCALE)
        field = wu_whitened(field, first.x)
        fitted = batch.fit(field, first.x, SIX, WU_SCALE)
        assert fitted.status == "converged"
        total_nees += nees((fitted.x - WU_TRUTH) / WU_SCALE, np.linalg.inv(fitted.A))
        total_chi2 += fitted.chi2
        dof += field.n_arcs - 6
    assert chi_square(total_nees, 6 * sets).consistent
    assert chi_square(total_chi2, dof).consistent


@pytest.mark.few(2)
@pytest.mark.parametrize("method", ["ekf", "sqrf", "ukf"])
def test_a_filter_ends_where_the_batch_does(method):
    field = wu_whitened(wu_field(np.random.default_rng(2), frames=60), WU_TRUTH)
    history = FILTERS[method](field, start(WU_TRUTH, 6, 10.0), SIX, WU_SCALE, Tuning())
    fitted = batch.fit(field, WU_TRUTH, SIX, WU_SCALE)
    sigma = batch.sigma_in_scale(fitted.A)
    np.testing.assert_allclose((history.last.x - fitted.x) / WU_SCALE / sigma, 0, atol=0.15)
    np.testing.assert_allclose(history.sigmas[-1], sigma, rtol=0.05)


@pytest.mark.parametrize("method", ["sqrf", "ukf"])
def test_a_filter_from_the_papers_start_is_as_uncertain_as_it_says(method):
    sets, total = 20, 0.0
    for seed in range(sets):
        field = wu_field(np.random.default_rng(700 + seed), frames=40)
        pooled = pool_start(wu_whitened(field, WU_TRUTH), START_ARCS_PER_PARAMETER * 6)
        last = FILTERS[method](pooled, start(WU_START, 6, 10.0), SIX, WU_SCALE, Tuning()).last
        total += nees((last.x - WU_TRUTH) / WU_SCALE, last.P)
    assert chi_square(total, 6 * sets).consistent


def test_a_start_under_which_the_stars_have_no_direction_is_called_diverged():
    field = wu_whitened(wu_field(np.random.default_rng(3), frames=5), WU_TRUTH)
    blind = WU_TRUTH.copy()
    blind[4] = -50.0
    assert batch.fit(field, blind, SIX, WU_SCALE).status == "diverged"


@pytest.mark.parametrize("method", ["angular", "ekf", "sqrf", "svd"])
def test_state_step_and_errors_belong_together_also_where_no_halving_helps(method):
    finite = 0
    for seed in (0, 1, 5, 6, 11, 13):
        x_0 = TRUTH + 300 * SCALE * np.random.default_rng(seed).normal(size=8)  # every step from there overshoots
        field = whitened(star_field(np.random.default_rng(seed), frames=1, mean_stars=4), TRUTH)
        begin = start(x_0, 8, 100.0)
        history = FILTERS[method](field, begin, FREE, SCALE, Tuning(linearisations=1))
        if not history.finite:
            continue
        finite += 1
        last = history.last
        np.testing.assert_allclose((last.x - x_0) / SCALE, last.z - begin.z, rtol=1e-6, atol=1e-5)
        e = arc_errors(field, last.x)
        assert history.sum_of_squares[-1] == pytest.approx(float(e @ e), rel=1e-9)
    assert finite
