"""The covariance of a difference, against what simulated pairs of estimates do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.calibration.evaluation.contrast import (
    SharedData,
    covariance_of_difference,
    joint_test,
    sigma_of_difference,
)

N_EXPOSURES, N_PARAMETERS, N_TRIALS = 60, 3, 6000
RNG = np.random.default_rng(7)
H = RNG.normal(size=(N_EXPOSURES, 4, N_PARAMETERS)) * np.array([1.0, 3.0, 0.2])


def estimates(noise, chosen):
    A, y = H[chosen].reshape(-1, N_PARAMETERS), noise[:, chosen].reshape(len(noise), -1)
    P = np.linalg.inv(A.T @ A)
    return y @ A @ P, P


@pytest.fixture(scope="module")
def noise():
    return np.random.default_rng(8).normal(size=(N_TRIALS, N_EXPOSURES, 4))


@pytest.mark.parametrize(
    ("a", "b", "tolerance"),
    [
        (range(30), range(30, 60), 0.06),
        (range(20), range(60), 0.06),
        (range(60), range(45), 0.06),
        (range(40), range(20, 60), 0.2),  # shares are told, not what the shared exposures hold
    ],
    ids=["disjoint", "a within b", "b within a", "partly"],
)
def test_differences_scatter_as_their_covariance_says(noise, a, b, tolerance):
    (x_a, P_a), (x_b, P_b) = estimates(noise, list(a)), estimates(noise, list(b))
    common = len(set(a) & set(b))
    D = covariance_of_difference(P_a, P_b, SharedData(common / len(a), common / len(b)))
    assert np.std(x_a - x_b, axis=0) == pytest.approx(np.sqrt(np.diag(D)), rel=tolerance)


def test_taking_nested_runs_for_independent_would_hide_what_differs(noise):
    (x_a, P_a), (x_b, P_b) = estimates(noise, list(range(50))), estimates(noise, list(range(60)))
    naive = np.sqrt(np.diag(P_a + P_b))
    assert np.all(np.std(x_a - x_b, axis=0) < 0.4 * naive)


def test_a_worse_estimator_on_the_same_data_differs_by_the_difference_of_the_variances(noise):
    weight = np.where(np.arange(N_EXPOSURES) % 2, 1.0, 4.0)  # unbiased, but not with the weights of the noise
    A = H.reshape(-1, N_PARAMETERS)
    W = np.repeat(weight, 4)
    inverse = np.linalg.inv(A.T @ (A * W[:, None]))
    x_a = noise.reshape(N_TRIALS, -1) @ (A * W[:, None]) @ inverse
    P_a = inverse @ (A.T @ (A * W[:, None] ** 2)) @ inverse
    x_b, P_b = estimates(noise, list(range(60)))
    D = covariance_of_difference(P_a, P_b, SharedData(1, 1))
    assert np.std(x_a - x_b, axis=0) == pytest.approx(np.sqrt(np.diag(D)), rel=0.06)


def test_the_joint_test_is_a_chi_square_where_the_runs_have_one_truth(noise):
    (x_a, P_a), (x_b, P_b) = estimates(noise, list(range(20))), estimates(noise, list(range(60)))
    D = covariance_of_difference(P_a, P_b, SharedData(1, 1 / 3))
    sigma = sigma_of_difference(P_a, P_b, D)
    tests = [joint_test(d, D, sigma) for d in (x_a - x_b)[:800]]
    assert {dof for _, dof, _ in tests} == {N_PARAMETERS}
    assert np.mean([p < 0.05 for _, _, p in tests]) == pytest.approx(0.05, abs=0.025)


def test_equal_estimates_of_the_same_data_have_no_noise_between_them(noise):
    _, P = estimates(noise, list(range(60)))
    D = covariance_of_difference(P, P * 1.001, SharedData(1, 1))
    sigma = sigma_of_difference(P, P, D)
    assert np.isnan(sigma).all()
    assert joint_test(np.ones(N_PARAMETERS), D, sigma) is None


def test_a_parameter_that_one_run_holds_fixed_differs_by_the_other_s_sigma():
    P_a, P_b = np.diag([4.0, 9.0]), np.diag([4.0, 0.0])
    D = covariance_of_difference(P_a, P_b, SharedData(1, 1))
    sigma = sigma_of_difference(P_a, P_b, D)
    assert np.isnan(sigma[0])
    assert sigma[1] == pytest.approx(3)


@given(st.floats(0, 1), st.floats(0, 1), st.floats(0.1, 10), st.floats(0.1, 10))
def test_a_covariance_is_never_negative_and_never_above_the_sum(share_a, share_b, scale_a, scale_b):
    P_a, P_b = scale_a * (np.eye(2) + 0.5), scale_b * (np.eye(2) + 0.8)
    shared = SharedData(share_a, share_b)
    D = covariance_of_difference(P_a, P_b, shared)
    assert np.linalg.eigvalsh(D).min() >= -1e-9
    assert np.all(np.diag(D) <= np.diag(P_a + P_b) + 1e-9)


@given(st.floats(0.01, 0.99), st.floats(0.1, 10))
def test_nested_data_are_the_limit_of_partly_shared_data(share, scale):
    P_a = scale * np.eye(2)
    P_b = share * P_a  # as much information a exposure
    nested = covariance_of_difference(P_a, P_b, SharedData(1, share))
    nearly = covariance_of_difference(P_a, P_b, SharedData(1 - 1e-9, share))
    assert nested == pytest.approx(nearly, abs=1e-6 * scale)


@pytest.mark.parametrize(
    ("shares", "kind"),
    [((0, 0), "disjoint"), ((1, 1), "same"), ((1, 0.3), "inside"), ((0.3, 1), "around"), ((0.5, 0.5), "partly")],
)
def test_shares_have_names(shares, kind):
    assert SharedData(*shares).kind == kind
