"""Is a new set within the forecast? One calibration against what all before it forecast, and what they say against the baseline.

Let theta be the new estimate with covariance P, theta_b the baseline's with B, and alpha the policy's false-alarm rate.

- *It jumps* where it is outside of what the calibrations before it forecast of its time and temperature
  (`estimation.pass_forecast`). The errors of the passes are in no other of these tests, so the test's level times the number of
  sets is the number of false jumps that is to be expected. P is of the set's own stars alone: a prior would tie it to the forecast.
- *It drifts* where all calibrations, this one among them, say that the camera at the baseline's temperature is no longer the
  baseline: D^2 = (x - theta_b)^T (C + B)^-1 (x - theta_b) above its limit, x with covariance C what all say of it. Where
  the baseline is of one of these calibrations D is smaller than that, so it asks later and not more often. What comes and goes with
  the temperature is in the forecast, and no reason to load another set.
- *It holds* otherwise: nothing is asked. People are asked once so many sets in a row did not hold.
- *It is not judged* where it cannot be compared, and says why.

Both are asked at once, so each has the level alpha / 2, as in a sensor's drift test (`estimation.statistics.drift`): the chance
that a set is asked about although nothing changed is alpha at most.

As long as there are too few calibrations for a forecast, the baseline is the forecast, and its test alone has the level alpha: D^2
is that of theta, with P + B. All these tests share the baseline's error, so their false alarms come in bursts, as many on average.

A dry run walks over the calibrations of the past by the same functions. A set that would have been asked as a drift is the next
reference, as though people had promoted it; of a jump the advice is to wait for the next set, and that is taken. Nothing is
calibrated again: sets without a calibration that counts are counted, and the gates are not judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import numpy as np

from boresight.console.fleet.trend import Followed, Follower, Trend, TrendPoint, make_baseline_epoch, make_epoch
from boresight.console.ingest.rules import PolicyRules
from boresight.estimation.pass_forecast import FEWEST
from boresight.estimation.statistics import drift as tests
from boresight.estimation.statistics.drift import ChiSquareTest, Epoch
from boresight.verdicts.numbers import fixed, number, quantity


@dataclass(frozen=True)
class Reference:
    """What a new set is held against: a baseline, or in a dry run a set that would have become one."""

    name: str
    names: tuple[str, ...]
    epoch: Epoch
    parameter_set_id: int | None = None
    run_id: int | None = None
    measured: bool = True


@dataclass(frozen=True)
class Reason:
    """A reason of a decision: what code knows it by, and what people read."""

    code: str
    sentence: str


@dataclass(frozen=True)
class OtherSensor:
    """A sensor that a set fits better than its own: with `own` against what the own one's sets say, `other` against its."""

    sensor_id: int
    name: str
    own: ChiSquareTest
    other: ChiSquareTest


@dataclass(frozen=True)
class PolicyFinding:
    """What a policy finds in one calibration.

    `state`: as of a decision. `holds`: what is known of the camera against the baseline. `forecast`: the set against its forecast;
    None where there is none. `largest`: the parameter that moved most, and by how many of its sigmas. `in_row`: sets in a row that
    did not hold, this one with them. `other`: the sensor that it is of instead, see `other_sensor`.
    """

    state: str
    reasons: tuple[Reason, ...]
    reference: Reference | None = None
    holds: ChiSquareTest | None = None
    forecast: ChiSquareTest | None = None
    largest: tuple[str, float] | None = None
    in_row: int = 0
    other: OtherSensor | None = None

    @property
    def sentence(self) -> str:
        """The first reason."""
        return self.reasons[0].sentence

    @property
    def is_forecast(self) -> bool:
        """Whether the sets before it forecast it."""
        return self.forecast is not None and not self.forecast.rejects


def make_follower(rules: PolicyRules) -> Follower:
    """Return who forecasts sets at the level of one of two tests."""
    return Follower(rules.false_alarm_rate / 2)


def make_reference(trend: Trend) -> Reference | None:
    """Return a sensor's baseline as a reference; None where it has none."""
    if trend.baseline is None:
        return None
    own = trend.find_run(trend.baseline.run_id)
    names = tuple(trend.baseline.document["covariance"]["names"])
    measured = trend.baseline.run_id is not None
    epoch = make_baseline_epoch(trend.baseline, own, names)
    return Reference(trend.baseline.name, names, epoch, trend.baseline.id, trend.baseline.run_id, measured)


def promote_point(point: TrendPoint) -> Reference:
    """Return a calibration as a reference, as though it had been promoted."""
    return Reference(f"run {point.run_id}", point.names, make_epoch(point, point.names), None, point.run_id)


def judge_newest(trend: Trend, run_id: int, rules: PolicyRules) -> PolicyFinding:
    """Judge the calibration of a run against what those before it forecast, and the baseline."""
    point, reference = trend.find_run(run_id), make_reference(trend)
    if reference is None:
        return _not_judged("NO BASELINE", "There is no baseline to compare with; register the sensor again.")
    if point is None:
        return _not_judged(
            "NO RESULT", f"Run {run_id} has no calibration of the baseline's camera model; choose another preset."
        )
    own = trend.find_run(reference.run_id)
    if own is not None and (point.overlaps(own) or point.at_utc <= own.at_utc):
        return _not_judged(
            "OLDER", f"The data are not newer than those of {reference.name}; nothing is to be decided on them."
        )
    if (refusal := _refuse(point, reference, rules)) is not None:
        return refusal
    follower = make_follower(rules)
    earlier = [one for one in trend.independent if one.at_utc < point.at_utc]
    followed = [found for one in earlier if (found := follower.follow(one)) is not None]
    since = [one for one in followed if own is None or one.point.at_utc > own.at_utc]
    return judge(point, follower.follow(point), since, reference, rules)


def agree(trend: Trend, run_id: int | None, other_id: int | None, rules: PolicyRules) -> bool:
    """Whether the calibrations of two runs are of the same camera, for a change that was answered before there is a forecast."""
    one, other = trend.find_run(run_id), trend.find_run(other_id)
    if one is None or other is None or set(one.names) != set(other.names):
        return False
    test = tests.baseline_test(make_epoch(one, one.names), make_epoch(other, one.names), rules.false_alarm_rate)
    return test is not None and not test.rejects


def judge(
    point: TrendPoint, own: Followed | None, since: Sequence[Followed], reference: Reference, rules: PolicyRules
) -> PolicyFinding:
    """Judge one calibration as the model took it; `since`: those since the reference, by time."""
    if (refusal := _refuse(point, reference, rules)) is not None:
        return refusal
    holds = None if own is None else _hold(own, reference, rules)
    if own is None or holds is None:
        return _not_judged(
            "NO COVARIANCE", f"The covariance of run {point.run_id} or of {reference.name} is not positive definite."
        )
    test, names = own.found.test, sorted(point.names)
    of_jump = test is not None and test.rejects
    beside = own.found.forecast if of_jump and own.found.forecast is not None else _base(reference, names)
    epoch = make_epoch(point, names) if of_jump or test is None else own.found.state_at(_temperature(reference))
    worth = (epoch.value - beside.value) / np.sqrt(np.diag(epoch.covariance + beside.covariance))
    most = int(np.argmax(np.abs(worth)))
    found = PolicyFinding("WITHIN FORECAST", (), reference, holds, test, (names[most], float(worth[most])))
    if not (of_jump or holds.rejects):
        return replace(found, reasons=(Reason("HOLDS", _describe_outcome(point, reference, found)),))
    in_row = 1 + _outside_in_row(since, reference, rules)
    state = "ASKED" if in_row >= rules.confirmations else "UNCONFIRMED"
    found = replace(found, state=state, in_row=in_row)
    return replace(found, reasons=tuple(_reasons(point, found, rules)))


def _base(reference: Reference, names: Sequence[str]) -> Epoch:
    """Return the reference's estimate of these parameters, in their order."""
    order = [reference.names.index(name) for name in names]
    return Epoch(0.0, reference.epoch.value[order], reference.epoch.covariance[np.ix_(order, order)])


def _temperature(reference: Reference) -> float:
    """Return the temperature that a reference was taken at; NaN where it is not known."""
    return reference.epoch.temperature_c


def _hold(one: Followed, reference: Reference, rules: PolicyRules) -> ChiSquareTest | None:
    """Hold what is known with a calibration, at the reference's temperature, against the reference."""
    names = sorted(one.point.names)
    if not set(names) <= set(reference.names):
        return None
    state = one.found.state_at(_temperature(reference))
    level = rules.false_alarm_rate / (1 if one.found.test is None else 2)
    return tests.baseline_test(state, _base(reference, names), level)


def _refuse(point: TrendPoint, reference: Reference, rules: PolicyRules) -> PolicyFinding | None:
    """Return why a calibration cannot be judged, None where it can."""
    if point.left_out:
        return _not_judged("LEFT OUT", f"Run {point.run_id} does not count: {point.left_out}.")
    if not point.timed:
        return _not_judged("NO TIME", "The telemetry has no times, so nothing tells whether it is newer; add time_utc.")
    if point.stars < rules.least_stars:
        return _not_judged(
            "FEW STARS",
            f"The fit has {point.stars} stars, and the policy asks for {rules.least_stars}; wait for a longer set.",
        )
    if not point.names or not set(point.names) <= set(reference.names):
        return _not_judged(
            "OTHER PARAMETERS",
            f"Run {point.run_id} estimated other parameters than {reference.name}; choose a preset with the same ones.",
        )
    return None


def _not_judged(code: str, sentence: str) -> PolicyFinding:
    return PolicyFinding("NOT JUDGED", (Reason(code, sentence),))


def _outside_in_row(since: Sequence[Followed], reference: Reference, rules: PolicyRules) -> int:
    """Count how many of the sets before, from the last one on, did not hold either."""
    found = 0
    for one in reversed(since):
        test = _hold(one, reference, rules)
        if not one.found.is_outside and (test is None or not test.rejects):
            break
        found += 1
    return found


def _describe_outcome(point: TrendPoint, reference: Reference, found: PolicyFinding) -> str:
    """Say whether a set holds, by the test that decides."""
    forecast, holds = found.forecast, found.holds
    if forecast is None:
        verb = "does not agree with" if holds is not None and holds.rejects else "agrees with"
        return f"Run {point.run_id} {verb} {reference.name} ({_numbers(holds)})."
    if forecast.rejects:
        return f"Run {point.run_id} is outside of what the sets before forecast ({_numbers(forecast)})."
    if holds is not None and holds.rejects:
        return f"All sets together do not agree with {reference.name} any longer ({_numbers(holds)})."
    return (
        f"Run {point.run_id} is where the sets before forecast it ({_numbers(forecast)}), and {reference.name} holds "
        f"({_numbers(holds)})."
    )


def _numbers(test: ChiSquareTest | None) -> str:
    return "" if test is None else f"χ² {number(test.statistic, 3)} of {test.dof}, limit {number(test.limit, 3)}"


def _reasons(point: TrendPoint, found: PolicyFinding, rules: PolicyRules) -> list[Reason]:
    """Say why a set is outside the baseline, the headline first."""
    reference, holds, largest = found.reference, found.holds, found.largest
    if reference is None or holds is None or largest is None:
        return []
    said = [Reason("OUTSIDE", _describe_outcome(point, reference, found))]
    said.append(
        Reason("LARGEST", f"{quantity(largest[0]).symbol} changed most, {fixed(largest[1], 1)} σ of the difference.")
    )
    if not reference.measured:
        said.append(Reason("GROUND", f"{reference.name} is a ground calibration, declared and not measured."))
    if found.forecast is None:
        said.append(
            Reason(
                "NO FORECAST",
                f"There are fewer than {FEWEST} sets to forecast one, so a drift cannot be told from a jump.",
            )
        )
    elif found.is_forecast:
        said.append(Reason("DRIFT", "It is where the sets before forecast it: a drift, not a jump."))
    else:
        said.append(
            Reason(
                "JUMP", "A jump, or wrong data: the next set tells which; where it agrees with this one, it was a jump."
            )
        )
    of = f"of {rules.confirmations} that the policy asks for" if found.in_row < rules.confirmations else "in a row"
    said.append(Reason("IN ROW", f"{found.in_row} set{'s' if found.in_row != 1 else ''} {of} outside it."))
    return said


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
            reference, since = reference or promote_point(point), []
            continue
        found = judge(point, own, since, reference, rules)
        walked.append((point, found))
        if found.state == "ASKED" and (found.forecast is None or not found.forecast.rejects):
            reference, since = promote_point(point), []
        elif own is not None:
            since.append(own)
    return walked


def _first_reference(points: Sequence[TrendPoint], trend: Trend) -> Reference | None:
    """Return what the oldest set is held against: the baseline where it is declared, else the oldest set itself."""
    baseline = make_reference(trend)
    if baseline is not None and not baseline.measured:
        return baseline
    return promote_point(points[0]) if points else None


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
