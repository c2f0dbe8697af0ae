"""How two parameter sets do on a telemetry set: availability, matched stars and RMS on common pairs (E section III).

The set is seen under each state (`calibration.matching.matched_frames`): stars are matched again, and the flight code's check says
what it would accept. With N(x) the accepted matches of all valid exposures,

    availability(x)     = frames with a valid exposure / frames
    matched star ratio  = N(x_final) / N(x_initial)                                  (E Eq 30)
    RMS(x)              = sqrt(sum dphi(x)^2 / N_phi), unweighted                    (E Eq 20, erratum: no 1/2, no weights)

where both RMS are taken over the very same arcs, those of the larger of the two accepted sets: "we must evaluate dphi using a
common set of star pairs ... we used the largest set of star pairs available" (E section II-B). Every score has a 95 % interval from
resampling frames in blocks, `calibration.evaluation.bootstrap`.

Shadow mode sets baseline and candidate side by side on every frame of the same set, and tells what each would have lost. A star
is lost in a frame when the baseline's valid exposures held it and the candidate's do not, gained the other way round. Whether the
candidate is available more often is McNemar's question: of the frames that one state alone solves, b the baseline's and c the
candidate's, as many would fall to each if they were alike, and b is binomial,

    p = min(1, 2 P(B <= min(b, c))),    B ~ Bin(b + c, 1/2)                                    (exact, two-sided).

The test takes frames as independent; where neighbours fail together p is too small, and the interval of the availability, which is
resampled in blocks, is the one to believe.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.calibration.calibration import (
    Change,
    CountChange,
    Evaluation,
    EvaluationIntervals,
    IntervalChange,
    ReasonChange,
    ShadowAnswer,
    ShadowFrame,
    ShadowOfSet,
    ShadowSummary,
)
from boresight.calibration.corrections import put_right
from boresight.calibration.evaluation import bootstrap
from boresight.calibration.matching.matched_frames import (
    REASONS_OF_FRAMES,
    MatchedFrames,
    common_arcs,
    match_under_states,
)
from boresight.calibration.matching.rematch import Matches
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import whiten_at
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.estimation.arcs import ArcSet
from boresight.estimation.metrics import arc_errors
from boresight.estimation.statistics.special import bdtr
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry, time_texts
from boresight.telemetry.sensors import Sensor

#: Every score is a ratio of two columns of `_columns`, or its root: numerator, denominator, whether the root is taken.
SCORES = {
    "availability_initial": (1, 0, False),
    "availability_final": (2, 0, False),
    "matched_star_ratio": (4, 3, False),
    "rms_arc_rad_initial": (5, 7, True),
    "rms_arc_rad_final": (6, 7, True),
    "rms_ratio": (6, 5, True),
}


def evaluate_parameters(  # noqa: PLR0913 - two states, each a vector and its covariance
    telemetry: Telemetry,
    sensor: Sensor,
    catalogue: Catalogue,
    x_initial: FloatArray,
    x_final: FloatArray,
    settings: CalibrationSettings,
    P_initial: FloatArray | None = None,
    P_final: FloatArray | None = None,
    *,
    rng: np.random.Generator | None = None,
) -> Evaluation:
    """Compare two states on a set.

    Parameters
    ----------
    telemetry, sensor, catalogue
        The set, whose it is, and where directions come from that it does not give.
    x_initial, x_final
        (n_parameters,) states, SI.
    settings
        `match`, `minimum_stars`, `flight_tolerance_urad`, and what matching looks at.
    P_initial, P_final
        (n_parameters, n_parameters) covariance of each, SI, from which the tolerance of a re-match follows; None is a ground
        calibration's.
    rng
        Source of the resampling; without it every interval is null.

    Returns
    -------
    Scores and intervals, `boresight.evaluation/1`.

    Raises
    ------
    RefusedInputError
        When rows that name stars can be given no direction at all.
    """
    states = [(x_initial, P_initial), (x_final, P_final)]
    telemetry = put_right(telemetry, sensor, catalogue, x_final)
    initial, final = match_under_states(telemetry, sensor, catalogue, states, settings)
    return evaluate_matched_frames(telemetry, sensor, initial, final, settings, rng)


def evaluate_matched_frames(
    telemetry: Telemetry,
    sensor: Sensor,
    initial: MatchedFrames,
    final: MatchedFrames,
    settings: CalibrationSettings,
    rng: np.random.Generator | None,
    ordered: ArcSet | None = None,
) -> Evaluation:
    """Compare a set's matched frames under two states, as `evaluate_parameters` does; `ordered`, its arcs, saves ordering again."""
    larger = initial if initial.view.matched_stars > final.view.matched_stars else final
    common = common_arcs(telemetry, sensor, larger, settings.minimum_stars, ordered)
    columns = _columns(initial, final, common, CAMERA_MODELS[sensor.camera_model])
    scores = {name: _score(columns, *SCORES[name], rng) for name in SCORES}
    value = {name: score for name, (score, _) in scores.items()}
    interval = {name: within for name, (_, within) in scores.items()}
    return Evaluation(
        frames=len(columns),
        availability=Change(**_sides(value, "availability")),
        matched_stars=CountChange(initial=initial.view.matched_stars, final=final.view.matched_stars),
        matched_star_ratio=value["matched_star_ratio"],
        rms_arc_rad=Change(**_sides(value, "rms_arc_rad")),
        rms_ratio=value["rms_ratio"],
        common_pairs=int(columns[:, 7].sum()),
        stars=sum(arcs.n_stars for arcs in common),
        match="rematch" if isinstance(final.matches, Matches) else "given",
        flight_tolerance_rad=final.tolerance_rad,
        intervals=EvaluationIntervals(
            availability=IntervalChange(**_sides(interval, "availability")),
            matched_star_ratio=interval["matched_star_ratio"],
            rms_arc_rad=IntervalChange(**_sides(interval, "rms_arc_rad")),
            rms_ratio=interval["rms_ratio"],
        ),
        reasons=ReasonChange(initial=initial.count_reasons(), final=final.count_reasons()),
    )


T = TypeVar("T")


def _sides(scores: dict[str, T], name: str) -> dict[str, T]:
    return {side: scores[f"{name}_{side}"] for side in ("initial", "final")}


def _columns(initial: MatchedFrames, final: MatchedFrames, common: list[ArcSet], camera: CameraModel) -> FloatArray:
    """What the scores are made of, a row a frame: 1, available, stars, sums of squares of both, and common arcs, (n_frames, 8)."""
    frames = initial.view.frames
    squares = np.zeros((len(frames), 3))
    for arcs in common:
        squares[np.searchsorted(frames, arcs.frame)] += _squares(arcs, camera, initial.x, final.x)
    seen = (
        initial.view.valid_frames,
        final.view.valid_frames,
        initial.view.matched_in_frame,
        final.view.matched_in_frame,
    )
    return np.column_stack([np.ones(len(frames)), *seen, squares]).astype(np.float64)


def _squares(arcs: ArcSet, camera: CameraModel, x_initial: FloatArray, x_final: FloatArray) -> FloatArray:
    """Sums of squared arc errors under both states and the number of arcs, a row a frame, (n, 3)."""
    arcs = arcs if arcs.n_arcs else whiten_at(arcs, camera, x_final)
    squares = [np.add.reduceat(arc_errors(arcs, x) ** 2, arcs.frame_arcs[:-1]) for x in (x_initial, x_final)]
    return np.column_stack([*squares, np.diff(arcs.frame_arcs)])


def _score(
    columns: FloatArray, over: int, under: int, root: bool, rng: np.random.Generator | None
) -> tuple[float | None, list[float | None]]:
    """A score and its interval, null where it is nothing divided by nothing."""
    pair = columns[:, [over, under]]
    total = pair.sum(axis=0)
    if total[1] == 0:
        return None, [None, None]
    ratio = float(total[0] / total[1])
    score = float(np.sqrt(ratio)) if root else ratio
    if rng is None:
        return score, [None, None]
    length = bootstrap.block_length(pair[:, 0] - ratio * pair[:, 1])
    sums = bootstrap.resampled_sums(pair, length, rng)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = sums[:, 0] / sums[:, 1]
    interval = bootstrap.interval if under else bootstrap.share_interval
    return score, interval(score, np.sqrt(ratios) if root else ratios, len(columns) / length)


#: Frames kept one by one; the summary is of all.
MOST_FRAMES = 2000
#: Of these, at most so many places are kept for frames that one state alone solves.
MOST_DIFFERING = 1000


def shadow_view(telemetry: Telemetry, baseline: MatchedFrames, candidate: MatchedFrames) -> ShadowOfSet:
    """Set the matched frames of one set under two states side by side.

    Returns dict with `frames`, one object a frame and at most `MOST_FRAMES` of them, those that differ first; `frames_in_set`;
    `flight_tolerance_rad`; and `summary` of all frames.
    """
    lost, gained = _moved(baseline, candidate), _moved(candidate, baseline)
    ends = np.searchsorted(telemetry.frame, baseline.view.frames, side="right")
    rows = np.stack([np.append(0, ends[:-1]), ends], axis=1)
    kept = _choose_frames(baseline.view.valid_frames, candidate.view.valid_frames)
    columns = (
        baseline.view.frames[kept].tolist(),
        time_texts(telemetry, rows[kept, 0]),
        _answers(baseline, kept),
        _answers(candidate, kept),
        _ids(baseline, lost, rows[kept]),
        _ids(candidate, gained, rows[kept]),
    )
    return ShadowOfSet(
        frames=[
            ShadowFrame(frame=frame, time_utc=time, baseline=before, candidate=after, lost=lost_of, gained=gained_of)
            for frame, time, before, after, lost_of, gained_of in zip(*columns, strict=True)
        ],
        frames_in_set=len(rows),
        flight_tolerance_rad=candidate.tolerance_rad,
        summary=shadow_summary(
            baseline.view.valid_frames, candidate.view.valid_frames, int(lost.sum()), int(gained.sum())
        ),
    )


def _moved(here: MatchedFrames, there: MatchedFrames) -> BoolArray:
    """Rows (n_rows,) whose star the valid exposures hold under one state and not under the other."""
    held, kept = here.taken(), there.taken()
    return np.asarray(held & ~(kept & (here.matches.star_id == there.matches.star_id)))


def _choose_frames(baseline: BoolArray, candidate: BoolArray) -> IntArray:
    """Which frames to keep, ascending: those that one state alone solves first, then evenly over the set."""
    differing = _thinned(np.flatnonzero(baseline != candidate), MOST_DIFFERING)
    return np.union1d(differing, _thinned(np.arange(len(baseline)), MOST_FRAMES - len(differing)))


def _thinned(places: IntArray, most: int) -> IntArray:
    if len(places) <= most:
        return places
    return places[np.linspace(0, len(places) - 1, most).round().astype(np.int64)]


def _answers(seen: MatchedFrames, kept: IntArray) -> list[ShadowAnswer]:
    valid, matched = seen.view.valid_frames[kept].tolist(), seen.view.matched_in_frame[kept].tolist()
    reasons = REASONS_OF_FRAMES[seen.reasons[kept]].tolist()
    return [
        ShadowAnswer(valid=right, matched=stars, reason=None if right else why)
        for right, stars, why in zip(valid, matched, reasons, strict=True)
    ]


def _ids(seen: MatchedFrames, moved: BoolArray, rows: IntArray) -> list[list[int]]:
    """Star numbers of the rows of some frames that moved; 0 where the file gives a direction and no number."""
    places = np.flatnonzero(moved)
    star, ends = seen.matches.star_id[places], np.searchsorted(places, rows)
    return [star[first:last].tolist() if last > first else [] for first, last in ends.tolist()]


def shadow_summary(baseline: BoolArray, candidate: BoolArray, stars_lost: int, stars_gained: int) -> ShadowSummary:
    """Count what each state alone solves.

    `baseline`, `candidate`: (n_frames,) whether each frame is available. `stars_lost`, `stars_gained`: sightings of stars that
    only the baseline, and only the candidate, accepts.
    """
    b, c = int(np.sum(baseline & ~candidate)), int(np.sum(candidate & ~baseline))
    p = mcnemar(b, c)
    return ShadowSummary(
        baseline_only=b,
        candidate_only=c,
        both=int(np.sum(baseline & candidate)),
        neither=int(np.sum(~baseline & ~candidate)),
        stars_lost=stars_lost,
        stars_gained=stars_gained,
        p=p,
        sentence=_sentence(b, c, p, stars_lost, stars_gained),
    )


def mcnemar(b: int, c: int) -> float:
    """McNemar's exact test, two-sided: how likely so uneven a split is when both states are available equally often."""
    return min(1.0, 2.0 * float(bdtr(min(b, c), b + c, 0.5)))


def _sentence(b: int, c: int, p: float, stars_lost: int, stars_gained: int) -> str:
    stars = f"{stars_gained:,} star sightings gained, {stars_lost:,} lost"
    if b == c == 0:
        return f"Both parameter sets solve the same frames; {stars}."
    lost, won = f"lose {_frames(b)} that the old ones solve", f"solve {_frames(c)} that the old ones lose"
    first, second = (won, lost) if c >= b else (lost, won)
    doubt = "" if p < 0.05 else ": consistent with chance"
    return f"The new parameters {first} and {second} (exact test, p = {p:.2g}{doubt}); {stars}."


def _frames(count: int) -> str:
    return "no frame" if count == 0 else f"{count:,} frame{'s' * (count != 1)}"
