"""The figure cache: the bytes of the figures drawn last, with entity tags for the browser's own cache."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import plotly
from starlette.requests import Request
from starlette.responses import Response

from boresight import figures
from boresight.platform.db.data_version import SizeLimitedCache

KEPT_BYTES = 64 << 20
ASK_AGAIN = {"Cache-Control": "private, no-cache"}  # the browser caches it, but revalidates
NOT_MODIFIED = 304


@cache
def figures_version() -> str:
    """Return the hash of the code and data that figures depend on."""
    digest = hashlib.sha256(plotly.__version__.encode())
    for source in sorted(Path(figures.__file__).parent.rglob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()


class FigureCache:
    """A cache of recently drawn figures as bytes."""

    def __init__(self) -> None:
        self._recent: SizeLimitedCache[bytes] = SizeLimitedCache(KEPT_BYTES)

    def answer(self, request: Request, parts: Sequence[str] | None, draw: Callable[[], bytes]) -> Response:
        """Return the response with a figure."""
        if parts is None:
            return Response(draw(), media_type="application/json", headers={"Cache-Control": "no-store"})
        digest = hashlib.sha256("\0".join((figures_version(), *parts)).encode()).hexdigest()[:32]
        headers = {**ASK_AGAIN, "ETag": f'"{digest}"'}
        if digest in request.headers.get("if-none-match", ""):
            return Response(status_code=NOT_MODIFIED, headers=headers)

        def make() -> tuple[bytes, int]:
            content = draw()
            return content, len(content)

        return Response(self._recent.get(digest, make), media_type="application/json", headers=headers)
