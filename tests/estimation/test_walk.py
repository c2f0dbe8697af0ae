"""Drift between passes by maximum likelihood: the dense restricted likelihood, without bias, and as often inside as it says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.estimation.batch import NormalEquations
from boresight.estimation.block_bordered import Regressed
from boresight.estimation.walk import LEAST, WalkedPasses, find_walk, link_by_walk
from tests.effort import effort

N, OWN = 4, np.array([0, 2])


def drawn(rng, sigma, days, rows=8):
    """Passes whose parameters OWN walk: rows, residuals, their normal equations, all taken at zero."""
    K = len(days) + 1
    steps = np.sqrt(days)[:, None] * sigma * rng.normal(size=(K - 1, len(OWN)))
    z = np.tile(rng.normal(size=N), (K, 1))
    z[1:, OWN] += np.cumsum(steps, axis=0)
    H = rng.normal(size=(K, rows, N))
    e = rng.normal(size=(K, rows)) - np.einsum("kri,ki->kr", H, z)
    return H, e, [NormalEquations(h.T @ h, h.T @ r, float(r @ r), 0.0) for h, r in zip(H, e, strict=True)]


def walked(sums, days, z=None, **of):
    return WalkedPasses(sums, np.zeros((len(sums), N)) if z is None else z, OWN, days, **of)


def dense_problem(H, days, sigma, columns):
    """The coefficients of what is free, and the covariance of the pieces with the steps as noise."""
    K, rows, _ = H.shape
    X = H.reshape(-1, N) if columns is None else np.concatenate([h @ b for h, b in zip(H, columns, strict=True)])
    V = np.eye(K * rows)
    for k in range(1, K):
        J = np.zeros((K, rows, len(OWN)))
        J[k:] = H[k:, :, OWN]
        J = J.reshape(-1, len(OWN))
        V += J @ np.diag(days[k - 1] * sigma**2) @ J.T
    return X, V


def dense_doubt(H, e, days, sigma, columns=None):
    """-2 log of the restricted likelihood: steps as noise, the first state and the coefficients of columns as free."""
    (X, V), y = dense_problem(H, days, sigma, columns), e.ravel()
    inverse = np.linalg.inv(V)
    inner = X.T @ inverse @ X
    rest = inverse - inverse @ X @ np.linalg.solve(inner, X.T @ inverse)
    return np.linalg.slogdet(V)[1] + np.linalg.slogdet(inner)[1] + y @ rest @ y


@given(st.integers(0, 10_000), st.integers(2, 6))
def test_the_likelihood_is_the_dense_restricted_one(seed, K):
    rng = np.random.default_rng(seed)
    days = rng.uniform(0.1, 30.0, K - 1)
    H, e, sums = drawn(rng, np.array([0.2, 0.5]), days)
    one, two = rng.uniform(0.01, 2.0, (2, 2))
    passes = walked(sums, days)
    ours = passes.doubt(one) - passes.doubt(two)
    assert ours == pytest.approx(dense_doubt(H, e, days, one) - dense_doubt(H, e, days, two), rel=1e-9, abs=1e-9)


def with_steps(sums, days, sigma, trend, stepped):
    """The same by the sweep that fits, and a step as a column of its own."""
    link = link_by_walk(OWN, days, sigma, trend, stepped)
    found = link.solve(sums, np.zeros((len(sums), N)))
    return found.log_determinant - found.decrement - np.log(link.W[1:][link.W[1:] > 0.0]).sum()


@given(st.integers(0, 10_000), st.integers(5, 9))
def test_about_a_trend_and_with_steps_it_is_the_dense_one_and_the_one_of_the_sweep(seed, K):
    rng = np.random.default_rng(seed)
    days = rng.uniform(0.1, 30.0, K - 1)
    H, e, sums = drawn(rng, np.array([0.2, 0.5]), days)
    trend = Regressed(np.array([0, 2, 2]), rng.normal(size=(K, 3)))
    one, two = rng.uniform(0.01, 2.0, (2, 2))
    passes, columns = walked(sums, days, trend=trend), trend.design(N)
    ours = passes.doubt(one) - passes.doubt(two)
    theirs = dense_doubt(H, e, days, one, columns) - dense_doubt(H, e, days, two, columns)
    assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-9)
    stepped = np.zeros((K - 1, 2), bool)
    stepped[2, 1] = True
    passes = walked(sums, days, trend=trend, stepped=stepped)
    ours = passes.doubt(one) - passes.doubt(two)
    assert ours == pytest.approx(
        with_steps(sums, days, one, trend, stepped) - with_steps(sums, days, two, trend, stepped), rel=1e-9, abs=1e-9
    )


@given(st.integers(0, 10_000), st.integers(5, 9))
def test_what_a_step_takes_from_chi_square_is_what_a_fit_with_it_takes(seed, K):
    rng = np.random.default_rng(seed)
    days, sigma, at = rng.uniform(0.1, 30.0, K - 1), rng.uniform(0.01, 2.0, 2), np.zeros((K, N))
    _, _, sums = drawn(rng, np.array([0.2, 0.5]), days)
    trend = Regressed(np.array([0, 2]), rng.normal(size=(K, 2)))
    falls, sizes = walked(sums, days, trend=trend).step_falls(sigma)
    without = link_by_walk(OWN, days, sigma, trend).solve(sums, at)
    for gap in range(K - 1):
        for j, place in enumerate(OWN):
            step = (np.arange(K) > gap).astype(float)[:, None]
            more = Regressed(np.append(trend.of, place), np.concatenate([trend.values, step], axis=1))
            found = link_by_walk(OWN, days, sigma, more).solve(sums, at)
            assert falls[gap, j] == pytest.approx(found.decrement - without.decrement, rel=1e-6, abs=1e-9)
            assert sizes[gap, j] == pytest.approx(found.slope[-1], rel=1e-6)


def test_a_direction_that_all_passes_leave_open_is_no_likelihood():
    seen = [NormalEquations(np.diag([1.0, 1.0, 0.0, 1.0]), np.ones(N), 0.0, 0.0)] * 3
    assert walked(seen, np.ones(2)).doubt(np.array([0.1, 0.1])) == np.inf


def test_where_the_sums_were_taken_does_not_matter():
    rng = np.random.default_rng(5)
    days = np.full(5, 2.0)
    H, e, sums = drawn(rng, np.array([0.2, 0.5]), days)
    z = rng.normal(size=(6, N))
    z[:, [1, 3]] = z[0, [1, 3]]
    moved = e + np.einsum("kri,ki->kr", H, z)
    elsewhere = [NormalEquations(h.T @ h, h.T @ r, float(r @ r), 0.0) for h, r in zip(H, moved, strict=True)]
    gaps = [
        walked(sums, days).doubt(s)
        + sum(one.chi2 for one in sums)
        - walked(elsewhere, days, z).doubt(s)
        - sum(one.chi2 for one in elsewhere)
        for s in (np.array([0.1, 0.1]), np.array([0.7, 0.3]))
    ]
    assert gaps == pytest.approx([0.0, 0.0], abs=1e-7)


@pytest.mark.full
def test_a_drift_is_found_without_bias_and_lies_in_its_intervals_as_often_as_they_say():
    truth, days, sets = np.array([0.15, 0.4]), np.full(29, 1.5), effort(40, 200)
    logs, inside = [], {1.0: [], 3.841458820694124: []}
    for seed in range(sets):
        _, _, sums = drawn(np.random.default_rng(seed), truth, days)
        for rise, hits in inside.items():
            found = find_walk(walked(sums, days), rise)
            hits.append((found.low <= truth) & (truth <= found.high))
        logs.append(np.log(found.sigma / truth))
    spread = np.std(logs, axis=0)
    assert (np.abs(np.mean(logs, axis=0)) < 0.2 * spread + 3.0 * spread / np.sqrt(sets)).all()
    for share, hits in zip((0.683, 0.95), inside.values(), strict=True):
        n = 2 * sets
        assert np.mean(hits) == pytest.approx(share, abs=0.04 + 3.0 * np.sqrt(share * (1 - share) / n))


def test_what_does_not_move_has_an_interval_that_begins_at_zero():
    days, begins = np.full(19, 1.0), []
    for seed in range(20):
        _, _, sums = drawn(np.random.default_rng(seed), np.array([0.0, 0.5]), days)
        found = find_walk(walked(sums, days))
        begins.append(found.low == 0.0)
        assert found.sigma[1] > 10 * LEAST
    # one-sided: 0.975 of the sets at least
    assert np.mean(begins, axis=0)[0] >= 0.8
    assert np.mean(begins, axis=0)[1] == 0.0


@given(st.integers(0, 10_000), st.integers(5, 9))
def test_the_deviance_is_the_dense_likelihood_at_the_best_first_state_and_border(seed, K):
    rng = np.random.default_rng(seed)
    days = rng.uniform(0.1, 30.0, K - 1)
    H, e, sums = drawn(rng, np.array([0.2, 0.5]), days)
    trend = Regressed(np.array([0, 2]), rng.normal(size=(K, 2)))
    total = sum(one.chi2 for one in sums)
    for columns, about in ((None, None), (trend.design(N), trend)):
        sigma = rng.uniform(0.01, 2.0, 2)
        ours = walked(sums, days, trend=about).deviance(sigma) + total
        assert ours == pytest.approx(dense_deviance(H, e, days, sigma, columns), rel=1e-9, abs=1e-9)


def dense_deviance(H, e, days, sigma, columns):
    (X, V), y = dense_problem(H, days, sigma, columns), e.ravel()
    inverse = np.linalg.inv(V)
    left = y - X @ np.linalg.solve(X.T @ inverse @ X, X.T @ inverse @ y)
    return np.linalg.slogdet(V)[1] + left @ inverse @ left
