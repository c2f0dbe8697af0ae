"""Parameters of a pass: the sweep over passes is the dense stacked problem, whatever joins them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.estimation.batch import NormalEquations
from boresight.estimation.block_bordered import Linked, Regressed


def drawn(rng, K, n, rows=30):
    """Rows of each pass, their residuals, and the normal equations of both."""
    H, e = rng.normal(size=(K, rows, n)), rng.normal(size=(K, rows))
    return H, e, [NormalEquations(h.T @ h, h.T @ r, float(r @ r), 0.0) for h, r in zip(H, e, strict=True)]


def dense(H, e, B, links=(), residuals=()):
    """Least squares over all rows at once: steps and covariances of every pass; B (K, n, n_all) picks its parameters."""
    J = np.concatenate([*(h @ b for h, b in zip(H, B, strict=True)), *links])
    right = np.concatenate([*e, *residuals])
    d, *_ = np.linalg.lstsq(J, -right, rcond=None)
    P = np.linalg.inv(J.T @ J)
    return np.array([b @ d for b in B]), np.array([b @ P @ b.T for b in B]), d, P


def picked(K, n, own):
    shared = np.setdiff1d(np.arange(n), own)
    B = np.zeros((K, n, len(shared) + K * len(own)))
    B[:, shared, np.arange(len(shared))] = 1.0
    for k in range(K):
        B[k, own, len(shared) + k * len(own) + np.arange(len(own))] = 1.0
    return B


def within_1e_9_sigma(found, step, P):
    sigma = np.sqrt(np.einsum("kii->ki", P))
    assert np.abs((found.step - step) / sigma).max() < 1e-9
    np.testing.assert_allclose(found.P, P, rtol=1e-8, atol=1e-9 * np.abs(P).max())


@given(st.integers(0, 10_000), st.integers(1, 7), st.integers(1, 4), st.booleans())
def test_passes_and_walks_are_the_stacked_problem(seed, K, m, walks):
    rng, n = np.random.default_rng(seed), 5
    own = np.sort(rng.permutation(n)[:m])
    H, e, sums = drawn(rng, K, n)
    z = np.zeros((K, n))
    z[:, own] = rng.normal(size=(K, m))
    W = rng.uniform(0.1, 50.0, (K, m)) if walks else np.zeros((K, m))
    W[0] = 0.0
    B = picked(K, n, own)
    links = [np.sqrt(W[k])[:, None] * (B[k, own] - B[k - 1, own]) for k in range(1, K)]
    residuals = [np.sqrt(W[k]) * (z[k, own] - z[k - 1, own]) for k in range(1, K)]
    step, P, _, _ = dense(H, e, B, links, residuals)
    found = Linked(own, W).solve(sums, z)
    within_1e_9_sigma(found, step, P)
    assert Linked(own, W).cost(z) == pytest.approx(sum(float(r @ r) for r in residuals))


@given(st.integers(0, 10_000), st.integers(3, 7), st.integers(1, 4))
def test_a_walk_about_a_line_is_the_stacked_problem(seed, K, m):
    rng, n = np.random.default_rng(seed), 5
    own = np.sort(rng.permutation(n)[:m])
    H, e, sums = drawn(rng, K, n)
    z = np.zeros((K, n))
    z[:, own] = rng.normal(size=(K, m))
    W = rng.uniform(0.1, 50.0, (K, m))
    W[0] = 0.0
    t = np.cumsum(rng.uniform(0.5, 2.0, K))
    B = picked(K, n, own)
    n_all = B.shape[2]
    B = np.concatenate([B, np.zeros((K, n, m))], axis=2)
    slopes = np.eye(n_all + m)[n_all:]
    links = [np.sqrt(W[k])[:, None] * (B[k, own] - B[k - 1, own] - (t[k] - t[k - 1]) * slopes) for k in range(1, K)]
    residuals = [np.sqrt(W[k]) * (z[k, own] - z[k - 1, own]) for k in range(1, K)]
    step, P, d, all_P = dense(H, e, B, links, residuals)
    link = Linked(own, W, Regressed(own, np.tile(t[:, None], (1, m))))
    found = link.solve(sums, z)
    within_1e_9_sigma(found, step, P)
    np.testing.assert_allclose(found.slope, d[n_all:], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.slope_covariance, all_P[n_all:, n_all:], rtol=1e-6)
    there = z + found.step
    moved = [
        NormalEquations(one.A, one.b + one.A @ d_k, 0.0, 0.0) for one, d_k in zip(sums, found.step, strict=True)
    ]  # at rest nothing pulls, and the line stays
    again = link.solve(moved, there)
    assert again.decrement < 1e-15 * max(found.decrement, 1.0)
    np.testing.assert_allclose(again.slope, found.slope, rtol=1e-6, atol=1e-9)
    left = there[:, own] - t[:, None] * found.slope
    assert link.cost(there) == pytest.approx(float(np.sum(W[1:] * np.diff(left, axis=0) ** 2)), rel=1e-6)


@given(st.integers(0, 10_000), st.integers(2, 6), st.integers(1, 3))
def test_a_regression_is_the_stacked_problem(seed, K, m):
    rng, n = np.random.default_rng(seed), 4
    own = np.sort(rng.permutation(n)[:m])
    H, e, sums = drawn(rng, K, n)
    t = rng.uniform(-20.0, 20.0, K)
    t[1] = t[0] + 5.0
    B = np.concatenate([np.tile(np.eye(n), (K, 1, 1)), t[:, None, None] * np.eye(n)[:, own]], axis=2)
    step, P, d, all_P = dense(H, e, B)
    found = Regressed(own, np.tile(t[:, None], (1, m))).solve(sums, np.zeros((K, n)))
    within_1e_9_sigma(found, step, P)
    np.testing.assert_allclose(found.slope, d[n:], rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(found.slope_covariance, all_P[n:, n:], rtol=1e-7)


def test_a_walk_without_noise_is_a_constant_and_one_without_bound_is_each_pass_by_itself():
    rng, own = np.random.default_rng(3), np.array([1, 3])
    _, _, sums = drawn(rng, 4, 5)
    z = np.zeros((4, 5))
    stiff, free = (Linked(own, np.array([[0.0, 0.0], *3 * [[w, w]]])).solve(sums, z) for w in (1e9, 1e-12))
    A, b = sum(one.A for one in sums), sum(one.b for one in sums)
    np.testing.assert_allclose(stiff.step, np.tile(-np.linalg.solve(A, b), (4, 1)), atol=1e-6)
    np.testing.assert_allclose(free.step, Linked(own, np.zeros((4, 2))).solve(sums, z).step, atol=1e-9)


def test_an_open_direction_is_no_solution():
    nothing = NormalEquations(np.zeros((2, 2)), np.zeros(2), 0.0, 0.0)
    seen = NormalEquations(np.eye(2), np.ones(2), 0.0, 0.0)
    with pytest.raises(np.linalg.LinAlgError):
        Linked(np.array([0]), np.zeros((2, 1))).solve([seen, nothing], np.zeros((2, 2)))
    walked = Linked(np.array([0]), np.array([[0.0], [1.0]])).solve([seen, nothing], np.zeros((2, 2)))
    assert walked.P[1, 0, 0] == pytest.approx(walked.P[0, 0, 0] + 1.0)
