"""Matching as an engineer would write it with SciPy alone: the yardstick of the matching loops in `studies.speed`.

Exposure by exposure: attitude by `Rotation.align_vectors` from the named stars, the catalogue's stars of the field from
a k-d tree, each detection its nearest star inside one fixed tolerance, then arcs pair by pair, the worst offender dropped first,
and the attitude again. Apparent places are taken once for the set. There is no parameter covariance in it, no second exposure,
no doubt between two stars: it does less than the product does.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from boresight.arrays import FloatArray, IntArray


def scipy_match(
    row_start: IntArray,
    s_d: FloatArray,
    given: IntArray,
    hip: IntArray,
    s_i: FloatArray,
    cone_rad: float,
    tolerance_rad: float,
) -> IntArray:
    """Match every exposure that has two named stars.

    Parameters
    ----------
    row_start
        (n_exposures + 1,) first detection of each exposure.
    s_d
        (n_rows, 3) measured directions, right-handed.
    given
        (n_rows,) star numbers given, 0 = none.
    hip, s_i
        (n_stars,) numbers, ascending, and (n_stars, 3) apparent directions of the catalogue's stars.
    cone_rad
        Angle from the boresight to the farthest corner of the detector.
    tolerance_rad
        Largest distance of a match from its predicted place, and of an arc from the catalogue's.

    Returns
    -------
    (n_rows,) star numbers, 0 = none.
    """
    matched, sky = np.zeros_like(given), KDTree(s_i)
    for first, last in itertools.pairwise(row_start):
        rows = slice(first, last)
        named = np.flatnonzero(given[rows] > 0)
        if len(named) >= 2:
            stars = np.searchsorted(hip, given[rows][named])
            turn, _ = Rotation.align_vectors(s_d[rows][named], s_i[stars])
            matched[rows] = _exposure(s_d[rows], turn, sky, hip, s_i, cone_rad, tolerance_rad)
    return matched


def _exposure(
    s_d: FloatArray, turn: Rotation, sky: KDTree, hip: IntArray, s_i: FloatArray, cone_rad: float, tolerance_rad: float
) -> IntArray:
    """Match one exposure from its attitude: (n,) star numbers, 0 = none."""
    field = np.array(sky.query_ball_point(turn.as_matrix()[2], 2 * np.sin(cone_rad / 2)))
    distance, nearest = KDTree(turn.apply(s_i[field])).query(s_d)
    found = np.flatnonzero(distance < tolerance_rad)
    star = field[nearest[found]]
    agree = np.abs(_arcs(s_d[found]) - _arcs(s_i[star])) <= tolerance_rad
    kept = np.arange(len(found))
    while len(kept) and not agree[np.ix_(kept, kept)].all():
        kept = np.delete(kept, np.argmin(agree[np.ix_(kept, kept)].sum(axis=0)))
    if len(kept) >= 2:
        Rotation.align_vectors(s_d[found[kept]], s_i[star[kept]])
    matched = np.zeros(len(s_d), np.int64)
    matched[found[kept]] = hip[star[kept]]
    return matched


def _arcs(s: FloatArray) -> FloatArray:
    """Angles (n, n) between unit vectors (n, 3)."""
    return np.asarray(2 * np.arcsin(np.clip(np.linalg.norm(s[:, None] - s, axis=-1) / 2, 0.0, 1.0)))
