"""Every camera model of the registry: derivatives, inverse, behaviour on the principal point."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from boresight.cameras import CAMERA_MODELS, CameraModel
from tests.estimation.fields import GROUND, PITCH, SCALE
from tests.estimation.pinhole_fields import PINHOLE_GROUND, PINHOLE_SCALE

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
