"""What a person should know before believing a calibration: one sentence each, the gravest first."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from boresight.calibration.estimate import Estimate, Parameters, claim
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.estimation.arcs import ArcSet
from boresight.estimation.consistency import ChiSquare
from boresight.estimation.filters.angular import MOST_PAIRS
from boresight.estimation.observability import Observability

#: Shift from the start, in typical sigmas, beyond which a parameter deserves a second look; E Table III stays within 10.
FAR = 15.0
#: Shift beyond which it is another sensor: no launch moves a focal length by a hundred times the spread of its make.
ANOTHER_SENSOR = 100.0
#: Claimed over available information beyond which a filter is called over-confident.
OVERCLAIM = 1.5


def advice(
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    estimate: Estimate,
    fit: ChiSquare,
    nis: ChiSquare,
    observed: Observability,
) -> list[str]:
    """Collect every sentence that applies."""
    return [
        *_of_status(estimate, observed),
        *_of_shift(problem, parameters, estimate),
        *_of_weak_directions(observed, estimate),
        *_of_consistency(fit, nis, problem, settings, estimate),
        *estimate.remarks,
        *_of_data(problem),
        *_of_gain_form(problem, settings),
    ]


def too_few(problem: Problem, minimum_stars: int) -> list[str]:
    """Say that nothing can be estimated, and what was missing."""
    reasons = [
        f"{item.count} {item.what[: -1 if item.count == 1 else None]}: {item.reason}" for item in problem.left_out
    ]
    missing = "; ".join(reasons) or "the set is empty"
    sentence = (
        f"No exposure has {minimum_stars} usable matched stars off one line, so nothing was estimated; "
        f"match more stars or send other frames ({missing})."
    )
    return [sentence]


def _of_status(estimate: Estimate, observed: Observability) -> Iterator[str]:
    """Sentences that follow from the status alone."""
    if estimate.status == "diverged":
        yield "The fit diverged: do not use these numbers; free fewer parameters, or start closer to the truth."
    if estimate.status == "max_iterations":
        yield "The fit was still moving at its last iteration: allow more iterations, or free fewer parameters."
    if estimate.status == "rank_deficient":
        lost = [observed.direction(i) for i in range(len(observed.names)) if observed.singular_values[i] == 0]
        names = sorted({name for direction in lost for name, value in direction.items() if abs(value) > 0.1})
        yield f"These data do not determine {', '.join(names)}: hold at least {len(lost)} of them fixed and run again."


def _of_weak_directions(observed: Observability, estimate: Estimate) -> Iterator[str]:
    """Name directions that the data hardly determine."""
    if estimate.status == "diverged":
        return
    for i in observed.weak():
        if observed.singular_values[i] > 0:
            alone = len(observed.named(i)) == 1
            caution = "Hold it fixed" if alone else "Do not read these parameters one by one; hold one of them fixed"
            yield f"Weakly determined: {observed.sentence(i)} {caution}, or add frames that cover more of the detector."


def _of_consistency(
    fit: ChiSquare, nis: ChiSquare, problem: Problem, settings: CalibrationSettings, estimate: Estimate
) -> Iterator[str]:
    """Sentences on whether the sigmas can be believed."""
    if estimate.status == "diverged":
        return
    implied = _centroid_sigma_px(problem) * np.sqrt(fit.mean)
    if fit.mean > fit.upper and estimate.robust is not None:
        yield (
            f"The residuals are larger than the stated centroid noise explains (chi-square {fit.mean:.4g} per degree of "
            f"freedom, at most {fit.upper:.4g} expected); the sigmas hold the scale that the robust fit measured."
        )
    elif fit.mean > fit.upper:
        yield (
            f"The residuals are larger than the stated centroid noise explains (chi-square {fit.mean:.4g} per degree of "
            f"freedom, at most {fit.upper:.4g} expected): the sigmas are about {np.sqrt(fit.mean) - 1:.1%} too small; a "
            f"centroid sigma of {implied:.3g} px would explain them, or look for wrong matches."
        )
    elif fit.mean < fit.lower:
        yield (
            f"The residuals are smaller than the stated centroid noise explains (chi-square {fit.mean:.4g} per degree of "
            f"freedom, at least {fit.lower:.4g} expected): the sigmas are too wide; {implied:.3g} px would fit."
        )
    if settings.sequential and nis.mean > max(nis.upper, fit.mean * 1.05):
        yield (
            f"The filter is over-confident (normalised innovations {nis.mean:.3g} per degree of freedom, at most "
            f"{nis.upper:.3g} expected): do not rely on its sigmas; compare with a batch run."
        )
    claimed = claim(estimate.A, estimate.P, settings.initial_sigma_scale) if settings.sequential else 1.0
    if claimed > OVERCLAIM:
        yield (
            f"The filter claims {claimed:.2g} times the information that the data hold along some direction, because it took "
            "early frames in far from where it ended: its sigmas there are too small; run the batch, or start from its result."
        )
    if settings.sequential and settings.linearisations == 1:
        yield (
            "One linearisation a frame, as printed, makes the filter over-confident from a distant start: "
            "its sigmas are too small."
        )


def _centroid_sigma_px(problem: Problem) -> float:
    """Root mean square of the stated centroid sigmas."""
    return float(np.sqrt(sum(problem.arcs.over_blocks(_variance_in_block)) / problem.arcs.n_stars))


def _variance_in_block(block: ArcSet) -> float:
    """Sum of the stated variances of one block, px^2."""
    return float(np.sum(block.sigma_px**2))


def _of_shift(problem: Problem, parameters: Parameters, estimate: Estimate) -> Iterator[str]:
    """Name parameters that went far from where they started."""
    if estimate.status == "diverged":
        return
    shift = (estimate.x - problem.sensor.initial)[parameters.free] / parameters.scale
    moved = [(problem.camera.parameter_names[p], steps) for p, steps in zip(parameters.free, shift, strict=True)]
    far = ", ".join(f"{name} {steps:+.0f}" for name, steps in moved if abs(steps) > FAR)
    if not far:
        return
    if np.abs(shift).max() > ANOTHER_SENSOR:
        yield f"This telemetry hardly comes from this sensor (moved in typical sigmas: {far}): choose the right sensor."
    else:
        yield f"Moved far from the start, in typical sigmas: {far}; check the sensor file's start and typical_sigma."


def _of_data(problem: Problem) -> Iterator[str]:
    """Sentences on what the data lack."""
    if problem.arcs.n_frames < 20:
        yield f"Only {problem.arcs.n_frames} frames took part: the result follows these few fields closely."


def _of_gain_form(problem: Problem, settings: CalibrationSettings) -> Iterator[str]:
    """Say where the printed inverse of all pairs gave way to a smaller one."""
    if settings.method != "angular" or settings.gain_form != "gain":
        return
    parts = problem.arcs.over_blocks(_pairs_in_block)
    most, many = max(part[0] for part in parts), sum(part[1] for part in parts)
    if many:
        yield (
            f"{many} of {problem.arcs.n_exposures} exposures have more than {MOST_PAIRS:,} pairs (up to {most:,}): "
            "their gain was taken over two numbers a star, which gives the same but takes less time than the printed inverse."
        )


def _pairs_in_block(block: ArcSet) -> tuple[int, int]:
    """Most pairs of an exposure of one block, and how many exposures have more than `MOST_PAIRS`."""
    stars = np.diff(block.star_start)
    pairs = stars * (stars - 1) // 2
    return int(pairs.max()), int(np.sum(pairs > MOST_PAIRS))
