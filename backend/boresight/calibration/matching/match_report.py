"""Fit, match again, fit: until the matches rest, or three times (E section II-B), and what matching changed.

A cycle is one fit; after it the set is matched with the result, and when no star changes, the matches rest. A filter that
matches with its latest state does the same frame by frame, and is judged by the set as its end state matches it. Of the rows
that the file names a star for, a match is *kept* when the number is the same, *changed* when it is another, *removed* when
there is none any more; of the others it is *added* when there is one now.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import BoolArray, IntArray
from boresight.calibration.advice_kinds import Advice
from boresight.calibration.calibration import (
    Cycle,
    Evaluation,
    FlaggedStars,
    FlightScores,
    Matching,
    RemovedStar,
    Tolerance,
)
from boresight.calibration.estimate import Asked, Estimate, Parameters, ReportEstimate, run_batch
from boresight.calibration.matching.matched import Dataset, Matched
from boresight.calibration.matching.matched_frames import MatchedFrames
from boresight.calibration.matching.rematch import Matches, pixel_rad
from boresight.calibration.matching.verification import MOST_LISTED
from boresight.calibration.minima import LowerMinimum
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.sequence import finished, run_sequential, standing_frames
from boresight.estimation.metrics import rms
from boresight.sky.guide_stars import DOUBLE, UNRELIABLE
from boresight.sky.matching import BLENDED, EXPOSURE_REASONS, LEFT_OUT, ROW_REASONS, STARTS
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

MOST_CYCLES = 3
#: Given stars are only refused and taken back, which is quick; with every tenth identity wrong they rest after five or six cycles.
MOST_GIVEN_CYCLES = 12


@dataclass(frozen=True)
class CyclesEnd:
    """Where the cycles ended: the set and estimate that belong together, every cycle, and whether the matches rest.

    `method_s` is the processor time of the method alone in its last cycle, matching left out.
    """

    matched: Matched
    estimate: Estimate
    cycles: tuple[Cycle, ...] = ()
    rested: bool = True
    method_s: float = 0.0

    def judged_by(self, matched: Matched) -> CyclesEnd:
        """Put what is in memory of the set, all or a sample, in its place, and of a filter's updates those that are of it."""
        history, frame = self.estimate.history, matched.problem.arcs.frame
        if history is not None and len(frame) < self.matched.problem.arcs.n_frames:
            history = history.select_frames(frame)
        return replace(self, matched=matched, estimate=replace(self.estimate, history=history))


@dataclass(frozen=True)
class Estimation:
    """What a set is estimated from: its first matches, what is free, the settings, who listens and who may stop it."""

    sets: Dataset
    first: Matched
    parameters: Parameters
    settings: CalibrationSettings
    listen: ReportEstimate
    cancelled: Asked

    def run(self) -> CyclesEnd:
        """Run the estimator of the settings on the set's matches until they rest."""
        return self._filtered() if self.settings.sequential else self.fit_in_cycles()

    def fit_in_cycles(self, begin: LowerMinimum | None = None, restarts: int = 0) -> CyclesEnd:
        """Fit, match again, fit; `begin`: where judging a former estimate led to, and how often one has."""
        sets, matched, cycles = self.sets, self.first, list[Cycle]()
        while True:
            began = time.thread_time()
            estimate = run_batch(
                matched.problem, self.parameters, self.settings, self.listen, self.cancelled, begin, restarts
            )
            method_s = time.thread_time() - began
            if estimate.status == "diverged":
                return CyclesEnd(matched, estimate, tuple(cycles), sets.is_given, method_s)
            again = sets.at(estimate, matched.problem)
            changed = sets.changed(matched, again)
            if sets.is_given and not changed:  # the arcs are the same, the probabilities are those under this estimate
                return CyclesEnd(again, estimate, tuple(cycles), method_s=method_s)
            cycles.append(_cycle(len(cycles) + 1, changed, matched, again, estimate))
            done = len(cycles) == (MOST_GIVEN_CYCLES if sets.is_given else MOST_CYCLES)
            if changed == 0 or done or again.problem.arcs.n_exposures == 0:
                return CyclesEnd(matched, estimate, tuple(cycles), changed == 0, method_s)
            matched = again

    def _filtered_on_given(self) -> CyclesEnd:
        """Run a filter on given stars, and again without those that its end refuses.

        A filter takes each frame in once and cannot take a star back, so where any is refused the batch, which costs less than
        the filter, finds beside it which stars stand. A clean set costs one look at the filter's end.
        """
        matched, cycles = self.first, tuple[Cycle, ...]()
        if len(matched.refused):
            settled = self._settled_by_batch(matched)
            matched, cycles = settled.matched, settled.cycles
        ended = self._filtered_once(matched)
        if ended.estimate.status == "diverged" or cycles:
            return replace(ended, cycles=cycles)
        last = ended.estimate.history.last if ended.estimate.history is not None else None
        again = matched if last is None else self.sets.at_covariance(last.x, last.P)
        if not self.sets.changed(matched, again):
            return replace(ended, matched=again)
        if again.problem.arcs.n_exposures == 0:
            return replace(ended, rested=False)
        settled = self._settled_by_batch(again)
        return replace(self._filtered_once(settled.matched), cycles=settled.cycles, rested=settled.rested)

    def _settled_by_batch(self, first: Matched) -> CyclesEnd:
        """Find which of the given stars stand, by the batch."""
        batch = replace(self.settings, method="batch", variant="no-q")
        return replace(self, first=first, settings=batch, listen=lambda *_: None).fit_in_cycles()

    def _filtered_once(self, matched: Matched) -> CyclesEnd:
        """Run a filter over matches that stand."""
        problem, began = matched.problem, time.thread_time()
        frames = standing_frames(problem)
        history = run_sequential(frames, problem, self.parameters, self.settings, self.listen, self.cancelled)
        method_s = time.thread_time() - began
        return CyclesEnd(matched, finished(problem, self.parameters, history), method_s=method_s)

    def _filtered(self) -> CyclesEnd:
        """Run a filter, on the baseline's matches or on those of its latest state."""
        sets, first, parameters = self.sets, self.first, self.parameters
        if sets.is_given:
            return self._filtered_on_given()
        if self.settings.matched_with != "latest":
            return self._filtered_once(first)
        began = time.thread_time()
        history = run_sequential(sets.frames(), first.problem, parameters, self.settings, self.listen, self.cancelled)
        method_s = time.thread_time() - began - sets.matching_s
        if not history.finite:
            return CyclesEnd(first, finished(first.problem, parameters, history), method_s=method_s)
        last = sets.at_covariance(history.last.x, history.last.P)
        if last.problem.arcs.n_exposures == 0:
            return CyclesEnd(first, finished(first.problem, parameters, history), rested=False, method_s=method_s)
        estimate = finished(last.problem, parameters, history)
        return CyclesEnd(
            last, estimate, (_cycle(1, sets.changed(first, last), first, last, estimate),), method_s=method_s
        )


def _cycle(number: int, changed: int, before: Matched, after: Matched, estimate: Estimate) -> Cycle:
    value = rms(before.problem.whitened(estimate.x), estimate.x)
    return Cycle(
        cycle=number,
        matched=before.problem.arcs.n_stars,
        rematched=after.problem.arcs.n_stars,
        changed=changed,
        rms_arc_rad=value if np.isfinite(value) else None,
    )


#: Given identities below which their share says nothing.
FEWEST_NAMES = 20

SCHEMA = "boresight.matching/1"
#: Reason of a row that matching found a star for and the flight code would not accept.
NOT_ACCEPTED = "not accepted by the flight code"


def matched_stars(matches: Matches, seen: MatchedFrames | None) -> tuple[IntArray, list[str]]:
    """Star number of every row, 0 = unmatched, and why it has none, (n_rows,) each; `seen` to keep what the flight code accepts."""
    reasons = [ROW_REASONS[place] for place in matches.row_reason]
    if seen is None:
        return matches.star_id, reasons
    taken = seen.taken()
    rejected = (matches.star_id > 0) & ~taken
    return np.where(taken, matches.star_id, 0), [
        NOT_ACCEPTED if no else reason for no, reason in zip(rejected, reasons, strict=True)
    ]


def match_report(
    telemetry: Telemetry, sensor: Sensor, matches: Matches, seen: MatchedFrames | None = None
) -> dict[str, Any]:
    """Count what changed, and list every exposure with its attitude."""
    star_id, why = matched_stars(matches, seen)
    given = np.zeros(len(telemetry), np.int64) if telemetry.star_id is None else telemetry.star_id
    removed = (given > 0) & (star_id == 0)
    valid = matches.valid if seen is None else seen.view.valid
    counts = np.add.reduceat(star_id > 0, matches.exposure_start[:-1], dtype=np.int64)
    exposures = [_exposure(matches, seen, counts, k) for k in range(len(matches.frame))]
    frames, first = np.unique(matches.frame, return_index=True)
    available = np.logical_or.reduceat(valid, first)
    return {
        "schema": SCHEMA,
        "sensor": sensor.name,
        "rows": len(telemetry),
        "given": int(np.sum(given > 0)),
        "kept": int(np.sum((given > 0) & (star_id == given))),
        "changed": int(np.sum((given > 0) & (star_id > 0) & (star_id != given))),
        "added": int(np.sum((given == 0) & (star_id > 0))),
        "advice": names_advice(int(np.sum(given > 0)), int(np.sum((given > 0) & (star_id == given)))),
        "removed": int(removed.sum()),
        "matched": int(np.sum(star_id > 0)),
        "removed_reasons": _counted(why, removed),
        "unmatched_reasons": _counted(why, star_id == 0),
        "frames": len(frames),
        "valid_frames": int(available.sum()),
        "frame_reasons": dict(Counter(_frame_reason(exposures, first, k) for k in np.flatnonzero(~available).tolist())),
        "starts": dict(Counter(exposure["start"] for exposure in exposures)),
        "flight_tolerance_rad": None if seen is None else seen.tolerance_rad,
        "exposures": exposures,
    }


def names_advice(given: int, kept: int) -> list[Advice]:
    """What to think of a set of which most given names do not agree with the sensor."""
    if given < FEWEST_NAMES or 2 * kept >= given:
        return []
    sentence = (
        f"Only {kept:,} of {given:,} given identities agree with this sensor: the sensor file, its parity or its parameters are "
        "probably wrong for this telemetry; do not trust the attitudes and matches that were found."
    )
    return [Advice(sentence, "identities")]


def _counted(why: list[str], rows: BoolArray) -> dict[str, int]:
    """How many of some rows have each reason, most first."""
    return dict(Counter(why[row] for row in np.flatnonzero(rows)).most_common())


def _exposure(matches: Matches, seen: MatchedFrames | None, counts: IntArray, k: int) -> dict[str, Any]:
    """What matching says of exposure k: valid or not with the reason, stars, and the attitude with its covariance."""
    valid = bool(matches.valid[k] if seen is None else seen.view.valid[k])
    known = bool(np.isfinite(matches.quaternion[k]).all())
    return {
        "frame": int(matches.frame[k]),
        "exposure": int(matches.exposure[k]),
        "valid": valid,
        "reason": None if valid else _reason(matches, seen, k),
        "matched": int(counts[k]),
        "start": STARTS[matches.start[k]],
        "quaternion": matches.quaternion[k].tolist() if known else None,
        "attitude_covariance_rad2": matches.attitude_covariance[k].tolist() if known else None,
    }


def _reason(matches: Matches, seen: MatchedFrames | None, k: int) -> str:
    return EXPOSURE_REASONS[matches.reason[k]] if seen is None else seen.exposure_reason(k)


def _frame_reason(exposures: list[dict[str, Any]], first: IntArray, k: int) -> str:
    """Why a frame is not valid: the reason of its exposure with the most stars."""
    last = first[k + 1] if k + 1 < len(first) else len(exposures)
    reason: str = max(exposures[first[k] : last], key=lambda exposure: exposure["matched"])["reason"]
    return reason


def matching_view(telemetry: Telemetry, sensor: Sensor, ended: CyclesEnd, evaluation: Evaluation) -> Matching | None:
    """Describe the matches that an estimate stands on; None where they are given ones, which are not made again."""
    matches = ended.matched.matches
    if not isinstance(matches, Matches):
        return None
    given = np.zeros(len(telemetry), np.int64) if telemetry.star_id is None else np.maximum(telemetry.star_id, 0)
    named, found = given > 0, matches.star_id > 0
    kept = named & (matches.star_id == given)
    return Matching(
        given=int(named.sum()),
        kept=int(kept.sum()),
        added=int((found & ~named).sum()),
        removed=int((named & ~kept).sum()),
        renamed=int((named & found & ~kept).sum()),
        matched=int(found.sum()),
        cycles=list(ended.cycles),
        rested=ended.rested,
        tolerance_px=_summarise(matches.tolerance_rad[found] / pixel_rad(sensor, ended.estimate.x)),
        row_reasons=counted(matches.row_reason[~found], ROW_REASONS),
        removed_reasons=counted(matches.row_reason[named & ~found], ROW_REASONS),
        exposure_reasons=counted(matches.reason, EXPOSURE_REASONS),
        starts=counted(matches.start, STARTS),
        flagged=FlaggedStars(
            doubles=int((matches.flags & DOUBLE > 0).sum()),
            unreliable=int((matches.flags & UNRELIABLE > 0).sum()),
            left_out=int((matches.row_reason == LEFT_OUT).sum()),
            blended=int((matches.row_reason == BLENDED).sum()),
        ),
        flight=FlightScores(
            tolerance_rad=evaluation.flight_tolerance_rad,
            availability=evaluation.availability,
            matched_stars=evaluation.matched_stars,
        ),
    )


def list_refused_names(telemetry: Telemetry, matches: Matches) -> list[RemovedStar]:
    """List the given stars of which matching made another star or none, the first of very many."""
    if telemetry.star_id is None:
        return []
    refused = np.flatnonzero((telemetry.star_id > 0) & (matches.star_id != telemetry.star_id))
    return [
        RemovedStar(
            frame=int(telemetry.frame[row]),
            exposure=int(telemetry.exposure[row]),
            row=telemetry.first_row + int(row),
            star_id=int(telemetry.star_id[row]),
            reason=(
                f"HIP {matches.star_id[row]} is a better match"
                if matches.star_id[row]
                else ROW_REASONS[matches.row_reason[row]]
            ),
        )
        for row in refused[:MOST_LISTED].tolist()
    ]


def counted(places: NDArray[np.int8], phrases: Sequence[str]) -> dict[str, int]:
    """How often each phrase is meant, the most frequent first."""
    return {phrases[place]: count for place, count in Counter(places.tolist()).most_common()}


def _summarise(values: NDArray[np.float64]) -> Tolerance:
    """Return median and 95th percentile; None where there are no values."""
    values = values[np.isfinite(values)]
    if not len(values):
        return Tolerance(median=None, p95=None)
    median, p95 = np.percentile(values, [50, 95])
    return Tolerance(median=float(median), p95=float(p95))
