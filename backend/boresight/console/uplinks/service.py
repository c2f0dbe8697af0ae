"""What is on board, as people recorded it; Boresight commands no spacecraft.

    NOT SENT --> SENT --> LOADED --> VERIFIED --> ACTIVE
    SENT, LOADED, MISMATCH, UNKNOWN     somebody's statement          `record`
    VERIFIED, MISMATCH                  a comparison of what was read `read_backs.read_back`
    ACTIVE                              a signature in person         `activate`

ACTIVE always follows a read-back that agreed. MISMATCH and UNKNOWN are left by sending again or by a read-back. One set
is active: the one before becomes UNKNOWN. Nothing on the ground moves these states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from boresight.calibration.parameter_set import parse_parameter_set
from boresight.console.access import confirmations, users
from boresight.console.access.passwords import PasswordProof
from boresight.console.alarms.rules import update_alarms
from boresight.console.approvals.review import warn_of_turn
from boresight.console.fleet.timeline import happened_on
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.parameter_sets.tables import ONBOARD_ACTIONS, ParameterSet
from boresight.console.transitions import name_subject, require_seen
from boresight.console.uplinks import queries as rows
from boresight.console.uplinks.table_definitions import find_definition_in_force
from boresight.console.uplinks.tables import C_SD_ANSWERS, Package, Uplink
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, require_person, require_role, require_scope, require_user
from boresight.platform.audit import log as audit
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.db.times import read_time
from boresight.platform.web.text_validation import refuse_control_characters, refuse_long


@dataclass(frozen=True)
class CsdAnswer:
    """Whether the update of C_SD was loaded, and when and how, or why not."""

    answer: str
    said: str = ""

    @classmethod
    def from_given(cls, answer: str | None, said: str) -> CsdAnswer | None:
        """Make it of what was given; None where nothing was."""
        if not answer and said.strip():
            raise RefusedInputError(
                "Say with c_sd_said also in c_sd whether the update of C_SD was loaded, or leave both out."
            )
        return cls(answer, said) if answer else None


@dataclass(frozen=True)
class EntryBasis:
    """The basis of an entry; with a source alone it is a statement."""

    details: Mapping[str, Any] = field(default_factory=dict)
    method: str | None = None
    printed_name: str | None = None
    meaning: str | None = None
    c_sd: CsdAnswer | None = None
    leaves_state: bool = False


STATEMENT = EntryBasis()


def require_entrant(actor: Actor) -> None:
    """Refuse who may not enter what happened on board."""
    require_role(actor, "operator")
    require_scope(actor, "uplinks")
    require_user(actor, "record an uplink")


def get_set_for_entry(
    session: Session, actor: Actor, parameter_set_id: int, source: str, seen_version: int | None
) -> ParameterSet:
    """Return the set of an operator's entry, after checking role and version."""
    require_entrant(actor)
    refuse_control_characters(source=source)
    refuse_long(source=source)
    row = session.get_known(ParameterSet, parameter_set_id)
    if seen_version is not None:
        require_seen(session, row, seen_version)
    if not source.strip():
        raise RefusedInputError("Give the source: the pass, the procedure or the read-back file.")
    return row


def has_shown_mismatch(session: Session, row: ParameterSet) -> bool:
    """Say whether a dump of what was last sent differed, and no dump has agreed since.

    What was recorded in between, by statement or by CRC, changes nothing of it: of all that was recorded since the set was
    last SENT only the comparisons of bytes count, and the newest of them decides.
    """
    sent = rows.find_newest_record(session, row.id, "SENT")
    compared = rows.find_newest_compared(session, row.id, "bytes", 0 if sent is None else sent.id)
    return compared is not None and compared.onboard_state == "MISMATCH"


def refuse_shown_mismatch(session: Session, row: ParameterSet) -> None:
    """Refuse to leave a mismatch that a dump showed without another dump or sending again."""
    if has_shown_mismatch(session, row):
        raise ConflictError(
            f"The mismatch of {row.name} was found by a dump; upload a dump that matches, or send the table again.",
            code="dump-mismatched",
        )


def add_entry(
    session: Session, actor: Actor, row: ParameterSet, onboard_state: str, source: str, basis: EntryBasis = STATEMENT
) -> Uplink:
    """Add the entry and show its state on the set, with one audit record."""
    uplink = Uplink(
        parameter_set_id=row.id,
        onboard_state=onboard_state,
        source=source.strip(),
        recorded_utc=utc_now(),
        recorded_by=require_user(actor, "record an uplink"),
        method=basis.method,
        evidence=dict(basis.details) or None,
        printed_name=basis.printed_name,
        meaning=basis.meaning,
        c_sd=basis.c_sd and basis.c_sd.answer,
        c_sd_said=(basis.c_sd and basis.c_sd.said.strip()) or None,
        leaves_state=1 if basis.leaves_state else None,
    )
    before = {"onboard_state": row.onboard_state, "version": row.version}
    row.onboard_state = onboard_state
    row.version += 1
    session.put(uplink)
    told = {"method": basis.method, "meaning": basis.meaning, "found": basis.details.get("sentence")}
    told |= {"c_sd": uplink.c_sd, "c_sd_said": uplink.c_sd_said}
    after = {"onboard_state": onboard_state, "version": row.version, "record": f"uplinks/{uplink.id}"}
    after |= {name: value for name, value in told.items() if value is not None}
    action = ONBOARD_ACTIONS[onboard_state] if uplink.is_step else "recorded C_SD for"
    audit.append(session, actor, action, name_subject(row), before, after, source.strip())
    update_alarms(session, [row.sensor_id])
    return uplink


NEXT: dict[str, tuple[str, ...]] = {
    "NOT SENT": ("SENT",),
    "SENT": ("LOADED", "MISMATCH", "UNKNOWN"),
    "LOADED": ("VERIFIED", "MISMATCH", "UNKNOWN"),
    "VERIFIED": ("ACTIVE", "SENT", "MISMATCH", "UNKNOWN"),
    "ACTIVE": ("MISMATCH", "UNKNOWN"),
    "MISMATCH": ("SENT", "UNKNOWN"),
    "UNKNOWN": ("SENT", "LOADED", "VERIFIED", "MISMATCH"),
}
WITH_C_SD = ("LOADED", "VERIFIED", "ACTIVE", "MISMATCH", "UNKNOWN")
STATED = ("SENT", "LOADED", "MISMATCH", "UNKNOWN")


def record(  # noqa: PLR0913 - a record has all of these, and a form gives them one by one
    session: Session,
    actor: Actor,
    parameter_set_id: int,
    onboard_state: str,
    source: str,
    seen_version: int | None = None,
    *,
    package_id: int | None = None,
    happened: str | None = None,
    c_sd: CsdAnswer | None = None,
) -> Uplink:
    """Record the next on-board state of a set by statement, with where it is known from; or, beside its state, its C_SD."""
    row = get_set_for_entry(session, actor, parameter_set_id, source, seen_version)
    if c_sd is not None:
        _check_c_sd(session, row, onboard_state, c_sd)
        if onboard_state == row.onboard_state:
            if package_id is not None:
                raise RefusedInputError(
                    f"{row.name} stays {row.onboard_state}: a record of C_SD names no package. Leave out package_id."
                )
            beside = EntryBasis(happened_on(happened), c_sd=c_sd, leaves_state=True)
            return add_entry(session, actor, row, onboard_state, source, beside)
    _refuse_statement(actor, row, onboard_state)
    _refuse_step(row, onboard_state)
    if onboard_state == "LOADED":
        refuse_shown_mismatch(session, row)
    details = _describe_package(session, row, package_id, onboard_state) | happened_on(happened)
    return add_entry(session, actor, row, onboard_state, source, EntryBasis(details, c_sd=c_sd))


def explain_c_sd(session: Session, row: ParameterSet) -> str | None:
    """Say why an update of C_SD belongs to loading a set: it turns the attitude, or is older than the C_SD on board; else None."""
    turn = warn_of_turn(parse_parameter_set(row.document)).get("attitude-turn")
    later = None if turn else rows.find_later_c_sd(session, row)
    if later is None:
        return turn
    return (
        f"The update of C_SD of {later.name} was loaded: going back to {row.name} turns the reported attitude unless the C_SD of "
        "before is loaded with it."
    )


def is_c_sd_open(session: Session, row: ParameterSet) -> bool:
    """Whether a set's update of C_SD is needed, as far as is known, and not recorded as loaded."""
    record = rows.find_c_sd_record(session, row)
    return explain_c_sd(session, row) is not None and (record is None or record.c_sd == "NOT YET")


def _check_c_sd(session: Session, row: ParameterSet, onboard_state: str, told: CsdAnswer) -> None:
    """Refuse what cannot be said of a set's update of C_SD."""
    refuse_control_characters(c_sd_said=told.said)
    refuse_long(c_sd_said=told.said)
    if told.answer not in C_SD_ANSWERS:
        raise RefusedInputError(f"There is no answer {told.answer!r} of C_SD; choose from {', '.join(C_SD_ANSWERS)}.")
    if parse_parameter_set(row.document).alignment is None and explain_c_sd(session, row) is None:
        raise RefusedInputError(f"{row.name} has no update of C_SD: leave c_sd out.")
    if told.answer != "NOT YET" and not told.said.strip():
        needed = "when and how the update of C_SD was loaded" if told.answer == "LOADED" else "why no update is needed"
        raise RefusedInputError(f"Say {needed}.")
    if onboard_state != "LOADED" and (onboard_state, row.onboard_state) not in {(one, one) for one in WITH_C_SD}:
        raise ConflictError(
            f"{row.name} is {row.onboard_state} on board: give c_sd when it is recorded as LOADED, or later with its own state."
        )


def activate(
    session: Session,
    actor: Actor,
    parameter_set_id: int,
    source: str,
    meaning: str,
    proof: PasswordProof,
    seen_version: int | None,
    *,
    happened: str | None = None,
) -> Uplink:
    """Record that a verified set is what the sensor runs with: an entry signed by a person who gives the password again."""
    _refuse_activator(session, actor)
    row = get_set_for_entry(session, actor, parameter_set_id, source, seen_version)
    require_seen(session, row, seen_version)
    _refuse_step(row, "ACTIVE")
    _refuse_unread(session, row)
    refuse_control_characters(meaning=meaning)
    refuse_long(meaning=meaning)
    if not meaning.strip():
        raise RefusedInputError("Say what your signature means, for example: I saw this table active in telemetry.")
    details = happened_on(happened) | {"shown_sha256": compute_shown_sha256(session, row)}
    confirmations.require(session, actor, proof)
    _retire_active(session, actor, row, source.strip())
    signed = EntryBasis(details, printed_name=actor.printed_name, meaning=meaning.strip())
    return add_entry(session, actor, row, "ACTIVE", source, signed)


def _refuse_activator(session: Session, actor: Actor) -> None:
    """Refuse who may not sign that any set is active."""
    require_person(actor, "sign that a set is active")
    if "administrator" in actor.roles:
        raise ForbiddenError("An administrator cannot sign; ask an operator who is not an administrator.")
    if users.must_change_password(session, actor):
        raise ForbiddenError("Somebody else set your password; set your own first, then sign.", code="password-due")


def explain_why_not_activate(session: Session, actor: Actor, row: ParameterSet) -> str | None:
    """Say why this actor may not sign that a verified set is active; None when only the password is missing."""
    try:
        _refuse_activator(session, actor)
        require_entrant(actor)
        _refuse_step(row, "ACTIVE")
        _refuse_unread(session, row)
    except (ForbiddenError, ConflictError) as refusal:
        return str(refusal)
    return None


def compute_shown_sha256(session: Session, row: ParameterSet) -> str:
    """Return the hash that an activation's signature covers: the set and the record that verified it."""
    newest = rows.find_newest_record(session, row.id)
    verified = [{"record": it.id, "state": it.onboard_state, "method": it.method} for it in [newest] if it is not None]
    return compute_sha256({"parameter_set": row.name, "set_sha256": row.sha256, "verified": verified})


def list_next_statements(session: Session, row: ParameterSet) -> list[str]:
    """Return the states of a set that can be recorded next by statement."""
    held = {"SENT"} if row.ground_state != "BASELINE" else set()
    held |= {"LOADED"} if has_shown_mismatch(session, row) else set()
    return [state for state in NEXT[row.onboard_state] if state in STATED and state not in held]


def _refuse_statement(actor: Actor, row: ParameterSet, onboard_state: str) -> None:
    """Refuse a state that cannot be recorded by statement, and name the operation for it."""
    if onboard_state == "VERIFIED":
        raise ConflictError(
            f"VERIFIED cannot be recorded as a statement: send the dump or CRC of {row.name} to `:read-back` for comparison.",
            code="not-by-statement",
        )
    if onboard_state == "ACTIVE":
        require_person(actor, "sign that a set is active")
        raise ConflictError(
            f"ACTIVE cannot be recorded as a statement: have an operator sign it for {row.name} with password and meaning, "
            "by `:activate`.",
            code="not-by-statement",
        )


def _refuse_unread(session: Session, row: ParameterSet) -> None:
    """Refuse to activate a set that was recorded as VERIFIED by statement alone, which earlier versions allowed."""
    newest = rows.find_newest_record(session, row.id)
    if newest is None or newest.method is None:
        raise ConflictError(
            f"{row.name} is VERIFIED only by statement; read it back by dump or CRC, then sign.",
            code="verified-by-statement",
        )


def _refuse_step(row: ParameterSet, onboard_state: str) -> None:
    """Refuse a step that is not allowed from the current state."""
    if onboard_state not in NEXT:
        raise RefusedInputError(f"There is no on-board state {onboard_state!r}; choose from {', '.join(NEXT)}.")
    if onboard_state not in NEXT[row.onboard_state]:
        steps = ", ".join(NEXT[row.onboard_state])
        raise ConflictError(
            f"{row.name} is {row.onboard_state} on board, so {onboard_state} cannot be next; record {steps}."
        )
    if onboard_state == "SENT" and row.ground_state != "BASELINE":
        raise ConflictError(
            f"{row.name} is {row.ground_state}; only the baseline is sent. Have it approved and promote it.",
            code="not-the-baseline",
        )


def _describe_package(
    session: Session, row: ParameterSet, package_id: int | None, onboard_state: str
) -> dict[str, Any]:
    """Return the record's description of the sent package; refuse a package of another set or for another table."""
    if package_id is None:
        return {}
    package = session.get(Package, package_id)
    if package is None or package.parameter_set_id != row.id:
        raise RefusedInputError(
            f"There is no package {package_id} of {row.name}; choose one that was built for it.", code="no-such-package"
        )
    definition = find_definition_in_force(session, row.sensor_id)
    if onboard_state == "SENT" and package.table_definition_id != (definition.id if definition else None):
        raise ConflictError(
            f"Package {package_id} was built for another table definition than the one in force: "
            "build the package again and send that.",
            code="other-table-definition",
        )
    return {"package": {"id": package.id, "sha256": package.sha256}}


def list_sendable_packages(session: Session, row: ParameterSet, built: Sequence[Package]) -> list[Package]:
    """Return those of a set's packages that can be recorded as sent: built for the table definition in force."""
    definition = find_definition_in_force(session, row.sensor_id)
    return [one for one in built if one.table_definition_id == (definition.id if definition else None)]


def _retire_active(session: Session, actor: Actor, row: ParameterSet, source: str) -> None:
    """Make the set that was active UNKNOWN: another is active now."""
    if (active := set_rows.find_active_set(session, row.sensor_id)) is not None and active.id != row.id:
        add_entry(session, actor, active, "UNKNOWN", f"{row.name} was read back as active: {source}")


def get_dump_digest(session: Session, uplink_id: int) -> str:
    """Return the SHA-256 of the dump that a record rests on."""
    dump = session.get_known(Uplink, uplink_id).typed_evidence.dump
    if dump is None:
        raise NotFoundError(f"Uplink record {uplink_id} has no dump; see its method and evidence.")
    return dump.sha256


def find_baseline_at(session: Session, sensor_id: int, time: str) -> ParameterSet | None:
    """Return the sensor's baseline at a time; None before the first one."""
    return set_rows.find_baseline_at(session, sensor_id, read_time(time))


def list_onboard_at(session: Session, sensor_id: int, time: str) -> Sequence[tuple[ParameterSet, Uplink]]:
    """Return each set that was on its way or on board at a time, with the record that says so."""
    return rows.list_records_until(session, sensor_id, read_time(time))
