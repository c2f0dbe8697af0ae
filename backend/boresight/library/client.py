"""A server asked from Python, with and without `async`: `boresight.Client` and `boresight.AsyncClient`.

A request that found no answer, or "not now", is sent again, with pauses; a POST carries an `Idempotency-Key`, so that it has one
effect however often it is sent. What a server refuses is raised as the exception that the library would raise, with the server's
sentence. Keys read and launch, but do not sign: an approval is a person's, with their password, on the pages.
"""

from __future__ import annotations

import asyncio
import random
import ssl
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, Unpack

import httpx

from boresight import __version__
from boresight.errors import BoresightError, RefusedInputError, UnavailableError
from boresight.library import remote
from boresight.library.progress import Wanted, reporting
from boresight.library.remote import (
    PAUSED,
    Approval,
    GateReport,
    Operation,
    ParameterSet,
    Pause,
    Request,
    Run,
    ServerAnswer,
    ServerSensor,
    StoredPrior,
    StoredTelemetry,
    T,
    TelemetrySet,
    raise_problem,
)

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from boresight.library.choice import Choice
    from boresight.library.diagnosis import Diagnosis
    from boresight.library.inputs import SensorSource, TelemetrySource
    from boresight.library.keywords import CalibrationKeywords
    from boresight.library.pointings import PointingPlan
    from boresight.library.remote import ServerTelemetry
    from boresight.library.results import Calibration

Purpose = Literal["calibration", "validation"]
#: How often a request is sent in all, and the first and longest pause before it is sent again.
ATTEMPTS, FIRST_PAUSE_S, LONGEST_PAUSE_S = 5, 0.2, 10.0
#: A server, or what stands before it, cannot answer now.
NOT_NOW = (429, 502, 503, 504)
TIMEOUT = httpx.Timeout(60.0, connect=10.0)
#: A file is answered when the server has read and checked it, a diagnosis when it has searched, which may take minutes.
SLOW_TIMEOUT = httpx.Timeout(60.0, connect=10.0, read=900.0)
#: What ends a request without an answer that can be read.
NO_ANSWER = (httpx.TransportError, httpx.DecodingError)
CLOSED = "This client is closed: open a new one."
Silence = httpx.TransportError | httpx.DecodingError


class _Connection:
    """Address and key of a server, and the code shared by both clients."""

    def __init__(self, url: str, key: str | None) -> None:
        self.url = _checked_address(url)
        self._key = _checked_key(key)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url!r})"

    @property
    def _settings(self) -> dict[str, Any]:
        """Return the arguments of both kinds of HTTP client."""
        headers = {"User-Agent": f"boresight/{__version__}"}
        if self._key:
            headers["Authorization"] = f"Bearer {self._key}"
        return {"base_url": f"{self.url}{remote.PREFIX}", "headers": headers, "timeout": TIMEOUT}

    def _arguments(self, request: Request, opened: ExitStack) -> dict[str, Any]:
        """Return a request as arguments of the HTTP client; its files stay open as long as `opened`."""
        headers = dict(request.headers) | ({"Idempotency-Key": request.key} if request.key else {})
        arguments: dict[str, Any] = {"params": dict(request.params), "headers": headers}
        if request.file is not None:
            name, content = request.file
            stream = opened.enter_context(content.open("rb")) if isinstance(content, Path) else content
            arguments |= {"data": dict(request.form or {}), "files": {"file": (name, stream)}}
        elif request.method == "POST":
            arguments["json"] = request.body
        return arguments | ({"timeout": SLOW_TIMEOUT} if request.slow else {})

    def _judge(self, response: httpx.Response) -> ServerAnswer:
        """Return an answer, or raise the exception of a refusal."""
        answer = ServerAnswer(status=response.status_code, headers=response.headers, content=response.content)
        raise_problem(answer, self.url)
        return answer

    def _pause_before_again(self, attempt: int, outcome: httpx.Response | Silence) -> float | None:
        """Return how long to wait before a request is sent again; None where it is not."""
        if isinstance(outcome, httpx.Response) and outcome.status_code not in NOT_NOW:
            return None
        if _refused_certificate(outcome):
            return None
        if attempt + 1 >= ATTEMPTS:
            return None
        asked = outcome.headers.get("retry-after", "") if isinstance(outcome, httpx.Response) else ""
        pause = min(FIRST_PAUSE_S * 2.0**attempt, LONGEST_PAUSE_S) * random.uniform(0.5, 1.0)  # noqa: S311 - no secret
        return max(pause, min(float(asked), LONGEST_PAUSE_S)) if asked.isdecimal() else pause

    def _refuse_silence(self, error: Silence) -> UnavailableError:
        if certificate := _refused_certificate(error):
            return UnavailableError(
                f"{self.url} has a certificate that cannot be verified ({certificate.verify_message}): check the address; "
                "if your own certificate authority signed it, name its file in SSL_CERT_FILE."
            )
        return UnavailableError(
            f"{self.url} does not answer ({error or type(error).__name__}): check the address, or try again."
        )


def _checked_address(url: object) -> str:
    """Return the address of a server without a slash at its end."""
    if not isinstance(url, str):
        raise RefusedInputError(
            f"{type(url).__name__} is not the address of a server: give a text such as https://boresight.example."
        )
    try:
        parts = httpx.URL(url)
        parts.raw_host.decode("ascii").encode("idna")  # as the network looks it up
    except (httpx.InvalidURL, UnicodeError):
        parts = httpx.URL()
    if parts.scheme not in {"http", "https"} or not parts.host or parts.query or parts.fragment:
        raise RefusedInputError(f"{url!r} is not the address of a server: give one such as https://boresight.example.")
    if parts.userinfo:
        raise RefusedInputError("The address of a server must not contain a password: give an API key.")
    return url.rstrip("/")


def _checked_key(key: object) -> str | None:
    """Return a key without the blanks about it; what can be none is refused, and never shown."""
    if key is not None and not isinstance(key, str):
        raise RefusedInputError(f"{type(key).__name__} is not an API key: give the text that the server showed once.")
    key = key.strip() if key else None
    if key and not (key.isascii() and key.isprintable()):
        raise RefusedInputError("The API key contains characters that no key has: copy it again from the server.")
    return key


def _refused_certificate(outcome: object) -> ssl.SSLCertVerificationError | None:
    """Return why a server's certificate was refused, if that is how a request ended."""
    while isinstance(outcome, BaseException) and not isinstance(outcome, ssl.SSLCertVerificationError):
        outcome = outcome.__cause__ or outcome.__context__
    return outcome if isinstance(outcome, ssl.SSLCertVerificationError) else None


class Client(_Connection):
    """A server.

    Parameters
    ----------
    url
        Its address, as https://boresight.example.
    key
        An API key of a person there; without one a server says nothing but that it is there.
    """

    def __init__(self, url: str, key: str | None = None) -> None:
        super().__init__(url, key)
        self._http = httpx.Client(**self._settings)

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def sensors(self) -> list[ServerSensor]:
        """Read the fleet."""
        return self._run(remote.list_sensors())

    def sensor(self, sensor: SensorSource | ServerSensor | int) -> ServerSensor:
        """Return the server's sensor of this number, name or file; one that it does not have is registered."""
        return self._run(remote.find_sensor(sensor))

    def upload(
        self, telemetry: TelemetrySource, sensor: SensorSource | ServerSensor | int, purpose: Purpose = "calibration"
    ) -> TelemetrySet:
        """Store telemetry, a file as it is or a table as Parquet; the same again is the set that is there."""
        return self._run(remote.upload(telemetry, sensor, purpose))

    def launch(
        self,
        telemetry: StoredTelemetry | Sequence[StoredTelemetry],
        *,
        validate: StoredTelemetry | None = None,
        prior: StoredPrior | None = None,
        label: str = "",
        **settings: Unpack[CalibrationKeywords],
    ) -> Run:
        """Queue a calibration of one set, or of several as one; settings as `boresight.calibrate` has them.

        It starts from `prior` with its covariance: a parameter set or its name, or a run or its number.
        """
        return self._run(remote.launch(telemetry, validate, label, settings, prior))

    def run(self, run: Run | int) -> Run:
        """Read the progress of a run."""
        return self._run(remote.read_run(run))

    def fetch(self, run: Run | int) -> Calibration:
        """Read a run's calibration, a partial one while it computes."""
        return self._run(remote.fetch(run))

    def choice(self, run: Run | int) -> Choice:
        """Read the camera that was chosen for a run's data."""
        return self._run(remote.fetch_choice(run))

    def cancel(self, run: Run | int, reason: str = "") -> Run:
        """Stop a run."""
        return self._run(remote.cancel(run, reason))

    def figures(self, run: Run | int) -> list[str]:
        """Name the figures of a run."""
        return self._run(remote.list_figures(run))

    def figure(self, run: Run | int, name: str) -> go.Figure:
        """Read a figure as the server's pages draw it, for Plotly."""
        return self._run(remote.figure(run, name))

    def report(self, run: Run | int) -> str:
        """Read the report of a run that has ended, HTML that stands alone."""
        return self._run(remote.report_html(run))

    def make_parameter_set(self, run: Run | int) -> ParameterSet:
        """Make an immutable candidate from a run; for the same run again, return the existing one."""
        return self._run(remote.make_parameter_set(run))

    def parameter_set(self, parameter_set: ParameterSet | int | str) -> ParameterSet:
        """Read a parameter set, by its number or name, as it stands now."""
        return self._run(remote.read_parameter_set(parameter_set))

    def assess(self, parameter_set: ParameterSet | int) -> GateReport:
        """Hold a parameter set against its sensor's gates."""
        return self._run(remote.assess(parameter_set))

    def submit(self, parameter_set: ParameterSet | int, reason: str) -> Approval:
        """Ask that a parameter set become the baseline; people sign the request, in person."""
        return self._run(remote.submit(parameter_set, reason))

    def approval(self, approval: Approval | int) -> Approval:
        """Read a request for approval as it stands now."""
        return self._run(remote.read_approval(approval))

    def withdraw(self, parameter_set: ParameterSet | int, reason: str = "") -> ParameterSet:
        """Take the request for a set back."""
        return self._run(remote.withdraw(parameter_set, reason))

    def promote(self, parameter_set: ParameterSet | int, reason: str = "") -> ParameterSet:
        """Make an approved set the baseline."""
        return self._run(remote.promote(parameter_set, reason))

    def export(
        self,
        parameter_set: ParameterSet | int,
        *,
        flight_software_version: str | None = None,
        table_id: str | None = None,
    ) -> bytes:
        """Build the uplink package of an approved set or the baseline, and read its bytes.

        What the spacecraft has may be said: the package is refused for anything else.
        """
        return self._run(remote.export(parameter_set, flight_software_version, table_id))

    def wait(self, run: Run | int, *, progress: Wanted = None, timeout_s: float | None = None) -> Run:
        """Follow a run to its end; one that fails is an exception with its reason."""
        with reporting(progress, "waiting for the run") as report:
            return self._run(remote.wait(run, report, timeout_s))

    def calibrate(
        self,
        telemetry: ServerTelemetry | Sequence[ServerTelemetry],
        sensor: SensorSource | ServerSensor | int | None = None,
        *,
        validate: ServerTelemetry | None = None,
        prior: StoredPrior | None = None,
        label: str = "",
        progress: Wanted = None,
        **settings: Unpack[CalibrationKeywords],
    ) -> Calibration:
        """Calibrate on the server: upload what is not there, launch, wait, fetch. Arguments as `boresight.calibrate`.

        `telemetry` and `validate` may be sets of the server too, `sensor` the name or number of one of its sensors, and `prior`
        is one of its parameter sets or runs.
        """
        with reporting(progress, "contacting the server") as report:
            return self._run(remote.calibrate(telemetry, sensor, validate, label, report, settings, prior))

    def choose(
        self,
        telemetry: TelemetrySource | TelemetrySet | Run | int,
        sensor: SensorSource | ServerSensor | int | None = None,
        *,
        validate: TelemetrySource | TelemetrySet | int | None = None,
        label: str = "",
        progress: Wanted = None,
        **settings: Unpack[CalibrationKeywords],
    ) -> Choice:
        """Choose the least camera model for the data of a run that has ended, or its number; the server's workers compute.

        Telemetry is calibrated first, with the other arguments as `calibrate`; the same run asked again has the same choice.
        """
        with reporting(progress, "contacting the server") as report:
            return self._run(remote.choose(telemetry, sensor, validate, label, report, settings))

    def diagnose(
        self,
        telemetry: TelemetrySource | TelemetrySet | int,
        sensor: SensorSource | ServerSensor | int | None = None,
        *,
        progress: Wanted = None,
    ) -> Diagnosis:
        """Find why a set of the server, or telemetry that is uploaded, does not match its sensor; as `boresight.diagnose`.

        The set keeps the answer in its quality report.
        """
        with reporting(progress, "contacting the server") as report:
            return self._run(remote.diagnose(telemetry, sensor, report))

    def plan(
        self,
        sensor: SensorSource | ServerSensor | int,
        start: str,
        minutes: float,
        *,
        calibration: StoredPrior | None = None,
        candidates: str | PathLike[str] | None = None,
        criterion: str = "A",
        orbit: Mapping[str, float] | None = None,
        **constraints: float,
    ) -> PointingPlan:
        """Plan what one of the server's sensors is to observe next; as `boresight.plan`, nothing is stored.

        `calibration`: what is known before, a parameter set or its name, or a run or its number.
        """
        return self._run(remote.plan(sensor, start, minutes, calibration, candidates, criterion, orbit, constraints))

    def _run(self, operation: Operation[T]) -> T:
        """Do what an operation asks until it has its answer."""
        try:
            asked = next(operation)
            while True:
                try:
                    answer = self._do(asked)
                except (BoresightError, KeyboardInterrupt) as error:  # it knows what goes on at the server
                    asked = operation.throw(error)
                else:
                    asked = operation.send(answer)
        except StopIteration as ended:
            result: T = ended.value
            return result

    def _do(self, asked: Request | Pause) -> ServerAnswer:
        """Wait, or send a request."""
        if not isinstance(asked, Pause):
            return self._ask(asked)
        time.sleep(asked.seconds)
        return PAUSED

    def _ask(self, request: Request) -> ServerAnswer:
        """Send a request, again where that may help."""
        if self._http.is_closed:
            raise RefusedInputError(CLOSED)
        attempt = 0
        while True:
            outcome: httpx.Response | Silence
            try:
                with ExitStack() as opened:
                    outcome = self._http.request(request.method, request.path, **self._arguments(request, opened))
            except NO_ANSWER as error:
                outcome = error
            pause = self._pause_before_again(attempt, outcome)
            if pause is None:
                break
            time.sleep(pause)
            attempt += 1
        if not isinstance(outcome, httpx.Response):
            raise self._refuse_silence(outcome) from outcome
        return self._judge(outcome)


class AsyncClient(_Connection):
    """A server, asked with `async`; arguments and methods as `Client`."""

    def __init__(self, url: str, key: str | None = None) -> None:
        super().__init__(url, key)
        self._http = httpx.AsyncClient(**self._settings)

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def sensors(self) -> list[ServerSensor]:
        """Read the fleet."""
        return await self._run(remote.list_sensors())

    async def sensor(self, sensor: SensorSource | ServerSensor | int) -> ServerSensor:
        """Return the server's sensor of this number, name or file; one that it does not have is registered."""
        return await self._run(remote.find_sensor(sensor))

    async def upload(
        self, telemetry: TelemetrySource, sensor: SensorSource | ServerSensor | int, purpose: Purpose = "calibration"
    ) -> TelemetrySet:
        """Store telemetry, a file as it is or a table as Parquet; the same again is the set that is there."""
        return await self._run(remote.upload(telemetry, sensor, purpose))

    async def launch(
        self,
        telemetry: StoredTelemetry | Sequence[StoredTelemetry],
        *,
        validate: StoredTelemetry | None = None,
        prior: StoredPrior | None = None,
        label: str = "",
        **settings: Unpack[CalibrationKeywords],
    ) -> Run:
        """Queue a calibration of one set, or of several as one; settings as `boresight.calibrate` has them.

        It starts from `prior` with its covariance: a parameter set or its name, or a run or its number.
        """
        return await self._run(remote.launch(telemetry, validate, label, settings, prior))

    async def run(self, run: Run | int) -> Run:
        """Read the progress of a run."""
        return await self._run(remote.read_run(run))

    async def fetch(self, run: Run | int) -> Calibration:
        """Read a run's calibration, a partial one while it computes."""
        return await self._run(remote.fetch(run))

    async def choice(self, run: Run | int) -> Choice:
        """Read the camera that was chosen for a run's data."""
        return await self._run(remote.fetch_choice(run))

    async def cancel(self, run: Run | int, reason: str = "") -> Run:
        """Stop a run."""
        return await self._run(remote.cancel(run, reason))

    async def figures(self, run: Run | int) -> list[str]:
        """Name the figures of a run."""
        return await self._run(remote.list_figures(run))

    async def figure(self, run: Run | int, name: str) -> go.Figure:
        """Read a figure as the server's pages draw it, for Plotly."""
        return await self._run(remote.figure(run, name))

    async def report(self, run: Run | int) -> str:
        """Read the report of a run that has ended, HTML that stands alone."""
        return await self._run(remote.report_html(run))

    async def make_parameter_set(self, run: Run | int) -> ParameterSet:
        """Make an immutable candidate from a run; for the same run again, return the existing one."""
        return await self._run(remote.make_parameter_set(run))

    async def parameter_set(self, parameter_set: ParameterSet | int | str) -> ParameterSet:
        """Read a parameter set, by its number or name, as it stands now."""
        return await self._run(remote.read_parameter_set(parameter_set))

    async def assess(self, parameter_set: ParameterSet | int) -> GateReport:
        """Hold a parameter set against its sensor's gates."""
        return await self._run(remote.assess(parameter_set))

    async def submit(self, parameter_set: ParameterSet | int, reason: str) -> Approval:
        """Ask that a parameter set become the baseline; people sign the request, in person."""
        return await self._run(remote.submit(parameter_set, reason))

    async def approval(self, approval: Approval | int) -> Approval:
        """Read a request for approval as it stands now."""
        return await self._run(remote.read_approval(approval))

    async def withdraw(self, parameter_set: ParameterSet | int, reason: str = "") -> ParameterSet:
        """Take the request for a set back."""
        return await self._run(remote.withdraw(parameter_set, reason))

    async def promote(self, parameter_set: ParameterSet | int, reason: str = "") -> ParameterSet:
        """Make an approved set the baseline."""
        return await self._run(remote.promote(parameter_set, reason))

    async def export(
        self,
        parameter_set: ParameterSet | int,
        *,
        flight_software_version: str | None = None,
        table_id: str | None = None,
    ) -> bytes:
        """Build the uplink package of an approved set or the baseline, and read its bytes.

        What the spacecraft has may be said: the package is refused for anything else.
        """
        return await self._run(remote.export(parameter_set, flight_software_version, table_id))

    async def wait(self, run: Run | int, *, progress: Wanted = None, timeout_s: float | None = None) -> Run:
        """Follow a run to its end; one that fails is an exception with its reason."""
        with reporting(progress, "waiting for the run") as report:
            return await self._run(remote.wait(run, report, timeout_s))

    async def calibrate(
        self,
        telemetry: ServerTelemetry | Sequence[ServerTelemetry],
        sensor: SensorSource | ServerSensor | int | None = None,
        *,
        validate: ServerTelemetry | None = None,
        prior: StoredPrior | None = None,
        label: str = "",
        progress: Wanted = None,
        **settings: Unpack[CalibrationKeywords],
    ) -> Calibration:
        """Calibrate on the server: upload what is not there, launch, wait, fetch. Arguments as `boresight.calibrate`.

        `telemetry` and `validate` may be sets of the server too, `sensor` the name or number of one of its sensors, and `prior`
        is one of its parameter sets or runs.
        """
        with reporting(progress, "contacting the server") as report:
            return await self._run(remote.calibrate(telemetry, sensor, validate, label, report, settings, prior))

    async def choose(
        self,
        telemetry: TelemetrySource | TelemetrySet | Run | int,
        sensor: SensorSource | ServerSensor | int | None = None,
        *,
        validate: TelemetrySource | TelemetrySet | int | None = None,
        label: str = "",
        progress: Wanted = None,
        **settings: Unpack[CalibrationKeywords],
    ) -> Choice:
        """Choose the least camera model for the data of a run that has ended, or its number; the server's workers compute.

        Telemetry is calibrated first, with the other arguments as `calibrate`; the same run asked again has the same choice.
        """
        with reporting(progress, "contacting the server") as report:
            return await self._run(remote.choose(telemetry, sensor, validate, label, report, settings))

    async def diagnose(
        self,
        telemetry: TelemetrySource | TelemetrySet | int,
        sensor: SensorSource | ServerSensor | int | None = None,
        *,
        progress: Wanted = None,
    ) -> Diagnosis:
        """Find why a set of the server, or telemetry that is uploaded, does not match its sensor; as `boresight.diagnose`.

        The set keeps the answer in its quality report.
        """
        with reporting(progress, "contacting the server") as report:
            return await self._run(remote.diagnose(telemetry, sensor, report))

    async def plan(
        self,
        sensor: SensorSource | ServerSensor | int,
        start: str,
        minutes: float,
        *,
        calibration: StoredPrior | None = None,
        candidates: str | PathLike[str] | None = None,
        criterion: str = "A",
        orbit: Mapping[str, float] | None = None,
        **constraints: float,
    ) -> PointingPlan:
        """Plan what one of the server's sensors is to observe next; as `boresight.plan`, nothing is stored.

        `calibration`: what is known before, a parameter set or its name, or a run or its number.
        """
        return await self._run(
            remote.plan(sensor, start, minutes, calibration, candidates, criterion, orbit, constraints)
        )

    async def _run(self, operation: Operation[T]) -> T:
        """Do what an operation asks until it has its answer."""
        try:
            asked = next(operation)
            while True:
                try:
                    answer = await self._do(asked)
                except (BoresightError, KeyboardInterrupt) as error:  # it knows what goes on at the server
                    asked = operation.throw(error)
                else:
                    asked = operation.send(answer)
        except StopIteration as ended:
            result: T = ended.value
            return result

    async def _do(self, asked: Request | Pause) -> ServerAnswer:
        """Wait, or send a request."""
        if not isinstance(asked, Pause):
            return await self._ask(asked)
        await asyncio.sleep(asked.seconds)
        return PAUSED

    async def _ask(self, request: Request) -> ServerAnswer:
        """Send a request, again where that may help."""
        if self._http.is_closed:
            raise RefusedInputError(CLOSED)
        attempt = 0
        while True:
            outcome: httpx.Response | Silence
            try:
                with ExitStack() as opened:
                    outcome = await self._http.request(request.method, request.path, **self._arguments(request, opened))
            except NO_ANSWER as error:
                outcome = error
            pause = self._pause_before_again(attempt, outcome)
            if pause is None:
                break
            await asyncio.sleep(pause)
            attempt += 1
        if not isinstance(outcome, httpx.Response):
            raise self._refuse_silence(outcome) from outcome
        return self._judge(outcome)
