"""The pages: what all of them share, and where every noun's pages are found and added to a server."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pkgutil import walk_packages
from types import ModuleType

from fastapi import APIRouter

from boresight import console
from boresight.console.pages.page_router import PageRouter


def modules() -> Iterator[ModuleType]:
    """Yield every module of pages: `pages` of a noun, or each in a noun's folder `pages`."""
    prefix = f"{console.__name__}."
    for found in walk_packages(console.__path__, prefix):
        if "pages" in found.name.removeprefix(prefix).split(".")[1:]:
            yield import_module(found.name)


def routers(module: ModuleType) -> Iterator[PageRouter]:
    """Yield every router that a module of pages declares, in the order in which it declares them."""
    yield from (value for value in vars(module).values() if isinstance(value, PageRouter))


def include_pages(routes: APIRouter) -> None:
    """Join the pages to the routes of a server, directly, because the framework matches and resolves an included router's twice."""
    for page in modules():
        for router in routers(page):
            routes.routes.extend(router.routes)
