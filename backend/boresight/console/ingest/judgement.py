"""Is a new set within the forecast? One calibration against the baseline, and against the line through those before it.

Let theta be the new estimate with covariance P, theta_b the baseline's with B, and alpha the policy's false-alarm rate.

- *It holds* where D^2 = (theta - theta_b)^T (P + B)^-1 (theta - theta_b) stays below the chi-square limit of alpha
  (`estimation.statistics.drift`): nothing is asked. P is of the set's own stars alone: a prior would tie the two together.
- *It left the baseline* otherwise; people are asked once so many sets in a row did. That the line through the sets before it,
  at the time and temperature of the new one, forecasts it tells a drift from a jump, by the same test.
- *It is not judged* where it cannot be compared, and says why.

A dry run walks over the calibrations of the past by the same function, with each one that would have been asked as the next
reference, as though people had promoted it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from boresight.console.fleet.trend import Trend, TrendPoint, make_baseline_epoch, make_epoch
from boresight.console.ingest.rules import PolicyRules
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
class PolicyFinding:
    """What a policy finds in one calibration.

    `state`: as of a decision. `holds`, `forecast`: against the baseline and the line. `largest`: the parameter that moved most,
    and by how many of its sigmas. `in_row`: sets outside the baseline in a row, this one with them.
    """

    state: str
    reasons: tuple[Reason, ...]
    reference: Reference | None = None
    holds: ChiSquareTest | None = None
    forecast: ChiSquareTest | None = None
    largest: tuple[str, float] | None = None
    in_row: int = 0

    @property
    def sentence(self) -> str:
        """The first reason."""
        return self.reasons[0].sentence

    @property
    def is_forecast(self) -> bool:
        """Whether the line through the sets before it forecasts it."""
        return self.forecast is not None and not self.forecast.rejects


def make_reference(trend: Trend) -> Reference | None:
    """Return a sensor's baseline as a reference; None where it has none."""
    if trend.baseline is None:
        return None
    own = trend.of_run(trend.baseline.run_id)
    names = tuple(trend.baseline.document["covariance"]["names"])
    measured = trend.baseline.run_id is not None
    epoch = make_baseline_epoch(trend.baseline, own, names)
    return Reference(trend.baseline.name, names, epoch, trend.baseline.id, trend.baseline.run_id, measured)


def reference_of(point: TrendPoint) -> Reference:
    """Return a calibration as a reference, as though it had been promoted."""
    return Reference(f"run {point.run_id}", point.names, make_epoch(point, point.names), None, point.run_id)


def judge_newest(trend: Trend, run_id: int, rules: PolicyRules) -> PolicyFinding:
    """Judge the calibration of a run against the baseline, and the line through those before it."""
    point, reference = trend.of_run(run_id), make_reference(trend)
    if reference is None:
        return _not_judged("NO BASELINE", "There is no baseline to compare with; register the sensor again.")
    if point is None:
        return _not_judged(
            "NO RESULT", f"Run {run_id} has no calibration of the baseline's camera model; choose another preset."
        )
    own = trend.of_run(reference.run_id)
    if own is not None and (point.overlaps(own) or point.at_utc <= own.at_utc):
        return _not_judged(
            "OLDER", f"The data are not newer than those of {reference.name}; nothing is to be decided on them."
        )
    before = [
        one for one in trend.independent if one.at_utc < point.at_utc and (own is None or one.at_utc > own.at_utc)
    ]
    return judge(point, before, reference, rules)


def judge(point: TrendPoint, before: Sequence[TrendPoint], reference: Reference, rules: PolicyRules) -> PolicyFinding:
    """Judge one calibration; `before`: those since the reference, by time."""
    if (refusal := _refuse(point, reference, rules)) is not None:
        return refusal
    names = point.names
    order = [reference.names.index(name) for name in names]
    base = Epoch(0.0, reference.epoch.value[order], reference.epoch.covariance[np.ix_(order, order)])
    epoch = make_epoch(point, names)
    holds = tests.baseline_test(epoch, base, rules.false_alarm_rate)
    if holds is None:
        return _not_judged(
            "NO COVARIANCE", f"The covariance of run {point.run_id} or of {reference.name} is not positive definite."
        )
    of_line = [one for one in before if one.timed and set(one.names) == set(names)]
    line = tests.forecast([make_epoch(one, names) for one in of_line], epoch.t_d, epoch.temperature_c)
    forecast = None if line is None else tests.baseline_test(epoch, line, rules.false_alarm_rate)
    worth = (epoch.value - base.value) / np.sqrt(np.diag(epoch.covariance + base.covariance))
    most = int(np.argmax(np.abs(worth)))
    found = PolicyFinding("WITHIN FORECAST", (), reference, holds, forecast, (names[most], float(worth[most])))
    if not holds.rejects:
        return replace(found, reasons=(Reason("HOLDS", _said(point, reference, holds, "agrees with")),))
    in_row = 1 + _outside_in_row(before, base, names, rules)
    state = "ASKED" if in_row >= rules.confirmations else "UNCONFIRMED"
    return replace(
        found, state=state, in_row=in_row, reasons=tuple(_reasons(point, replace(found, in_row=in_row), rules))
    )


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


def _outside_in_row(before: Sequence[TrendPoint], base: Epoch, names: tuple[str, ...], rules: PolicyRules) -> int:
    """Count how many of the sets before, from the last one on, were outside the baseline too."""
    found = 0
    for one in reversed(before):
        if set(one.names) != set(names):
            continue
        test = tests.baseline_test(make_epoch(one, names), base, rules.false_alarm_rate)
        if test is None or not test.rejects:
            break
        found += 1
    return found


def _said(point: TrendPoint, reference: Reference, test: ChiSquareTest, verb: str) -> str:
    limit = f"χ² {number(test.statistic, 3)} of {test.dof}, limit {number(test.limit, 3)}"
    return f"Run {point.run_id} {verb} {reference.name} ({limit})."


def _reasons(point: TrendPoint, found: PolicyFinding, rules: PolicyRules) -> list[Reason]:
    """Say why a set is outside the baseline, the headline first."""
    reference, holds, largest = found.reference, found.holds, found.largest
    if reference is None or holds is None or largest is None:
        return []
    said = [Reason("OUTSIDE", _said(point, reference, holds, "does not agree with"))]
    said.append(Reason("LARGEST", f"{quantity(largest[0]).symbol} changed most, {fixed(largest[1], 1)} σ."))
    if not reference.measured:
        said.append(Reason("GROUND", f"{reference.name} is a ground calibration, declared and not measured."))
    if found.forecast is None:
        said.append(
            Reason("NO LINE", "There are fewer than three sets since then, so a drift cannot be told from a jump.")
        )
    elif found.is_forecast:
        said.append(Reason("DRIFT", "It is where the line through the sets before forecasts it: a drift, not a jump."))
    else:
        numbers = (
            f"χ² {number(found.forecast.statistic, 3)} of {found.forecast.dof}, limit {number(found.forecast.limit, 3)}"
        )
        said.append(
            Reason("JUMP", f"The line through the sets before does not forecast it ({numbers}): a jump, or wrong data.")
        )
    of = f"of {rules.confirmations} that the policy asks for" if found.in_row < rules.confirmations else "in a row"
    said.append(Reason("IN ROW", f"{found.in_row} set{'s' if found.in_row != 1 else ''} {of} outside it."))
    return said
