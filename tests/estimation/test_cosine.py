"""The cosine error: its sums to first order, the covariance it really has, and that arclengths beat it."""

import numpy as np

from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch, cosine
from boresight.estimation.metrics import arc_errors
from boresight.estimation.statistics.consistency import chi_square
from tests.estimation.fields import FREE, GROUND, SCALE, TRUTH, star_field, weighed

SETS = 60


def test_the_cost_is_the_sum_of_squared_cosine_errors_to_first_order():
    arcs = weighed(star_field(np.random.default_rng(1), frames=10), TRUTH)
    cost = batch.normal_equations(cosine.unweighted(arcs), TRUTH, FREE, SCALE).chi2
    squares = np.sum((np.cos(arcs.phi + arc_errors(arcs, TRUTH)) - np.cos(arcs.phi)) ** 2)
    variance = np.mean(np.sin(arcs.phi) ** 2 * (arcs.band**2).sum(axis=1))
    np.testing.assert_allclose(cost * variance, squares, rtol=5e-3)


def test_its_information_equals_the_plain_sandwich():
    field = star_field(np.random.default_rng(2), frames=3)
    sigma = arcsets.angular_sigma(INVERTED_WANG, TRUTH, field)
    arcs, _ = arcsets.whiten(field, sigma)
    worth = cosine.compute_information(arcs, TRUTH, FREE, SCALE)
    A, B = np.zeros((8, 8)), np.zeros((8, 8))
    blocks = [(slice(a, b)) for a, b in zip(arcs.star_start[:-1], arcs.star_start[1:], strict=True)]
    all_R = [arcsets.covariance(arcs.s_i[stars], sigma[stars]) for stars in blocks]
    scaled = [np.sin(arcs.phi[_arcs_of(arcs, k)]) ** 2 * np.diag(R) for k, R in enumerate(all_R)]
    variance = np.concatenate(scaled).mean()
    for k, (stars, R) in enumerate(zip(blocks, all_R, strict=True)):
        s, ds = INVERTED_WANG.directions_and_jacobian(TRUTH, arcs.row_px[stars], arcs.col_px[stars], arcs.pitch)
        i, j = arcsets.pairs(len(R) // 2 + 2).T
        phi = arcsets.arclength(s[i], s[j])
        H = -(np.einsum("ap,ap...->a...", s[j], ds[i]) + np.einsum("ap,ap...->a...", s[i], ds[j]))
        H = H / np.sin(phi)[:, None] * SCALE
        weight = np.sin(arcs.phi[_arcs_of(arcs, k)]) ** 2 / variance
        A += H.T @ (weight[:, None] * H)
        B += H.T @ (weight[:, None] * R * weight) @ H
    np.testing.assert_allclose(worth.claimed, A, rtol=1e-6, atol=1e-7 * np.abs(A).max())
    held = A @ np.linalg.solve(B, A)
    np.testing.assert_allclose(worth.held, held, rtol=1e-5, atol=1e-6 * np.abs(held).max())


def _arcs_of(arcs, k):
    return slice(2 * arcs.star_start[k] - 3 * k, 2 * arcs.star_start[k + 1] - 3 * (k + 1))


def test_its_errors_are_spread_as_the_sandwich_says_and_a_third_wider_than_those_of_arclengths():
    held, claimed, errors, errors_of_arcs = 0.0, 0.0, [], []
    for seed in range(SETS):
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
    assert chi_square(held, 8 * SETS).consistent
    assert claimed / SETS > 2 * 8
    wider = np.sqrt(np.mean(np.square(errors), axis=0) / np.mean(np.square(errors_of_arcs), axis=0))
    # 60 sets know a ratio of spreads to a tenth
    assert 1.2 < np.exp(np.mean(np.log(wider))) < 1.5


def test_no_direction_is_known_better_than_by_arclengths():
    arcs = weighed(star_field(np.random.default_rng(3), frames=30), TRUTH)
    worth, best = (
        cosine.compute_information(arcs, TRUTH, FREE, SCALE),
        batch.normal_equations(arcs, TRUTH, FREE, SCALE).A,
    )
    assert np.linalg.eigvals(np.linalg.solve(best, worth.held)).real.max() < 1 + 1e-9
