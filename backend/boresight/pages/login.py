"""Logging in and out. The way back (`?next=`) is followed only inside this server."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.api.credentials import current_actor
from boresight.api.dependencies import clear_cookie, client_of, csrf, log_in_person
from boresight.api.passwords import Passwords
from boresight.errors import SessionEndedError, UnauthenticatedError
from boresight.pages.attempts import attempt
from boresight.pages.rendering import redirect, render
from boresight.services import sessions
from boresight.services.passwords import PasswordProof

router = APIRouter()


def local_path(address: str) -> str:
    """Return an address of this server as it is, and the start page for any other."""
    inside = address.startswith("/") and not address.startswith(("//", "/\\"))
    return address if inside and address.isprintable() else "/"


@router.get("/login", response_class=HTMLResponse)
def login_page(request: Request, next: str = "/", ended: str = "") -> Response:  # noqa: A002 - the name in the address
    """Show the form, and why the log-in of before has ended; who is logged in already goes on."""
    try:
        current_actor(request)
    except UnauthenticatedError:
        said = SessionEndedError.SENTENCES.get(ended)
        return render(request, "access/login.html", next=local_path(next), name="", refusal=None, ended=said)
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
    checks: Passwords = request.app.state.passwords

    async def prove() -> tuple[PasswordProof]:
        return (await checks.check_log_in(name, password, client_of(request)),)

    refusal = (await attempt(request, partial(log_in_person, request, response), prove)).refusal
    if refusal is None:
        return response
    return render(
        request,
        "access/login.html",
        refused=refusal,
        next=local_path(next),
        name=name,
        refusal=refusal.sentence,
        ended=None,
    )


@router.post("/logout", dependencies=[Depends(csrf)])
async def log_out(request: Request) -> Response:
    """End this log-in, wherever its cookie was copied to."""
    response = redirect("/login", flash="You are logged out.")
    clear_cookie(request, response)
    try:
        actor = await run_in_threadpool(current_actor, request)
    except UnauthenticatedError:
        return response  # it has ended already
    outcome = await attempt(request, partial(sessions.log_out, actor=actor))
    if outcome.refusal is not None and outcome.refusal.is_ours:
        raise outcome.refusal.error  # a copied cookie would still be let in
    return response
