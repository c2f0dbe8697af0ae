"""Waivers: a person lets a set pass in spite of a gate, with a reason, until a time.

A waiver is never taken back and never removed. While it holds the gate does not block; when it expires the gate blocks again;
and the verdict of the set says for ever how many gates were waived. It changes the evidence, so an open request of the set
becomes STALE, and the next one needs one approval more.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from boresight.errors import ConflictError, ForbiddenError, RefusedInputError
from boresight.services import audit, staleness, users
from boresight.services.actors import Actor, require_person, require_role
from boresight.services.gates import latest_report, with_waivers
from boresight.services.passwords import PasswordProof
from boresight.services.transitions import get_parameter_set, require_seen
from boresight.services.words import refuse_control_characters
from boresight.store import gates as rows
from boresight.store.sessions import Session, utc_after, utc_now
from boresight.store.tables import GateReport, Waiver
from boresight.store.times import read_time
from boresight.verdicts.gates import GATES

CODES = {
    "known-cause": "The cause is known and does no harm",
    "limit-too-tight": "The limit is tighter than this case needs",
    "data-limited": "No better data can be had in time",
    "mission-need": "The mission needs the set in spite of it",
    "other": "Another reason",
}
LEAST_LETTERS = 20
LONGEST_DAYS = 30
DAY_S = 86400.0


def waive(  # noqa: PLR0913, PLR0917 - a waiver has all of these, and a form gives them one by one
    session: Session,
    actor: Actor,
    parameter_set_id: int,
    gate: str,
    code: str,
    reason: str,
    expires_utc: str,
    proof: PasswordProof,
    seen_version: int | None,
) -> Waiver:
    """Let a set pass in spite of a gate that blocks it, as a person who gives the password again.

    Parameters
    ----------
    gate
        One that blocks the set in the report that holds now.
    code, reason
        Of `CODES`, and in at least `LEAST_LETTERS` letters of one's own.
    expires_utc
        Until when, ISO 8601; within `LONGEST_DAYS` days.
    seen_version
        Version of the set that the person saw.

    Raises
    ------
    ForbiddenError, UnauthenticatedError
        When the actor is no analyst or approver in person, the gate is critical, or the password is wrong.
    NotFoundError, PreconditionRequiredError, StaleError
        When there is no such set, or it is not as it was seen.
    ConflictError
        When there is no report that holds, or the gate does not block.
    RefusedInputError
        When gate, code, reason or expiry cannot be used.
    """
    user_id = require_person(actor, "waive a gate")
    require_role(actor, "analyst", "approver")
    row = get_parameter_set(session, parameter_set_id)
    require_seen(session, row, seen_version)
    until = _checked(gate, code, reason, expires_utc)
    report = _blocking_report(session, parameter_set_id, row.name, gate)
    users.require_password(session, actor, proof)
    waiver = Waiver(
        parameter_set_id=row.id,
        gate_report_id=report.id,
        gate=gate,
        code=code,
        reason=reason.strip(),
        expires_utc=until,
        made_utc=utc_now(),
        made_by=user_id,
        printed_name=actor.printed_name,
    )
    session.add(waiver)
    session.flush()
    told: dict[str, Any] = {"set": row.name, "gate": gate, "code": code, "expires_utc": until, "report": report.sha256}
    audit.append(session, actor, "waived a gate of", f"parameter-sets/{row.id}/waivers", None, told, waiver.reason)
    staleness.make_stale_of_set(session, actor, row.id, f"its gate {gate} was waived")
    return waiver


def _checked(gate: str, code: str, reason: str, expires_utc: str) -> str:
    """Refuse what is no waiver, and return its expiry as the store writes it."""
    refuse_control_characters(reason=reason)
    if gate not in GATES:
        raise RefusedInputError(f"There is no gate {gate!r}; the gates are {', '.join(GATES)}.")
    if code not in CODES:
        raise RefusedInputError(f"There is no reason code {code!r}; choose from {', '.join(CODES)}.")
    if len(reason.strip()) < LEAST_LETTERS:
        raise RefusedInputError(f"Give the reason in at least {LEAST_LETTERS} letters: the approvers must judge it.")
    until = read_time(expires_utc)
    if not utc_now() < until <= utc_after(LONGEST_DAYS * DAY_S):
        raise RefusedInputError(f"The waiver must expire in the future and within {LONGEST_DAYS} days, not at {until}.")
    return until


def _blocking_report(session: Session, parameter_set_id: int, name: str, gate: str) -> GateReport:
    """Return the report that holds, if this gate blocks in it and may be waived."""
    report = latest_report(session, parameter_set_id)
    if report is None:
        raise ConflictError(f"{name} has no gate report that holds now: assess it, then waive what blocks it.")
    document = with_waivers(session, report)
    answer = next(one for one in document["gates"] if one["name"] == gate)
    if gate not in document["blocking"]:
        how = "waived already" if answer["waived"] else answer["status"]
        raise ConflictError(f"The gate {gate} does not block {name}: it is {how}. There is nothing to waive.")
    if answer["critical"] or not answer["waivable"]:
        why = "it is critical" if answer["critical"] else "the gate profile does not let it be waived"
        raise ForbiddenError(f"Nobody can waive the gate {gate}: {why}. Calibrate again.")
    return report


def active_waivers(session: Session, parameter_set_id: int) -> Sequence[Waiver]:
    """Return a set's waivers that hold now, in order."""
    now = utc_now()
    return [waiver for waiver in all_waivers(session, parameter_set_id) if waiver.expires_utc > now]


def all_waivers(session: Session, parameter_set_id: int) -> Sequence[Waiver]:
    """Return every waiver that a set was ever given, in order."""
    return rows.waivers(session, [parameter_set_id])
