"""The arcs among the matches that a sighting accepts, on which two states are compared (E section III: "common pairs").

An exposure of which every star of an ordered set is accepted, and no other, keeps the order it has there: the order depends on
its stars alone, and finding it is most of the work. The others are ordered anew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from boresight.arrays import BoolArray, FloatArray
from boresight.calibration.problem import problem_of
from boresight.calibration.sighting import Sighting
from boresight.estimation.arcs import ArcSet
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

#: Directions of one star in one exposure that differ by less are the same, rad.
_SAME_RAD = 1e-12


def common_arcs(
    telemetry: Telemetry, sensor: Sensor, seen: Sighting, minimum_stars: int, ordered: ArcSet | None = None
) -> list[ArcSet]:
    """Arcs among the accepted matches of a sighting's valid exposures.

    Parameters
    ----------
    telemetry, sensor
        The set that was seen.
    seen
        Under one state.
    minimum_stars
        Of an exposure that counts.
    ordered
        Arcs of the same telemetry that are there already, weighed or not; None orders all.

    Returns
    -------
    Sets that have no exposure in common, and together all of them; of the exposures of one frame some may be in either.
    """
    s_i = np.where(seen.taken()[:, None], seen.matches.s_i, np.nan)
    found = list[ArcSet]()
    if ordered is not None:
        same = _unchanged(ordered, seen, s_i)
        found.append(ordered.exposures(same))
        s_i[found[0].source_row] = np.nan
    found.append(problem_of(replace(telemetry, star_id=None), sensor, s_i, minimum_stars).arcs.whole())
    return [arcs for arcs in found if arcs.n_exposures]


def _unchanged(ordered: ArcSet, seen: Sighting, s_i: FloatArray) -> BoolArray:
    """Which exposures of an ordered set hold just the stars (n_rows, 3) that are taken, (n_exposures,)."""
    if not ordered.n_exposures:
        return np.zeros(0, np.bool_)
    starts = ordered.star_start[:-1]
    taken = np.isfinite(s_i[:, 0])
    counts = np.add.reduceat(taken, seen.matches.exposure_start[:-1], dtype=np.int64)
    exposure = np.searchsorted(seen.matches.exposure_start, ordered.source_row[starts], side="right") - 1
    away = np.abs(s_i[ordered.source_row] - ordered.s_i)
    same = (away[:, 0] < _SAME_RAD) & (away[:, 1] < _SAME_RAD) & (away[:, 2] < _SAME_RAD)  # NaN is not
    whole = np.logical_and.reduceat(same, starts)
    return np.asarray(whole & (counts[exposure] == np.diff(ordered.star_start)))
