"""A verdict on a calibration file, with no store behind it: what `boresight assess` does.

Set and incumbent on frames that neither was fitted to: the one comparison that nothing in a fit can flatter.

Both see the same frames (`calibration.matching.matched_frames`), so every comparison is paired: ratios and differences are
resampled frame by
frame, in blocks (`calibration.evaluation.bootstrap`), and what makes a frame hard for both drops out. The stars are compared by the
difference a frame and not by the ratio of E Eq 30: an incumbent that matches none has no ratio, though nothing is clearer. The
change of the availability is

    change = g - l,    g = frames that only the set solves / frames,    l = frames that only the incumbent solves / frames.

Where no frame changed sides resampling gives it an interval of no width. As a share's interval holds Wilson's, so this one
holds the interval that Wilson's intervals of g and l make (the MOVER of Newcombe 1998 and Zou and Donner 2008), of as many
independent frames as there are blocks:

    change - sqrt((g - g_low)^2 + (l_high - l)^2)    to    change + sqrt((g_high - g)^2 + (l - l_low)^2).

A run's own validation compares with the parameters that it started from. Where these are the incumbent's nothing needs to be
seen again, `take_scores`; elsewhere the frames are matched under both, `compute_validation_scores`, which takes seconds.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boresight.calibration.calibration import Calibration, Evaluation
from boresight.calibration.corrections import put_right
from boresight.calibration.evaluation import bootstrap
from boresight.calibration.evaluation.evaluate import evaluate_matched_frames
from boresight.calibration.matching.matched_frames import match_under_states
from boresight.calibration.options import CalibrationSettings
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor
from boresight.verdicts.gates.assessed_set import AssessedSet, assess_calibration
from boresight.verdicts.gates.judgement import GateReport, judge
from boresight.verdicts.gates.measurements import (
    GateInputs,
    Score,
    ValidationScores,
    ends,
    measure,
)
from boresight.verdicts.gates.profile import Profile


def compute_validation_scores(
    telemetry: Telemetry,
    sensor: Sensor,
    catalogue: Catalogue,
    incumbent: AssessedSet,
    candidate: AssessedSet,
    settings: CalibrationSettings,
    cache_folder: Path | None = None,
) -> ValidationScores:
    """See validation frames under both sets and score them."""
    states = [incumbent.state, candidate.state]
    telemetry = put_right(telemetry, sensor, catalogue, states[-1][0])
    before, after = match_under_states(telemetry, sensor, catalogue, states, settings, cache_folder)
    evaluation = evaluate_matched_frames(telemetry, sensor, before, after, settings, _rng())
    valid = np.stack([before.view.valid_frames, after.view.valid_frames])
    matched = np.stack([before.view.matched_in_frame, after.view.matched_in_frame])
    return _scores(evaluation, valid, matched)


def take_scores(result: Calibration) -> ValidationScores | None:
    """Take the scores of a run's own validation, against what it started from.

    None where it had none, where an older version wrote less of it, or where it kept some of many frames: those that differ first,
    from which nothing of all frames follows.
    """
    validation, shadow = result.validation, result.shadow.validation
    if validation is None or shadow is None or len(shadow.frames) != validation.frames:
        return None
    if validation.intervals is None or not validation.intervals.rms_ratio:
        return None
    sides = [frame.baseline for frame in shadow.frames], [frame.candidate for frame in shadow.frames]
    valid = np.array([[answer.valid for answer in side] for side in sides], np.bool_)
    matched = np.array([[answer.matched for answer in side] for side in sides], np.int64)
    return _scores(validation, valid, matched)


def _rng() -> np.random.Generator:
    """Return the source of the resampling: the same data have the same intervals wherever they are judged."""
    return np.random.default_rng(bootstrap.SEED)


def _scores(evaluation: Evaluation, valid: NDArray[np.bool_], matched: NDArray[np.int64]) -> ValidationScores:
    """Put the scores under their gates' names; `valid` and `matched` are (2, n_frames), the incumbent's first."""
    rms, available, intervals = evaluation.rms_arc_rad, evaluation.availability, evaluation.intervals
    rms_reach = intervals.rms_arc_rad.final if intervals else None
    available_reach = intervals.availability.final if intervals else None
    scores = {
        "validation-rms": Score(rms.final, ends(rms_reach), rms.initial),
        "validation-rms-incumbent": Score(evaluation.rms_ratio, ends(intervals.rms_ratio if intervals else None)),
        "availability": Score(available.final, ends(available_reach), available.initial),
        "availability-incumbent": change_of_share(valid[0], valid[1], _rng()),
        "matched-stars": _mean(matched[1], float(matched[0].mean())),
        "matched-stars-incumbent": _mean(matched[1] - matched[0]),
    }
    return ValidationScores(evaluation.frames, scores)


def _mean(counts: NDArray[np.int64], incumbent: float | None = None) -> Score:
    """Mean of counts (n_frames,) with its interval, and the incumbent's."""
    values = counts.astype(np.float64)
    length = bootstrap.block_length(values)
    sums = bootstrap.resampled_sums(np.column_stack([values, np.ones(len(values))]), length, _rng())
    mean = float(values.mean())
    interval = bootstrap.interval(mean, sums[:, 0] / sums[:, 1], len(values) / length)
    return Score(mean, ends(interval), incumbent)


def change_of_share(before: NDArray[np.bool_], after: NDArray[np.bool_], rng: np.random.Generator) -> Score:
    """Change of the share of frames that are available, with its interval.

    `before`, `after`: (n_frames,) whether each frame is available with the incumbent, and with the set.
    """
    steps = after.astype(np.float64) - before
    length = bootstrap.block_length(steps)
    sums = bootstrap.resampled_sums(np.column_stack([steps, np.ones(len(steps))]), length, rng)
    change, n_blocks = float(steps.mean()), len(steps) / length
    low, high = bootstrap.interval(change, sums[:, 0] / sums[:, 1], n_blocks)
    below, above = _mover(float(np.mean(steps > 0)), float(np.mean(steps < 0)), n_blocks)
    return Score(change, (max(-1.0, min(low or 0.0, change - below)), min(1.0, max(high or 0.0, change + above))))


def _mover(gained: float, lost: float, n_blocks: float) -> tuple[float, float]:
    """How far the interval of gained - lost reaches below and above it, from Wilson's intervals of both shares."""
    (g_low, g_high), (l_low, l_high) = (bootstrap.wilson(share, n_blocks) for share in (gained, lost))
    return math.hypot(gained - g_low, l_high - lost), math.hypot(g_high - gained, lost - l_low)


NO_FRAMES = "No held-out frames were given: add a telemetry set that the calibration did not use."


def started_from(result: Calibration, incumbent: AssessedSet) -> bool:
    """Whether a run started from the incumbent, so that its own validation already compares with it."""
    values = incumbent.parameters
    known = {name: value for name, value in result.initial.items() if value is not None}
    return set(known) == set(values) and all(math.isclose(known[name], values[name], rel_tol=1e-12) for name in values)


def assess(
    result: Calibration,
    sensor: Sensor,
    incumbent: AssessedSet,
    profile: Profile,
    frames: tuple[Telemetry, Catalogue] | None = None,
) -> GateReport:
    """Judge a calibration."""
    validation, why, candidate = None, NO_FRAMES, assess_calibration(result, sensor)
    if frames is not None:
        settings = result.inputs.settings
        settings.check()
        validation = compute_validation_scores(frames[0], sensor, frames[1], incumbent, candidate, settings)
    elif started_from(result, incumbent):
        validation = take_scores(result)
    inputs = GateInputs(
        sensor=sensor,
        candidate=candidate,
        incumbent=incumbent,
        result=result,
        validation=validation,
        no_validation="" if validation else why,
    )
    return judge(profile, measure(inputs))
