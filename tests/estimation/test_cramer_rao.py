"""The bound of the centroids against forms that share nothing with it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import batch
from boresight.estimation.statistics.cramer_rao import centroid_rows
from tests.estimation.fields import FREE, PITCH, SCALE, TRUTH, star_field, weighed


def _projected(x, turn, s_d):
    return np.ravel(np.stack(INVERTED_WANG.project(x, Rotation.from_rotvec(turn).apply(s_d), PITCH), axis=-1))


def _numeric_information(field):
    total = np.zeros((8, 8))
    for first, last in zip(field.star_start[:-1], field.star_start[1:], strict=True):
        s_d = INVERTED_WANG.directions(TRUTH, field.row_px[first:last], field.col_px[first:last], PITCH)
        columns = []
        for p in range(8):
            step = np.zeros(8)
            step[p] = 1e-3 * SCALE[p]
            both = (_projected(TRUTH + step, np.zeros(3), s_d), _projected(TRUTH - step, np.zeros(3), s_d))
            columns.append((both[0] - both[1]) / 2e-3)
        columns += [(_projected(TRUTH, axis, s_d) - _projected(TRUTH, -axis, s_d)) / 2e-6 for axis in np.eye(3) * 1e-6]
        D = np.array(columns).T / np.repeat(field.sigma_px[first:last], 2)[:, None]
        F = D.T @ D
        total += F[:8, :8] - F[:8, 8:] @ np.linalg.solve(F[8:, 8:], F[8:, :8])
    return total


def test_information_is_that_of_the_projection_with_attitude_eliminated():
    field = star_field(np.random.default_rng(1), frames=6)
    found = centroid_rows(INVERTED_WANG, TRUTH, field, FREE, SCALE).information
    plain = _numeric_information(field)
    root = np.sqrt(np.diag(plain))
    np.testing.assert_allclose(found / np.outer(root, root), plain / np.outer(root, root), atol=2e-5)


def test_arcs_hold_what_the_centroids_hold():
    field = weighed(star_field(np.random.default_rng(2), frames=40), TRUTH)
    bound = np.linalg.inv(centroid_rows(INVERTED_WANG, TRUTH, field, FREE, SCALE).information)
    claimed = np.linalg.inv(batch.normal_equations(field, TRUTH, FREE, SCALE).A)
    np.testing.assert_allclose(np.sqrt(np.diag(claimed) / np.diag(bound)), 1, atol=0.02)


def test_fewer_free_parameters_and_fewer_stars_hold_their_part():
    field = star_field(np.random.default_rng(3), frames=5)
    whole = centroid_rows(INVERTED_WANG, TRUTH, field, FREE, SCALE)
    some = centroid_rows(INVERTED_WANG, TRUTH, field, FREE[[0, 4]], SCALE[[0, 4]])
    kept = np.ones(field.n_stars, bool)
    kept[field.star_start[:-1]] = False
    without = centroid_rows(INVERTED_WANG, TRUTH, field, FREE, SCALE, kept)
    np.testing.assert_allclose(some.information, whole.information[np.ix_([0, 4], [0, 4])], rtol=1e-9)
    assert (np.trace(without.N, axis1=1, axis2=2) > np.trace(whole.N, axis1=1, axis2=2)).all()


def test_attitude_covariance_is_the_spread_of_attitudes_fitted_to_noisy_stars():
    field = star_field(np.random.default_rng(4), frames=1, noise_px=0.437)
    rows = centroid_rows(INVERTED_WANG, TRUTH, field, FREE, SCALE)
    rng = np.random.default_rng(5)
    K = rows.K[: field.star_start[1]].reshape(-1, 3)
    drawn = np.linalg.lstsq(K, rng.normal(size=(len(K), 4000)), rcond=None)[0]
    np.testing.assert_allclose(
        np.cov(drawn) / np.sqrt(np.outer(*[np.diag(rows.N[0])] * 2)), _correlation(rows.N[0]), atol=0.08
    )
    assert np.sqrt(np.trace(rows.N[0])) == pytest.approx(np.sqrt(np.trace(np.cov(drawn))), rel=0.05)


def _correlation(P):
    return P / np.sqrt(np.outer(np.diag(P), np.diag(P)))
