"""Rotations are held against SciPy's, and their sense against the notation page."""

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

from boresight.estimation.attitude import (
    conjugate,
    product,
    rotation_vector,
    to_matrix,
    to_quaternion,
    vector_to_quaternion,
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


def test_a_positive_turn_about_z_takes_x_to_y():
    quarter = vector_to_quaternion(np.array([0.0, 0.0, np.pi / 2]))
    np.testing.assert_allclose(quarter, [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-15)
    np.testing.assert_allclose(to_matrix(quarter) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


@given(C=rotations())
def test_rotation_vectors_are_scipys_and_come_back(C):
    theta = rotation_vector(to_quaternion(C))
    np.testing.assert_allclose(Rotation.from_rotvec(theta).as_matrix(), C, atol=1e-12)
    np.testing.assert_allclose(to_matrix(vector_to_quaternion(theta)), C, atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-12, 1e-6])
def test_tiny_turns_lose_no_digits(size):
    theta = size * np.array([1.0, -2.0, 3.0])
    np.testing.assert_allclose(rotation_vector(vector_to_quaternion(theta)), theta, rtol=1e-15, atol=0.0)


def test_both_signs_of_a_quaternion_give_the_short_turn():
    q = vector_to_quaternion(np.array([0.1, 0.2, -0.3]))
    np.testing.assert_allclose(rotation_vector(-q), [0.1, 0.2, -0.3], rtol=1e-14)


def test_tables_keep_their_shape_and_their_gaps():
    q = np.random.default_rng(3).normal(size=(4, 5, 4))
    q[1, 2] = np.nan
    C = to_matrix(q)
    assert C.shape == (4, 5, 3, 3)
    assert np.isnan(C[1, 2]).all()
    assert np.isnan(to_quaternion(C)[1, 2]).all()
    assert np.isfinite(np.delete(C.reshape(20, 9), 7, axis=0)).all()
