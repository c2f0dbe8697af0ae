"""Logs: lines of text as Python writes them, or one JSON object a line with the request, person, run and trace that it belongs to.

Secrets that a message or a traceback could hold are taken out of a JSON line: keys of the API and of webhooks, passwords
in addresses.
"""

from __future__ import annotations

import json
import logging
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import IO, Any

FORMATS = ("text", "json")
#: What a line belongs to: the state of a request, or the run that a worker computes.
BELONGS_TO: ContextVar[Mapping[str, Any]] = ContextVar("boresight_log", default={})  # noqa: B039 - never changed
SECRETS = (
    (re.compile(r"\bbs_[A-Za-z0-9_-]{6,}"), "bs_…"),
    (re.compile(r"\bwhsec_[A-Za-z0-9+/=_-]{6,}"), "whsec_…"),
    (re.compile(r"\bfernet:[A-Za-z0-9_=-]{6,}"), "fernet:…"),
    (re.compile(r"(://[^\s/:@]*):[^\s/@]+@"), r"\1:…@"),
    (
        re.compile(
            r"(?i)\b(password|secret|token|authorization|cookie)(\"?'?\s*[:=]\s*\"?'?)(?:Bearer\s+)?[^\s\"',;}]+"
        ),
        r"\1\2…",
    ),
)
REQUESTS = logging.getLogger("boresight.requests")  # a line a request, of the level INFO


def hide_secrets(text: str) -> str:
    """Take out of a text what looks like a secret."""
    for pattern, instead in SECRETS:
        text = pattern.sub(instead, text)
    return text


class JsonFormatter(logging.Formatter):
    """Writes a record as one JSON object on one line."""

    def format(self, record: logging.LogRecord) -> str:
        """Write a record."""
        told: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC)
            .isoformat(timespec="milliseconds")
            .replace("+00:00", "Z"),
            "level": record.levelname,
            "logger": record.name,
            "message": hide_secrets(record.getMessage()),
            "process": record.process,
        }
        told |= _describe(BELONGS_TO.get()) | getattr(record, "told", {})
        if record.exc_info:
            told["exception"] = hide_secrets(self.formatException(record.exc_info))
        return json.dumps({name: value for name, value in told.items() if value is not None}, default=str)


def _describe(belongs_to: Mapping[str, Any]) -> dict[str, Any]:
    """Return what names the request, person, run and trace of a line."""
    actor, trace = belongs_to.get("actor"), belongs_to.get("traceparent")
    parts = trace.split("-") if trace else ["", "", ""]
    return {
        "request_id": belongs_to.get("request_id"),
        "person": getattr(actor, "name", None),
        "run_id": belongs_to.get("run_id"),
        "attempt": belongs_to.get("attempt"),
        "trace_id": parts[1] or None,
        "span_id": parts[2] or None,
    }


def configure(log_format: str, stream: IO[str] | None = None) -> None:
    """Write all logs of this process as JSON where that is asked for; text is as Python and its libraries write it."""
    if log_format != "json":
        return
    handler = logging.StreamHandler(stream or sys.stderr)
    handler.setFormatter(JsonFormatter())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    logging.getLogger("boresight").setLevel(logging.INFO)
    for name in ("uvicorn", "uvicorn.error", "distributed", "distributed.nanny.memory", "bokeh"):
        logging.getLogger(name).handlers[:] = []
        logging.getLogger(name).propagate = True
    logging.getLogger("distributed").setLevel(logging.WARNING)
    logging.captureWarnings(capture=True)


def sayer(log_format: str, say: Callable[[str], None]) -> Callable[[str], None]:
    """Return how a service says that it has started: as a line of its log where that is JSON, else as it is."""
    return logging.getLogger("boresight.service").info if log_format == "json" else say


@contextmanager
def belonging_to(**what: Any) -> Iterator[None]:
    """Write in each line inside what it belongs to."""
    token = BELONGS_TO.set({**BELONGS_TO.get(), **what})
    try:
        yield
    finally:
        BELONGS_TO.reset(token)
