"""Sending messages to people by apprise, in a process of its own: `python -m boresight.platform.jobs.message_transport`.

apprise has some 150 services, and a person chooses by an address which of their code runs. So it runs apart from the server:
what it connects to is judged by `platform.web.targets` at each connection, and it can start no program and write no file. Python's
audit events (PEP 578) see every connection, whatever library makes it, redirects and proxies included; a hook that raises ends
the operation. The process reads one document from standard input and writes a line a message, as soon as it is sent::

    {"targets": {...}, "messages": [{"id": 7, "address": "...", "title": "...", "body": "...", "trusted": false}]}
    {"id": 7, "ok": true, "outcome": "..."}

`trusted` is a message to the installation's own mail server, which may be inside. apprise is imported here alone.
"""

from __future__ import annotations

import json
import logging
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from typing import IO, Any

from boresight.errors import RefusedInputError
from boresight.platform.web.targets import WebhookTargets

AT_ONCE = 8
TIMEOUT_S = 45.0
HEARD = 200  # characters of a refusal that are kept
CHECK_S = 20.0
FORBIDDEN = ("subprocess.Popen", "os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "os.system")
CONNECTING = ("socket.connect", "socket.sendto", "socket.sendmsg")
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
LEFT_OUT = re.compile(r"BORESIGHT_.*|AWS_.*|PG.*|.*_proxy|OTEL_.*", re.IGNORECASE)  # of the environment


@dataclass(frozen=True)
class OutboundMessage:
    """A message to be sent; `address` is apprise's, with its token."""

    id: int
    title: str
    body: str
    trusted: bool = False
    address: str = field(default="", repr=False)


@dataclass(frozen=True)
class Delivery:
    """What came of an attempt to send a message."""

    id: int
    ok: bool
    outcome: str


@dataclass(frozen=True)
class CheckedAddress:
    """An address that apprise knows: its scheme, and what may be shown of it."""

    service: str
    shown: str


def send(messages: Sequence[OutboundMessage], targets: WebhookTargets, timeout_s: float = TIMEOUT_S) -> list[Delivery]:
    """Send messages and return what came of each; one without an answer in time counts as not sent."""
    asked = {"targets": _plain(targets), "messages": [asdict(one) for one in messages]}
    answered = {
        int(told["id"]): Delivery(int(told["id"]), bool(told["ok"]), str(told["outcome"]))
        for told in _ask(asked, timeout_s)
        if "id" in told
    }
    return [answered.get(one.id) or Delivery(one.id, False, f"No answer within {timeout_s:g} s.") for one in messages]


def check(address: str, targets: WebhookTargets) -> CheckedAddress:
    """Return service and name of an address, or refuse it; takes a second, so call it outside writing transactions."""
    told = next(iter(_ask({"targets": _plain(targets), "check": address}, CHECK_S)), {})
    if told.get("fault") or "service" not in told:
        raise RefusedInputError(
            str(told.get("fault") or "The address could not be checked in time; try it again, or give another.")
        )
    return CheckedAddress(str(told["service"]), str(told["shown"]))


def _plain(targets: WebhookTargets) -> dict[str, Any]:
    return {name: getattr(targets, name) for name in ("local", "private", "hosts", "listening")}


def _ask(document: Mapping[str, Any], timeout_s: float) -> list[dict[str, Any]]:
    """Run the process and return the lines that it wrote until its end or the time-out."""
    words = [sys.executable, "-B", "-m", __name__]
    environment = {name: value for name, value in os.environ.items() if not LEFT_OUT.fullmatch(name)}
    try:
        done = subprocess.run(  # noqa: S603 - this interpreter, on this module
            words,
            input=json.dumps(document).encode(),
            capture_output=True,
            timeout=timeout_s,
            env=environment,
            check=False,
        )
        written = done.stdout
    except subprocess.TimeoutExpired as late:
        written = late.stdout or b""
    lines = []
    for line in written.decode("utf-8", "replace").splitlines():
        with suppress(ValueError):
            lines.append(json.loads(line))
    return lines


class Guard(threading.local):
    """What the current thread may connect to, and why it was refused."""

    trusted: bool = False
    refusal: str = ""


GUARD = Guard()


def _refuse(why: str) -> None:
    """Refuse what a service is about to do, by an error of the system that libraries of the network let pass."""
    GUARD.refusal = why
    raise PermissionError(why)


def _forbid(targets: WebhookTargets) -> Callable[[str, tuple[Any, ...]], None]:
    """Return the hook of audit events that refuses what a message's service must not do."""
    own = targets.own()
    judged = replace(targets, own=lambda: own)

    def hook(event: str, given: tuple[Any, ...]) -> None:
        if event in FORBIDDEN:
            _refuse("its service would start a program, which is not allowed")
        elif event == "open":
            if isinstance(given[2], int) and given[2] & WRITES and given[0] != os.devnull:
                _refuse("its service would write a file, which is not allowed")
        elif event == "socket.getaddrinfo" and not GUARD.trusted:
            try:
                judged.refuse_host(_text(given[0]))
            except RefusedInputError as error:
                _refuse(str(error).rstrip("."))
        elif event in CONNECTING and not GUARD.trusted and (why := _why_not(judged, given[1])):
            _refuse(why)

    return hook


def _why_not(targets: WebhookTargets, address: object) -> str | None:
    """Return why a socket may not be connected to an address; None where it may, or where it is connected already."""
    if address is None:
        return None
    if not isinstance(address, tuple):
        return "its service would access a socket of this machine, which is not allowed"
    host = _text(address[0])
    try:
        why = targets.why_not(host)
    except ValueError:  # a name, which the system would look up unseen
        why = "a host name that was not checked"
    return None if why is None else f"it leads to {host}, {why}"


def _text(host: object) -> str:
    return host.decode("ascii", "replace") if isinstance(host, bytes) else str(host)


class _Heard(logging.Handler):
    """Keeps the last warning of apprise in each thread."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.last = threading.local()

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a warning."""
        self.last.text = record.getMessage()


def main(source: IO[bytes], out: IO[str]) -> None:
    """Read the document, and check an address or send messages."""
    import apprise  # noqa: PLC0415 - before the hook, so that no import is taken for a write

    asked = json.load(source)
    given = asked["targets"]
    targets = WebhookTargets(given["local"], given["private"], tuple(given["hosts"]), given["listening"])
    heard = _Heard()
    apprise.logger.handlers[:] = [heard]
    apprise.logger.propagate = False
    asset = apprise.AppriseAsset(app_id="Boresight", app_desc="Boresight", app_url="", async_mode=False)
    if "check" in asked:
        out.write(json.dumps(_checked(apprise, asset, asked["check"], targets)) + "\n")
        return
    messages = [OutboundMessage(**one) for one in asked["messages"]]
    lock = threading.Lock()

    def deliver(message: OutboundMessage) -> None:
        told = _sent(apprise, asset, message, heard)
        with lock:
            out.write(json.dumps(asdict(told)) + "\n")
            out.flush()

    plugins = {one.id: apprise.Apprise.instantiate(one.address, asset=asset) for one in messages}  # imports them
    del plugins
    sys.addaudithook(_forbid(targets))
    with ThreadPoolExecutor(AT_ONCE) as threads:
        list(threads.map(deliver, messages))


def _checked(apprise: Any, asset: Any, address: str, targets: WebhookTargets) -> dict[str, str]:
    """Return service and shown form of an address, or why it is refused."""
    made = apprise.Apprise.instantiate(address, asset=asset)
    if made is None:
        return {
            "fault": "The address is not complete for its service; compare it with the service's page in apprise's list."
        }
    if not made.verify_certificate:
        return {"fault": "The address switches off the check of certificates; omit verify=."}
    host = str(getattr(made, "host", "") or "")
    scheme = address.partition(":")[0].lower()
    if host:
        try:
            targets.addresses(host, int(made.port or 443))
        except RefusedInputError as error:
            return {"fault": str(error)}
        except OSError:
            pass  # a name that does not resolve now; each connection is judged again
    return {"service": scheme, "shown": f"{scheme}://{host or '…'}" + ("/…" if host else "")}


def _sent(apprise: Any, asset: Any, message: OutboundMessage, heard: _Heard) -> Delivery:
    """Send one message in this thread, where the guard knows whose it is."""
    GUARD.trusted, GUARD.refusal, heard.last.text = message.trusted, "", ""
    service = apprise.Apprise.instantiate(message.address, asset=asset)
    if service is None:
        return Delivery(message.id, False, "Not sent: its address is not complete; remove it and enter it again.")
    try:
        ok = bool(service.notify(title=message.title, body=message.body, body_format=apprise.NotifyFormat.TEXT))
    except Exception as error:  # noqa: BLE001 - whatever a service raises, the message was not sent
        ok, heard.last.text = False, type(error).__name__
    if ok:
        return Delivery(message.id, True, "Delivered.")
    why = GUARD.refusal or hide(getattr(heard.last, "text", ""), message.address)[:HEARD]
    return Delivery(message.id, False, f"Not sent: {why or 'its service gave no reason'}")


def hide(text: str, address: str) -> str:
    """Take the parts of an address that may be secret out of a text."""
    parts = sorted(set(re.split(r"[/:@?&=,]+", address.partition("://")[2])), key=len, reverse=True)
    for part in parts:
        if len(part) >= 6:
            text = text.replace(part, "…")
    return " ".join(text.split())


if __name__ == "__main__":
    main(sys.stdin.buffer, sys.stdout)
