"""Which coding of an answer a request accepts: read once at the border, for everything behind it.

RFC 9110, 12.5.3: `Accept-Encoding` lists codings, each with a weight between 0 and 1, which is 1 where none is given. Capitals are
small letters, a weight of 0 says "not this one", and `*` stands for every coding that is not named. Plain bytes (`identity`) are
preferred where they are named with the greater weight. A weight that cannot be read counts as 0: plain bytes are always understood.
"""

from __future__ import annotations

from functools import lru_cache

from starlette.types import ASGIApp, Receive, Scope, Send

ACCEPT_ENCODING = b"accept-encoding"
GZIP = b"gzip"
SPELLINGS = (b"gzip", b"x-gzip")  # RFC 9110, 8.4.1.3


@lru_cache(maxsize=64)  # browsers and programs send few different ones
def takes_gzip(accepted: bytes) -> bool:
    """Say whether an answer may be sent with gzip.

    Parameters
    ----------
    accepted
        The value of `Accept-Encoding`; several of them joined by commas; empty where there is none.
    """
    weights = dict(_weighed(element) for element in accepted.lower().split(b","))
    named = [weights[name] for name in SPELLINGS if name in weights]
    weight = max(named) if named else weights.get(b"*", 0.0)
    return weight > 0 and weight >= weights.get(b"identity", 0.0)


def _weighed(element: bytes) -> tuple[bytes, float]:
    """Read a coding and its weight."""
    name, _, parameter = element.partition(b";")
    key, _, value = parameter.partition(b"=")
    if not parameter.strip():
        return name.strip(), 1.0
    try:
        weight = float(value) if key.strip() == b"q" else 0.0
    except ValueError:
        weight = 0.0
    return name.strip(), weight if 0 <= weight <= 1 else 0.0


class Codings:
    """The layer that writes `Accept-Encoding` as what is done about it: `gzip`, or not there at all."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request in."""
        if scope["type"] == "http":
            accepted = b",".join(value for name, value in scope["headers"] if name == ACCEPT_ENCODING)
            others = [pair for pair in scope["headers"] if pair[0] != ACCEPT_ENCODING]
            scope["headers"] = [*others, (ACCEPT_ENCODING, GZIP)] if takes_gzip(accepted) else others
        await self.app(scope, receive, send)
