"""Health, readiness, metrics and the documentation of the API.

Everybody may read whether the server is alive and ready; details are for known actors, and for this machine where the server
listens to nobody else. They have a thread of their own, so that a crowd which waits for an endpoint does not look like a dead
server.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import cache, partial
from typing import Annotated, Any, Literal

from anyio import CapacityLimiter
from anyio.lowlevel import RunVar
from anyio.to_thread import run_sync
from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from boresight.console.access.credentials import current_actor
from boresight.console.access.dependencies import Database, ServerSettings, WorkerControl, Workers, depend_on_server
from boresight.console.operation import json_response
from boresight.console.schemas import Shape
from boresight.errors import BoresightError
from boresight.platform.db.engines import refuse_unwritable_store
from boresight.platform.db.sessions import Engine, current_revision, head_revision
from boresight.platform.web.media import PrometheusText
from boresight.platform.web.metrics import CachedCheck, Metrics
from boresight.platform.web.openapi import refusals
from boresight.platform.web.origins import is_local
from boresight.resources import folder
from boresight.settings import Settings

Draining = Annotated[bool, depend_on_server("draining")]
FilesCheck = Annotated[CachedCheck, depend_on_server("blob_check")]


class Health(Shape):
    """That the process answers."""

    status: Literal["ok"]


class Check(BaseModel):
    """One part of the server."""

    model_config = ConfigDict(extra="allow")
    ready: bool
    detail: str | None = None


class Readiness(Shape):
    """Whether store, files and workers are there."""

    status: Literal["ready", "not ready"]
    checks: dict[str, Check] | None = Field(None, description="Only for callers who are logged in or send a key.")


router = APIRouter(tags=["server"], generate_unique_id_function=lambda route: route.name)


_thread: RunVar[CapacityLimiter] = RunVar("the thread for those who watch the server")


async def _apart(act: Callable[..., Any], *given: Any) -> Any:
    """Run a function in the thread reserved for health checks."""
    try:
        limiter = _thread.get()
    except LookupError:
        limiter = CapacityLimiter(1)
        _thread.set(limiter)
    return await run_sync(act, *given, limiter=limiter)


@router.get("/healthz", name="health", summary="Is the process alive")
async def health() -> Health:
    """Say that the process answers; nothing else is checked."""
    return Health(status="ok")


@router.get(
    "/readyz",
    name="readiness",
    summary="Can it do its work",
    response_model=Readiness,
    responses={503: {"model": Readiness, "description": "Not ready; `checks` says why."}},
)
async def readiness(
    request: Request,
    engine: Database,
    files: FilesCheck,
    settings: ServerSettings,
    workers: Workers,
    draining: Draining,
) -> Response:
    """Say whether store, files and workers are available: 200, or 503 with what is not.

    The store must answer with the right schema, the place of the files must be reached and written, and where workers are
    expected one must have joined since the server began. A server that was told to stop says 503 while it still answers
    everything else: send new requests to another one. `checks` is there for whoever is logged in or sends an API key, and on
    the server's own machine where it listens to nobody else.
    """
    parts: dict[str, Callable[[], dict[str, Any]]] = {
        "store": partial(_store, engine),
        "files": partial(_files, files),
        "workers": partial(_workers, settings, workers),
    }
    checks = {name: await _apart(look) for name, look in parts.items()}
    if draining:
        checks["draining"] = {"ready": False, "detail": "This server is stopping: use another one."}
    ready = all(check["ready"] for check in checks.values())
    body: dict[str, Any] = {"status": "ready" if ready else "not ready"}
    if is_local(request) or await _apart(_is_known, request):
        body["checks"] = checks
    return json_response(body, 200 if ready else 503)


def _is_known(request: Request) -> bool:
    """Whether a request carries valid credentials."""
    try:
        current_actor(request)
    except BoresightError:
        return False
    return True


def _store(engine: Engine) -> dict[str, Any]:
    """Check that the store answers and has the right schema."""
    try:
        found, expected = current_revision(engine), _newest_revision()
        refuse_unwritable_store(engine)
    except (BoresightError, OSError) as error:
        return {"ready": False, "detail": str(error)}
    return {"ready": found == expected, "revision": found, "expected": expected}


@cache
def _newest_revision() -> str | None:
    """Return the newest revision of this version; found once, for it takes longer than the rest of the answer."""
    return head_revision()


def _files(files: CachedCheck) -> dict[str, Any]:
    fault = files.fault()
    return {"ready": False, "detail": fault} if fault else {"ready": True}


def _workers(settings: Settings, workers: WorkerControl | None) -> dict[str, Any]:
    """Check that a worker has joined; a server without workers by its settings needs none.

    It stays ready when its only worker dies: another takes its place, and runs wait meanwhile.
    """
    expected = bool(settings.scheduler) or settings.workers > 0
    state = None if workers is None else workers.state()
    return {
        "ready": not expected or (state is not None and state.connected and state.joined),
        "expected": expected,
        **({} if state is None else asdict(state)),
    }


@router.get(
    "/metrics",
    name="metrics",
    summary="Prometheus metrics",
    response_class=PrometheusText,
    responses=refusals(401, 403),
)
async def metrics(request: Request, counted: Annotated[Metrics, depend_on_server("metrics")]) -> Response:
    """Return the series of this server in the Prometheus exposition format.

    Any API key is accepted, also one without scopes; on the server's own machine none is needed where it listens to nobody else.
    """
    if not is_local(request):
        await _apart(current_actor, request)
    text = await _apart(counted.text)
    return PrometheusText(text)


documentation_router = APIRouter(
    include_in_schema=False
)  # Swagger UI, as a Python package ships it, over our own OpenAPI document


@documentation_router.get("/api/v1/docs")
def api_documentation() -> HTMLResponse:
    """Show every operation, and let who is logged in or has a key try it."""
    return HTMLResponse((folder("frontend") / "templates" / "shared/documentation.html").read_text())
