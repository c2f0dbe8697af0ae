"""Pages of people, API keys and log-ins, and of one's own password and preferences."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import partial
from typing import Annotated, Any

from fastapi import Depends, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.console.access import api_keys, preferences, second_factors, sessions, users
from boresight.console.access.dependencies import (
    KNOWN,
    Cookie,
    PasswordChecks,
    Reading,
    ServerSettings,
    Who,
    clear_cookie,
    csrf,
    get_client,
)
from boresight.console.access.passwords import MINIMUM_PASSWORD_LENGTH, NewPassword, PasswordProof
from boresight.console.access.tables import User
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext, attempt, make_change, read_again, redirect, render
from boresight.errors import RefusedInputError
from boresight.platform.actors import SCOPES, Actor, SessionLimits, require_person, require_role
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.db.times import TimeForm, TimeStyle, list_zones
from boresight.platform.web.paging import parse_row_id

router = PageRouter(dependencies=[Depends(csrf)])

SESSIONS_SHOWN = 200
WHY_ENDED = {
    "logged_out": "logged out",
    "ended": "ended by the user",
    "ended_by_administrator": "ended by an administrator",
    "password_changed": "the password was changed",
    "roles_changed": "the roles were changed",
    "disabled": "the user was disabled",
    "idle": "unused for too long",
    "expired": "reached its maximum age",
}
WHAT_A_ROLE_MAY = {
    "viewer": "look at everything",
    "analyst": "upload telemetry, launch runs, submit parameter sets",
    "operator": "promote approved sets, record what is on board",
    "approver": "sign requests for approval",
    "administrator": "manage users and keys; cannot sign",
}


@dataclass(frozen=True)
class UsersContext:
    """What a form left behind on the page: its refusal, what was typed, a key's secret that is shown once."""

    form: str = ""
    refusal: RefusalContext | None = None
    typed: Mapping[str, Any] = field(default_factory=dict)
    secret: str = ""


def _page(request: Request, actor: Actor, shown: UsersContext, session: Session) -> HTMLResponse:
    administrator = "administrator" in actor.roles
    people = users.list_users(session)
    return render(
        request,
        "access/users.html",
        refused=shown.refusal,
        people=people if administrator else [],
        names={person.id: person.printed_name for person in people},
        administrators=users.list_administrators(session),
        keys=api_keys.list_keys(session, None if administrator else actor.user_id),
        roles=WHAT_A_ROLE_MAY,
        scopes=SCOPES,
        minimum_length=MINIMUM_PASSWORD_LENGTH,
        administrator=administrator,
        enrolled=second_factors.list_enrolled_ids(session) if administrator else (),
        now=utc_now(),
        shown=shown,
    )


async def _change(
    request: Request,
    actor: Actor,
    change: Callable[..., Any],
    said: str,
    form: str = "people",
    prepare: Callable[[], Awaitable[Sequence[object]]] | None = None,
    **typed: Any,
) -> Response:
    """Make a change of people or keys, and show them, or why it was refused beside what was typed."""

    def render_again(refusal: RefusalContext, session: Session) -> HTMLResponse:
        return _page(request, actor, UsersContext(form, refusal, typed), session)

    return await make_change(request, change, "/users", said, prepare=prepare, again=render_again)


@router.get("/users", response_class=HTMLResponse)
def users_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show the people and API keys."""
    return _page(request, actor, UsersContext(), session)


@router.post("/users", response_class=HTMLResponse)
async def create(
    request: Request,
    actor: Who,
    checks: PasswordChecks,
    name: Annotated[str, Form()] = "",
    printed_name: Annotated[str, Form()] = "",
    password: Annotated[str, Form()] = "",
    roles: Annotated[list[str] | None, Form()] = None,
    own_password: Annotated[str, Form()] = "",
) -> Response:
    """Add a person."""
    chosen = roles or []

    async def prepare() -> tuple[NewPassword]:
        require_role(actor, "administrator")  # before the slow hashing; the service checks again
        return (await checks.prepare(password, name, printed_name),)

    def change(session: Session, prepared: NewPassword) -> User:
        return users.create_user(
            session,
            actor,
            name=name,
            printed_name=printed_name,
            password=prepared,
            roles=chosen,
            must_change_password=bool(own_password),
        )

    typed = {"name": name, "printed_name": printed_name, "roles": chosen}
    return await _change(request, actor, change, "{0.printed_name} may log in as {0.name}.", "person", prepare, **typed)


@router.post("/users/{user_id}/roles", response_class=HTMLResponse)
async def change_roles(
    request: Request, actor: Who, user_id: int, roles: Annotated[list[str] | None, Form()] = None
) -> Response:
    """Give a person other roles."""

    def change(session: Session) -> str:
        person = users.change_roles(session, actor, user_id, roles or [])
        return f"{person.printed_name} now has: {', '.join(person.roles) or 'no role'}."

    return await _change(request, actor, change, "{}")


@router.post("/users/{user_id}/disable", response_class=HTMLResponse)
async def disable(request: Request, actor: Who, user_id: int) -> Response:
    """Disable a person."""
    change = partial(users.disable_user, actor=actor, user_id=user_id)
    return await _change(request, actor, change, "{.printed_name} can no longer log in.")


@router.post("/users/{user_id}/enable", response_class=HTMLResponse)
async def enable(request: Request, actor: Who, user_id: int) -> Response:
    """Let a disabled person in again."""
    change = partial(users.enable_user, actor=actor, user_id=user_id)
    return await _change(request, actor, change, "{.printed_name} can log in again.")


@router.post("/users/{user_id}/password", response_class=HTMLResponse)
async def reset_password(
    request: Request, actor: Who, checks: PasswordChecks, user_id: int, password: Annotated[str, Form()] = ""
) -> Response:
    """Give a person a password that they must change at their next log-in."""
    if user_id == actor.user_id:
        return redirect("/password")

    async def prepare() -> tuple[NewPassword, PasswordProof]:
        return await checks.prepare_change(actor, user_id, password, "", get_client(request))

    def change(session: Session, prepared: NewPassword, current: PasswordProof) -> User:
        return users.change_password(session, actor, user_id, prepared, current)

    said = "{.printed_name} is logged out and must set a new password at the next log-in."
    return await _change(request, actor, change, said, prepare=prepare)


@router.post("/users/{user_id}/reset-second-factor", response_class=HTMLResponse)
async def reset_second_factor(request: Request, actor: Who, user_id: int) -> Response:
    """Remove the second factors of a person who lost theirs."""
    change = partial(second_factors.reset, actor=actor, user_id=user_id)
    said = "{.printed_name} was logged out and their second factors were removed."
    return await _change(request, actor, change, said)


@router.post("/users/{user_id}/end-sessions", response_class=HTMLResponse)
async def end_sessions(request: Request, actor: Who, user_id: int) -> Response:
    """End every log-in of a person."""
    return await _change(request, actor, partial(_end_sessions, actor, user_id), "{} is logged out everywhere.")


def _end_sessions(actor: Actor, user_id: int, session: Session) -> str:
    users.end_sessions(session, actor, user_id)
    return session.get_known(User, user_id).printed_name


@router.get("/sessions", response_class=HTMLResponse)
def sessions_page(
    request: Request, session: Reading, actor: Who, settings: ServerSettings, user: int | None = None
) -> HTMLResponse:
    """Show one's log-ins, or as an administrator another person's."""
    return _sessions_page(request, actor, settings.session_limits, user, None, session)


def _sessions_page(
    request: Request,
    actor: Actor,
    limits: SessionLimits,
    user_id: int | None,
    refusal: RefusalContext | None,
    session: Session,
) -> HTMLResponse:
    opened = sessions.list_sessions(session, actor, user_id, is_open=True)
    ended = sessions.list_sessions(session, actor, user_id, is_open=False, limit=SESSIONS_SHOWN)
    person = session.get_known(User, user_id or require_person(actor, "see log-ins"))
    return render(
        request,
        "access/sessions.html",
        refused=refusal,
        person=person,
        own=person.id == actor.user_id,
        opened=[(row, limits.ends_utc(row.created_utc)) for row in opened if not limits.is_idle(row.last_used_utc)],
        ended=ended,
        most=SESSIONS_SHOWN,
        current=actor.session_id,
        idle_minutes=limits.idle_s / 60,
        why=WHY_ENDED,
        kept_days=round(sessions.KEPT_FOR_S / 86400),
        refusal=refusal,
    )


@router.post("/sessions/{session_id:int}/end", response_class=HTMLResponse)
async def end_session(request: Request, actor: Who, settings: ServerSettings, session_id: int) -> Response:
    """End one log-in."""
    outcome = await attempt(request, partial(sessions.end_session, actor=actor, session_id=session_id))
    if outcome.value is None:
        page = partial(_sessions_page, request, actor, settings.session_limits, None, outcome.refusal)
        return await read_again(request, page)
    own = outcome.value.user_id == actor.user_id
    return redirect("/sessions" if own else f"/sessions?user={outcome.value.user_id}", flash="The log-in is ended.")


@router.post("/sessions/end-others", response_class=HTMLResponse)
async def end_other_sessions(request: Request, actor: Who, settings: ServerSettings) -> Response:
    """End every log-in of one's own but this one."""
    outcome = await attempt(request, partial(sessions.end_other_sessions, actor=actor))
    if outcome.value is None:
        page = partial(_sessions_page, request, actor, settings.session_limits, None, outcome.refusal)
        return await read_again(request, page)
    count = outcome.value
    return redirect("/sessions", flash=f"{count} other log-in{'s are' if count != 1 else ' is'} ended.")


@router.post("/users/keys", response_class=HTMLResponse)
async def create_key(
    request: Request,
    actor: Who,
    label: Annotated[str, Form()] = "",
    days: Annotated[str, Form()] = "90",
    scopes: Annotated[list[str] | None, Form()] = None,
) -> Response:
    """Make a key and show its secret, this once."""
    outcome = await attempt(request, partial(_make_key, actor, label, days, scopes or []))
    if outcome.value is not None:
        return await read_again(request, partial(_page, request, actor, UsersContext("key", secret=outcome.value)))
    typed = {"label": label, "days": days, "scopes": scopes or []}
    return await read_again(request, partial(_page, request, actor, UsersContext("key", outcome.refusal, typed)))


def _make_key(actor: Actor, label: str, days: str, scopes: list[str], session: Session) -> str:
    expires_days = parse_row_id(days)
    if expires_days is None:
        raise RefusedInputError(f"{days.strip()[:20]!r} is not a number of days; type one, such as 90.")
    _, secret = api_keys.create_key(session, actor, label=label, scopes=scopes, expires_days=expires_days)
    return secret


@router.post("/users/keys/{key_id}/revoke", response_class=HTMLResponse)
async def revoke_key(request: Request, actor: Who, key_id: int) -> Response:
    """End a key."""
    change = partial(api_keys.revoke_key, actor=actor, key_id=key_id)
    return await _change(request, actor, change, "The key {0.label!r} is revoked.", "keys")


password_router = PageRouter(prefix="/password", dependencies=[Depends(csrf)])


@password_router.get("", response_class=HTMLResponse, dependencies=[KNOWN])
def password_page(request: Request) -> HTMLResponse:
    """Show the form."""
    return _password_page(request, None)


def _password_page(request: Request, refusal: RefusalContext | None) -> HTMLResponse:
    sentence = refusal.sentence if refusal else ""
    return render(
        request, "access/password.html", refused=refusal, refusal=sentence, minimum_length=MINIMUM_PASSWORD_LENGTH
    )


@password_router.post("", response_class=HTMLResponse)
async def change_password(
    request: Request,
    actor: Who,
    checks: PasswordChecks,
    current: Annotated[str, Form()] = "",
    password: Annotated[str, Form()] = "",
    repeated: Annotated[str, Form()] = "",
) -> Response:
    """Set one's own password; every log-in then ends, this one too."""
    user_id = require_person(actor, "set a password")

    async def prepare() -> tuple[NewPassword, PasswordProof]:
        if password != repeated:
            raise RefusedInputError("The two new passwords differ; type the same one twice.")
        return await checks.prepare_change(actor, user_id, password, current, get_client(request))

    outcome = await attempt(request, partial(set_password, actor, user_id), prepare)
    if outcome.refusal is not None:
        return await run_in_threadpool(_password_page, request, outcome.refusal)
    response = redirect("/login", flash="Your password is changed; log in with the new one.")
    clear_cookie(request, response)
    return response


def set_password(actor: Actor, user_id: int, session: Session, password: NewPassword, current: PasswordProof) -> None:
    """Change the password of who acts."""
    users.change_password(session, actor, user_id, password, current)


preference_router = PageRouter(prefix="/preferences", dependencies=[Depends(csrf)])
FORMS: Mapping[TimeForm, str] = {
    "day_of_year": "UTC with day of year",
    "iso": "UTC calendar date (ISO 8601)",
    "local": "UTC calendar date with local time in brackets",
}
EXAMPLE = datetime(2026, 11, 21, 3, 4, 5, tzinfo=UTC)


@preference_router.get("", response_class=HTMLResponse)
def preferences_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show how one has pages shown."""
    chosen = preferences.get_preferences(session, actor.user_id)
    return _preferences_page(request, TimeStyle(**chosen["times"]), chosen["theme"], None)


def _preferences_page(request: Request, times: TimeStyle, theme: str, refusal: RefusalContext | None) -> HTMLResponse:
    beside = times.zone if refusal is None and times.form == "local" else "Europe/Amsterdam"
    return render(
        request,
        "access/preferences.html",
        refused=refusal,
        refusal=refusal,
        chosen=times,
        theme=theme,
        themes=preferences.THEMES,
        forms=tuple(FORMS.items()),
        examples={form: TimeStyle(form, beside).show(EXAMPLE) for form in FORMS},
        zones=list_zones(),
    )


@preference_router.post("", response_class=HTMLResponse)
async def choose_preferences(
    request: Request,
    actor: Who,
    cookie: Cookie,
    form: Annotated[TimeForm, Form()] = "day_of_year",
    zone: Annotated[str, Form()] = "",
    theme: Annotated[str, Form()] = "system",
) -> Response:
    """Choose how times are shown, and the theme."""
    typed = TimeStyle(form, zone.strip())
    outcome = await attempt(request, partial(_keep, actor=actor, chosen={"times": asdict(typed), "theme": theme}))
    if outcome.refusal is not None:
        return await run_in_threadpool(_preferences_page, request, typed, theme, outcome.refusal)
    answer = redirect("/preferences", flash="Preferences saved. You can type times in any of the formats.")
    cookie.write_theme(answer, theme)
    return answer


def _keep(session: Session, *, actor: Actor, chosen: Mapping[str, Any]) -> None:
    for name, value in chosen.items():
        preferences.set_preference(session, actor, name, value)
