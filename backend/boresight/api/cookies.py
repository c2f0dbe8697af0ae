"""The log-in cookie: a signed value that names the person, the generation of their log-ins and a CSRF token.

The value is `{user, epoch, csrf}` signed with the installation's secret key, so it can be read by its holder and altered
by nobody. It ends when `session_hours` have passed, when the person is disabled, or when their `session_epoch` in the
store has moved on (a changed password, "log out everywhere"). With `session_idle_hours` it ends too when it was not used
for so long; each server remembers that of the log-ins that it has seen, and an open page that only follows the event
feed does not use its log-in. HttpOnly keeps it from scripts, SameSite=Lax from other
sites' forms; the CSRF token it carries must come back in every unsafe request that the cookie authenticates.
"""

from __future__ import annotations

import os
import secrets
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from itsdangerous import BadData, URLSafeTimedSerializer
from starlette.responses import Response

from boresight.errors import UnauthenticatedError
from boresight.settings import Settings

SESSION_COOKIE = "boresight_session"
SECURE_PREFIX = "__Host-"  # browsers then take the cookie from this host alone, over HTTPS alone, for every path
SECRET_FILE = "secret.key"  # noqa: S105 - the name of a file
SECRET_BYTES = 32
MOST_LOG_INS = 10_000


@dataclass(frozen=True)
class LogIn:
    """What the cookie says: whose it is, of which generation, and the token that unsafe requests repeat."""

    user_id: int
    epoch: int
    csrf_token: str
    ends_s: float = 0.0  # by the clock, however much it is used


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
        self._idle_s = settings.session_idle_hours * 3600
        self._used_s: dict[str, float] = {}  # by CSRF token, which no two log-ins share
        self._secure = bool(settings.secure_cookies)
        self.name = SECURE_PREFIX + SESSION_COOKIE if self._secure else SESSION_COOKIE
        self._serializer = URLSafeTimedSerializer(read_secret(settings.data_folder), salt=SESSION_COOKIE)

    def open(self, response: Response, user_id: int, epoch: int) -> LogIn:
        """Give the browser a new log-in, with a CSRF token that no earlier one had."""
        log_in = LogIn(user_id, epoch, secrets.token_urlsafe(24))
        value = self._serializer.dumps([log_in.user_id, log_in.epoch, log_in.csrf_token])
        response.set_cookie(
            self.name,
            value if isinstance(value, str) else value.decode(),
            max_age=self._max_age_s,
            path="/",
            secure=self._secure,
            httponly=True,
            samesite="lax",
        )
        return log_in

    def close(self, response: Response) -> None:
        """Take the log-in away from the browser."""
        response.delete_cookie(self.name, path="/", secure=self._secure, httponly=True, samesite="lax")

    def read(self, value: str, *, active: bool = True) -> LogIn:
        """Return what a cookie says.

        Parameters
        ----------
        active
            Whether somebody did something; False where an open page only goes on listening.

        Raises
        ------
        UnauthenticatedError
            When it is too old, was idle for too long, is altered, or signed by another installation.
        """
        try:
            said, signed = self._serializer.loads(value, max_age=self._max_age_s, return_timestamp=True)
            user_id, epoch, csrf_token = said
        except (BadData, ValueError, TypeError) as error:
            raise UnauthenticatedError("Your log-in has expired; log in again.") from error
        self._refuse_idle(str(csrf_token), active=active)
        return LogIn(int(user_id), int(epoch), str(csrf_token), signed.timestamp() + self._max_age_s)

    def use(self, log_in: LogIn) -> bool:
        """Count a use of a log-in that was read before; whether it was not idle for too long."""
        try:
            self._refuse_idle(log_in.csrf_token, active=True)
        except UnauthenticatedError:
            return False
        return True

    def _refuse_idle(self, csrf_token: str, *, active: bool) -> None:
        """Refuse a log-in that was not used for too long, and go on refusing it."""
        if not self._idle_s:
            return
        now_s = time.monotonic()
        if now_s - self._used_s.get(csrf_token, now_s) > self._idle_s:
            raise UnauthenticatedError("Your log-in was not used for long and has ended; log in again.")
        if active or csrf_token not in self._used_s:
            self._used_s[csrf_token] = now_s
        if len(self._used_s) > MOST_LOG_INS:
            self._forget_expired(now_s)

    def _forget_expired(self, now_s: float) -> None:
        """Forget the log-ins that are older than any cookie may be."""
        for token, used_s in list(self._used_s.items()):
            if now_s - used_s > self._max_age_s:
                self._used_s.pop(token, None)
