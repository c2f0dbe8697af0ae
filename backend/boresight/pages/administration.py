"""What keeps an installation going, on one page: people, keys, workers, the audit's light, settings, backup."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from boresight.api.dependencies import Reading, Who
from boresight.pages.rendering import render
from boresight.services import api_keys, runs, users
from boresight.store.sessions import Session, utc_after, utc_now
from boresight.store.tables import ROLES, ApiKey, User

SOON_S = 14 * 86400.0
ALONE = ("approver", "administrator")  # roles that one person alone should not be the only one to have

router = APIRouter()


@dataclass(frozen=True)
class Keys:
    """How the API keys are at."""

    valid: int
    unused: int
    expiring: int
    endless: int


def roles_held(people: Sequence[User]) -> list[tuple[str, int]]:
    """Count who may log in, by role."""
    held = Counter(role for person in people if person.disabled_utc is None for role in person.roles)
    return [(role, held[role]) for role in ROLES]


def warnings(people: Sequence[User], *, four_eyes: bool) -> list[str]:
    """Say what of people and roles would hold up work."""
    held = dict(roles_held(people))
    said = [f"There is one {role} only: nobody stands in." for role in ALONE if held[role] == 1]
    said += [f"There is no {role}." for role in ROLES[1:] if not held[role]]
    if four_eyes and held["approver"] and not any("approver" in p.roles and "analyst" not in p.roles for p in people):
        said.append("Every approver is an analyst too: whoever submits needs another to sign.")
    return said


def keys_at(keys: Sequence[ApiKey], now: str, soon: str) -> Keys:
    """Count the keys that are valid, and of them those never used, soon expired, or valid for ever."""
    valid = [key for key in keys if not key.revoked_utc and (key.expires_utc is None or key.expires_utc > now)]
    return Keys(
        valid=len(valid),
        unused=sum(key.last_used_utc is None for key in valid),
        expiring=sum(key.expires_utc is not None and key.expires_utc <= soon for key in valid),
        endless=sum(key.expires_utc is None for key in valid),
    )


@router.get("/administration", response_class=HTMLResponse)
def administration_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show how the installation is at."""
    state = request.app.state
    people = users.list_users(session)
    return render(
        request,
        "administration/administration.html",
        people=people,
        due=[person.printed_name for person in people if person.must_change_password and not person.disabled_utc],
        roles=roles_held(people),
        warnings=warnings(people, four_eyes=state.policy.four_eyes),
        keys=keys_at(_keys(session), utc_now(), utc_after(SOON_S)),
        workers=state.workers.state() if state.workers else None,
        counts=runs.count_by_state(session),
        policy=state.policy,
        session_hours=state.settings.session_hours,
        login_attempts=state.settings.login_attempts,
        blobs_at=state.blobs.kept_at,
        light=state.upkeep.light(),
        administrator="administrator" in actor.roles,
    )


def _keys(session: Session) -> Sequence[ApiKey]:
    return api_keys.list_keys(session)
