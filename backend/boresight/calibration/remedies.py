"""What would make weak directions known: a parameter to hold fixed, more frames, or stars elsewhere on the detector.

Holding parameter p strikes its row and column from the information A. The direction that is left open longest goes first: of all
parameters the one is held whose absence leaves the least known direction known best, until none is weak. Frames like these add to
A in proportion, so a direction known to s typical sigmas needs (s / `WEAK`)^2 times as many. What the detector shows of its own
coverage is how far out stars lie and how many of its parts hold any.
"""

from __future__ import annotations

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.estimation.batch import determined
from boresight.estimation.observability import WEAK, Observability

#: More frames are worth naming up to so many times those that are there.
MOST_TIMES = 100.0
#: Parts of the detector a side, for coverage.
PARTS = 6
#: Share of the parts, and of the way to the corner, below which coverage is called thin.
ENOUGH = 0.95


def remedies(
    A: FloatArray, observed: Observability, problem: Problem, frames: int, settings: CalibrationSettings
) -> list[str]:
    """Sentences that say what would help, the surest first; none where nothing is weak.

    Parameters
    ----------
    A
        (n_free, n_free) information of the set, in typical sigmas.
    observed
        Its directions.
    problem
        Stars that stand for the set's.
    frames
        Frames of the set.
    settings
        Whether a filter forgets, which more frames do not mend.
    """
    if not observed.weak():
        return []
    held = to_hold(A)
    forgets = settings.sequential and (settings.process_noise > 0 or settings.forgetting_factor < 1)
    return [*_of_holding(held, A, observed), *_of_coverage(problem), *([] if forgets else _of_frames(observed, frames))]


def to_hold(A: FloatArray) -> list[int]:
    """Places of the parameters that leave no weak direction when held, the first to hold first; all but one at most."""
    left, held = list(range(len(A))), list[int]()
    while len(left) > 1 and _worst(A, left) > WEAK:
        best = min(left, key=lambda p: _worst(A, [q for q in left if q != p]))
        left.remove(best)
        held.append(best)
    return held


def _worst(A: FloatArray, places: list[int]) -> float:
    """Sigma of the least known direction of some parameters alone, in typical sigmas; infinite where undetermined."""
    values, _, known = determined(A[np.ix_(places, places)])
    return float(1 / np.sqrt(values[0])) if known.all() else np.inf


def _of_holding(held: list[int], A: FloatArray, observed: Observability) -> list[str]:
    """Say which parameters to hold."""
    left = [p for p in range(len(A)) if p not in held]
    worst = _worst(A, left)
    if not held or worst > WEAK:
        return []
    names = [observed.symbols[p] for p in held]
    listed = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    by_then = "it is" if len(names) == 1 else "they are"
    sentence = (
        f"Hold {listed} fixed, and every direction of the others is known to {worst:.2g} typical sigmas or better; "
        f"what {by_then} wrong by then goes into the others."
    )
    return [sentence]


def _of_coverage(problem: Problem) -> list[str]:
    """Say where the detector has no stars."""
    sensor, arcs = problem.sensor, problem.arcs.whole()
    row, col = arcs.row_px - (sensor.rows - 1) / 2, arcs.col_px - (sensor.columns - 1) / 2
    reach = float(np.hypot(row, col).max() / (np.hypot(sensor.rows, sensor.columns) / 2))
    counts, _, _ = np.histogram2d(
        arcs.row_px, arcs.col_px, bins=PARTS, range=((-0.5, sensor.rows - 0.5), (-0.5, sensor.columns - 0.5))
    )
    filled = int(np.count_nonzero(counts))
    if reach >= ENOUGH and filled >= ENOUGH * PARTS**2:
        return []
    sentence = (
        f"Stars reach {100 * min(reach, 1.0):.0f} % of the way to the corner and lie in {filled} of {PARTS**2} parts of the "
        "detector: frames with stars in the others would help most."
    )
    return [sentence]


def _of_frames(observed: Observability, frames: int) -> list[str]:
    """Say how many frames like these would do."""
    times = float((observed.sigma_of_direction.max() / WEAK) ** 2)
    if not np.isfinite(times):
        return ["More frames like these would leave the same direction open."]
    if times > MOST_TIMES:
        return [f"Frames like these alone would not do: it would take {times:,.0f} times as many."]
    return [
        f"About {int(np.ceil(times * frames)):,} frames like these, in place of {frames:,}, would leave no weak direction."
    ]
