"""Comparing runs: their figures over one another and a table of what differs, nothing else.

`?runs=1,2,3&reference=2&all=1` is the whole view. One run is the reference; the others' parameters are measured against
it in the sigma of the difference. Runs of unlike camera models are refused: their parameters are not the same quantities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import HTMLResponse

from boresight.api.dependencies import Reading, current_actor
from boresight.errors import RefusedInputError
from boresight.estimation.filters import FILTERS
from boresight.figures import FIGURES, WIDE
from boresight.figures.numbers import number, urad
from boresight.figures.parameter_table import contrasts
from boresight.pages.method_panel import method_panel
from boresight.pages.methods import title_of
from boresight.pages.rendering import render
from boresight.pages.runs import Names, read_names
from boresight.services import runs
from boresight.store.blobs import BlobStore
from boresight.store.sessions import Session
from boresight.store.tables import Run

MOST_RUNS = 20
CROWDED_RUNS = 8

router = APIRouter(dependencies=[Depends(current_actor)])


@dataclass(frozen=True)
class Compared:
    """One run of a comparison with its result; an empty result where the run has none."""

    run: Run
    result: Mapping[str, Any]

    @property
    def camera_model(self) -> str:
        """The camera model the run was launched with."""
        return str(self.run.sensor_document.get("camera_model"))


@dataclass(frozen=True)
class Difference:
    """One row of the table of settings and outcomes: a name and a text a run."""

    name: str
    values: Sequence[str]

    @property
    def differs(self) -> bool:
        """Tell whether the runs do not all have the same."""
        return len(set(self.values)) > 1


def read_run_ids(asked: Sequence[str]) -> list[int]:
    """Read run numbers from `1,2,3` or from repeated fields, each once, in their order.

    Raises
    ------
    RefusedInputError
        When something is no number, or there are more than can be compared.
    """
    texts = [text.strip() for part in asked for text in part.split(",") if text.strip()]
    if strange := [text for text in texts if not text.isdecimal()]:
        raise RefusedInputError(f"{strange[0]!r} is no run number; give them as ?runs=1,2,3.")
    found = list(dict.fromkeys(int(text) for text in texts))
    if len(found) > MOST_RUNS:
        raise RefusedInputError(
            f"{len(found)} runs were chosen; at most {MOST_RUNS} can be compared. Leave out {len(found) - MOST_RUNS}."
        )
    return found


def read_compared(session: Session, blobs: BlobStore, run_ids: Sequence[int]) -> list[Compared]:
    """Read the runs and their results.

    Raises
    ------
    RefusedInputError
        When their camera models are unlike; names them.
    """
    found = [Compared(runs.get_run(session, run_id), runs.result(session, blobs, run_id) or {}) for run_id in run_ids]
    models = {one.camera_model: one.run.id for one in found}
    if len(models) > 1:
        (first, first_id), (second, second_id) = list(models.items())[:2]
        raise RefusedInputError(
            f"Run #{first_id} uses the camera model {first} and run #{second_id} uses {second}: their parameters are not"
            " the same quantities. Compare runs of one model."
        )
    return found


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
) -> HTMLResponse:
    """Show several runs over one another, or say what to choose."""
    try:
        run_ids = read_run_ids(asked or [])
        compared = read_compared(session, request.app.state.blobs, run_ids)
    except RefusedInputError as error:
        return render(request, "compare.html", status_code=422, refusal=str(error), compared=[])
    if len(compared) < 2:
        return render(request, "compare.html", refusal=None, compared=[])
    place = run_ids.index(int(reference)) if reference.isdecimal() and int(reference) in run_ids else 0
    rows = differences(compared, read_names(session, [one.run for one in compared]))
    parameters = contrasts([one.result for one in compared], place)
    return render(
        request,
        "compare.html",
        refusal=None,
        compared=compared,
        run_ids=run_ids,
        reference=place,
        ordered=[run_ids[place], *(run_id for run_id in run_ids if run_id != run_ids[place])],
        everything=bool(everything),
        crowded=len(compared) > CROWDED_RUNS,
        methods=method_panel(compared),
        rows=[row for row in rows if everything or row.differs],
        alike=sum(not row.differs for row in rows),
        parameters=[row for row in parameters if everything or row.differs],
        figures=list(FIGURES.values()),
        wide=WIDE,
    )
