"""Batch and filter meet the maximum-likelihood fit and the bound where the lens is tangential, of sixth order or wide."""

import numpy as np
import pytest

from benchmarks import efficiency
from benchmarks.efficiency import CASES, OVER_LIKELIHOOD, PITCH_M, measure, rotations
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.statistics.cramer_rao import centroid_rows


@pytest.mark.few(1)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.camera)
def test_the_plain_cameras_are_the_product_s(case):
    camera, truth = CAMERA_MODELS[case.camera], np.array(case.truth)
    row, col = (at.ravel() for at in np.meshgrid(*(np.linspace(1, size, 9) for size in case.size)))
    s = camera.directions(truth, row, col, PITCH_M)
    np.testing.assert_allclose(case.forward(truth, s), [row, col], atol=1e-7)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.camera)
def test_the_plain_information_is_the_product_s_bound(case):
    rng = np.random.default_rng(1)
    camera, truth, scale = CAMERA_MODELS[case.camera], np.array(case.truth), np.array(case.typical_sigma)
    field = efficiency.uniform_field(camera, truth, case.size, PITCH_M, np.full(20, 15), 1e-6, rng)
    A = efficiency.normal_matrix(case.forward, field, truth, np.broadcast_to(np.eye(3), (20, 3, 3)))[0] * np.outer(
        scale, scale
    )
    held = centroid_rows(camera, truth, field, np.arange(len(truth)), scale).information
    np.testing.assert_allclose(np.linalg.inv(A) @ held, np.eye(len(truth)), atol=1e-3)


def test_small_rotations_are_rotations():
    C = rotations(np.array([[1e-3, -2e-3, 3e-4]]))
    np.testing.assert_allclose(C[0] @ C[0].T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(C[0] @ [0, 0, 1], [-2e-3, -1e-3, 1], atol=4e-6)


@pytest.mark.full
def test_batch_and_filter_err_as_the_maximum_likelihood_fit_does_and_claim_what_they_err():
    found = measure(lambda *_: None, sets=200, frames=60)["cameras"]
    for of in found.values():
        for name in ("batch", "sqrf"):
            one = of["estimators"][name]
            assert one["over_likelihood"] <= OVER_LIKELIHOOD
            assert one["nees_inside"]
        assert of["estimators"]["maximum_likelihood"]["rmse_over_bound"] < 1.05
