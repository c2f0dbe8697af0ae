"""The log-in cookie: a signed value that holds the secret of a session and its CSRF token.

The value is `[token, csrf]` signed with the installation's secret key, so it can be read by its holder and altered by nobody.
Whether the session still holds is the store's to say (`boresight.services.sessions`), with every request. HttpOnly keeps the cookie
from scripts, SameSite=Lax from other sites' forms; the CSRF token must come back in every unsafe request that it authenticates.
"""

from __future__ import annotations

import os
import secrets
import tempfile
from dataclasses import dataclass
from pathlib import Path

from itsdangerous import BadData, SignatureExpired, URLSafeTimedSerializer
from starlette.responses import Response

from boresight.errors import SessionEndedError, UnauthenticatedError
from boresight.settings import Settings

SESSION_COOKIE = "boresight_session"
SECURE_PREFIX = "__Host-"  # browsers then take the cookie from this host alone, over HTTPS alone, for every path
SECRET_FILE = "secret.key"  # noqa: S105 - the name of a file
SECRET_BYTES = 32


@dataclass(frozen=True)
class CookieContent:
    """What the cookie says: the secret of the session, the token that unsafe requests repeat, and its end by the clock."""

    token: str
    csrf_token: str
    ends_s: float


def read_secret(folder: Path) -> bytes:
    """Return the secret key of this installation, made on first use and readable by its owner only.

    The file appears under its name complete or not at all, and an existing one is never replaced: two servers that
    start at once on one folder end with the same key.
    """
    folder.mkdir(parents=True, exist_ok=True)
    place = folder / SECRET_FILE
    if not place.exists():
        handle, written = tempfile.mkstemp(prefix=".secret-", dir=folder)  # 0600 from the start
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(secrets.token_bytes(SECRET_BYTES))
            os.link(written, place)
        except FileExistsError:
            pass  # the other server was first: its key is the key
        finally:
            Path(written).unlink()
    return place.read_bytes()


class LogInCookie:
    """Writes and reads the cookie of one installation."""

    def __init__(self, settings: Settings) -> None:
        self._max_age_s = round(settings.session_hours * 3600)
        self._secure = bool(settings.secure_cookies)
        self.name = SECURE_PREFIX + SESSION_COOKIE if self._secure else SESSION_COOKIE
        self._serializer = URLSafeTimedSerializer(read_secret(settings.data_folder), salt=SESSION_COOKIE)

    def write(self, response: Response, token: str) -> str:
        """Give the browser a session; returns its CSRF token, which no earlier one had."""
        csrf_token = secrets.token_urlsafe(24)
        value = self._serializer.dumps([token, csrf_token])
        response.set_cookie(
            self.name,
            value if isinstance(value, str) else value.decode(),
            max_age=self._max_age_s,
            path="/",
            secure=self._secure,
            httponly=True,
            samesite="lax",
        )
        return csrf_token

    def clear(self, response: Response) -> None:
        """Take the cookie away from the browser."""
        response.delete_cookie(self.name, path="/", secure=self._secure, httponly=True, samesite="lax")

    def read(self, value: str) -> CookieContent:
        """Return what a cookie says.

        Raises
        ------
        UnauthenticatedError
            When it is too old, altered, of an earlier version, or signed by another installation.
        """
        try:
            said, signed = self._serializer.loads(value, max_age=self._max_age_s, return_timestamp=True)
            token, csrf_token = said
        except SignatureExpired as error:
            raise SessionEndedError("expired") from error
        except (BadData, ValueError, TypeError) as error:
            raise UnauthenticatedError("This log-in is not known here; log in again.") from error
        if not isinstance(token, str) or not isinstance(csrf_token, str):  # a cookie of before log-ins were rows
            raise UnauthenticatedError("This log-in is not known here; log in again.")
        return CookieContent(token, csrf_token, signed.timestamp() + self._max_age_s)
