"""What a calibration's numbers say about its own trustworthiness: one mark a question, the worst of which is the verdict.

Each part of a run's page is judged here too, from the same marks, and so is the summary that lists keep of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from boresight.calibration.advice_kinds import ADVICE_KINDS, CAUSE, Advice, list_codes
from boresight.calibration.calibration import (
    Calibration,
    Change,
    ChiSquareTest,
    Evaluation,
    InnovationTest,
    Observability,
    Trust,
    parse_part,
)
from boresight.calibration.process_noise import LAST_FRAMES, explains_chi2
from boresight.calibration.result import TrendEntry, trend_entry
from boresight.calibration.trust.advice import TOO_SMALL
from boresight.errors import RefusedInputError
from boresight.estimation.filters import FILTERS
from boresight.estimation.statistics.observability import WEAK, is_curved
from boresight.verdicts.history import Ends, find_relative_intervals, interval_of_rms, settled_step, sigma_of_rms
from boresight.verdicts.numbers import count, number, percent, urad, urad_between

LEVELS = ("off", "standby", "normal", "caution", "serious", "critical")  # of the Astro UX status system, worst last
LEVEL_OF_STATUS = {
    "running": "standby",
    "converged": "normal",
    "max_iterations": "caution",
    "rank_deficient": "serious",
    "diverged": "critical",
    "too_few_stars": "critical",
}
NOT_TESTED = "NOT TESTED"  # what nothing was computed for; NO-DATA is the word of a gate alone
WORD_OF_LEVEL = {
    "serious": "converged, but no better",
    "caution": "converged with warnings",
}  # of a fit that converged
WHY = {
    "running": "The run has not ended: everything below is provisional.",
    "max_iterations": "The fit stopped before it converged: allow more iterations, or start closer to the solution.",
    "rank_deficient": "The data do not determine every free parameter: free fewer, or add frames with other stars.",
    "diverged": "The fit diverged: do not use these numbers.",
    "too_few_stars": "No exposure has enough stars, so nothing was estimated.",
}
AT_THE_BOUND = (TOO_SMALL, 1.15)  # claimed sigma over bound: below it is too good to be true, above it data are wasted
NOT_YET = "Not yet: trust is examined when the run ends."
NEVER = "This result has no examination of trust: clone its run and run it again to get one."
NO_REASON = "This part of the examination was not possible for this run."


@dataclass(frozen=True)
class VerdictMark:
    """One answer on the verdict strip; `name` is what code knows it by, `question` what people read."""

    name: str
    question: str
    level: str
    word: str
    value: str
    detail: str
    reason: str = ""


@dataclass(frozen=True)
class PartVerdict:
    """How a part of a run's page stands, in a word; no word where there is nothing to judge."""

    level: str = "off"
    word: str = ""


@dataclass(frozen=True)
class RunVerdict:
    """The worst of the marks."""

    level: str
    word: str
    reasons: tuple[str, ...]


def make_advice(mark: VerdictMark, result: Calibration) -> Advice:
    """Return the reason of a mark, which is advice of the kind that the mark is named by; of the fit, by how it ended."""
    return Advice(mark.reason, result.status if mark.name == "fit" else mark.name)


def _unknown(name: str, question: str, detail: str) -> VerdictMark:
    return VerdictMark(name, question, "off", NOT_TESTED, "–", detail)


def _not_yet(result: Calibration, never: str) -> str:
    """Say that the answer comes with the end of the run, or why there is none."""
    return "Judged when the run ends." if result.status == "running" else never


def _fit(result: Calibration) -> VerdictMark:
    status, steps = result.status, result.iterations
    if status == "running":
        return VerdictMark("fit", "Fit", LEVEL_OF_STATUS[status], status, *_so_far(result), WHY[status])
    of_set = {name: getattr(result, name) for name in ("frames", "exposures", "stars", "pairs")}
    used = ", ".join(f"{count(n)} {name}" for name, n in of_set.items())
    level, value = LEVEL_OF_STATUS[status], describe_iterations(result) if steps else ""
    return VerdictMark(
        "fit", "Fit", level, status.replace("_", " "), value, used, "" if level == "normal" else WHY[status]
    )


def describe_iterations(result: Calibration) -> str:
    """Say what was iterated: a batch goes over the whole set, a filter over each frame for itself."""
    steps = result.iterations
    told = f"{count(steps)} iteration{'s' * (steps != 1)}"
    return f"{told} in {count(result.frames)} updates" if result.method in FILTERS else told


def _so_far(result: Calibration) -> tuple[str, str]:
    """Say as of which frame or iteration a run on its way is told, and how much of its set it has taken in."""
    done, frames = result.frames_done, count(result.frames or None)
    newest = result.history.frame[-1] if result.history and result.history.frame else None
    steps = result.iterations
    value = f"as of frame {newest}" if newest is not None else f"as of iteration {steps}" if steps else ""
    return value, f"{frames} frames in all" if done is None else f"{count(done)} of {frames} frames so far"


def _chi_square(result: Calibration) -> VerdictMark:
    name, question, chi2, per_dof = "chi_square", "χ² per degree of freedom", result.chi2, result.chi2_per_dof
    if per_dof is None or chi2 is None:
        return _unknown(name, question, _not_yet(result, "No chi-square was computed."))
    detail = f"95 % bounds {_bounds(chi2)}, {count(chi2.dof)} degrees of freedom"
    if not is_doubted(result, "chi_square", chi2.consistent):
        detail += f"; {LAST_FRAMES}" if explains_chi2(result) else ""
        return VerdictMark(name, question, "normal", "consistent", number(per_dof), detail)
    word = "noise above model" if per_dof > 1 else "noise below model"
    reason = f"{question} is {number(per_dof, 3)}: the noise is not as assumed."
    return VerdictMark(name, question, "caution", word, number(per_dof), detail, reason)


def is_doubted(result: Calibration, test: str, consistent: bool) -> bool:
    """Whether a test of trust noticed something; by its own bounds where a result has no such test."""
    return next((one.noticed for one in result.tests if one.name == test), not consistent)


def _bounds(test: ChiSquareTest | InnovationTest) -> str:
    return f"{number(test.lower)} to {number(test.upper)}"


def _nis(result: Calibration) -> VerdictMark:
    name, question, nis = "nis", "Innovations (NIS)", result.nis
    if result.method not in FILTERS:
        return VerdictMark(
            name,
            question,
            "off",
            "not applicable",
            "",
            "Only filters have innovations; this run used a method without a filter.",
        )
    if nis is None:
        return _unknown(name, question, "No innovations yet.")
    value, detail = number(nis.mean), f"95 % bounds {_bounds(nis)}, per degree of freedom"
    if nis.consistent:
        return VerdictMark(name, question, "normal", "consistent", value, detail)
    word = "over-confident" if (nis.mean or 0.0) > (nis.upper or 0.0) else "pessimistic"
    reason = "The innovations are outside their 95 % bounds: the sigmas of this filter are wrong."
    return VerdictMark(name, question, "caution", word, value, detail, reason)


def _weakest(result: Calibration) -> VerdictMark:
    name, question, seen = "weakest_direction", "Weakest direction", result.observability
    if seen is None or not seen.singular_values:
        return _unknown(name, question, _not_yet(result, "Observability was not computed."))
    spread = [sigma for sigma in seen.sigma_of_direction if sigma is not None]
    sentence = seen.weakest.sentence or "One direction was not determined at all."
    worst = max(spread, default=0.0)
    if len(spread) < len(seen.singular_values):
        value = f"condition {number(seen.condition_number, 3)}"
        return VerdictMark(name, question, "caution", "weak", value, sentence, sentence)
    if seen.chi2_rise is not None and is_curved(seen.chi2_rise):
        curved = (
            f"One sigma along the weakest direction, chi-square rises by {number(seen.chi2_rise, 3)} instead of 1: "
            "the fit is not linear there, and the sigmas are wrong."
        )
        return VerdictMark(name, question, "caution", "curved", f"{number(worst, 2)} typical σ", sentence, curved)
    if worst > WEAK:
        return VerdictMark(name, question, "caution", "weak", f"{number(worst, 2)} typical σ", sentence, sentence)
    return VerdictMark(name, question, "normal", "known", f"{number(worst, 2)} typical σ", sentence)


def count_weak(seen: Observability) -> int:
    """Count the directions that the data do not see: known worse than `WEAK` typical sigmas, or not at all."""
    return sum(sigma is None or sigma > WEAK for sigma in seen.sigma_of_direction)


def list_rms(scores: Evaluation | None, rms: Change, arcs: float | None) -> list[str]:
    """Write the RMS of a set before and after in microradians, each with its 95 % interval where that is known."""
    ends = _find_rms_ends(scores, rms, arcs)
    return [urad_between(value, known) for value, known in zip((rms.initial, rms.final), ends, strict=True)]


def _find_rms_ends(scores: Evaluation | None, rms: Change, arcs: float | None) -> tuple[Ends | None, Ends | None]:
    """Find the 95 % intervals of the RMS of a set before and after."""
    before, after = find_relative_intervals(scores)
    return interval_of_rms(rms.initial, arcs, before), interval_of_rms(rms.final, arcs, after)


def describe_rms(scores: Evaluation | None, rms: Change, arcs: float | None) -> str:
    """Write the same as one change."""
    return " → ".join(list_rms(scores, rms, arcs))


def _validation(result: Calibration) -> VerdictMark:
    name, question, validation = "validation_rms", "Validation RMS", result.validation
    before, after = (validation.rms_arc_rad.initial, validation.rms_arc_rad.final) if validation else (None, None)
    if validation is None or before is None or after is None:
        return _unknown(name, question, _not_yet(result, "Nothing outside the fitted frames was checked."))
    detail = f"{count(validation.frames)} held-out frames, {percent(validation.availability.final)} available"
    sigma = sigma_of_rms(after, validation.common_pairs)
    value = f"{describe_rms(validation, validation.rms_arc_rad, validation.common_pairs)} µrad"
    known = interval_of_rms(after, validation.common_pairs, find_relative_intervals(validation)[1])
    detail += "; no interval was stored" if known is None else "; 95 % intervals in brackets"
    if after < before:
        return VerdictMark(name, question, "normal", "better", value, detail)
    if sigma is not None and after - before < 3 * sigma:  # a calibration that finds what is in use already
        return VerdictMark(name, question, "normal", "unchanged", value, detail)
    reason = f"On the validation set the error went from {urad(before)} to {urad(after)} µrad."
    return VerdictMark(name, question, "serious", "worse" if after > before else "no better", value, detail, reason)


def make_verdict_marks(result: Calibration) -> list[VerdictMark]:
    """Answer the five questions of the verdict strip."""
    return [question(result) for question in (_fit, _chi_square, _nis, _weakest, _validation)]


def make_verdict(result: Calibration) -> RunVerdict:
    """Judge a result by the worst of its marks and its examination's; one whose fit did not converge by that alone."""
    answers = [*make_verdict_marks(result), *trust_marks(result)]
    fit = answers[0]
    if fit.reason:
        return RunVerdict(fit.level, fit.word, (fit.reason,))
    level = max((mark.level for mark in answers), key=LEVELS.index)
    against = tuple(mark.reason for mark in answers if mark.reason)
    agreement = "The statistics agree with the noise that was assumed."
    return RunVerdict(level, WORD_OF_LEVEL.get(level, "converged and consistent"), against or (agreement,))


def judge_parts(result: Calibration | None) -> dict[str, PartVerdict]:
    """Judge the parts of a run's page that can be judged, by name; none where nothing was estimated."""
    if result is None or not result.parameters:
        return {}
    return {name: judge(result) for name, judge in PART_JUDGES.items()}


def _judge_result(result: Calibration) -> PartVerdict:
    level = make_verdict(result).level
    return PartVerdict(level, {"normal": "no warnings", "standby": "partial"}.get(level, "warnings"))


def _judge_convergence(result: Calibration) -> PartVerdict:
    """Judge whether the estimate settled, and the error by the validation set alone: on its own frames every fit is better."""
    if result.status == "running":
        return PartVerdict("standby", "moving")
    settled = settled_step(result) is not None
    verdict = PartVerdict("normal", "converged") if settled else PartVerdict("caution", "not converged")
    mark = _validation(result)
    return PartVerdict(mark.level, f"validation {mark.word}") if _is_worse(mark.level, verdict.level) else verdict


def _judge_observability(result: Calibration) -> PartVerdict:
    mark = _weakest(result)
    return PartVerdict() if mark.level == "off" else PartVerdict(mark.level, mark.word)


def _judge_evidence(result: Calibration) -> PartVerdict:
    """Judge by the examination, by the residuals' chi-square, and by whether the matches settled."""
    if result.trust is None:
        return PartVerdict()
    doubts = len(trust_doubts(result)) + bool(_chi_square(result).reason)
    doubts += result.matching is not None and not result.matching.rested
    level = max(trust_level(result), _chi_square(result).level, "caution" if doubts else "off", key=LEVELS.index)
    return PartVerdict(level, f"{doubts} warning{'s' * (doubts != 1)}" if doubts else "no deviation found")


def _is_worse(one: str, other: str) -> bool:
    return LEVELS.index(one) > LEVELS.index(other)


#: What judges a part of a run's page, by the part's name.
PART_JUDGES: Mapping[str, Callable[[Calibration], PartVerdict]] = {
    "result": _judge_result,
    "convergence": _judge_convergence,
    "observability": _judge_observability,
    "evidence": _judge_evidence,
}


def trust_marks(result: Calibration) -> list[VerdictMark]:
    """Answer the questions of the examination; none where a result has no examination."""
    if result.trust is None:
        return []
    questions = (_innovations, _whiteness, _causes, _efficiency, _needed, _stars)
    return [*_tests(result), _halves(result), *(question(result.trust) for question in questions)]


def trust_level(result: Calibration) -> str:
    """Return the worst level of the examination, `off` where there is none."""
    return max((mark.level for mark in trust_marks(result)), key=LEVELS.index, default="off")


def trust_doubts(result: Calibration) -> list[str]:
    """List what the examination holds against the result, a sentence each."""
    return [mark.reason for mark in trust_marks(result) if mark.reason]


def prospects(result: Calibration) -> list[str]:
    """Say what more data would buy, which speaks neither for nor against the result."""
    more = result.trust.more_data if result.trust else None
    return [more.sentence] if more and more.sentence else []


def _not_made(trust: Trust, name: str, question: str) -> VerdictMark:
    """Make a mark of a part that is not there; the mark has the part's name."""
    return VerdictMark(name, question, "off", NOT_TESTED, "–", _why_not_made(trust, name))


def _examined(name: str, question: str, words: tuple[str, str], sound: bool, value: str, sentence: str) -> VerdictMark:
    """Make a mark: the first word where all is well, the second, with the sentence as doubt, where it is not."""
    if sound:
        return VerdictMark(name, question, "normal", words[0], value, sentence)
    return VerdictMark(name, question, "caution", words[1], value, sentence, sentence or f"{question}: {words[1]}.")


def _tests(result: Calibration) -> list[VerdictMark]:
    """Say what all tests of the model together noticed, and what explains it; nothing of a result that has none."""
    if not result.tests:
        return []
    noticed = [test for test in result.tests if test.noticed]
    value = f"{count(len(noticed))} of {count(len(result.tests))} found a deviation"
    sentence = " ".join(f"{cause.sentence} {cause.remedy}" for cause in result.causes[:1])
    sound = "No test of the model found a deviation (joint false-alarm rate 1 %)."
    return [
        _examined(
            "tests", "Tests of the model", ("no deviation found", "deviates"), not noticed, value, sentence or sound
        )
    ]


def _halves(result: Calibration) -> VerdictMark:
    trust = result.trust or Trust()
    name, question, part = "two_halves", "Two halves", trust.two_halves
    if part is None:
        return _not_made(trust, name, question)
    chi2 = part.chi2
    value = f"χ² {number(chi2.value, 3)} for {count(chi2.dof)}"
    alike = chi2.consistent or not chi2.value > chi2.upper  # halves more alike than expected are no doubt
    sound = not is_doubted(result, name, alike)
    return _examined(name, question, ("agree", "differ"), sound, value, part.sentence)


def _innovations(trust: Trust) -> VerdictMark:
    name, question, part = "nis_over_time", "Innovations over time", trust.nis_over_time
    if part is None:
        return _not_made(trust, name, question)
    value = f"{percent(part.outside_share)} outside"
    return _examined(name, question, ("as expected", "uneven"), part.consistent, value, part.sentence)


def _whiteness(trust: Trust) -> VerdictMark:
    name, question, part = "whiteness", "Whiteness", trust.whiteness
    if part is None:
        return _not_made(trust, name, question)
    return _examined(
        name, question, ("white", "not white"), part.white, f"p {number(part.ljung_box.p, 2)}", part.sentence
    )


def _efficiency(trust: Trust) -> VerdictMark:
    name, question, part = "efficiency", "Efficiency", trust.efficiency
    if part is None:
        return _not_made(trust, name, question)
    ratio, (low, high) = part.overall_ratio, AT_THE_BOUND
    word = "too good to be true" if ratio < low else "wasteful"
    value = f"{number(ratio, 3)} times the bound"
    return _examined(name, question, ("at the bound", word), low <= ratio <= high, value, part.sentence)


def _causes(trust: Trust) -> VerdictMark:
    """Hold the residual against its causes: the sentences of those that explain it."""
    name, question, part = "residual_against", "Residual against causes", trust.residual_against
    judged = [(cause, bins) for cause, bins in part.by_cause.items() if bins is not None] if part else []
    if not judged:
        return _not_made(trust, name, question)
    uneven = [(cause, bins) for cause, bins in judged if not bins.even]
    told = " ".join(bins.sentence for _, bins in uneven)
    value = ", ".join(cause for cause, _ in uneven or judged)
    return _examined(
        name, question, ("even", "uneven"), not uneven, value, told or "The radial residual depends on none of them."
    )


def _needed(trust: Trust) -> VerdictMark:
    name, question, part = "drop_one", "Parameters", trust.drop_one
    if not part:
        return _not_made(trust, name, question)
    needed = sum(row.needed for row in part)
    sentence = trust.drop_one_sentence or ""
    return _examined(
        name, question, ("all needed", "some not needed"), needed == len(part), f"{needed} of {len(part)}", sentence
    )


def _stars(trust: Trust) -> VerdictMark:
    name, question, part = "stars", "Stars", trust.stars
    if not part:
        return _not_made(trust, name, question)
    value = f"{count(len(trust.suspects))} of {count(trust.stars_in_all or len(part))}"
    sentence = trust.stars_sentence or "Check the suspects before the next run."
    return _examined(name, question, ("none suspect", "suspects"), not trust.suspects, value, sentence)


def why_absent(result: Calibration, part: str) -> str:
    """Say in a sentence why a part of the examination is not there."""
    if result.trust is None:
        return NOT_YET if result.status == "running" else NEVER
    return _why_not_made(result.trust, part)


def _why_not_made(trust: Trust, part: str) -> str:
    return trust.unavailable.get(part) or NO_REASON


@dataclass(frozen=True)
class RunSummary:
    """What lists show of a run; what its calibration does not have, or what was not kept yet when it ended, is None.

    `advice`: the gravest sentence; `finding`: what it found, for a line among others; absent from summaries of earlier versions.
    `weak_directions`: how many the data hardly determine, or not at all. The intervals are those of 95 %; absent from summaries of
    earlier versions. `tail_rms_rad`: of a filter, at its end. `seconds`, `cpu_seconds`: what a worker took for it.
    """

    status: str | None = None
    level: str | None = None
    advice: str | None = None
    finding: str | None = None
    advice_code: str | None = None
    chi2_consistent: bool | None = None
    weak_directions: int | None = None
    rms_initial_arc_rad: float | None = None
    rms_final_arc_rad: float | None = None
    chi2_per_dof: float | None = None
    iterations: int | None = None
    frames: int | None = None
    stars: int | None = None
    weakest: str | None = None
    tail_rms_rad: float | None = None
    availability: float | None = None
    trend: TrendEntry | None = None
    validation_rms_initial_arc_rad: float | None = None
    validation_rms_final_arc_rad: float | None = None
    rms_initial_interval_rad: list[float] | None = None
    rms_final_interval_rad: list[float] | None = None
    validation_rms_initial_interval_rad: list[float] | None = None
    validation_rms_final_interval_rad: list[float] | None = None
    seconds: float | None = None
    cpu_seconds: float | None = None


def parse_run_summary(document: Mapping[str, Any] | None) -> RunSummary:
    """Read the summary in a run's row, whatever version wrote it; one that tells nothing where the row has none.

    A damaged one says that it is: one row must not refuse a list, or keep other runs waiting.
    """
    try:
        return parse_part(RunSummary, document or {}, RefusedInputError)
    except RefusedInputError as error:
        said = f"The summary in the run's row is damaged ({error}): read its calibration, or restore the database from a backup."
        return RunSummary(status="damaged", level="serious", advice=said)


def summarise_run(result: Calibration) -> RunSummary:
    """Pick the figures for lists."""
    judged = make_verdict(result)
    advice = [*result.advice, *(judged.reasons if judged.level != "normal" else ())]
    seen, validation, history = result.observability, result.validation, result.history
    fitted = _find_rms_ends(result.evaluation, result.rms_arc_rad, result.pairs)
    of_validation = (
        _find_rms_ends(validation, validation.rms_arc_rad, validation.common_pairs) if validation else (None, None)
    )
    before, after, valid_before, valid_after = (ends and list(ends) for ends in (*fitted, *of_validation))
    return RunSummary(
        status=result.status,
        level=judged.level,
        advice=str(advice[0]) if advice else None,
        finding=name_finding(advice[0], result) if advice else None,
        advice_code=next(iter(list_codes(advice)), None),
        chi2_consistent=not is_doubted(result, "chi_square", result.chi2.consistent) if result.chi2 else None,
        weak_directions=count_weak(seen) if seen else None,
        rms_initial_arc_rad=result.rms_arc_rad.initial,
        rms_final_arc_rad=result.rms_arc_rad.final,
        chi2_per_dof=result.chi2_per_dof,
        iterations=result.iterations,
        frames=result.frames,
        stars=result.stars,
        weakest=seen.weakest.sentence if seen else None,
        tail_rms_rad=history.tail_rms_rad[-1] if history and history.tail_rms_rad else None,
        availability=validation.availability.final if validation else None,
        trend=trend_entry(result),
        validation_rms_initial_arc_rad=validation.rms_arc_rad.initial if validation else None,
        validation_rms_final_arc_rad=validation.rms_arc_rad.final if validation else None,
        rms_initial_interval_rad=before,
        rms_final_interval_rad=after,
        validation_rms_initial_interval_rad=valid_before,
        validation_rms_final_interval_rad=valid_after,
    )


def name_finding(advice: str, result: Calibration) -> str:
    """Return the finding behind an advice: its own, else the sentence of its cause, else of its kind; other text as it is."""
    if not isinstance(advice, Advice):
        return advice
    cause = next((one.sentence for one in result.causes if f"{CAUSE}{one.name}" == advice.code), None)
    return advice.finding or cause or ADVICE_KINDS.get(advice.code, advice)


def judge_result(summary: RunSummary) -> str:
    """Judge a finished run by its summary: the verdict of its page, and no better than caution where it gave advice."""
    level = summary.level or LEVEL_OF_STATUS.get(summary.status or "converged", "serious")
    doubted = summary.advice or summary.weak_directions or summary.chi2_consistent is False
    return max(level, "caution" if doubted else "normal", key=LEVELS.index)
