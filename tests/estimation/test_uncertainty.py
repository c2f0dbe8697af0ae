"""What a covariance means on the detector, against parameters drawn from it, and the bound of the centroids."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import batch
from boresight.estimation.arcs import arclength
from boresight.estimation.statistics.cramer_rao import centroid_rows
from boresight.estimation.statistics.uncertainty import (
    AZIMUTHS,
    _arcs_from,
    arc_sigma,
    difference_over_detector,
    displacement_px,
    expected_difference,
    radial_difference,
)
from tests.estimation.fields import COLUMNS, FREE, PITCH, ROWS, SCALE, TRUTH, star_field, weighed

DETECTOR = (ROWS, COLUMNS, PITCH)
LENGTH = np.radians(5.0)
PLACES = (np.array([0.0, 100.0, 970.0, 1943.0]), np.array([0.0, 2400.0, 1300.0, 1200.0]))


@pytest.fixture(scope="module")
def P():
    field = weighed(star_field(np.random.default_rng(31), frames=30), TRUTH)
    return np.linalg.inv(batch.normal_equations(field, TRUTH, FREE, SCALE).A) * np.outer(SCALE, SCALE)


def _drawn(P, n, seed=1):
    return np.random.default_rng(seed).multivariate_normal(TRUTH, P, size=n, method="cholesky")


def test_the_error_of_an_arc_is_the_spread_of_that_arc_over_drawn_parameters(P):
    near, far, on = _arcs_from(INVERTED_WANG, TRUTH, PLACES, LENGTH, DETECTOR)
    arcs = np.array(
        [
            arclength(INVERTED_WANG.directions(x, *near, PITCH), INVERTED_WANG.directions(x, *far, PITCH))
            for x in _drawn(P, 3000)
        ]
    )
    variance = np.where(on, arcs.var(axis=0), np.nan).reshape(-1, AZIMUTHS)
    sigma = arc_sigma(INVERTED_WANG, TRUTH, P, PLACES, LENGTH, DETECTOR)
    np.testing.assert_allclose(sigma, np.sqrt(np.nanmean(variance, axis=1)), rtol=0.05)
    np.testing.assert_allclose(arcs.mean(axis=0)[on], LENGTH, atol=1e-5)


def test_arcs_that_end_off_the_detector_do_not_count(P):
    _, far, on = _arcs_from(INVERTED_WANG, TRUTH, PLACES, LENGTH, DETECTOR)
    counts = on.reshape(-1, AZIMUTHS).sum(axis=1)
    assert (counts >= 2).all()
    assert counts[2] == AZIMUTHS
    assert counts[0] < AZIMUTHS / 2
    assert (far[0][on] >= -0.5).all()
    assert (far[0][on] <= ROWS - 0.5).all()
    assert np.isnan(arc_sigma(INVERTED_WANG, TRUTH, P, PLACES, np.radians(40.0), DETECTOR)).all()


def test_a_bulk_rotation_of_the_detector_is_no_difference():
    moved = TRUTH.copy()
    moved[4] = moved[3] = moved[5] = moved[6] = 0.0
    turned = moved.copy()
    turned[1] += 3.0
    turned[6] += 3.0 * PITCH / turned[0]  # the tilt that follows the principal point: all but a rotation
    difference = difference_over_detector(INVERTED_WANG, moved, turned, PLACES, PITCH)
    seen = INVERTED_WANG.directions(moved, *PLACES, PITCH) - INVERTED_WANG.directions(turned, *PLACES, PITCH)
    assert np.linalg.norm(seen, axis=-1).min() > 3e-4
    assert difference.max() < 2e-6
    assert difference_over_detector(INVERTED_WANG, TRUTH, TRUTH, PLACES, PITCH).max() < 1e-14


def test_the_expected_difference_is_the_mean_square_of_differences_drawn(P):
    places = tuple(np.meshgrid(np.linspace(0, ROWS - 1, 5), np.linspace(0, COLUMNS - 1, 5), indexing="ij"))
    places = (places[0].ravel(), places[1].ravel())
    drawn = [difference_over_detector(INVERTED_WANG, x, TRUTH, places, PITCH) for x in _drawn(P, 2000, 2)]
    expected = expected_difference(INVERTED_WANG, TRUTH, P, places, PITCH)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(drawn), axis=0)), expected, rtol=0.08)


def test_displacements_of_two_states_differ_by_the_radial_difference_and_a_pinhole_has_none(P):
    radius, moved = np.linspace(0, 1600, 9), TRUTH * 1.001
    old, new = (displacement_px(INVERTED_WANG, x, TRUTH, radius, PITCH) for x in (TRUTH, moved))
    between = radial_difference(INVERTED_WANG, moved, TRUTH, P, radius, PITCH)
    assert new - old == pytest.approx(between.difference_px, abs=1e-9)
    pinhole = TRUTH.copy()
    pinhole[3] = pinhole[4] = 0.0
    assert displacement_px(INVERTED_WANG, pinhole, pinhole, radius, PITCH) == pytest.approx(0, abs=1e-9)


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


def test_information_is_that_of_the_projection_with_attitude_eliminated_and_arcs_hold_it():
    field = star_field(np.random.default_rng(1), frames=6)
    found = centroid_rows(INVERTED_WANG, TRUTH, field, FREE, SCALE).information
    plain = _numeric_information(field)
    root = np.sqrt(np.diag(plain))
    np.testing.assert_allclose(found / np.outer(root, root), plain / np.outer(root, root), atol=2e-5)
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
