"""The list of sensors, page by page, registering one, and the sensors that a page's chooser offers."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from textwrap import indent
from typing import Any

import numpy as np
from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response
from starlette.datastructures import FormData, UploadFile

from boresight.cameras import CAMERA_MODELS, DEFAULT_CAMERA, CameraModel
from boresight.console.access.dependencies import KNOWN, Reading, Roles, Who, csrf, get_server
from boresight.console.fleet import service as sensors
from boresight.console.fleet import status as fleet
from boresight.console.fleet.schemas import (
    EXAMPLE_DECLARED,
    EXAMPLE_INITIAL,
    EXAMPLE_READOUT,
    EXAMPLE_TYPICAL_SIGMA,
)
from boresight.console.fleet.service import SensorChoices
from boresight.console.fleet.status import SensorStatus, SensorTile
from boresight.console.fleet.tables import Sensor
from boresight.console.operation import RowWithFields
from boresight.console.pages.formats import LEVELS
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext, attempt, redirect, render
from boresight.console.pages.tables import (
    Table,
    TableColumn,
    TableView,
    accept_one,
    is_text,
    read_all,
    read_page,
    read_view,
    write_csv,
)
from boresight.errors import Fault, RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session, open_reading
from boresight.platform.web.paging import parse_row_id
from boresight.site import SITE_FIELDS
from boresight.telemetry.data_sheets import ASKED, DATA_SHEETS
from boresight.telemetry.declarations import DECLARATIONS
from boresight.telemetry.new_sensor import Described, describe_typed
from boresight.telemetry.read.formats import parse_json, read_text

router = PageRouter(dependencies=[Depends(csrf)])

EXAMPLE = f"""{{
  "name": "ST16-7",
  "detector": {{
    "rows": 1944, "columns": 2592, "pixel_pitch_m": 2.2e-6
  }},
  "camera_model": "{DEFAULT_CAMERA.name}",
  "parity": 1,
  "centroid_sigma_px": 0.1,
  "initial": {indent(json.dumps(EXAMPLE_INITIAL, indent=2), "  ").lstrip()},
  "typical_sigma": {indent(json.dumps(EXAMPLE_TYPICAL_SIGMA, indent=2), "  ").lstrip()},
  "magnitude_limit": 5.75,
  "readout": {json.dumps(EXAMPLE_READOUT)},
  "declared": {json.dumps(EXAMPLE_DECLARED)}
}}
"""

SENSORS = Table(
    "sensors",
    "Registered sensors",
    (
        TableColumn("sensor", "Sensor", "sensor", "nowrap", head=True, csv=("number", "sensor", "simulated")),
        TableColumn("status", "Status", csv=("status", "sentence")),
        TableColumn("model", "Camera model", "model", "nowrap", csv=("camera_model",)),
        TableColumn("detector", "Detector", "-detector", "num", unit="px", csv=("rows", "columns")),
        TableColumn("f", "f", "-f", "num", "Focal length of the baseline", "mm", csv=("f_m",)),
        TableColumn("baseline", "Baseline", "baseline", "nowrap", csv=("baseline",)),
        TableColumn("sets", "Sets", "-sets", "num", "Telemetry sets that are in use", csv=("telemetry_sets",)),
    ),
    {"status": accept_one(LEVELS), "q": is_text},
    "sensor",
    kind="dense",
)
ROWS_AT_ONCE = 500
#: What a person calls the sensor that the form makes, and letters of a field that are read.
SUBJECT, LONGEST_TYPED = "The new sensor", 100
FIELDS = (
    ("name", "Unique in the fleet; becomes part of PS-<sensor>-<n>."),
    ("detector", "rows, columns, and pixel_pitch_m in metres."),
    ("camera_model", "The equations that convert pixels to directions; determines the parameter names."),
    ("parity", "+1: rows, columns and boresight are right-handed. −1: an upright image."),
    ("centroid_sigma_px", "Noise of a centroid along one axis, used where the telemetry gives none."),
    ("initial", "The ground calibration, in SI; becomes set 0 and the first baseline."),
    ("typical_sigma", "Spread of each parameter between sensors of this kind, in SI."),
    ("free", "Optional: the parameters to estimate; all if omitted."),
    ("magnitude_limit", "Optional: the faintest catalogue star that the sensor sees."),
    (
        "readout",
        (
            "Optional; the gate Assumptions has no data until it is declared: mode global, or rolling with line_time_s, axis "
            "rows or columns, and corrected. If the telemetry is not corrected for a rolling readout, Boresight corrects it."
        ),
    ),
    (
        "site",
        "Optional, for a camera on the ground: "
        + ", ".join(SITE_FIELDS)
        + ". Stars are then seen through the air above it.",
    ),
    (
        "declared",
        "Optional; the gate Assumptions has no data until it is declared: "
        + "; ".join(f"{name} {' or '.join(one.words)}" for name, one in DECLARATIONS.items())
        + ".",
    ),
)


def read_document(text: str) -> dict[str, Any]:
    """Read a typed sensor file."""
    if not text.strip():
        raise RefusedInputError("There is no sensor file: paste its JSON or choose the file.")
    try:
        document = parse_json(text)
    except json.JSONDecodeError as error:
        fault = Fault(error.lineno, str(error.colno), f"{error.msg}; correct the JSON here.")
        raise RefusedInputError(
            f"This is not JSON at line {error.lineno} ({error.msg}); correct it.", (fault,)
        ) from error
    if not isinstance(document, dict):
        raise RefusedInputError("This is not a sensor file; write one JSON object, in braces.")
    return document


async def typed_document(form: FormData) -> str:
    """Return the text of the chosen file, else the typed text."""
    chosen = form.get("file")
    if isinstance(chosen, UploadFile) and chosen.filename:
        content = await chosen.read()
        await chosen.close()
        return read_text(chosen.filename, content).decode()
    typed = form.get("document")
    return typed if isinstance(typed, str) else ""


@dataclass(frozen=True)
class Optics:
    """What a detector and a focal length see."""

    rows_deg: float
    columns_deg: float
    diagonal_deg: float
    pixel_urad: float
    principal_row_px: float
    principal_col_px: float


def compute_optics(camera: CameraModel, detector: Mapping[str, Any], parameters: Mapping[str, float]) -> Optics:
    """Derive the field of view from a detector and camera parameters."""
    x = np.array([parameters[name] for name in camera.parameter_names])
    f_px, (principal_row_px, principal_col_px) = (
        camera.focal_px(x, detector["pixel_pitch_m"]),
        camera.principal_point(x),
    )
    rows, columns = detector["rows"], detector["columns"]

    def degrees(side_px: float) -> float:
        return 2.0 * math.degrees(math.atan(side_px / 2.0 / f_px))

    return Optics(
        rows_deg=degrees(rows),
        columns_deg=degrees(columns),
        diagonal_deg=degrees(math.hypot(rows, columns)),
        pixel_urad=1e6 / f_px,
        principal_row_px=principal_row_px,
        principal_col_px=principal_col_px,
    )


@dataclass(frozen=True)
class Proposal:
    """What was typed of a new sensor, by name, and what was made of it, or every fault.

    `optics`: its field of view, where one was made.
    """

    typed: Mapping[str, str] = field(default_factory=dict)
    described: Described | None = None
    optics: Optics | None = None
    faults: tuple[Fault, ...] = ()

    def is_faulty(self, name: str) -> bool:
        """Whether a fault names a field."""
        return any(one.name == name for one in self.faults)

    @property
    def on_the_ground(self) -> bool:
        """Whether anything of a site was typed."""
        return any(self.typed.get(name) for name in SITE_FIELDS)

    @property
    def text(self) -> str:
        """The sensor file that was made, as JSON."""
        return "" if self.described is None else json.dumps(self.described.document, indent=2)


def propose(request: Request) -> Proposal:
    """Make a sensor of what an address holds; nothing is kept."""
    names = ("name", "sheet", "camera_model", "parity", *ASKED, *SITE_FIELDS)
    typed = {name: request.query_params.get(name, "").strip()[:LONGEST_TYPED] for name in names}
    if not request.query_params.get("describe"):
        return Proposal(typed)
    try:
        described = describe_typed(typed, SUBJECT)
    except RefusedInputError as error:
        return Proposal(typed, faults=tuple(error.faults))
    document = described.document
    optics = compute_optics(CAMERA_MODELS[document["camera_model"]], document["detector"], document["initial"])
    return Proposal(typed, described, optics)


@dataclass(frozen=True)
class SensorsContext:
    """The state of the form: its text and its refusal; what fills it where the address does not, and what is said of that.

    `of_stars`: whether the refusal is of uploaded stars.
    """

    text: str = ""
    refusal: RefusalContext | None = None
    proposal: Proposal | None = None
    sentences: tuple[str, ...] = ()
    of_stars: bool = False


@router.get("/sensors", response_class=HTMLResponse)
def sensors_page(request: Request, roles: Roles, example: str = "") -> HTMLResponse:
    """Show a page of sensors and the form, filled with the example when asked."""
    return show_sensors(request, roles, SensorsContext(EXAMPLE if example else propose(request).text))


@router.get("/sensors.csv", dependencies=[KNOWN])
def sensors_csv(request: Request, session: Reading) -> Response:
    """Give every sensor of a view as CSV, lengths in metres."""
    view = read_view(request, SENSORS)
    return write_csv(view, map(_csv_row, _every_tile(session, view)))


def _standing(session: Session, view: TableView) -> dict[int, SensorStatus] | None:
    """Return the sensors with the status that a view asks for, computed over the whole fleet; None where it asks for none."""
    if (status := view.where.get("status")) is None:
        return None
    return {one.sensor_id: one for one in fleet.list_sensor_statuses(session) if one.status == status}


def _where(chosen: Mapping[int, SensorStatus] | None) -> dict[str, Any]:
    return {} if chosen is None else {"status": None, "among": list(chosen)}


def _tiles(session: Session, sensor_ids: Sequence[int], chosen: Mapping[int, SensorStatus] | None) -> list[SensorTile]:
    """Return the tiles of some sensors, in this order, with the status that was computed when they were chosen."""
    stand = chosen or {one.sensor_id: one for one in fleet.list_sensor_statuses(session, sensor_ids)}
    return fleet.list_tiles(session, [stand[sensor_id] for sensor_id in sensor_ids])


def _every_tile(session: Session, view: TableView) -> Iterator[SensorTile]:
    chosen = _standing(session, view)
    ids = iter([sensor.id for sensor in read_all(session, view, **_where(chosen))])
    while some := list(islice(ids, ROWS_AT_ONCE)):
        yield from _tiles(session, some, chosen)


def compute_focal_length(tile: SensorTile) -> float:
    """Focal length of the baseline, else of the sensor file, metres."""
    document, baseline = tile.sensor.document, tile.baseline
    camera, pitch = CAMERA_MODELS[document["camera_model"]], float(document["detector"]["pixel_pitch_m"])
    values = baseline.document["parameters"] if baseline else document["initial"]
    return pitch * camera.focal_px(np.array([values[name] for name in camera.parameter_names]), pitch)


def _csv_row(tile: SensorTile) -> RowWithFields:
    sensor, baseline = tile.sensor, tile.baseline
    document = sensor.document
    return RowWithFields(
        tile,
        number=sensor.id,
        sensor=sensor.name,
        simulated=bool(sensor.simulated),
        camera_model=document["camera_model"],
        rows=document["detector"]["rows"],
        columns=document["detector"]["columns"],
        f_m=compute_focal_length(tile),
        baseline=baseline.name if baseline else None,
    )


def show_sensors(request: Request, roles: frozenset[str], shown: SensorsContext) -> HTMLResponse:
    """Render a page of sensors and the form."""
    view = read_view(request, SENSORS)
    with open_reading(get_server(request).engine) as session:
        chosen = _standing(session, view)
        found = read_page(session, view, **_where(chosen))
        return render(
            request,
            "fleet/sensors.html",
            refused=shown.refusal,
            view=view,
            tiles=_tiles(session, [sensor.id for sensor in found.rows], chosen),
            registered=sensors.count(session),
            fitting=None if chosen is None or "q" in view.where else len(chosen),
            last=found.last,
            levels=tuple(reversed(LEVELS)),
            may_register=bool({"analyst", "administrator"} & roles),
            example=EXAMPLE,
            fields=FIELDS,
            focal_length_m=compute_focal_length,
            models=_models(),
            proposal=shown.proposal or propose(request),
            limit_mb=get_server(request).settings.upload_limit_mb,
            asked=ASKED,
            sheets=DATA_SHEETS,
            site_fields=SITE_FIELDS,
            shown=shown,
        )


def _models() -> Sequence[tuple[str, Sequence[str]]]:
    return [(name, model.parameter_names) for name, model in CAMERA_MODELS.items()]


@router.post("/sensors", response_class=HTMLResponse)
async def register(request: Request, actor: Who) -> Response:
    """Register a sensor from the form."""
    try:
        text = await typed_document(await request.form())
    except RefusedInputError as error:
        return await run_in_threadpool(
            show_sensors, request, actor.roles, SensorsContext(refusal=RefusalContext.of(error))
        )
    outcome = await attempt(request, partial(_register, actor, text))
    if outcome.value is not None:
        sensor = outcome.value
        flash = f"{sensor.name} is registered; its ground calibration PS-{sensor.name}-0 is the baseline."
        return redirect(f"/sensors/{sensor.id}", flash=flash)
    return await run_in_threadpool(show_sensors, request, actor.roles, SensorsContext(text, outcome.refusal))


def _register(actor: Actor, text: str, session: Session) -> Sensor:
    return sensors.register_sensor(session, actor, read_document(text))


def list_sensor_choices(
    session: Session, view: TableView, *, find: str = "", keep: Iterable[int] = ()
) -> SensorChoices:
    """Return the choices of a list's sensor filter, including the sensor that is selected."""
    narrowed = parse_row_id(view.where.get("sensor", ""))
    return sensors.list_choices(session, find=find, keep=[*keep, *([narrowed] if narrowed else [])])
