"""Findings on matching: what the paper's text, its tables and our runs say about which stars were taken in, and by what rule."""

from __future__ import annotations

from boresight.studies.enright import printed
from boresight.studies.enright.estimators import ESTIMATORS
from boresight.studies.enright.pooled import Pooled, mean
from boresight.studies.enright.sentences import Finding, by_sensor, described, finding, listed, validation_urad
from boresight.studies.enright.tables import URAD_PER_RAD


def matching_findings(pooled: Pooled) -> list[Finding]:
    """Return every finding on matching."""
    return [make(pooled) for make in (_no_refit, _fixed_tolerance, _star_ratios, _tolerance)]


def _no_refit(pooled: Pooled) -> Finding:
    rank, (worst, best) = printed.no_refit_rank(), _ranked(pooled)
    stars = {key: mean(pooled.firsts(key), lambda record: record["stars"]) for key in ("no-q", "no-refit")}
    theirs = f"Table V itself: worst of the three for {listed(rank['worst'])}, best for {listed(rank['best'])}."
    here = f"Here: worst for {listed(worst)}, best for {listed(best)}, out of {listed(pooled.sensors)}"
    used = f"it used {stars['no-refit']:.0f} stars a set on average, No-Q {stars['no-q']:.0f}."
    return finding(
        "No-Refit: the text and its own table disagree",
        "III-B: “The No-Refit errors are higher than the other filter variants for most sensors”.",
        (theirs, f"{here}; {used}", f"{described(pooled, 'no-refit')}. {described(pooled, 'q')}."),
    )


def _ranked(pooled: Pooled) -> tuple[list[int], list[int]]:
    """Sensors for which our No-Refit is the worst, and the best, of the three sequential variants."""
    worst, best = [], []
    for sensor in pooled.sensors:
        errors = [validation_urad(pooled.shown(sensor, key)) for key in ("no-refit", "q", "no-q")]
        worst += [sensor] if errors[0] == max(errors) else []
        best += [sensor] if errors[0] == min(errors) else []
    return worst, best


def _fixed_tolerance(pooled: Pooled) -> Finding:
    stars = ", ".join(
        f"{ESTIMATORS[key].label} {mean(pooled.firsts(key), lambda record: record['stars']):.0f}"
        for key in ("no-refit", "no-refit-flight", "no-q", "no-q-flight")
    )
    why = "From a ground calibration little passes, and what passes was chosen for agreeing with it."
    return finding(
        "A fixed tolerance in the loop keeps the stars that agree with the ground calibration",
        "II-D: matching only with the baseline values is “a conservative approach” that “will always preserve performance”.",
        (
            f"{described(pooled, 'no-refit-flight')}. {described(pooled, 'no-q-flight')}. {described(pooled, 'batch-flight')}.",
            f"By the statistical rule: {described(pooled, 'no-refit')}. {described(pooled, 'no-q')}.",
            f"Stars used, mean of a set: {stars}. {why}",
        ),
    )


def _tolerance(pooled: Pooled) -> Finding:
    records = pooled.firsts("batch")
    theirs = by_sensor(records, [printed.TABLE_IV[record["sensor"]][0] for record in records], 2)
    said = [f"Availability at the ground calibration printed, by sensor: {theirs}."]
    for place, tried in enumerate(records[0]["tolerances"]):
        found = [record["tolerances"][place]["availability"]["initial"] for record in records]
        size = f"{tried['arc_sigmas']:g} arc sigmas ({tried['flight_tolerance_rad'] * URAD_PER_RAD:.0f} µrad)"
        said.append(f"Here at {size}: {by_sensor(records, found, 2)}.")
    return finding(
        "How wide the flight matching would have to be",
        "The paper does not give the tolerance of its matching, on which Table IV's initial availability rests.",
        said,
    )


def _star_ratios(pooled: Pooled) -> Finding:
    records = pooled.firsts("batch")
    theirs = [(printed.TABLE_IV[sensor][2], printed.TABLE_VI[sensor][0]) for sensor in pooled.sensors]
    ours = [[record[data]["matched_star_ratio"] for record in records] for data in ("calibration", "validation")]
    return finding(
        "Tables IV and VI: sensors 3 and 4 match 2.5 times the stars on one set and as many as before on the other",
        "Tables IV and VI give matched star ratios of the same calibrations; Table V gives sensors 3 and 4 the largest raw errors.",
        (
            f"Printed, calibration set, by sensor: {by_sensor(records, [pair[0] for pair in theirs], 2)}.",
            f"Printed, validation set: {by_sensor(records, [pair[1] for pair in theirs], 2)}.",
            f"Here, calibration set: {by_sensor(records, ours[0], 2)}; validation set: {by_sensor(records, ours[1], 2)}.",
            "The paper does not say what its raw validation telemetry was matched with.",
        ),
    )
