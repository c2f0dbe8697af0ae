"""A refusal as a page: what happened, what to do, and the request id to quote; a log-in where that is what is missing."""

from __future__ import annotations

import logging
from contextlib import suppress
from http import HTTPStatus
from urllib.parse import quote

from fastapi import Request
from fastapi.responses import HTMLResponse, Response
from starlette.exceptions import HTTPException

from boresight.console.access import users
from boresight.console.access.credentials import current_actor
from boresight.console.pages.rendering import TEMPLATES, redirect, render
from boresight.errors import PasswordDueError, SessionEndedError, UnauthenticatedError
from boresight.platform.db.sessions import open_reading
from boresight.platform.web.problems import make_problem

log = logging.getLogger(__name__)

FORBIDDEN = HTTPStatus.FORBIDDEN
NOBODY = "No administrator is left to give one; boresight user add on the server makes one."
SENTENCE = {404: "There is no page at this address.", 405: "This address does not take what was sent."}
ADVICE = {
    400: "Go back, reload the page and send its form again.",
    403: "Go back; if it is a role that you lack, ask for it.",
    404: "It may have another number, or the address was copied incompletely.",
    405: "Open the page by a link or by the navigation, and use its buttons.",
    409: "Read the thing again to see its state now, then decide anew.",
    412: "Somebody changed it after you opened the page. Go back, reload, and look at what is there now.",
    413: "Split the file, or ask an administrator to raise the limit.",
    422: "Nothing was stored. Go back, correct what is named here, and send it again.",
    428: "Go back, reload the page and do it from there.",
    429: "Wait as long as the sentence says; nothing of this request was stored.",
    500: "Nothing of this request was stored. Try again; if it fails again, report the request id below.",
    503: "Wait a moment and try again; if it stays so, tell whoever keeps the server, with the request id below.",
}
ADVICE_OF_ANY = "Go back and try again; if it fails again, report the request id below."


def is_page(request: Request) -> bool:
    """Tell whether a person's browser asks, and not a program."""
    return not request.url.path.startswith("/api/") and "text/html" in request.headers.get("accept", "")


def problem_page(request: Request, error: Exception) -> Response:
    """Answer an error as a page; who is not logged in is sent to the log-in and back."""
    if isinstance(error, PasswordDueError):
        return redirect("/password")
    if isinstance(error, UnauthenticatedError):
        ended = f"&ended={error.because}" if isinstance(error, SessionEndedError) else ""
        return redirect(f"/login?next={quote(_way_back(request), safe='')}{ended}")
    with suppress(Exception):  # an address that does not exist asked nobody who acts; a broken store cannot say
        current_actor(request)
    problem = make_problem(error)
    return render(
        request,
        "shared/problem.html",
        status_code=problem.status,
        headers=problem.headers,
        problem=problem,
        sentence=SENTENCE.get(problem.status, problem.detail) if isinstance(error, HTTPException) else problem.detail,
        advice=ADVICE.get(problem.status, ADVICE_OF_ANY) + _who_grants(request, problem.status),
        request_id=getattr(request.state, "request_id", None),
    )


def _who_grants(request: Request, status: int) -> str:
    """Name who can give a role, to who is known and lacks it."""
    if status != FORBIDDEN or getattr(request.state, "actor", None) is None:
        return ""
    try:
        with open_reading(request.app.state.engine) as session:
            names = users.administrators(session)
    except Exception:
        log.exception("A refusal could not name the administrators")
        return ""
    said = f"On the page Users and keys {' or '.join(names)} can give roles." if names else NOBODY
    return f" {said}"


def bare_problem_page(request: Request, error: Exception) -> Response:
    """Answer an error where even the frame around a page cannot be made: its sentence and the request id, alone."""
    problem = make_problem(error)
    page = TEMPLATES.get_template("shared/bare_problem.html").render(
        problem=problem,
        advice=ADVICE.get(problem.status, ADVICE_OF_ANY),
        request_id=getattr(request.state, "request_id", None),
    )
    return HTMLResponse(
        page, status_code=problem.status, headers={**(problem.headers or {}), "Cache-Control": "no-store"}
    )


def _way_back(request: Request) -> str:
    """Return the address to open after the log-in: the one asked for, or the start after a form."""
    if request.method != "GET":
        return "/"
    return request.url.path + (f"?{request.url.query}" if request.url.query else "")
