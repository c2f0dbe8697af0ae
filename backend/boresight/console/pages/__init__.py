"""The pages. One file a page, each with a `router`; this package finds and joins them. A new page is one new file."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from fastapi import APIRouter, Depends
from fastapi.responses import HTMLResponse

from boresight.console.pages.frame import know_fleet
from boresight.console.pages.rendering import check_numbers


def join(routes: APIRouter) -> None:
    """Join the `router` of every page file to the routes of a server."""
    first = [Depends(check_numbers), Depends(know_fleet)]
    for found in iter_modules(__path__):
        page = import_module(f"{__name__}.{found.name}")
        if hasattr(page, "router"):
            routes.include_router(
                page.router, include_in_schema=False, default_response_class=HTMLResponse, dependencies=first
            )
