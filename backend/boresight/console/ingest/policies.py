"""Policies: drafted, rehearsed on the past, put into force by an administrator, paused by what runs away, resumed by a person.

    DRAFT --rehearse--> DRAFT --enable--> ACTIVE --runaway, or a person--> PAUSED --a person--> ACTIVE
    DRAFT, ACTIVE, PAUSED --a person, or a newer version is enabled--> OFF

A policy that was not rehearsed is not enabled. Its rules never change: other rules are its next version, a draft again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.console.alarms.rules import update_alarms
from boresight.console.fleet.tables import Sensor
from boresight.console.fleet.trend import read_trend
from boresight.console.ingest import queries as rows
from boresight.console.ingest.change_tests import rehearse
from boresight.console.ingest.rules import PolicyRules, parse_rules
from boresight.console.ingest.tables import IngestPolicy
from boresight.console.runs.presets import get_offer
from boresight.console.telemetry.profiles import find_profile
from boresight.console.transitions import move, name_subject, require_seen
from boresight.errors import BoresightError, ConflictError, RefusedInputError
from boresight.mission_control.systems import TITLES
from boresight.platform.actors import INGEST, Actor, require_person, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import refuse_control_characters

WRITERS = ("analyst", "administrator")
LONGEST_REASON = 2000


@dataclass(frozen=True)
class PolicyStep:
    """A step of a policy: who takes it, from which states, what to do in another, and whether only in person, as what."""

    roles: tuple[str, ...]
    states: tuple[str, ...]
    remedy: str
    in_person: str = ""


STEPS = {
    "rehearse": PolicyStep(WRITERS, ("DRAFT", "ACTIVE", "PAUSED"), "write a new version and rehearse that"),
    "enable": PolicyStep(("administrator",), ("DRAFT",), "write a new version to enable", "enable an ingest policy"),
    "pause": PolicyStep((*WRITERS, "operator"), ("ACTIVE",), "choose an ACTIVE one to pause"),
    "resume": PolicyStep(WRITERS, ("PAUSED",), "choose a PAUSED one to resume", "resume an ingest policy"),
    "switch-off": PolicyStep((*WRITERS, "operator"), ("DRAFT", "ACTIVE", "PAUSED"), "there is nothing to switch off"),
}


def may_write(actor: Actor) -> bool:
    """Whether an actor may draft policies."""
    return bool(actor.roles.intersection(WRITERS))


def list_open_steps(session: Session, actor: Actor, row: IngestPolicy) -> set[str]:
    """Return the steps of a policy that this actor may take now."""
    found = {name for name, step in STEPS.items() if row.state in step.states and actor.roles.intersection(step.roles)}
    return found - ({"enable"} if explain_why_not_enable(session, row) else set())


def explain_why_not_enable(session: Session, row: IngestPolicy) -> str | None:
    """Say what a draft lacks to be enabled; None where it lacks nothing."""
    try:
        _refuse_unready(session, row)
    except BoresightError as refusal:
        return str(refusal)
    return None


def _refuse_unready(session: Session, row: IngestPolicy) -> None:
    if row.rehearsal is None:
        raise ConflictError(
            f"Policy {row.number} has not been rehearsed; rehearse it first to see which decisions it would have requested."
        )
    _refuse_unknown(session, read_rules(row))


def _take(session: Session, actor: Actor, name: str, policy_id: int, seen_version: int | None) -> IngestPolicy:
    """Return a policy to take a step of; refuse who may not, and one whose state does not allow it."""
    step = STEPS[name]
    if step.in_person:
        require_person(actor, step.in_person)
    require_role(actor, *step.roles)
    require_scope(actor, "telemetry-sets")
    row = session.get_known(IngestPolicy, policy_id)
    require_seen(session, row, seen_version)
    if row.state not in step.states:
        raise ConflictError(f"Policy {row.number} is {row.state}; {step.remedy}.")
    return row


def read_rules(row: IngestPolicy) -> PolicyRules:
    """Return the rules of a policy."""
    return parse_rules(row.document)


def draft(session: Session, actor: Actor, sensor_id: int, document: Mapping[str, Any], reason: str) -> IngestPolicy:
    """Write the next version of a sensor's policy, which does nothing until it was rehearsed and enabled."""
    require_role(actor, *WRITERS)
    require_scope(actor, "telemetry-sets")
    session.get_known(Sensor, sensor_id)
    rules = parse_rules(document)
    _refuse_unknown(session, rules)
    row = IngestPolicy(
        sensor_id=sensor_id,
        number=rows.read_next_number(session, sensor_id),
        document=rules.to_dict(),
        sha256=compute_sha256(rules.to_dict()),
        reason=_check_reason(reason, "for this policy"),
        created_utc=utc_now(),
        created_by=actor.user_id,
        state="DRAFT",
    )
    session.put(row)
    told = {"sensor_id": sensor_id, "number": row.number, "rules": row.document, "sha256": row.sha256}
    audit.append(session, actor, "drafted", name_subject(row), None, told, row.reason)
    return row


def _refuse_unknown(session: Session, rules: PolicyRules) -> None:
    """Refuse a profile, a preset or an archive that is not there."""
    get_offer(session, rules.preset)
    profile = find_profile(session, rules.profile) if rules.profile else None
    if rules.feed and rules.feed not in TITLES:
        raise RefusedInputError(f"There is no archive {rules.feed!r}; choose from {', '.join(TITLES)}, or none.")
    if rules.feed and profile is None:
        raise RefusedInputError(
            f"Pulling from {TITLES[rules.feed]} requires a mapping profile, but the policy has none; choose one."
        )


def compute_rehearsal(session: Session, policy_id: int) -> dict[str, Any]:
    """Say what a policy would have asked in the past; only reads."""
    row = session.get_known(IngestPolicy, policy_id)
    return rehearse(read_trend(session, row.sensor_id), read_rules(row))


def record_rehearsal(
    session: Session, actor: Actor, policy_id: int, found: Mapping[str, Any], seen_version: int | None
) -> IngestPolicy:
    """Put a rehearsal on record, without which a policy is not enabled."""
    row = _take(session, actor, "rehearse", policy_id, seen_version)
    row.rehearsal, row.rehearsed_utc = dict(found), utc_now()
    told = {name: found[name] for name in ("sets", "asked", "held", "unconfirmed", "not_judged")}
    move(session, actor, row, row.state, "rehearsed", **told)
    return row


def enable(session: Session, actor: Actor, policy_id: int, seen_version: int | None) -> IngestPolicy:
    """Put a rehearsed draft into force, in place of the policy that is; an administrator, in person."""
    row = _take(session, actor, "enable", policy_id, seen_version)
    _refuse_unready(session, row)
    before = rows.find_policy_in_force(session, row.sensor_id)
    if before is not None:
        move(session, actor, before, "OFF", "switched off", reason=f"Policy {row.number} is in force.")
        session.flush()
    row.enabled_utc = row.resumed_utc = utc_now()
    move(session, actor, row, "ACTIVE", "enabled", sha256=row.sha256)
    update_alarms(session, [row.sensor_id])
    return row


def pause(session: Session, row: IngestPolicy, code: str, reason: str) -> None:
    """Stop a policy that runs away, and raise its alarm."""
    if row.state != "ACTIVE":
        return
    _pause(session, INGEST, row, code, reason)


def _pause(session: Session, actor: Actor, row: IngestPolicy, code: str, reason: str) -> None:
    row.pause_code, row.pause_reason, row.paused_utc = code, reason, utc_now()
    move(session, actor, row, "PAUSED", "paused", reason=reason, code=code)
    update_alarms(session, [row.sensor_id])


def pause_by_person(
    session: Session, actor: Actor, policy_id: int, reason: str, seen_version: int | None
) -> IngestPolicy:
    """Stop a policy until it is resumed; files stay where they are."""
    row = _take(session, actor, "pause", policy_id, seen_version)
    _pause(session, actor, row, "PERSON", _check_reason(reason, "for pausing it"))
    return row


def resume(session: Session, actor: Actor, policy_id: int, reason: str, seen_version: int | None) -> IngestPolicy:
    """Let a paused policy go on; the counts that stopped it begin again. Only a person may, because a machine stopped it."""
    row = _take(session, actor, "resume", policy_id, seen_version)
    said = _check_reason(reason, "for resuming it")
    row.resumed_utc = utc_now()
    row.pause_code = row.pause_reason = row.paused_utc = None
    move(session, actor, row, "ACTIVE", "resumed", reason=said)
    update_alarms(session, [row.sensor_id])
    return row


def switch_off(session: Session, actor: Actor, policy_id: int, reason: str, seen_version: int | None) -> IngestPolicy:
    """Take a policy out of force for good, or give a draft up."""
    row = _take(session, actor, "switch-off", policy_id, seen_version)
    move(session, actor, row, "OFF", "switched off", reason=_check_reason(reason, "for switching it off"))
    update_alarms(session, [row.sensor_id])
    return row


def _check_reason(reason: str, what: str) -> str:
    refuse_control_characters(reason=reason)
    if not reason.strip() or len(reason) > LONGEST_REASON:
        raise RefusedInputError(f"Enter the reason {what}, up to {LONGEST_REASON} characters.")
    return reason.strip()
