"""What a run stands on besides its first set: how much came from its prior, and what each of its passes says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from boresight.calibration.calibration import Calibration, InputPass, PassState, PriorUse
from boresight.calibration.joint.passes_fit import CHANGES
from boresight.calibration.joint.prior import DISAGREE
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.estimation.statistics.special import chdtrc
from boresight.figures import passes as passes_figure
from boresight.verdicts.numbers import MISSING, number, percent, quantity


@dataclass(frozen=True)
class PriorRow:
    """A parameter: the share of its variance that the prior gave, and its sigma in the prior and now, as the page writes them."""

    name: str
    share: float | None
    prior_sigma: float | None
    sigma: float | None


@dataclass(frozen=True)
class PriorView:
    """How much came from a prior, in a sentence and by parameter, and whether the data agree with it."""

    title: str
    source: str
    answer: str
    address: str | None
    rows: Sequence[PriorRow]
    level: str
    agreement: str


@dataclass(frozen=True)
class PassRow:
    """A pass: where its set is, its size, its chi-square a pair, and how far each varied parameter is from the last pass."""

    name: str
    address: str | None
    start_utc: str | None
    frames: int
    stars: int | None
    chi2: str
    level: str
    word: str
    departures: Sequence[str]


def make_origin(run: Run, sets: Sequence[TelemetrySet], result: Calibration | None) -> dict[str, Any]:
    """Gather what came from the prior, and the passes of a joint run."""
    if result is None or not result.parameters:
        return {"prior": None, "passes": None, "passes_figure": None}
    varied = result.variation.vary if result.variation else []
    return {
        "prior": None if result.prior is None else make_prior_view(run, result, result.prior),
        "passes": {
            "answer": say_passes(result),
            "heads": [(name, quantity(name, result).unit) for name in varied],
            "rows": list_pass_rows(sets, result),
        }
        if len(result.inputs.passes) > 1
        else None,
        "passes_figure": passes_figure if varied else None,
    }


def make_prior_view(run: Run, result: Calibration, use: PriorUse) -> PriorView:
    """Lay out what a calibration began with."""
    shares = [share for share in use.share.values() if share is not None]
    aged = "" if use.age_days is None else f", {use.age_days:.3g} days old"
    answer = f"Started from {use.name}{aged}. With process noise or forgetting, its share decreases over time and is not reported."
    if shares:
        spread = percent(min(shares), 0)
        if percent(max(shares), 0) != spread:
            spread += f" to {percent(max(shares), 0)}"
        answer = f"{spread} of each parameter's variance came from {use.name}{aged}, the rest from these data."
    rows = [PriorRow(name, share, use.sigma.get(name), result.sigma.get(name)) for name, share in use.share.items()]
    source = use.name if result.variation is None else "the other passes"
    who = "Prior and data" if result.variation is None else "The other passes and the last"
    level, agreement = "standby", "The data determine no direction that could be compared with the prior."
    if use.agreement is not None:
        told = use.agreement
        agrees = told.p_value >= DISAGREE
        level = "normal" if agrees else "serious"
        agreement = (
            f"{who} {'agree' if agrees else 'contradict each other'}: chi-square {told.chi2:.3g} of {told.dof} degrees of "
            f"freedom, p = {told.p_value:.2g}."
        )
    named = f"/parameter-sets/{run.prior_set_id}" if run.prior_set_id else f"/runs/{run.prior_run_id}"
    return PriorView(
        f"What came from {source}", source, answer, named if run.prior_run_id else None, rows, level, agreement
    )


def say_passes(result: Calibration) -> str:
    """Say of a joint calibration in one sentence what its passes show."""
    if result.variation is not None:
        return result.variation.sentence
    passes = result.inputs.passes
    worse = [one.name for one in passes if _judge(one)[0] == "caution"]
    if worse:
        few = ", ".join(worse[:3]) + (f" and {len(worse) - 3} more" if len(worse) > 3 else "")
        which = "fits significantly worse: let a parameter vary, or examine that pass alone"
        if len(worse) > 1:
            which = "fit significantly worse: let a parameter vary, or examine those passes alone"
        return f"{len(passes)} passes as one camera; {few} {which}."
    return f"{len(passes)} passes as one camera; no pass fits significantly worse."


def list_pass_rows(sets: Sequence[TelemetrySet], result: Calibration) -> list[PassRow]:
    """Lay out every pass, in the order in which they were taken."""
    addresses = {one.original_sha256: f"/telemetry/{one.id}" for one in sets}
    found = result.variation
    states: Sequence[PassState | None] = found.states if found else [None] * len(result.inputs.passes)
    rows = []
    for one, state in zip(result.inputs.passes, states, strict=False):
        level, word = _judge(one)
        departures = []
        for name in found.vary if found and state else ():
            item, last = quantity(name, result), found.states[-1] if found else None
            if state is not None and last is not None:
                moved = item.factor * (state.parameters[name] - last.parameters[name])
                departures.append(f"{number(moved)} ± {number(item.factor * state.sigma[name], 2)}")
        chi2 = MISSING if one.chi2 is None or not one.pairs else f"{number(one.chi2 / one.pairs)}"
        address = addresses.get(one.sha256 or "")
        rows.append(PassRow(one.name, address, one.start_utc, one.frames, one.stars, chi2, level, word, departures))
    return rows


def _judge(one: InputPass) -> tuple[str, str]:
    """Hold a pass's chi-square against chance."""
    if one.chi2 is None or not one.pairs:
        return "off", "no arcs"
    return ("normal", "as expected") if chdtrc(one.pairs, one.chi2) >= CHANGES else ("caution", "too large")
