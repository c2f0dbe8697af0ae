"""The operations of a server's client without the network: every operation is a generator of requests.

An operation yields a `Request` and is sent the `ServerAnswer`; it yields a `Pause` to wait. `library.client` drives the same
operations with and without `async`. Answers are read into frozen dataclasses; what a newer server says besides is dropped.
"""

from __future__ import annotations

import hashlib
import io
import os
import uuid
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar
from urllib.parse import quote

import orjson

from boresight import errors
from boresight.errors import BoresightError, Fault, RefusedInputError, UnavailableError
from boresight.library.functions import parse_choices, read_sensor, read_telemetry

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from boresight.library.choice import Choice
    from boresight.library.diagnosis import Diagnosis
    from boresight.library.inputs import SensorSource, TelemetrySource
    from boresight.library.pointings import PointingPlan
    from boresight.library.progress import Report
    from boresight.library.results import Assessment, Calibration
    from boresight.verdicts.gates import GateAnswer

PREFIX = "/api/v1"
PROBLEM = "urn:boresight:problem:"
#: The exception of each problem, by the end of its type.
PROBLEMS: Final[Mapping[str, type[errors.BoresightError]]] = {
    "refused-input": errors.RefusedInputError,
    "malformed-request": errors.RefusedInputError,
    "not-found": errors.NotFoundError,
    "conflict": errors.ConflictError,
    "corrupt-file": errors.CorruptFileError,
    "stale": errors.StaleError,
    "precondition-required": errors.PreconditionRequiredError,
    "forbidden": errors.ForbiddenError,
    "password-to-be-set": errors.PasswordDueError,
    "second-factor-to-be-enrolled": errors.FactorEnrolmentDueError,
    "unauthenticated": errors.UnauthenticatedError,
    "second-factor-needed": errors.SecondFactorError,
    "single-sign-on-refused": errors.SingleSignOnError,
    "session-ended": errors.UnauthenticatedError,
    "too-many-attempts": errors.TooManyAttemptsError,
    "too-large": errors.TooLargeError,
    "overloaded": errors.OverloadedError,
    "unavailable": errors.UnavailableError,
    "storage-unavailable": errors.StorageError,
    "cancelled": errors.CancelledError,
}
ENDED = ("SUCCEEDED", "FAILED", "CANCELLED", "LOST")
#: Seconds between two requests about a run, short at first because most runs are.
FIRST_PAUSE_S, LONGEST_PAUSE_S, SLOWER = 0.1, 1.0, 1.3
FIRST_REDIRECT, FIRST_ERROR = 300, 400
NAMES_SHOWN = 20
FOREIGN = "the server has another version of Boresight, or a proxy or log-in page answered; check the address"

T = TypeVar("T")
V = TypeVar("V")


class RunFailedError(BoresightError):
    """A run on a server ended without a calibration; says why."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """One request; `key` makes a repeated POST the same POST. `file`: name and content of an upload. `slow`: may take minutes."""

    method: Literal["GET", "POST"]
    path: str
    params: Mapping[str, str] = field(default_factory=dict)
    body: Mapping[str, Any] | None = None
    form: Mapping[str, str] | None = None
    file: tuple[str, Path | bytes] | None = None
    headers: Mapping[str, str] = field(default_factory=dict)
    key: str | None = None
    slow: bool = False


@dataclass(frozen=True, kw_only=True)
class ServerAnswer:
    """A server's answer."""

    status: int
    headers: Mapping[str, str]
    content: bytes

    def document(self) -> dict[str, Any]:
        """Return its body, which is a JSON object in every answer of Boresight's."""
        try:
            found = orjson.loads(self.content)
        except ValueError:
            found = None
        if not isinstance(found, dict):
            kind = one_line(self.headers.get("content-type", "of no type"))
            raise UnavailableError(f"The server's answer ({self.status}, {kind}) cannot be read: {FOREIGN}.")
        return found


@dataclass(frozen=True)
class Pause:
    """A pause in seconds between two requests."""

    seconds: float


#: What an operation is sent after a pause.
PAUSED = ServerAnswer(status=0, headers={}, content=b"")
#: An operation: it yields requests, is sent answers, and returns its result.
Operation = Generator[Request | Pause, ServerAnswer, T]


@dataclass(frozen=True, kw_only=True)
class ServerSensor:
    """A star tracker on a server."""

    id: int
    name: str
    version: int
    document: dict[str, Any] = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class TelemetrySet:
    """A telemetry set on a server, with its quality report."""

    id: int
    sensor_id: int
    name: str
    purpose: str
    frames: int
    stars: int
    original_sha256: str
    quality: dict[str, Any] = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class RunProgress:
    """How far a run is, 0 to 1 and in words."""

    fraction: float | None = None
    message: str | None = None
    elapsed_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class Run:
    """A calibration on a server: QUEUED, RUNNING or CANCELLING, then SUCCEEDED, FAILED, CANCELLED or LOST with the reason."""

    id: int
    sensor_id: int
    telemetry_set_id: int
    validation_set_id: int | None
    label: str
    method: str
    state: str
    reason: str | None
    attempt: int
    progress: RunProgress | None
    joint_set_ids: list[int]
    prior_run_id: int | None
    prior_set_id: int | None
    settings: dict[str, Any] = field(repr=False)

    @property
    def has_ended(self) -> bool:
        """Whether its state is final."""
        return self.state in ENDED


@dataclass(frozen=True, kw_only=True)
class ParameterSet:
    """A named parameter set; only `ground_state` and `onboard_state` change."""

    id: int
    name: str
    sensor_id: int
    run_id: int | None
    sha256: str
    ground_state: str
    onboard_state: str
    version: int
    document: dict[str, Any] = field(repr=False)


#: A telemetry set of a server, or its number.
StoredTelemetry = TelemetrySet | int
if TYPE_CHECKING:
    #: A telemetry set of a server, or telemetry that is uploaded first.
    ServerTelemetry = TelemetrySource | TelemetrySet | int
#: What a run on a server starts from: a parameter set or its name, or a run or its number.
StoredPrior = ParameterSet | Run | int | str


@dataclass(frozen=True, kw_only=True)
class GateReport:
    """A parameter set held against its sensor's gates, by the server."""

    id: int
    parameter_set_id: int
    verdict: str
    words: str
    blocking: list[str]
    waived: list[str]
    gates: list[GateAnswer] = field(repr=False)
    sha256: str

    def as_assessment(self, sensor: str) -> Assessment:
        """Return what `boresight.assess` would of the sensor with this name."""
        from boresight.calibration.calibration import to_plain
        from boresight.library.results import Assessment
        from boresight.verdicts.gates import GateReport as Judged

        judged = Judged(
            gates=self.gates, verdict=self.verdict, words=self.words, blocking=self.blocking, waived=self.waived
        )
        return Assessment(
            sensor=sensor,
            verdict=self.verdict,
            words=self.words,
            blocking=self.blocking,
            gates=self.gates,
            document={**to_plain(judged), "sensor": sensor},
        )


@dataclass(frozen=True, kw_only=True)
class Approval:
    """A request that a parameter set become the baseline: OPEN, then APPROVED, REJECTED, WITHDRAWN, STALE or EXPIRED."""

    id: int
    parameter_set_id: int
    state: str
    reason: str
    needed: int
    version: int
    expires_utc: str | None


def one_line(text: str) -> str:
    """Return a text of a server without control characters, which a terminal would obey."""
    return "".join(sign if sign.isprintable() else " " for sign in text)


def member(document: Mapping[str, Any], name: str, kind: type[V]) -> V:
    """Return a member of an answer, of the type that Boresight gives it."""
    found = document.get(name)
    if not isinstance(found, kind):
        raise UnavailableError(f"The server's answer has no {name} of type {kind.__name__}: {FOREIGN}.")
    return found


def parse_record(kind: type[T], document: Mapping[str, Any]) -> T:
    """Read a row of a server as one of the dataclasses here."""
    try:
        return kind(**{item.name: document[item.name] for item in fields(kind) if item.init})  # type: ignore[arg-type]  # a dataclass
    except (KeyError, TypeError) as error:
        raise UnavailableError(f"The server's {kind.__name__} lacks {error}: {FOREIGN}.") from error


def parse_run(document: Mapping[str, Any]) -> Run:
    """Read a run."""
    document = {"joint_set_ids": [], "prior_run_id": None, "prior_set_id": None, **document}  # older servers lack them
    if document.get("progress") is None:
        return parse_record(Run, {**document, "progress": None})
    progress = member(document, "progress", dict)
    said = RunProgress(**{item.name: progress[item.name] for item in fields(RunProgress) if item.name in progress})
    return parse_record(Run, {**document, "progress": said})


def raise_problem(answer: ServerAnswer, address: str) -> None:
    """Raise a server's refusal with its sentence, or for any other failure an exception with the status."""
    if answer.status < FIRST_REDIRECT:
        return
    if answer.status < FIRST_ERROR:
        where = one_line(answer.headers.get("location", "nowhere"))
        raise UnavailableError(
            f"{address} redirects to {where}, where the key was not sent: give that address if it is your server's."
        )
    try:
        problem = answer.document()
        sentence, kind = one_line(member(problem, "detail", str)), member(problem, "type", str).removeprefix(PROBLEM)
    except UnavailableError:
        raise UnavailableError(
            f"{address} answered {answer.status}, but not like Boresight: check the address."
        ) from None
    error = PROBLEMS.get(kind, errors.UnavailableError)
    if issubclass(error, RefusedInputError):
        refusal: BoresightError = error(sentence, tuple(_faults(problem)))
    elif issubclass(error, errors.TooManyAttemptsError | errors.OverloadedError):
        wait_s = answer.headers.get("retry-after", "")
        refusal = error(sentence, int(wait_s) if wait_s.isdecimal() else 1)
    else:
        refusal = error(sentence)
    refusal.code = one_line(str(problem.get("code") or ""))
    raise refusal


def _faults(problem: Mapping[str, Any]) -> Iterator[Fault]:
    """Yield the places that a refusal of an input names."""
    listed = problem.get("errors")
    for one in listed if isinstance(listed, list) else ():
        if isinstance(one, dict):
            yield Fault(one.get("row"), one.get("column"), one_line(str(one.get("detail", ""))))


def _get(path: str, **params: str) -> Request:
    return Request(method="GET", path=path, params=params)


def _post(path: str, body: Mapping[str, Any] | None = None, version: int | None = None) -> Request:
    """Return a POST with an idempotency key, which may be sent again."""
    headers = {} if version is None else {"If-Match": f'"v{version}"'}
    return Request(method="POST", path=path, body=body or {}, headers=headers, key=uuid.uuid4().hex)


def list_sensors() -> Operation[list[ServerSensor]]:
    """Read the fleet, page by page."""
    rows = yield from _list("/sensors")
    return [parse_record(ServerSensor, row) for row in rows]


def _list(path: str) -> Operation[list[dict[str, Any]]]:
    """Read every page of a list."""
    found: list[dict[str, Any]] = []
    cursor: str | None = ""
    while cursor is not None:
        answer = yield _get(path, **({"cursor": cursor} if cursor else {}))
        page = answer.document()
        found += member(page, "items", list)
        before, cursor = cursor, None if page.get("next") is None else member(page, "next", str)
        if cursor == before:
            raise UnavailableError(f"The server's list of {path} starts again after a page: {FOREIGN}.")
    return found


def find_sensor(sensor: SensorSource | ServerSensor | int, *, register: bool = True) -> Operation[ServerSensor]:
    """Return the server's sensor of this number, name or description; one that it does not have is registered.

    A path is read; a text that is no file is a name.
    """
    if isinstance(sensor, ServerSensor):
        return sensor
    if isinstance(sensor, int):
        answer = yield _get(f"/sensors/{sensor}")
        return parse_record(ServerSensor, answer.document())
    known = yield from list_sensors()
    if isinstance(sensor, str) and not _is_file(Path(sensor)):
        for one in known:
            if one.name == sensor:
                return one
        names = ", ".join([one.name for one in known[:NAMES_SHOWN]] + ["..."] * (len(known) > NAMES_SHOWN)) or "none"
        raise errors.NotFoundError(
            f"The server has no sensor {sensor}, and there is no such file: choose from {names}."
        )
    described = read_sensor(sensor)
    from boresight.telemetry.sensors import parse_sensor, sensor_document

    document = sensor_document(described)
    for one in known:
        if one.name == described.name:
            if sensor_document(parse_sensor(one.document)) != document:
                raise errors.ConflictError(
                    f"The server's sensor {one.name} differs from this file: give its name to use the server's, "
                    "or edit it there."
                )
            return one
    if not register:
        raise errors.NotFoundError(f"The server has no sensor {described.name}: register it first.")
    answer = yield _post("/sensors", document)
    return parse_record(ServerSensor, answer.document())


def upload(
    telemetry: TelemetrySource, sensor: SensorSource | ServerSensor | int, purpose: str
) -> Operation[TelemetrySet]:
    """Store telemetry; the same bytes again are the set that is there."""
    found = yield from find_sensor(sensor)
    answer = yield Request(
        method="POST",
        path="/telemetry-sets",
        form={"sensor_id": str(found.id), "purpose": purpose},
        file=_make_file(telemetry),
        key=uuid.uuid4().hex,
        slow=True,
    )
    return parse_record(TelemetrySet, answer.document())


def _is_file(path: Path) -> bool:
    """Whether there is such a file; not of a name that is longer than a name may be."""
    try:
        return path.is_file()
    except OSError:
        return False


def _make_file(telemetry: TelemetrySource) -> tuple[str, Path | bytes]:
    """Return name and content of an upload: a file unchanged, or data in memory as Parquet."""
    if isinstance(telemetry, str | os.PathLike):
        path = Path(telemetry)
        if not _is_file(path):
            raise RefusedInputError(f"{path} is not a file: check the name.")
        return path.name.encode("utf-8", "replace").decode(), path  # a name may hold bytes that are no text
    import pyarrow.parquet as pq

    read = read_telemetry(telemetry)
    from boresight.telemetry.writing import contract_table

    content = io.BytesIO()
    pq.write_table(contract_table(read), content, compression="zstd")
    return "telemetry.parquet", content.getvalue()


def launch(
    telemetry: StoredTelemetry | Sequence[StoredTelemetry],
    validate: StoredTelemetry | None,
    label: str,
    settings: Mapping[str, Any],
    prior: StoredPrior | None = None,
) -> Operation[Run]:
    """Queue a calibration of one set, or of several as one."""
    first, *further = _list_several(telemetry)
    if isinstance(first, int):
        answer = yield _get(f"/telemetry-sets/{first}")
        first = parse_record(TelemetrySet, answer.document())
    document = parse_choices(settings).document()
    chosen = {name: document[name] for name, value in settings.items() if value is not None}
    order = {"sensor_id": first.sensor_id, "telemetry_set_id": first.id, "settings": chosen, "label": label}
    if further:
        order["joint_set_ids"] = [_id(one) for one in further]
    if validate is not None:
        order["validation_set_id"] = _id(validate)
    answer = yield _post("/runs", order | (yield from _name_prior(prior)))
    return parse_run(answer.document())


def _name_prior(prior: StoredPrior | None) -> Operation[dict[str, int]]:
    """Return the members of an order that name the calibration it starts from; none without a prior."""
    if prior is None:
        return {}
    if isinstance(prior, str) and not prior.isdecimal():
        prior = yield from read_parameter_set(prior)
    named = isinstance(prior, ParameterSet)
    return {"prior_set_id" if named else "prior_run_id": int(prior) if isinstance(prior, str) else _id(prior)}


def plan(
    sensor: SensorSource | ServerSensor | int,
    start: str,
    minutes: float,
    calibration: StoredPrior | None,
    candidates: str | os.PathLike[str] | None,
    criterion: str,
    orbit: Mapping[str, float] | None,
    constraints: Mapping[str, float],
) -> Operation[PointingPlan]:
    """Plan what to observe next; a sensor that is not there is registered first."""
    from boresight.library.pointings import list_degrees

    order: dict[str, Any] = {"start_utc": start, "minutes": minutes, "criterion": criterion, **constraints}
    if orbit is not None:
        order["orbit"] = dict(orbit)
    if candidates is not None:
        order["candidates"] = list_degrees(Path(candidates))
    known = yield from find_sensor(sensor)
    order |= yield from _name_prior(calibration)
    answer = yield replace(_post(f"/sensors/{known.id}:plan", order), key=None, slow=True)
    return parse_plan(answer.document())


def parse_plan(document: Mapping[str, Any]) -> PointingPlan:
    """Read a plan."""
    from boresight.library.pointings import PointingPlan
    from boresight.simulation.plans import Pointing

    pointings = [parse_record(Pointing, one) for one in member(document, "pointings", list)]
    return parse_record(PointingPlan, {**document, "pointings": pointings})


def _list_several(given: Any) -> list[Any]:
    """Return the sets that are meant, one or several."""
    several = list(given) if isinstance(given, list | tuple) else [given]
    if not several:
        raise RefusedInputError("No telemetry was given: name at least one set.")
    return several


def _id(thing: Any) -> int:
    found = thing if isinstance(thing, int) else getattr(thing, "id", None)
    if not isinstance(found, int):
        raise RefusedInputError(
            f"{thing!r} is not a number: give the number of a run, a set or a sensor, or what the client returned."
        )
    return found


def read_run(run: Run | int) -> Operation[Run]:
    """Read the progress of a run."""
    answer = yield _get(f"/runs/{_id(run)}")
    return parse_run(answer.document())


def wait(run: Run | int, report: Report, timeout_s: float | None) -> Operation[Run]:
    """Follow a run to its end."""
    try:
        found = yield from _ended(run, report, timeout_s)
    except (UnavailableError, KeyboardInterrupt) as error:
        error.add_note(f"Run {_id(run)} continues on the server: see or cancel it on its page there.")
        raise
    if found.state == "CANCELLED":
        raise errors.CancelledError(f"Run {found.id} was cancelled{_because(found)}")
    if found.state != "SUCCEEDED":
        raise RunFailedError(f"Run {found.id} ended {found.state}{_because(found)}")
    return found


def _ended(run: Run | int, report: Report, timeout_s: float | None) -> Operation[Run]:
    """Read a run until it has ended."""
    pause, waited = FIRST_PAUSE_S, 0.0
    while not (found := (yield from read_run(run))).has_ended:
        if timeout_s is not None and waited >= timeout_s:
            raise UnavailableError(
                f"Run {found.id} is {found.state} after {timeout_s:g} s: wait for it again, or cancel it."
            )
        said = found.progress or RunProgress()
        report(one_line(str(said.message or f"run {found.id} is {found.state}")), said.fraction)
        yield Pause(pause)
        waited, pause = waited + pause, min(SLOWER * pause, LONGEST_PAUSE_S)
    return found


def _because(run: Run) -> str:
    return f": {one_line(str(run.reason))}" if run.reason else "."


def fetch(run: Run | int) -> Operation[Calibration]:
    """Read a run's calibration, or its progress."""
    from boresight.calibration.calibration import parse_calibration
    from boresight.library.results import Calibration

    answer = yield _get(f"/runs/{_id(run)}/result")
    document = answer.document()
    if document.get("status") == "none":
        raise errors.NotFoundError(f"Run {_id(run)} ended without a calibration: launch it again.")
    return Calibration.of(parse_calibration(document, f"The result of run {_id(run)}"))


def fetch_choice(run: Run | int) -> Operation[Choice]:
    """Read the camera that was chosen for a run's data."""
    from boresight.calibration.choice.result import parse_choice
    from boresight.library.choice import Choice

    answer = yield _get(f"/runs/{_id(run)}/choice")
    return Choice.of(parse_choice(answer.document(), f"The choice of run {_id(run)}"))


def choose(
    telemetry: TelemetrySource | TelemetrySet | Run | int,
    sensor: SensorSource | ServerSensor | int | None,
    validate: TelemetrySource | TelemetrySet | int | None,
    label: str,
    report: Report,
    settings: Mapping[str, Any],
) -> Operation[Choice]:
    """Choose a camera for a run's data; telemetry is calibrated first."""
    if isinstance(telemetry, Run | int):
        if sensor is not None or validate is not None or label or settings:
            raise RefusedInputError(
                "A run has its sensor, validation set and settings: give the run alone.", code="run-alone"
            )
        run = telemetry
    else:
        run = yield from launch_files(telemetry, sensor, validate, label, report, settings)
        run = yield from wait(run, report, None)
    answer = yield _post(f"/runs/{_id(run)}/choice")
    yield from wait(parse_run(answer.document()), report, None)
    return (yield from fetch_choice(run))


def diagnose(
    telemetry: TelemetrySource | TelemetrySet | int, sensor: SensorSource | ServerSensor | int | None, report: Report
) -> Operation[Diagnosis]:
    """Find why a telemetry set does not match its sensor; what is not there is uploaded first."""
    from boresight.calibration.diagnosis.result import parse_diagnosis
    from boresight.library.diagnosis import Diagnosis

    if not isinstance(telemetry, TelemetrySet | int):
        telemetry = yield from _uploaded(telemetry, sensor, report)
    elif sensor is not None:
        raise RefusedInputError("A telemetry set already defines its sensor: give only the set.")
    report("looking for what does not match", None)
    answer = yield replace(_post(f"/telemetry-sets/{_id(telemetry)}:diagnose"), slow=True)
    found = parse_record(TelemetrySet, answer.document())
    return Diagnosis.of(parse_diagnosis(member(found.quality, "diagnosis", dict)))


def calibrate(
    telemetry: ServerTelemetry | Sequence[ServerTelemetry],
    sensor: SensorSource | ServerSensor | int | None,
    validate: ServerTelemetry | None,
    label: str,
    report: Report,
    settings: Mapping[str, Any],
    prior: StoredPrior | None = None,
) -> Operation[Calibration]:
    """Upload, launch, wait and fetch."""
    run = yield from launch_files(telemetry, sensor, validate, label, report, settings, prior)
    run = yield from wait(run, report, None)
    return (yield from fetch(run))


def launch_files(
    telemetry: ServerTelemetry | Sequence[ServerTelemetry],
    sensor: SensorSource | ServerSensor | int | None,
    validate: ServerTelemetry | None,
    label: str,
    report: Report,
    settings: Mapping[str, Any],
    prior: StoredPrior | None = None,
) -> Operation[Run]:
    """Upload what is not there, and launch."""
    stored: list[StoredTelemetry] = []
    for one in _list_several(telemetry):
        if isinstance(one, TelemetrySet | int):
            stored.append(one)
        else:
            stored.append((yield from _uploaded(one, sensor, report)))
    if validate is not None and not isinstance(validate, TelemetrySet | int):
        report("uploading the validation set", None)
        owner = stored[0].sensor_id if isinstance(stored[0], TelemetrySet) else sensor
        if owner is None:
            raise RefusedInputError("A validation set is uploaded for a sensor: name the sensor, or give its file.")
        validate = yield from upload(validate, owner, "validation")
    return (yield from launch(stored, validate, label, settings, prior))


def _uploaded(
    telemetry: TelemetrySource, sensor: SensorSource | ServerSensor | int | None, report: Report
) -> Operation[TelemetrySet]:
    """Store telemetry to calibrate from, with its sensor."""
    if sensor is None:
        raise RefusedInputError("Telemetry is uploaded for a sensor: name the sensor, or give its file.")
    known = yield from find_sensor(sensor)
    report("uploading the telemetry", None)
    return (yield from upload(telemetry, known, "calibration"))


def cancel(run: Run | int, reason: str) -> Operation[Run]:
    """Stop a run."""
    seen = yield _get(f"/runs/{_id(run)}")
    order = _post(f"/runs/{_id(run)}:cancel", {"reason": reason})
    answer = yield replace(order, headers={"If-Match": member(seen.headers, "etag", str)})
    return parse_run(answer.document())


def list_figures(run: Run | int) -> Operation[list[str]]:
    """Name the figures of a run."""
    answer = yield _get(f"/runs/{_id(run)}/figures")
    return [member(one, "name", str) for one in member(answer.document(), "items", list)]


def figure(run: Run | int, name: str) -> Operation[go.Figure]:
    """Read a figure as the pages draw it."""
    answer = yield _get(f"/runs/{_id(run)}/figures/{quote(name, safe='')}")
    document = answer.document()
    import plotly.graph_objects as go

    layout = {key: value for key, value in member(document, "layout", dict).items() if key != "meta"}
    return go.Figure({"data": member(document, "data", list), "layout": layout})


def report_html(run: Run | int) -> Operation[str]:
    """Read the report of a run that has ended."""
    answer = yield _get(f"/runs/{_id(run)}/report")
    member(answer.headers, "content-disposition", str)  # a log-in page is HTML too, but no file
    return answer.content.decode("utf-8")


def make_parameter_set(run: Run | int) -> Operation[ParameterSet]:
    """Make an immutable candidate from a run; for the same run again, return the existing one."""
    answer = yield _post("/parameter-sets", {"run_id": _id(run)})
    return parse_record(ParameterSet, answer.document())


def read_parameter_set(parameter_set: ParameterSet | int | str) -> Operation[ParameterSet]:
    """Read a parameter set, by its number or name, as it stands now."""
    if isinstance(parameter_set, str):
        rows = yield from _list("/parameter-sets")
        for row in rows:
            if row["name"] == parameter_set:
                return parse_record(ParameterSet, row)
        raise errors.NotFoundError(f"The server has no parameter set {parameter_set}: check the name.")
    answer = yield _get(f"/parameter-sets/{_id(parameter_set)}")
    return parse_record(ParameterSet, answer.document())


def assess(parameter_set: ParameterSet | int) -> Operation[GateReport]:
    """Hold a parameter set against its gates."""
    answer = yield _post(f"/parameter-sets/{_id(parameter_set)}:assess")
    from boresight.verdicts.gates import parse_report

    document = answer.document()
    try:
        judged = parse_report(document)
    except RefusedInputError as error:
        raise UnavailableError(f"The server's GateReport is not complete ({error}): {FOREIGN}.") from error
    return parse_record(GateReport, {**document, "gates": judged.gates})


def submit(parameter_set: ParameterSet | int, reason: str) -> Operation[Approval]:
    """Ask that a set become the baseline."""
    seen = yield from _seen(parameter_set)
    answer = yield _post(f"/parameter-sets/{seen.id}:submit", {"reason": reason}, seen.version)
    return parse_record(Approval, answer.document())


def withdraw(parameter_set: ParameterSet | int, reason: str) -> Operation[ParameterSet]:
    """Take the request back."""
    found = yield from read_parameter_set(parameter_set)
    answer = yield _post(f"/parameter-sets/{found.id}:withdraw", {"reason": reason}, found.version)
    return parse_record(ParameterSet, answer.document())


def promote(parameter_set: ParameterSet | int, reason: str) -> Operation[ParameterSet]:
    """Make an approved set the baseline."""
    found = yield from _seen(parameter_set)
    answer = yield _post(f"/parameter-sets/{found.id}:promote", {"reason": reason}, found.version)
    return parse_record(ParameterSet, answer.document())


def _seen(parameter_set: ParameterSet | int) -> Operation[ParameterSet]:
    """Return the version of a parameter set that the caller read; given by number, the current one."""
    if isinstance(parameter_set, int):
        return (yield from read_parameter_set(parameter_set))
    return parameter_set


def read_approval(approval: Approval | int) -> Operation[Approval]:
    """Read a request as it stands now."""
    answer = yield _get(f"/approvals/{_id(approval)}")
    return parse_record(Approval, answer.document())


def export(
    parameter_set: ParameterSet | int, flight_software_version: str | None, table_id: str | None
) -> Operation[bytes]:
    """Build the uplink package of an approved set or the baseline."""
    on_board = {"flight_software_version": flight_software_version, "table_id": table_id}
    answer = yield _post(f"/parameter-sets/{_id(parameter_set)}:export", on_board)
    package = answer.document()
    answer = yield _get(f"/packages/{member(package, 'id', int)}/content")
    if hashlib.sha256(answer.content).hexdigest() != member(package, "sha256", str):
        raise UnavailableError("The package was damaged on the way: export it again.")
    return answer.content
