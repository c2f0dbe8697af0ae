"""Alarms: the list, unacknowledged first, and one alarm with its figures, its history and its actions.

The address holds the filters: `/alarms?state=shelved&sensor=3&kind=DRIFT`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, Response

from boresight.console.access import users
from boresight.console.access.dependencies import KNOWN, Reading, Who, csrf
from boresight.console.alarms import service as alarms
from boresight.console.alarms.tables import ALARM_KINDS, Alarm
from boresight.console.fleet import service as sensors
from boresight.console.fleet.tables import Sensor
from boresight.console.pages.rendering import (
    RefusalContext,
    make_change,
    read_texts,
    render,
    seen_version,
)
from boresight.console.pages.tables import LONGEST_FILTER, csv_file, is_text
from boresight.console.runs.pages.list import RunNames, read_names
from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session, utc_after
from boresight.platform.web.paging import parse_row_id
from boresight.verdicts.verdict import LEVELS

router = APIRouter(dependencies=[Depends(csrf)])

A_PAGE = 200  # an installation has at most three open alarms a sensor
CSV_FIELDS = ("alarm", "kind", "severity", "state", "sentence", "sensor", "raised_utc", "closed_utc", "assigned_to")
A_SHIFT_S = 8 * 3600.0
DONE = {
    "acknowledge": "is acknowledged",
    "shelve": "is shelved",
    "unshelve": "is taken from the shelf",
    "assign": "is assigned",
    "comment": "has your comment",
}


def _sought(state: str = "", sensor: str = "", sensor_name: str = "", kind: str = "") -> alarms.AlarmFilter:
    return alarms.AlarmFilter(
        sensor_id=parse_row_id(sensor),
        sensor_name=sensor_name.strip()[:LONGEST_FILTER] if is_text(sensor_name) else "",
        kind=kind if kind in ALARM_KINDS else None,
        state=state if state in alarms.STATES else None,
    )


def _query(sought: alarms.AlarmFilter) -> str:
    named = {"state": sought.state or "", "sensor": sought.sensor_id or "", "kind": sought.kind or ""}
    return urlencode(named | ({"sensor_name": sought.sensor_name} if sought.sensor_name else {}))


Seeking = Annotated[alarms.AlarmFilter, Depends(_sought)]


@router.get("/alarms", response_class=HTMLResponse)
def alarms_page(request: Request, session: Reading, actor: Who, sought: Seeking, before: str = "") -> HTMLResponse:
    """Show the open alarms, unacknowledged ones first, or those that the filters select."""
    before_id = parse_row_id(before)
    found = alarms.list_alarms(session, sought, before_id=before_id, limit=A_PAGE + 1)
    return render(
        request,
        "alarms/alarms.html",
        alarms=sorted(found[:A_PAGE], key=lambda row: (bool(row.acknowledged) or alarms.is_shelved(row), -row.id)),
        older=found[A_PAGE - 1].id if len(found) > A_PAGE else None,
        sought=sought,
        query=_query(sought),
        states=alarms.STATES,
        kinds=ALARM_KINDS,
        choices=sensors.list_choices(session, keep=[sought.sensor_id] if sought.sensor_id else []),
        names=read_names(session, sensors_of=found),
        state_of=alarms.get_alarm_state,
        ranks={level: rank for rank, level in enumerate(LEVELS)},
        may_handle=bool(actor.roles.intersection(alarms.HANDLERS)),
    )


@router.get("/alarms.csv", dependencies=[KNOWN])
def alarms_csv(session: Reading, sought: Seeking) -> Response:
    """Give every alarm of a view as CSV, newest first."""
    names = read_names(session, sensors_of=None)
    found = alarms.list_alarms(session, sought)
    return csv_file("alarms", CSV_FIELDS, (_csv_row(row, names) for row in found))


def _csv_row(row: Alarm, names: RunNames) -> dict[str, Any]:
    return {
        "alarm": row.id,
        "kind": row.kind,
        "severity": row.level,
        "state": alarms.get_alarm_state(row),
        "sentence": row.sentence,
        "sensor": names.sensors[row.sensor_id] if row.sensor_id is not None else None,
        "raised_utc": row.raised_utc,
        "closed_utc": row.closed_utc,
        "assigned_to": names.person(row.assigned_to) if row.assigned_to is not None else None,
    }


@router.get("/alarms/{alarm_id:int}", response_class=HTMLResponse)
def alarm_page(request: Request, session: Reading, actor: Who, alarm_id: int) -> HTMLResponse:
    """Show an alarm."""
    return _page(request, actor, alarm_id, {}, None, session)


def _page(
    request: Request,
    actor: Actor,
    alarm_id: int,
    typed: Mapping[str, str],
    refusal: RefusalContext | None,
    session: Session,
) -> HTMLResponse:
    row = session.get_known(Alarm, alarm_id)
    return render(
        request,
        "alarms/alarm.html",
        refused=refusal,
        alarm=row,
        sensor=None if row.sensor_id is None else session.get_known(Sensor, row.sensor_id),
        state=alarms.get_alarm_state(row),
        shelved=alarms.is_shelved(row),
        events=alarms.list_alarm_events(session, alarm_id),
        people=[user for user in users.list_users(session) if user.disabled_utc is None],
        names=read_names(session),
        may_handle=bool(actor.roles.intersection(alarms.HANDLERS)) and row.closed_utc is None,
        until=typed.get("until") or utc_after(A_SHIFT_S)[:16] + "Z",
        typed=typed,
        refusal=refusal,
    )


@router.post("/alarms/{alarm_id:int}/{step}", response_class=HTMLResponse)
async def handle(request: Request, actor: Who, alarm_id: int, step: str) -> Response:
    """Acknowledge, shelve, unshelve, assign or comment on an alarm."""
    if step not in DONE:
        raise NotFoundError(f"There is no step {step} of an alarm; choose from {', '.join(DONE)}.")
    typed = await read_texts(request)
    change, again = partial(_handle, actor, alarm_id, step, typed), partial(_page, request, actor, alarm_id, typed)
    return await make_change(request, change, f"/alarms/{alarm_id}", f"Alarm {alarm_id} {DONE[step]}.", again=again)


def _handle(actor: Actor, alarm_id: int, step: str, typed: Mapping[str, str], session: Session) -> Alarm:
    seen, text = seen_version(typed), typed.get("text", "")
    if step == "acknowledge":
        return alarms.acknowledge(session, actor, alarm_id, text, seen)
    if step == "shelve":
        return alarms.shelve(session, actor, alarm_id, typed.get("until", ""), text, seen)
    if step == "unshelve":
        return alarms.unshelve(session, actor, alarm_id, seen)
    if step == "assign":
        return alarms.assign(session, actor, alarm_id, _person(typed.get("user_id", "")), seen)
    return alarms.comment(session, actor, alarm_id, text, seen)


def _person(number: str) -> int | None:
    """Read the assignee's number from the form; an empty field means nobody."""
    if not number:
        return None
    person = parse_row_id(number)
    if person is None:
        raise RefusedInputError("Choose a person from the list.")
    return person
