"""Launching a run, in steps on one page: starting point, data, method, parameters, dry run, queue.

The dry run is the service's own (`validate_only`). The address holds where the form begins: `?sensor=`, `?set=`,
`?method=`, `?preset=`, `?clone=` a run, what was sought of a large fleet (`?find=`), and every field that was changed
since.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any
from urllib.parse import urlencode

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response
from starlette.datastructures import FormData, QueryParams

from boresight.calibration.evaluation.forecast import Forecast
from boresight.calibration.options import (
    FORM,
    METHODS,
    OF_ONE_RUN,
    OPTIONS,
    CalibrationSettings,
    Option,
    describe_value,
    format_value,
    get_method_title,
)
from boresight.cameras import CAMERA_MODELS
from boresight.console.access.dependencies import DryRunSources, Reading, Who, csrf
from boresight.console.fleet import queries as sensor_queries
from boresight.console.fleet import service as sensors
from boresight.console.fleet.service import SensorChoices
from boresight.console.fleet.tables import Sensor
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import AttemptResult, RefusalContext, ask, attempt, get_texts, redirect, render
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import presets
from boresight.console.runs import service as runs
from boresight.console.runs.presets import OfferedPreset
from boresight.console.runs.starts import TRUSTED
from boresight.console.telemetry import queries as telemetry_rows
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session
from boresight.platform.db.times import read_time
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.web.paging import parse_row_id
from boresight.telemetry.sensors import read_described_camera
from boresight.verdicts.numbers import count, duration

#: The settings with one form field each; free parameters have one per sensor.
FIELDS = tuple(name for name in OPTIONS if name != "free")


def typed_settings(document: Mapping[str, Any]) -> dict[str, str]:
    """Write the settings of a run as the form's fields show them."""
    return {name: format_value(document[name]) for name in FIELDS if name in document}


DEFAULTS = typed_settings(CalibrationSettings().document())


@dataclass(frozen=True)
class TypedForm:
    """The form as typed text, so that a refused form comes back unchanged; a setting is `typed[name]`."""

    sensor_id: str = ""
    telemetry_set_id: str = ""
    validation_set_id: str = ""
    joint_set_ids: Sequence[str] = ()
    prior: str = ""  # `set-3` or `run-7`
    label: str = ""
    chosen: Mapping[str, str] = field(default_factory=lambda: DEFAULTS)
    free: Mapping[int, Sequence[str]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> str:
        """Return what was typed for a setting."""
        return self.chosen[name]

    def with_settings(self, texts: Mapping[str, str]) -> TypedForm:
        """Return the form with some settings replaced."""
        return replace(self, chosen={**self.chosen, **texts})

    def under(self, settings: CalibrationSettings) -> TypedForm:
        """Return the form with new settings, keeping data and label, and the free parameters where the settings name none."""
        free = dict(self.free)
        if settings.free and (sensor_id := parse_row_id(self.sensor_id)) is not None:
            free[sensor_id] = list(settings.free)
        return replace(self.with_settings(typed_settings(settings.document())), free=free)

    def amended(self, address: QueryParams) -> TypedForm:
        """Return the form with the fields that an address names; an empty `free-<sensor>` frees no parameter.

        An address with a validation set was written by this form and names all its data; otherwise its set is only a
        starting point.
        """
        said: dict[str, Any] = {
            name: address[name] for name in ("validation_set_id", "prior", "label") if name in address
        }
        if "joint_set_ids" in address:
            said["joint_set_ids"] = [number for number in address.getlist("joint_set_ids") if number]
        if "validation_set_id" in address:
            named = {"sensor_id": address.get("sensor", ""), "telemetry_set_id": address.get("set", "")}
            said |= {name: value for name, value in named.items() if value.isdecimal()}
        free = {
            sensor: [name for name in address.getlist(f"free-{sensor}") if name]
            if f"free-{sensor}" in address
            else names
            for sensor, names in self.free.items()
        }
        texts = {name: address[name] for name in FIELDS if name in address and name != "method"}
        return replace(self.with_settings(texts), **said, free=free)

    @property
    def query(self) -> str:
        """The fields as a query string, from which the page finds what was changed since."""
        texts = [("validation_set_id", self.validation_set_id), ("prior", self.prior), ("label", self.label)]
        texts += [("joint_set_ids", number) for number in self.joint_set_ids]
        texts += [(name, self[name]) for name in FIELDS if name != "method"]
        ticks = [(f"free-{sensor}", name) for sensor, names in self.free.items() for name in names]
        return urlencode([*texts, *ticks])

    @property
    def advanced(self) -> bool:
        """Whether a choice behind "More options" differs from the usual."""
        return any(
            self[name] != DEFAULTS[name]
            for name in FIELDS
            if not OPTIONS[name].usual and OPTIONS[name].group not in OF_ONE_RUN
        )

    @property
    def differs_for_one_run(self) -> bool:
        """Whether a choice about several sets or a prior differs from the usual."""
        return any(self[name] != DEFAULTS[name] for name in FIELDS if OPTIONS[name].group in OF_ONE_RUN)

    @property
    def start(self) -> dict[str, Any]:
        """The calibration that the run starts from, as the service names it."""
        kind, _, number = self.prior.partition("-")
        if not self.prior:
            return {}
        if kind not in {"set", "run"}:
            raise RefusedInputError(f"A run cannot start from {self.prior[:20]!r}; choose from the list.")
        return {f"prior_{kind}_id": whole(number, "prior")}

    def settings(self) -> dict[str, Any]:
        """Return the settings document of the calibration."""
        free = list(self.free.get(whole(self.sensor_id, "sensor"), ()))
        if not free:
            raise RefusedInputError("No parameter is free: tick at least one to estimate.")
        return {**self.settings_of_any(), "free": free}

    def settings_of_any(self) -> dict[str, Any]:
        """Return the settings document for any sensor, with the sensor's own free parameters; refuses as `settings`."""
        method = self["method"]
        mine = [name for name in FIELDS if name == "method" or method in OPTIONS[name].methods]
        if self["variant"] == "no-q" and "process_noise_sigma" in mine:
            mine.remove("process_noise_sigma")
        return {name: _read(OPTIONS[name], self[name]) for name in mine}


def _read(option: Option, text: str) -> Any:
    """Read what was typed; a time in any form that pages show."""
    value = option.read(text)
    return list(map(read_time, value)) if option.kind == "times" and value else value


def whole(text: str, name: str) -> int:
    """Read a whole number."""
    number = parse_row_id(text)
    if number is None:
        raise RefusedInputError(f"The {name} {text.strip()[:20]!r} is not a whole number; type one, such as 6.")
    return number


def typed_form(form: FormData) -> TypedForm:
    """Read the form as typed; free parameters are those of the sensors whose boxes are ticked."""
    text = get_texts(form)
    ticked = {name: name.removeprefix("free-") for name in form if name.startswith("free-")}
    numbered = {name: parse_row_id(number) for name, number in ticked.items()}
    free = {number: list(map(str, form.getlist(name))) for name, number in numbered.items() if number is not None}
    about: dict[str, Any] = {item.name: text[item.name] for item in fields(TypedForm) if text.get(item.name)}
    about["joint_set_ids"] = [str(number) for number in form.getlist("joint_set_ids")]
    chosen = {**DEFAULTS, **{name: text[name] for name in FIELDS if text.get(name)}}
    return TypedForm(**{**about, "chosen": chosen, "free": free})


MOST_SETS = 100
LONGEST_NUMBER = 9  # digits of a row's number
OF_A_SENSOR = (
    "set",
    "validation_set_id",
    "joint_set_ids",
    "prior",
)  # parameters of the address about data, besides the sensor


@dataclass(frozen=True)
class LaunchOrigin:
    """The starting point of the form: the valid parameters of the address."""

    sensor: int | None = None
    set_id: int | None = None
    clone: int | None = None
    method: str = ""
    preset: OfferedPreset | None = None
    find: str = ""

    @property
    def address_fields(self) -> dict[str, str]:
        """Its parameters in an address, without the search text."""
        named = {"sensor": self.sensor, "set": self.set_id, "clone": self.clone, "method": self.method}
        key = self.preset.key if self.preset else None
        return {name: str(value) for name, value in {**named, "preset": key}.items() if value}

    @property
    def query(self) -> str:
        """The same as a query string."""
        return urlencode(self.address_fields | ({"find": self.find} if self.find else {}))

    def with_preset(self, key: str) -> str:
        """The query string with a preset, whose method replaces the one in the address."""
        named = {"sensor": self.sensor, "set": self.set_id, "clone": self.clone, "preset": key, "find": self.find}
        return urlencode({name: value for name, value in named.items() if value})


@dataclass(frozen=True)
class OfferedStart:
    """A calibration that a run may start from: its value in the form, its sensor, and what it is."""

    value: str
    sensor_id: int
    name: str
    said: str


@dataclass(frozen=True)
class OfferedData:
    """The choices that the form offers."""

    choices: SensorChoices
    fleet: Sequence[Sensor]
    sets: Sequence[TelemetrySet]
    is_whole: bool
    starts: Sequence[OfferedStart] = ()

    @property
    def shown_sensor(self) -> int | None:
        """The sensor whose sets and parameters the form shows."""
        return None if self.is_whole or not self.fleet else self.fleet[0].id


def offer(session: Session, find: str, sensor_id: int | None, set_ids: Sequence[str] = ()) -> OfferedData:
    """Read the choices of a form for a sensor, by default the first by name, including these sets."""
    choices = sensors.list_choices(session, find=find, keep=[] if sensor_id is None else [sensor_id])
    if choices.is_all:
        sets = telemetry_sets.list_telemetry_sets(session, limit=MOST_SETS + 1)
        if len(sets) <= MOST_SETS:
            return OfferedData(choices, sensor_queries.list_sensors(session), sets, is_whole=True)
    if not choices.names:  # no name contains the search text
        choices = replace(choices, names=dict(list(sensors.list_choices(session).names.items())[:1]))
    chosen = next(number for number in (sensor_id, *choices.names) if number is not None and number in choices.names)
    sets = telemetry_sets.list_telemetry_sets(session, sensor_id=chosen, limit=MOST_SETS)
    older = _older(session, set_ids, chosen, {known.id for known in sets})
    return OfferedData(choices, sensor_queries.list_sensors(session, [chosen]), [*sets, *older], is_whole=False)


def _older(session: Session, set_ids: Sequence[str], sensor_id: int, known: set[int]) -> Iterator[TelemetrySet]:
    """Yield the named sets of the sensor that are in use but not among the newest."""
    for number in {number for text in set_ids for number in _number(text)} - known:
        try:
            row = session.get_known(TelemetrySet, number)
        except NotFoundError:
            continue
        if row.sensor_id == sensor_id and row.archived_utc is None:
            yield row


def _number(text: str) -> list[int]:
    return [int(text)] if text.isdecimal() and len(text) <= LONGEST_NUMBER else []


def sensor_meant(session: Session, origin: LaunchOrigin, address: Mapping[str, str]) -> int | None:
    """Return the sensor of a form with this starting point; None where that determines none."""
    of_set = origin.set_id is not None and origin.clone is None and "validation_set_id" not in address
    if origin.sensor is not None and not of_set:
        return origin.sensor
    if origin.clone is not None:
        return runs.get_run(session, origin.clone).sensor_id
    if origin.set_id is not None:
        return session.get_known(TelemetrySet, origin.set_id).sensor_id
    return None


def sets_of_clone(session: Session, origin: LaunchOrigin) -> list[str]:
    """Return the set numbers of the cloned run, which may be older than the other choices."""
    if origin.clone is None:
        return []
    run = runs.get_run(session, origin.clone)
    named = (run.telemetry_set_id, run.validation_set_id, *run.joint_set_ids)
    return [str(number) for number in named if number is not None]


def list_starts(session: Session, fleet: Sequence[Sensor], chosen: str) -> list[OfferedStart]:
    """Return what runs of these sensors may start from: sets that were approved or are active, and the run that is chosen."""
    sets = set_queries.list_sets_in(session, [sensor.id for sensor in fleet], TRUSTED)
    found = [
        OfferedStart(f"set-{row.id}", row.sensor_id, row.name, ", ".join(dict.fromkeys(_states(row)))) for row in sets
    ]
    kind, _, number = chosen.partition("-")
    if kind == "run" and (run_id := parse_row_id(number)) is not None:
        try:
            run = runs.get_run(session, run_id)
        except NotFoundError:
            return found
        found.append(OfferedStart(chosen, run.sensor_id, f"run #{run.id}", run.own_label or run.state))
    return found


def _states(row: ParameterSet) -> Iterator[str]:
    """Say how a set stands, first what is on board."""
    if row.onboard_state == "ACTIVE":
        yield "active on board"
    yield row.ground_state.lower()


def found_alone(offered: OfferedData, address: QueryParams) -> str | None:
    """Return the query of the form for the only sensor found; None where it is shown already or several were found."""
    choices = offered.choices
    alone = list(choices.names)[-1] if choices.find and choices.found == choices.fitting == 1 else None
    if offered.is_whole or choices.is_all or alone in {None, offered.shown_sensor}:
        return None
    kept = [(name, text) for name, text in address.multi_items() if not _applies_to_one_sensor(name)]
    return urlencode([*kept, ("sensor", alone)])


def _applies_to_one_sensor(name: str) -> bool:
    """Whether a parameter of the address applies to one sensor only."""
    return name in {"sensor", *OF_A_SENSOR} or name.startswith("free-")


def first_choice(
    session: Session, fleet: Sequence[Sensor], clone: int | None, sensor_id: int | None, set_id: int | None
) -> TypedForm:
    """Fill a new form: from a run to clone, with a set, or with the newest sets of a sensor, by default the first."""
    free = {sensor.id: list_free_parameters(sensor) for sensor in fleet}
    if clone is None and set_id is not None:
        return TypedForm(**_sets_with(session, set_id), free=free)
    if clone is None:
        return TypedForm(**newest_sets(session, fleet[0].id if sensor_id is None and fleet else sensor_id), free=free)
    run = runs.get_run(session, clone)
    free[run.sensor_id] = list(run.stated_settings.free or free.get(run.sensor_id) or [])
    data: dict[str, Any] = {
        "sensor_id": str(run.sensor_id),
        "telemetry_set_id": str(run.telemetry_set_id),
        "validation_set_id": str(run.validation_set_id or ""),
        "joint_set_ids": [str(number) for number in run.joint_set_ids],
        "prior": f"set-{run.prior_set_id}"
        if run.prior_set_id
        else f"run-{run.prior_run_id}"
        if run.prior_run_id
        else "",
    }
    if sensor_id not in {None, run.sensor_id}:
        data = newest_sets(session, sensor_id)
    return TypedForm(**data, label=run.label, free=free).with_settings(typed_settings(run.settings))


def about_its_sensor(session: Session, typed: TypedForm) -> TypedForm:
    """Return the form with the newest sets and the own free parameters of the sensor that it names."""
    fleet = sensor_queries.list_sensors(session, _number(typed.sensor_id))
    free = {sensor.id: list_free_parameters(sensor) for sensor in fleet}
    return replace(typed, **newest_sets(session, next(iter(free), None)), free=free, joint_set_ids=(), prior="")


def newest_sets(session: Session, sensor_id: int | None) -> dict[str, Any]:
    """Choose the newest set of either purpose for a sensor."""
    if sensor_id is None:
        return {}
    newest = {known.purpose: str(known.id) for known in telemetry_rows.read_heads(session, [sensor_id], 1, ())}
    return {
        "sensor_id": str(sensor_id),
        "telemetry_set_id": newest.get("calibration", ""),
        "validation_set_id": newest.get("validation", ""),
    }


def _sets_with(session: Session, set_id: int) -> dict[str, Any]:
    """Choose this set for its purpose, and the newest of its sensor for the other."""
    known = session.get_known(TelemetrySet, set_id)
    place = "telemetry_set_id" if known.purpose == "calibration" else "validation_set_id"
    return {**newest_sets(session, known.sensor_id), place: str(known.id)}


def list_free_parameters(sensor: Sensor) -> list[str]:
    """Return the free parameters of a sensor's file; all where it names none."""
    return list(read_described_camera(sensor.document).free)


def list_parameter_names(sensor: Sensor) -> tuple[str, ...]:
    """Return the names of a sensor's parameters."""
    return CAMERA_MODELS[sensor.document["camera_model"]].parameter_names


@dataclass(frozen=True)
class PredictedSigma:
    """A free parameter's predicted sigma and its typical sigma, both SI; `share` is their ratio."""

    name: str
    predicted: float | None
    typical: float

    @property
    def share(self) -> float | None:
        """Predicted over typical sigma; above 1 the data add nothing."""
        return None if self.predicted is None else self.predicted / self.typical


@dataclass(frozen=True)
class DryRunView:
    """A dry run as the page shows it: facts, forecast and warnings."""

    facts: Sequence[tuple[str, str]]
    warnings: Sequence[str]
    forecast: Forecast | None
    sigmas: Sequence[PredictedSigma]

    @property
    def level(self) -> str:
        """The level of the forecast: normal where every direction is determined, serious where nothing can be predicted."""
        if self.forecast is None or self.forecast.weak is None:
            return "serious"
        return "caution" if self.forecast.weak else "normal"


def make_dry_run_view(summary: Mapping[str, Any]) -> DryRunView:
    """Lay out the service's dry-run summary."""
    free, forecast = summary["free"], summary["forecast"]
    facts = [
        ("Sensor", summary["sensor"]),
        ("Calibration set", ", ".join([summary["telemetry_set"], *summary["joint_sets"]])),
        ("Starts from", summary["prior"] or "the sensor's parameters"),
        ("Validation set", summary["validation_set"] or "none"),
        ("Method", get_method_title(summary["settings"]["method"])),
        ("Matches", describe_value("match", summary["settings"]["match"])),
        ("Other settings", _other_choices(summary["settings"]) or "defaults"),
        ("Frames", count(summary["frames"])),
        ("Stars", count(summary["stars"])),
        ("Star pairs", f"about {count(summary['pairs'])}"),
        ("Free parameters", f"{len(free)}: {', '.join(free)}"),
        ("Expected duration", _expected(summary)),
    ]
    sigmas = [
        PredictedSigma(name, value, forecast.typical_sigma[name])
        for name, value in (forecast.sigma.items() if forecast else ())
    ]
    return DryRunView(facts, summary["warnings"], forecast, sigmas)


def _expected(summary: Mapping[str, Any]) -> str:
    """Write the expected duration with its spread and its basis."""
    low, high = map(duration, summary["predicted_range_s"])
    runs = summary["paced_by"]
    known = f"from the last {runs} of this method" if runs > 1 else "from the one run of this method"
    basis = f", {known}" if runs else "; rough estimate, no earlier runs"
    return f"about {duration(summary['predicted_s'])} ({low} to {high}{basis})"


def _other_choices(settings: Mapping[str, Any]) -> str:
    usual = CalibrationSettings().document()
    named = {"method", "match", "free"}
    return ", ".join(
        f"{name} {settings[name]}" for name in usual if name not in named and settings[name] != usual[name]
    )


@dataclass(frozen=True)
class ChangedChoice:
    """A setting that differs from the starting point, in words."""

    title: str
    before: str
    now: str


def differences(before: CalibrationSettings, now: CalibrationSettings) -> list[ChangedChoice]:
    """List the differences of two settings."""
    pairs = ((name, getattr(before, name), getattr(now, name)) for name in OPTIONS)
    return [
        ChangedChoice(OPTIONS[name].label, describe_value(name, old), describe_value(name, new))
        for name, old, new in pairs
        if old != new
    ]


router = PageRouter(dependencies=[Depends(csrf)])


def _launch(session: Session, actor: Actor, typed: TypedForm, forecast_sources: ForecastSources | None = None) -> Any:
    return runs.launch(
        session,
        actor,
        whole(typed.sensor_id, "sensor"),
        whole(typed.telemetry_set_id, "calibration set"),
        typed.settings(),
        validation_set_id=whole(typed.validation_set_id, "validation set") if typed.validation_set_id else None,
        joint_set_ids=[whole(number, "further set") for number in typed.joint_set_ids],
        **typed.start,
        label=typed.label.strip(),
        validate_only=forecast_sources is not None,
        forecast_sources=forecast_sources,
    )


def _saved(session: Session, actor: Actor, typed: TypedForm, name: str, sentence: str) -> Any:
    """Keep the typed settings under a name; the sensor's own free parameters are left to each sensor."""
    settings = typed.settings()
    sensor = session.get_known(Sensor, whole(typed.sensor_id, "sensor"))
    own = set(settings["free"]) == set(list_free_parameters(sensor))
    return presets.save_preset(session, actor, name, sentence, {**settings, "free": None if own else settings["free"]})


def read_origin(request: Request, session: Session) -> LaunchOrigin:
    """Read the starting point from the address; unknown names are ignored, except a preset, which is refused."""
    given = request.query_params
    texts = {name: given.get(name, "") for name in ("sensor", "set", "clone")}
    numbers = {name: int(text) for name, text in texts.items() if text.isdecimal() and len(text) <= LONGEST_NUMBER}
    method = given.get("method", "")
    return LaunchOrigin(
        numbers.get("sensor"),
        numbers.get("set"),
        numbers.get("clone"),
        method if method in METHODS else "",
        presets.get_offer(session, given["preset"]) if given.get("preset") else None,
        given.get("find", "").strip(),
    )


def _begun(session: Session, offered: OfferedData, origin: LaunchOrigin) -> TypedForm:
    """Fill a new form from its starting point: data first, then the preset's settings, then the method."""
    typed = first_choice(session, offered.fleet, origin.clone, offered.shown_sensor or origin.sensor, origin.set_id)
    typed = typed if origin.preset is None else typed.under(origin.preset.chosen)
    return typed.with_settings({"method": origin.method}) if origin.method else typed


@router.get("/runs/new", response_class=HTMLResponse)
def launch_page(request: Request, session: Reading, actor: Who) -> Response:
    """Show the form, empty or filled from a run, a telemetry set or a preset."""
    origin = read_origin(request, session)
    typed, offered = _offered(request, session, origin)
    if query := found_alone(offered, request.query_params):
        return redirect(f"/runs/new?{query}")
    return _page(request, session, actor, typed, origin, offered)


def _offered(request: Request, session: Session, origin: LaunchOrigin) -> tuple[TypedForm, OfferedData]:
    """Fill a new form as its address asks."""
    address = request.query_params
    named = [*(number for name in OF_A_SENSOR for number in address.getlist(name)), *sets_of_clone(session, origin)]
    offered = offer(session, origin.find, sensor_meant(session, origin, address), named)
    return _begun(session, offered, origin).amended(address), offered


@router.post("/runs/new", response_class=HTMLResponse)
async def launch(request: Request, session: Reading, actor: Who, forecast_sources: DryRunSources) -> Response:
    """Apply a preset (`intent=preset`), keep one (`save`), queue the run (`queue`; `offered`: as offered here), or only check.

    A form that holds the sets of one sensor and names another comes back with the sets of that one, whatever it was sent for.
    """
    form = await request.form()
    origin = await run_in_threadpool(read_origin, request, session)
    typed, intent = typed_form(form), form.get("intent")
    if intent == "offered":
        typed, intent = (await run_in_threadpool(_offered, request, session, origin))[0], "queue"
    if form.get("shown", typed.sensor_id) != typed.sensor_id:
        typed, intent = await run_in_threadpool(about_its_sensor, session, typed), "check"
    if intent == "queue":
        outcome = await attempt(request, partial(_launch, actor=actor, typed=typed))
        if outcome.value is not None:
            return redirect(f"/runs/{outcome.value.id}", flash=f"Run #{outcome.value.id} was put into the queue.")
    elif intent == "save":
        words = get_texts(form)
        name, sentence = words.get("preset_name", ""), words.get("preset_sentence", "")
        outcome = await attempt(request, partial(_saved, actor=actor, typed=typed, name=name, sentence=sentence))
        if outcome.value is not None:
            kept = replace(origin, preset=presets.make_offer(outcome.value))
            return redirect(f"/runs/new?{kept.query}", flash=f"{kept.preset.name} is saved." if kept.preset else "")
    else:
        if intent == "preset" and origin.preset is not None:
            typed = typed.under(origin.preset.chosen)
        outcome = await run_in_threadpool(ask, partial(_launch, session, actor, typed, forecast_sources))
    return await run_in_threadpool(_page, request, session, actor, typed, origin, None, outcome, form)


def _page(
    request: Request,
    session: Session,
    actor: Actor,
    typed: TypedForm,
    origin: LaunchOrigin,
    offered: OfferedData | None,
    outcome: AttemptResult[Any] | None = None,
    form: FormData | None = None,
) -> HTMLResponse:
    if offered is None:
        named = [typed.telemetry_set_id, typed.validation_set_id, *typed.joint_set_ids]
        offered = offer(session, origin.find, parse_row_id(typed.sensor_id), named)
    offered = replace(offered, starts=list_starts(session, offered.fleet, typed.prior))
    refusal: RefusalContext | None = outcome.refusal if outcome else None
    words = get_texts(form) if form is not None else request.query_params
    moved = form is not None and form.get("intent") in {"queue", "offered", "save"}
    return render(
        request,
        "runs/launch.html",
        refused=refusal if refusal and (moved or refusal.is_ours) else None,
        offered=offered,
        parameter_names={sensor.id: list_parameter_names(sensor) for sensor in offered.fleet},
        has_telemetry=bool(offered.sets or telemetry_sets.list_telemetry_sets(session, limit=1)),
        options=FORM,
        methods=METHODS.values(),
        typed=typed,
        origin=origin,
        begun=_begun(session, offered, origin).query,
        offers=presets.list_offers(session),
        changes=_changes(session, typed, origin),
        preset_name=words.get("preset_name", ""),
        preset_sentence=words.get("preset_sentence", ""),
        refusal=refusal,
        summary=make_dry_run_view(outcome.value) if outcome and outcome.value is not None else None,
        may_launch="analyst" in actor.roles,
    )


def _changes(session: Session, typed: TypedForm, origin: LaunchOrigin) -> list[ChangedChoice] | None:
    """List the differences from the cloned run or from the preset; None where the form began from neither."""
    sensor_id = parse_row_id(typed.sensor_id)
    if (origin.clone is None and origin.preset is None) or sensor_id is None:
        return None
    try:
        now = CalibrationSettings.parse(typed.settings())
    except RefusedInputError:
        return []  # the refusal is shown beside
    before = origin.preset.chosen if origin.preset else CalibrationSettings()
    if origin.clone is not None:
        before = runs.get_run(session, origin.clone).stated_settings
    free = before.free or tuple(list_free_parameters(session.get_known(Sensor, sensor_id)))
    if set(now.free or ()) == set(free):
        now = replace(now, free=free)  # their order is no difference
    return differences(replace(before, free=free), now)
