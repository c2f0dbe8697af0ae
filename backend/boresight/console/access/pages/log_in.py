"""Pages of logging in, by password and second factor, and of logging out."""

from __future__ import annotations

from functools import partial
from typing import Annotated
from urllib.parse import quote

from fastapi import Depends, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.console.access import second_factors, sessions, users
from boresight.console.access.credentials import current_actor
from boresight.console.access.dependencies import (
    PasswordChecks,
    Reading,
    begin_session,
    clear_cookie,
    csrf,
    get_client,
    get_site,
    log_in_or_wait,
    waiting_cookie,
)
from boresight.console.access.passwords import PasswordProof
from boresight.console.access.second_factors import GivenFactor
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext, attempt, redirect, render
from boresight.errors import SecondFactorError, SessionEndedError, UnauthenticatedError
from boresight.platform.db.sessions import Session, open_reading
from boresight.platform.web.origins import is_own_path

login_router = PageRouter(open_to_all=True)


def local_path(address: str) -> str:
    """Return an address of this server unchanged, and the start page in place of any other."""
    return address if is_own_path(address) else "/"


def show_log_in(
    request: Request, back: str, *, name: str = "", ended: str | None = None, refusal: RefusalContext | None = None
) -> HTMLResponse:
    """Show the log-in form."""
    provider = request.app.state.identity_provider
    return render(
        request,
        "access/login.html",
        refused=refusal,
        next=local_path(back),
        name=name,
        refusal=refusal.sentence if refusal else None,
        code=refusal.code if refusal else "",
        ended=ended,
        provider=provider.settings.label if provider else "",
        asked=quote(local_path(back), safe=""),
    )


@login_router.get("/login", response_class=HTMLResponse)
def login_page(request: Request, next: str = "/", ended: str = "") -> Response:  # noqa: A002 - the name in the address
    """Show the log-in form, and why the last log-in ended; redirect a person who is logged in already."""
    try:
        current_actor(request)
    except UnauthenticatedError:
        return show_log_in(request, next, ended=SessionEndedError.SENTENCES.get(ended))
    return redirect(local_path(next))


@login_router.post("/login", response_class=HTMLResponse)
async def log_in(
    request: Request,
    checks: PasswordChecks,
    name: Annotated[str, Form()] = "",
    password: Annotated[str, Form()] = "",
    next: Annotated[str, Form()] = "/",  # noqa: A002 - the name in the form
) -> Response:
    """Check name and password; the answer to a wrong one does not tell which of the two it was."""
    response = redirect(local_path(next))

    async def prove() -> tuple[PasswordProof]:
        return (await checks.check_log_in(name, password, get_client(request)),)

    def enter(session: Session, proof: PasswordProof) -> bool:
        actor = users.authenticate(session, proof, request.state.request_id)
        return log_in_or_wait(request, response, session, actor, "password")

    outcome = await attempt(request, enter, prove)
    if outcome.refusal is not None:
        return show_log_in(request, next, name=name, refusal=outcome.refusal)
    return wait_for_factor(response, next) if outcome.value else response


def wait_for_factor(response: Response, back: str) -> Response:
    """Send a browser that passed the first step on to the second."""
    response.headers["location"] = f"/login/second-factor?next={quote(local_path(back), safe='')}"
    return response


@login_router.get("/login/second-factor", response_class=HTMLResponse)
def second_factor_page(request: Request, session: Reading, next: str = "/") -> Response:  # noqa: A002 - the name in the address
    """Ask for the second factor of a log-in that waits."""
    return _second_factor_page(request, next, None, session)


def _second_factor_page(request: Request, back: str, refusal: RefusalContext | None, session: Session) -> Response:
    content = waiting_cookie(request).read(request)
    try:
        waiting = second_factors.find_waiting(session, content[0] if content else "")
    except SecondFactorError:
        return redirect(f"/login?next={quote(local_path(back), safe='')}")
    return render(
        request,
        "access/login_second_factor.html",
        refused=refusal,
        next=local_path(back),
        refusal=refusal.sentence if refusal else None,
        code=refusal.code if refusal else "",
        options=second_factors.make_log_in_options(session, waiting, get_site(request)),
    )


@login_router.post("/login/second-factor", response_class=HTMLResponse)
async def give_second_factor(
    request: Request,
    checks: PasswordChecks,
    factor: Annotated[str, Form()] = "",
    next: Annotated[str, Form()] = "/",  # noqa: A002 - the name in the form
) -> Response:
    """Log in a person whose log-in waited for this; the cookie of the log-in is a new one."""
    response, cookie = redirect(local_path(next)), waiting_cookie(request)
    content = cookie.read(request)
    token = content[0] if content else ""

    def find() -> int | None:
        with open_reading(request.app.state.engine) as session:
            try:
                return second_factors.find_waiting(session, token).user_id
            except SecondFactorError:
                return None  # the transaction says so

    async def prove() -> tuple[GivenFactor]:
        user_id = await run_in_threadpool(find)
        if user_id is None:
            return (GivenFactor(factor, get_site(request), request.app.state.factor_rules),)
        return (await checks.check_code(user_id, factor, get_client(request), get_site(request)),)

    def finish(session: Session, given: GivenFactor) -> str:
        waiting, kind = second_factors.finish_waiting(session, token, given, request.state.request_id)
        actor = users.get_actor(session, waiting.user_id, sets_password=True)
        return begin_session(request, response, session, actor, waiting.method or "password", kind)

    outcome = await attempt(request, finish, prove)
    if outcome.refusal is None:
        cookie.clear(response)
        return response

    if outcome.refusal.is_ours:
        raise outcome.refusal.error

    def render_again() -> Response:
        with open_reading(request.app.state.engine) as session:
            return _second_factor_page(request, next, outcome.refusal, session)

    return await run_in_threadpool(render_again)


@login_router.post("/logout", dependencies=[Depends(csrf)])
async def log_out(request: Request) -> Response:
    """End this log-in, wherever its cookie was copied to."""
    response = redirect("/login", flash="You are logged out.")
    clear_cookie(request, response)
    try:
        actor = await run_in_threadpool(current_actor, request)
    except UnauthenticatedError:
        return response  # the log-in has ended already
    outcome = await attempt(request, partial(sessions.log_out, actor=actor))
    if outcome.refusal is not None and outcome.refusal.is_ours:
        raise outcome.refusal.error  # a copied cookie would still be let in
    return response
