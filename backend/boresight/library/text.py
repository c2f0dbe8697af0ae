"""Answers in words, for a terminal: a calibration's parameters, what its fit is worth, advice; the others as a `Summary` each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from boresight.calibration.calibration import (
        Calibration,
        Change,
        ChiSquareTest,
        Evaluation,
        InnovationTest,
        Matching,
        Numbers,
    )
    from boresight.calibration.choice.result import Choice
    from boresight.calibration.diagnosis.result import Diagnosis
    from boresight.library.results import Assessment, Extraction, Matches, NewSensor, Quality
    from boresight.library.results import Evaluation as Comparison


def aligned(rows: Iterable[Sequence[str]], left: Iterable[int] = (0,)) -> str:
    """Lay rows out in columns two spaces apart, numbers to the right, the columns of `left` to the left."""
    table = [[str(cell) for cell in row] for row in rows]
    widths = [max(len(cell) for cell in column) for column in zip(*table, strict=True)]
    sides = [str.ljust if i in set(left) else str.rjust for i in range(len(widths))]
    return "\n".join(
        "  ".join(side(cell, width) for side, cell, width in zip(sides, row, widths, strict=True)).rstrip()
        for row in table
    )


def summary_lines(found: Calibration) -> Iterator[str]:
    """Write a calibration in lines."""
    from boresight.figures.tables import HEADINGS, printed_rows

    yield headline(found)
    if left_out := "; ".join(f"{item.count:,} {item.what}: {item.reason}" for item in found.left_out):
        yield f"left out: {left_out}"
    yield from _removed(found)
    yield ""
    yield aligned([HEADINGS, *(row.cells for row in printed_rows(found))], left=(0, 1))
    yield ""
    yield aligned([("verdict", verdict(found)), *_scores(found)], left=(0, 1))
    yield from _intervals(found)
    for sentence in found.advice:
        yield f"\n- {sentence}"


#: Removed stars that are named on a terminal.
MOST_REMOVED = 5


def _removed(found: Calibration) -> Iterator[str]:
    """Say how many proposed stars were removed, and name the first."""
    from boresight.figures.tables import printed_probability

    of = found.removed_of
    if of is None or not of.removed:
        return
    yield f"removed: {of.removed:,} of {of.proposed:,} proposed stars"
    for one in found.removed[:MOST_REMOVED]:
        star = "" if one.star_id is None else f", HIP {one.star_id}"
        chance = "" if one.probability is None else f" (p {printed_probability(one.probability, '= ')})"
        yield f"  row {one.row}, frame {one.frame}, exposure {one.exposure}{star}: {one.reason}{chance}"
    if of.removed > MOST_REMOVED:
        yield f"  and {of.removed - MOST_REMOVED:,} more; --json writes them"


def _intervals(found: Calibration) -> Iterator[str]:
    """Write other minima, and the intervals that are not those of the sigmas."""
    from boresight.figures.tables import interval_rows, minimum_rows

    others, intervals = minimum_rows(found), interval_rows(found)
    if others:
        yield ""
        yield aligned([("other minima", ""), *((f"chi-square {one.above}", one.values) for one in others)], left=(0, 1))
    if intervals:
        yield ""
        table = ((one.symbol, one.unit, one.interval, one.by_sigma) for one in intervals)
        heading = ("parameter", "unit", f"{intervals[0].confidence} by profile likelihood", "by its sigma")
        yield aligned([heading, *table], left=(0, 1))


def headline(found: Calibration) -> str:
    """Return one line on what was calibrated, how, and from how much data."""
    words = [found.method, found.variant or "", found.status.replace("_", " ")]
    counts = f"{found.frames:,} frames, {found.exposures:,} exposures, {found.stars:,} stars, {found.pairs:,} pairs"
    return f"{found.sensor}: {', '.join(word for word in words if word)}; {counts}"


def verdict(found: Calibration) -> str:
    """Return the trustworthiness of the numbers in a word or two; the advice says why."""
    from boresight.verdicts.verdict import make_verdict

    return make_verdict(found).word


def _scores(found: Calibration) -> Iterator[tuple[str, str]]:
    yield "RMS arc error", _pair(found.rms_arc_rad)
    for name, part in (
        ("passes", found.variation),
        ("prior", found.prior),
        ("process noise", found.process_noise),
        ("smoother", found.smoothed),
        ("misfit", found.misfit),
        ("minima", found.minima),
    ):
        if part is not None:
            yield name, part.sentence
    yield from _statistics(found)
    if found.matching is not None:
        yield "matches", _matches(found.matching)
    for name, scores in (("calibration set", found.evaluation), ("validation set", found.validation)):
        if scores is not None:
            yield f"{name}, availability", _share(scores)
            yield f"{name}, RMS", _pair(scores.rms_arc_rad)
    if found.alignment is not None:
        yield "C_SD", found.alignment.sentence
    yield from _noise(found)
    yield from _assumed(found)


def _statistics(found: Calibration) -> Iterator[tuple[str, str]]:
    """Name what the residuals, the tests and the information say."""
    if found.chi2 is not None:
        from boresight.calibration.process_noise import LAST_FRAMES, explains_chi2

        word = LAST_FRAMES if explains_chi2(found) else None
        yield "chi2 per degree of freedom", _test(found.chi2_per_dof, found.chi2, word)
    if found.tests:
        yield (
            "tests of the model",
            f"{sum(test.noticed for test in found.tests)} of {len(found.tests)} noticed something",
        )
    if found.nis is not None and found.method != "batch":
        yield "innovations (NIS)", _test(found.nis.mean, found.nis)
    if (seen := found.observability) is not None:
        number = seen.condition_number
        yield "condition number", "infinite" if number is None else f"{number:,.4g}"
        yield "weakest direction", seen.weakest.sentence


def _noise(found: Calibration) -> Iterator[tuple[str, str]]:
    """Name the terms of the centroid noise that are applied or needed."""
    terms = [] if found.noise is None else [term for term in found.noise.terms if term.needed]
    for place, term in enumerate(terms):
        yield ("" if place else "centroid noise"), term.sentence


def _assumed(found: Calibration) -> Iterator[tuple[str, str]]:
    """Name what was assumed and not declared, and what was declared and left in."""
    undeclared = ", ".join(
        f"{one.name.replace('_', ' ')}: {one.value}" for one in found.assumptions if not one.declared
    )
    if undeclared:
        yield "assumed, not declared", f"{undeclared}; declare the true ones in the sensor file (readout, declared)"
    for one in found.assumptions:
        if one.declared and one.left_in:
            yield "left in", one.sentence


def _matches(matching: Matching) -> str:
    """Return lines on the matching cycle: its counts, and whether it rests."""
    counts = f"{matching.given:,} given, {matching.kept:,} kept, {matching.removed:,} removed, {matching.added:,} added"
    cycles = len(matching.cycles)
    rest = "the matches have settled" if matching.rested else "the matches have not settled yet"
    return f"{counts}; {rest}" + (f" after {cycles} {'cycle' if cycles == 1 else 'cycles'}" if cycles else "")


def _share(scores: Evaluation) -> str:
    """Return availability before and after with its interval, at the flight code's tolerance."""
    ends = scores.intervals.availability if scores.intervals else None
    sides = [
        _with_interval(scores.availability.initial, ends.initial if ends else ()),
        _with_interval(scores.availability.final, ends.final if ends else ()),
    ]
    tolerance = scores.flight_tolerance_rad
    within = "" if tolerance is None else f", arcs within {tolerance * 1e6:.0f} µrad"
    return f"{' -> '.join(sides)} of {scores.frames:,} frames{within}"


def _with_interval(share: float | None, interval: Sequence[float | None]) -> str:
    low, high = interval or (None, None)
    return ("-" if share is None else f"{share:.1%}") + (
        "" if low is None or high is None else f" ({low:.1%} to {high:.1%})"
    )


def _pair(rms: Change) -> str:
    before, after = ("-" if value is None else f"{value * 1e6:.2f}" for value in (rms.initial, rms.final))
    return f"{before} -> {after} µrad"


def _test(value: float | None, test: ChiSquareTest | InnovationTest, word: str | None = None) -> str:
    word = word or ("consistent" if test.consistent else "NOT consistent")
    number, lower, upper = ("-" if one is None else f"{one:.4g}" for one in (value, test.lower, test.upper))
    return f"{number}, 95 % bounds {lower} to {upper}: {word}"


@dataclass(frozen=True)
class Summary:
    """An answer in short, for terminal and notebook alike.

    `headline`: whose it is, and what came out. `rows`: a table, its headings first. `left`: columns of words. `sentences`: what to
    know and do.
    """

    headline: str
    rows: list[Sequence[str]]
    left: tuple[int, ...]
    sentences: list[str]

    def __str__(self) -> str:
        """Lay it out for a terminal."""
        return "\n\n".join([self.headline, aligned(self.rows, self.left), *(f"- {one}" for one in self.sentences)])


def summarise_quality(found: Quality) -> Summary:
    """Findings by severity, with how often."""
    return Summary(
        f"{found.frames:,} frames, {found.exposures:,} exposures, {found.stars:,} stars, {found.matched:,} matched, "
        f"{found.usable:,} usable: {found.verdict}",
        [("severity", "finding", "count"), *((one.severity, one.code, f"{one.count:,}") for one in found.findings)],
        (0, 1),
        [one.sentence for one in found.findings],
    )


def summarise_matches(found: Matches) -> Summary:
    """How many of the given identities stood."""
    names = ("given", "kept", "changed", "added", "removed", "matched")
    return Summary(
        f"{found.matched:,} of {len(found.telemetry):,} stars matched; {found.valid_frames:,} of {found.frames:,} frames valid",
        [names, [f"{getattr(found, name):,}" for name in names]],
        (),
        found.advice,
    )


def summarise_extraction(found: Extraction) -> Summary:
    """How many stars the images gave."""
    counts = sorted(image.stars for image in found.images)
    names = ("images", "stars", "fewest", "median", "most", "saturated")
    saturated = sum(image.saturated for image in found.images)
    numbers = (len(counts), sum(counts), counts[0], counts[len(counts) // 2], counts[-1], saturated)
    return Summary(
        f"{sum(counts):,} stars of {len(counts):,} images",
        [names, [f"{number:,}" for number in numbers]],
        (),
        found.sentences,
    )


def summarise_new_sensor(found: NewSensor) -> Summary:
    """Where each parameter starts, how far it may be off, and why; then the reasons of the other numbers."""
    document = found.document
    rows: list[Sequence[str]] = [("parameter", "start", "typical sigma", "why")]
    for name, value in document["initial"].items():
        sigma = document["typical_sigma"][name]
        rows.append((name, f"{value:.6g}", f"{sigma:.3g}", found.reasons[f"typical_sigma.{name}"]))
    shown = {f"typical_sigma.{name}" for name in document["initial"]}
    said = [f"{name}: {why}" for name, why in found.reasons.items() if name not in shown]
    size = document["detector"]
    return Summary(
        f"{document['name']}: {document['camera_model']}, {size['rows']} x {size['columns']} px",
        rows,
        (0, 3),
        [*found.sentences, *said],
    )


def summarise_evaluation(found: Comparison) -> Summary:
    """The scores under both parameter sets, with their intervals."""
    ends, stars = found.intervals, found.matched_stars
    none: Numbers = [None, None]
    rows: list[Sequence[str]] = [("", "initial", "95 %", "final", "95 %")]
    for name, score, between, scale, form in (
        ("availability", found.availability, ends.availability if ends else None, 1.0, ".3f"),
        ("RMS arc error, µrad", found.rms_arc_rad, ends.rms_arc_rad if ends else None, 1e6, ".2f"),
    ):
        low_high = (between.initial, between.final) if between else (none, none)
        sides = zip((score.initial, score.final), low_high, strict=True)
        rows.append(
            [name, *(word for one, two in sides for word in (_scaled(one, scale, form), _between(two, scale, form)))]
        )
    if stars is not None:
        rows.append(("matched stars", f"{stars.initial:,}", "", f"{stars.final:,}", ""))
    for name, ratio, between_ratios in (
        ("matched star ratio", found.matched_star_ratio, ends.matched_star_ratio if ends else none),
        ("RMS ratio", found.rms_ratio, ends.rms_ratio if ends else none),
    ):
        rows.append((name, "", "", written(ratio, ".3f"), _between(between_ratios, 1.0, ".3f")))
    shadow = [] if found.shadow is None else [found.shadow.summary.sentence]
    pairs = "" if found.common_pairs is None else f", {found.common_pairs:,} common pairs"
    return Summary(f"{found.sensor}: {found.frames:,} frames{pairs}", rows, (0,), [*found.advice, *shadow])


def summarise_choice(found: Choice) -> Summary:
    """The sentence, and a row a camera."""
    headline = f"{found.sensor}: {found.frames:,} frames, {found.stars:,} stars, {found.arcs:,} arcs\n{found.sentence}"
    return Summary(headline, list(camera_rows(found)), (0, 1), found.advice)


def summarise_diagnosis(found: Diagnosis) -> Summary:
    """The sentence, and a row for all that was tried."""
    rows: list[Sequence[str]] = [("tested", "exposures matched", "stars")]
    rows += [(one.what, f"{one.exposures_solved:,} of {found.exposures:,}", f"{one.stars:,}") for one in found.tried]
    sentences = ["The time limit was reached before all options were tested."] if found.cut_short else []
    if (mapping := found.mapping) is not None:
        from boresight.telemetry.mapping import profile_members

        sentences.append(
            "Write corrected telemetry with --out-telemetry FILE, or describe the format in a mapping profile: "
            f"{profile_members(mapping)}."
        )
    return Summary(f"{found.sensor}: {found.sentence}", rows, (0,), sentences)


def summarise_assessment(found: Assessment) -> Summary:
    """A row a gate, and a sentence for each that does not pass."""
    from boresight.verdicts.gates.judgement import gate_rows

    rows = gate_rows(found.gates, found.blocking)
    blocking = f"; it would be blocked by {', '.join(found.blocking)}" if found.blocking else ""
    return Summary(
        f"{found.sensor}: {found.words}{blocking}",
        [
            ("gate", "answer", "measured", "limit", "unit"),
            *((r.title, r.status, r.value, r.limit, r.unit) for r in rows),
        ],
        (0, 1, 4),
        list(dict.fromkeys(row.sentence for row in rows if row.status != "PASS")),
    )


def camera_rows(found: Choice) -> Iterator[tuple[str, ...]]:
    """Give a row a camera: its least sufficient candidate."""
    yield "", "camera and free terms", "free", "chi2/dof", "BIC", "held-out RMS µrad", "change px", "± 3σ"
    for place, one in enumerate(found.list_cameras()):
        words = ", ".join(one.terms) or "focal length alone"
        yield (
            "->" if place == 0 else "",
            f"{one.camera_model}: {words}",
            str(len(one.free)),
            written(None if one.chi2 is None else one.chi2 / one.dof, ".4f"),
            _scored_bic(found.bic_above(one), chosen=place == 0),
            _scored(one.held_out_rms_arc_rad, one.held_out_interval_rad),
            written(one.change_px, ".3f"),
            written(one.change_3_sigma_px, ".3f"),
        )


def _scored_bic(above: float | None, *, chosen: bool) -> str:
    """BIC beside that of the chosen camera."""
    from boresight.calibration.choice.result import say_bic

    return "-" if above is None else "chosen" if chosen else say_bic(above, ".1f")


def _scored(value: float | None, interval: Numbers | None) -> str:
    """Held-out RMS with its interval."""
    if value is None:
        return "-"
    low, high = interval or (None, None)
    ends = "" if low is None or high is None else f" ({low * 1e6:.2f} to {high * 1e6:.2f})"
    return f"{value * 1e6:.2f}{ends}"


def written(value: float | None, form: str) -> str:
    """Write a number, or a dash where there is none."""
    return "-" if value is None else format(value, form)


def _scaled(value: float | None, scale: float, form: str) -> str:
    return written(None if value is None else value * scale, form)


def _between(ends: Sequence[float | None], scale: float, form: str) -> str:
    return " to ".join(_scaled(end, scale, form) for end in ends)
