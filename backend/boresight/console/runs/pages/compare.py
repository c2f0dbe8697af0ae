"""Comparing runs: what differs from a reference run, in sigmas of the difference, their figures, and methods on one data set.

`?runs=1,2,3&reference=2&all=1&align=time&overlay=band` is the whole view. Methods can be told apart only where all else
is alike: runs on different sets are refused, and what else differs is named above the table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any
from urllib.parse import urlencode

import numpy as np
from fastapi import Query, Request
from fastapi.responses import HTMLResponse

from boresight.calibration.evaluation.contrast import Contrast
from boresight.calibration.options import ALL, METHODS, OPTIONS, get_method_title, is_sequential
from boresight.console.access.dependencies import Reading, get_server
from boresight.console.pages.formats import words
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import render
from boresight.console.runs import comparisons
from boresight.console.runs.comparisons import ComparedRun, Comparison, UnlikeModelsError, joint
from boresight.console.runs.pages.list import RunNames, read_names
from boresight.console.runs.tables import TERMINAL_RUN_STATES
from boresight.errors import RefusedInputError
from boresight.estimation.filters import FILTERS
from boresight.figures import FIGURES, WIDE
from boresight.figures.charts import radial as radial_contrast
from boresight.figures.charts.methods import MethodScores, method_scores
from boresight.figures.style.axes import ALIGNMENTS
from boresight.platform.web.paging import parse_row_id
from boresight.verdicts.history import SETTLED_SIGMAS
from boresight.verdicts.numbers import MISSING, count, fixed, number, plus_minus, power, quantity, sigmas
from boresight.verdicts.verdict import describe_iterations, list_rms
from boresight.wording import join_words

#: Differences from here on are marked; chance makes one of 370 as large.
FAR_SIGMAS = 3.0
#: Correlations that differ by less look alike.
ALIKE = 0.05
UNLIKELY = 0.01
#: Differences of runs on the same data below this share of the reference's sigma change nothing that anybody decides.
NEGLIGIBLE = 0.1
#: Below this a p-value has left the range of floats.
SMALLEST_P = 1e-300


@dataclass(frozen=True)
class ComparedCell:
    """One parameter of one run: its value, its difference from the reference, and whether that is large."""

    value: str
    note: str
    far: bool = False
    differs: bool = False


@dataclass(frozen=True)
class ParameterLine:
    """One parameter, with a cell for each run."""

    name: str
    cells: Sequence[ComparedCell]
    differs: bool


@dataclass(frozen=True)
class CorrelationLine:
    """A pair of parameters, with a printed correlation for each run."""

    names: tuple[str, str]
    values: Sequence[str]
    differs: bool


def parameter_lines(found: Comparison) -> list[ParameterLine]:
    """Print every parameter of every run."""
    lines = []
    for i, name in enumerate(found.names):
        cells = [_cell(found, i, k) for k in range(len(found.compared))]
        lines.append(ParameterLine(name, cells, any(cell.differs for cell in cells)))
    return lines


def _cell(found: Comparison, i: int, k: int) -> ComparedCell:
    """Print parameter i of run k."""
    name, result, base = found.names[i], found.compared[k].calibration, found.compared[found.reference].calibration
    value, sigma = result.parameters.get(name), result.reliable_sigma.get(name)
    shared = power(name, *(one.calibration.parameters.get(name) for one in found.compared))
    printed = plus_minus(value, name, sigma, power=shared).replace(
        "± ", "±\N{NO-BREAK SPACE}"
    )  # a line may break before it
    held = "held fixed" if value is not None and sigma is None else ""
    against = found.contrasts[k]
    if k == found.reference:
        return ComparedCell(printed, "reference, held fixed" if held else "reference")
    if against is None or not np.isfinite(against.difference[i]):
        return ComparedCell(printed, held or MISSING)
    apart = _apart(against, i, base.reliable_sigma.get(name))
    if apart is not None and np.isfinite(against.sigma[i]):
        note = f"{sigmas(apart)}{', held fixed' if held else ''}"
        return ComparedCell(printed, note, abs(apart) > FAR_SIGMAS, abs(apart) >= NEGLIGIBLE)
    alike = bool(against.difference[i] == 0)
    if alike or apart is None:
        return ComparedCell(printed, "alike" if alike else held or MISSING, differs=not alike)
    if abs(apart) < NEGLIGIBLE:
        return ComparedCell(printed, f"{number(apart, 2)} σ of the reference, negligible")
    return ComparedCell(printed, f"{number(apart, 2)} σ of the reference", differs=True)


def _apart(against: Contrast, i: int, spread: float | None) -> float | None:
    """Difference of parameter i in sigmas of the difference, else of the reference, which are its `spread`; None without either."""
    if np.isfinite(against.sigma[i]):
        return float(against.separation[i])
    return float(against.difference[i]) / spread if spread and np.isfinite(against.difference[i]) else None


@dataclass(frozen=True)
class ComparedAnswer:
    """What a comparison says in a sentence, and how that is to be taken."""

    level: str
    sentence: str


def answer(found: Comparison) -> ComparedAnswer:
    """Say whether the runs differ from the reference, by how much, and in which parameter most."""
    others = [k for k in range(len(found.compared)) if k != found.reference]
    known = [k for k in others if found.contrasts[k] is not None]
    if not known:
        waits = any(one.run.state not in TERMINAL_RUN_STATES for one in found.compared)
        lacking = "Fewer than two of the runs have a result"
        do = "wait until another has ended" if waits else "choose runs that SUCCEEDED"
        return ComparedAnswer("standby", f"{lacking}: {do}.")
    far = [k for k in known if (test := joint(found.contrasts[k])) is not None and test["p"] < UNLIKELY]
    largest = max((_largest(found, k) for k in known), key=lambda one: one[0])
    unit = "σ of the difference" if largest[2] else "σ of the reference"
    size = f"{number(largest[0], 2)} {unit} ({quantity(largest[1]).symbol})" if largest[1] else f"0 {unit}"
    same = all(found.shared[k].kind == "same" for k in known)
    if same and largest[0] < NEGLIGIBLE:
        what = "methods" if len({one.run.method for one in found.compared}) > 1 else "runs"
        return ComparedAnswer("normal", f"Same data: the {what} differ by at most {size}, negligible.")
    if far:
        named = join_words([f"#{found.compared[k].run.id}" for k in far])
        differ = f"{named} {'differs' if len(far) == 1 else 'differ'} significantly"
        of = f" ({count(len(far))} of {count(len(known))} compared)" if len(known) > 1 else ""
        reference = f"the reference #{found.compared[found.reference].run.id}"
        return ComparedAnswer("caution", f"{differ} from {reference}{of}; largest difference {size}.")
    if same and largest[0] > FAR_SIGMAS:
        return ComparedAnswer(
            "caution", f"Same data: the runs differ by at most {size}, more than expected between methods."
        )
    if same:
        return ComparedAnswer("normal", f"Same data: the runs differ by at most {size}, as expected between methods.")
    return ComparedAnswer("normal", f"No run differs significantly from the reference; largest difference {size}.")


def _largest(found: Comparison, k: int) -> tuple[float, str, bool]:
    """The largest difference of a run, in sigmas as `_apart` has them, its parameter, and whether they are of the difference."""
    against, spreads = found.contrasts[k], found.compared[found.reference].calibration.reliable_sigma
    sizes = {
        name: abs(apart)
        for i, name in enumerate(found.names)
        if against is not None and (apart := _apart(against, i, spreads.get(name))) is not None
    }
    most = max(sizes, key=lambda name: sizes[name], default="")
    of_difference = against is not None and bool(most) and bool(np.isfinite(against.sigma[found.names.index(most)]))
    return sizes.get(most, 0.0), most, of_difference


def correlation_lines(found: Comparison) -> list[CorrelationLine]:
    """Print the strong correlations."""
    lines = []
    for a, b, values in found.correlations():
        known = [value for value in values if value is not None]
        lines.append(CorrelationLine((a, b), [fixed(value, 2) for value in values], max(known) - min(known) > ALIKE))
    return lines


def together(found: Comparison) -> list[ComparedCell]:
    """Print for each run whether all its parameters together differ from the reference's."""
    cells = []
    for k, against in enumerate(found.contrasts):
        test = joint(against)
        if k == found.reference:
            cells.append(ComparedCell("reference", ""))
        elif test is None:
            cells.append(ComparedCell(MISSING, "no result" if against is None else "no σ: same data, different method"))
        else:
            far = test["p"] < UNLIKELY
            words = "differ" if far else "no difference found"
            cells.append(
                ComparedCell(words, f"χ² {number(test['chi2'], 3)} of {test['dof']}, {_chance(test['p'])}", far)
            )
    return cells


def _chance(p: float) -> str:
    """Print a p-value; one too small for a float is printed as an upper bound, because no p-value is zero."""
    return f"p = {number(p, 2)}" if p >= SMALLEST_P else "p < 10⁻³⁰⁰"


#: Settings that are a method's own, and so belong to the comparison.
OWN = {"method", *(name for name, option in OPTIONS.items() if option.methods != ALL)}


@dataclass(frozen=True)
class MethodLine:
    """One row of the table: a quantity, its unit, a text for each run, and how to read it."""

    name: str
    unit: str
    values: Sequence[str]
    reading: str


@dataclass(frozen=True)
class MethodPanel:
    """The contents of the panel of methods."""

    refusal: str | None
    unlike: str
    lines: Sequence[MethodLine]
    when: Sequence[tuple[str, str]]


def method_panel(compared: Sequence[ComparedRun]) -> MethodPanel | None:
    """Compare the methods of several runs; None where there is only one run."""
    used = {one.run.method for one in compared}
    if len(used) < 2:
        return None
    when = [(method.title, method.when) for method in METHODS.values() if method.name in used]
    refusal = _refusal(compared)
    if refusal is not None:
        return MethodPanel(refusal, "", (), when)
    return MethodPanel(None, ", ".join(_unlike(compared)), _lines(compared), when)


def _refusal(compared: Sequence[ComparedRun]) -> str | None:
    """Return why the methods of these runs cannot be compared, or None."""
    by_set = {one.run.telemetry_set_id: one.run.id for one in compared}
    if len(by_set) > 1:
        first, second = list(by_set.values())[:2]
        return (
            f"Run #{first} and run #{second} use different telemetry sets, so their differences do not show how their"
            " methods differ: compare runs of one set."
        )
    if not any(one.calibration.parameters for one in compared):
        return "None of these runs has a result: choose runs that SUCCEEDED."
    return None


def _unlike(compared: Sequence[ComparedRun]) -> list[str]:
    """List the settings, other than the methods' own, that differ between the runs."""
    chosen = [one.run.stated_settings for one in compared]
    names = sorted(set(OPTIONS) - OWN - {"free"})
    found = [words(name) for name in names if len({getattr(settings, name) for settings in chosen}) > 1]
    free = {str(one.calibration.free) for one in compared if one.calibration.free}
    frames = {one.calibration.frames for one in compared if one.calibration.frames}
    return found + ["free parameters"] * (len(free) > 1) + ["number of frames used"] * (len(frames) > 1)


def _lines(compared: Sequence[ComparedRun]) -> list[MethodLine]:
    scores = [method_scores(one.calibration) for one in compared]
    lines = [
        MethodLine(
            "Method",
            "",
            [get_method_title(one.run.method) for one in compared],
            "The text below the table says when to use it.",
        ),
        MethodLine(
            "Claimed error",
            "bound sigmas",
            [fixed(score.claimed, 3) for score in scores],
            "Claimed σ over the Cramér-Rao bound, geometric mean over the free parameters: 1 is the best that the stars allow.",
        ),
        MethodLine(
            "Cost",
            "ms / frame",
            [number(score.ms_per_frame, 3) for score in scores],
            "Processor time of the method without matching, measured once: differences below a factor of two are not "
            "significant. Not available for replays. For a paired timing of all methods, see the report of boresight "
            "reproduce wu.",
        ),
        MethodLine(
            "Converged after",
            "",
            [_settled(one, score) for one, score in zip(compared, scores, strict=True)],
            f"From this point on, all free parameters stay within {SETTLED_SIGMAS:.0f} final σ of their final values.",
        ),
        MethodLine(
            "Condition number",
            "1",
            [number(score.condition, 3) for score in scores],
            "For the scaled Jacobian of the whole set at the end: equal if the methods agree.",
        ),
        MethodLine(
            "χ² / dof",
            "1",
            [_verdict(score.chi2_per_dof, score.consistent, 3) for score in scores],
            "For all arcs at the end, independent of what the method measures, compared with its 95 % bounds.",
        ),
    ]
    return [*lines[:2], *_against_truth(scores), *lines[2:]]


def _against_truth(scores: Sequence[MethodScores]) -> list[MethodLine]:
    """Return the rows that compare with the truth of a simulated sensor."""
    if all(score.honesty is None for score in scores):
        return []
    return [
        MethodLine(
            "True error",
            "bound sigmas",
            [fixed(score.true_error, 3) for score in scores],
            "Root mean square over the free parameters, against the simulated truth: about 1 for an efficient method.",
        ),
        MethodLine(
            "NEES / n",
            "1",
            [
                _verdict(score.honesty.mean, score.honesty.consistent, 3) if score.honesty else MISSING
                for score in scores
            ],
            "True error squared over the claimed covariance: 1 on average where the claimed covariance is right, with its verdict.",
        ),
    ]


def _settled(one: ComparedRun, score: MethodScores) -> str:
    if is_sequential(one.run.method):
        return MISSING if score.settled_frames is None else _many(score.settled_frames, "frame")
    return MISSING if score.settled_iterations is None else _many(score.settled_iterations, "iteration")


def _many(number_of: int, what: str) -> str:
    return f"{count(number_of)} {what}{'' if number_of == 1 else 's'}"


def _verdict(value: float | None, consistent: bool | None, digits: int) -> str:
    said = {True: " consistent", False: " not consistent", None: ""}[consistent]
    return MISSING if value is None else f"{number(value, digits)}{said}"


CROWDED_RUNS = 8
OVERLAYS = {"lines": "every run", "band": "lowest to highest", "table": "no figures, tables only"}
ALIGNED_BY = {"frame": "frame number", "time": "time since the first frame", "update": "update"}

router = PageRouter()


@dataclass(frozen=True)
class CompareView:
    """The view that the page's address describes."""

    run_ids: Sequence[int]
    reference: int
    everything: bool
    align: str
    overlay: str

    def query(self, **changed: Any) -> str:
        """Return the query string of the view, with changes; defaults are left out."""
        view = replace(self, **changed)
        named = {
            "reference": "" if view.reference == view.run_ids[0] else view.reference,
            "all": "1" if view.everything else "",
            "align": "" if view.align == "frame" else view.align,
            "overlay": "" if view.overlay == "lines" else view.overlay,
        }
        chosen = {"runs": ",".join(map(str, view.run_ids))} | {name: value for name, value in named.items() if value}
        return urlencode(chosen, safe=",")

    @property
    def figures_query(self) -> str:
        """Return the part of the query string that figures take; empty where all is default."""
        named = {"align": self.align, "overlay": self.overlay}
        usual = {"align": "frame", "overlay": "lines"}
        return "".join(f"&{name}={value}" for name, value in named.items() if value != usual[name])

    @property
    def ordered(self) -> list[int]:
        """The runs with the reference first, in which order figures colour them."""
        return [self.reference, *(run_id for run_id in self.run_ids if run_id != self.reference)]


def read_view(run_ids: Sequence[int], reference: str, everything: str, align: str, overlay: str) -> CompareView:
    """Read the view from the address; invalid values are replaced by defaults."""
    chosen = named if (named := parse_row_id(reference)) is not None and named in run_ids else run_ids[0]
    return CompareView(
        run_ids,
        chosen,
        bool(everything),
        align if align in ALIGNMENTS else "frame",
        overlay if overlay in OVERLAYS else "lines",
    )


@dataclass(frozen=True)
class DifferenceRow:
    """One row of the table of settings and outcomes: a name and a text for each run."""

    name: str
    values: Sequence[str]

    @property
    def differs(self) -> bool:
        """Whether the runs differ."""
        return len(set(self.values)) > 1


def differences(compared: Sequence[ComparedRun], names: RunNames) -> list[DifferenceRow]:
    """Return the settings and outcomes of the runs, a row each."""
    described = [_description(one, names) for one in compared]
    rows = list(dict.fromkeys(name for description in described for name in description))
    return [DifferenceRow(name, [description.get(name, "–") for description in described]) for name in rows]


def _description(one: ComparedRun, names: RunNames) -> dict[str, str]:
    run, result = one.run, one.calibration
    nis, validation, seen = result.nis, result.validation, result.observability
    before, after = list_rms(result.evaluation, result.rms_arc_rad, result.pairs)
    unseen = list_rms(validation, validation.rms_arc_rad, validation.common_pairs)[1] if validation else MISSING
    return {
        "State": run.state,
        "Sensor": names.sensors.get(run.sensor_id, str(run.sensor_id)),
        "Calibration set": names.sets.get(run.telemetry_set_id, "–"),
        "Validation set": names.sets.get(run.validation_set_id or 0, "none"),
        "Method": get_method_title(run.method),
        **{f"Setting {name}": _text(value) for name, value in sorted(_chosen(one).items())},
        "Fit": "–" if one.result is None else result.status.replace("_", " "),
        "Iterations": "–" if one.result is None else describe_iterations(result),
        "Frames used": _text(one.result and result.frames),
        "RMS before (µrad, 95 %)": before,
        "RMS after (µrad, 95 %)": after,
        "Validation RMS after (µrad, 95 %)": unseen,
        "χ² / dof": number(result.chi2_per_dof),
        "NIS mean": number(nis.mean if nis else None) if run.method in FILTERS else "not applicable",
        "Condition number": number(seen.condition_number if seen else None, 3),
        "Launched by": names.person(run.launched_by),
    }


def _name(one: ComparedRun, names: RunNames) -> str:
    """Name a run by its sensor, and by its label where that says more than the method beside it."""
    sensor = names.sensors.get(one.run.sensor_id, str(one.run.sensor_id))
    return f"{sensor}: {one.run.own_label}" if one.run.own_label else sensor


def _chosen(one: ComparedRun) -> dict[str, Any]:
    """Return a run's settings except its method, with the sensor's free parameters filled in where it named none."""
    settings = one.run.stated_settings
    said = {name: value for name, value in settings.document().items() if name != "method"}
    return {**said, "free": one.calibration.free or settings.free}


def _text(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, list | tuple):
        return ", ".join(str(item) for item in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


@router.get("/compare", response_class=HTMLResponse)
def compare_page(
    request: Request,
    session: Reading,
    asked: Annotated[list[str] | None, Query(alias="runs")] = None,
    reference: str = "",
    everything: Annotated[str, Query(alias="all")] = "",
    align: str = "",
    overlay: str = "",
) -> HTMLResponse:
    """Show a comparison of runs, or what to choose for one."""
    blobs = get_server(request).blobs
    try:
        run_ids = comparisons.read_run_ids(asked or [])
        if len(run_ids) < 2:
            comparisons.read_compared(session, blobs, run_ids)
            return render(request, "runs/compare.html", refusal=None, sets=[], found=None)
        view = read_view(run_ids, reference, everything, align, overlay)
        found = comparisons.compare(session, blobs, run_ids, view.reference)
    except UnlikeModelsError as error:
        return render(
            request,
            "runs/compare.html",
            status_code=422,
            refusal=str(error),
            code=error.code,
            sets=error.sets,
            found=None,
        )
    except RefusedInputError as error:
        return render(
            request, "runs/compare.html", status_code=422, refusal=str(error), code=error.code, sets=[], found=None
        )
    names = read_names(session, [one.run for one in found.compared])
    return render(request, "runs/compare.html", refusal=None, found=found, view=view, **_tables(found, view, names))


def _tables(found: Comparison, view: CompareView, names: RunNames) -> Mapping[str, Any]:
    rows, lines, pairs = differences(found.compared, names), parameter_lines(found), correlation_lines(found)
    return {
        "rows": [row for row in rows if view.everything or row.differs],
        "alike": sum(not row.differs for row in rows),
        "parameters": [line for line in lines if view.everything or line.differs],
        "hidden": sum(not line.differs for line in lines),
        "correlations": [pair for pair in pairs if view.everything or pair.differs],
        "correlated": len(pairs),
        "together": together(found),
        "answer": answer(found),
        "methods": method_panel(found.compared),
        "names": [_name(one, names) for one in found.compared],
        "titles": [get_method_title(one.run.method) for one in found.compared],
        "assumption": comparisons.ASSUMPTION,
        "crowded": len(found.compared) > CROWDED_RUNS,
        "figures": [] if view.overlay == "table" else list(FIGURES.values()),
        "radial": {"title": radial_contrast.RADIAL_CONTRAST_TITLE, "guide": radial_contrast.GUIDE},
        "wide": WIDE | {"correlation"},  # maps side by side
        "alignments": ALIGNED_BY,
        "overlays": OVERLAYS,
    }
