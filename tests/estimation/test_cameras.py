"""Every camera model of the registry: derivatives, inverse, principal point, W's own equations, and from one model to another."""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from boresight import kernels
from boresight.calibration.conversion import convert
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL, turning_radius
from tests.estimation.fields import (
    GROUND,
    PINHOLE_GROUND,
    PINHOLE_SCALE,
    PITCH,
    SCALE,
    WU_COLUMNS,
    WU_PITCH,
    WU_ROWS,
    WU_TRUTH,
)

DETECTOR = st.tuples(st.floats(0, 1943), st.floats(0, 2591))
SHIFTS = st.lists(st.floats(-9, 9), min_size=8, max_size=8)


@dataclass(frozen=True)
class Case:
    """A model with a state near a real camera's, and what the tests cannot know of its parameters.

    `barrel` turns back at a tangent below 0.2; `axis` is that of D along which a pixel is Delta long; `radial` are the
    parameters of the symmetric part.
    """

    camera: CameraModel
    ground: np.ndarray
    scale: np.ndarray
    barrel: tuple[int, float]
    axis: int
    radial: tuple[int, ...]

    def state(self, shifts):
        return self.ground + np.array(shifts[: len(self.ground)]) * self.scale


CASES = {
    "inverted_wang": Case(CAMERA_MODELS["inverted_wang"], GROUND, SCALE, (4, -1e5), 0, (0, 3, 4)),
    "pinhole_radial": Case(CAMERA_MODELS["pinhole_radial"], PINHOLE_GROUND, PINHOLE_SCALE, (4, -20.0), 1, (1, 4, 5)),
}


def test_every_model_of_the_registry_is_tested_here():
    assert set(CASES) == set(CAMERA_MODELS)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
class TestCameraModel:
    @given(shifts=SHIFTS, place=DETECTOR)
    @settings(deadline=None)  # the first call compiles
    def test_the_analytic_jacobian_equals_the_complex_step(self, case, shifts, place):
        x = case.state(shifts)
        s, jacobian = case.camera.directions_and_jacobian(x, np.array([place[0]]), np.array([place[1]]), PITCH)
        for p in range(len(x)):
            step = 1e-30 * max(abs(x[p]), 1e-3)
            moved = x.astype(complex)
            moved[p] += 1j * step
            derivative = case.camera.directions(moved, np.array([place[0]]), np.array([place[1]]), PITCH).imag / step
            np.testing.assert_allclose(jacobian[..., p], derivative, rtol=1e-11, atol=1e-12 * np.abs(derivative).max())
        np.testing.assert_allclose(np.linalg.norm(s, axis=-1), 1.0, rtol=1e-14)

    def test_the_jacobian_is_finite_for_a_star_on_the_principal_point(self, case):
        x = case.state(np.ones(8))
        row, col = case.camera.principal_point(x)
        s, jacobian = case.camera.directions_and_jacobian(x, np.array([row]), np.array([col]), PITCH)
        np.testing.assert_allclose(s, [[0, 0, 1]], atol=1e-15)
        assert np.isfinite(jacobian).all()

    @given(shifts=SHIFTS, place=DETECTOR)
    @settings(deadline=None)  # the first call compiles
    def test_projection_undoes_the_direction(self, case, shifts, place):
        x = case.state(shifts)
        # only inside the radius where the distortion turns back is there one place a ray
        radius = np.linspace(0, 2000, 400)
        assume((np.diff(case.camera.radial_tangent(x, radius, PITCH)[0]) > 0).all())
        row, col = case.camera.project(
            x, case.camera.directions(x, np.array([place[0]]), np.array([place[1]]), PITCH), PITCH
        )
        np.testing.assert_allclose([row[0], col[0]], place, atol=1e-8)

    def test_a_direction_behind_the_sensor_projects_to_nothing(self, case):
        row, col = case.camera.project(case.ground, np.array([[0.1, 0.1, -1.0]]), PITCH)
        assert np.isnan(row).all()
        assert np.isnan(col).all()

    def test_a_direction_beyond_the_turning_point_of_the_distortion_projects_to_nothing(self, case):
        x = case.ground.copy()
        x[case.barrel[0]] = case.barrel[1]
        row, _ = case.camera.project(x, np.array([[0.2, 0.0, 1.0]]), PITCH)
        assert np.isnan(row).all()

    @given(shifts=SHIFTS, place=DETECTOR)
    @settings(deadline=None)  # the first call compiles
    def test_the_solid_angle_of_a_pixel_is_the_area_its_edges_span(self, case, shifts, place):
        x, row, col = case.state(shifts), np.array([place[0]]), np.array([place[1]])
        step = 1e-30
        down = case.camera.directions(x, row + 1j * step, col, PITCH)[0].imag / step
        right = case.camera.directions(x, row, col + 1j * step, PITCH)[0].imag / step
        np.testing.assert_allclose(
            case.camera.solid_angle(x, row, col, PITCH), np.linalg.norm(np.cross(down, right)), rtol=1e-10
        )

    def test_the_radial_tangent_agrees_with_directions_along_an_untilted_radius(self, case):
        radius = np.array([0.0, 10.0, 500.0, 1500.0])
        tangent, gradient = case.camera.radial_tangent(case.ground, radius, PITCH)
        place = list(case.camera.principal_point(case.ground))
        place[case.axis] = place[case.axis] + radius
        s = case.camera.directions(case.ground, *np.broadcast_arrays(*place), PITCH)
        np.testing.assert_allclose(tangent, s[:, case.axis] / s[:, 2], rtol=1e-12)
        for p in case.radial:
            h = 1e-4 * case.scale[p]
            moved = case.ground.copy()
            moved[p] += h
            slope = (case.camera.radial_tangent(moved, radius, PITCH)[0] - tangent) / h
            np.testing.assert_allclose(gradient[:, p], slope, rtol=1e-3, atol=1e-6 * np.abs(slope).max())

    def test_every_parameter_has_a_symbol_a_unit_a_spread_and_a_range(self, case):
        n = len(case.camera.parameter_names)
        assert [
            len(case.camera.symbols),
            len(case.camera.units),
            len(case.camera.default_typical_sigma),
            len(case.camera.plausible),
        ] == [n] * 4


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


def test_projection_and_principal_point_are_the_papers_with_its_x_along_columns():
    x = WU_TRUTH + np.array([1e-3, 1e-5, 3.0, -7.0, 0.02, 0.1])
    s_d = np.array([[0.1, -0.16, 1.0], [-0.07, 0.02, 1.0], [0.0, 0.0, 1.0]])
    row, col = PINHOLE_RADIAL.project(x, s_d, WU_PITCH)
    u, v = _as_printed(x, X=s_d[:, 1], Y=s_d[:, 0], Z=s_d[:, 2])
    np.testing.assert_allclose(col, u, rtol=1e-13)
    np.testing.assert_allclose(row, v, rtol=1e-13)
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


WU = (WU_ROWS, WU_COLUMNS, WU_PITCH)
STRAIGHT = np.array([1.0007, 0.016, 970.0, 550.0, 0.0, 0.0])


def _seen(model, x, places):
    return CAMERA_MODELS[model].directions(x, *places, WU_PITCH)


@pytest.fixture
def places():
    rng = np.random.default_rng(2)
    return rng.uniform(0, WU_ROWS - 1, 300), rng.uniform(0, WU_COLUMNS - 1, 300)


@given(s=st.floats(0.9, 1.1), f=st.floats(0.01, 0.05), u0=st.floats(900, 1000), v0=st.floats(500, 600))
def test_a_lens_without_distortion_converts_exactly_and_back(s, f, u0, v0):
    x = np.array([s, f, u0, v0, 0.0, 0.0])
    there = convert(x, "pinhole_radial", "inverted_wang", WU)
    back = convert(there.x, "inverted_wang", "pinhole_radial", WU)
    assert there.misfit_px < 1e-9
    np.testing.assert_allclose(back.x, x, rtol=1e-14, atol=1e-14)
    np.testing.assert_array_equal(there.x[3:7], 0.0)


def test_the_converted_camera_sees_the_same_directions_with_the_same_uncertainty(places):
    there = convert(STRAIGHT, "pinhole_radial", "inverted_wang", WU)
    np.testing.assert_allclose(
        _seen("inverted_wang", there.x, places), _seen("pinhole_radial", STRAIGHT, places), atol=1e-15
    )
    spread = np.array([1e-4, 1e-6, 1.0, 1.0, 1e-3, 1e-2])
    root = np.random.default_rng(3).normal(size=(6, 6)) * spread[:, None]
    there = convert(STRAIGHT, "pinhole_radial", "inverted_wang", WU, P=root @ root.T)
    variances = []
    for model, x, P in (("pinhole_radial", STRAIGHT, root @ root.T), ("inverted_wang", there.x, there.P)):
        _, J = CAMERA_MODELS[model].directions_and_jacobian(x, *places, WU_PITCH)
        variances.append(np.einsum("nip,pq,niq->ni", J, P, J))
    np.testing.assert_allclose(variances[1], variances[0], rtol=1e-6)
    assert there.lost_sigma_px < 1e-6


def test_a_lens_without_decentring_gets_none_and_decentring_that_the_target_has_not_is_misfit_and_lost_sigma():
    there = convert(STRAIGHT, "pinhole_radial", "inverted_wang", WU, P=np.diag([1e-5, 1e-7, 1.0, 1.0, 1e-2, 1e-1]) ** 2)
    np.testing.assert_array_equal(there.x[5:7], 0.0)
    np.testing.assert_array_equal(there.P[5:7], 0.0)
    np.testing.assert_array_equal(there.P[:, 5:7], 0.0)
    assert (np.diag(there.P)[[0, 1, 2, 3, 4, 7]] > 0).all()
    x = convert(STRAIGHT, "pinhole_radial", "inverted_wang", WU).x
    P = np.zeros((8, 8))
    P[5, 5] = 0.001**2
    there = convert(x, "inverted_wang", "pinhole_radial", WU, P=P)
    # a1 moves a corner by a1 u v / f = 1e-3 * 540 * 960 / 5517 = 0.09 px, and by v^2 / f besides
    assert 0.02 < there.lost_sigma_px < 0.3
    x[5] = 0.01
    assert convert(x, "inverted_wang", "pinhole_radial", WU).misfit_px > 0.1


def test_the_misfit_is_what_the_two_cameras_differ_by_on_the_detector(places):
    there = convert(WU_TRUTH, "pinhole_radial", "inverted_wang", WU)
    s = _seen("pinhole_radial", WU_TRUTH, places)
    row, col = CAMERA_MODELS["inverted_wang"].project(there.x, s, WU_PITCH)
    away = np.hypot(row - places[0], col - places[1])
    angle = np.linalg.norm(_seen("inverted_wang", there.x, places) - s, axis=-1)
    assert 0.2 * there.misfit_px < away.max() < 1.01 * there.misfit_px
    assert np.sqrt(np.mean(away**2)) == pytest.approx(there.rms_px, rel=0.5)
    assert 0.2 * there.misfit_rad < angle.max() < 1.01 * there.misfit_rad
    assert np.sqrt(np.mean(angle**2)) == pytest.approx(there.rms_rad, rel=0.5)
    assert 1e-6 < there.misfit_px < 0.01


def test_every_pair_of_models_has_a_conversion_and_a_model_is_its_own():
    for source, target in permutations(CAMERA_MODELS, 2):
        x = STRAIGHT if source == "pinhole_radial" else convert(STRAIGHT, "pinhole_radial", source, WU).x
        assert convert(x, source, target, WU).misfit_px < 1e-6
    there = convert(WU_TRUTH, "pinhole_radial", "pinhole_radial", WU, P=np.eye(6))
    np.testing.assert_array_equal(there.x, WU_TRUTH)
    np.testing.assert_array_equal(there.P, np.eye(6))
