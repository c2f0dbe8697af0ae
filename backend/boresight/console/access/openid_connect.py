"""OpenID Connect Core 1.0: the authorization code flow with PKCE, as the relying party that this server is.

::

    browser -> /login/single-sign-on      a random state, nonce and code verifier v, kept in a signed cookie
            -> provider                   state, nonce, SHA-256(v), redirect_uri
            -> /login/single-sign-on/callback?code&state
    server  -> provider's token endpoint  code, v, client secret  ->  ID token

The ID token counts when its signature is by a key of the provider's discovery document, in an asymmetric algorithm, its
issuer and audience are those of the settings, it has not expired, and its nonce is that of this browser's cookie. Nothing is
asked of the provider before somebody logs in, and no redirect is followed.

Whom the provider logs out, it names to this server by a log-out token (Back-Channel Logout 1.0), which is verified in the same
way and must say that it is one.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

import httpx
import orjson
from authlib.oauth2.rfc7636 import create_s256_code_challenge
from authlib.oidc.core import CodeIDToken
from joserfc import jwt
from joserfc.errors import ExpiredTokenError, InvalidKeyIdError, JoseError
from joserfc.jwk import KeySet

import boresight
from boresight.console.access.tables import ROLES
from boresight.errors import RefusedInputError, SingleSignOnError, UnavailableError
from boresight.hosts import is_loopback
from boresight.settings import Settings

CALLBACK = "/login/single-sign-on/callback"
ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "EdDSA", "Ed25519")
TIMEOUT_S = 5.0
CLOCKS_DIFFER_S = 60
ATTEMPT_S = 600.0
KEPT_FOR_S = 3600.0
KEYS_AGAIN_S = 60.0  # at the earliest, for a key that is not known
LONGEST_ANSWER = 1_000_000  # bytes
LONGEST_CODE = 4_096
LONGEST_TOKEN = 16_384
LOG_OUT = "http://schemas.openid.net/event/backchannel-logout"  # the event of a log-out token
MOST_GROUPS = 2_000


@dataclass(frozen=True)
class ProviderSettings:
    """What this server knows of its provider beforehand."""

    issuer: str
    client_id: str
    client_secret: str = field(repr=False)
    redirect_uri: str
    home: str
    label: str = ""
    scopes: str = "openid"
    name_claim: str = "preferred_username"
    groups_claim: str = "groups"
    roles: tuple[tuple[str, str], ...] = ()


def read_provider_settings(settings: Settings) -> ProviderSettings:
    """Read what belongs to the provider from the settings, and refuse what cannot work or would be unsafe."""
    if not settings.oidc_client_id or not settings.public_url:
        raise RefusedInputError(
            "BORESIGHT_OIDC_ISSUER needs BORESIGHT_OIDC_CLIENT_ID, and BORESIGHT_PUBLIC_URL for the address that the provider "
            "sends people back to: set both."
        )
    if unknown := sorted({role for _, role in settings.oidc_roles} - set(ROLES)):
        raise RefusedInputError(
            f"BORESIGHT_OIDC_ROLES names no role {', '.join(unknown)}; choose from {', '.join(ROLES)}."
        )
    _require_https(settings.oidc_issuer, "BORESIGHT_OIDC_ISSUER")
    home = settings.public_url.rstrip("/")
    scopes = settings.oidc_scopes.split()
    return ProviderSettings(
        issuer=settings.oidc_issuer,
        client_id=settings.oidc_client_id,
        client_secret=_read_secret(settings),
        redirect_uri=home + CALLBACK,
        home=home,
        label=settings.oidc_label,
        scopes=" ".join(scopes if "openid" in scopes else ["openid", *scopes]),
        name_claim=settings.oidc_name_claim,
        groups_claim=settings.oidc_groups_claim,
        roles=settings.oidc_roles,
    )


def _read_secret(settings: Settings) -> str:
    if not settings.oidc_client_secret_file:
        return settings.oidc_client_secret
    try:
        return Path(settings.oidc_client_secret_file).expanduser().read_text().strip()
    except OSError as error:
        raise RefusedInputError(
            f"BORESIGHT_OIDC_CLIENT_SECRET_FILE cannot be read ({error.strerror}): name a file that the server's user can read."
        ) from error


def _require_https(address: str, what: str) -> None:
    parts = urlsplit(address)
    if parts.scheme != "https" and not (parts.scheme == "http" and is_loopback(parts.hostname)):
        raise RefusedInputError(f"{what} must begin with https://, except on this machine: correct {address[:200]!r}.")


@dataclass(frozen=True)
class Attempt:
    """A log-in that a browser is at the provider for; `session_id` is empty unless a person is to be confirmed again."""

    state: str
    nonce: str
    verifier: str
    back: str
    began_s: str
    session_id: str = ""

    @classmethod
    def begin(cls, back: str, session_id: int | None = None) -> Attempt:
        """Make one with random values of its own."""
        state, nonce, verifier = (secrets.token_urlsafe(32) for _ in range(3))
        return cls(state, nonce, verifier, back, f"{time.time():.0f}", "" if session_id is None else str(session_id))


@dataclass(frozen=True)
class ProviderAnswer:
    """What a provider vouches for: who it is, by issuer and subject, and the roles that their groups give."""

    issuer: str
    subject: str
    name: str
    printed_name: str
    roles: tuple[str, ...]
    authenticated_s: float | None


@dataclass(frozen=True)
class ProviderLogOut:
    """Whom a provider logged out, and when it said so."""

    issuer: str
    subject: str
    issued_s: float


@dataclass(frozen=True)
class _Discovered:
    """The provider's discovery document and keys, and when they were read."""

    document: Mapping[str, Any]
    keys: KeySet
    read_s: float


class IdentityProvider:
    """The provider of one server, as its discovery document describes it."""

    def __init__(self, settings: ProviderSettings) -> None:
        self.settings = settings
        self._known: _Discovered | None = None
        self._looking = asyncio.Lock()

    async def make_address(self, attempt: Attempt) -> str:
        """Return the provider's address to which a browser is sent for an attempt."""
        endpoint = self._endpoint(await self._discover(), "authorization_endpoint")
        asked = {
            "response_type": "code",
            "client_id": self.settings.client_id,
            "redirect_uri": self.settings.redirect_uri,
            "scope": self.settings.scopes,
            "state": attempt.state,
            "nonce": attempt.nonce,
            "code_challenge": create_s256_code_challenge(attempt.verifier),
            "code_challenge_method": "S256",
        }
        if attempt.session_id:
            asked |= {"prompt": "login", "max_age": "0"}
        return f"{endpoint}{'&' if '?' in endpoint else '?'}{urlencode(asked)}"

    async def make_log_out_address(self) -> str:
        """Return where a browser ends its log-in at the provider; the log-in page of this server where there is no such place."""
        document = await self._discover()
        if not document.document.get("end_session_endpoint"):
            return "/login"
        endpoint = self._endpoint(document, "end_session_endpoint")
        asked = {"client_id": self.settings.client_id, "post_logout_redirect_uri": f"{self.settings.home}/login"}
        return f"{endpoint}{'&' if '?' in endpoint else '?'}{urlencode(asked)}"

    async def finish(self, attempt: Attempt, answered: Mapping[str, str]) -> ProviderAnswer:
        """Check what a browser brought back, exchange its code, and return whom the ID token names."""
        if not hmac.compare_digest(answered.get("state", "").encode(), attempt.state.encode()):
            raise SingleSignOnError("This log-in was not begun in this browser; log in again.", "state")
        if "iss" in answered and answered["iss"] != self.settings.issuer:  # RFC 9207
            raise SingleSignOnError(
                "The answer came from another provider than the one of this server; log in again.", "issuer"
            )
        if "error" in answered:
            raise SingleSignOnError("The provider did not log you in; try again, or ask its administrator.", "denied")
        code = answered.get("code", "")
        if not code or len(code) > LONGEST_CODE:
            raise SingleSignOnError("The provider's answer has no code; log in again.", "code")
        found = await self._discover()
        token = await self._exchange(found, code, attempt.verifier)
        claims = await self._check(found, token, attempt)
        return self._read(claims)

    async def _exchange(self, found: _Discovered, code: str, verifier: str) -> Mapping[str, Any]:
        """Exchange a code for tokens."""
        form = {
            "grant_type": "authorization_code",
            "code": code,
            "redirect_uri": self.settings.redirect_uri,
            "code_verifier": verifier,
        }
        known, auth = self.settings, None
        methods = found.document.get("token_endpoint_auth_methods_supported") or ["client_secret_basic"]
        if not known.client_secret:
            form["client_id"] = known.client_id
        elif "client_secret_basic" in methods:
            auth = httpx.BasicAuth(
                quote(known.client_id, safe=""), quote(known.client_secret, safe="")
            )  # RFC 6749, 2.3.1
        else:
            form |= {"client_id": known.client_id, "client_secret": known.client_secret}
        status, answer = await _ask("POST", self._endpoint(found, "token_endpoint"), data=form, auth=auth)
        if status >= httpx.codes.INTERNAL_SERVER_ERROR:
            raise _unavailable(f"answered {status}")
        if status != httpx.codes.OK or not isinstance(answer.get("id_token"), str):
            raise SingleSignOnError(
                "The provider refused this log-in's code: it was used already or is too old; log in again.", "code"
            )
        return answer

    async def _check(self, found: _Discovered, token: Mapping[str, Any], attempt: Attempt) -> CodeIDToken:
        """Verify signature and claims of an ID token."""
        read = await self._decode(found, str(token["id_token"]))
        expected = {
            "iss": {"essential": True, "value": self.settings.issuer},
            "aud": {"essential": True, "value": self.settings.client_id},
            "sub": {"essential": True},
        }
        bound = {
            "nonce": attempt.nonce,
            "client_id": self.settings.client_id,
            "access_token": token.get("access_token"),
        }
        claims = CodeIDToken(read.claims, read.header, expected, bound)
        try:
            claims.validate(leeway=CLOCKS_DIFFER_S)
        except ExpiredTokenError as error:
            raise SingleSignOnError(
                "The provider's token has expired; log in again, and check both clocks.", "expired"
            ) from error
        except (JoseError, ValueError, TypeError) as error:
            claim = getattr(error, "claim", None) or "claims"
            raise SingleSignOnError(SENTENCES.get(claim, INCOMPLETE), REASONS.get(claim, "claims")) from error
        return claims

    async def read_log_out(self, given: str) -> ProviderLogOut:
        """Verify a log-out token as Back-Channel Logout 1.0, 2.6, has it, and return whom it names."""
        if not given or len(given) > LONGEST_TOKEN:
            raise SingleSignOnError("The request has no log-out token; send one as logout_token.", "claims")
        claims = (await self._decode(await self._discover(), given)).claims
        if "sub" not in claims and "sid" in claims:
            raise SingleSignOnError(
                "The log-out token identifies only a provider session (sid), not a person; such sessions are not stored here: have "
                "the provider put sub into its log-out tokens.",
                "claims",
            )
        needed = jwt.ClaimsOption(essential=True)
        registry = jwt.JWTClaimsRegistry(
            leeway=CLOCKS_DIFFER_S,
            iss=jwt.ClaimsOption(essential=True, value=self.settings.issuer),
            aud=jwt.ClaimsOption(essential=True, value=self.settings.client_id),
            sub=needed,
            iat=needed,
            exp=needed,
            jti=needed,
        )
        try:
            registry.validate(claims)
        except (JoseError, ValueError, TypeError) as error:
            claim = getattr(error, "claim", None) or "claims"
            raise SingleSignOnError(SENTENCES.get(claim, INCOMPLETE), REASONS.get(claim, "claims")) from error
        events = claims.get("events")
        if "nonce" in claims or not isinstance(events, dict) or not isinstance(events.get(LOG_OUT), dict):
            raise SingleSignOnError("The token is no log-out token; send one as logout_token.", "claims")
        return ProviderLogOut(self.settings.issuer, claims["sub"], max(0.0, float(claims["iat"])))

    async def _decode(self, found: _Discovered, given: str) -> jwt.Token:
        """Verify the signature of a token."""
        try:
            try:
                return jwt.decode(given, found.keys, algorithms=ALGORITHMS)
            except (InvalidKeyIdError, ValueError):  # a key that is newer than what was read
                return jwt.decode(given, (await self._discover(newer_than_s=found.read_s)).keys, algorithms=ALGORITHMS)
        except (JoseError, ValueError, TypeError) as error:
            raise SingleSignOnError(
                "The provider's token is not signed by a key of the provider; log in again, or tell an administrator.",
                "signature",
            ) from error

    def _read(self, claims: CodeIDToken) -> ProviderAnswer:
        """Return whom an ID token names, and the roles of their groups."""
        known = self.settings
        groups = claims.get(known.groups_claim)
        listed = [groups] if isinstance(groups, str) else groups if isinstance(groups, list) else []
        held = {group for group in listed[:MOST_GROUPS] if isinstance(group, str)}
        given = {role for group, role in known.roles if group in held}
        name, printed, at = claims.get(known.name_claim), claims.get("name"), claims.get("auth_time")
        return ProviderAnswer(
            issuer=known.issuer,
            subject=str(claims["sub"]),
            name=name if isinstance(name, str) else "",
            printed_name=printed if isinstance(printed, str) else "",
            roles=tuple(role for role in ROLES if role in given),
            authenticated_s=float(at) if isinstance(at, int | float) and not isinstance(at, bool) else None,
        )

    async def _discover(self, newer_than_s: float | None = None) -> _Discovered:
        """Return the discovery document and the keys, read again each hour and, at most once a minute, for an unknown key."""
        async with self._looking:
            known, now_s = self._known, time.monotonic()
            if known is not None:
                age_s = now_s - known.read_s
                wanted = newer_than_s is not None and known.read_s <= newer_than_s and age_s > KEYS_AGAIN_S
                if age_s < KEPT_FOR_S and not wanted:
                    return known
            issuer = self.settings.issuer
            status, document = await _ask("GET", f"{issuer.rstrip('/')}/.well-known/openid-configuration")
            if status != httpx.codes.OK:
                raise _unavailable(f"answered {status}")
            if document.get("issuer") != issuer:
                raise SingleSignOnError(
                    "The provider's issuer does not match BORESIGHT_OIDC_ISSUER; have the setting corrected.",
                    "issuer",
                )
            keys_at = self._endpoint(_Discovered(document, KeySet([]), 0.0), "jwks_uri")
            status, keys = await _ask("GET", keys_at)
            if status != httpx.codes.OK:
                raise _unavailable(f"answered {status}")
            try:
                read = KeySet.import_key_set({"keys": _list_signing_keys(keys)})
            except (JoseError, ValueError, TypeError, KeyError) as error:
                raise _unavailable("has keys that cannot be read") from error
            self._known = _Discovered(document, read, time.monotonic())
            return self._known

    def _endpoint(self, found: _Discovered, name: str) -> str:
        """Return an address of the discovery document, which must be encrypted as the issuer's is."""
        address = found.document.get(name)
        if not isinstance(address, str):
            raise _unavailable(f"names no {name}")
        parts = urlsplit(address)
        is_plain_too = urlsplit(self.settings.issuer).scheme == "http" and is_loopback(parts.hostname)
        if parts.scheme != "https" and not is_plain_too:
            raise _unavailable(f"has no https:// address as its {name}")
        return address


INCOMPLETE = "The provider's token lacks required claims; log in again, or tell an administrator."
SENTENCES = {
    "nonce": "The provider's token belongs to another log-in than this one; log in again.",
    "aud": "The provider's token is for another program than this server; log in again, or tell an administrator.",
    "azp": "The provider's token is for another program than this server; log in again, or tell an administrator.",
    "iss": "The provider's token is from another provider than the one of this server; tell an administrator.",
    "iat": "The provider's token is from the future; check both clocks and log in again.",
    "nbf": "The provider's token is from the future; check both clocks and log in again.",
}
REASONS = {"nonce": "nonce", "aud": "audience", "azp": "audience", "iss": "issuer", "iat": "clock", "nbf": "clock"}


def _list_signing_keys(document: Mapping[str, Any]) -> list[Any]:
    """Return the public keys for signatures: no symmetric one, and none for encryption."""
    keys = [key for key in document.get("keys") or [] if isinstance(key, dict)]
    return [key for key in keys if key.get("kty") in {"RSA", "EC", "OKP"} and key.get("use", "sig") == "sig"]


async def _ask(method: str, address: str, **given: Any) -> tuple[int, Mapping[str, Any]]:
    """Ask the provider, within limits of time and size, and read its JSON; redirects are not followed."""
    headers = {"Accept": "application/json", "User-Agent": f"boresight/{boresight.__version__}"}
    content = bytearray()
    try:
        async with (
            asyncio.timeout(2 * TIMEOUT_S),
            httpx.AsyncClient(timeout=TIMEOUT_S, follow_redirects=False) as client,
            client.stream(method, address, headers=headers, **given) as answer,
        ):
            async for piece in answer.aiter_bytes():
                content += piece
                if len(content) > LONGEST_ANSWER:
                    raise _unavailable("answers with more than a megabyte")
        document = orjson.loads(bytes(content) or b"{}")
    except (httpx.HTTPError, httpx.InvalidURL, TimeoutError, OSError) as error:
        raise _unavailable("does not answer") from error
    except orjson.JSONDecodeError:
        document = {}
    return answer.status_code, document if isinstance(document, dict) else {}


def _unavailable(what: str) -> UnavailableError:
    return UnavailableError(f"The provider of single sign-on {what}; try again, or log in with a local account.")
