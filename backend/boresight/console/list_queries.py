"""Long lists, sorted and filtered by the database and cut into pages by key.

A page is asked for by the id of the last row before it. With k the value that the list is sorted by, c the row named,
and rows without a value last, the page holds the rows after c in the order (k, newest first)::

    k > k_c  or  (k = k_c and id < id_c)  or  k is null            (k < k_c where the order descends)

so that it stays the page it was while rows arrive before it, and the hundredth page costs what the first one does. Only
ids are sorted, for a row carries documents; the rows of one page are read by their ids. A list is one entry of `LISTS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import sqlalchemy as sa
from sqlalchemy.orm import defer

from boresight.console.access.tables import LoginSession, User
from boresight.console.alarms.queries import in_state, needs_nobody
from boresight.console.alarms.tables import ALARM_LEVELS, Alarm
from boresight.console.alignments.tables import Alignment, AlignmentRequest
from boresight.console.approvals.tables import Approval, Signature
from boresight.console.campaigns.queries import select_newest_members
from boresight.console.campaigns.tables import Campaign, CampaignRun
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.fleet.tables import Sensor
from boresight.console.ingest.tables import IngestDecision, IngestPolicy
from boresight.console.messages.tables import Message
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import CALIBRATIONS, ArchivedRun, JointSet, Preset, Run
from boresight.console.telemetry.tables import ImportProfile, TelemetrySet
from boresight.console.uplinks.queries import BOARD_WORDS, find_board_place
from boresight.console.uplinks.tables import Package, Uplink
from boresight.console.webhooks.tables import WebhookDelivery
from boresight.errors import RefusedInputError
from boresight.platform.audit.queries import RECORDS
from boresight.platform.db.documents import among, number_in, text_in
from boresight.platform.db.lists import Condition, List, equals, list_newest_rows
from boresight.platform.db.sessions import Session

ROWS_A_READ = 500
T = TypeVar("T")


@dataclass(frozen=True)
class Signatory:
    """The person who would sign, and whether having a part in a set excludes them."""

    user_id: int
    now_utc: str
    four_eyes: bool


@dataclass(frozen=True)
class ListQuery:
    """A query on a list: filters by name, and the sort key, with `-` before it for descending order."""

    where: Mapping[str, Any]
    sort: str
    before_id: int | None = None


def _name_expression(table: Any, number: Any) -> Any:
    """Return the expression for the name of a row of another table, by its id."""
    name = table.printed_name if table is User else table.name
    return sa.func.lower(sa.select(name).where(table.id == number).correlate_except(table).scalar_subquery())


def _holds(*columns: Any) -> Condition:
    return lambda text: sa.or_(*(column.icontains(text, autoescape=True) for column in columns))


def _filter_sensor_name(column: Any) -> Condition:
    holds = _holds(Sensor.name)
    return lambda text: column.in_(sa.select(Sensor.id).where(holds(text)))


def _filter_either_sensor(value: Any) -> Any:
    """Hold where an alignment leads from a sensor or to it."""
    return sa.or_(equals(Alignment.sensor_a_id)(value), equals(Alignment.sensor_b_id)(value))


def _takes_set(value: Any) -> Any:
    """Hold where a run calibrates a telemetry set, by itself or with others."""
    with_others = sa.select(JointSet.run_id).where(equals(JointSet.telemetry_set_id)(value))
    return sa.or_(equals(Run.telemetry_set_id)(value), Run.id.in_(with_others))


def _baseline(column: Any) -> Any:
    """Return the expression of a column of a sensor's baseline."""
    of_sensor = sa.and_(ParameterSet.sensor_id == Sensor.id, ParameterSet.ground_state == "BASELINE")
    return sa.select(column).where(of_sensor).correlate(Sensor).scalar_subquery()


def _filter_set_sensor(column: Any) -> Condition:
    """Filter rows by the sensor of their set."""
    of_sensor = equals(ParameterSet.sensor_id)
    return lambda sensor_id: column.in_(sa.select(ParameterSet.id).where(of_sensor(sensor_id)))


def _sets_in_use() -> Any:
    """Return the expression for the number of a sensor's telemetry sets that are not archived."""
    in_use = sa.and_(TelemetrySet.sensor_id == Sensor.id, TelemetrySet.archived_utc.is_(None))
    return sa.select(sa.func.count()).select_from(TelemetrySet).where(in_use).correlate(Sensor).scalar_subquery()


def _worst_board_first() -> Any:
    """Return the expression that sorts sensors by what their boards need, the worst first, and then by name."""
    needs = ("critical", "caution", "standby", "off", "normal")  # the same on the ground and on board needs nobody
    ranks = {place: str(needs.index(level)) for place, level in enumerate(BOARD_WORDS.values())}
    return sa.case(ranks, value=find_board_place()) + Sensor.name


def _open_to(who: Signatory) -> sa.ColumnElement[bool]:
    """Filter the open requests that a person may sign, by the rules of `console.approvals.signers`."""
    signed = sa.select(Signature.id).where(Signature.approval_id == Approval.id, Signature.user_id == who.user_id)
    unexpired = sa.or_(Approval.expires_utc.is_(None), Approval.expires_utc > who.now_utc)
    signable = sa.and_(Approval.state == "OPEN", unexpired, ~signed.exists())
    if not who.four_eyes:
        return signable
    in_campaign = sa.select(CampaignRun.id).join(Campaign, Campaign.id == CampaignRun.campaign_id)
    in_campaign = in_campaign.where(CampaignRun.run_id == ParameterSet.run_id, Campaign.launched_by == who.user_id)
    launched = sa.select(Run.id).where(Run.id == ParameterSet.run_id, Run.launched_by == who.user_id)
    own = sa.or_(ParameterSet.created_by == who.user_id, launched.exists(), in_campaign.exists())
    of_set = sa.select(ParameterSet.id).where(ParameterSet.id == Approval.parameter_set_id, own)
    submitted = sa.and_(Approval.submitted_by.is_not(None), Approval.submitted_by == who.user_id)
    return sa.and_(signable, ~submitted, ~of_set.exists())


_final, _initial = (number_in(Run.summary, f"rms_{when}_arc_rad") for when in ("final", "initial"))

LISTS = {
    "sensors": List(
        Sensor,
        {
            "sensor": Sensor.name,
            "model": text_in(Sensor.document, "camera_model"),
            "detector": number_in(Sensor.document, "detector.rows") * number_in(Sensor.document, "detector.columns"),
            "f": sa.func.coalesce(
                _baseline(number_in(ParameterSet.document, "parameters.f_m")), number_in(Sensor.document, "initial.f_m")
            ),
            "baseline": sa.func.lower(_baseline(ParameterSet.name)),
            "sets": _sets_in_use(),
            "board": _worst_board_first(),
        },
        {
            "q": _holds(Sensor.name),
            "board": lambda word: find_board_place() == list(BOARD_WORDS).index(word),
            "among": partial(among, Sensor.id),
        },
    ),
    "runs": List(
        Run,
        {
            "run": Run.id,
            "state": Run.state,
            "label": sa.func.lower(Run.label),
            "sensor": _name_expression(Sensor, Run.sensor_id),
            "method": Run.method,
            "data": _name_expression(TelemetrySet, Run.telemetry_set_id),
            "rms": _final,
            "validation": number_in(Run.summary, "validation_rms_final_arc_rad"),
            "chi2": number_in(Run.summary, "chi2_per_dof"),
            "change": _final / sa.func.nullif(_initial, 0),
            "by": _name_expression(User, Run.launched_by),
            "started": sa.func.coalesce(Run.started_utc, Run.launched_utc),
            "ended": Run.ended_utc,
        },
        {
            "sensor": equals(Run.sensor_id),
            "sensor_name": _filter_sensor_name(Run.sensor_id),
            "state": equals(Run.state),
            "status": equals(text_in(Run.summary, "status")),
            "method": equals(Run.method),
            "data": _takes_set,
            "among": equals(Run.id),
            "in_use": lambda _: ~sa.exists().where(ArchivedRun.run_id == Run.id),
            "q": _holds(Run.label),
        },
        unread=("settings", "progress"),
        large=("sensor_document",),
        only=CALIBRATIONS,
    ),
    "telemetry": List(
        TelemetrySet,
        {
            "set": sa.func.lower(TelemetrySet.name),
            "sensor": _name_expression(Sensor, TelemetrySet.sensor_id),
            "frames": TelemetrySet.frames,
            "stars": TelemetrySet.stars,
            "unmatched": number_in(TelemetrySet.quality, "unmatched_share"),
            "uploaded": TelemetrySet.id,
        },
        {
            "sensor": equals(TelemetrySet.sensor_id),
            "sensor_name": _filter_sensor_name(TelemetrySet.sensor_id),
            "purpose": equals(TelemetrySet.purpose),
            "in_use": lambda _: TelemetrySet.archived_utc.is_(None),
            "q": _holds(TelemetrySet.name),
        },
    ),
    "parameter-sets": List(
        ParameterSet,
        {
            "set": ParameterSet.id,
            "sensor": _name_expression(Sensor, ParameterSet.sensor_id),
            "ground": ParameterSet.ground_state,
            "board": ParameterSet.onboard_state,
            "run": ParameterSet.run_id,
            "by": _name_expression(User, ParameterSet.created_by),
            "baseline": ParameterSet.baseline_from_utc,
        },
        {
            "sensor": equals(ParameterSet.sensor_id),
            "sensor_name": _filter_sensor_name(ParameterSet.sensor_id),
            "state": equals(ParameterSet.ground_state),
            "board": equals(ParameterSet.onboard_state),
            "of_a_run": lambda _: ParameterSet.run_id.is_not(None),
            "q": _holds(ParameterSet.name, ParameterSet.sha256),
        },
    ),
    "approvals": List(
        Approval,
        {
            "request": Approval.id,
            "set": _name_expression(ParameterSet, Approval.parameter_set_id),
            "state": Approval.state,
            "by": _name_expression(User, Approval.submitted_by),
            "expires": Approval.expires_utc,
        },
        {
            "state": equals(Approval.state),
            "set": equals(Approval.parameter_set_id),
            "submitted_by": equals(Approval.submitted_by),
            "open_to": _open_to,
            "q": _holds(Approval.reason),
        },
    ),
    "audit": RECORDS,
    "alarms": List(
        Alarm,
        {
            "attention": needs_nobody(),
            "alarm": Alarm.id,
            "severity": sa.case({level: rank for rank, level in enumerate(ALARM_LEVELS)}, value=Alarm.level),
            "sensor": _name_expression(Sensor, Alarm.sensor_id),
            "raised": Alarm.raised_utc,
            "assigned": _name_expression(User, Alarm.assigned_to),
        },
        {
            "state": in_state,
            "sensor": equals(Alarm.sensor_id),
            "sensor_name": _filter_sensor_name(Alarm.sensor_id),
            "kind": equals(Alarm.kind),
            "q": _holds(Alarm.kind, Alarm.sentence),
        },
    ),
    "campaigns": List(
        Campaign,
        {
            "campaign": Campaign.id,
            "label": sa.func.lower(Campaign.label),
            "preset": Campaign.preset,
            "by": _name_expression(User, Campaign.launched_by),
            "launched": Campaign.launched_utc,
        },
        {},
    ),
    "campaign-sensors": List(
        CampaignRun,
        {"launched": CampaignRun.id},
        {
            "campaign": equals(CampaignRun.campaign_id),
            "newest": lambda _: CampaignRun.id.in_(select_newest_members()),
        },
    ),
    "import-profiles": List(ImportProfile, {}, {"in_use": lambda _: ImportProfile.archived_utc.is_(None)}),
    "presets": List(Preset, {}, {"in_use": lambda _: Preset.archived_utc.is_(None)}),
    "change-proposals": List(
        ChangeProposal,
        {
            "proposal": ChangeProposal.id,
            "kind": ChangeProposal.kind,
            "state": ChangeProposal.state,
            "by": _name_expression(User, ChangeProposal.proposed_by),
            "expires": ChangeProposal.expires_utc,
        },
        {
            "sensor": equals(ChangeProposal.sensor_id),
            "kind": equals(ChangeProposal.kind),
            "state": equals(ChangeProposal.state),
        },
    ),
    "alignments": List(
        Alignment,
        {
            "alignment": Alignment.id,
            "state": Alignment.state,
            "a": _name_expression(Sensor, Alignment.sensor_a_id),
            "b": _name_expression(Sensor, Alignment.sensor_b_id),
            "by": _name_expression(User, Alignment.created_by),
        },
        {"sensor": _filter_either_sensor, "state": equals(Alignment.state)},
    ),
    "alignment-requests": List(
        AlignmentRequest,
        {"request": AlignmentRequest.id},
        {
            "state": equals(AlignmentRequest.state),
            "alignment": equals(AlignmentRequest.alignment_id),
            "submitted_by": equals(AlignmentRequest.submitted_by),
            "q": _holds(AlignmentRequest.reason),
        },
    ),
    "ingest-decisions": List(
        IngestDecision,
        {
            "decision": IngestDecision.id,
            "sensor": _name_expression(Sensor, IngestDecision.sensor_id),
            "state": IngestDecision.state,
            "file": sa.func.lower(IngestDecision.file_name),
        },
        {
            "sensor": equals(IngestDecision.sensor_id),
            "sensor_name": _filter_sensor_name(IngestDecision.sensor_id),
            "state": equals(IngestDecision.state),
            "q": _holds(IngestDecision.file_name),
        },
    ),
    "ingest-policies": List(
        IngestPolicy, {}, {"sensor": equals(IngestPolicy.sensor_id), "state": equals(IngestPolicy.state)}
    ),
    "packages": List(
        Package,
        {},
        {"set": equals(Package.parameter_set_id), "sensor": _filter_set_sensor(Package.parameter_set_id)},
    ),
    "uplinks": List(
        Uplink,
        {},
        {"set": equals(Uplink.parameter_set_id), "sensor": _filter_set_sensor(Uplink.parameter_set_id)},
    ),
    "deliveries": List(WebhookDelivery, {}, {"webhook": equals(WebhookDelivery.webhook_id)}),
    "messages": List(Message, {}, {"address": equals(Message.address_id)}),
    "log-ins": List(
        LoginSession,
        {},
        {
            "user": equals(LoginSession.user_id),
            "open": lambda is_open: (
                LoginSession.ended_utc.is_(None) if is_open else LoginSession.ended_utc.is_not(None)
            ),
        },
    ),
}
NAMES = {known.table: name for name, known in LISTS.items()}


def list_newest(
    session: Session, table: type[T], *, before_id: int | None = None, limit: int | None = None, **where: Any
) -> list[T]:
    """Return a page of a table's rows, newest first, narrowed by what is not None; the next starts before the last one's id."""
    return list_newest_rows(session, LISTS[NAMES[table]], before_id=before_id, limit=limit, **where)


def list_rows(session: Session, name: str, asked: ListQuery, limit: int) -> list[Any]:
    """Return the rows of a page, at most `limit`."""
    known = LISTS[name]
    return _read_rows(session, known, session.scalars(_ids(session, known, asked).limit(limit)).all())


def count(session: Session, name: str, where: Mapping[str, Any]) -> int:
    """Return the number of rows of a list that match its filters."""
    known = LISTS[name]
    narrowed = sa.select(sa.func.count()).select_from(known.table)
    fitting = (known.filters[key](value) for key, value in _checked(name, where).items())
    return session.scalar(narrowed.where(known.only, *fitting)) or 0


def walk(session: Session, name: str, asked: ListQuery) -> Iterator[Any]:
    """Yield every row of a list in its order, from the first page on, without holding them all."""
    known = LISTS[name]
    ids = session.scalars(_ids(session, known, asked)).all()
    for start in range(0, len(ids), ROWS_A_READ):
        yield from _read_rows(session, known, ids[start : start + ROWS_A_READ])
        session.expunge_all()


def _ids(session: Session, known: List, asked: ListQuery) -> Any:
    """Select the ids of a list in its order, from the page on."""
    identity, key = known.table.id, known.keys[asked.sort.removeprefix("-")]
    query = sa.select(identity).where(known.only, *(known.filters[name](value) for name, value in asked.where.items()))
    descends = asked.sort.startswith("-")
    if asked.before_id is not None:
        query = query.where(_after(session, known, key, descends, asked.before_id))
    if key is identity:
        return query.order_by(identity.desc() if descends else identity)
    return query.order_by((key.desc() if descends else key.asc()).nulls_last(), identity.desc())


def _after(session: Session, known: List, key: Any, descends: bool, before_id: int) -> sa.ColumnElement[bool]:
    """Return the SQL condition for the rows after one."""
    identity = known.table.id
    if key is identity:
        return identity < before_id if descends else identity > before_id  # type: ignore[no-any-return]  # columns are Any here
    last = session.scalar(sa.select(key).where(identity == before_id))
    if last is None:
        return sa.and_(key.is_(None), identity < before_id)
    further = key < last if descends else key > last
    return sa.or_(further, sa.and_(key == last, identity < before_id), key.is_(None))


def _read_rows(session: Session, known: List, ids: Sequence[int]) -> list[Any]:
    """Read rows by their ids, in the order of the ids."""
    left_out = [defer(getattr(known.table, name)) for name in (*known.unread, *known.large)]
    found = session.scalars(sa.select(known.table).where(among(known.table.id, ids)).options(*left_out))
    by_id = {row.id: row for row in found}
    return [by_id[number] for number in ids if number in by_id]


def read_page(
    session: Session, name: str, where: Mapping[str, Any], sort: str, *, before_id: int | None = None, limit: int
) -> list[Any]:
    """Return a page of a list; the next page is that before the last row's id."""
    return list_rows(session, name, _asked(name, where, sort, before_id), limit)


def read_all(session: Session, name: str, where: Mapping[str, Any], sort: str) -> Iterator[Any]:
    """Yield every row of a list in its order."""
    return walk(session, name, _asked(name, where, sort, None))


def _asked(name: str, where: Mapping[str, Any], sort: str, before_id: int | None) -> ListQuery:
    """Check the names of filters and sort key, and return the query."""
    known = LISTS[name]
    if sort.removeprefix("-") not in known.keys:
        raise RefusedInputError(f"The list cannot be sorted by {sort!r}; choose from {', '.join(known.keys)}.")
    return ListQuery(_checked(name, where), sort, before_id)


def _checked(name: str, where: Mapping[str, Any]) -> Mapping[str, Any]:
    """Refuse filters that a list does not know."""
    known = LISTS[name].filters
    if strange := sorted(set(where) - set(known)):
        raise RefusedInputError(f"The list has no filter {', '.join(strange)}; choose from {', '.join(known)}.")
    return where
