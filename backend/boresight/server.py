"""The composition root: settings in, a server out. The only place where the parts of Boresight meet."""

from __future__ import annotations

import asyncio
import gc
import logging
import socket
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from functools import cache
from typing import Any

import uvicorn
from anyio.to_thread import current_default_thread_limiter
from fastapi import APIRouter, FastAPI
from fastapi.exceptions import RequestValidationError
from fastapi.telemetry import TelemetryConfig
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import Response
from uvicorn.config import LOGGING_CONFIG

import boresight
from boresight.console import pages
from boresight.console import routes as api_routes
from boresight.console.access.credentials import Authentication, CredentialCache, LogInCookie, authenticate
from boresight.console.access.openid_connect import IdentityProvider, read_provider_settings
from boresight.console.access.password_checks import PasswordWorker
from boresight.console.access.second_factors import FactorRules
from boresight.console.administration.fleet_metrics import FleetMetrics, ServerParts
from boresight.console.jobs.alignment_thread import AlignmentThread
from boresight.console.jobs.anchoring import Anchoring
from boresight.console.jobs.backup_thread import BackupThread
from boresight.console.jobs.broadcast import Broadcast
from boresight.console.jobs.heartbeat import Heartbeat
from boresight.console.jobs.ingest_watcher import IngestWatcher
from boresight.console.jobs.maintenance import ExternalHeadFile, Maintenance
from boresight.console.jobs.message_sender import MessageSender
from boresight.console.jobs.mission_control import MissionControl
from boresight.console.jobs.retention_thread import RetentionThread
from boresight.console.jobs.webhook_sender import WebhookSender
from boresight.console.messages.service import Outlets
from boresight.console.pages.frame import FleetStatusCache
from boresight.console.pages.rendering import bare_problem_page, is_page, problem_page
from boresight.console.webhooks.secrets import encrypt_all
from boresight.disks import storage_error
from boresight.errors import BoresightError, StorageError
from boresight.platform.audit.security_log import SecurityLog, tell
from boresight.platform.blobs import files
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.db.data_version import DataVersionPoller, DataVersionReader, VersionedCache
from boresight.platform.db.sessions import migrate, open_engine, open_reading
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.observability import logs
from boresight.platform.observability.traces import get_traces
from boresight.platform.web import static_files
from boresight.platform.web.concurrency_limit import ConcurrencyLimit, ConcurrencyLimits
from boresight.platform.web.connections import Connections, open_file_limit
from boresight.platform.web.figure_cache import FigureCache
from boresight.platform.web.lazy_route import LazyRoute
from boresight.platform.web.metrics import CachedCheck, Metrics
from boresight.platform.web.middleware import (
    AcceptEncodingMiddleware,
    HeadMiddleware,
    RequestMiddleware,
    answer_options,
    with_allow,
)
from boresight.platform.web.openapi import DESCRIPTION, TAGS, corrected
from boresight.platform.web.origins import OriginCheck
from boresight.platform.web.problems import make_problem, problem_response
from boresight.platform.web.request_bodies import BodyRate, RequestValidation
from boresight.platform.web.response_cache import (
    COMPRESS_FROM_BYTES,
    COMPRESSION_LEVEL,
    CacheLookupMiddleware,
    CacheStoreMiddleware,
    ResponseCache,
)
from boresight.settings import Settings
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.workers.dispatcher import RunDispatcher

log = logging.getLogger(__name__)

ENDS_WITHIN_S = 10  # requests under way when the listener is closed
DRAIN_TURN_S = 0.1
#: Every route. What each wants of a request is worked out when it is first needed: once a process, however many
#: servers it makes; so a server's `dependency_overrides` change nothing.
ROUTES = APIRouter(generate_unique_id_function=lambda route: route.name)
api_routes.include_routes(ROUTES)
ROUTES.routes.extend(static_files.router.routes)
pages.include_pages(ROUTES)
SWITCH_S = (
    0.001  # after so long a thread that computes lets another go on; the event loop waits for that with each answer
)
COLLECTIONS = (20_000, 20, 50)  # an answer makes thousands of objects, nearly all of which are let go one by one
BUILDING_REST_S = 0.001  # between two routes that are built in advance: a first request waits for one, not for all
THREADS = (
    12  # of requests: those whose turn it is, and those that take long (`boresight.platform.web.concurrency_limit`)
)


#: The framework looks for OpenTelemetry in every request: a tenth of what an answer from the cache takes. Ours is `/metrics`.
NO_TELEMETRY: TelemetryConfig = {"tracing": False, "metrics": False, "logs": False}


def create_app(settings: Settings, *, limits: ConcurrencyLimits | None = None, pace: BodyRate | None = None) -> FastAPI:
    """Build the server of these settings; nothing runs before its lifespan begins."""
    app = FastAPI(
        title="Boresight",
        version=boresight.__version__,
        description=DESCRIPTION,
        openapi_tags=TAGS,
        openapi_url="/api/v1/openapi.json",
        docs_url=None,
        redoc_url=None,
        lifespan=_lifespan,
        routes=ROUTES.routes,
        telemetry=NO_TELEMETRY,
    )
    described = app.openapi

    def describe() -> dict[str, Any]:
        _build_routes(app)  # whole, also those that another thread is building
        return corrected(described(), app.state.log_in_cookie.name)

    app.openapi = describe  # type: ignore[method-assign]  # the framework's own way to extend it
    _furnish(app, settings)
    for kind in (BoresightError, RequestValidationError, HTTPException):
        app.add_exception_handler(kind, _refuse)
    app.add_exception_handler(OSError, _refuse_disk)
    app.add_middleware(RequestValidation, refuse=_refuse)  # what is added later is further out
    app.add_middleware(CacheStoreMiddleware, cache=app.state.response_cache)
    app.add_middleware(GZipMiddleware, minimum_size=COMPRESS_FROM_BYTES, compresslevel=COMPRESSION_LEVEL)
    app.add_middleware(ConcurrencyLimit, refuse=_turn_away, begin=app.state.response_cache.begin, limits=limits)
    app.add_middleware(CacheLookupMiddleware, cache=app.state.response_cache)
    app.add_middleware(Authentication, refuse=_turn_away)
    app.add_middleware(HeadMiddleware)
    app.add_middleware(AcceptEncodingMiddleware)
    app.add_middleware(OriginCheck, refuse=_turn_away, public_url=settings.public_url)
    limit_mb = settings.upload_limit_mb
    app.add_middleware(
        RequestMiddleware,
        observe=app.state.metrics.observe,
        refuse=_refuse,
        upload_limit_mb=limit_mb,
        four_eyes=lambda: app.state.policy.four_eyes,
        pace=pace,
        https_only=bool(settings.secure_cookies),
        traces=app.state.traces,
        security_log=app.state.security_log,
    )
    return app


def _furnish(app: FastAPI, settings: Settings) -> None:
    settings.data_folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    state = app.state
    state.settings = settings
    state.security_log = SecurityLog(settings.security_log)
    state.policy = settings.policy
    state.traces = get_traces(settings.otlp_endpoint, "boresight")
    state.engine = open_engine(settings.database_url)
    state.blobs = open_blobs(settings.blob_location)
    if settings.blob_location.is_folder:
        with suppress(StorageError):  # `readyz` says so, and the first use tries again
            state.blobs.open()
    state.blob_check = CachedCheck(state.blobs.refuse_unusable)
    state.figure_cache = FigureCache()
    state.log_in_cookie = LogInCookie(settings)
    state.catalogue = _lazy_catalogue(settings)
    state.forecast_sources = ForecastSources(state.blobs, lambda: state.catalogue(), settings.catalogue_folder)  # noqa: PLW0108 - as it is when asked
    state.broadcast = Broadcast(state.engine)
    state.heartbeat = Heartbeat(state.engine, state.broadcast.nudge, settings.data_folder / "last-seen")
    external_head = ExternalHeadFile(settings.kept_head_file, 60.0 * settings.audit_head_minutes)
    state.own_key = settings.own_key
    state.anchoring = Anchoring(state.engine, state.own_key, settings.time_stamps, 60.0 * settings.anchor_minutes)
    state.maintenance = Maintenance(state.engine, settings.session_limits, state.blobs, external_head, state.anchoring)
    state.secret_box = settings.secret_box
    state.factor_rules = FactorRules(settings.second_factor, state.secret_box)
    state.passwords = PasswordWorker(state.engine, settings.login_attempts, state.factor_rules)
    state.identity_provider = IdentityProvider(read_provider_settings(settings)) if settings.oidc_issuer else None
    state.blobs.tell_corrupt = state.maintenance.suspect
    state.blobs.find_removed = lambda sha256: _find_removed(app, sha256)
    state.webhook_sender = WebhookSender(state.engine, settings.targets, state.secret_box)
    state.message_sender = MessageSender(
        state.engine, settings.targets, state.secret_box, _outlets(settings), lambda: state.policy
    )
    data_versions = DataVersionReader(state.engine)
    state.data_version_poller, state.fleet_status = (
        DataVersionPoller(data_versions),
        FleetStatusCache(state.engine, data_versions),
    )
    state.credential_cache, state.overview = CredentialCache(data_versions), VersionedCache[object](data_versions)
    state.rendered = OrderedDict()
    state.draining = False
    state.response_cache = ResponseCache(state.data_version_poller, authenticate, lambda: _beside(app))
    state.workers = None
    state.ingest_watcher = IngestWatcher(state.engine, state.forecast_sources, settings, lambda: _tell(app))
    state.mission_control = MissionControl(state.engine, state.forecast_sources, settings, lambda: _tell(app))
    state.alignment_thread = AlignmentThread(state.engine, state.forecast_sources, lambda: _tell(app))
    state.backup_thread = BackupThread(state.engine, state.blobs, settings, lambda: _tell(app))
    state.retention_thread = RetentionThread(
        state.engine, state.blobs, settings.telemetry_keep_days, lambda: _tell(app)
    )
    parts = ServerParts(lambda: state.workers.state() if state.workers else None, lambda: state.maintenance.broken)
    state.metrics = Metrics(lambda: state.broadcast.listeners, [FleetMetrics(state.engine, parts)])


def _outlets(settings: Settings) -> Outlets:
    """Return what messages to people may go by, and where the pages are that they lead to."""
    return Outlets(settings.message_services, settings.mail_server, settings.page_root, settings.mode)


def _beside(app: FastAPI) -> tuple[object, ...]:
    """Return what pages show besides the store: whether two are asked for, the light of the audit log, how the workers are."""
    workers = app.state.workers
    return (app.state.policy.four_eyes, app.state.maintenance.light(), workers.state() if workers else None)


def _tell(app: FastAPI) -> None:
    """Wake what follows the store after a service wrote to it."""
    app.state.broadcast.nudge()
    app.state.webhook_sender.nudge()
    app.state.message_sender.nudge()
    if app.state.workers is not None:
        app.state.workers.notify()


def _find_removed(app: FastAPI, sha256: str) -> str | None:
    with open_reading(app.state.engine) as session:
        return files.find_removed(session, sha256)


def _lazy_catalogue(settings: Settings) -> Callable[[], Catalogue]:
    """Return a function that loads the star catalogue once, whoever asks first."""
    lock = threading.Lock()

    @cache
    def load() -> Catalogue:
        return load_catalogue(settings.catalogue_folder)

    def catalogue() -> Catalogue:
        with lock:
            return load()

    return catalogue


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Open the parts in order, and close them in reverse."""
    state = app.state
    current_default_thread_limiter().total_tokens = THREADS
    await run_in_threadpool(migrate, state.engine)
    await run_in_threadpool(_encrypt_secrets, app)
    state.write_lock = asyncio.Lock()
    state.broadcast.start()
    state.heartbeat.start()
    with state.security_log.following():
        state.maintenance.start()
    state.passwords.start()
    state.webhook_sender.start()
    state.message_sender.start()
    state.workers = RunDispatcher(
        state.engine,
        state.settings,
        state.broadcast.hear,
        suspect=state.maintenance.suspect,
        observe=state.metrics.observe_run,
    )
    state.workers.start()
    state.ingest_watcher.start()
    state.mission_control.start()
    state.alignment_thread.start()
    state.backup_thread.start()
    state.retention_thread.start()
    threading.Thread(target=_warm, args=(app,), name="boresight-warm", daemon=True).start()
    with state.security_log.following():
        tell(
            "sys_startup", "success", version=boresight.__version__, host=state.settings.host, port=state.settings.port
        )
        for weak in state.settings.list_weaknesses():
            tell("sys_weak_setting", "success", setting=weak.variable, value=weak.value, why=weak.why)
    try:
        yield
    finally:
        await run_in_threadpool(state.retention_thread.close)
        await run_in_threadpool(state.backup_thread.close)
        await run_in_threadpool(state.alignment_thread.close)
        await run_in_threadpool(state.mission_control.close)
        await run_in_threadpool(state.ingest_watcher.close)
        await run_in_threadpool(state.workers.stop)
        await run_in_threadpool(state.message_sender.close)
        await run_in_threadpool(state.webhook_sender.close)
        await run_in_threadpool(state.heartbeat.close)
        await run_in_threadpool(state.passwords.close)
        await run_in_threadpool(state.maintenance.close)
        await run_in_threadpool(state.broadcast.close)
        await run_in_threadpool(state.traces.close)
        state.data_version_poller.close()
        state.engine.dispose()
        with state.security_log.following():
            tell("sys_shutdown", "success")
        state.security_log.close()


def _encrypt_secrets(app: FastAPI) -> None:
    """Encrypt what an older version stored plain, and say which webhooks cannot be told anything from here."""
    try:
        encryption = encrypt_all(app.state.engine, app.state.secret_box)
    except (BoresightError, OSError) as error:
        log.error("Webhooks receive no events: %s", error)  # noqa: TRY400 - the sentence says it all
        return
    if encryption.sentence is not None:
        log.warning("%s", encryption.sentence)


def _build_routes(app: FastAPI, rest_s: float = 0.0) -> None:
    for route in app.routes:
        if isinstance(route, LazyRoute):
            route.prepare()
            time.sleep(rest_s)


def _warm(app: FastAPI) -> None:
    """Build the routes before somebody asks for them, and load the catalogue before the first upload."""
    try:
        _build_routes(app, BUILDING_REST_S)
    except Exception:
        log.exception("A route could not be built; the first request for it will try again")
    try:
        app.state.catalogue()
    except Exception:
        log.exception("The star catalogue could not be loaded; the first upload will try again")


def _turn_away(request: Request, error: Exception) -> Response:
    """Answer who is not let in, without a thread and without the store."""
    if is_page(request):
        return bare_problem_page(request, error)
    return problem_response(request, make_problem(error))


async def _refuse_disk(request: Request, error: Exception) -> Response:
    """Answer a disk that is full or cannot be written; every other system error is a defect, and goes on as one."""
    if not isinstance(error, OSError) or (of_disk := storage_error(error)) is None:
        raise error
    log.error("Request %s: %s", request.state.request_id, of_disk)
    return await _refuse(request, of_disk)


async def _refuse(request: Request, error: Exception) -> Response:
    """Answer an error: as a page to people, as a problem to programs and where no page can be made."""
    options = answer_options(request, error)
    if options is not None:
        return options
    error = with_allow(request, error)
    for make in (problem_page, bare_problem_page) if is_page(request) else ():
        try:
            return await run_in_threadpool(make, request, error)
        except Exception:
            log.exception("A page for request %s could not be made", request.state.request_id)
    return problem_response(request, make_problem(error))


class _Server(uvicorn.Server):
    """Says when it accepts connections, and stops in order.

    Told to stop, it first drains: it listens on and answers everything, while `/readyz` says 503 and no further run is claimed.
    Then it ends the event streams, which would never end by themselves, closes its listener, and waits for the requests under way.
    """

    def __init__(self, config: uvicorn.Config, on_open: Callable[[], None] | None = None) -> None:
        super().__init__(config)
        self._on_open = on_open

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen, then say so."""
        await super().startup(sockets)
        if self.started and self._on_open is not None:
            self._on_open()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Drain, close the feed, then wait for what is under way."""
        app = self.config.app
        if isinstance(app, FastAPI):
            await self._drain(app)
            await run_in_threadpool(app.state.broadcast.close)
        await super().shutdown(sockets)

    async def _drain(self, app: FastAPI) -> None:
        """Answer on while a proxy notices that this server is not ready; a second signal ends it at once."""
        app.state.draining = True
        if app.state.workers is not None:
            app.state.workers.drain()
        for turn in range(round(app.state.settings.drain_s / DRAIN_TURN_S)):
            if self.force_exit or len(self._captured_signals) > 1:
                return
            await self.on_tick(turn)
            await asyncio.sleep(DRAIN_TURN_S)


def configured(app: FastAPI, settings: Settings, connections: Connections | None = None) -> uvicorn.Config:
    """Return how an application is served over HTTP, with connections that have their deadlines."""
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        http=(connections or Connections()).protocol(),
        ws="none",
        log_level="warning",
        log_config=None if settings.log_format == "json" else LOGGING_CONFIG,
        server_header=False,
        forwarded_allow_ips=settings.trusted_proxies,
        timeout_graceful_shutdown=ENDS_WITHIN_S,
    )


def serve(settings: Settings, on_open: Callable[[], None] | None = None) -> None:
    """Serve until told to stop by SIGINT or SIGTERM; `on_open` is called once connections are accepted."""
    logs.configure(settings.log_format)
    sys.setswitchinterval(SWITCH_S)
    gc.freeze()  # what was imported stays: no collection looks through it again
    gc.set_threshold(*COLLECTIONS)
    gc.enable()
    connections = Connections(open_file_limit())
    _Server(configured(create_app(settings), settings, connections), on_open).run()
