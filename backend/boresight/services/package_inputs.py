"""What an uplink package says of a set: its document, its run, its gates and waivers, its request with the signatures.

Only what lasts is in it. What goes on changing (the version, what is recorded on board) would make another package of the
same set tomorrow.
"""

from __future__ import annotations

from typing import Any

from boresight.services.actors import Policy
from boresight.services.gates import newest_report, with_waivers
from boresight.services.signers import second_persons
from boresight.store import approvals as approval_rows
from boresight.store import gates as gate_rows
from boresight.store.sessions import Session
from boresight.store.tables import Approval, ParameterSet, Run, Signature, TelemetrySet, User

SIGNED = ("printed_name", "decision", "meaning", "comment", "signed_utc", "shown_sha256", "console")
WAIVED = ("gate", "code", "reason", "printed_name", "made_utc", "expires_utc")


def described(session: Session, row: ParameterSet) -> dict[str, Any]:
    """Return everything that a package says of a set."""
    return {
        "id": row.id,
        "name": row.name,
        "sha256": row.sha256,
        "ground_state": row.ground_state,
        "document": row.document,
        "created_utc": row.created_utc,
        "run": _run(session, row),
        "gates": _gates(session, row),
        "approval": _approval(session, row),
    }


def four_eyes(session: Session, row: ParameterSet, policy: Policy) -> dict[str, Any]:
    """Say whether this installation asks for a second person, and whether one approved this set.

    `kept` is what happened, not what is asked now: None of a ground calibration, which nobody signed.
    """
    approval = approval_rows.latest_of(session, row.id, "APPROVED")
    second = None if approval is None else second_persons(session, approval, Policy())
    kept = None if approval is None or second is None else len(second) >= approval.needed
    if not policy.four_eyes:
        sentence = "FOUR EYES ARE OFF: this installation lets one person submit, sign and export alone."
    elif kept is None:
        sentence = "Nobody signed this set: it is the ground calibration."
    elif kept:
        sentence = "Four eyes: it was approved by who neither submitted nor created it, nor launched its run."
    else:
        sentence = "FOUR EYES WERE NOT KEPT: it was approved by who submitted or created it, or launched its run."
    return {"enforced": policy.four_eyes, "kept": kept, "sentence": sentence}


def _run(session: Session, row: ParameterSet) -> dict[str, Any] | None:
    """Say which run a set was made of, from which data; None for a ground calibration."""
    run = None if row.run_id is None else session.get_one(Run, row.run_id)
    if run is None:
        return None
    return {
        "id": run.id,
        "method": run.method,
        "result_sha256": run.result_sha256,
        "launched_utc": run.launched_utc,
        "launched_by": _printed(session, run.launched_by),
        "started_from": run.sensor_document["initial"],
        "telemetry": _telemetry(session, run.telemetry_set_id),
        "validation": _telemetry(session, run.validation_set_id),
    }


def _telemetry(session: Session, telemetry_set_id: int | None) -> dict[str, Any] | None:
    """Say which telemetry it was: its hash, when it was taken and how warm it was."""
    if telemetry_set_id is None:
        return None
    row = session.get_one(TelemetrySet, telemetry_set_id)
    time = row.quality.get("time") or {}
    return {
        "id": row.id,
        "name": row.name,
        "original_sha256": row.original_sha256,
        "frames": row.frames,
        "epoch_utc": {key: time.get(key) for key in ("start_utc", "end_utc")},
        "temperature_c": row.quality.get("temperature_c"),
    }


def _gates(session: Session, row: ParameterSet) -> dict[str, Any] | None:
    """Say what the gate report that was signed found, and which gates were waived by whom; None when nothing was judged.

    The verdict is the signed one: the report with the waivers that the request binds, though they expired since. Of a set that
    nobody signed it is the one that stands now. `document` is the report without waivers, as `sha256` has it.
    """
    approval = approval_rows.latest_of(session, row.id, "APPROVED")
    bound = {} if approval is None else approval.bound
    report = newest_report(session, row.id, bound.get("gate_report_sha256"))
    if report is None:
        return None
    laid_over = with_waivers(session, report, bound.get("waivers"))
    return {
        "sha256": report.sha256,
        "verdict": laid_over["verdict"],
        "words": laid_over["words"],
        "waived": laid_over["waived"],
        "waivers": [{key: getattr(waiver, key) for key in WAIVED} for waiver in gate_rows.waivers(session, [row.id])],
        "document": report.document,
    }


def _approval(session: Session, row: ParameterSet) -> dict[str, Any] | None:
    """Return the request by which a set was approved, with its signatures; None for a ground calibration."""
    approval: Approval | None = approval_rows.latest_of(session, row.id, "APPROVED")
    if approval is None:
        return None
    return {
        "id": approval.id,
        "kind": approval.kind,
        "reason": approval.reason,
        "submitted_by": _printed(session, approval.submitted_by),
        "submitted_utc": approval.submitted_utc,
        "needed": approval.needed,
        "bound": approval.bound,
        "signatures": [_signed(signature) for signature in approval_rows.signatures(session, approval.id)],
    }


def _signed(signature: Signature) -> dict[str, Any]:
    """Say who signed what, and who else knew the password, where somebody did."""
    said = {key: getattr(signature, key) for key in SIGNED}
    return said if signature.password_by is None else said | {"password_by": signature.password_by}


def _printed(session: Session, user_id: int | None) -> str:
    """Return a person's printed name."""
    user = None if user_id is None else session.get(User, user_id)
    return "Boresight" if user is None else user.printed_name
