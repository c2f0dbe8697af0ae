"""Logging in and out. The way back (`?next=`) is followed only inside this server."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request
from fastapi.responses import HTMLResponse, Response

from boresight.api.credentials import current_actor
from boresight.api.dependencies import csrf, log_in_person, log_out_person
from boresight.errors import UnauthenticatedError
from boresight.pages.attempts import attempt
from boresight.pages.rendering import redirect, render
from boresight.store.sessions import Session

router = APIRouter()


def local_path(address: str) -> str:
    """Return an address of this server as it is, and the start page for any other."""
    inside = address.startswith("/") and not address.startswith(("//", "/\\"))
    return address if inside and address.isprintable() else "/"


@router.get("/login", response_class=HTMLResponse)
def login_page(request: Request, next: str = "/") -> Response:  # noqa: A002 - the name in the address
    """Show the form; who is logged in already goes on."""
    try:
        current_actor(request)
    except UnauthenticatedError:
        return render(request, "login.html", next=local_path(next), name="", refusal=None)
    return redirect(local_path(next))


@router.post("/login", response_class=HTMLResponse)
async def log_in(
    request: Request,
    name: Annotated[str, Form()] = "",
    password: Annotated[str, Form()] = "",
    next: Annotated[str, Form()] = "/",  # noqa: A002 - the name in the form
) -> Response:
    """Check name and password; the answer to a wrong one does not tell which of the two it was."""
    response = redirect(local_path(next))
    refusal = (await attempt(request, partial(_check, request, response, name, password))).refusal
    if refusal is None:
        return response
    page = render(
        request, "login.html", status_code=refusal.status, next=local_path(next), name=name, refusal=refusal.sentence
    )
    page.headers.update(refusal.headers)
    return page


def _check(request: Request, response: Response, name: str, password: str, session: Session) -> None:
    """Log a person in within the transaction, where failures are counted."""
    log_in_person(request, response, session, name, password)


@router.post("/logout", dependencies=[Depends(csrf)])
def log_out(request: Request) -> Response:
    """End this log-in."""
    response = redirect("/login", flash="You are logged out.")
    log_out_person(request, response)
    return response
