"""Rotations written three ways: matrix, quaternion, rotation vector; one sense for all of them.

A quaternion q = (x, y, z, w) is Hamilton's, scalar last, and C(q) turns vectors: with v = (x, y, z),

    C(q) s = s + 2 w v × s + 2 v × (v × s)            s_d = C(q) s_i            C(p ⊗ q) = C(p) C(q)

q and -q are one rotation; those made here have w >= 0. A rotation vector θ turns by |θ| about θ, so for a small one

    C(θ) s = s + θ × s.

An attitude error is the θ of C(θ) = C_estimated C_true^T: it stands on the left, and its axes are the detector's.

A library that turns the axes and not the vectors (JPL quaternions) means the conjugate. SciPy's `Rotation.from_quat(q)` has the
sense used here and is what the tests hold these lines against; it is not called, because it refuses a table in which
some attitudes are NaN, and costs 0.4 s to import.

Reference: Markley & Crassidis, Fundamentals of Spacecraft Attitude Determination and Control, 2014, sections 2.7 and 2.9.
"""

from __future__ import annotations

import numpy as np

from boresight.arrays import FloatArray


def matrix_of(q: FloatArray) -> FloatArray:
    """Matrices C(q), (..., 3, 3), of quaternions (..., 4) of any length but zero; NaN stays NaN."""
    q = np.asarray(q, dtype=np.float64)
    x, y, z, w = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_of(C: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4), w >= 0, of proper rotation matrices (..., 3, 3); NaN stays NaN.

    4 q q^T is linear in C. Its longest column is 4 q times the largest component of q, which is never small (Shepperd).
    """
    C = np.asarray(C, dtype=np.float64)
    outer = np.empty((*C.shape[:-2], 4, 4))
    diagonal = np.diagonal(C, axis1=-2, axis2=-1)
    trace = diagonal.sum(axis=-1)
    outer[..., :3, :3] = C + np.swapaxes(C, -1, -2)
    for k in range(3):
        outer[..., k, k] = 1 + 2 * diagonal[..., k] - trace
        outer[..., k, 3] = outer[..., 3, k] = C[..., k - 1, k - 2] - C[..., k - 2, k - 1]
    outer[..., 3, 3] = 1 + trace
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., 3:] < 0, -q, q))


def product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Hamilton's product p ⊗ q, (..., 4): q turns first."""
    v, w = p[..., :3], p[..., 3:]
    u, t = q[..., :3], q[..., 3:]
    vector = w * u + t * v + np.cross(v, u)
    return np.concatenate([vector, w * t - np.sum(v * u, axis=-1, keepdims=True)], axis=-1)


def conjugate(q: FloatArray) -> FloatArray:
    """The inverse rotation of unit quaternions (..., 4)."""
    return np.asarray(q * np.array([-1.0, -1.0, -1.0, 1.0]))


def rotation_vector(q: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3), rad, |θ| <= π, of unit quaternions (..., 4)."""
    q = np.where(q[..., 3:] < 0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., 3:])
    return np.asarray(q[..., :3] * np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine != 0))


def quaternion_of_vector(theta: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4) of rotation vectors (..., 3), rad."""
    half = 0.5 * np.linalg.norm(theta, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(half / np.pi) * theta, np.cos(half)], axis=-1)
