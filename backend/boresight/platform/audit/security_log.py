"""The security log: what a SIEM is told, one JSON object a line, on standard output or in a file.

Every event is declared in `EVENTS` and written under no other id; ids are those of the OWASP Logging Vocabulary where that
has one. What a transaction did is noted in it and written after its commit (`note`), a refusal is told at once (`tell`).
Who asked, from where and under which request id follows from the request that is under way. Secrets are never given here:
an event takes only the details that it declares. What somebody unknown can cause has a budget of lines a minute; the lines
beyond it are counted, and the count is written.
"""

from __future__ import annotations

import json
import logging
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from logging.handlers import WatchedFileHandler
from pathlib import Path
from typing import Any, Protocol

from boresight.platform.actors import Actor
from boresight.platform.db.times import utc_now

log = logging.getLogger(__name__)

SCHEMA = "boresight.security/1"
STANDARD_OUTPUT = "-"
LINES_A_MINUTE = 600  # of each event that somebody unknown can cause
LONGEST_TEXT = 200
NOTED = "security events"


@dataclass(frozen=True)
class SecurityEvent:
    """One kind of event: its id, level, what it tells, the details it may carry, and whether anybody unknown can cause it."""

    id: str
    level: str
    sentence: str
    details: tuple[str, ...] = ()
    by_anybody: bool = False


_E = SecurityEvent
EVENTS: Mapping[str, SecurityEvent] = {
    event.id: event
    for event in (
        _E("authn_login_success", "INFO", "A person logged in.", ("method", "factor", "log_in")),
        _E(
            "authn_login_fail",
            "WARN",
            "A log-in or the password of a signature was refused.",
            ("name", "reason", "method"),
            by_anybody=True,
        ),
        _E(
            "authn_login_lock",
            "WARN",
            "Further tries for a name must wait, because too many failed.",
            ("name", "wait_s"),
            by_anybody=True,
        ),
        _E("authn_confirm_success", "INFO", "The provider confirmed a person again, for one signature.", ("log_in",)),
        _E("authn_password_change", "INFO", "A person changed their password.", ("user",)),
        _E("authn_password_reset", "WARN", "An administrator set another person's password.", ("user",)),
        _E("authn_factor_enrolled", "INFO", "A second factor was enrolled.", ("user", "kind", "factor")),
        _E("authn_factor_used", "INFO", "A second factor was given.", ("user", "kind", "purpose")),
        _E("authn_factor_fail", "WARN", "A second factor was refused.", ("user", "kind", "purpose", "reason")),
        _E("authn_factor_removed", "WARN", "A person removed one of their second factors.", ("user", "kind", "factor")),
        _E("authn_factor_reset", "WARN", "An administrator removed every second factor of a person.", ("user",)),
        _E("authn_recovery_codes_made", "INFO", "A person generated new recovery codes.", ("user",)),
        _E(
            "authn_recovery_code_used", "WARN", "A recovery code was used instead of a second factor.", ("user", "left")
        ),
        _E(
            "authn_sso_fail",
            "WARN",
            "Single sign-on was refused.",
            ("reason", "issuer", "subject"),
            by_anybody=True,
        ),
        _E("authn_token_created", "INFO", "An API key was created.", ("key", "scopes", "expires_utc")),
        _E("authn_token_revoked", "INFO", "An API key was revoked.", ("key",)),
        _E(
            "authn_token_fail", "WARN", "An unknown, expired or revoked API key was sent.", ("reason",), by_anybody=True
        ),
        _E(
            "authz_fail",
            "WARN",
            "What a person or a key asked for was refused to them.",
            ("method", "path", "sentence"),
        ),
        _E("authz_change", "WARN", "The roles of a person changed.", ("user", "before", "after", "source")),
        _E("session_ended", "INFO", "Log-ins of a person ended.", ("user", "reason", "log_ins", "log_in")),
        _E("user_created", "WARN", "An account was created.", ("user", "name", "roles", "source")),
        _E("user_disabled", "WARN", "An account was disabled.", ("user",)),
        _E("user_enabled", "WARN", "A disabled account was enabled.", ("user",)),
        _E(
            "malicious_csrf",
            "WARN",
            "A request came with a log-in and without the token of its pages.",
            ("method", "path"),
            by_anybody=True,
        ),
        _E(
            "malicious_cors",
            "WARN",
            "A page of another site made a request.",
            ("method", "path", "origin"),
            by_anybody=True,
        ),
        _E("sys_startup", "INFO", "The server started.", ("version", "host", "port")),
        _E("sys_shutdown", "INFO", "The server stopped."),
        _E(
            "sys_weak_setting", "WARN", "A setting weakens what protects the installation.", ("setting", "value", "why")
        ),
        _E("sys_suppressed", "WARN", "Events were over their budget and were counted only.", ("events",)),
    )
}


class Transaction(Protocol):
    """The part of a session that carries the events of its transaction."""

    @property
    def info(self) -> dict[Any, Any]:
        """What belongs to the transaction."""


class SecurityLog:
    """The log of one server; without a place it writes nothing."""

    def __init__(self, place: str = "", lines_a_minute: int = LINES_A_MINUTE) -> None:
        self._handler = _open(place)
        self._lines_a_minute = lines_a_minute
        self._guard = threading.Lock()
        self._minute = 0
        self._written: Counter[str] = Counter()

    @property
    def is_kept(self) -> bool:
        """Whether anything is written."""
        return self._handler is not None

    @contextmanager
    def following(
        self, request_id: str | None = None, address: str | None = None, method: str = "", path: str = ""
    ) -> Iterator[None]:
        """Write to this log what is told inside, as of one request or of the server's own work."""
        token = _under_way.set(_Origin(self, request_id, address, {"method": method, "path": path}))
        try:
            yield
        finally:
            _under_way.reset(token)

    def write(self, event: SecurityEvent, line: Mapping[str, Any]) -> None:
        """Write one event within its budget."""
        if self._handler is None:
            return
        with self._guard:
            minute = int(time.monotonic() // 60)
            if minute != self._minute:
                over = {name: count - self._lines_a_minute for name, count in self._written.items()}
                self._minute, self._written = minute, Counter()
                if told := {name: count for name, count in over.items() if count > 0}:
                    lost = EVENTS["sys_suppressed"]
                    self._emit(_line(lost, "failure", _Origin(self, None, None), None, {"events": told}))
            if event.by_anybody:
                self._written[event.id] += 1
            if self._written[event.id] <= self._lines_a_minute:
                self._emit(line)

    def _emit(self, line: Mapping[str, Any]) -> None:
        if self._handler is None:
            return
        text = json.dumps(line, ensure_ascii=True, separators=(",", ":"), default=str)
        record = logging.LogRecord("boresight.security", logging.INFO, "", 0, text, None, None)
        try:
            self._handler.emit(record)
        except OSError:  # of opening, before Python 3.14; all else the handler hands to `handleError` itself
            self._handler.handleError(record)

    def close(self) -> None:
        """Close the file."""
        if isinstance(self._handler, WatchedFileHandler):
            with suppress(OSError):  # what it could not write was told
                self._handler.close()


def _open(place: str) -> logging.StreamHandler[Any] | None:
    if not place:
        return None
    if place == STANDARD_OUTPUT:
        return logging.StreamHandler(sys.stdout)
    handler = WatchedFileHandler(Path(place).expanduser(), encoding="utf-8", delay=True)
    handler.handleError = _tell_of_failure  # type: ignore[method-assign]  # instead of a traceback on standard error
    return handler


def _tell_of_failure(record: logging.LogRecord) -> None:
    """Say what could not be written; what it tells of goes on, for the audit log has what must not be lost."""
    log.error("The security log cannot be written (%s): %s", sys.exception(), record.getMessage())


@dataclass
class _Origin:
    """Where an event comes from: the log of its server, and the request that is under way."""

    log: SecurityLog
    request_id: str | None
    address: str | None
    request: Mapping[str, str] = field(default_factory=dict)  # its method and path
    actor: Actor | None = None
    refused: set[str] = field(default_factory=set)


_under_way: ContextVar[_Origin | None] = ContextVar("security log", default=None)


def tell_actor(actor: Actor) -> None:
    """Say who acts in the request that is under way."""
    if (origin := _under_way.get()) is not None:
        origin.actor = actor


def tell(event_id: str, outcome: str, actor: Actor | None = None, **details: Any) -> None:
    """Write an event now: a refusal, or what no transaction is about."""
    origin = _under_way.get()
    if origin is not None and origin.log.is_kept:
        event = EVENTS[event_id]
        origin.refused.add(event_id)
        origin.log.write(event, _line(event, outcome, origin, actor, details))


def tell_once(event_id: str, outcome: str, actor: Actor | None = None, **details: Any) -> None:
    """Write an event unless this request was told of already."""
    origin = _under_way.get()
    if origin is not None and not origin.refused:
        tell(event_id, outcome, actor, **details)


def note(transaction: Transaction, event_id: str, actor: Actor | None = None, **details: Any) -> None:
    """Write an event once its transaction is committed; nothing of one that is rolled back."""
    event = EVENTS[event_id]
    _check(event, details)
    transaction.info.setdefault(NOTED, []).append((event, actor, details))


def write_noted(transaction: Transaction) -> None:
    """Write the events of a transaction that was committed."""
    noted = transaction.info.pop(NOTED, ())
    origin = _under_way.get()
    if origin is None or not origin.log.is_kept:
        return
    for event, actor, details in noted:
        origin.log.write(event, _line(event, "success", origin, actor, details))


def _check(event: SecurityEvent, details: Mapping[str, Any]) -> None:
    if not details.keys() <= set(event.details):
        raise ValueError(f"Expected details of {event.id} among {event.details} / Received {sorted(details)}")


def _line(
    event: SecurityEvent, outcome: str, origin: _Origin, actor: Actor | None, details: Mapping[str, Any]
) -> dict[str, Any]:
    """Return an event as it is written."""
    _check(event, details)
    if {"method", "path"} <= set(event.details):
        details = {**origin.request, **details}
    actor = actor or origin.actor
    who = {} if actor is None else {"actor": actor.name, "actor_id": actor.user_id, "credential": actor.credential}
    request_id = origin.request_id if actor is None or actor.request_id is None else actor.request_id
    return {
        "schema": SCHEMA,
        "time": utc_now(),
        "event": event.id,
        "level": event.level,
        "outcome": outcome,
        "description": event.sentence,
        "server": socket.gethostname(),
        "request_id": request_id,
        "source_ip": origin.address,
        "actor": None,
        "actor_id": None,
        "credential": None,
        **who,
        "details": {name: _short(value) for name, value in details.items() if value is not None},
    }


def _short(value: Any) -> Any:
    """Shorten a text that somebody outside chose."""
    return value[:LONGEST_TEXT] if isinstance(value, str) else value


def list_events() -> str:
    """Return the table of every event, as the documentation shows it."""
    rows = ["| Event | Level | When | Details |", "|---|---|---|---|"]
    for event in EVENTS.values():
        named = ", ".join(f"`{name}`" for name in event.details) or "none"
        rows.append(f"| `{event.id}` | {event.level} | {event.sentence} | {named} |")
    return "\n".join(rows)
