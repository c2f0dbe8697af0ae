"""What every page shows around its content: mode, fleet, approvals, the audit's light, person, navigation, flash line.

The values come from one short read of the store, made by `know_fleet` before a page opens its own transaction, so that
no page holds one connection while it waits for a second. Where the store cannot be read the frame says so and goes on.
The fleet's worst sensor is remembered while nothing is committed, at most `HELD_S`; of more than `LARGE` sensors `REST`
times as long as the look took.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any
from urllib.parse import unquote

from fastapi import Request
from fastapi.concurrency import run_in_threadpool

from boresight.console import list_queries as lists
from boresight.console.access.credentials import get_actor, get_times
from boresight.console.access.dependencies import get_server
from boresight.console.alarms import service as alarms
from boresight.console.alignments import queries as alignment_rows
from boresight.console.fleet import service as sensors
from boresight.console.fleet import status as fleet
from boresight.console.jobs.maintenance import ChainStatus
from boresight.console.pages.formats import LEVELS, sensor_word
from boresight.errors import FactorEnrolmentDueError, PasswordDueError, UnauthenticatedError
from boresight.platform.actors import Actor
from boresight.platform.db.data_version import DataVersion, DataVersionReader
from boresight.platform.db.sessions import Engine, Session, open_reading
from boresight.platform.db.times import TimeStyle
from boresight.platform.web.response_cache import NAME_GAP, TOKEN_GAP, has_gaps, mark_outdated

HELD_S = 30.0
LARGE, REST = 200, 5.0


@dataclass(frozen=True)
class FleetStatus:
    """A consolidated status: colour and shape, a word, and why; and each sensor's, of which it is the worst."""

    level: str
    word: str
    sentence: str
    standings: Sequence[fleet.SensorStatus] = field(default=(), compare=False, repr=False)


def find_worst_status(standings: Sequence[fleet.SensorStatus]) -> FleetStatus:
    """Return the worst status of a fleet."""
    if not standings:
        return FleetStatus("off", "NO SENSORS", "No sensors yet: register one.")
    worst = max(standings, key=lambda one: LEVELS.index(one.status))
    alike = sum(one.status == worst.status for one in standings)
    more = f" {alike - 1} more like this." if alike > 1 else ""
    return FleetStatus(worst.status, sensor_word(worst.status), f"{worst.name}: {worst.sentence}{more}", standings)


def read_fleet_status(session: Session) -> tuple[FleetStatus, int, int]:
    """Return the fleet's worst status, the number of requests that wait for a signature, and of unacknowledged alarms."""
    waiting = lists.count(session, "approvals", {"state": "OPEN"}) + alignment_rows.read_open_requests(session)[0]
    return find_worst_status(fleet.list_sensor_statuses(session)), waiting, alarms.count_unacknowledged(session)


@dataclass(frozen=True)
class FleetReading:
    """The result of `read_fleet_status`, and whether it is older than the newest commit."""

    found: tuple[FleetStatus, int, int]
    is_older: bool = False


class FleetStatusCache:
    """A cache of the status in the top bar, reread after a commit, less often in a large fleet, by one thread for all requests."""

    def __init__(self, database: Engine, data_versions: DataVersionReader) -> None:
        self._database, self._data_versions = database, data_versions
        self._looking = threading.Lock()
        self._known: tuple[DataVersion, float, float, tuple[FleetStatus, int, int]] | None = (
            None  # when the last reading began and ended
        )
        self._resting_until_s = 0.0

    def known_now(self, asked_s: float) -> FleetReading | None:
        """Return the result of `standing` from the cache; None where the store must be read or a thread is needed."""
        return self._remembered(self._data_versions.look(), asked_s) if self._data_versions.at_once else None

    def _remembered(self, data_version: DataVersion | None, asked_s: float) -> FleetReading | None:
        """Return the last reading if it is recent enough for a request that came at a time of the monotonic clock."""
        now_s = time.monotonic()
        if self._known is None:
            return None
        of_version, began_s, ended_s, found = self._known
        if now_s - ended_s >= HELD_S:
            return None
        if data_version == of_version or now_s < self._resting_until_s:
            return FleetReading(found)
        return FleetReading(found, is_older=True) if began_s > asked_s else None

    def known_standings(self) -> Sequence[fleet.SensorStatus] | None:
        """Return each sensor's status where it was read since the newest commit; None where it must be read."""
        with self._looking:
            data_version, known, now_s = self._data_versions.look(), self._known, time.monotonic()
        is_known = known is not None and known[0] == data_version and now_s - known[2] < HELD_S
        return (known[3][0].standings or None) if known is not None and is_known else None

    def standing(self, asked_s: float) -> FleetReading:
        """Return `read_fleet_status` as of the request or the newest commit; in a large fleet possibly an older reading."""
        with self._looking:
            now_s = time.monotonic()
            data_version = self._data_versions.look()
            if (remembered := self._remembered(data_version, asked_s)) is not None:
                return remembered
            with open_reading(self._database) as session:
                found = read_fleet_status(session)
                is_large = sensors.count(session) > LARGE
            ended_s = time.monotonic()
            took_s = ended_s - now_s
            self._known = None if data_version is None else (data_version, now_s, ended_s, found)
            self._resting_until_s = ended_s + min(HELD_S, REST * took_s) if is_large else 0.0
            return FleetReading(found)


log = logging.getLogger(__name__)

FLASH_COOKIE = "boresight_flash"
UNREAD = FleetStatus("off", "UNKNOWN", "The store could not be read.")


@dataclass(frozen=True)
class NavigationLine:
    """One line of the navigation; `key` opens it after `g`."""

    path: str
    label: str
    key: str


@dataclass(frozen=True)
class NavigationGroup:
    """Lines that belong together, under a heading; `roles` do most of their work there."""

    title: str
    lines: tuple[NavigationLine, ...]
    roles: frozenset[str] = frozenset()


NAVIGATION = (
    NavigationGroup(
        "Monitor",
        (
            NavigationLine("/", "Overview", "o"),
            NavigationLine("/sensors", "Sensors", "s"),
            NavigationLine("/alarms", "Alarms", "l"),
        ),
    ),
    NavigationGroup(
        "Calibrate",
        (
            NavigationLine("/telemetry", "Telemetry", "t"),
            NavigationLine("/runs", "Runs", "r"),
            NavigationLine("/campaigns", "Campaigns", "n"),
            NavigationLine("/alignments", "Alignments", "d"),
            NavigationLine("/ingest", "Ingest", "i"),
            NavigationLine("/compare", "Compare", "c"),
        ),
        frozenset({"analyst"}),
    ),
    NavigationGroup(
        "Release",
        (
            NavigationLine("/parameter-sets", "Parameter sets", "p"),
            NavigationLine("/approvals", "Approvals", "a"),
            NavigationLine("/uplink", "Uplink", "u"),
        ),
        frozenset({"approver", "operator"}),
    ),
    NavigationGroup(
        "Administer",
        (
            NavigationLine("/audit", "Audit", "h"),
            NavigationLine("/webhooks", "Webhooks", "w"),
            NavigationLine("/users", "Users and keys", "k"),
            NavigationLine("/administration", "Administration", "m"),
        ),
        frozenset({"administrator"}),
    ),
)


def order_navigation(roles: frozenset[str]) -> tuple[NavigationGroup, ...]:
    """Return the groups as a person with these roles needs them: the fleet, their own, the others."""
    first, *others = NAVIGATION
    return (first, *sorted(others, key=lambda group: group.roles.isdisjoint(roles)))


# What keys do within a page; `keys.js` acts on them. None signs, promotes, rolls back, cancels or deletes.
KEYS = (
    (("/",), "the search field, or the first filter"),
    (("j", "k"), "next row, previous row"),
    (("Enter",), "open the row"),
    (("x", "Shift+x"), "select the row, or all from the last one selected"),
    (("c",), "compare what is selected"),
    (("[", "]"), "previous, next: run, or page of the list"),
    (("1", "…", "9"), "switch to tab n"),
    (("d",), "only differences, or all rows"),
    (("e",), "download the list or the run"),
    (("Ctrl+k",), "find anything"),
    (("y",), "copy the address of this view"),
    (("Esc",), "close a dialog, leave a field"),
    (("?",), "show this list of keys"),
)


@dataclass(frozen=True)
class PageFrame:
    """The values that `frame.html` prints."""

    mode: str
    actor: Actor | None
    csrf_token: str
    path: str
    now: str
    times: TimeStyle
    fleet: FleetStatus
    approvals_waiting: int | None
    alarms_unacknowledged: int | None
    light: ChainStatus
    four_eyes: bool
    flash: tuple[str, str, str] | None
    navigation: tuple[NavigationGroup, ...]
    keys: tuple[tuple[tuple[str, ...], str], ...] = KEYS


def _read_flash(request: Request) -> tuple[str, str, str] | None:
    """Return the (level, sentence, code) that the last POST left, if it can be read."""
    try:
        level, sentence, code = json.loads(unquote(request.cookies.get(FLASH_COOKIE, "")))
    except (ValueError, TypeError):
        return None
    return (level, str(sentence), str(code)) if level in LEVELS else None


def _fleet(request: Request, actor: Actor | None) -> tuple[FleetStatus, int | None, int | None]:
    """Read the fleet's status and the numbers of waiting requests and alarms; nothing of it for a visitor who is not logged in."""
    if actor is None:
        return UNREAD, None, None
    known: tuple[FleetStatus, int, int] | None = getattr(request.state, "fleet", None)
    if known is not None:
        return known
    try:
        memory: FleetStatusCache = request.app.state.fleet_status
        return _taken(request, memory.standing(request.state.came_s))
    except Exception:
        log.exception("The frame could not read the store")
        return UNREAD, None, None


def _taken(request: Request, look: FleetReading) -> tuple[FleetStatus, int, int]:
    """Return a reading, and mark the page outdated where something was committed since."""
    if look.is_older:
        mark_outdated(request)
    return look.found


async def know_fleet(request: Request) -> None:
    """Read what the frame shows of the store, for a request by somebody who is logged in."""
    memory: FleetStatusCache = request.app.state.fleet_status
    with suppress(UnauthenticatedError, PasswordDueError, FactorEnrolmentDueError):
        actor = await get_actor(request)
        known = memory.known_now(request.state.came_s)
        request.state.fleet = (
            await run_in_threadpool(_fleet, request, actor) if known is None else _taken(request, known)
        )


def make_page_frame(request: Request, *, is_answer: bool = True) -> PageFrame:
    """Gather the frame's values for a request; `is_answer` is False where the page shows a refusal."""
    actor: Any = getattr(request.state, "actor", None)
    fleet, waiting, alarms = _fleet(request, actor)
    flash, token, times = _read_flash(request), getattr(request.state, "csrf_token", ""), get_times(request)
    if is_answer and flash is None and has_gaps(request):  # the endpoint may depend on the roles only
        actor, token = Actor(None, NAME_GAP, NAME_GAP, actor.roles, ""), TOKEN_GAP
    server = get_server(request)
    return PageFrame(
        mode=server.settings.mode,
        actor=actor,
        csrf_token=token,
        path=request.url.path,
        now=times.show(datetime.now(UTC)),
        times=times,
        fleet=fleet,
        approvals_waiting=waiting,
        alarms_unacknowledged=alarms,
        light=request.app.state.maintenance.light(),
        four_eyes=server.policy.four_eyes,
        flash=flash,
        navigation=order_navigation(frozenset(actor.roles)) if actor else (),
    )
