"""What the newest calibration of a sensor would change: availability, matched stars and RMS, before and after, with intervals.

The validation set is quoted where the run had one, for it took no part in the estimate; else the calibration set.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from boresight.errors import ConflictError, NotFoundError
from boresight.services import runs
from boresight.store.blobs import BlobStore
from boresight.store.sessions import Session
from boresight.store.tables import Run
from boresight.verdicts.numbers import MISSING, NARROW_SPACE, fixed, is_number, urad

#: How many of the newest finished runs are looked at for one with a validation set.
LOOKED_AT = 20


@dataclass(frozen=True)
class Score:
    """One row: what it is, its unit, and before and after as printed, each with its 95 % interval or nothing."""

    name: str
    unit: str
    before: str
    before_interval: str
    after: str
    after_interval: str


@dataclass(frozen=True)
class BeforeAfter:
    """The newest result of a sensor, judged on a set.

    Parameters
    ----------
    run
        The run it is of.
    judged_on
        `validation` or `calibration`.
    scores
        The table.
    tolerance_urad
        Of the simulated check of the flight code, as printed; a dash where there was none.
    """

    run: Run
    judged_on: str
    scores: Sequence[Score]
    tolerance_urad: str


def before_after(session: Session, blobs: BlobStore, sensor_id: int) -> BeforeAfter | None:
    """Return what the newest finished run of a sensor would change, one with a validation set first; None without a run."""
    for run in runs.newest_finished(session, sensor_id, LOOKED_AT):
        try:
            result = runs.result(session, blobs, run.id)
        except (ConflictError, NotFoundError):  # its file is gone or no calibration; an older run may still have one
            continue
        if result is not None and (judged := judged_on(result)) is not None:
            whose, evaluation = judged
            return BeforeAfter(run, whose, scores(evaluation), urad(evaluation.get("flight_tolerance_rad"), 3))
    return None


def judged_on(result: Mapping[str, Any]) -> tuple[str, Mapping[str, Any]] | None:
    """Return the set that a result is judged on and its scores, in the shape of an evaluation; None where nothing is."""
    for key, whose in (("validation", "validation"), ("evaluation", "calibration")):
        if result.get(key):
            return whose, result[key]
    if (result.get("rms_arc_rad") or {}).get("final") is None:
        return None
    return "calibration", {"rms_arc_rad": result["rms_arc_rad"]}


def scores(evaluation: Mapping[str, Any]) -> list[Score]:
    """Print the scores of an evaluation, those that it has."""
    intervals = evaluation.get("intervals") or {}
    available, rms = evaluation.get("availability") or {}, evaluation.get("rms_arc_rad") or {}
    reach_available, reach_rms = intervals.get("availability") or {}, intervals.get("rms_arc_rad") or {}
    ratio, reach = evaluation.get("matched_star_ratio"), intervals.get("matched_star_ratio")
    rows = [
        _score("Availability", "%", available, reach_available, 100.0, 1),
        _score("Matched star ratio", "", {"initial": 1.0, "final": ratio}, {"final": reach}, 1.0, 2),
        _score("RMS arc error", "µrad", rms, reach_rms, 1e6, 1),
    ]
    return [row for row in rows if row.after != MISSING]


def _score(
    name: str, unit: str, values: Mapping[str, Any], reach: Mapping[str, Any], factor: float, decimals: int
) -> Score:
    """Print one score, `factor` from SI to its unit."""
    printed = [
        text
        for side in ("initial", "final")
        for text in (_number(values.get(side), factor, decimals), _interval(reach.get(side), factor, decimals))
    ]
    return Score(name, unit, *printed)


def _number(value: Any, factor: float, decimals: int) -> str:
    return fixed(value * factor, decimals) if is_number(value) else MISSING


def _interval(ends: Sequence[Any] | None, factor: float, decimals: int) -> str:
    """Print an interval; nothing where none is known, one end where the other is not."""
    if not ends or not is_number(ends[0]):
        return ""
    if not is_number(ends[1]):
        return f"over {_number(ends[0], factor, decimals)}"
    return f"{NARROW_SPACE}to{NARROW_SPACE}".join(_number(end, factor, decimals) for end in ends)
