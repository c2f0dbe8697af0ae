"""The batch estimator finds the truth with the spread it claims; Huber's loss and the cosine error beside it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares

from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.errors import CancelledError
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch, cosine
from boresight.estimation.metrics import arc_errors
from boresight.estimation.robust import measure_huber_effect
from boresight.estimation.statistics.consistency import chi_square, nees
from tests.estimation.fields import FREE, GROUND, SCALE, TRUTH, star_field, weighed, whitened_plainly, whitened_rows


def test_the_fit_agrees_with_scipy_on_the_same_whitened_residuals():
    field = weighed(star_field(np.random.default_rng(2), frames=20), GROUND)

    peer = least_squares(
        lambda z: whitened_plainly(field, GROUND + z * SCALE), np.zeros(8), method="lm", xtol=1e-12, ftol=1e-12
    )
    fitted = batch.fit(field, GROUND, FREE, SCALE)

    sigma = batch.sigma_in_scale(fitted.A)
    np.testing.assert_allclose((fitted.x - GROUND) / SCALE / sigma, peer.x / sigma, atol=1e-3)
    assert fitted.chi2 == pytest.approx(2 * peer.cost, rel=1e-8)


def test_errors_are_spread_as_the_covariance_says_and_residuals_as_R_says():
    seeds = 40
    total_nees, total_chi2, dof = 0.0, 0.0, 0
    for seed in range(seeds):
        field = star_field(np.random.default_rng(100 + seed), frames=50)
        first = batch.fit(weighed(field, GROUND), GROUND, FREE, SCALE)
        fitted = batch.fit(weighed(field, first.x), first.x, FREE, SCALE)
        total_nees += nees((fitted.x - TRUTH) / SCALE, np.linalg.inv(fitted.A))
        total_chi2 += fitted.chi2
        dof += weighed(field, first.x).n_arcs - 8
    # 95 % bounds; the seeds are fixed, so this passes or fails for ever
    assert chi_square(total_nees, 8 * seeds).consistent
    assert chi_square(total_chi2, dof).consistent


def test_the_principal_point_without_distortion_or_tilt_is_called_rank_deficient():
    pinhole = GROUND.copy()
    pinhole[4] = 0.0
    field = weighed(star_field(np.random.default_rng(3), frames=10, noise_px=0.0, truth=pinhole), pinhole)
    free = np.array([0, 1, 2, 5, 6])  # f, m0, n0, a1, a2: at b2 = b4 = 0 (m0, a2) and (n0, a1) are pure rotations
    fitted = batch.fit(field, pinhole, free, SCALE[free])
    assert fitted.status == "rank_deficient"
    assert fitted.rank == 3
    sigma = batch.sigma_in_scale(fitted.A)
    assert np.isfinite(sigma[0])
    assert np.isinf(sigma[1:]).all()


def test_without_noise_the_fit_ends_on_the_truth_and_from_zero_distortion_reaches_it():
    exact = weighed(star_field(np.random.default_rng(1), frames=20, noise_px=0.0), GROUND)
    fitted = batch.fit(exact, GROUND, FREE, SCALE)
    assert fitted.status == "converged"
    np.testing.assert_allclose((fitted.x - TRUTH) / SCALE, 0, atol=1e-5)
    nominal = np.array([0.016, 972.0, 1296.0, 0, 0, 0, 0, 1.0])
    fitted = batch.fit(weighed(star_field(np.random.default_rng(4), frames=100), nominal), nominal, FREE, SCALE)
    assert fitted.status == "converged"
    assert nees((fitted.x - TRUTH) / SCALE, np.linalg.inv(fitted.A)) < 40


def test_costs_never_rise_and_a_fit_says_when_it_diverged_had_too_few_iterations_or_was_stopped():
    absurd = GROUND.copy()
    absurd[3] = np.inf  # rays do not exist
    field = weighed(star_field(np.random.default_rng(7), frames=30), GROUND)
    costs = [step.chi2 for step in batch.fit(field, GROUND, FREE, SCALE).steps]
    assert all(after <= before * (1 + 1e-12) for before, after in pairwise(costs))
    assert batch.fit(field, absurd, FREE, SCALE).status == "diverged"
    assert batch.fit(field, GROUND, FREE, SCALE, max_iterations=1).status == "max_iterations"
    with pytest.raises(CancelledError, match="Stopped as asked"):
        batch.fit(field, GROUND, FREE, SCALE, cancelled=lambda: True)


HUBER = 1.345
SETS = 40


def _soiled(field, rng, share=0.02):
    wrong = rng.uniform(size=field.n_stars) < share
    off = 20.0 * rng.normal(size=(2, field.n_stars)) * wrong
    return replace(field, row_px=field.row_px + off[0], col_px=field.col_px + off[1])


def _fitted_twice(field, threshold):
    first = batch.fit(weighed(field, GROUND), GROUND, FREE, SCALE, threshold=threshold)
    return batch.fit(weighed(field, first.x), first.x, FREE, SCALE, threshold=threshold)


def _nees(fitted):
    return nees((fitted.x - TRUTH) / SCALE, np.linalg.inv(fitted.A))


def test_the_fused_equations_are_hubers_and_the_cost_falls_along_their_gradient():
    arcs = weighed(star_field(np.random.default_rng(1), frames=5), TRUTH)
    x = TRUTH + 0.1 * SCALE
    fused = batch.normal_equations(arcs, x, FREE, SCALE, HUBER)
    e, H = whitened_rows(arcs, x, FREE, SCALE)
    beyond = np.abs(e) > HUBER
    assert 0 < beyond.sum() < len(e)
    w = np.where(beyond, HUBER / np.abs(e), 1.0)
    np.testing.assert_allclose(fused.A, H.T @ (w[:, None] * H), rtol=1e-9, atol=1e-9 * np.abs(fused.A).max())
    np.testing.assert_allclose(fused.b, H.T @ np.clip(e, -HUBER, HUBER), rtol=1e-9, atol=1e-9 * np.abs(fused.b).max())
    assert fused.chi2 == pytest.approx(np.where(beyond, 2 * HUBER * np.abs(e) - HUBER**2, e**2).sum())
    arcs = weighed(star_field(np.random.default_rng(2), frames=5), TRUTH)
    x, step = TRUTH + 0.1 * SCALE, 1e-5
    slope = 2 * batch.normal_equations(arcs, x, FREE, SCALE, HUBER).b
    for p in range(8):
        ahead, behind = (x + side * step * SCALE * (np.arange(8) == p) for side in (1, -1))
        costs = [batch.normal_equations(arcs, at, FREE, SCALE, HUBER).chi2 for at in (ahead, behind)]
        assert (costs[0] - costs[1]) / (2 * step) == pytest.approx(slope[p], rel=1e-4, abs=1e-3 * np.abs(slope).max())


def test_an_infinite_threshold_is_least_squares_and_one_below_every_arc_leaves_no_information():
    field = weighed(star_field(np.random.default_rng(3), frames=20), GROUND)
    plain, wide = batch.fit(field, GROUND, FREE, SCALE), batch.fit(field, GROUND, FREE, SCALE, threshold=1e9)
    np.testing.assert_allclose(wide.x, plain.x, rtol=1e-12)
    assert wide.beyond == 0
    # the noise's size is measured, not taken from the file, so information differs by what chi-square differs from 1
    n = field.n_arcs
    np.testing.assert_allclose(wide.A, plain.A * (n - 8) / plain.chi2, rtol=1e-9)
    arcs = weighed(star_field(np.random.default_rng(4), frames=2), GROUND)
    far = GROUND.copy()
    far[0] *= 10
    paid = measure_huber_effect(arcs, far, 8, 1e-6)
    assert paid.beyond == arcs.n_arcs
    assert paid.information_share == 0


def test_under_gaussian_noise_sigmas_stay_honest_and_cost_a_fortieth():
    total, beyond, widened = 0.0, 0.0, []
    for seed in range(SETS):
        field = star_field(np.random.default_rng(1000 + seed), frames=50)
        robust, plain = _fitted_twice(field, HUBER), _fitted_twice(field, np.inf)
        total += _nees(robust)
        beyond += robust.beyond / weighed(field, GROUND).n_arcs / SETS
        widened.append(batch.sigma_in_scale(robust.A) / batch.sigma_in_scale(plain.A))
    assert chi_square(total, 8 * SETS).consistent
    assert beyond == pytest.approx(0.1786, abs=0.005)  # 2 (1 - Phi(1.345))
    assert np.mean(widened) == pytest.approx(1.026, abs=0.01)


def test_with_two_stars_in_a_hundred_wrong_it_stays_near_the_truth_and_least_squares_does_not():
    robust, plain = 0.0, []
    for seed in range(SETS):
        rng = np.random.default_rng(1000 + seed)
        field = _soiled(star_field(rng, frames=50), rng)
        robust += _nees(_fitted_twice(field, HUBER))
        plain.append(_nees(_fitted_twice(field, np.inf)))
    assert chi_square(robust, 8 * SETS).consistent
    assert np.median(plain) > 100


COSINE_SETS = 60


def test_the_cosine_cost_is_the_sum_of_squares_to_first_order_and_knows_nothing_better_than_arclengths():
    arcs = weighed(star_field(np.random.default_rng(1), frames=10), TRUTH)
    cost = batch.normal_equations(cosine.unweighted(arcs), TRUTH, FREE, SCALE).chi2
    squares = np.sum((np.cos(arcs.phi + arc_errors(arcs, TRUTH)) - np.cos(arcs.phi)) ** 2)
    variance = np.mean(np.sin(arcs.phi) ** 2 * (arcs.band**2).sum(axis=1))
    np.testing.assert_allclose(cost * variance, squares, rtol=5e-3)
    arcs = weighed(star_field(np.random.default_rng(3), frames=30), TRUTH)
    worth, best = (
        cosine.compute_information(arcs, TRUTH, FREE, SCALE),
        batch.normal_equations(arcs, TRUTH, FREE, SCALE).A,
    )
    assert np.linalg.eigvals(np.linalg.solve(best, worth.held)).real.max() < 1 + 1e-9


def test_its_information_equals_the_plain_sandwich():
    field = star_field(np.random.default_rng(2), frames=3)
    sigma = arcsets.angular_sigma(INVERTED_WANG, TRUTH, field)
    arcs, _ = arcsets.whiten(field, sigma)
    worth = cosine.compute_information(arcs, TRUTH, FREE, SCALE)
    A, B = np.zeros((8, 8)), np.zeros((8, 8))
    blocks = [slice(a, b) for a, b in pairwise(arcs.star_start)]
    arc_start = 2 * arcs.star_start - 3 * np.arange(len(arcs.star_start))
    of_arcs = [slice(a, b) for a, b in pairwise(arc_start)]
    all_R = [arcsets.covariance(arcs.s_i[stars], sigma[stars]) for stars in blocks]
    scaled = [np.sin(arcs.phi[of_arcs[k]]) ** 2 * np.diag(R) for k, R in enumerate(all_R)]
    variance = np.concatenate(scaled).mean()
    for k, (stars, R) in enumerate(zip(blocks, all_R, strict=True)):
        s, ds = INVERTED_WANG.directions_and_jacobian(TRUTH, arcs.row_px[stars], arcs.col_px[stars], arcs.pitch)
        i, j = arcsets.pairs(len(R) // 2 + 2).T
        phi = arcsets.arclength(s[i], s[j])
        H = -(np.einsum("ap,ap...->a...", s[j], ds[i]) + np.einsum("ap,ap...->a...", s[i], ds[j]))
        H = H / np.sin(phi)[:, None] * SCALE
        weight = np.sin(arcs.phi[of_arcs[k]]) ** 2 / variance
        A += H.T @ (weight[:, None] * H)
        B += H.T @ (weight[:, None] * R * weight) @ H
    np.testing.assert_allclose(worth.claimed, A, rtol=1e-6, atol=1e-7 * np.abs(A).max())
    held = A @ np.linalg.solve(B, A)
    np.testing.assert_allclose(worth.held, held, rtol=1e-5, atol=1e-6 * np.abs(held).max())


def test_its_errors_are_spread_as_the_sandwich_says_and_a_third_wider_than_those_of_arclengths():
    held, claimed, errors, errors_of_arcs = 0.0, 0.0, [], []
    for seed in range(COSINE_SETS):
        field = star_field(np.random.default_rng(1000 + seed), frames=50)
        first = batch.fit(cosine.unweighted(weighed(field, GROUND)), GROUND, FREE, SCALE)
        arcs = weighed(field, first.x)
        fitted = batch.fit(cosine.unweighted(arcs), first.x, FREE, SCALE)
        worth = cosine.compute_information(arcs, fitted.x, FREE, SCALE)
        error = (fitted.x - TRUTH) / SCALE
        held += error @ worth.held @ error
        claimed += error @ worth.claimed @ error
        errors.append(error)
        errors_of_arcs.append((batch.fit(arcs, first.x, FREE, SCALE).x - TRUTH) / SCALE)
    assert chi_square(held, 8 * COSINE_SETS).consistent
    assert claimed / COSINE_SETS > 2 * 8
    wider = np.sqrt(np.mean(np.square(errors), axis=0) / np.mean(np.square(errors_of_arcs), axis=0))
    # 60 sets know a ratio of spreads to a tenth
    assert 1.2 < np.exp(np.mean(np.log(wider))) < 1.5
