"""Every camera model of the registry: derivatives, inverse, behaviour on the principal point."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from boresight.estimation.cameras import CAMERA_MODELS
from tests.estimation.fields import GROUND, PITCH, SCALE

MODELS = list(CAMERA_MODELS.values())
DETECTOR = st.tuples(st.floats(0, 1943), st.floats(0, 2591))
SHIFTS = st.lists(st.floats(-9, 9), min_size=8, max_size=8)


def _state(shifts):
    return GROUND + np.array(shifts) * SCALE


@pytest.mark.parametrize("camera", MODELS, ids=lambda camera: camera.name)
class TestCameraModel:
    @given(shifts=SHIFTS, place=DETECTOR)
    @settings(deadline=None)  # the first call compiles
    def test_the_analytic_jacobian_equals_the_complex_step(self, camera, shifts, place):
        x = _state(shifts)

        s, jacobian = camera.directions_and_jacobian(x, np.array([place[0]]), np.array([place[1]]), PITCH)

        for p in range(len(x)):
            step = 1e-30 * max(abs(x[p]), 1e-3)
            moved = x.astype(complex)
            moved[p] += 1j * step
            derivative = camera.directions(moved, np.array([place[0]]), np.array([place[1]]), PITCH).imag / step
            np.testing.assert_allclose(jacobian[..., p], derivative, rtol=1e-11, atol=1e-13 * np.abs(derivative).max())
        np.testing.assert_allclose(np.linalg.norm(s, axis=-1), 1.0, rtol=1e-14)

    def test_the_jacobian_is_finite_for_a_star_on_the_principal_point(self, camera):
        x = _state(np.ones(8))
        row, col = camera.principal_point(x)

        s, jacobian = camera.directions_and_jacobian(x, np.array([row]), np.array([col]), PITCH)

        np.testing.assert_allclose(s, [[0, 0, 1]], atol=1e-15)
        assert np.isfinite(jacobian).all()

    @given(shifts=SHIFTS, place=DETECTOR)
    @settings(deadline=None)  # the first call compiles
    def test_projection_undoes_the_direction(self, camera, shifts, place):
        x = _state(shifts)
        # only inside the radius where the distortion turns back is there one place a ray
        radius = np.linspace(0, 2000, 400)
        assume((np.diff(camera.radial_tangent(x, radius, PITCH)[0]) > 0).all())

        row, col = camera.project(x, camera.directions(x, np.array([place[0]]), np.array([place[1]]), PITCH), PITCH)

        np.testing.assert_allclose([row[0], col[0]], place, atol=1e-8)

    def test_a_direction_behind_the_sensor_projects_to_nothing(self, camera):
        row, col = camera.project(GROUND, np.array([[0.1, 0.1, -1.0]]), PITCH)

        assert np.isnan(row).all()
        assert np.isnan(col).all()

    def test_a_direction_beyond_the_turning_point_of_the_distortion_projects_to_nothing(self, camera):
        x = GROUND.copy()
        x[4] = -1e5  # barrel so strong that B rho turns back at 1.8 mm

        row, _ = camera.project(x, np.array([[0.2, 0.0, 1.0]]), PITCH)

        assert np.isnan(row).all()

    @given(shifts=SHIFTS, place=DETECTOR)
    @settings(deadline=None)  # the first call compiles
    def test_the_solid_angle_of_a_pixel_is_the_area_its_edges_span(self, camera, shifts, place):
        x, row, col = _state(shifts), np.array([place[0]]), np.array([place[1]])

        step = 1e-30
        down = camera.directions(x, row + 1j * step, col, PITCH)[0].imag / step
        right = camera.directions(x, row, col + 1j * step, PITCH)[0].imag / step

        np.testing.assert_allclose(
            camera.solid_angle(x, row, col, PITCH), np.linalg.norm(np.cross(down, right)), rtol=1e-10
        )

    def test_the_radial_tangent_agrees_with_directions_along_an_untilted_radius(self, camera):
        radius = np.array([0.0, 10.0, 500.0, 1500.0])

        tangent, gradient = camera.radial_tangent(GROUND, radius, PITCH)

        s = camera.directions(GROUND, GROUND[1] + radius, np.full(4, GROUND[2]), PITCH)
        np.testing.assert_allclose(tangent, s[:, 0] / s[:, 2], rtol=1e-12)
        for p in (0, 3, 4):
            h = 1e-6 * SCALE[p]
            moved = GROUND.copy()
            moved[p] += h
            np.testing.assert_allclose(
                gradient[:, p], (camera.radial_tangent(moved, radius, PITCH)[0] - tangent) / h, rtol=1e-3, atol=1e-12
            )

    def test_every_parameter_has_a_symbol_a_unit_a_spread_and_a_range(self, camera):
        n = len(camera.parameter_names)

        assert [len(camera.symbols), len(camera.units), len(camera.default_typical_sigma), len(camera.plausible)] == [
            n
        ] * 4
