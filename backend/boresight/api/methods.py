"""Which methods an address takes: all of its routes' together, in the `Allow` of a 405 and in the answer to OPTIONS.

The framework names those of the first route that it meets (RFC 9110, 10.2.1 asks for all).
"""

from __future__ import annotations

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Match

METHODS = ("GET", "POST", "PUT", "PATCH", "DELETE")
NOT_ALLOWED = 405


def allowed(request: Request) -> list[str]:
    """Return the methods that the address of a request takes."""
    routes: list[BaseRoute] = request.app.router.routes
    scope = {name: value for name, value in request.scope.items() if name not in {"route", "endpoint", "path_params"}}
    takes = [
        method
        for method in METHODS
        if any(route.matches({**scope, "method": method})[0] is Match.FULL for route in routes)
    ]
    return [*takes, *(["HEAD"] if "GET" in takes else []), "OPTIONS"]


def answer_options(request: Request, error: Exception) -> Response | None:
    """Answer OPTIONS of an address that there is; None where that is not what was asked."""
    if request.method != "OPTIONS" or getattr(error, "status_code", None) != NOT_ALLOWED:
        return None
    return Response(status_code=204, headers={"Allow": ", ".join(allowed(request))})


def with_allow(request: Request, error: Exception) -> Exception:
    """Return an error with every method of the address in its `Allow`, where it says that the one asked is none of them."""
    if not isinstance(error, HTTPException) or error.status_code != NOT_ALLOWED:
        return error
    takes = ", ".join(allowed(request))
    sentence = f"This address does not take {request.method}; it takes {takes}."
    return HTTPException(NOT_ALLOWED, sentence, headers={"Allow": takes})
