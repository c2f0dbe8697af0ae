"""Star fields at random attitudes: on the detector, at the catalogue's angles, in the part of the sky that was asked for."""

import numpy as np
import pytest

from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.simulation.fields import GALACTIC_POLE_DEG, _attitudes, _unit_vectors, random_fields
from boresight.simulation.sensors import WU_PIXEL_PITCH_M, WU_START, WU_TRUTH, wu_sensor


@pytest.fixture(scope="module")
def fields():
    rng = np.random.default_rng(5)
    s_i = rng.normal(size=(3000, 3))
    s_i /= np.linalg.norm(s_i, axis=1, keepdims=True)
    return random_fields(wu_sensor(), WU_TRUTH, s_i, 250, rng, minimum_stars=5)


def test_every_field_has_its_stars_on_the_detector_and_enough_of_them(fields):
    assert len(fields) == 250
    assert np.diff(fields.star_start).min() >= 5
    assert fields.star_start[-1] == len(fields.s_i) == len(fields.row_px) == len(fields.col_px)
    assert np.all((fields.row_px >= -0.5) & (fields.row_px <= 1079.5))
    assert np.all((fields.col_px >= -0.5) & (fields.col_px <= 1919.5))


def test_the_true_camera_gives_back_the_catalogues_angles_and_left_and_right(fields):
    s_d = PINHOLE_RADIAL.directions(WU_TRUTH, fields.row_px, fields.col_px, WU_PIXEL_PITCH_M)
    for first, last in zip(fields.star_start[:20], fields.star_start[1:21], strict=True):
        seen, known = s_d[first:last], fields.s_i[first:last]
        assert np.allclose(seen @ seen.T, known @ known.T, atol=1e-12)
        handed = [np.linalg.det(one[:3]) for one in (seen, known)]
        assert np.isclose(handed[0], wu_sensor().parity * handed[1], atol=1e-12)


def test_a_uniform_sky_shows_its_share_of_stars(fields):
    corners = PINHOLE_RADIAL.solid_angle(
        WU_TRUTH, *np.mgrid[0:1080:20, 0:1920:20].reshape(2, -1) + 9.5, WU_PIXEL_PITCH_M
    )
    expected = 3000 * corners.sum() * 400 / (4 * np.pi)
    assert fields.stars_per_field == pytest.approx(expected, abs=4 * np.sqrt(expected / 250))


def test_attitudes_are_rotations_with_their_boresights_in_the_band_spread_evenly():
    rng = np.random.default_rng(2)
    C = np.concatenate([_attitudes(25.0, rng) for _ in range(20)])
    sine = C[:, 2] @ _unit_vectors(*np.radians(GALACTIC_POLE_DEG))
    assert np.allclose(C @ C.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(C), 1)
    assert np.abs(sine).max() <= np.sin(np.radians(25))
    assert np.mean(sine**2) == pytest.approx(np.sin(np.radians(25)) ** 2 / 3, rel=0.05)
    assert np.abs(C[:, 0].mean(axis=0)).max() < 0.05


def test_the_papers_sensor_starts_where_the_paper_starts():
    sensor = wu_sensor(0.5)
    assert (sensor.rows, sensor.columns, sensor.centroid_sigma_px) == (1080, 1920, 0.5)
    assert np.array_equal(sensor.initial, WU_START)
    assert sensor.free == PINHOLE_RADIAL.parameter_names
