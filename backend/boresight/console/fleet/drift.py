"""Whether a sensor drifts: the tests of `estimation.statistics.drift` on its trend, in words.

Asked is what matters now, so only data since the baseline's own take part: once a new baseline is promoted, the drift that led
to it is history and the alarm returns to normal. Two tests share the false-alarm rate of 0.1 % for each look:

- does the newest calibration, of data that the baseline has not seen, agree with the baseline?
- do all calibrations since the baseline, its own among them, move with time, once temperature has its part?

A ground calibration is declared and not measured: its sigmas are the spread from unit to unit, and it is on no line. A shift
against it tells of the launch and of what was declared, not of time: it is a `GROUND SHIFT`, and drift is only what moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.console.fleet.trend import Trend, TrendPoint
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.estimation.statistics import drift as tests
from boresight.estimation.statistics.drift import FALSE_ALARM_RATE, Epoch, RegressionLine
from boresight.verdicts.numbers import fixed, number, quantity

DAY_S = 86400.0
GROUND_SHIFTED = "The ground calibration does not hold any more: promote a calibration made on orbit."
EPOCH = "2000-01-01T12:00:00+00:00"  # days are counted from J2000, and any day would do


@dataclass(frozen=True)
class DriftResult:
    """What the tests say.

    `names`: (k,) parameters that were tested. `difference`, `sigma`: (k,) newest minus baseline and one sigma of it,
    SI. `covariance`: (k, k) of the difference.
    """

    verdict: str
    sentence: str
    names: tuple[str, ...] = ()
    newest: TrendPoint | None = None
    difference: FloatArray | None = None
    sigma: FloatArray | None = None
    covariance: FloatArray | None = None
    holds: tests.ChiSquareTest | None = None
    slope: tests.ChiSquareTest | None = None
    line: RegressionLine | None = None
    counted: int = 0

    @property
    def largest(self) -> tuple[str, float] | None:
        """The parameter that moved most in its own sigma, and by how many."""
        if self.difference is None or self.sigma is None:
            return None
        worth = self.difference / self.sigma
        most = int(np.argmax(np.abs(worth)))
        return self.names[most], float(worth[most])


def judge_drift(trend: Trend, alpha: float = FALSE_ALARM_RATE) -> DriftResult:
    """Test a sensor for drift."""
    if trend.baseline is None:
        return DriftResult(
            "NOT TESTED", "There is no baseline to hold a calibration against; register the sensor again."
        )
    own = trend.of_run(trend.baseline.run_id)
    since = [point for point in trend.independent if _is_since(point, own, trend.baseline)]
    later = [point for point in since if own is None or not point.overlaps(own)]
    if not later:
        return DriftResult("NOT TESTED", _nothing_newer(trend))
    newest = later[-1]
    names, base = newest.names, _baseline_epoch(trend.baseline, own, newest.names)
    series = [make_epoch(point, names) for point in since if point.timed and set(point.names) == set(names)]
    line = tests.fit_line(series)
    share = alpha / (1 if line is None else 2)
    first = make_epoch(newest, names)
    held = tests.baseline_test(first, base, share)
    slope = None if line is None else tests.slope_test(line, share)
    if held is None:
        return DriftResult(
            "NOT TESTED", f"The covariance of run {newest.run_id} or of the baseline is not positive definite."
        )
    covariance = first.covariance + base.covariance
    found = DriftResult(
        _verdict(held, slope, trend.baseline),
        "",
        names,
        newest,
        first.value - base.value,
        np.sqrt(np.diag(covariance)),
        covariance,
        held,
        slope,
        line,
        len(series),
    )
    return _with_sentence(found, trend.baseline)


def _verdict(held: tests.ChiSquareTest, slope: tests.ChiSquareTest | None, baseline: ParameterSet) -> str:
    """Say it in a word; calibrations that move with time drift, whatever the baseline was made from."""
    if slope is not None and slope.rejects:
        return "DRIFT"
    if not held.rejects:
        return "HOLDS"
    return "GROUND SHIFT" if baseline.run_id is None else "DRIFT"


def _is_since(point: TrendPoint, own: TrendPoint | None, baseline: ParameterSet) -> bool:
    """Whether a calibration is of the baseline's own data or of later ones."""
    if baseline.run_id is None:
        return True
    if own is None:
        return baseline.baseline_from_utc is None or point.at_utc >= baseline.created_utc
    return point.run_id == own.run_id or point.overlaps(own) or point.at_utc > own.at_utc


def _nothing_newer(trend: Trend) -> str:
    name = trend.baseline.name if trend.baseline else "the baseline"
    left = sum(bool(point.left_out) for point in trend.points)
    more = f" {left} of {len(trend.points)} calibrations take no part; the table says why." if left else ""
    return f"No calibration of data that {name} has not seen: upload newer telemetry and calibrate it.{more}"


def make_epoch(point: TrendPoint, names: Sequence[str]) -> Epoch:
    """Return a calibration's estimate of these parameters, in their order."""
    order = [point.names.index(name) for name in names]
    days = (datetime.fromisoformat(point.at_utc) - datetime.fromisoformat(EPOCH)).total_seconds() / DAY_S
    value = np.array([point.parameters[name] for name in names], dtype=np.float64)
    warmth = np.nan if point.temperature_c is None else point.temperature_c
    return Epoch(days, value, point.covariance[np.ix_(order, order)], warmth)


def _baseline_epoch(baseline: ParameterSet, own: TrendPoint | None, names: Sequence[str]) -> Epoch:
    """Return the baseline's estimate; its run's covariance is the honest one where it is known."""
    document = baseline.document["covariance"]
    listed, matrix = list(document["names"]), np.array(document["matrix"], dtype=np.float64)
    if own is not None and set(names) <= set(own.names):
        listed, matrix = list(own.names), own.covariance
    order = [listed.index(name) for name in names]
    value = np.array([baseline.document["parameters"][name] for name in names], dtype=np.float64)
    return Epoch(0.0, value, matrix[np.ix_(order, order)])


def _with_sentence(found: DriftResult, baseline: ParameterSet) -> DriftResult:
    """Say what was found, the test that rejects first."""
    first = [GROUND_SHIFTED] if found.verdict == "GROUND SHIFT" else []
    said = [*first, _of_the_baseline(found, baseline), *_of_the_slope(found), *_of_temperature(found)]
    return replace(found, sentence=" ".join(said))


def _of_the_baseline(found: DriftResult, baseline: ParameterSet) -> str:
    """Say whether the baseline holds."""
    if found.holds is None or found.newest is None or found.largest is None:
        return ""
    name, worth = found.largest
    numbers = f"χ² {number(found.holds.statistic, 3)} of {found.holds.dof}, limit {number(found.holds.limit, 3)}"
    if found.holds.rejects:
        moved = f"{quantity(name).symbol} moved most, {fixed(worth, 1)} σ"
        return f"Run {found.newest.run_id} does not agree with {baseline.name} ({numbers}); {moved}."
    return f"Run {found.newest.run_id} agrees with {baseline.name} ({numbers})."


def _of_the_slope(found: DriftResult) -> list[str]:
    """Say whether there is a slope."""
    if found.slope is None or found.line is None:
        return ["Too few calibrations since the baseline for a slope: three of different times show one."]
    said = "move with time" if found.slope.rejects else "do not move with time"
    numbers = f"χ² {number(found.slope.statistic, 3)} of {found.slope.dof}, limit {number(found.slope.limit, 3)}"
    sentences = [f"{found.counted} calibrations since the baseline {said} ({numbers})."]
    if found.line.inflation > 1.0:
        factor = fixed(found.line.inflation**0.5, 2)
        sentences.append(
            f"They scatter {factor} times as much as their sigmas say; the slope's sigmas are widened by that."
        )
    return sentences


def _of_temperature(found: DriftResult) -> list[str]:
    """Say what part temperature has."""
    if found.line is None or found.line.thermal_per_c is None or found.line.thermal_covariance is None:
        return []
    statistic = tests.mahalanobis(found.line.thermal_per_c, found.line.thermal_covariance)
    if statistic is None:
        return []
    test = tests.chi_square_test(statistic, len(found.names), FALSE_ALARM_RATE)
    return ["They move with temperature; the slope is what is left."] if test.rejects else []


def document(found: DriftResult) -> dict[str, Any]:
    """Write what the tests say as JSON, SI."""
    line = found.line
    return {
        "verdict": found.verdict,
        "sentence": found.sentence,
        "false_alarm_rate": FALSE_ALARM_RATE,
        "run_id": None if found.newest is None else found.newest.run_id,
        "names": list(found.names),
        "difference": _listed(found.names, found.difference),
        "sigma": _listed(found.names, found.sigma),
        "baseline_holds": _test(found.holds),
        "slope": _test(found.slope),
        "calibrations_on_the_line": found.counted,
        "slope_per_day": _listed(found.names, None if line is None else line.slope_per_d),
        "slope_sigma_per_day": _listed(found.names, None if line is None else np.sqrt(np.diag(line.slope_covariance))),
        "change_per_c": _listed(found.names, None if line is None else line.thermal_per_c),
    }


def _listed(names: Sequence[str], values: FloatArray | None) -> dict[str, float] | None:
    return None if values is None else dict(zip(names, values.tolist(), strict=True))


def _test(test: tests.ChiSquareTest | None) -> dict[str, Any] | None:
    if test is None:
        return None
    return {"statistic": test.statistic, "dof": test.dof, "limit": test.limit, "p": test.p, "rejects": test.rejects}
