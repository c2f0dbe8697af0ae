"""Setting one's own password: what a person must do first to whom somebody else gave one."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Who, clear_cookie, client_of, csrf
from boresight.api.passwords import Passwords
from boresight.errors import RefusedInputError
from boresight.pages.attempts import Refusal, attempt
from boresight.pages.rendering import redirect, render
from boresight.services import users
from boresight.services.actors import Actor, require_person
from boresight.services.passwords import MINIMUM_PASSWORD_LENGTH, NewPassword, PasswordProof
from boresight.store.sessions import Session

router = APIRouter(prefix="/password", dependencies=[Depends(csrf)])


@router.get("", response_class=HTMLResponse)
def password_page(request: Request, actor: Who) -> HTMLResponse:  # noqa: ARG001 - who is not logged in has none to set
    """Show the form."""
    return _page(request, None)


def _page(request: Request, refusal: Refusal | None) -> HTMLResponse:
    """Render the form, with why it was refused."""
    sentence = refusal.sentence if refusal else ""
    return render(
        request, "access/password.html", refused=refusal, refusal=sentence, minimum_length=MINIMUM_PASSWORD_LENGTH
    )


@router.post("", response_class=HTMLResponse)
async def change_password(
    request: Request,
    actor: Who,
    current: Annotated[str, Form()] = "",
    password: Annotated[str, Form()] = "",
    repeated: Annotated[str, Form()] = "",
) -> Response:
    """Set one's own password; every log-in then ends, this one too."""
    checks: Passwords = request.app.state.passwords
    user_id = require_person(actor, "set a password")

    async def prepare() -> tuple[NewPassword, PasswordProof]:
        if password != repeated:
            raise RefusedInputError("The two new passwords differ; type the same one twice.")
        return await checks.prepare_change(actor, user_id, password, current, client_of(request))

    outcome = await attempt(request, partial(set_password, actor, user_id), prepare)
    if outcome.refusal is not None:
        return await run_in_threadpool(_page, request, outcome.refusal)
    response = redirect("/login", flash="Your password is changed; log in with the new one.")
    clear_cookie(request, response)
    return response


def set_password(actor: Actor, user_id: int, session: Session, password: NewPassword, current: PasswordProof) -> None:
    """Change the password of who acts."""
    users.change_password(session, actor, user_id, password, current)
