"""Where a request comes from: a page of another site, or this machine itself.

A browser says by `Origin` which site's page made an unsafe request, and by `Sec-Fetch-Site` whether that is ours. Either
one is enough to refuse it, whatever cookie comes along and also where none does: logging somebody in from another site is
an attack too. Programs send neither. With an API key nothing is refused: no other site can make a browser send that header.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Callable
from http import HTTPMethod
from urllib.parse import SplitResult, urlsplit

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from boresight.errors import ForbiddenError
from boresight.hosts import is_loopback
from boresight.platform.audit.security_log import tell

SAFE_METHODS = frozenset({HTTPMethod.GET, HTTPMethod.HEAD, HTTPMethod.OPTIONS})
DEFAULT_PORTS = {"http": 80, "https": 443}
FORWARDED = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-forwarded-proto", "x-real-ip", "via")
SENTENCE = "This request was made by a page of another site; make it from Boresight's own pages."


class OriginCheck:
    """The middleware that refuses requests from pages of other sites."""

    def __init__(self, app: ASGIApp, refuse: Callable[[Request, Exception], Response], public_url: str = "") -> None:
        self.app = app
        self._refuse = refuse
        self._public_url = public_url

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] == "http" and scope["method"] not in SAFE_METHODS:
            headers = Headers(scope=scope)
            if not _carries_key(headers) and is_foreign(headers, self._public_url):
                tell("malicious_cors", "failure", origin=headers.get("origin"))
                await self._refuse(Request(scope), ForbiddenError(SENTENCE))(scope, receive, send)
                return
        await self.app(scope, receive, send)


def _carries_key(headers: Headers) -> bool:
    return headers.get("authorization", "").lower().startswith("bearer ")


def is_foreign(headers: Headers, public_url: str = "") -> bool:
    """Whether a browser says that a page of another site made a request.

    An origin is ours when it is the public address, or names the host and port that the request was sent to, as the
    browser or a proxy before us wrote them. The scheme is compared only with the public address: behind a proxy we do
    not know under which one the page was read. No page can set the headers of a proxy without being asked for leave first.
    """
    if headers.get("sec-fetch-site") == "cross-site":
        return True
    origins = headers.getlist("origin")
    if not origins:
        return False
    origin = _split(origins[0])
    if len(origins) > 1 or origin is None or origin.scheme not in DEFAULT_PORTS:
        return True  # "null" is the origin of a page that hides its own
    if public_url and origin.geturl() == _parse_origin(public_url):
        return False
    hosts = [headers.get("host", ""), *headers.get("x-forwarded-host", "").split(",")[:1]]
    return not any(_same_authority(origin, host.strip()) for host in hosts if host.strip())


def _split(address: str) -> SplitResult | None:
    """Parse an origin; None where it is invalid."""
    try:
        parts = urlsplit(address.lower())
        port = parts.port
    except ValueError:
        return None
    return parts if parts.hostname and port != 0 and not (parts.path or parts.query) else None


def _parse_origin(address: str) -> str:
    """Return the origin of an address as a browser writes it."""
    parts = urlsplit(address.lower())
    host = f"[{parts.hostname}]" if ":" in (parts.hostname or "") else parts.hostname
    port = "" if parts.port in {None, DEFAULT_PORTS.get(parts.scheme)} else f":{parts.port}"
    return f"{parts.scheme}://{host}{port}"


def _same_authority(origin: SplitResult, host: str) -> bool:
    """Whether an origin has this host and port; a port that is not written is the default one of the origin's scheme."""
    default = DEFAULT_PORTS[origin.scheme]
    sent_to = _split(f"{origin.scheme}://{host}")
    return sent_to is not None and (sent_to.hostname, sent_to.port or default) == (
        origin.hostname,
        origin.port or default,
    )


def get_network(address: str) -> str:
    """Return the network by which an address is counted: itself, or for IPv6 its /64, which belongs to one subscriber."""
    try:
        number = ipaddress.ip_address(address)
    except ValueError:
        return address
    if isinstance(number, ipaddress.IPv4Address):
        return address
    mapped = number.ipv4_mapped
    return str(mapped or ipaddress.ip_network((int(number), 64), strict=False))


def is_local(request: Request) -> bool:
    """Whether a request was made on this machine to a server that only this machine reaches.

    What a proxy passed on was not, however near the proxy is.
    """
    client = request.client.host if request.client else None
    forwarded = any(name in request.headers for name in FORWARDED)
    hosts = (
        request.app.state.settings.host,
        client,
        request.url.hostname,
    )  # checked last, because the name of another site may resolve to this machine
    return not forwarded and all(map(is_loopback, hosts))


def is_own_path(address: str) -> bool:
    """Whether an address is a path of this server, wherever a browser reads it."""
    return address.startswith("/") and not address.startswith(("//", "/\\")) and address.isprintable()
