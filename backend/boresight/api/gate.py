"""How many requests may be under way: who comes when there are too many is told so at once, and when to come back.

A request that needs the store waits for one of a few threads. Without a bound a crowd would fill the queue until everybody's
patience is over before their turn comes, and the server would work for people who have left. With it, whoever is let in is answered
within seconds, and the rest know it within a millisecond: 503 and `Retry-After`. What stands ready, files of the pages, event
streams and the routes by which the server is watched need no thread of the few, and are always let in.
"""

from __future__ import annotations

from collections.abc import Callable

from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from boresight.errors import OverloadedError

MOST_UNDER_WAY = 512
COME_BACK_S = 2
ALWAYS = ("/static/", "/healthz", "/readyz", "/metrics", "/api/v1/events")
Refuse = Callable[[Request, Exception], Response]


class Gate:
    """The layer that counts.

    Parameters
    ----------
    refuse
        Makes the answer to who is turned away; must need no thread and no store.
    most
        Requests under way at once.
    """

    def __init__(self, app: ASGIApp, refuse: Refuse, most: int = MOST_UNDER_WAY) -> None:
        self.app = app
        self.under_way = 0
        self._refuse = refuse
        self._most = most

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request in, or turn it away."""
        if scope["type"] != "http" or scope["path"].startswith(ALWAYS):
            await self.app(scope, receive, send)
        elif self.under_way >= self._most:
            sentence = (
                f"{self._most} requests are under way, as many as this server takes; ask again in {COME_BACK_S} s."
            )
            await self._refuse(Request(scope), OverloadedError(sentence, COME_BACK_S))(scope, receive, send)
        else:
            self.under_way += 1
            try:
                await self.app(scope, receive, send)
            finally:
                self.under_way -= 1
