"""Every compiled loop of estimation against plain NumPy: the clever form is proven by the naive one."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight import kernels
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import angular, singular_values
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import angular_sigma
from boresight.estimation.batch import normal_equations
from boresight.estimation.filters.angular import AllPairs
from boresight.estimation.filters.singular import SingularValues
from boresight.estimation.metrics import arc_errors, tail_rms
from boresight.estimation.singular_values import STAR_MODELS, Selection
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


def test_a_subset_of_parameters_gives_the_subset_of_the_equations_finite_on_the_principal_point():
    field = weighed(star_field(np.random.default_rng(6), frames=2), GROUND)
    some = np.array([0, 4, 7])
    whole, part = normal_equations(field, TRUTH, FREE, SCALE), normal_equations(field, TRUTH, some, SCALE[some])
    np.testing.assert_allclose(part.A, whole.A[np.ix_(some, some)], rtol=1e-12)
    np.testing.assert_allclose(part.b, whole.b[some], rtol=1e-12)
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


SUBSETS = [(1,), (2,), (3,), (1, 2), (1, 3), (2, 3), (1, 2, 3)]


def _frame(seed=1, mean_stars=9.0):
    field = star_field(np.random.default_rng(seed), frames=1, mean_stars=mean_stars)
    s, D = INVERTED_WANG.directions_and_jacobian(GROUND, field.row_px, field.col_px, field.pitch)
    return field.star_start, field.s_i, angular_sigma(INVERTED_WANG, TRUTH, field), s, D


def _plain_values(frame, selection):
    star_start, s_i, sigma, s, D = frame
    for first, last in pairwise(star_start):
        stars = slice(first, last)
        taken = singular_values.exposure(s_i[stars], sigma[stars], selection)
        z, g = singular_values.stacked(s[stars], taken.rows, selection)
        yield z - taken.z, np.einsum("rnj,njp->rp", g, D[stars]) * SCALE, taken.R


def _plain_pairs(frame):
    star_start, s_i, sigma, s, D = frame
    for first, last in pairwise(star_start):
        stars = slice(first, last)
        phi, g = angular.angles(s[stars])
        e = phi - angular.angles(s_i[stars])[0]
        yield e, np.einsum("rnj,njp->rp", g, D[stars]) * SCALE, angular.covariance(s_i[stars], sigma[stars])


def _normal(e, H, inverse):
    return H.T @ inverse @ H, H.T @ inverse @ e, e @ inverse @ e


def _same(found, expected):
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9 * np.abs(b).max())


@pytest.mark.parametrize("values", SUBSETS, ids=str)
@pytest.mark.parametrize("model", STAR_MODELS)
def test_compiled_values_slopes_and_weights_equal_the_plain_ones(model, values):
    frame, selection = _frame(), Selection(model, values)
    reference = SingularValues(selection, FREE, SCALE)
    dof = reference.whiten(*frame[:3])
    e, H = reference.rows(*frame[3:])
    expected = [np.zeros((8, 8)), np.zeros(8), 0.0]
    kept = 0
    for plain_e, plain_H, R in _plain_values(frame, selection):
        rows = singular_values.determined_rows(R)
        kept += len(rows)
        parts = _normal(plain_e[rows], plain_H[rows], np.linalg.inv(R[np.ix_(rows, rows)]))
        expected = [total + part for total, part in zip(expected, parts, strict=True)]
    assert dof == kept == len(e)
    _same(_normal(e, H, np.eye(len(e))), expected)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(STAR_MODELS), st.floats(3.0, 20.0))
def test_unwhitened_rows_equal_the_plain_ones_on_any_stars(seed, model, mean_stars):
    frame, selection = _frame(seed, mean_stars), Selection(model)
    reference = SingularValues(selection, FREE, SCALE)
    reference.whiten(*frame[:3])
    for e, H, (plain_e, plain_H, _) in zip(
        *reference.unwhitened(*frame[3:]), _plain_values(frame, selection), strict=True
    ):
        m = len(plain_e)
        np.testing.assert_allclose(e[:m], plain_e, atol=1e-12)
        np.testing.assert_allclose(H[:m], plain_H, rtol=1e-8, atol=1e-9 * np.abs(plain_H).max())


def test_an_exposure_hands_over_the_covariance_of_its_rows():
    frame = _frame(2)
    reference = SingularValues(Selection(), FREE, SCALE)
    reference.whiten(*frame[:3])
    for (e, H, R), (plain_e, plain_H, plain_R) in zip(
        reference.exposures(*frame[3:]), _plain_values(frame, Selection()), strict=True
    ):
        rows = singular_values.determined_rows(plain_R)
        np.testing.assert_allclose(e, plain_e[rows], atol=1e-12)
        np.testing.assert_allclose(H, plain_H[rows], rtol=1e-8, atol=1e-9 * np.abs(plain_H).max())
        np.testing.assert_allclose(R, plain_R[np.ix_(rows, rows)], atol=1e-9 * plain_R.max())


def test_the_determined_part_of_the_covariance_is_what_an_eigen_decomposition_keeps():
    frame = _frame(3, 7.0)
    for model in STAR_MODELS:
        for e, H, R in _plain_values(frame, Selection(model)):
            rows = singular_values.determined_rows(R)
            values = np.linalg.eigvalsh(R)
            if values[-len(rows)] < 1e-3 * values[-1]:
                continue  # a row dropped for its curvature: the two cut at different places
            by_rows = _normal(e[rows], H[rows], np.linalg.inv(R[np.ix_(rows, rows)]))
            by_values = _normal(e, H, np.linalg.pinv(R, rcond=1e-8, hermitian=True))
            # the rows beyond repeat the others to first order only: here the camera is ten sigmas off
            np.testing.assert_allclose(by_rows[0], by_values[0], atol=0.05 * np.abs(by_values[0]).max())


def test_compiled_pairs_equal_the_plain_ones():
    frame = _frame(4)
    reference = AllPairs(FREE, SCALE)
    dof = reference.whiten(*frame[:3])
    found = _normal(*reference.rows(*frame[3:]), np.eye(2 * frame[0][-1]))
    expected = [np.zeros((8, 8)), np.zeros(8), 0.0]
    for e, H, R in _plain_pairs(frame):
        parts = _normal(e, H, np.linalg.pinv(R, rcond=1e-10, hermitian=True))
        expected = [total + part for total, part in zip(expected, parts, strict=True)]
    assert dof == 2 * frame[0][-1] - 6
    _same(found, expected)


def test_a_filled_covariance_can_be_inverted_and_says_the_same():
    frame = _frame(5)
    reference = AllPairs(FREE, SCALE)
    reference.whiten(*frame[:3])
    for (e, H, R), (plain_e, plain_H, plain_R) in zip(
        reference.exposures(*frame[3:]), _plain_pairs(frame), strict=True
    ):
        assert np.linalg.cond(R) < 1e6
        assert np.linalg.matrix_rank(plain_R, 1e-10 * plain_R.max()) < len(plain_R)
        _same(
            _normal(e, H, np.linalg.inv(R)),
            _normal(plain_e, plain_H, np.linalg.pinv(plain_R, rcond=1e-10, hermitian=True)),
        )


def test_the_information_update_equals_the_covariance_form():
    rng = np.random.default_rng(6)
    e, H, z_prior, z_at = rng.normal(size=20), rng.normal(size=(20, 5)), rng.normal(size=5), rng.normal(size=5)
    root = rng.normal(size=(5, 9))
    P_prior = root @ root.T
    z, posterior, P = np.empty(5), np.empty((5, 5)), np.empty((5, 5))
    nis = kernels.information_update(np.linalg.inv(P_prior), z_prior, z_at, e, H, z, posterior, P)
    innovation, W = e + H @ (z_prior - z_at), H @ P_prior @ H.T + np.eye(20)
    K = P_prior @ H.T @ np.linalg.inv(W)
    np.testing.assert_allclose(z, z_prior - K @ innovation, rtol=1e-9)
    np.testing.assert_allclose(P, P_prior - K @ H @ P_prior, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(posterior @ P, np.eye(5), atol=1e-9)
    assert nis == pytest.approx(innovation @ np.linalg.solve(W, innovation), rel=1e-9)


def test_a_missing_centroid_makes_every_row_of_its_exposure_missing():
    frame = _frame(7)
    frame[3][0] = np.nan
    for reference in (SingularValues(Selection(), FREE, SCALE), AllPairs(FREE, SCALE)):
        reference.whiten(*frame[:3])
        assert np.isnan(reference.rows(*frame[3:])[0]).any()
