"""What every page shows around its content: mode, fleet, approvals, the audit's light, person, navigation, flash line.

The values come from `request.state` (who is logged in), the settings, and one short read of the store, made by
`know_fleet` before a page opens its own transaction: a page that held one connection while it waited for a second could
take the last of them from another that does the same. A page that reports a failure must not fail for the same cause:
where the store cannot be read, the frame says so and goes on.
"""

from __future__ import annotations

import json
import logging
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any
from urllib.parse import unquote

from fastapi import Request
from fastapi.concurrency import run_in_threadpool

from boresight.api.credentials import who_acts
from boresight.api.keeping import has_gaps, tell_older
from boresight.api.sheets import NAME_GAP, TOKEN_GAP
from boresight.api.upkeep import Light
from boresight.errors import PasswordDueError, UnauthenticatedError
from boresight.pages.fleet import FleetMemory, Look, Standing
from boresight.pages.formats import day_of_year
from boresight.pages.states import LEVELS
from boresight.services.actors import Actor

log = logging.getLogger(__name__)

FLASH_COOKIE = "boresight_flash"
UNREAD = Standing("off", "UNKNOWN", "The store could not be read.")


@dataclass(frozen=True)
class Destination:
    """One line of the navigation; `key` opens it after `g`, and no `roles` means everybody."""

    path: str
    label: str
    key: str
    roles: frozenset[str] = frozenset()


NAVIGATION = (
    Destination("/", "Overview", "o"),
    Destination("/sensors", "Sensors", "s"),
    Destination("/telemetry", "Telemetry", "t"),
    Destination("/runs", "Runs", "r"),
    Destination("/campaigns", "Campaigns", "n"),
    Destination("/compare", "Compare", "c"),
    Destination("/parameter-sets", "Parameter sets", "p"),
    Destination("/approvals", "Approvals", "a"),
    Destination("/uplink", "Uplink", "u"),
    Destination("/alarms", "Alarms", "l"),
    Destination("/audit", "Audit", "h"),
    Destination("/webhooks", "Webhooks", "w"),
    Destination("/users", "Users and keys", "k"),
    Destination("/administration", "Administration", "m"),
)

# What keys do within a page; `keys.js` acts on them. None signs, promotes, rolls back, cancels or deletes.
KEYS = (
    (("/",), "the search field, or the first filter"),
    (("j", "k"), "next row, previous row"),
    (("Enter",), "open the row"),
    (("x", "Shift+x"), "select the row, or all from the last one selected"),
    (("c",), "compare what is selected"),
    (("[", "]"), "previous, next: run, or page of the list"),
    (("1", "…", "9"), "tab of the page"),
    (("d",), "only what differs, or everything"),
    (("e",), "the list or the run as a file"),
    (("y",), "copy the address of this view"),
    (("Esc",), "close what is open, leave a field"),
    (("?",), "this list"),
)


@dataclass(frozen=True)
class Frame:
    """The values that `frame.html` prints."""

    mode: str
    actor: Actor | None
    csrf_token: str
    path: str
    now: str
    fleet: Standing
    approvals_waiting: int | None
    alarms_unacknowledged: int | None
    light: Light
    four_eyes: bool
    flash: tuple[str, str] | None
    navigation: tuple[Destination, ...]
    keys: tuple[tuple[tuple[str, ...], str], ...] = KEYS


def _read_flash(request: Request) -> tuple[str, str] | None:
    """Return the (level, sentence) that the last POST left, if it can be read."""
    try:
        level, sentence = json.loads(unquote(request.cookies.get(FLASH_COOKIE, "")))
    except (ValueError, TypeError):
        return None
    return (level, str(sentence)) if level in LEVELS else None


def _fleet(request: Request, actor: Actor | None) -> tuple[Standing, int | None, int | None]:
    """Read the fleet's standing, how many requests wait and how many alarms; nobody logged in learns any of it."""
    if actor is None:
        return UNREAD, None, None
    known: tuple[Standing, int, int] | None = getattr(request.state, "fleet", None)
    if known is not None:
        return known
    try:
        memory: FleetMemory = request.app.state.fleet
        return _taken(request, memory.standing(request.state.came_s))
    except Exception:
        log.exception("The frame could not read the store")
        return UNREAD, None, None


def _taken(request: Request, look: Look) -> tuple[Standing, int, int]:
    """Take what was found, and say where something was committed since."""
    if look.is_older:
        tell_older(request)
    return look.found


async def know_fleet(request: Request) -> None:
    """Read what the frame shows of the store, for a request by somebody who is logged in."""
    memory: FleetMemory = request.app.state.fleet
    with suppress(UnauthenticatedError, PasswordDueError):
        actor = await who_acts(request)
        known = memory.known_now(request.state.came_s)
        request.state.fleet = (
            await run_in_threadpool(_fleet, request, actor) if known is None else _taken(request, known)
        )


def frame_of(request: Request, *, is_answer: bool = True) -> Frame:
    """Gather the frame's values for a request; `is_answer` where the page is what was asked for, and no refusal."""
    actor: Any = getattr(request.state, "actor", None)
    fleet, waiting, alarms = _fleet(request, actor)
    flash, token = _read_flash(request), getattr(request.state, "csrf_token", "")
    if is_answer and flash is None and has_gaps(request):  # whoever writes the page is not told more than the roles
        actor, token = Actor(None, NAME_GAP, NAME_GAP, actor.roles, ""), TOKEN_GAP
    return Frame(
        mode=request.app.state.settings.mode,
        actor=actor,
        csrf_token=token,
        path=request.url.path,
        now=day_of_year(datetime.now(UTC)),
        fleet=fleet,
        approvals_waiting=waiting,
        alarms_unacknowledged=alarms,
        light=request.app.state.upkeep.light(),
        four_eyes=request.app.state.policy.four_eyes,
        flash=flash,
        navigation=NAVIGATION if actor else (),
    )
