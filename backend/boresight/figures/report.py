"""The report: one HTML file that stands alone, on paper as on a screen, years later and without a network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from shlex import quote
from typing import Any

import plotly.graph_objects as go
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from boresight import __version__
from boresight.calibration.calibration import Calibration, Change, Evaluation, to_plain
from boresight.calibration.options import OPTIONS, CalibrationSettings, format_value
from boresight.figures import CHAPTERS, FIGURES
from boresight.figures.chart import Trace, figure_json
from boresight.figures.charts.matching import why_no_matching
from boresight.figures.style.theme import LIGHT_TEMPLATE, TOKENS, declared
from boresight.figures.tables import (
    HEADINGS,
    cause_rows,
    flight_rows,
    flight_tolerance,
    interval_rows,
    match_counts,
    match_facts,
    minimum_rows,
    model_test_rows,
    printed_rows,
    reason_tables,
    removed_count,
    removed_rows,
    side_by_side,
    star_rows,
    to_flag,
)
from boresight.resources import folder
from boresight.verdicts.numbers import count, number, show_numbers_of_report
from boresight.verdicts.verdict import (
    describe_iterations,
    describe_rms,
    make_verdict,
    prospects,
    trust_marks,
    why_absent,
)

NUMBERS_JS = (folder("frontend") / "static" / "shared" / "numbers.js").read_text(encoding="utf-8")


def embed_figures(figures: Mapping[str, go.Figure]) -> dict[str, Markup]:
    """Return what a page that draws these figures by name needs: two scripts, `figures_json`, and `tokens` of white paper."""
    for figure in figures.values():
        figure.update_layout(template=LIGHT_TEMPLATE, meta=None)
    text = ",".join(f'"{name}":{figure_json(figure).decode()}' for name, figure in figures.items())
    escaped = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return {
        "plotly": Markup(get_plotlyjs()),  # noqa: S704 - the library's own file, as its writer inlines it
        "numbers_js": Markup(NUMBERS_JS),  # noqa: S704 - our own module
        "figures_json": Markup("{" + escaped + "}"),  # noqa: S704 - escaped here
        "tokens": Markup(declared(TOKENS["light"])),  # noqa: S704 - the style sheet's own text
    }


MOST_STARS = 25  # in print, and as many removed ones; the run's CSV has more


def render_report(result: Calibration, *, four_eyes: bool = True) -> str:
    """Render the report as HTML text."""
    environment = Environment(
        loader=FileSystemLoader(folder("frontend") / "templates"), autoescape=True, undefined=StrictUndefined
    )
    document = environment.get_template("figures/report.html").render(
        result=result,
        four_eyes=four_eyes,
        verdict=make_verdict(result),
        summary=list(_summary(result)),
        headings=HEADINGS,
        rows=printed_rows(result),
        beyond=[one.sentence for one in (result.process_noise, result.misfit, result.minima) if one],
        minima=minimum_rows(result),
        intervals=interval_rows(result),
        chapters=CHAPTERS,
        **embed_figures({name: figure.draw([_trace(result)]) for name, figure in FIGURES.items()}),
        **_examined(result),
        **_matched(result),
        provenance=list(flattened(to_plain(result.inputs))),
        timing=list(flattened(result.timing_s)),
        command=command(result),
        version=__version__,
    )
    return show_numbers_of_report(document)


def _examined(result: Calibration) -> dict[str, Any]:
    return {
        "trust_marks": trust_marks(result),
        "model_tests": model_test_rows(result),
        "causes": cause_rows(result),
        "why_no_trust": why_absent(result, ""),
        "prospects": prospects(result),
        "stars": star_rows(result)[:MOST_STARS],
        "to_flag": to_flag(result),
    }


def _matched(result: Calibration) -> dict[str, Any]:
    matching = result.matching
    return {
        "match_counts": match_counts(matching) if matching else [],
        "match_facts": match_facts(matching) if matching else [],
        "flight": flight_rows(result),
        "flight_tolerance": flight_tolerance(result),
        "side_by_side": side_by_side(result),
        "reasons": reason_tables(matching) if matching else [],
        "why_no_matching": why_no_matching(result),
        "removed": removed_rows(result, MOST_STARS),
        "removed_count": removed_count(result),
    }


def _trace(result: Calibration) -> Trace:
    return Trace(result.method or "run", result)


def _summary(result: Calibration) -> Iterator[tuple[str, str]]:
    yield "Method", " ".join(word for word in (result.method, result.variant) if word)
    yield "Camera model", result.camera_model or "–"
    yield "Free parameters", ", ".join(result.free) or "–"
    if result.frames or result.status != "running":
        yield "Frames", count(result.frames)
        yield "Exposures", count(result.exposures)
        yield "Stars", count(result.stars)
        yield "Pairs", count(result.pairs)
        yield "Iterations", describe_iterations(result)
    yield "RMS arc error", _pair(result.evaluation, result.rms_arc_rad, result.pairs)
    if result.chi2_per_dof is not None:
        yield "χ² per degree of freedom", number(result.chi2_per_dof)
    condition = result.observability.condition_number if result.observability else None
    yield "Condition number", number(condition)
    validation = result.validation
    told = _pair(validation, validation.rms_arc_rad, validation.common_pairs) if validation else ""
    yield "Validation RMS", told or "no validation set was given"
    for term in result.noise.terms if result.noise else ():
        if term.needed:
            yield "Centroid noise", term.sentence
    for one in result.assumptions:
        word = "declared" if one.declared else "assumed, not declared"
        yield f"{one.name.replace('_', ' ').capitalize()}, {word}", one.sentence


def _pair(scores: Evaluation | None, rms: Change, arcs: float | None) -> str:
    return f"{describe_rms(scores, rms, arcs)} µrad, 95 % in brackets"


def flattened(document: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Walk a document as lines of dotted name and value."""
    for key, value in document.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{prefix}{key}.")
        else:
            text = f"{value:.6g}" if isinstance(value, float) else str(value)
            yield f"{prefix}{key}", "–" if value is None else text


def command(result: Calibration) -> str:
    """Write the command that makes this result again from the same files."""
    settings = replace(result.inputs.settings, method=result.method or CalibrationSettings.method)
    validation = "VALIDATION" if result.validation else None
    several = len(result.inputs.passes)
    sets = [f"TELEMETRY_{number}" for number in range(1, several + 1)] if several > 1 else ["TELEMETRY"]
    prior = "PRIOR.json" if result.prior is not None and result.variation is None else None
    return " ".join(calibrate_command(sets, "SENSOR.json", settings, validation, "RESULT.json", prior))


#: Said even where it is the default, because it names the calibration.
ALWAYS = ("method", "match")


def calibrate_command(
    telemetry: Sequence[str],
    sensor: str,
    settings: CalibrationSettings,
    validation: str | None,
    json_file: str,
    prior: str | None = None,
) -> list[str]:
    """Return the words of the command that makes a result again, an option with its value as one."""
    words = [f"boresight calibrate {' '.join(map(quote, telemetry))}", f"--sensor {quote(sensor)}"]
    for name, one in OPTIONS.items():
        value = getattr(settings, name)
        if (
            one.flag
            and one.counts_under(settings.method)
            and value is not None
            and (value != one.default or name in ALWAYS)
        ):
            words.append(one.flag if value is True else f"{one.flag} {quote(format_value(value))}")
    if validation:
        words.append(f"--validate {quote(validation)}")
    if prior:
        words.append(f"--prior {quote(prior)}")
    return [*words, f"--json {quote(json_file)}"]
