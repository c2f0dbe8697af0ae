"""Judging measurements by a profile: one answer a gate, the worst decides, no score.

With value v, 95 % interval [l, h] (both ends v where no sample stands behind it), limit L and marginal M, a gate that wants
its value `below` answers

    FAIL      l > L             worse for sure: a sound set is failed once in forty times at most, even one exactly at the limit
    MARGINAL  h > L or v > M    it may be worse, or comes close: a person judges
    PASS      otherwise

and `above` the other way round. A gate that wants a ratio `around` 1 has, instead of an interval of the value, the bounds
[a, b] within which a sound set's value falls 95 times in a hundred. Both matter: of few data a value far from 1 is no sign of
anything, and of very many a value of 1.001 is significant and means nothing. So

    FAIL      v outside both [a, b] and [1/L, L]
    MARGINAL  v outside both [a, b] and [1/M, M]

No value is NO-DATA. The verdict is the worst answer in the order PASS, MARGINAL, NO-DATA, FAIL, of all gates that are not only
observed. A gate blocks when it FAILs, or must have data and has none, and nobody waived it. A waiver lets a set pass and stays:
the verdict says forever how many gates were waived.

A gate report as people read it, on pages and in terminals: one row of words a gate.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

from boresight.calibration.calibration import parse_part
from boresight.errors import RefusedInputError
from boresight.verdicts.gates.measurements import GATES, Ends, Gate, Measurement
from boresight.verdicts.gates.profile import Profile, Threshold
from boresight.verdicts.numbers import MINUS, MISSING, NARROW_SPACE, number, percent

SCHEMA = "boresight.gate-report/1"
STATUSES = ("PASS", "MARGINAL", "NO-DATA", "FAIL")  # the worst last


@dataclass(frozen=True, kw_only=True)
class GateAnswer:
    """What one gate answers: what was measured, what it was held against, and how it came out.

    `interval`: of 95 %; None stands for an end that is not known. `bounds`: within which a sound set's value falls. `met`: the
    answer of a gate that has no number. `margin`: how far the value is from the limit on its good side.
    """

    name: str
    title: str
    status: str
    value: float | None
    unit: str
    direction: str
    limit: float | None
    marginal: float | None
    incumbent: float | None
    interval: list[float | None] | None
    bounds: list[float | None] | None
    met: str | None
    margin: float | None
    sentence: str
    critical: bool
    waivable: bool
    observe_only: bool
    must_have_data: bool
    waived: bool = False


@dataclass(frozen=True, kw_only=True)
class GateReport:
    """The answers of all gates, `boresight.gate-report/1`, with the verdict, in words too, and the gates that block."""

    schema: str = SCHEMA
    gates: list[GateAnswer]
    verdict: str
    words: str
    blocking: list[str]
    waived: list[str]


Report = TypeVar("Report", bound=GateReport)


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """The validation frames that were used."""

    name: str
    sha256: str


@dataclass(frozen=True, kw_only=True)
class BoundHashes:
    """The hashes of everything that a report of the store rests on."""

    set_sha256: str
    run_result_sha256: str | None
    profile_sha256: str
    incumbent_sha256: str | None
    table_definition_sha256: str | None = None

    def list_moved(self, now: BoundHashes) -> list[BoundInput]:
        """List which have another value now."""
        return [name for name in BOUND if getattr(self, name) != getattr(now, name)]


BoundInput = Literal["set_sha256", "run_result_sha256", "profile_sha256", "incumbent_sha256", "table_definition_sha256"]
#: What each hash is of, in words for people.
BOUND: Mapping[BoundInput, str] = {
    "set_sha256": "set",
    "run_result_sha256": "run result",
    "profile_sha256": "profile",
    "incumbent_sha256": "baseline",
    "table_definition_sha256": "table definition",
}


def name_inputs(moved: Iterable[BoundInput]) -> str:
    """Name inputs in a sentence that begins with its article."""
    return " and the ".join(BOUND[name] for name in moved)


@dataclass(frozen=True, kw_only=True)
class BoundGateReport(GateReport):
    """A report of the store, with the frames that were held out and what it is bound to."""

    held_out: HeldOut | None = None
    bound: BoundHashes


def parse_bound_report(document: Mapping[str, Any]) -> BoundGateReport:
    """Read a report of the store from its JSON."""
    return parse_part(BoundGateReport, document, RefusedInputError)


def parse_held_out(document: Mapping[str, Any]) -> HeldOut | None:
    """Read of a report of the store only which frames were held out."""
    frames = document.get("held_out")
    return None if frames is None else parse_part(HeldOut, frames, RefusedInputError)


def parse_report(document: Mapping[str, Any]) -> GateReport:
    """Read a report from its JSON; whatever else stands in it is left out."""
    return parse_part(GateReport, document, RefusedInputError)


def judge(profile: Profile, measurements: Mapping[str, Measurement], gates: Mapping[str, Gate] = GATES) -> GateReport:
    """Answer every gate of a profile; `gates`: those that it names."""
    nothing = Measurement(None, "This was not measured.")
    answers = [_answer(gates[one.name], one, measurements.get(one.name, nothing)) for one in profile.thresholds]
    return GateReport(**_sum_up(answers, 0))


def summarise(report: Report, waived: Collection[str], ever_waived: Collection[str]) -> Report:
    """Return a report as it stands with waivers."""
    answers = [replace(answer, waived=answer.name in waived) for answer in report.gates]
    return replace(report, **_sum_up(answers, len(set(ever_waived) | set(waived))))


def _sum_up(answers: list[GateAnswer], ever_waived: int) -> dict[str, Any]:
    """Return the members of a report that follow from its answers."""
    counted = [answer for answer in answers if not answer.observe_only]
    verdict = find_worst(answer.status for answer in counted if not (_stands(answer) and _passed_by(answer)))
    return {
        "gates": answers,
        "verdict": verdict,
        "words": words(verdict, ever_waived),
        "blocking": [answer.name for answer in counted if _blocks(answer)],
        "waived": [answer.name for answer in answers if answer.waived],
    }


def find_worst(statuses: Iterable[str]) -> str:
    """Return the worst of some answers; PASS of none."""
    return max(statuses, key=STATUSES.index, default="PASS")


def words(verdict: str, waived: int) -> str:
    """Say a verdict with how many gates were ever waived for it."""
    return f"{verdict} ({waived} gate{'s' * (waived != 1)} waived)" if waived else verdict


def _stands(answer: GateAnswer) -> bool:
    """Whether an answer stands in the way of a set, waived or not."""
    return answer.status == "FAIL" or (answer.status == "NO-DATA" and answer.must_have_data)


def _blocks(answer: GateAnswer) -> bool:
    """Whether an answer stands in the way of a set and nobody lets it pass."""
    return _stands(answer) and not _passed_by(answer)


def _passed_by(answer: GateAnswer) -> bool:
    """Whether a person lets a set pass by this answer."""
    return answer.waived and answer.waivable


def _answer(gate: Gate, threshold: Threshold, measured: Measurement) -> GateAnswer:
    status = _status(threshold, measured)
    return GateAnswer(
        name=gate.name,
        title=gate.title,
        status=status,
        value=measured.value,
        unit=gate.unit,
        direction=gate.direction,
        limit=threshold.limit,
        marginal=threshold.marginal,
        incumbent=measured.incumbent,
        interval=None if measured.interval is None else list(measured.interval),
        bounds=None if measured.bounds is None else list(measured.bounds),
        met=measured.met,
        margin=_margin(threshold, measured),
        sentence=measured.sentence,
        critical=threshold.critical,
        waivable=threshold.waivable,
        observe_only=threshold.observe_only,
        must_have_data=threshold.must_have_data,
    )


def read_measurements(report: GateReport) -> dict[str, Measurement]:
    """Return what was measured, from a report, to be judged by another profile."""
    return {
        answer.name: Measurement(
            value=answer.value,
            sentence=answer.sentence,
            interval=_pair(answer.interval),
            bounds=_pair(answer.bounds),
            incumbent=answer.incumbent,
            met=answer.met,
        )
        for answer in report.gates
    }


def _pair(values: Sequence[float | None] | None) -> Ends | None:
    return None if values is None else (values[0], values[1])


def _status(threshold: Threshold, measured: Measurement) -> str:
    if measured.met is not None:
        return measured.met
    if measured.value is None:
        return "NO-DATA"
    if threshold.direction == "around":
        return _around(threshold, measured.value, measured.bounds)
    sign = 1.0 if threshold.direction == "below" else -1.0
    low, high = sorted(sign * end for end in _ends(measured))
    limit, marginal = (math.inf if edge is None else sign * edge for edge in (threshold.limit, threshold.marginal))
    if low > limit:
        return "FAIL"
    return "MARGINAL" if high > limit or sign * measured.value > marginal else "PASS"


def _ends(measured: Measurement) -> tuple[float, float]:
    """Return the ends of the interval; an unknown end is unbounded, and without an interval both are the value."""
    if measured.interval is None:
        return (float(measured.value or 0.0),) * 2
    low, high = measured.interval
    return (-math.inf if low is None else low, math.inf if high is None else high)


def _around(threshold: Threshold, value: float, bounds: Ends | None) -> str:
    """Hold a ratio that should be 1 against its bounds and the factors that are allowed."""
    low, high = _allowed(threshold.limit, bounds)
    if not low <= value <= high:
        return "FAIL"
    low, high = _allowed(threshold.marginal, bounds)
    return "PASS" if low <= value <= high else "MARGINAL"


def _allowed(factor: float | None, bounds: Ends | None) -> tuple[float, float]:
    """Return the wider of the statistical bounds and a factor either way."""
    if factor is None:
        return -math.inf, math.inf
    low, high = bounds if bounds is not None else (None, None)
    return min(1 / factor, math.inf if low is None else low), max(factor, -math.inf if high is None else high)


def _margin(threshold: Threshold, measured: Measurement) -> float | None:
    """Return how far the value is from the limit on its good side, in its unit; negative beyond it."""
    value, limit = measured.value, threshold.limit
    if value is None or limit is None:
        return None
    if threshold.direction == "around":
        low, high = _allowed(limit, measured.bounds)
        return min(value - low, high - value)
    return limit - value if threshold.direction == "below" else value - limit


SHARES = ("of frames", "of regions", "of pairs")


@dataclass(frozen=True)
class GateRow:
    """One gate of a report, in words."""

    name: str
    title: str
    status: str
    value: str
    interval: str
    limit: str
    marginal: str
    incumbent: str
    margin: str
    unit: str
    decided_by: str
    also: str
    sentence: str
    notes: tuple[str, ...]
    blocking: bool
    waivable: bool

    @property
    def warning(self) -> str:
        """The gate in one sentence: what was measured, the threshold that decides, and why."""
        measured = "" if self.value in {MISSING, *MET.values()} else f"{self.value} {self.unit}".rstrip()
        told = ", ".join(filter(None, (measured, self.decided_by if measured else "")))
        return f"{self.title}: {told}. {self.sentence}" if told else f"{self.title}: {self.sentence}"


def gate_rows(answers: Sequence[GateAnswer], blocking: Collection[str]) -> list[GateRow]:
    """Lay the answers of a report out, a row a gate."""
    return [_row(answer, answer.name in blocking) for answer in answers]


MET = {"PASS": "met", "MARGINAL": "nearly met", "FAIL": "not met"}


def _row(answer: GateAnswer, blocking: bool) -> GateRow:
    unit = answer.unit
    decided_by, also = describe_thresholds(answer)
    return GateRow(
        name=answer.name,
        title=answer.title,
        status=answer.status,
        value=in_unit(unit, answer.value) if answer.met is None else MET[answer.met],
        interval=_between(unit, answer.interval or answer.bounds),
        limit=threshold_text(answer, answer.limit),
        marginal=threshold_text(answer, answer.marginal),
        incumbent=in_unit(unit, answer.incumbent),
        margin=in_unit(unit, answer.margin),
        unit="" if unit in SHARES else unit,
        decided_by=decided_by,
        also=also,
        sentence=answer.sentence,
        notes=tuple(_notes(answer)),
        blocking=blocking,
        waivable=answer.waivable and not answer.critical,
    )


def _notes(answer: GateAnswer) -> list[str]:
    return [
        word
        for word, holds in (
            ("waived", answer.waived),
            ("critical", answer.critical),
            ("observe only", answer.observe_only),
            ("must have data", answer.must_have_data and not answer.critical),
        )
        if holds
    ]


def in_unit(unit: str, value: float | None) -> str:
    """Write a gate's number in its unit, without it; a share as a percentage."""
    if value is None:
        return MISSING
    return percent(value) if unit in SHARES else number(value, 3)


def _between(unit: str, interval: Sequence[float | None] | None) -> str:
    """Write an interval; an unknown end is unbounded."""
    if interval is None:
        return MISSING
    low, high = interval
    left = f"{MINUS}∞" if low is None else in_unit(unit, low)
    return f"{left} to {'∞' if high is None else in_unit(unit, high)}"


def describe_thresholds(answer: GateAnswer) -> tuple[str, str]:
    """Say which threshold decided an answer, then the other; empty where a gate has none."""
    if answer.direction == "met" or answer.value is None:
        return "", ""
    limit = "no limit" if answer.limit is None else f"limit {_good_side(answer, answer.limit)}"
    if answer.marginal is None:
        return limit, ""
    marginal = f"marginal {_beyond(answer, answer.marginal)}"
    if answer.status == "MARGINAL":
        return (marginal, limit) if _is_beyond(answer, answer.marginal) else (f"interval crosses the {limit}", marginal)
    return (limit, marginal) if answer.limit is not None else (marginal, limit)


def _is_beyond(answer: GateAnswer, marginal: float) -> bool:
    """Whether the value itself is beyond the marginal threshold; a ratio that is MARGINAL always is."""
    value = answer.value or 0.0
    return answer.direction == "around" or (value > marginal if answer.direction == "below" else value < marginal)


def _good_side(answer: GateAnswer, limit: float) -> str:
    if answer.direction != "around":
        return threshold_text(answer, limit)
    low, high = _allowed(limit, _pair(answer.bounds))
    return f"{number(low, 3)} to {number(high, 3)}"


def _beyond(answer: GateAnswer, marginal: float) -> str:
    if answer.direction == "around":
        return f"outside {_good_side(answer, marginal)}"
    words = f"{'above' if answer.direction == 'below' else 'below'} {in_unit(answer.unit, marginal)}"
    if answer.name == "weak-directions" and marginal > 0:  # the figure of observability has the inverse on its axis
        words += f" {answer.unit} (under {number(1 / marginal, 2)} times better than typical)"
    return words


def threshold_text(answer: GateAnswer, value: float | None) -> str:
    """Write a threshold with the side that is good."""
    direction = answer.direction
    if direction == "met":
        return MISSING
    if value is None:
        return "none"
    if direction == "around":
        return f"{number(1 / value, 3)} to {number(value, 3)}"
    return f"{'≤' if direction == 'below' else '≥'}{NARROW_SPACE}{in_unit(answer.unit, value)}"
