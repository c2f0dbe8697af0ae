"""Alarms: the list, unacknowledged first, and one alarm with its figures, its history and its actions.

The address holds the view: `/alarms?state=shelved&sensor=3&kind=DRIFT`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse, Response

from boresight.console.access import users
from boresight.console.access.dependencies import KNOWN, Reading, Who, csrf
from boresight.console.alarms import service as alarms
from boresight.console.alarms.tables import ALARM_KINDS, Alarm, AlarmEvent
from boresight.console.fleet import service as sensors
from boresight.console.fleet.tables import Sensor
from boresight.console.operation import RowWithFields
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import (
    RefusalContext,
    make_change,
    read_texts,
    render,
    seen_version,
)
from boresight.console.pages.tables import (
    Table,
    TableColumn,
    TableView,
    accept_one,
    is_number,
    is_text,
    read_all,
    read_page,
    read_view,
    write_csv,
)
from boresight.console.runs.pages.list import RunNames, read_names
from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session, utc_after
from boresight.platform.web.paging import parse_row_id

router = PageRouter(dependencies=[Depends(csrf)])

ALARMS = Table(
    "alarms",
    "Alarms, unacknowledged first",
    (
        TableColumn("alarm", "Alarm", "-alarm", "nowrap", head=True, csv=("alarm", "kind")),
        TableColumn("severity", "Severity", "severity", csv=("severity",)),
        TableColumn("state", "State", "attention", csv=("state",)),
        TableColumn("sentence", "What is wrong", "", "gist", csv=("sentence",)),
        TableColumn("sensor", "Sensor", "sensor", "nowrap", csv=("sensor",)),
        TableColumn("raised", "Raised", "-raised", "tight", csv=("raised_utc", "closed_utc")),
        TableColumn("assigned", "Assigned", "assigned", csv=("assigned_to",)),
    ),
    {
        "state": accept_one(alarms.STATES),
        "sensor": is_number,
        "sensor_name": is_text,
        "kind": accept_one(ALARM_KINDS),
    },
    "attention",
    rows_a_page=200,  # an installation has at most three open alarms a sensor
)
A_SHIFT_S = 8 * 3600.0
DONE = {
    "acknowledge": "is acknowledged",
    "shelve": "is shelved",
    "unshelve": "is unshelved",
    "assign": "is assigned",
    "comment": "has your comment",
}


@router.get("/alarms", response_class=HTMLResponse)
def alarms_page(request: Request, session: Reading) -> HTMLResponse:
    """Show the alarms that are open, those to be acknowledged first; or those sought."""
    view = read_view(request, ALARMS)
    found = read_page(session, view, state=_state(view))
    sensor = parse_row_id(view.where.get("sensor", ""))
    return render(
        request,
        "alarms/alarms.html",
        view=view,
        alarms=found.rows,
        last=found.last,
        sensor=sensor,
        states=alarms.STATES,
        kinds=ALARM_KINDS,
        choices=sensors.list_choices(session, keep=[sensor] if sensor else []),
        names=read_names(session, sensors_of=found.rows),
        state_of=alarms.get_alarm_state,
    )


@router.get("/alarms.csv", dependencies=[KNOWN])
def alarms_csv(request: Request, session: Reading) -> Response:
    """Give every alarm of a view as CSV."""
    view, names = read_view(request, ALARMS), read_names(session, sensors_of=None)
    return write_csv(view, (_csv_row(row, names) for row in read_all(session, view, state=_state(view))))


def _state(view: TableView) -> str:
    """Return the state that is looked at; every one but closed where the address names none."""
    return view.where.get("state", "open")


def _csv_row(row: Alarm, names: RunNames) -> RowWithFields:
    return RowWithFields(
        row,
        alarm=row.id,
        severity=row.level,
        state=alarms.get_alarm_state(row),
        sensor=names.sensors[row.sensor_id] if row.sensor_id is not None else None,
        assigned_to=names.person(row.assigned_to) if row.assigned_to is not None else None,
    )


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
    events = alarms.list_alarm_events(session, alarm_id)[::-1]
    readings = [event for event in events if _is_reading(event)][1:]
    return render(
        request,
        "alarms/alarm.html",
        refused=refusal,
        alarm=row,
        sensor=None if row.sensor_id is None else session.get_known(Sensor, row.sensor_id),
        state=alarms.get_alarm_state(row),
        shelved=alarms.is_shelved(row),
        events=[event for event in events if event not in readings],
        readings=readings,
        is_reading=_is_reading,
        people=[user for user in users.list_users(session) if user.disabled_utc is None],
        names=read_names(session),
        may_handle=alarms.may_handle(actor, row),
        until=typed.get("until") or utc_after(A_SHIFT_S),
        typed=typed,
        refusal=refusal,
    )


def _is_reading(event: AlarmEvent) -> bool:
    """Whether Boresight itself says what is wrong now: after each new run, so that the last is the one that counts."""
    return event.event == "COMMENTED" and event.user_id is None


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
