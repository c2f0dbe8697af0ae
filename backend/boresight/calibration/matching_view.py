"""The `matching` object of the calibration JSON: what was given, what was kept, what was found, and why the rest was not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.calibration.cycles import Ended, cycles_view
from boresight.calibration.detections import pixel_rad
from boresight.calibration.rematch import Matches
from boresight.sky.doubles import DOUBLE, UNRELIABLE
from boresight.sky.matching import EXPOSURE_REASONS, LEFT_OUT, ROW_REASONS, STARTS
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor


def matching_view(
    telemetry: Telemetry, sensor: Sensor, ended: Ended, evaluation: dict[str, Any]
) -> dict[str, Any] | None:
    """Describe the matches that an estimate stands on; None where the given ones stood.

    Parameters
    ----------
    telemetry
        The set as it came.
    ended
        Where the cycles ended.
    evaluation
        Of the set, initial against final: what the flight code would accept.
    """
    matches = ended.matched.matches
    if not isinstance(matches, Matches):
        return None
    given = np.zeros(len(telemetry), np.int64) if telemetry.star_id is None else np.maximum(telemetry.star_id, 0)
    named, found = given > 0, matches.star_id > 0
    kept = named & (matches.star_id == given)
    return {
        "given": int(named.sum()),
        "kept": int(kept.sum()),
        "added": int((found & ~named).sum()),
        "removed": int((named & ~kept).sum()),
        "renamed": int((named & found & ~kept).sum()),
        "matched": int(found.sum()),
        "cycles": cycles_view(ended),
        "rested": ended.rested,
        "tolerance_px": _spread(matches.tolerance_rad[found] / pixel_rad(sensor, ended.estimate.x)),
        "row_reasons": counted(matches.row_reason[~found], ROW_REASONS),
        "removed_reasons": counted(matches.row_reason[named & ~found], ROW_REASONS),
        "exposure_reasons": counted(matches.reason, EXPOSURE_REASONS),
        "starts": counted(matches.start, STARTS),
        "flagged": {
            "doubles": int((matches.flags & DOUBLE > 0).sum()),
            "unreliable": int((matches.flags & UNRELIABLE > 0).sum()),
            "left_out": int((matches.row_reason == LEFT_OUT).sum()),
        },
        "flight": {
            "tolerance_rad": evaluation["flight_tolerance_rad"],
            "availability": evaluation["availability"],
            "matched_stars": evaluation["matched_stars"],
        },
    }


def counted(places: NDArray[np.int8], phrases: Sequence[str]) -> dict[str, int]:
    """How often each phrase is meant, the most frequent first."""
    return {phrases[place]: count for place, count in Counter(places.tolist()).most_common()}


def _spread(values: NDArray[np.float64]) -> dict[str, float | None]:
    """Median and 95th percentile; nulls of nothing."""
    values = values[np.isfinite(values)]
    if not len(values):
        return {"median": None, "p95": None}
    median, p95 = np.percentile(values, [50, 95])
    return {"median": float(median), "p95": float(p95)}
