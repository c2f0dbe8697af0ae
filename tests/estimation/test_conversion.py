"""From one camera model to another: exact where the two say the same, and with its misfit where they do not."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.calibration.conversion import convert
from boresight.cameras import CAMERA_MODELS
from tests.estimation.pinhole_fields import WU_COLUMNS, WU_PITCH, WU_ROWS, WU_TRUTH

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


def test_the_converted_camera_sees_the_same_directions(places):
    there = convert(STRAIGHT, "pinhole_radial", "inverted_wang", WU)
    np.testing.assert_allclose(
        _seen("inverted_wang", there.x, places), _seen("pinhole_radial", STRAIGHT, places), atol=1e-15
    )


def test_the_covariance_gives_directions_the_same_uncertainty(places):
    spread = np.array([1e-4, 1e-6, 1.0, 1.0, 1e-3, 1e-2])
    root = np.random.default_rng(3).normal(size=(6, 6)) * spread[:, None]
    there = convert(STRAIGHT, "pinhole_radial", "inverted_wang", WU, P=root @ root.T)
    variances = []
    for model, x, P in (("pinhole_radial", STRAIGHT, root @ root.T), ("inverted_wang", there.x, there.P)):
        _, J = CAMERA_MODELS[model].directions_and_jacobian(x, *places, WU_PITCH)
        variances.append(np.einsum("nip,pq,niq->ni", J, P, J))
    np.testing.assert_allclose(variances[1], variances[0], rtol=1e-6)
    assert there.lost_sigma_px < 1e-6


def test_a_lens_without_decentring_gets_none_and_no_sigma_of_it_that_is_but_rounding():
    there = convert(STRAIGHT, "pinhole_radial", "inverted_wang", WU, P=np.diag([1e-5, 1e-7, 1.0, 1.0, 1e-2, 1e-1]) ** 2)
    np.testing.assert_array_equal(there.x[5:7], 0.0)
    np.testing.assert_array_equal(there.P[5:7], 0.0)
    np.testing.assert_array_equal(there.P[:, 5:7], 0.0)
    assert (np.diag(there.P)[[0, 1, 2, 3, 4, 7]] > 0).all()


def test_what_is_uncertain_in_the_decentring_is_said_to_be_lost():
    x = convert(STRAIGHT, "pinhole_radial", "inverted_wang", WU).x
    P = np.zeros((8, 8))
    P[5, 5] = 0.001**2
    there = convert(x, "inverted_wang", "pinhole_radial", WU, P=P)
    # a1 moves a corner by a1 u v / f = 1e-3 * 540 * 960 / 5517 = 0.09 px, and by v^2 / f besides
    assert 0.02 < there.lost_sigma_px < 0.3


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


def test_decentring_is_left_as_misfit_where_the_target_has_none():
    x = convert(STRAIGHT, "pinhole_radial", "inverted_wang", WU).x
    x[5] = 0.01
    assert convert(x, "inverted_wang", "pinhole_radial", WU).misfit_px > 0.1


def test_every_pair_of_models_has_a_conversion():
    for source, target in permutations(CAMERA_MODELS, 2):
        x = STRAIGHT if source == "pinhole_radial" else convert(STRAIGHT, "pinhole_radial", source, WU).x
        assert convert(x, source, target, WU).misfit_px < 1e-6


def test_a_model_converts_to_itself_unchanged():
    there = convert(WU_TRUTH, "pinhole_radial", "pinhole_radial", WU, P=np.eye(6))
    np.testing.assert_array_equal(there.x, WU_TRUTH)
    np.testing.assert_array_equal(there.P, np.eye(6))
