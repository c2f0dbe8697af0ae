"""What only the pinhole camera with radial distortion has: an iteration, a turn, and W's own equations to be held against."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight import kernels
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL, turning_radius
from tests.estimation.pinhole_fields import WU_COLUMNS, WU_PITCH, WU_ROWS, WU_TRUTH

COEFFICIENTS = st.tuples(st.floats(-3, 3), st.floats(-30, 30))


def _as_printed(x, X, Y, Z):
    s, f, u0, v0, k1, k2 = x
    D_u = WU_PITCH
    D_v = s * D_u
    f_u, f_v = f / D_u, f / D_v
    u, v = f_u * X / Z + u0, f_v * Y / Z + v0
    r2 = (u - u0) ** 2 / f_u**2 + (v - v0) ** 2 / f_v**2
    delta = k1 * r2 + k2 * r2**2
    return u + (u - u0) * delta, v + (v - v0) * delta


def test_projection_is_the_papers_with_its_x_along_columns_and_its_y_along_rows():
    x = WU_TRUTH + np.array([1e-3, 1e-5, 3.0, -7.0, 0.02, 0.1])
    s_d = np.array([[0.1, -0.16, 1.0], [-0.07, 0.02, 1.0], [0.0, 0.0, 1.0]])
    row, col = PINHOLE_RADIAL.project(x, s_d, WU_PITCH)
    u, v = _as_printed(x, X=s_d[:, 1], Y=s_d[:, 0], Z=s_d[:, 2])
    np.testing.assert_allclose(col, u, rtol=1e-13)
    np.testing.assert_allclose(row, v, rtol=1e-13)


def test_the_principal_point_is_column_first_as_in_the_paper():
    assert PINHOLE_RADIAL.principal_point(WU_TRUTH) == (550.0, 970.0)


@given(k=COEFFICIENTS, share=st.floats(0, 0.999))
def test_the_ray_of_a_place_short_of_the_turn_lies_on_the_branch_that_rises_from_zero(k, share):
    turn = min(turning_radius(*k), 1.0)
    r = share * turn
    radius_px = r * (1 + k[0] * r**2 + k[1] * r**4) * WU_TRUTH[1] / WU_PITCH
    tangent, _ = PINHOLE_RADIAL.radial_tangent(np.array([*WU_TRUTH[:4], *k]), np.array([radius_px]), WU_PITCH)
    # beside the turn a hundredth of a billionth of R is a millionth of r
    np.testing.assert_allclose(tangent, r, rtol=1e-6, atol=1e-12)


@given(k=COEFFICIENTS)
def test_the_slope_is_positive_up_to_the_turning_radius_and_not_beyond(k):
    turn = turning_radius(*k)
    y = np.linspace(0, min(turn, 5.0) * (1 - 1e-9), 500) ** 2
    assert (1 + 3 * k[0] * y + 5 * k[1] * y**2 > 0).all()
    if np.isfinite(turn):
        beyond = (turn * (1 + 1e-9)) ** 2
        assert 1 + 3 * k[0] * beyond + 5 * k[1] * beyond**2 < 1e-9


def test_a_place_beyond_the_turn_has_no_direction():
    x = WU_TRUTH.copy()
    x[4], x[5] = -20.0, 0.0  # r_turn = 0.129, R_turn = 0.086: 475 px
    s, ds = PINHOLE_RADIAL.directions_and_jacobian(x, np.array([550.0, 550.0]), np.array([1440.0, 1450.0]), WU_PITCH)
    assert np.isfinite(s[0]).all()
    assert np.isnan(s[1]).all()
    assert np.isnan(ds[1]).any()


@pytest.mark.parametrize("k", [(-0.5, 0.5), (0.4, -2.0), (-20.0, 0.0), (0.0, 0.0), (-4.0, 18.0)])
def test_the_compiled_rays_and_their_derivatives_equal_the_plain_ones(k):
    rng = np.random.default_rng(4)
    x = np.array([1.001, *WU_TRUTH[1:4], *k])
    row, col = rng.uniform(0, WU_ROWS - 1, 200), rng.uniform(0, WU_COLUMNS - 1, 200)
    s, D = np.empty((200, 3)), np.empty((200, 3, 6))
    kernels.rays_and_jacobians(PINHOLE_RADIAL.kernel, x, WU_PITCH, row, col, s, D)
    expected_s, expected_D = PINHOLE_RADIAL.directions_and_jacobian(x, row, col, WU_PITCH)
    size = np.nanmax(np.abs(expected_D), axis=(0, 1))
    np.testing.assert_allclose(s, expected_s, atol=1e-13)
    np.testing.assert_allclose(D / size, expected_D / size, atol=1e-9 if k[0] == -20.0 else 1e-12)
