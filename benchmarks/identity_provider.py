"""A stand-in for an identity provider that follows OpenID Connect: discovery, keys, authorization and token endpoint.

It holds the relying party to the standard: the registered redirect address, PKCE by S256, client authentication, each code
once. A test changes `claims`, `key` and the rest to have it misbehave.
"""

import base64
import hashlib
import json
import secrets
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, quote, unquote, urlencode, urlsplit

from joserfc import jwt
from joserfc.jwk import ECKey, OctKey

from benchmarks.servers import listening

CLIENT_ID, CLIENT_SECRET = "boresight", "a secret: of % signs & more"
LOG_OUT = "http://schemas.openid.net/event/backchannel-logout"


def _key(kid: str) -> ECKey:
    return ECKey.generate_key("P-256", {"kid": kid, "use": "sig", "alg": "ES256"})


@dataclass
class Provider:
    """The provider's state, and whom it logs in."""

    issuer: str = ""
    redirect_uri: str = ""
    person: dict[str, Any] = field(default_factory=dict)
    claims: dict[str, Any] = field(default_factory=dict)  # in place of the right ones; None takes one away
    published: list[ECKey] = field(default_factory=lambda: [_key("first")])
    key: Any = None  # what signs, in place of the first published
    algorithm: str = "ES256"
    token_answer: dict[str, Any] | None = None
    error: str = ""
    discovery: dict[str, Any] = field(default_factory=dict)
    asked: list[dict[str, str]] = field(default_factory=list)
    _codes: dict[str, dict[str, str]] = field(default_factory=dict)
    _last_log_in_s: dict[str, int] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """Return the discovery document."""
        return {
            "issuer": self.issuer,
            "authorization_endpoint": f"{self.issuer}/authorize",
            "token_endpoint": f"{self.issuer}/token",
            "jwks_uri": f"{self.issuer}/keys",
            "end_session_endpoint": f"{self.issuer}/log-out",
            **self.discovery,
        }

    def authorize(self, asked: dict[str, str]) -> str:
        """Log the person in without asking, and return where the browser is sent back to."""
        self.asked.append(asked)
        assert asked["response_type"] == "code"
        assert asked["client_id"] == CLIENT_ID
        assert asked["redirect_uri"] == self.redirect_uri
        assert asked["code_challenge_method"] == "S256"
        assert "openid" in asked["scope"].split()
        now, subject = int(time.time()), str(self.person.get("sub"))
        if asked.get("prompt") == "login" or subject not in self._last_log_in_s:
            self._last_log_in_s[subject] = now
        back = {"state": asked["state"], "iss": self.issuer}
        if self.error:
            return f"{self.redirect_uri}?{urlencode({**back, 'error': self.error})}"
        code = secrets.token_urlsafe(16)
        self._codes[code] = {**asked, "auth_time": str(self._last_log_in_s[subject])}
        return f"{self.redirect_uri}?{urlencode({**back, 'code': code})}"

    def token(self, form: dict[str, str], authorization: str) -> tuple[int, dict[str, Any]]:
        """Exchange a code, once."""
        given = base64.b64decode(authorization.removeprefix("Basic ")).decode().partition(":")
        if (unquote(given[0]), unquote(given[2])) != (CLIENT_ID, CLIENT_SECRET):
            return 401, {"error": "invalid_client"}
        asked = self._codes.pop(form.get("code", ""), None)
        verifier = hashlib.sha256(form.get("code_verifier", "").encode()).digest()
        challenge = base64.urlsafe_b64encode(verifier).decode().rstrip("=")
        if asked is None or asked["code_challenge"] != challenge or form["redirect_uri"] != asked["redirect_uri"]:
            return 400, {"error": "invalid_grant"}
        if self.token_answer is not None:
            return 200, self.token_answer
        now = int(time.time())
        claims = {
            "iss": self.issuer,
            "aud": CLIENT_ID,
            "exp": now + 300,
            "iat": now,
            "nonce": asked["nonce"],
            "auth_time": int(asked["auth_time"]),
            **self.person,
            **self.claims,
        }
        claims = {name: value for name, value in claims.items() if value is not None}
        key = self.key or self.published[0]
        header = {"alg": self.algorithm, "kid": key.kid or "first"}
        signed = jwt.encode(header, claims, key, algorithms=[self.algorithm])
        return 200, {"access_token": "opaque", "token_type": "Bearer", "id_token": signed}

    def make_log_out_token(self, **claims: Any) -> str:
        """Return a log-out token of the person, as Back-Channel Logout 1.0, 2.4, has it; None takes a claim away."""
        now = int(time.time())
        right = {
            "iss": self.issuer,
            "aud": CLIENT_ID,
            "iat": now,
            "exp": now + 120,
            "jti": secrets.token_urlsafe(8),
            "events": {LOG_OUT: {}},
            "sub": self.person["sub"],
            "sid": "the provider's own session",
        }
        told = {name: value for name, value in {**right, **claims}.items() if value is not None}
        key = self.key or self.published[0]
        header = {"alg": self.algorithm, "kid": key.kid or "first", "typ": "logout+jwt"}
        return jwt.encode(header, told, key, algorithms=[self.algorithm])


class _Handler(BaseHTTPRequestHandler):
    provider: Provider

    def _send(self, status: int, body: Any = None, location: str = "") -> None:
        content = json.dumps(body).encode()
        self.send_response(status)
        if location:
            self.send_header("Location", location)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def do_GET(self) -> None:
        parts = urlsplit(self.path)
        if parts.path == "/authorize":
            asked = {name: values[0] for name, values in parse_qs(parts.query).items()}
            self._send(302, location=self.provider.authorize(asked))
        elif parts.path == "/keys":
            self._send(200, {"keys": [key.as_dict(private=False) for key in self.provider.published]})
        elif parts.path == "/.well-known/openid-configuration":
            self._send(200, self.provider.document())
        else:
            self._send(404)

    def do_POST(self) -> None:
        length = int(self.headers["Content-Length"])
        form = {name: values[0] for name, values in parse_qs(self.rfile.read(length).decode()).items()}
        self._send(*self.provider.token(form, self.headers.get("Authorization", "")))

    def log_message(self, *_: Any) -> None:
        """Say nothing."""


@contextmanager
def providing() -> Iterator[Provider]:
    """Serve a provider on a port of its own."""
    provider = Provider()
    handler = type("Handler", (_Handler,), {"provider": provider})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    with listening(server) as port:
        provider.issuer = f"http://127.0.0.1:{port}"
        yield provider


def symmetric_key(published: ECKey) -> OctKey:
    """Return the public key's own bytes as a secret: what an attacker signs with where any algorithm is taken."""
    return OctKey.import_key(json.dumps(published.as_dict(private=False), sort_keys=True))


def other_key(kid: str = "first") -> ECKey:
    """Return a key that the provider did not publish, by the name of one that it did."""
    return _key(kid)


def encoded(text: str) -> str:
    """Return a text as an address has it."""
    return quote(text, safe="")
