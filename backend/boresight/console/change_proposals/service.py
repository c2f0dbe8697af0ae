"""A second person for gate limits and table layouts, where the policy asks for one.

A change is checked and proposed, and checked again when somebody else confirms it in person; until then nothing moves.
A proposal binds the version in force that it was made against::

    OPEN --another confirms--> CONFIRMED   --another refuses--> REFUSED   --who proposed takes it back--> WITHDRAWN
    OPEN --another version came into force--> STALE                       --its time is over--> EXPIRED
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from boresight.console import list_queries as lists
from boresight.console.access.passwords import name_password_setter
from boresight.console.access.tables import User
from boresight.console.alarms import rules as alarm_rules
from boresight.console.approvals import gate_profiles
from boresight.console.approvals import queries as gate_rows
from boresight.console.approvals.tables import GateProfile
from boresight.console.change_proposals import queries as rows
from boresight.console.change_proposals.tables import PROPOSAL_KINDS, PROPOSAL_STATES, ChangeProposal
from boresight.console.transitions import describe_last_change, move, name_subject, require_seen
from boresight.console.uplinks import queries as table_rows
from boresight.console.uplinks import table_definitions
from boresight.console.uplinks.tables import TableDefinition
from boresight.errors import ConflictError, ForbiddenError, RefusedInputError, StaleError
from boresight.platform.actors import (
    DAY_S,
    SYSTEM,
    Actor,
    Policy,
    require_person,
    require_role,
    require_scope,
    require_user,
)
from boresight.platform.audit import log as audit
from boresight.platform.audit.subjects import AuditAction
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Session, keep_despite_refusal, utc_after, utc_now
from boresight.platform.web.text_validation import refuse_control_characters

MAY_CONFIRM = {"gate-profile": ("administrator",), "table-definition": ("analyst", "administrator")}
TITLES = {"gate-profile": "gate profile", "table-definition": "table definition"}
Scalar = str | int | float | bool | None


@dataclass(frozen=True)
class ChangedEntry:
    """An entry that a proposal changes."""

    place: str
    before: Scalar
    after: Scalar


def change(
    session: Session,
    actor: Actor,
    kind: str,
    sensor_id: int,
    document: Mapping[str, Any],
    reason: str,
    seen_number: int | None,
    *,
    policy: Policy,
) -> GateProfile | TableDefinition | ChangeProposal:
    """Put a change into force, or propose it where the policy asks for a second person."""
    if not policy.second_person:
        change_now = gate_profiles.set_profile if kind == "gate-profile" else table_definitions.set_definition
        made = change_now(session, actor, sensor_id, document, reason, seen_number)
        _make_stale(session, actor, sensor_id, kind, made.number)
        return made
    complete = _check_document(session, actor, kind, sensor_id, document, reason, seen_number)
    same = [row for row in list_open_proposals(session, sensor_id, kind) if row.sha256 == compute_sha256(complete)]
    if same:
        raise ConflictError(f"Proposal {same[0].id} already contains this change: have another person confirm it.")
    row = ChangeProposal(
        sensor_id=sensor_id,
        kind=kind,
        base_number=_read_number_in_force(session, kind, sensor_id),
        document=complete,
        sha256=compute_sha256(complete),
        reason=reason.strip(),
        proposed_utc=utc_now(),
        proposed_by=require_user(actor, "propose a change"),
        expires_utc=utc_after(policy.approval_days * DAY_S),
        state="OPEN",
    )
    session.put(row)
    told = {"kind": kind, "sensor": f"sensors/{sensor_id}", "against": row.base_number, "sha256": row.sha256}
    told |= {"document": complete, "expires_utc": row.expires_utc}
    audit.append(session, actor, AuditAction.PROPOSED, name_subject(row), None, told, row.reason)
    return row


def explain_why_not_decide(session: Session, actor: Actor, row: ChangeProposal) -> str | None:
    """Say why this actor may neither confirm nor refuse a proposal; None when they may."""
    try:
        _refuse_decider(session, actor, row)
    except ForbiddenError as refusal:
        return str(refusal)
    return _explain_closed(session, row)


def may_withdraw(session: Session, actor: Actor, row: ChangeProposal) -> bool:
    """Whether this actor may take a proposal back now."""
    return _is_own(actor, row) and _explain_closed(session, row) is None


def _is_own(actor: Actor, row: ChangeProposal) -> bool:
    """Whether a proposal is the actor's to take back: who made it, or an administrator."""
    return actor.user_id == row.proposed_by or "administrator" in actor.roles


def confirm(
    session: Session, actor: Actor, proposal_id: int, seen_version: int | None, comment: str = ""
) -> ChangeProposal:
    """Put a proposed change into force, as a second person."""
    row = session.get_known(ChangeProposal, proposal_id)
    _refuse_decider(session, actor, row)
    require_seen(session, row, seen_version)
    _require_open(session, row)
    number = _read_number_in_force(session, row.kind, row.sensor_id)
    if number != row.base_number:
        _make_stale(session, actor, row.sensor_id, row.kind, number)
        keep_despite_refusal(session)
        raise StaleError(
            f"Proposal {row.id} was made against version {row.base_number} of the {TITLES[row.kind]}, and version "
            f"{number} is in force now. Propose the change again.",
            code="proposal-outdated",
        )
    refuse_control_characters(comment=comment)
    told = name_password_setter(session, require_person(actor, "confirm a change"))
    row.number = number + 1
    _close(session, actor, row, "CONFIRMED", "confirmed", comment=comment, password_by=told)
    put = gate_profiles.put_into_force if row.kind == "gate-profile" else table_definitions.put_into_force
    put(session, actor, row.sensor_id, row.document, row.reason, proposal=row)
    _make_stale(session, actor, row.sensor_id, row.kind, row.number)
    return row


def refuse(session: Session, actor: Actor, proposal_id: int, seen_version: int | None, comment: str) -> ChangeProposal:
    """Refuse a proposed change, as a second person, with a comment."""
    row = session.get_known(ChangeProposal, proposal_id)
    _refuse_decider(session, actor, row)
    require_seen(session, row, seen_version)
    _require_open(session, row)
    if not comment.strip():
        raise RefusedInputError("Say why you refuse: the proposer needs the comment.")
    told = name_password_setter(session, require_person(actor, "refuse a change"))
    _close(session, actor, row, "REFUSED", "refused", comment=comment, password_by=told)
    return row


def withdraw(session: Session, actor: Actor, proposal_id: int, seen_version: int | None) -> ChangeProposal:
    """Take a proposal back: who made it, or an administrator."""
    require_scope(actor, "sensors")
    row = session.get_known(ChangeProposal, proposal_id)
    if not _is_own(actor, row):
        require_role(actor, "administrator")
    require_seen(session, row, seen_version)
    _require_open(session, row)
    _close(session, actor, row, "WITHDRAWN", "withdrew")
    return row


def _explain_closed(session: Session, row: ChangeProposal) -> str | None:
    """Say why nobody can decide on a proposal any more; None while somebody can."""
    if row.state != "OPEN":
        return f"Proposal {row.id} is {row.state}: {describe_last_change(session, row)}. Propose the change again."
    if row.expires_utc <= utc_now() and not alarm_rules.is_held(session):
        return f"Proposal {row.id} expired at {row.expires_utc}. Propose the change again."
    return None


def _require_open(session: Session, row: ChangeProposal) -> None:
    """Refuse to decide on what is decided; one whose time is over is EXPIRED from now on."""
    why = _explain_closed(session, row)
    if why is None:
        return
    if row.state == "OPEN":
        _expire(session, row)
        keep_despite_refusal(session)
    raise ConflictError(why, code="wrong-state")


def _close(
    session: Session,
    actor: Actor,
    row: ChangeProposal,
    state: str,
    action: str,
    *,
    comment: str = "",
    reason: str | None = None,
    password_by: str | None = None,
) -> None:
    """Bring a proposal into its last state, with its audit record."""
    refuse_control_characters(comment=comment)
    row.closed_utc, row.closed_by, row.comment = utc_now(), actor.user_id, comment.strip() or None
    told = {"kind": row.kind, "sensor": f"sensors/{row.sensor_id}", "sha256": row.sha256, "number": row.number}
    told |= {} if password_by is None else {"password_by": password_by}
    move(session, actor, row, state, action, reason=reason or row.comment, **told)


def _make_stale(session: Session, actor: Actor, sensor_id: int, kind: str, number: int) -> None:
    """Close every proposal that was made against a version which is in force no more."""
    for row in list_open_proposals(session, sensor_id, kind):
        if row.base_number != number:
            _close(session, actor, row, "STALE", "made stale", reason=f"version {number} came into force")


def is_any_due(session: Session) -> bool:
    """Whether there are proposals whose time is over and that still stand open."""
    return bool(rows.list_due_proposals(session, utc_now())) and not alarm_rules.is_held(session)


def expire_due(session: Session) -> Sequence[ChangeProposal]:
    """Close every proposal whose time is over, and return them."""
    found = () if alarm_rules.is_held(session) else rows.list_due_proposals(session, utc_now())
    for row in found:
        _expire(session, row)
    return found


def _expire(session: Session, row: ChangeProposal) -> None:
    _close(session, SYSTEM, row, "EXPIRED", "let expire", reason=f"no decision was made before {row.expires_utc}")


def list_proposals(
    session: Session,
    *,
    sensor_id: int | None = None,
    kind: str | None = None,
    state: str | None = None,
    before_id: int | None = None,
    limit: int | None = None,
) -> Sequence[ChangeProposal]:
    """Return proposals, newest first: all, or a page, the next of which starts before the last one's id."""
    for asked, known in ((kind, PROPOSAL_KINDS), (state, PROPOSAL_STATES)):
        if asked is not None and asked not in known:
            raise RefusedInputError(f"{asked!r} is not a state of a proposal; choose from {', '.join(known)}.")
    return lists.list_newest(
        session, ChangeProposal, before_id=before_id, limit=limit, sensor=sensor_id, kind=kind, state=state
    )


def list_open_proposals(
    session: Session, sensor_id: int | None = None, kind: str | None = None
) -> Sequence[ChangeProposal]:
    """Return every proposal that waits, of a sensor or of all, newest first."""
    return lists.list_newest(session, ChangeProposal, sensor=sensor_id, kind=kind, state="OPEN")


def list_confirmed_by_number(session: Session, sensor_id: int, kind: str) -> dict[int, ChangeProposal]:
    """Return the proposals that came into force, by the number of the version that they became."""
    found = lists.list_newest(session, ChangeProposal, sensor=sensor_id, kind=kind, state="CONFIRMED")
    return {row.number: row for row in found if row.number is not None}


def list_differences(session: Session, row: ChangeProposal) -> list[ChangedEntry]:
    """Return what a proposal changes in the version that it was made against."""
    before, after = dict(_leaves(_read_base(session, row))), dict(_leaves(row.document))
    places = [*before, *(place for place in after if place not in before)]
    return [
        ChangedEntry(place, before.get(place), after.get(place))
        for place in places
        if (place in before) != (place in after) or before[place] != after[place]
    ]


def _refuse_decider(session: Session, actor: Actor, row: ChangeProposal) -> None:
    user_id = require_person(actor, "confirm or refuse a change")
    require_role(actor, *MAY_CONFIRM[row.kind])
    if user_id == row.proposed_by:
        raise ForbiddenError("You proposed this change; have another person confirm or refuse it.", code="own-proposal")
    if session.get_one(User, user_id).must_change_password:
        raise ForbiddenError("Somebody else set your password; set your own first, then decide.", code="password-due")


def _check_document(
    session: Session,
    actor: Actor,
    kind: str,
    sensor_id: int,
    document: Mapping[str, Any],
    reason: str,
    seen_number: int | None,
) -> dict[str, Any]:
    """Return a document as it would be stored, if it could be put into force now."""
    check = gate_profiles.check_profile if kind == "gate-profile" else table_definitions.check_definition
    return check(session, actor, sensor_id, document, reason, seen_number)


def _read_number_in_force(session: Session, kind: str, sensor_id: int) -> int:
    """Return the number of the version in force; 0 for the default, or none."""
    if kind == "gate-profile":
        return gate_profiles.get_profile_in_force(session, sensor_id).number
    row = table_definitions.find_definition_in_force(session, sensor_id)
    return 0 if row is None else row.number


def _read_base(session: Session, row: ChangeProposal) -> Mapping[str, Any]:
    if row.kind == "gate-profile":
        profiles = gate_rows.list_profiles(session, row.sensor_id, 1, until=row.base_number)
        return profiles[0].document if profiles else gate_profiles.DEFAULT
    definitions = table_rows.list_definitions(session, row.sensor_id, 1, until=row.base_number)
    return definitions[0].document if definitions else {}


def _leaves(value: Any, place: str = "") -> Iterator[tuple[str, Scalar]]:
    """Yield every entry of a document with its path; list items are addressed by name where they have one."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _leaves(inner, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list) and value:
        for index, inner in enumerate(value):
            name = inner.get("name", index) if isinstance(inner, Mapping) else index
            yield from _leaves(inner, f"{place}[{name}]")
    else:
        yield place, json.dumps(value) if isinstance(value, Mapping | list) else value
