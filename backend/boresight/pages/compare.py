"""Comparing runs: what differs from a reference run, in sigmas of the difference, and their figures over one another.

`?runs=1,2,3&reference=2&all=1&align=time&overlay=band` is the whole view, so whoever opens the address sees the same. Only what
differs is shown unless `all=1`; `align` is what the figures' axis of frames counts; `overlay` draws each run, the band of the
lowest and the highest, or no figures but the tables. Runs of unlike camera models are refused with the way out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import HTMLResponse

from boresight.api.credentials import who_acts
from boresight.api.dependencies import Reading
from boresight.api.numbers import row_number
from boresight.calibration.options import title_of
from boresight.errors import RefusedInputError
from boresight.estimation.filters import FILTERS
from boresight.figures import FIGURES, WIDE, radial_contrast
from boresight.figures.alignment import ALIGNMENTS
from boresight.pages.compare_tables import correlation_lines, parameter_lines, together
from boresight.pages.method_panel import method_panel
from boresight.pages.rendering import render
from boresight.pages.runs import Names, read_names
from boresight.services import comparisons
from boresight.services.comparisons import Compared, Comparison, UnlikeModelsError
from boresight.verdicts.numbers import number, urad

CROWDED_RUNS = 8
OVERLAYS = {"lines": "every run", "band": "lowest to highest", "table": "no figures, tables only"}
ALIGNED_BY = {"frame": "frame number", "time": "time since the first frame", "update": "update"}

router = APIRouter(dependencies=[Depends(who_acts)])


@dataclass(frozen=True)
class View:
    """Everything that the address of the page says."""

    run_ids: Sequence[int]
    reference: int
    everything: bool
    align: str
    overlay: str

    def query(self, **changed: Any) -> str:
        """Write the view as an address's query, with changes; what is as it is by default is left out."""
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
        """Write the part of the view that figures are asked with, behind their runs; empty where all is by default."""
        named = {"align": self.align, "overlay": self.overlay}
        usual = {"align": "frame", "overlay": "lines"}
        return "".join(f"&{name}={value}" for name, value in named.items() if value != usual[name])

    @property
    def ordered(self) -> list[int]:
        """The runs with the reference first, in which order figures colour them."""
        return [self.reference, *(run_id for run_id in self.run_ids if run_id != self.reference)]


def read_view(run_ids: Sequence[int], reference: str, everything: str, align: str, overlay: str) -> View:
    """Read the view from the address; what is no choice is as by default."""
    chosen = named if (named := row_number(reference)) is not None and named in run_ids else run_ids[0]
    return View(
        run_ids,
        chosen,
        bool(everything),
        align if align in ALIGNMENTS else "frame",
        overlay if overlay in OVERLAYS else "lines",
    )


@dataclass(frozen=True)
class Difference:
    """One row of the table of settings and outcomes: a name and a text a run."""

    name: str
    values: Sequence[str]

    @property
    def differs(self) -> bool:
        """Tell whether the runs do not all have the same."""
        return len(set(self.values)) > 1


def differences(compared: Sequence[Compared], names: Names) -> list[Difference]:
    """Set settings and outcomes of the runs beside each other."""
    described = [_description(one, names) for one in compared]
    rows = list(dict.fromkeys(name for description in described for name in description))
    return [Difference(name, [description.get(name, "–") for description in described]) for name in rows]


def _description(one: Compared, names: Names) -> dict[str, str]:
    """Describe a run in short texts."""
    run, result = one.run, one.result
    rms, nis = result.get("rms_arc_rad") or {}, result.get("nis") or {}
    held_out = (result.get("validation") or {}).get("rms_arc_rad") or {}
    return {
        "State": run.state,
        "Sensor": names.sensors.get(run.sensor_id, str(run.sensor_id)),
        "Calibration set": names.sets.get(run.telemetry_set_id, "–"),
        "Validation set": names.sets.get(run.validation_set_id or 0, "none"),
        "Method": title_of(run.method),
        **{f"Setting {name}": _text(value) for name, value in sorted(_chosen(one).items())},
        "Fit": str(result.get("status", "–")).replace("_", " "),
        "Iterations": _text(result.get("iterations")),
        "Frames used": _text(result.get("frames")),
        "RMS before (µrad)": urad(rms.get("initial")),
        "RMS after (µrad)": urad(rms.get("final")),
        "Validation RMS after (µrad)": urad(held_out.get("final")),
        "χ² / dof": number(result.get("chi2_per_dof")),
        "NIS mean": number(nis.get("mean")) if run.method in FILTERS else "not applicable",
        "Condition number": number((result.get("observability") or {}).get("condition_number"), 3),
        "Launched by": names.person(run.launched_by),
    }


def _chosen(one: Compared) -> dict[str, Any]:
    """Return a run's settings but its method, with the free parameters that the sensor's own list stood for."""
    settings = {name: value for name, value in one.run.settings.items() if name != "method"}
    return {**settings, "free": one.result.get("free") or settings.get("free")}


def _text(value: Any) -> str:
    """Write a setting as a person would."""
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
    """Show several runs over one another, or say what to choose."""
    blobs = request.app.state.blobs
    try:
        run_ids = comparisons.read_run_ids(asked or [])
        if len(run_ids) < 2:
            comparisons.read_compared(session, blobs, run_ids)
            return render(request, "runs/compare.html", refusal=None, sets=[], found=None)
        view = read_view(run_ids, reference, everything, align, overlay)
        found = comparisons.compare(session, blobs, run_ids, view.reference)
    except UnlikeModelsError as error:
        return render(request, "runs/compare.html", status_code=422, refusal=str(error), sets=error.sets, found=None)
    except RefusedInputError as error:
        return render(request, "runs/compare.html", status_code=422, refusal=str(error), sets=[], found=None)
    names = read_names(session, [one.run for one in found.compared])
    return render(request, "runs/compare.html", refusal=None, found=found, view=view, **_tables(found, view, names))


def _tables(found: Comparison, view: View, names: Names) -> Mapping[str, Any]:
    """Lay out everything that the page shows of a comparison."""
    rows, lines, pairs = differences(found.compared, names), parameter_lines(found), correlation_lines(found)
    return {
        "rows": [row for row in rows if view.everything or row.differs],
        "alike": sum(not row.differs for row in rows),
        "parameters": [line for line in lines if view.everything or line.differs],
        "correlations": [pair for pair in pairs if view.everything or pair.differs],
        "correlated": len(pairs),
        "together": together(found),
        "methods": method_panel(found.compared),
        "titles": [title_of(one.run.method) for one in found.compared],
        "assumption": comparisons.ASSUMPTION,
        "crowded": len(found.compared) > CROWDED_RUNS,
        "figures": [] if view.overlay == "table" else list(FIGURES.values()),
        "radial": {"title": radial_contrast.TITLE, "guide": radial_contrast.GUIDE},
        "wide": WIDE,
        "alignments": ALIGNED_BY,
        "overlays": OVERLAYS,
    }
