"""Traces by OpenTelemetry, from the click to the result: on where an endpoint is set, and not even imported where none is.

A span's place is its `traceparent` (W3C Trace Context), `00-<trace>-<span>-<flags>`: a text, so that it goes into the row of
a run, and with its inputs to a worker on another machine. Spans are sent in batches by OTLP over HTTP, from a thread of their own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Literal

import boresight
from boresight.errors import RefusedInputError
from boresight.platform.observability.logs import BELONGS_TO, belonging_to

TRACEPARENT = re.compile(r"00-(?!0{32})[0-9a-f]{32}-(?!0{16})[0-9a-f]{16}-[0-9a-f]{2}")
SEND_EVERY_MS = 1000
Kind = Literal["INTERNAL", "SERVER", "PRODUCER", "CONSUMER"]
Attributes = Mapping[str, str | int | float | bool | None]
NOTHING: Attributes = MappingProxyType({})


@dataclass(frozen=True)
class Span:
    """A span that has begun; it records nothing where traces are off."""

    _span: Any = field(default=None, repr=False)
    traceparent: str | None = None

    def tell(self, attributes: Attributes) -> None:
        """Add attributes."""
        if self._span is not None:
            self._span.set_attributes(_attributes(attributes))

    def rename(self, name: str) -> None:
        """Give it the name that is known by now."""
        if self._span is not None:
            self._span.update_name(name)

    def fail(self, sentence: str) -> None:
        """Mark it as failed."""
        if self._span is not None:
            from opentelemetry.trace import Status, StatusCode  # noqa: PLC0415 - only where traces are on

            self._span.set_status(Status(StatusCode.ERROR, sentence[:200]))

    def end(self, at_ns: int | None = None) -> None:
        """End it, now or at a time of Unix in nanoseconds."""
        if self._span is not None:
            self._span.end(at_ns)


NO_SPAN = Span()


class Traces:
    """What makes the spans of one process, and sends them to an endpoint; without one it does nothing."""

    def __init__(self, endpoint: str = "", service: str = "boresight") -> None:
        self.endpoint = endpoint
        self._provider: Any = None
        self._tracer: Any = None
        if endpoint:
            self._provider = _provider(endpoint, service)
            self._tracer = self._provider.get_tracer("boresight", boresight.__version__)

    @property
    def on(self) -> bool:
        """Whether spans are made."""
        return self._tracer is not None

    def begin(
        self,
        name: str,
        parent: str | None,
        attributes: Attributes = NOTHING,
        *,
        kind: Kind = "INTERNAL",
        at_ns: int | None = None,
    ) -> Span:
        """Begin a span under the one at a place, or a new trace."""
        if self._tracer is None:
            return NO_SPAN
        from opentelemetry.trace import SpanKind  # noqa: PLC0415 - only where traces are on
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator  # noqa: PLC0415 - as above

        carrier = {} if parent is None else {"traceparent": parent}
        context = TraceContextTextMapPropagator().extract(carrier)
        made = self._tracer.start_span(
            name, context, getattr(SpanKind, kind), attributes=_attributes(attributes), start_time=at_ns
        )
        place = made.get_span_context()
        return Span(made, f"00-{place.trace_id:032x}-{place.span_id:016x}-{int(place.trace_flags):02x}")

    @contextmanager
    def span(
        self, name: str, parent: str | None = None, attributes: Attributes = NOTHING, *, kind: Kind = "INTERNAL"
    ) -> Iterator[Span]:
        """Run what is inside as a span, under the one at a place or the current one; lines of the log belong to it."""
        if self._tracer is None:
            yield NO_SPAN
            return
        made = self.begin(name, parent or get_traceparent(), attributes, kind=kind)
        try:
            with belonging_to(traceparent=made.traceparent):
                yield made
        except BaseException as error:
            made.fail(f"{type(error).__name__}: {error}")
            raise
        finally:
            made.end()

    def tell_past(
        self, name: str, parent: str | None, begin_ns: int, end_ns: int, attributes: Attributes = NOTHING
    ) -> None:
        """Add a span that is over already."""
        self.begin(name, parent, attributes, at_ns=begin_ns).end(max(begin_ns, end_ns))

    def close(self) -> None:
        """Send what is left, for a moment at most; safe to call twice."""
        if self._provider is not None:
            self._provider.force_flush(2000)


@lru_cache(maxsize=8)
def _provider(endpoint: str, service: str) -> Any:
    """Return what sends the spans of this process to an endpoint, one for each."""
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter  # noqa: PLC0415 - as above
        from opentelemetry.sdk.resources import Resource  # noqa: PLC0415 - as above
        from opentelemetry.sdk.trace import TracerProvider  # noqa: PLC0415 - as above
        from opentelemetry.sdk.trace.export import BatchSpanProcessor  # noqa: PLC0415 - as above
    except ImportError as error:
        raise RefusedInputError(
            "BORESIGHT_OTLP_ENDPOINT is set and OpenTelemetry is not installed: install 'boresight[tracing]', or leave it empty."
        ) from error
    resource = Resource.create({"service.name": service, "service.version": boresight.__version__})
    provider = TracerProvider(resource=resource)
    exporter = OTLPSpanExporter(endpoint=f"{endpoint.rstrip('/')}/v1/traces", timeout=5)
    provider.add_span_processor(BatchSpanProcessor(exporter, schedule_delay_millis=SEND_EVERY_MS))
    return provider


@lru_cache(maxsize=8)
def get_traces(endpoint: str, service: str) -> Traces:
    """Return the traces of this process that go to an endpoint."""
    return Traces(endpoint, service)


def get_traceparent() -> str | None:
    """Return the place of the current span; None where there is none."""
    return BELONGS_TO.get().get("traceparent")


def read_traceparent(text: str) -> str | None:
    """Return the place that a caller sent, None where it is none."""
    return text if TRACEPARENT.fullmatch(text) else None


def to_ns(time_utc: str) -> int:
    """Return a time of the store in nanoseconds of Unix."""
    return round(datetime.fromisoformat(time_utc).timestamp() * 1e6) * 1000


def _attributes(given: Attributes) -> dict[str, Any]:
    return {name: value for name, value in given.items() if value is not None}
