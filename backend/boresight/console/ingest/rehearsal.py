"""A dry run on the past: what a policy would have made of the calibrations that are there, one after the other.

The walk begins with the baseline that the oldest of them could be held against and takes each set that would have been asked as
promoted, so it says how often people would have been asked if they had agreed each time. Nothing is calibrated again: sets without
a calibration that counts are counted, and the gates are not judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from boresight.console.fleet.trend import Followed, Trend, TrendPoint
from boresight.console.ingest.judgement import (
    PolicyFinding,
    Reference,
    judge,
    make_follower,
    make_reference,
    reference_of,
)
from boresight.console.ingest.rules import PolicyRules

YEAR_D = 365.25
#: Lines that are kept with a policy, the newest.
MOST_LINES = 400


def rehearse(trend: Trend, rules: PolicyRules) -> dict[str, Any]:
    """Walk over a sensor's calibrations by the time of their data."""
    points = [point for point in trend.points if point.timed and (not point.left_out)]
    walked = list(walk_over(points, trend, rules))
    counts = {name: sum(found.state == state for _, found in walked) for name, state in STATES.items()}
    with_runs = {point.telemetry_set_id for point in (*trend.points, *trend.others)}
    idle = [row for row in trend.telemetry.values() if row.purpose == "calibration" and row.id not in with_runs]
    busiest = _busiest_day(points)
    return {
        "sets": len(walked),
        **counts,
        "without_run": len(idle),
        "left_out": sum(bool(point.left_out) for point in trend.points),
        "busiest_day_sets": busiest,
        "would_pause": busiest > rules.sets_per_day,
        "false_requests_per_year": _per_year(points, rules),
        "lines": [_line(point, found) for point, found in walked[-MOST_LINES:]],
    }


STATES = {"held": "WITHIN FORECAST", "unconfirmed": "UNCONFIRMED", "asked": "ASKED", "not_judged": "NOT JUDGED"}


def walk_over(points: Sequence[TrendPoint], trend: Trend, rules: PolicyRules) -> list[tuple[TrendPoint, PolicyFinding]]:
    """Judge one calibration after the other, with each that would have been asked as promoted, but for jumps."""
    reference, since, follower = _first_reference(points, trend), list[Followed](), make_follower(rules)
    walked: list[tuple[TrendPoint, PolicyFinding]] = []
    for point in points:
        own = follower.follow(point)
        if reference is None or point.run_id == reference.run_id:
            reference, since = reference or reference_of(point), []
            continue
        found = judge(point, own, since, reference, rules)
        walked.append((point, found))
        if found.state == "ASKED" and (found.forecast is None or not found.forecast.rejects):
            reference, since = reference_of(point), []
        elif own is not None:
            since.append(own)
    return walked


def _first_reference(points: Sequence[TrendPoint], trend: Trend) -> Reference | None:
    """Return what the oldest set is held against: the baseline where it is declared, else the oldest set itself."""
    baseline = make_reference(trend)
    if baseline is not None and not baseline.measured:
        return baseline
    return reference_of(points[0]) if points else None


def _busiest_day(points: Sequence[TrendPoint]) -> int:
    days = [point.at_utc[:10] for point in points]
    return max((days.count(day) for day in set(days)), default=0)


def _per_year(points: Sequence[TrendPoint], rules: PolicyRules) -> float | None:
    """Return how many requests a year would come of chance alone, at the pace of the past; None where there is none."""
    if len(points) < 2:
        return None
    span_d = (
        datetime.fromisoformat(points[-1].at_utc) - datetime.fromisoformat(points[0].at_utc)
    ).total_seconds() / 86400
    return None if span_d <= 0 else rules.false_alarm_rate * (len(points) - 1) / span_d * YEAR_D


def _line(point: TrendPoint, found: PolicyFinding) -> dict[str, Any]:
    return {
        "run_id": point.run_id,
        "telemetry": point.telemetry,
        "at_utc": point.at_utc,
        "state": found.state,
        "against": None if found.reference is None else found.reference.name,
        "statistic": None if found.holds is None else found.holds.statistic,
        "limit": None if found.holds is None else found.holds.limit,
        "sentence": found.sentence,
    }
