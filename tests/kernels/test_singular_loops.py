"""The compiled loops of the singular values and of all pairs against plain NumPy, on random stars of either camera."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight import kernels
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import angular, singular_values
from boresight.estimation.arcs import angular_sigma
from boresight.estimation.filters.angular import AllPairs
from boresight.estimation.filters.singular import SingularValues
from boresight.estimation.singular_values import STAR_MODELS, Selection
from tests.estimation.fields import FREE, GROUND, SCALE, TRUTH, star_field

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
    dof = reference.weigh(*frame[:3])
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
    reference.weigh(*frame[:3])
    for e, H, (plain_e, plain_H, _) in zip(
        *reference.unwhitened(*frame[3:]), _plain_values(frame, selection), strict=True
    ):
        m = len(plain_e)
        np.testing.assert_allclose(e[:m], plain_e, atol=1e-12)
        np.testing.assert_allclose(H[:m], plain_H, rtol=1e-8, atol=1e-9 * np.abs(plain_H).max())


def test_an_exposure_hands_over_the_covariance_of_its_rows():
    frame = _frame(2)
    reference = SingularValues(Selection(), FREE, SCALE)
    reference.weigh(*frame[:3])
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
    dof = reference.weigh(*frame[:3])
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
    reference.weigh(*frame[:3])
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
        reference.weigh(*frame[:3])
        assert np.isnan(reference.rows(*frame[3:])[0]).any()
