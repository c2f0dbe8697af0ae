"""Pages that a browser passes through on its way to the identity provider and back. They show nothing but refusals."""

from __future__ import annotations

from dataclasses import astuple, fields
from functools import partial

from fastapi import Request
from fastapi.responses import HTMLResponse, JSONResponse, RedirectResponse, Response

from boresight.console.access import external_identities
from boresight.console.access.credentials import LogInCookie, ShortCookie, get_actor
from boresight.console.access.dependencies import log_in_or_wait
from boresight.console.access.external_identities import Entering
from boresight.console.access.openid_connect import ATTEMPT_S, Attempt, IdentityProvider, ProviderAnswer
from boresight.console.access.pages.log_in import local_path, show_log_in, wait_for_factor
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext, attempt, redirect, redirect_refused
from boresight.errors import BoresightError, NotFoundError, SingleSignOnError
from boresight.platform.actors import Actor, require_person
from boresight.platform.audit.security_log import tell
from boresight.platform.db.sessions import Session

router = PageRouter(prefix="/login/single-sign-on", open_to_all=True)


def _provider(request: Request) -> IdentityProvider:
    provider: IdentityProvider | None = request.app.state.identity_provider
    if provider is None:
        raise NotFoundError("This server has no single sign-on; log in with name and password.")
    return provider


def _cookie(request: Request) -> ShortCookie:
    cookie: LogInCookie = request.app.state.log_in_cookie
    return cookie.short("boresight_single_sign_on", ATTEMPT_S)


@router.get("", response_class=HTMLResponse)
async def go(request: Request, next: str = "/", confirm: bool = False) -> Response:  # noqa: A002 - the name in the address
    """Send a browser to the provider: to log in, or with `confirm` to have the person who is logged in confirmed again."""
    provider, session_id = _provider(request), None
    if confirm:
        actor = await get_actor(request)
        require_person(actor, "be confirmed")
        session_id = actor.session_id
    begun = Attempt.begin(local_path(next), session_id)
    try:
        response = RedirectResponse(await provider.make_address(begun), status_code=303)
    except BoresightError as error:
        return _refused(request, begun, error)
    _cookie(request).write(response, list(astuple(begun)))
    response.headers["Cache-Control"] = "no-store"
    return response


@router.get("/callback", response_class=HTMLResponse)
async def come_back(request: Request) -> Response:
    """Log in, or confirm, whom the provider sends back."""
    provider, content = _provider(request), _cookie(request).read(request)
    begun = Attempt(*content) if content is not None and len(content) == len(fields(Attempt)) else None
    try:
        if begun is None:
            raise SingleSignOnError(
                "This log-in was not begun in this browser, or took too long; log in again.", "state"
            )
        person = await provider.finish(begun, dict(request.query_params))
        response = (
            await _confirmed(request, begun, person) if begun.session_id else await _entered(request, begun, person)
        )
    except BoresightError as error:
        response = _refused(request, begun, error)
    _cookie(request).clear(response)
    return response


async def _entered(request: Request, begun: Attempt, person: ProviderAnswer) -> Response:
    """Log in whom the provider names, or let the log-in wait for a second factor."""
    response = redirect(local_path(begun.back))

    def enter(session: Session) -> tuple[Entering, bool]:
        entering = external_identities.enter(session, person, request.state.request_id)
        return entering, log_in_or_wait(request, response, session, entering.actor, "single sign-on")

    outcome = await attempt(request, enter)
    if outcome.refusal is not None:
        raise outcome.refusal.error
    return wait_for_factor(response, begun.back) if outcome.made[1] else response


async def _confirmed(request: Request, begun: Attempt, person: ProviderAnswer) -> Response:
    """Record that the provider confirmed who is logged in, and go back to what it is needed for."""
    actor: Actor = await get_actor(request)
    outcome = await attempt(request, partial(external_identities.confirm, actor=actor, person=person, attempt=begun))
    if outcome.refusal is not None:
        raise outcome.refusal.error
    return redirect(local_path(begun.back), flash="Identity confirmed. You can sign once within the next 5 minutes.")


def _refused(request: Request, begun: Attempt | None, error: BoresightError) -> Response:
    """Say why nobody was logged in or confirmed, in the log too."""
    provider = _provider(request)
    reason = error.reason if isinstance(error, SingleSignOnError) else "unavailable"
    tell("authn_sso_fail", "failure", reason=reason, issuer=provider.settings.issuer)
    refusal, back = RefusalContext.of(error), begun.back if begun else "/"
    if begun is not None and begun.session_id:
        return redirect_refused(local_path(back), refusal)
    return show_log_in(request, back, refusal=refusal)


@router.get("/log-out", response_class=HTMLResponse)
async def log_out(request: Request) -> Response:
    """Send a browser to where it ends its log-in at the provider."""
    provider = _provider(request)
    try:
        return RedirectResponse(await provider.make_log_out_address(), status_code=303)
    except BoresightError as error:
        return _refused(request, None, error)


@router.post("/back-channel-log-out", response_class=Response)
async def log_out_by_provider(request: Request) -> Response:
    """End the log-ins of whom the provider logged out, as OpenID Connect Back-Channel Logout 1.0 has it.

    The provider sends this itself, without a browser: what counts is the signed token. 200: done, also where nobody was logged in.
    """
    provider, headers = _provider(request), {"Cache-Control": "no-store"}
    given = (await request.form(max_files=0, max_fields=10)).get("logout_token", "")
    try:
        told = await provider.read_log_out(given if isinstance(given, str) else "")
    except SingleSignOnError as error:
        tell("authn_sso_fail", "failure", reason=error.reason, issuer=provider.settings.issuer)
        body = {"error": "invalid_request", "error_description": str(error)}
        return JSONResponse(body, status_code=400, headers=headers)
    outcome = await attempt(request, partial(external_identities.log_out, told=told))
    if outcome.refusal is not None:
        raise outcome.refusal.error
    return Response(status_code=200, headers=headers)
