"""The API's documentation: Swagger UI, as a Python package ships it, over this server's own OpenAPI document."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import HTMLResponse, RedirectResponse

from boresight.resources import folder

router = APIRouter(include_in_schema=False)


@router.get("/docs")
def documentation() -> HTMLResponse:
    """Show every operation, and let who is logged in or has a key try it."""
    return HTMLResponse((folder("frontend") / "templates" / "shared/documentation.html").read_text())


@router.get("/api/v1/docs")
def documentation_of_version() -> RedirectResponse:
    """Lead to the page from beside the routes that it documents."""
    return RedirectResponse("/docs")
