"""Shadow mode: baseline and candidate parameters side by side on every frame, and what each would have lost.

Both states see the same set (`calibration.matching.matched_frames`). A star is lost in a frame when the baseline's valid exposures
held it and the
candidate's do not, gained the other way round. Whether the candidate is available more often is McNemar's question: of the frames
that one state alone solves, b the baseline's and c the candidate's, as many would fall to each if they were alike, and b is
binomial,

    p = min(1, 2 P(B <= min(b, c))),    B ~ Bin(b + c, 1/2)                                    (exact, two-sided).

The test takes frames as independent; where neighbours fail together p is too small, and the interval of the availability, which is
resampled in blocks, is the one to believe.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import bdtr

from boresight.arrays import BoolArray, IntArray
from boresight.calibration.matching.matched_frames import MatchedFrames
from boresight.telemetry.schema import Telemetry

#: Frames kept one by one; the summary is of all.
MOST_FRAMES = 2000
#: Of these, at most so many places are kept for frames that one state alone solves.
MOST_DIFFERING = 1000


def shadow_view(telemetry: Telemetry, baseline: MatchedFrames, candidate: MatchedFrames) -> dict[str, Any]:
    """Set two sightings of one set side by side.

    Returns dict with `frames`, one object a frame and at most `MOST_FRAMES` of them, those that differ first; `frames_in_set`;
    `flight_tolerance_rad`; and `summary` of all frames.
    """
    lost, gained = _moved(baseline, candidate), _moved(candidate, baseline)
    ends = np.searchsorted(telemetry.frame, baseline.view.frames, side="right")
    rows = np.stack([np.append(0, ends[:-1]), ends], axis=1)
    reasons = baseline.frame_reasons, candidate.frame_reasons
    return {
        "frames": [
            {
                "frame": int(baseline.view.frames[k]),
                "time_utc": _time(telemetry, rows[k, 0]),
                "baseline": _side(baseline, k, reasons[0]),
                "candidate": _side(candidate, k, reasons[1]),
                "lost": _ids(baseline, lost, rows[k]),
                "gained": _ids(candidate, gained, rows[k]),
            }
            for k in _kept(baseline.view.valid_frames, candidate.view.valid_frames)
        ],
        "frames_in_set": len(rows),
        "flight_tolerance_rad": candidate.tolerance_rad,
        "summary": summary(baseline.view.valid_frames, candidate.view.valid_frames, int(lost.sum()), int(gained.sum())),
    }


def _moved(here: MatchedFrames, there: MatchedFrames) -> BoolArray:
    """Rows (n_rows,) whose star one sighting's valid exposures hold and the other's do not."""
    held, kept = here.taken(), there.taken()
    return np.asarray(held & ~(kept & (here.matches.star_id == there.matches.star_id)))


def _kept(baseline: BoolArray, candidate: BoolArray) -> IntArray:
    """Which frames to keep, ascending: those that one state alone solves first, then evenly over the set."""
    differing = _thinned(np.flatnonzero(baseline != candidate), MOST_DIFFERING)
    return np.union1d(differing, _thinned(np.arange(len(baseline)), MOST_FRAMES - len(differing)))


def _thinned(places: IntArray, most: int) -> IntArray:
    """At most so many places, evenly spaced."""
    if len(places) <= most:
        return places
    return places[np.linspace(0, len(places) - 1, most).round().astype(np.int64)]


def _time(telemetry: Telemetry, row: int) -> str | None:
    """When a frame was taken, ISO 8601."""
    if telemetry.time_utc is None or np.isnat(telemetry.time_utc[row]):
        return None
    return f"{telemetry.time_utc[row]}Z"


def _side(seen: MatchedFrames, k: int, reasons: list[str]) -> dict[str, Any]:
    """One state's answer to frame k."""
    valid = bool(seen.view.valid_frames[k])
    return {"valid": valid, "matched": int(seen.view.matched_in_frame[k]), "reason": None if valid else reasons[k]}


def _ids(seen: MatchedFrames, moved: BoolArray, rows: IntArray) -> list[int]:
    """Star numbers of the rows of a frame that moved; 0 where the file gives a direction and no number."""
    first, last = rows
    ids: list[int] = seen.matches.star_id[first:last][moved[first:last]].tolist()
    return ids


def summary(baseline: BoolArray, candidate: BoolArray, stars_lost: int, stars_gained: int) -> dict[str, Any]:
    """Count what each state alone solves.

    `baseline`, `candidate`: (n_frames,) whether each frame is available. `stars_lost`, `stars_gained`: sightings of stars that
    only the baseline, and only the candidate, accepts.
    """
    b, c = int(np.sum(baseline & ~candidate)), int(np.sum(candidate & ~baseline))
    p = mcnemar(b, c)
    return {
        "baseline_only": b,
        "candidate_only": c,
        "both": int(np.sum(baseline & candidate)),
        "neither": int(np.sum(~baseline & ~candidate)),
        "stars_lost": stars_lost,
        "stars_gained": stars_gained,
        "p": p,
        "sentence": _sentence(b, c, p, stars_lost, stars_gained),
    }


def mcnemar(b: int, c: int) -> float:
    """McNemar's exact test, two-sided: how likely so uneven a split is when both states are available equally often."""
    return min(1.0, 2.0 * float(bdtr(min(b, c), b + c, 0.5)))


def _sentence(b: int, c: int, p: float, stars_lost: int, stars_gained: int) -> str:
    """The summary in words."""
    stars = f"{stars_gained:,} sightings of stars are gained and {stars_lost:,} lost"
    if b == c == 0:
        return f"Both parameter sets solve the same frames; {stars}."
    lost, won = f"loses {_frames(b)} that the baseline solves", f"solves {_frames(c)} that the baseline loses"
    first, second = (won, lost) if c >= b else (lost, won)
    doubt = "" if p < 0.05 else ", which chance alone would explain"
    return f"The candidate {first} and {second} (exact test, p = {p:.2g}{doubt}); {stars}."


def _frames(count: int) -> str:
    """So many frames, in words."""
    return "no frame" if count == 0 else f"{count:,} frame{'s' * (count != 1)}"
