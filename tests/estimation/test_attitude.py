"""Rotations against SciPy's; Wahba's attitude and the mean rotation: exact without noise, as good as they claim with it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from boresight.estimation.attitude import (
    attitudes,
    conjugate,
    mean_rotation,
    product,
    rotation_vector,
    to_matrix,
    to_quaternion,
    triad,
    vector_to_quaternion,
    wahba,
)
from tests.strategies import rotations, unit_vectors


@given(C=rotations())
def test_matrix_to_quaternion_and_back_is_the_same_rotation_as_scipys(C):
    q = to_quaternion(C)
    np.testing.assert_allclose(to_matrix(q), C, atol=1e-14)
    np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), C, atol=1e-14)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)
    assert q[3] >= 0.0


@given(axis=unit_vectors())
def test_half_turns_keep_their_axis_where_the_scalar_part_vanishes(axis):
    C = 2 * np.outer(axis, axis) - np.eye(3)
    np.testing.assert_allclose(to_matrix(to_quaternion(C)), C, atol=1e-14)


@given(A=rotations(), B=rotations())
def test_the_product_turns_by_its_right_factor_first(A, B):
    np.testing.assert_allclose(to_matrix(product(to_quaternion(A), to_quaternion(B))), A @ B, atol=1e-14)
    np.testing.assert_allclose(to_matrix(conjugate(to_quaternion(A))), A.T, atol=1e-14)


@given(C=rotations())
def test_rotation_vectors_are_scipys_and_come_back(C):
    theta = rotation_vector(to_quaternion(C))
    np.testing.assert_allclose(Rotation.from_rotvec(theta).as_matrix(), C, atol=1e-12)
    np.testing.assert_allclose(to_matrix(vector_to_quaternion(theta)), C, atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-12, 1e-6, 0.1])
def test_tiny_turns_lose_no_digits_both_signs_give_the_short_one_and_a_quarter_about_z_takes_x_to_y(size):
    q = vector_to_quaternion(size * np.array([1.0, -2.0, 3.0]))
    np.testing.assert_allclose(rotation_vector(q), size * np.array([1.0, -2.0, 3.0]), rtol=1e-14, atol=0.0)
    np.testing.assert_allclose(rotation_vector(-q), size * np.array([1.0, -2.0, 3.0]), rtol=1e-14, atol=0.0)
    quarter = vector_to_quaternion(np.array([0.0, 0.0, np.pi / 2]))
    np.testing.assert_allclose(quarter, [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-15)
    np.testing.assert_allclose(to_matrix(quarter) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


def test_tables_keep_their_shape_and_their_gaps():
    q = np.random.default_rng(3).normal(size=(4, 5, 4))
    q[1, 2] = np.nan
    C = to_matrix(q)
    assert C.shape == (4, 5, 3, 3)
    assert np.isnan(C[1, 2]).all()
    assert np.isnan(to_quaternion(C)[1, 2]).all()
    assert np.isfinite(np.delete(C.reshape(20, 9), 7, axis=0)).all()


PARITIES = pytest.mark.parametrize("parity", [1, -1])


def field(rng, n=8, half_angle_rad=0.17):
    off = half_angle_rad * np.sqrt(rng.random(n))
    turn = 2 * np.pi * rng.random(n)
    return np.column_stack([np.sin(off) * np.cos(turn), np.sin(off) * np.sin(turn), np.cos(off)])


def noisy(s, sigma_rad, rng):
    error = rng.normal(size=s.shape) * sigma_rad[:, None]
    moved = s + error - s * np.sum(error * s, axis=1, keepdims=True)
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)


@given(C=rotations(), parity=st.sampled_from([1, -1]), n=st.integers(2, 20), seed=st.integers(0, 2**32 - 1))
def test_without_noise_the_attitude_is_exact_for_either_parity(C, parity, n, seed):
    rng = np.random.default_rng(seed)
    s_d = field(rng, n)
    s_d[0] = [0.1, 0.05, np.sqrt(1 - 0.0125)]
    s_d[1] = [-0.1, 0.02, np.sqrt(1 - 0.0104)]
    solved = wahba(s_d, triad(s_d, parity) @ C, rng.uniform(1e-5, 1e-3, n), parity)
    np.testing.assert_allclose(solved.C, C, atol=1e-12)
    np.testing.assert_allclose(to_matrix(solved.quaternion), C, atol=1e-12)
    assert solved.cost < 1e-15


@given(before=rotations(), after=rotations(), seed=st.integers(0, 2**32 - 1))
def test_turning_either_frame_turns_the_attitude_with_it(before, after, seed):
    rng = np.random.default_rng(seed)
    sigma = np.full(8, 1e-3)
    s_i = field(rng)
    s_d = noisy(s_i, sigma, rng)
    plain, turned = wahba(s_d, s_i, sigma), wahba(s_d @ after.T, s_i @ before, sigma)
    np.testing.assert_allclose(turned.C, after @ plain.C @ before, atol=1e-10)
    np.testing.assert_allclose(turned.covariance, after @ plain.covariance @ after.T, atol=1e-9 * 1e-3)
    assert turned.cost == pytest.approx(plain.cost, rel=1e-6)


@PARITIES
def test_the_attitude_has_the_error_it_claims_and_the_cost_is_chi_square(parity):
    rng = np.random.default_rng(41)
    n, runs = 7, 4000
    s_d, C = field(rng, n), to_matrix(rng.normal(size=4))
    sigma = rng.uniform(5e-5, 3e-4, n)
    start = np.arange(runs + 1) * n
    measured = noisy(np.tile(s_d, (runs, 1)), np.tile(sigma, runs), rng)
    solved = attitudes(start, measured, np.tile(triad(s_d, parity) @ C, (runs, 1)), np.tile(sigma, runs), parity)
    theta = rotation_vector(to_quaternion(solved.C @ C.T))
    nees = np.einsum("ni,nij,nj->n", theta, np.linalg.inv(solved.covariance), theta)
    assert chi2.ppf(0.005, 3 * runs) < nees.sum() < chi2.ppf(0.995, 3 * runs)
    spread = np.linalg.solve(np.linalg.cholesky(solved.covariance[0]), theta.T)
    np.testing.assert_allclose(np.cov(spread), np.eye(3), atol=0.09)
    dof = runs * (2 * n - 3)
    assert chi2.ppf(0.005, dof) < 2 * solved.cost.sum() < chi2.ppf(0.995, dof)


@PARITIES
def test_the_wrong_parity_leaves_a_cost_no_noise_explains(parity):
    rng = np.random.default_rng(42)
    s_d, sigma = field(rng), np.full(8, 1e-4)
    s_i = triad(s_d, parity) @ to_matrix(rng.normal(size=4))
    assert wahba(s_d, s_i, sigma, parity).cost < 1e-6
    assert wahba(s_d, s_i, sigma, -parity).cost > 1e3


APART = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, np.sqrt(0.99)]])


@pytest.mark.parametrize(
    ("s_d", "s_i"),
    [
        *((s, s) for s in (np.zeros((0, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.6, 0.8]] * 4))),
        (APART, APART[[0, 0]]),  # two measured directions of one star
    ],
)
def test_fewer_than_two_directions_give_no_attitude(s_d, s_i):
    assert wahba(s_d, s_i, np.full(len(s_d), 1e-4)) is None


def test_many_exposures_at_once_are_each_what_they_are_alone():
    rng = np.random.default_rng(43)
    start = np.array([0, 0, 5, 6, 14, 14])
    s_i, sigma = field(rng, 14), rng.uniform(1e-4, 1e-3, 14)
    s_d = noisy(s_i, sigma, rng)
    solved = attitudes(start, s_d, s_i, sigma)
    np.testing.assert_array_equal(solved.known, [False, True, False, True, False])
    for exposure in (1, 3):
        stars = slice(start[exposure], start[exposure + 1])
        alone = wahba(s_d[stars], s_i[stars], sigma[stars])
        np.testing.assert_allclose(solved.C[exposure], alone.C, atol=1e-12)
        np.testing.assert_allclose(solved.quaternion[exposure], alone.quaternion, atol=1e-12)
        np.testing.assert_allclose(solved.covariance[exposure], alone.covariance, rtol=1e-9)
    s_d[7] = np.nan  # a star without a direction leaves the other exposures their attitude
    assert attitudes(start, s_d, s_i, sigma).known.tolist() == [False, True, False, False, False]
    empty = np.zeros((0, 3))
    assert not attitudes(np.zeros(4, np.int64), empty, empty, np.zeros(0)).known.any()


@given(C=rotations(), seed=st.integers(0, 2**32 - 1), n=st.integers(1, 20))
def test_the_mean_is_blind_to_signs_and_turns_with_its_rotations(C, seed, n):
    rng = np.random.default_rng(seed)
    q = vector_to_quaternion(0.2 * rng.normal(size=(n, 3)))
    weights = rng.uniform(0.1, 1.0, n)
    mean = mean_rotation(q, weights)
    turned = mean_rotation(product(to_quaternion(C), q) * rng.choice([-1.0, 1.0], (n, 1)), weights)
    np.testing.assert_allclose(to_matrix(turned), C @ to_matrix(mean), atol=1e-9)


def test_the_mean_minimises_the_weighted_distance_between_matrices():
    rng = np.random.default_rng(44)
    q, weights = vector_to_quaternion(0.3 * rng.normal(size=(6, 3))), rng.uniform(0.1, 1.0, 6)
    mean = mean_rotation(q, weights)

    def distance(p):
        return float(np.sum(weights * np.sum((to_matrix(p) - to_matrix(q)) ** 2, axis=(1, 2))))

    for step in 1e-3 * np.vstack([np.eye(3), -np.eye(3)]):
        assert distance(product(vector_to_quaternion(step), mean)) > distance(mean)


@given(seed=st.integers(0, 2**32 - 1), half_angle_rad=st.floats(0.001, 1.0), parity=st.sampled_from([1, -1]))
def test_the_compiled_loop_equals_the_decomposition_by_numpy(seed, half_angle_rad, parity):
    rng = np.random.default_rng(seed)
    start = np.cumsum([0, *rng.integers(3, 12, size=5)])
    s_d, sigma = field(rng, start[-1], half_angle_rad), rng.uniform(1e-5, 1e-3, start[-1])
    s_i = noisy(field(rng, start[-1], half_angle_rad) if seed % 2 else s_d, sigma, rng)
    found = attitudes(start, s_d, s_i, sigma, parity)
    for k in np.flatnonzero(found.known):
        stars = slice(start[k], start[k + 1])
        measured, weight = triad(s_d[stars], parity), 1 / sigma[stars] ** 2
        U, s, Vt = np.linalg.svd((weight[:, None] * measured).T @ s_i[stars])
        d = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
        loose = 1e-14 * s[0] / (s[1] + d * s[2])  # what rounding does to the weakest axis
        np.testing.assert_allclose(found.C[k], U @ np.diag([1, 1, d]) @ Vt, atol=1e-13 + 50 * loose)
        information = weight.sum() * np.eye(3) - (weight[:, None] * measured).T @ measured
        np.testing.assert_allclose(found.covariance[k] @ information, np.eye(3), atol=1e-8)
