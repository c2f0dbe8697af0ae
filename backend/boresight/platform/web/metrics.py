"""Metrics: requests by route, their durations, runs by state, open event streams."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from starlette.types import Scope

from boresight.errors import BoresightError

UNROUTED = "none"


class _RunsByState(Collector):
    """A collector that counts the runs when scraped."""

    def __init__(self, count: Callable[[], dict[str, int]]) -> None:
        self._count = count

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yield the number of runs in every state."""
        family = GaugeMetricFamily("boresight_runs", "Runs in the store by state", labels=["state"])
        for state, count in self._count().items():
            family.add_metric([state], count)
        yield family

    def describe(self) -> list[Any]:
        """Describe nothing at registration: the store may not be migrated yet."""
        return []


class Metrics:
    """The series of one server."""

    def __init__(self, count_runs: Callable[[], dict[str, int]], count_listeners: Callable[[], int]) -> None:
        self._registry = CollectorRegistry()
        labels = ("method", "route", "status")
        self._requests = Counter("boresight_http_requests", "Requests answered", labels, registry=self._registry)
        self._seconds = Histogram("boresight_http_seconds", "Time to answer", labels[:2], registry=self._registry)
        self._by_kind: dict[tuple[str, str, int], tuple[Counter, Histogram]] = {}
        listeners = Gauge("boresight_event_streams", "Open event streams", registry=self._registry)
        listeners.set_function(count_listeners)
        self._registry.register(_RunsByState(count_runs))

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
