"""Drift between passes by maximum likelihood: the dense restricted likelihood, without bias, and as often inside as it says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.estimation.batch import NormalEquations
from boresight.estimation.walk import LEAST, doubt, find_walk
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


def dense_doubt(H, e, days, sigma):
    """-2 log of the restricted likelihood: steps as noise, the first state as free."""
    K, rows, _ = H.shape
    X, y = H.reshape(-1, N), e.ravel()
    V = np.eye(len(y))
    for k in range(1, K):
        J = np.zeros((K, rows, len(OWN)))
        J[k:] = H[k:, :, OWN]
        J = J.reshape(-1, len(OWN))
        V += J @ np.diag(days[k - 1] * sigma**2) @ J.T
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
    ours = doubt(sums, np.zeros((K, N)), OWN, days, one) - doubt(sums, np.zeros((K, N)), OWN, days, two)
    assert ours == pytest.approx(dense_doubt(H, e, days, one) - dense_doubt(H, e, days, two), rel=1e-7, abs=1e-7)


def test_where_the_sums_were_taken_does_not_matter():
    rng = np.random.default_rng(5)
    days = np.full(5, 2.0)
    H, e, sums = drawn(rng, np.array([0.2, 0.5]), days)
    z = rng.normal(size=(6, N))
    z[:, [1, 3]] = z[0, [1, 3]]
    moved = e + np.einsum("kri,ki->kr", H, z)
    elsewhere = [NormalEquations(h.T @ h, h.T @ r, float(r @ r), 0.0) for h, r in zip(H, moved, strict=True)]
    gaps = [
        doubt(sums, np.zeros((6, N)), OWN, days, s)
        + sum(one.chi2 for one in sums)
        - doubt(elsewhere, z, OWN, days, s)
        - sum(one.chi2 for one in elsewhere)
        for s in (np.array([0.1, 0.1]), np.array([0.7, 0.3]))
    ]
    assert gaps == pytest.approx([0.0, 0.0], abs=1e-7)


def test_a_drift_is_found_without_bias_and_lies_in_its_intervals_as_often_as_they_say():
    truth, days, sets = np.array([0.15, 0.4]), np.full(29, 1.5), effort(40, 200)
    logs, inside = [], {1.0: [], 3.841458820694124: []}
    for seed in range(sets):
        _, _, sums = drawn(np.random.default_rng(seed), truth, days)
        for rise, hits in inside.items():
            found = find_walk(sums, np.zeros((30, N)), OWN, days, rise)
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
        found = find_walk(sums, np.zeros((20, N)), OWN, days)
        begins.append(found.low == 0.0)
        assert found.sigma[1] > 10 * LEAST
    # one-sided: 0.975 of the sets at least
    assert np.mean(begins, axis=0)[0] >= 0.8
    assert np.mean(begins, axis=0)[1] == 0.0
