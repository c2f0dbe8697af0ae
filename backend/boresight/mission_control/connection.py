"""One connection to a mission control system: HTTP with budgets on time and size, TLS verified, one sentence for each failure.

What the system says of a mistake in the request is a `RefusedInputError`; that it does not answer, answers too slowly or too
much, or does not let us in is an `UnavailableError`, after which the same may be asked again.
"""

from __future__ import annotations

import ssl
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import orjson

import boresight
from boresight.errors import RefusedInputError, UnavailableError
from boresight.hosts import is_loopback

#: Of connecting, and of every wait for further bytes.
TIMEOUT_S = 20.0
#: Of a whole answer, however steadily it comes.
LONGEST_ANSWER_S = 300.0
#: Of answers that are documents; an export of an archive has its own budget.
MOST_BYTES = 16_000_000
LONGEST_SECRET = 4096
HEARD = 200  # characters that a sentence repeats of what a system said


@dataclass(frozen=True)
class Server:
    """Where a mission control system is, who vouches for its certificate, and as whom we come.

    `secret` is the first line of the credentials file: `name:password`, or a key or password alone.
    """

    name: str
    url: str
    setting: str
    secret: str = field(default="", repr=False)
    authority: Path | None = None

    @property
    def account(self) -> tuple[str, str] | None:
        """Name and password; None where the secret is a key or a password alone."""
        name, colon, password = self.secret.partition(":")
        return (name, password) if colon else None


def read_server(name: str, url: str, setting: str, credentials: str = "", authority: str = "") -> Server:
    """Return a server of the settings; `setting` begins the names of those that a sentence refers to."""
    parts = urlsplit(url)
    if "@" in parts.netloc or parts.query or parts.fragment:
        raise RefusedInputError(
            f"{setting}_URL contains more than scheme, host and path; give credentials in the file of {setting}_CREDENTIALS."
        )
    secret = _read_secret(Path(credentials).expanduser(), setting) if credentials else ""
    if secret and parts.scheme != "https" and not is_loopback(parts.hostname or ""):
        raise RefusedInputError(f"{setting}_URL would send credentials in the clear; give an https:// address.")
    return Server(name, url.rstrip("/"), setting, secret, Path(authority).expanduser() if authority else None)


def _read_secret(file: Path, setting: str) -> str:
    try:
        with file.open(encoding="utf-8") as opened:
            secret = opened.readline(LONGEST_SECRET).strip()
    except (OSError, UnicodeError) as error:
        raise RefusedInputError(
            f"{setting}_CREDENTIALS={str(file)!r} cannot be read ({getattr(error, 'strerror', 'not text')}): correct it."
        ) from error
    if not secret or not secret.isprintable():
        raise RefusedInputError(f"{setting}_CREDENTIALS={str(file)!r} has no secret in its first line; write it there.")
    return secret


class Connection:
    """Requests to one server, within budgets of time and size."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self._client = httpx.Client(
            base_url=server.url,
            timeout=TIMEOUT_S,
            verify=_trust(server),
            trust_env=False,
            follow_redirects=False,
            headers={"User-Agent": f"Boresight/{boresight.__version__}", "Accept-Encoding": "identity"},
        )

    def close(self) -> None:
        """Close what is open."""
        self._client.close()

    def ask(self, method: str, path: str, *, most_bytes: int = MOST_BYTES, **given: Any) -> bytes:
        """Send one request and return the body of its answer."""
        return b"".join(self.stream(method, path, most_bytes=most_bytes, **given))

    def ask_document(self, method: str, path: str, **given: Any) -> Any:
        """Send one request and return the JSON of its answer."""
        content = self.ask(method, path, **given)
        try:
            return orjson.loads(content)
        except ValueError as error:
            raise UnavailableError(
                f"{self.server.name} at {self.server.url} did not return JSON; check {self.server.setting}_URL."
            ) from error

    def ask_mapping(self, method: str, path: str, **given: Any) -> Mapping[str, Any]:
        """Send one request and return the JSON object of its answer."""
        document = self.ask_document(method, path, **given)
        if not isinstance(document, Mapping):
            raise UnavailableError(
                f"{self.server.name} at {self.server.url} returned an unexpected response; check its version."
            )
        return document

    def stream(
        self, method: str, path: str, *, most_bytes: int, headers: Mapping[str, str] | None = None, **given: Any
    ) -> Iterator[bytes]:
        """Send one request and yield the body of its answer as it comes, within the budgets."""
        ends_s, left = time.monotonic() + LONGEST_ANSWER_S, most_bytes
        with (
            self._explain_failures(),
            self._client.stream(method, path, headers=dict(headers or {}), **given) as answer,
        ):
            if not answer.is_success:
                self._refuse(answer)
            for piece in answer.iter_raw():
                left -= len(piece)
                if left < 0:
                    raise TooMuchError(
                        f"{self.server.name} returned more than {most_bytes / 1e6:.0f} MB; ask for a shorter time."
                    )
                if time.monotonic() > ends_s:
                    raise TooMuchError(
                        f"{self.server.name} took more than {LONGEST_ANSWER_S:.0f} s to respond; ask for a shorter time."
                    )
                yield piece

    @contextmanager
    def _explain_failures(self) -> Iterator[None]:
        """Say in one sentence what went wrong on the way."""
        place = f"{self.server.name} at {self.server.url}"
        where = f"{self.server.setting}_URL and the network"
        try:
            yield
        except httpx.TimeoutException as error:
            raise UnavailableError(f"{place} did not respond within {TIMEOUT_S:.0f} s: check {where}.") from error
        except (httpx.HTTPError, httpx.InvalidURL, OSError) as error:
            said = str(error) or type(error).__name__
            if isinstance(error.__cause__ or error, ssl.SSLError) or "CERTIFICATE_VERIFY_FAILED" in said:
                said, where = "its certificate is not trusted", f"the authority in {self.server.setting}_AUTHORITY"
            raise UnavailableError(f"{place} cannot be reached ({_short(said)}): check {where}.") from error

    def _refuse(self, answer: httpx.Response) -> None:
        """Raise what an answer other than success means."""
        heard = b""
        for piece in answer.iter_raw():
            heard += piece
            if len(heard) >= 16 * HEARD:
                break
        said, status = _find_message(heard), answer.status_code
        if status in {401, 403}:
            raise UnavailableError(
                f"{self.server.name} at {self.server.url} denied access ({status}{said}): correct the credentials "
                f"in the file of {self.server.setting}_CREDENTIALS, or have permission granted."
            )
        if 400 <= status < 500 and status not in {408, 429}:
            raise RefusedInputError(f"{self.server.name} refused the request ({status}{said}): correct it.")
        raise UnavailableError(f"{self.server.name} at {self.server.url} failed ({status}{said}); try again later.")


class TooMuchError(UnavailableError):
    """An answer went over a budget: the same may be asked for in smaller pieces."""


def _trust(server: Server) -> ssl.SSLContext | bool:
    if server.authority is None:
        return True
    try:
        return ssl.create_default_context(cafile=str(server.authority))
    except OSError as error:
        raise RefusedInputError(
            f"{server.setting}_AUTHORITY={str(server.authority)!r} cannot be read ({error.strerror or 'no certificate'}): "
            "name the PEM file of the authority."
        ) from error


def _find_message(heard: bytes) -> str:
    """Return what a system says in its own words: `msg` of Yamcs, `message` or the error's message of OpenC3."""
    try:
        document = orjson.loads(heard)
    except ValueError:
        return ""
    if not isinstance(document, dict):
        return ""
    nested = document.get("error")
    found = (
        document.get("msg") or document.get("message") or (nested.get("message") if isinstance(nested, dict) else None)
    )
    return f", {_short(str(found))}" if found else ""


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= HEARD else f"{line[:HEARD]}..."
