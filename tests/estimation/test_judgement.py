"""Chi-square bounds, observability in words, RMS and the radial curve."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import batch
from boresight.estimation.metrics import aggregate_rms, rms, tail_rms
from boresight.estimation.statistics.consistency import chi_square
from boresight.estimation.statistics.observability import observability
from boresight.estimation.statistics.uncertainty import radial_difference
from tests.estimation.fields import FREE, GROUND, PITCH, SCALE, TRUTH, star_field, weighed

NAMES, SYMBOLS = INVERTED_WANG.parameter_names, INVERTED_WANG.symbols


@given(dof=st.integers(1, 100_000))
def test_the_bounds_are_the_quantiles_of_chi_square(dof):
    test = chi_square(float(dof), dof)
    np.testing.assert_allclose([test.lower, test.upper], chi2.ppf([0.025, 0.975], dof) / dof, rtol=1e-6)
    assert test.consistent == (test.lower <= 1.0 <= test.upper)


def test_no_degrees_of_freedom_is_a_programming_error():
    with pytest.raises(ValueError, match="Expected positive degrees of freedom, received 0"):
        chi_square(1.0, 0)


def test_the_principal_point_and_the_tilt_are_named_as_moving_together():
    pinhole = GROUND.copy()
    pinhole[4] = -50.0
    field = weighed(star_field(np.random.default_rng(21), frames=20, truth=pinhole), pinhole)
    equations = batch.normal_equations(field, pinhole, FREE, SCALE)
    seen = observability(equations.A, NAMES, SYMBOLS)
    assert [set(seen.sentence(i).split(" move together")[0].split(" and ")) for i in (7, 6)] in (
        [{"m0", "a2"}, {"n0", "a1"}],
        [{"n0", "a1"}, {"m0", "a2"}],
    )
    # moving the principal point with the tilt that follows it, a2 = (Delta / f) dm0 of the same sign, is the weak direction
    for i in (7, 6):
        v = seen.direction(i)
        point, tilt = ("m0_px", "a2_rad") if abs(v["m0_px"]) > 0.5 else ("n0_px", "a1_rad")
        ratio = v[tilt] * SCALE[NAMES.index(tilt)] / (v[point] * SCALE[NAMES.index(point)])
        assert ratio == pytest.approx(PITCH / GROUND[0], rel=0.1)


def test_singular_values_rebuild_the_information():
    field = weighed(star_field(np.random.default_rng(22), frames=10), TRUTH)
    A = batch.normal_equations(field, TRUTH, FREE, SCALE).A
    seen = observability(A, NAMES, SYMBOLS)
    np.testing.assert_allclose(seen.V @ np.diag(seen.singular_values**2) @ seen.V.T, A, rtol=1e-8, atol=1e-10 * A.max())
    assert (np.diff(seen.singular_values) <= 0).all()
    assert seen.condition_number == pytest.approx(seen.singular_values[0] / seen.singular_values[-1])


def test_an_undetermined_direction_is_said_to_be_so():
    seen = observability(np.diag([4.0, 0.0]), ("f_m", "g_y"), ("f", "g_y"))
    assert seen.sentence(1) == "g_y moves nearly alone: it is not determined by these data."
    assert seen.condition_number is None
    assert seen.weak() == [1]


def test_tail_and_aggregate_rms_follow_their_definitions():
    field = weighed(star_field(np.random.default_rng(23), frames=6), GROUND)
    states = np.linspace(GROUND, TRUTH, 6)
    tail = tail_rms(field, states)
    parts = [field.frames(k, k + 1) for k in range(6)]
    squares = np.array([rms(part, x) ** 2 * part.n_arcs for part, x in zip(parts, states, strict=True)])
    counts = np.array([float(part.n_arcs) for part in parts])
    np.testing.assert_allclose(tail, [rms(field, x) for x in states], rtol=1e-12)
    np.testing.assert_allclose(aggregate_rms(squares, counts)[-1] ** 2 * counts.sum(), squares.sum(), rtol=1e-12)


def test_the_band_of_the_radial_curve_is_the_spread_of_curves_drawn_from_the_covariance():
    field = weighed(star_field(np.random.default_rng(24), frames=40), TRUTH)
    P = np.linalg.inv(batch.normal_equations(field, TRUTH, FREE, SCALE).A) * np.outer(SCALE, SCALE)
    radius = np.array([0.0, 300.0, 900.0, 1500.0])
    curve = radial_difference(INVERTED_WANG, TRUTH, GROUND, P, radius, PITCH)
    draws = np.random.default_rng(1).multivariate_normal(TRUTH, P, size=4000, method="cholesky")
    drawn = np.array([radial_difference(INVERTED_WANG, x, GROUND, P, radius, PITCH).difference_px for x in draws])
    np.testing.assert_allclose(drawn.std(axis=0)[1:], curve.sigma_px[1:], rtol=0.05)
    np.testing.assert_allclose(drawn.mean(axis=0), curve.difference_px, atol=0.01)
    assert curve.sigma_px[0] == 0


def test_the_radial_curve_is_the_displacement_that_projection_shows():
    x = GROUND.copy()
    x[[0, 3, 4]] = TRUTH[[0, 3, 4]]
    radius = np.array([200.0, 1000.0])
    curve = radial_difference(INVERTED_WANG, x, GROUND, np.zeros((8, 8)), radius, PITCH)
    rays = INVERTED_WANG.directions(x, x[1] + radius, np.full(2, x[2]), PITCH)
    angle = np.arctan2(rays[:, 0], rays[:, 2])
    before = INVERTED_WANG.directions(GROUND, GROUND[1] + radius, np.full(2, GROUND[2]), PITCH)
    np.testing.assert_allclose(curve.difference_rad, angle - np.arctan2(before[:, 0], before[:, 2]), atol=1e-12)
    np.testing.assert_allclose(
        curve.difference_px / radius, np.tan(angle) / (before[:, 0] / before[:, 2]) - 1, atol=1e-10
    )
