"""Attitudes carried on from solved frames to those between and beyond them, at constant rate.

With C_a, C_b the attitudes of the two nearest solved frames at times t_a < t_b and q = (t - t_a) / (t_b - t_a),

    C(t) = exp(-q [phi]x) C_a,    exp(-[phi]x) = C_b C_a^T

which is a slerp between them and goes on beyond. A tracker that stares at the Earth turns four degrees a minute, so holding the
last attitude would not do; where the turn is not constant the answer is wrong, and the search that starts from it finds nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.estimation.rotations import conjugate, product, quaternion_of, quaternion_of_vector, rotation_vector

#: Frames are carried on at most so many sample periods.
FARTHEST = 4


def carried_on(
    frame_start: IntArray, time_s: FloatArray, valid: NDArray[np.bool_], C: FloatArray, lost: IntArray
) -> tuple[FloatArray, IntArray]:
    """Predict the attitudes of lost frames.

    Parameters
    ----------
    frame_start
        (n_frames + 1,) first exposure of each frame.
    time_s
        (n_frames,) seconds, NaN where unknown.
    valid, C
        (n_exposures,) which exposures are solved and (n_exposures, 3, 3) their attitudes.
    lost
        Frames without a solved exposure.

    Returns
    -------
    hint
        (n_exposures, 4) quaternions x y z w, NaN where nothing can be said.
    hinted
        The lost frames of which something can be.
    """
    hint = np.full((len(valid), 4), np.nan)
    frame = np.repeat(np.arange(len(frame_start) - 1), np.diff(frame_start))
    solved, place = np.unique(frame[valid], return_index=True)
    exposure = np.flatnonzero(valid)[place]
    timed = np.isfinite(time_s[solved])
    solved, exposure = solved[timed], exposure[timed]
    if len(solved) <= 1:  # a rate needs two frames
        return hint, np.empty(0, np.int64)
    reach = FARTHEST * float(np.nanmedian(np.diff(time_s)))
    hinted = []
    for k in lost[np.isfinite(time_s[lost])]:
        second = int(np.clip(np.searchsorted(solved, k), 1, len(solved) - 1))
        t = time_s[solved[[second - 1, second]]]
        if np.abs(t - time_s[k]).min() > reach or t[1] <= t[0]:
            continue
        share = float((time_s[k] - t[0]) / (t[1] - t[0]))
        hint[frame_start[k] : frame_start[k + 1]] = _turned(C[exposure[second - 1]], C[exposure[second]], share)
        hinted.append(k)
    return hint, np.array(hinted, np.int64)


def _turned(C_a: FloatArray, C_b: FloatArray, share: float) -> FloatArray:
    """Quaternion of C_a turned on by a share of the turn from C_a to C_b."""
    q_a, q_b = quaternion_of(C_a), quaternion_of(C_b)
    turn = rotation_vector(product(q_b, conjugate(q_a)))
    return product(quaternion_of_vector(share * turn), q_a)
