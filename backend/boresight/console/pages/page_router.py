"""The router of a noun's pages: HTML, not part of the API's description, each with what its frame shows."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter, Depends
from fastapi.params import Depends as Dependency
from fastapi.responses import HTMLResponse

from boresight.console.access.credentials import get_actor
from boresight.console.pages.frame import know_fleet
from boresight.console.pages.rendering import check_numbers
from boresight.platform.web.lazy_route import LazyRoute


class PageRouter(APIRouter):
    """A router of pages; every module of pages declares its own. They are for people who are logged in, unless `open_to_all`."""

    def __init__(self, *, prefix: str = "", dependencies: Sequence[Dependency] = (), open_to_all: bool = False) -> None:
        guard = () if open_to_all else (Depends(get_actor),)
        super().__init__(
            prefix=prefix,
            dependencies=[Depends(check_numbers), Depends(know_fleet), *dependencies, *guard],
            default_response_class=HTMLResponse,
            include_in_schema=False,
            route_class=LazyRoute,
        )
