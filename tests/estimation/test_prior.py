"""A Gaussian before the data: its square root, the share that is left of it, and whether data agree, by independent forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.estimation import batch
from boresight.estimation.prior import Prior
from boresight.estimation.statistics.consistency import chi_square
from tests.estimation.fields import FREE, GROUND, SCALE, star_field, whitened


def drawn(rng, n, rows=40):
    G = rng.normal(size=(rows, n))
    return G.T @ G


@given(st.integers(0, 10_000), st.integers(1, 8))
def test_root_share_and_agreement_are_those_of_the_dense_forms(seed, n):
    rng = np.random.default_rng(seed)
    A, A_0 = drawn(rng, n), drawn(rng, n)
    x_p, x_d = rng.normal(size=n), rng.normal(size=n)
    prior = Prior(x_p, np.linalg.inv(A_0))
    np.testing.assert_allclose(prior.S @ prior.S.T, prior.P, rtol=1e-9, atol=1e-12)
    assert np.array_equal(prior.S, np.triu(prior.S))
    P = np.linalg.inv(A + A_0)
    of_data = np.diag(P @ A @ P) / np.diag(P)
    np.testing.assert_allclose(prior.share(A) + of_data, 1.0, rtol=1e-9)
    chi2, dof = prior.disagreement(A, P @ (A_0 @ x_p + A @ x_d) - x_p)
    d = x_d - x_p
    assert dof == n
    assert chi2 == pytest.approx(d @ np.linalg.inv(prior.P + np.linalg.inv(A)) @ d, rel=1e-6)
    other = 2.0 * prior.P + np.eye(n)
    chi2, dof = prior.distance(A, P @ (A_0 @ x_p + A @ x_d) - x_p, other)
    assert dof == n
    assert chi2 == pytest.approx(d @ np.linalg.inv(other + np.linalg.inv(A)) @ d, rel=1e-6)


def test_a_direction_that_data_leave_open_is_no_degree_of_freedom():
    prior = Prior(np.zeros(3), np.eye(3))
    assert prior.disagreement(np.diag([4.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))[1] == 2


def test_a_fit_beside_a_prior_is_the_least_squares_problem_with_its_rows_added():
    arcs, rng = whitened(star_field(np.random.default_rng(5), frames=15), GROUND), np.random.default_rng(6)
    prior = Prior(GROUND + 0.3 * SCALE * rng.normal(size=8), np.linalg.inv(drawn(rng, 8)))
    fitted = batch.fit(arcs, GROUND, FREE, SCALE, prior=prior, rest=1e-12)
    data = batch.normal_equations(arcs, fitted.x, FREE, SCALE)
    z = (fitted.x - prior.x) / SCALE
    step = np.linalg.solve(data.A + prior.A, data.b + prior.A @ z)
    sigma = np.sqrt(np.diag(np.linalg.inv(data.A + prior.A)))
    assert np.abs(step / sigma).max() < 1e-9
    assert fitted.chi2 == data.chi2
    assert fitted.cost == pytest.approx(data.chi2 + z @ prior.A @ z, rel=1e-12)
    np.testing.assert_array_equal(fitted.A, data.A)


def test_a_prior_settles_what_data_leave_open():
    pinhole = GROUND.copy()
    pinhole[4] = 0.0
    free = np.array([0, 1, 2, 5, 6])
    arcs = whitened(star_field(np.random.default_rng(3), frames=10, noise_px=0.0, truth=pinhole), pinhole)
    alone = batch.fit(arcs, pinhole, free, SCALE[free])
    fitted = batch.fit(arcs, pinhole, free, SCALE[free], prior=Prior(pinhole, np.eye(5)))
    assert (alone.status, fitted.status) == ("rank_deficient", "converged")


def test_sets_that_agree_with_a_prior_are_said_to_as_often_as_chance_has_it():
    rng, total, n, sets = np.random.default_rng(7), 0.0, 6, 400
    A, A_0 = drawn(rng, n), drawn(rng, n)
    P, P_0 = np.linalg.inv(A + A_0), np.linalg.inv(A_0)
    for _ in range(sets):
        x_p = rng.multivariate_normal(np.zeros(n), P_0)
        x_d = rng.multivariate_normal(np.zeros(n), np.linalg.inv(A))
        total += Prior(x_p, P_0).disagreement(A, P @ (A_0 @ x_p + A @ x_d) - x_p)[0]
    assert chi_square(total, n * sets).consistent
