"""Metrics of a server: requests by route and their durations, open event streams, the ends of runs; and what collectors add."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.registry import Collector
from starlette.types import Scope

from boresight.errors import BoresightError

UNROUTED = "none"
COMPUTE_BUCKETS_S = (0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000, 3600)


class Metrics:
    """The series of one server."""

    def __init__(self, count_listeners: Callable[[], int], collectors: Iterable[Collector] = ()) -> None:
        self._registry = CollectorRegistry()
        labels = ("method", "route", "status")
        self._requests = Counter("boresight_http_requests", "Requests answered", labels, registry=self._registry)
        self._seconds = Histogram("boresight_http_seconds", "Time to answer", labels[:2], registry=self._registry)
        self._by_kind: dict[tuple[str, str, int], tuple[Counter, Histogram]] = {}
        listeners = Gauge("boresight_event_streams", "Open event streams", registry=self._registry)
        listeners.set_function(count_listeners)
        self._ended = Counter(
            "boresight_runs_ended", "Runs that ended on this server", ["state"], registry=self._registry
        )
        self._computed = Histogram(
            "boresight_run_compute_seconds",
            "Time that a run which succeeded computed",
            buckets=COMPUTE_BUCKETS_S,
            registry=self._registry,
        )
        for state in ("SUCCEEDED", "FAILED", "CANCELLED"):
            self._ended.labels(state)  # 0 until it happens
        for collector in collectors:
            self._registry.register(collector)

    def observe_run(self, state: str, seconds: float | None) -> None:
        """Count a run that ended, with the time that it computed."""
        self._ended.labels(state).inc()
        if seconds is not None:
            self._computed.observe(seconds)

    def observe(self, scope: Scope, status: int, seconds: float) -> None:
        """Count one answered request."""
        route = getattr(scope.get("route"), "path", UNROUTED)
        method = scope["method"] if route != UNROUTED else "any"
        answered, took = self._series(method, route, status)
        answered.inc()
        took.observe(seconds)

    def _series(self, method: str, route: str, status: int) -> tuple[Counter, Histogram]:
        """Return the two series for a route and status code."""
        kind = method, route, status
        if kind not in self._by_kind:
            labelled = self._requests.labels(method, route, str(status)), self._seconds.labels(method, route)
            self._by_kind[kind] = labelled
        return self._by_kind[kind]

    def text(self) -> bytes:
        """Return all series in the exposition format."""
        return generate_latest(self._registry)


LOOK_AGAIN_S = 5.0


class CachedCheck:
    """A check whose result is cached for some seconds."""

    def __init__(self, refuse: Callable[[], None]) -> None:
        self._refuse = refuse
        self._fault = ""
        self._looked_s = float("-inf")

    def fault(self) -> str:
        """Return the fault found by the check, at most some seconds old; empty where there is none."""
        if time.monotonic() - self._looked_s > LOOK_AGAIN_S:
            try:
                self._refuse()
                self._fault = ""
            except BoresightError as error:
                self._fault = str(error)
            self._looked_s = time.monotonic()
        return self._fault
