"""Every camera model of the registry: derivatives, inverse, principal point, W's own equations, and from one model to another."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from boresight.calibration.conversion import convert
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import corners
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL, turning_radius_squared
from tests.estimation.fields import (
    PITCH,
    WU_COLUMNS,
    WU_PITCH,
    WU_ROWS,
    WU_TRUTH,
    directions_by_definition,
)

DETECTOR = st.tuples(st.floats(0, 1943), st.floats(0, 2591))
FOCAL_PX, MIDDLE = 7300.0, (972.0, 1296.0)
SHIFTS = st.lists(st.floats(-9, 9), min_size=16, max_size=16)
BARREL = {"k1": -20.0, "b2_per_m2": -1e5}  # turns back at a tangent below 0.2


def state(camera, shifts):
    n = len(camera.parameter_names)
    assert n <= len(shifts)
    return camera.plain(FOCAL_PX, *MIDDLE, PITCH) + np.array(shifts[:n]) * camera.default_typical_sigma


@pytest.mark.parametrize("camera", CAMERA_MODELS.values(), ids=CAMERA_MODELS.keys())
class TestCameraModel:
    @given(shifts=SHIFTS, place=DETECTOR)
    @settings(deadline=None)  # the first call compiles
    def test_the_analytic_jacobian_equals_the_complex_step(self, camera, shifts, place):
        x = state(camera, shifts)
        s, jacobian = camera.directions_and_jacobian(x, *place, PITCH)
        assume(np.isfinite(s).all())
        for p in range(len(x)):
            step = 1e-30 * max(abs(x[p]), 1e-3)
            moved = x.astype(complex)
            moved[p] += 1j * step
            derivative = directions_by_definition(camera, moved, *place, PITCH).imag / step
            np.testing.assert_allclose(jacobian[..., p], derivative, rtol=1e-10, atol=1e-11 * np.abs(derivative).max())
        np.testing.assert_allclose(np.linalg.norm(s, axis=-1), 1.0, rtol=1e-14)
        np.testing.assert_allclose(camera.directions(x, *place, PITCH), s, rtol=0, atol=4e-16)
        few = camera.directions_of_few(x, *np.transpose([place, (np.nan, 0.0)]), PITCH)
        np.testing.assert_allclose(few, [np.ravel(s), [np.nan] * 3], rtol=0, atol=4e-16)

    def test_the_compiled_form_is_blind_at_the_corners_where_the_plain_one_is(self, camera):
        rng, row_col, found = np.random.default_rng(3), corners(1944, 2592), set()
        for size in np.repeat([0.0, 3.0, 100.0, 3000.0], 25):
            x = state(camera, size * rng.normal(size=16))
            blind = camera.blind_corner(x, 1944, 2592, PITCH) is not None
            assert np.isfinite(camera.directions(x, *row_col, PITCH)).all() == (not blind)
            found.add(blind)
        assert False in found

    def test_the_jacobian_is_finite_for_a_star_on_the_principal_point(self, camera):
        x = state(camera, np.ones(16))
        row, col = camera.principal_point(x)
        s, jacobian = camera.directions_and_jacobian(x, np.array([row]), np.array([col]), PITCH)
        np.testing.assert_allclose(s, [[0, 0, 1]], atol=1e-15)
        assert np.isfinite(jacobian).all()

    @given(shifts=SHIFTS, place=DETECTOR)
    @settings(deadline=None)  # the first call compiles
    def test_projection_undoes_the_direction(self, camera, shifts, place):
        x = state(camera, shifts)
        # only inside the radius where the distortion turns back is there one place a ray
        radius = np.linspace(0, 2000, 400)
        assume((np.diff(camera.radial_tangent(x, radius, PITCH)[0]) > 0).all())
        s = camera.directions(x, np.array([place[0]]), np.array([place[1]]), PITCH)
        assume(np.isfinite(s).all())
        np.testing.assert_allclose(np.ravel(camera.project(x, s, PITCH)), place, atol=1e-8)

    def test_a_direction_behind_the_sensor_projects_to_nothing(self, camera):
        assert np.isnan(camera.project(state(camera, np.zeros(16)), np.array([[0.1, 0.1, -1.0]]), PITCH)).all()

    def test_a_direction_beyond_the_turning_point_of_the_distortion_projects_to_nothing(self, camera):
        name = next(name for name in BARREL if name in camera.parameter_names)
        x = state(camera, np.zeros(16))
        x[camera.parameter_names.index(name)] = BARREL[name]
        assert np.isnan(camera.project(x, np.array([[0.2, 0.0, 1.0]]), PITCH)).all()

    @given(shifts=SHIFTS, place=DETECTOR)
    @settings(deadline=None)  # the first call compiles
    def test_the_solid_angle_of_a_pixel_is_the_area_its_edges_span(self, camera, shifts, place):
        x, step = state(camera, shifts), 1e-30
        assume(np.isfinite(camera.directions(x, *place, PITCH)).all())
        down = directions_by_definition(camera, x, place[0] + 1j * step, place[1], PITCH).imag / step
        right = directions_by_definition(camera, x, place[0], place[1] + 1j * step, PITCH).imag / step
        np.testing.assert_allclose(
            camera.solid_angle(x, np.array([place[0]]), np.array([place[1]]), PITCH),
            np.linalg.norm(np.cross(down, right)), rtol=1e-9,
        )  # fmt: skip

    def test_the_radial_tangent_is_that_of_a_camera_without_tilt_decentring_and_aspect(self, camera):
        radius = np.array([0.0, 10.0, 500.0, 1500.0])
        x = state(camera, np.ones(16))
        symmetric = np.array(
            [one if p.neutral is None else p.neutral for one, p in zip(x, camera.parameters, strict=True)]
        )
        row, col = camera.principal_point(x)
        tangent, gradient = camera.radial_tangent(x, radius, PITCH)
        s = camera.directions(symmetric, row, col + radius, PITCH)
        np.testing.assert_allclose(tangent, np.hypot(s[:, 0], s[:, 1]) / s[:, 2], rtol=1e-12)
        for p, parameter in enumerate(camera.parameters):
            h = 1e-2 * parameter.typical_sigma
            moved = x.copy()
            moved[p] += h
            slope = (camera.radial_tangent(moved, radius, PITCH)[0] - tangent) / h
            np.testing.assert_allclose(gradient[:, p], slope, rtol=1e-3, atol=1e-5 * np.abs(slope).max() + 1e-12)

    def test_a_plain_camera_shows_a_star_at_its_focal_length_times_the_tangent(self, camera):
        x = camera.plain(FOCAL_PX, *MIDDLE, PITCH)
        row, col = camera.project(x, np.array([[0.001, -0.0005, 1.0]]), PITCH)
        np.testing.assert_allclose(
            (row - MIDDLE[0], col - MIDDLE[1]), ([0.001 * FOCAL_PX], [-0.0005 * FOCAL_PX]), rtol=1e-6
        )
        assert camera.focal_px(x, PITCH) == pytest.approx(FOCAL_PX, rel=1e-15)
        assert camera.principal_point(x) == MIDDLE

    def test_every_parameter_has_a_symbol_a_unit_a_spread_and_a_range(self, camera):
        assert [one for one in camera.parameters if not (one.symbol and one.unit and one.typical_sigma > 0)] == []
        assert all(
            one.lowest <= (one.neutral or 0.0) <= one.highest for one in camera.parameters if one.symbol not in "fs"
        )


FISHEYE_F = 1e-3


def derivative_by_definition(x, p, place, rays):
    """Complex step through the definition; what it leaves to a search, the theorem of the implicit function gives."""
    row, col = place
    t = rays[:, :2] / rays[:, 2:]
    theta, azimuth = np.arctan(np.hypot(*t.T)), np.arctan2(t[:, 0], t[:, 1])

    def seen(x, theta, azimuth):
        s, f, u0, v0, *k = x
        rho = theta * (1 + sum(one * theta ** (2 * n) for n, one in enumerate(k, 1)))
        return np.array([v0 + f / (s * PITCH) * rho * np.sin(azimuth), u0 + f / PITCH * rho * np.cos(azimuth)])

    step = 1e-30
    by = np.array([seen(x, theta + 1j * step, azimuth).imag, seen(x, theta, azimuth + 1j * step).imag]) / step
    moved = x.astype(complex)
    moved[p] += 1j * step
    np.testing.assert_allclose(seen(x, theta, azimuth), [row, col], atol=1e-8)
    d_theta, d_azimuth = -np.linalg.solve(
        by.transpose(2, 1, 0), (seen(moved, theta, azimuth).imag / step).T[..., None]
    )[..., 0].T
    sin, cos = np.sin(theta), np.cos(theta)
    along = np.array([cos * np.sin(azimuth), cos * np.cos(azimuth), -sin])
    across = np.array([sin * np.cos(azimuth), -sin * np.sin(azimuth), 0 * sin])
    return (along * d_theta + across * d_azimuth).T


@given(shifts=st.lists(st.floats(-3, 3), min_size=8, max_size=8), seed=st.integers(0, 99))
def test_a_fisheye_of_eighty_degrees_comes_back_and_its_jacobian_is_the_complex_step_over_the_whole_field(shifts, seed):
    camera = CAMERA_MODELS["kannala_brandt"]
    spread = np.array([2e-4, 8e-6, 10.0, 10.0, 1e-2, 3e-3, 5e-4, 1e-4])
    x = camera.plain(FISHEYE_F / PITCH, *MIDDLE, PITCH) + np.array(shifts) * spread
    rng = np.random.default_rng(seed)
    theta, azimuth = np.radians(80.0 * np.sqrt(rng.uniform(size=50))), rng.uniform(0, 2 * np.pi, 50)
    theta[:2] = np.radians([80.0, 1e-3])
    rays = np.stack([np.sin(theta) * np.sin(azimuth), np.sin(theta) * np.cos(azimuth), np.cos(theta)], axis=1)
    place = camera.project(x, rays, PITCH)
    s, jacobian = camera.directions_and_jacobian(x, *place, PITCH)
    np.testing.assert_allclose(s, rays, atol=1e-13)
    np.testing.assert_allclose(np.ravel(camera.project(x, s, PITCH)), np.ravel(place), atol=1e-8)
    for p in range(len(x)):
        expected = derivative_by_definition(x, p, place, s)
        np.testing.assert_allclose(jacobian[..., p], expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())


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
    turn = min(np.sqrt(turning_radius_squared(*k)), 1.0)
    r = share * turn
    radius_px = r * (1 + k[0] * r**2 + k[1] * r**4) * WU_TRUTH[1] / WU_PITCH
    tangent, _ = PINHOLE_RADIAL.radial_tangent(np.array([*WU_TRUTH[:4], *k]), np.array([radius_px]), WU_PITCH)
    # beside the turn a hundredth of a billionth of R is a millionth of r
    np.testing.assert_allclose(tangent, r, rtol=1e-6, atol=1e-12)


@given(k=COEFFICIENTS)
def test_the_slope_is_positive_up_to_the_turning_radius_and_not_beyond(k):
    turn = np.sqrt(turning_radius_squared(*k))
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
