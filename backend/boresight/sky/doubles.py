"""Stars to be careful with: doubles that one image blends, and stars whose catalogue place may not be where they are.

Two stars nearer than the blend radius make one image, with its centroid between them by brightness. A companion m magnitudes
fainter, at separation d, pulls it by d / (1 + 10^(0.4 m)): beyond `FAINTER_MAG` = 3 by less than d / 16, and the star is left in
peace. The brighter of a pair is flagged only by a companion that close in brightness, the fainter always.

A Hipparcos solution of another type than 5 (single star, five parameters) says that the star moves in another way: types 7 and 9
accelerate, type 3 moves its light between components, type 1 scatters more than its errors say.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from boresight.sky.catalogue import SINGLE_STAR, Catalogue

FAINTER_MAG = 3.0
UNRELIABLE, DOUBLE = 1, 2
#: Bits of `star_flags` and what they mean.
FLAGS = {UNRELIABLE: "unreliable astrometry", DOUBLE: "double"}


def star_flags(catalogue: Catalogue, blend_rad: float) -> NDArray[np.int8]:
    """Flag every star of a catalogue.

    Parameters
    ----------
    blend_rad
        Separation below which two stars make one image: some pixels wide.

    Returns
    -------
    (n_stars,) sums of the bits of `FLAGS`, 0 = nothing against it.
    """
    flags = np.where(catalogue.solution_type == SINGLE_STAR, 0, UNRELIABLE).astype(np.int8)
    flags[_blended(catalogue, blend_rad)] |= DOUBLE
    return flags


def phrases(flag: int) -> list[str]:
    """What is against a star with this flag, in words."""
    return [phrase for bit, phrase in FLAGS.items() if flag & bit]


def _blended(catalogue: Catalogue, blend_rad: float) -> NDArray[np.int64]:
    """Stars, some more than once, with a companion within the radius that is brighter or at most `FAINTER_MAG` fainter."""
    if len(catalogue) < 2:
        return np.empty(0, np.int64)
    cos_dec = np.cos(catalogue.dec_rad)
    place = np.column_stack(
        [cos_dec * np.cos(catalogue.ra_rad), cos_dec * np.sin(catalogue.ra_rad), np.sin(catalogue.dec_rad)]
    )
    a, b = KDTree(place).query_pairs(2 * np.sin(blend_rad / 2), output_type="ndarray").T
    fainter_by = catalogue.magnitude[b] - catalogue.magnitude[a]
    return np.concatenate([a[fainter_by <= FAINTER_MAG], b[-fainter_by <= FAINTER_MAG]])
