"""Every compiled loop against plain NumPy: the clever form is proven by the naive one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight import kernels
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import arcs as arcsets
from boresight.estimation.batch import normal_equations
from boresight.estimation.metrics import arc_errors, tail_rms
from tests.estimation.fields import FREE, GROUND, PITCH, SCALE, TRUTH, star_field, weighed


def _plain_exposure(field, k, x, sigma):
    stars = slice(field.star_start[k], field.star_start[k + 1])
    s, ds = INVERTED_WANG.directions_and_jacobian(x, field.row_px[stars], field.col_px[stars], PITCH)
    pair = arcsets.pairs(stars.stop - stars.start)
    i, j = pair.T
    measured = arcsets.arclength(s[i], s[j])
    e = measured - arcsets.arclength(field.s_i[stars][i], field.s_i[stars][j])
    H = -(np.einsum("ai,aip->ap", s[j], ds[i]) + np.einsum("ai,aip->ap", s[i], ds[j])) / np.sin(measured)[:, None]
    return e, H, arcsets.covariance(field.s_i[stars], sigma[stars])


@pytest.mark.parametrize("x", [GROUND, TRUTH], ids=["ground", "truth"])
def test_the_fused_normal_equations_equal_the_plain_weighted_sums(x):
    field = star_field(np.random.default_rng(5), frames=3)
    sigma = arcsets.angular_sigma(INVERTED_WANG, x, field)
    field, _ = arcsets.whiten(field, sigma)
    fused = normal_equations(field, x, FREE, SCALE)
    A, b, chi2, total = np.zeros((8, 8)), np.zeros(8), 0.0, 0.0
    for k in range(field.n_exposures):
        e, H, R = _plain_exposure(field, k, x, sigma)
        H = H * SCALE
        A += H.T @ np.linalg.solve(R, H)
        b += H.T @ np.linalg.solve(R, e)
        chi2 += e @ np.linalg.solve(R, e)
        total += e @ e
    np.testing.assert_allclose(fused.A, A, rtol=1e-8, atol=1e-10 * np.abs(A).max())
    np.testing.assert_allclose(fused.b, b, rtol=1e-7, atol=1e-9 * np.abs(b).max())
    np.testing.assert_allclose([fused.chi2, fused.sum_of_squares], [chi2, total], rtol=1e-8)


def test_a_subset_of_parameters_gives_the_subset_of_the_normal_equations():
    field = weighed(star_field(np.random.default_rng(6), frames=2), GROUND)
    some = np.array([0, 4, 7])
    whole, part = normal_equations(field, TRUTH, FREE, SCALE), normal_equations(field, TRUTH, some, SCALE[some])
    np.testing.assert_allclose(part.A, whole.A[np.ix_(some, some)], rtol=1e-12)
    np.testing.assert_allclose(part.b, whole.b[some], rtol=1e-12)


def test_a_star_on_the_principal_point_gives_finite_derivatives():
    field = star_field(np.random.default_rng(7), frames=1)
    field.row_px[0], field.col_px[0] = GROUND[1], GROUND[2]
    equations = normal_equations(weighed(field, GROUND), GROUND, FREE, SCALE)
    assert equations.finite()


def test_arc_errors_and_their_sums_equal_the_plain_form():
    field = weighed(star_field(np.random.default_rng(9), frames=2), GROUND)
    sigma = arcsets.angular_sigma(INVERTED_WANG, GROUND, field)
    errors = arc_errors(field, TRUTH)
    plain = np.concatenate([_plain_exposure(field, k, TRUTH, sigma)[0] for k in range(field.n_exposures)])
    np.testing.assert_allclose(errors, plain, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(tail_rms(field, np.stack([TRUTH])), np.sqrt(np.mean(plain**2)), rtol=1e-9)


def _padded(values):
    padded = np.zeros((8,) * values.ndim, order="F")
    padded[tuple(slice(0, n) for n in values.shape)] = values
    return padded


def _random_upper(rng, n, spread):
    S = np.triu(rng.normal(size=(n, n)))
    S[np.diag_indices(n)] = 10.0 ** rng.uniform(-spread, spread, n)
    return S


@given(n=st.integers(1, 8), seed=st.integers(0, 2**32 - 1), spread=st.floats(0, 3))
@settings(deadline=None)
def test_carlsons_update_equals_the_covariance_update(n, seed, spread):
    rng = np.random.default_rng(seed)
    S, h, z, innovation = _random_upper(rng, n, spread), rng.normal(size=n), rng.normal(size=n), rng.normal()
    P = S @ S.T
    alpha = 1 + h @ P @ h
    K = P @ h / alpha
    expected_z, expected_P = z - K * innovation, P - np.outer(K, K) * alpha
    z, S, h = _padded(z), _padded(S), _padded(h)
    nis = kernels.carlson_update(z, S, h, innovation, np.empty(8), np.empty(8))
    assert not z[n:].any()
    assert not S[n:].any()
    z, S = z[:n], S[:n, :n]
    np.testing.assert_allclose(z, expected_z, rtol=1e-9, atol=1e-9 * np.abs(K * innovation).max())
    np.testing.assert_allclose(S @ S.T, expected_P, atol=1e-9 * np.abs(P).max())
    assert nis == pytest.approx(innovation**2 / alpha, rel=1e-12)
    assert not np.tril(S, -1).any()


def test_carlsons_update_leaves_a_zero_covariance_alone():
    S, z = np.zeros((8, 8), order="F"), np.ones(8)
    kernels.carlson_update(z, S, np.ones(8), 5.0, np.empty(8), np.empty(8))
    np.testing.assert_array_equal(z, np.ones(8))
    np.testing.assert_array_equal(S, np.zeros((8, 8)))


@given(n=st.integers(1, 8), seed=st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_inflation_refactors_P_plus_Q_and_stays_triangular(n, seed):
    rng = np.random.default_rng(seed)
    S, q = _random_upper(rng, n, 1), np.abs(rng.normal(size=n))
    P = S @ S.T
    kernels.inflate(S, q, np.empty((n, n)))
    np.testing.assert_allclose(S @ S.T, P + np.diag(q**2), rtol=1e-10, atol=1e-12 * np.abs(P).max())
    assert not np.tril(S, -1).any()


@pytest.mark.parametrize("x", [GROUND, TRUTH], ids=["ground", "truth"])
def test_the_compiled_rays_and_their_derivatives_equal_the_plain_ones(x):
    row, col = np.random.default_rng(10).uniform(0, 1900, (2, 50))
    s, D = np.empty((50, 3)), np.empty((50, 3, 8))
    kernels.rays_and_jacobians(INVERTED_WANG.kernel, x, PITCH, row, col, s, D)
    expected_s, expected_D = INVERTED_WANG.directions_and_jacobian(x, row, col, PITCH)
    np.testing.assert_allclose(s, expected_s, rtol=1e-13, atol=1e-15)
    size = np.abs(expected_D).max(axis=(0, 1))
    np.testing.assert_allclose(D / size, expected_D / size, atol=1e-13)
