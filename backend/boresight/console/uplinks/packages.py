"""Uplink packages: the files with which an approved set, or the baseline, goes to the spacecraft.

`inputs` gathers everything that the bytes follow from, and only what lasts, into one document; so the same set under
the same definition, signatures and way back is the package that exists already, byte for byte.

The bytes are made and signed before the transaction that stores them: what the table's number format does to the camera may need
loops that were never compiled on this machine, which takes minutes where it is busy.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight import __version__
from boresight.calibration.calibration import to_plain
from boresight.console import list_queries as lists
from boresight.console.access.tables import User
from boresight.console.alignments import queries as alignment_rows
from boresight.console.alignments.tables import parse_summary
from boresight.console.approvals import queries as approval_rows
from boresight.console.approvals import staleness
from boresight.console.approvals.gates import lay_waivers
from boresight.console.approvals.signers import list_second_persons
from boresight.console.approvals.tables import Approval, Binding, Signature
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import queries as run_rows
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet, parse_quality
from boresight.console.transitions import describe_last_change
from boresight.console.uplinks import queries as rows
from boresight.console.uplinks.tables import Package, TableDefinition
from boresight.errors import ConflictError, CorruptFileError, NotFoundError, RefusedInputError, StaleError
from boresight.platform.actors import POLICY, Actor, Policy, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.audit.signing import Signer, SigningKey
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.sessions import Session, utc_now
from boresight.uplink.package import build_package, make_files
from boresight.uplink.verify_package import SUMS

SIGNED = ("printed_name", "decision", "meaning", "comment", "signed_utc", "shown_sha256", "console")
WAIVED = ("gate", "code", "reason", "printed_name", "made_utc", "expires_utc")


def describe_set(session: Session, row: ParameterSet) -> dict[str, Any]:
    """Return a package's description of a set."""
    return {
        "id": row.id,
        "name": row.name,
        "sha256": row.sha256,
        "ground_state": row.ground_state,
        "document": row.document,
        "created_utc": row.created_utc,
        "run": _describe_run(session, row),
        "gates": _describe_gates(session, row),
        "approval": _describe_approval(session, row),
        **_describe_alignment(session, row),
    }


def _describe_alignment(session: Session, row: ParameterSet) -> dict[str, Any]:
    """Return the approved alignment that leads from this very calibration, with its signature; nothing where there is none."""
    found = None if row.run_id is None else alignment_rows.find_approved(session, row.run_id)
    if found is None:
        return {}
    alignment, request = found
    summary = parse_summary(alignment.summary or {})
    return {
        "alignment": {
            "id": alignment.id,
            "result_sha256": alignment.result_sha256,
            "from": session.get_one(Sensor, alignment.sensor_a_id).name,
            "to": session.get_one(Sensor, alignment.sensor_b_id).name,
            "run_a": alignment.run_a_id,
            "run_b": alignment.run_b_id,
            "verdict": alignment.verdict,
            "reference_utc": summary.reference_utc,
            "quaternion": summary.load_quaternion,
            "sigma_arcsec": summary.load_sigma_arcsec,
            "request": {
                "id": request.id,
                "reason": request.reason,
                "submitted_by": _name_person(session, request.submitted_by),
                "submitted_utc": request.submitted_utc,
                "signed_by": request.printed_name,
                "signed_utc": request.closed_utc,
                "meaning": request.meaning,
            },
        }
    }


def describe_four_eyes(session: Session, row: ParameterSet, policy: Policy) -> dict[str, Any]:
    """Return whether this installation requires a second person, and whether one approved this set, None where nobody signed."""
    approval = approval_rows.find_latest_approval(session, row.id, "APPROVED")
    second = None if approval is None else list_second_persons(session, approval, Policy())
    kept = None if approval is None or second is None else len(second) >= approval.needed
    if not policy.four_eyes:
        sentence = "FOUR-EYES RULE OFF: on this installation one person can submit, sign and export alone."
    elif kept is None:
        sentence = "Nobody signed this set: it is the ground calibration."
    elif kept:
        sentence = "Approved by a person who did not submit it, create it or launch its run."
    else:
        sentence = (
            "FOUR-EYES RULE NOT FOLLOWED: it was approved by a person who submitted it, created it or launched its run."
        )
    return {"enforced": policy.four_eyes, "kept": kept, "sentence": sentence}


def _describe_run(session: Session, row: ParameterSet) -> dict[str, Any] | None:
    """Return the run of a set and its data; None for a ground calibration."""
    run = None if row.run_id is None else session.get_one(Run, row.run_id)
    if run is None:
        return None
    return {
        "id": run.id,
        "method": run.method,
        "result_sha256": run.result_sha256,
        "launched_utc": run.launched_utc,
        "launched_by": _name_person(session, run.launched_by),
        "started_from": run.sensor_document["initial"],
        "telemetry": _describe_telemetry(session, run.telemetry_set_id),
        "joint_telemetry": [_describe_telemetry(session, number) for number in run.joint_set_ids],
        "prior": _describe_prior(session, run),
        "validation": _describe_telemetry(session, run.validation_set_id),
    }


def _describe_prior(session: Session, run: Run) -> dict[str, Any] | None:
    """Return the calibration that a run started from with its covariance, and the telemetry sets that it holds; None where none."""
    if run.prior_run_id is None:
        return None
    before = session.get_one(Run, run.prior_run_id)
    named = None if run.prior_set_id is None else session.get_one(ParameterSet, run.prior_set_id)
    return {
        "run": before.id,
        "parameter_set": None if named is None else named.name,
        "result_sha256": before.result_sha256,
        "telemetry": [
            _describe_telemetry(session, number) for number in sorted(run_rows.list_held_sets(session, before))
        ],
    }


def _describe_telemetry(session: Session, telemetry_set_id: int | None) -> dict[str, Any] | None:
    if telemetry_set_id is None:
        return None
    row = session.get_one(TelemetrySet, telemetry_set_id)
    quality = parse_quality(row.quality)
    time = quality.time
    return {
        "id": row.id,
        "name": row.name,
        "original_sha256": row.original_sha256,
        "frames": row.frames,
        "epoch_utc": {"start_utc": time.start_utc if time else None, "end_utc": time.end_utc if time else None},
        "temperature_c": to_plain(quality.temperature_c),
    }


def _describe_gates(session: Session, row: ParameterSet) -> dict[str, Any] | None:
    """Return the signed gate report with the bound waivers; None where there was none."""
    approval = approval_rows.find_latest_approval(session, row.id, "APPROVED")
    bound = Binding() if approval is None else approval.binding
    report = approval_rows.find_newest_report(session, row.id, bound.gate_report_sha256)
    if report is None:
        return None
    laid_over = lay_waivers(session, report, bound.waivers)
    return {
        "sha256": report.sha256,
        "verdict": laid_over.verdict,
        "words": laid_over.words,
        "waived": laid_over.waived,
        "waivers": [
            {key: getattr(waiver, key) for key in WAIVED} for waiver in approval_rows.list_waivers(session, [row.id])
        ],
        "document": report.document,
    }


def _describe_approval(session: Session, row: ParameterSet) -> dict[str, Any] | None:
    """Return the request by which a set was approved, with its signatures; None for a ground calibration."""
    approval: Approval | None = approval_rows.find_latest_approval(session, row.id, "APPROVED")
    if approval is None:
        return None
    return {
        "id": approval.id,
        "kind": approval.kind,
        "reason": approval.reason,
        "submitted_by": _name_person(session, approval.submitted_by),
        "submitted_utc": approval.submitted_utc,
        "needed": approval.needed,
        "bound": approval.bound,
        "signatures": [
            _describe_signature(signature) for signature in approval_rows.list_signatures(session, approval.id)
        ],
    }


def _describe_signature(signature: Signature) -> dict[str, Any]:
    """Return a signature, with who else knew the password and what it says of the points, where it has them."""
    said = {key: getattr(signature, key) for key in SIGNED}
    more = {key: getattr(signature, key) for key in ("password_by", "points")}
    return said | {key: value for key, value in more.items() if value is not None}


def _name_person(session: Session, user_id: int | None) -> str:
    user = None if user_id is None else session.get(User, user_id)
    return "Boresight" if user is None else user.printed_name


EXPORTED = ("APPROVED", "BASELINE")
MEDIA_TYPE = "application/zip"


@dataclass(frozen=True)
class Prepared:
    """A package as it would be stored: inputs, signature where there is a key, and bytes; None where they are stored already."""

    inputs: dict[str, Any]
    signature: dict[str, str] | None
    content: bytes | None


def prepare(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    parameter_set_id: int,
    *,
    policy: Policy = POLICY,
    key: SigningKey | None = None,
) -> Prepared | None:
    """Make the package of a set, signed where there is a key, if it does not exist; None where `build` will refuse."""
    _require_exporter(actor)
    row = session.get_known(ParameterSet, parameter_set_id)
    if row.ground_state not in EXPORTED:
        return None
    inputs = _gather_inputs(session, row, rows.find_definition_in_force(session, row.sensor_id), policy)
    existing = _find_existing(session, row, inputs, signed=key is not None)
    if existing is not None:
        lost = not _is_intact(blobs, existing)
        return Prepared(
            existing.inputs, existing.signature, rebuild(existing.inputs, existing.signature) if lost else None
        )
    inputs["first_built"] = {"at_utc": utc_now(), "audit_head": audit.head(session)}
    signature = None if key is None else _sign(key.load(), make_files(inputs, signed=True)[SUMS])
    return Prepared(inputs, signature, rebuild(inputs, signature))


def build(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    parameter_set_id: int,
    prepared: Prepared | None,
    *,
    flight_software_version: str | None = None,
    table_id: str | None = None,
    policy: Policy = POLICY,
) -> Package:
    """Store the package that was prepared, or return the one that exists."""
    _require_exporter(actor)
    row = session.get_known(ParameterSet, parameter_set_id)
    if row.ground_state not in EXPORTED:
        raise ConflictError(
            f"{row.name} is {row.ground_state}: {describe_last_change(session, row)}. "
            f"Export a set that is {' or '.join(EXPORTED)}."
        )
    _refuse_unsigned(session, actor, row)
    definition = rows.find_definition_in_force(session, row.sensor_id)
    _refuse_other_versions(session, row, definition, flight_software_version, table_id)
    inputs = _gather_inputs(session, row, definition, policy)
    if prepared is not None and _lasting(prepared.inputs) == inputs:
        existing = _find_existing(session, row, inputs, signed=prepared.signature is not None)
        if existing is not None:
            return _keep(session, blobs, existing, prepared)
        if prepared.content is not None:
            return _store(session, actor, blobs, row, definition, prepared, prepared.content)
    raise StaleError(
        f"{row.name} or its sensor changed while the package was built: export it again.", code="changed-while-built"
    )


def _require_exporter(actor: Actor) -> None:
    require_role(actor, "operator", "analyst")
    require_scope(actor, "uplinks")


def _lasting(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Return the inputs without the moment when the package was first built."""
    return {key: value for key, value in inputs.items() if key != "first_built"}


def _sign(signer: Signer, content: bytes) -> dict[str, str]:
    return {"key": signer.public.id, "public_key": signer.public.text, "signature": signer.sign(content)}


def _find_approval(session: Session, row: ParameterSet) -> Approval | None:
    """Return the request that an approved set is exported by; a baseline needs none."""
    return approval_rows.find_latest_approval(session, row.id, "APPROVED") if row.ground_state == "APPROVED" else None


def explain_why_not_export(session: Session, row: ParameterSet) -> str | None:
    """Say why an approved set would be refused: its request has expired, or it has changed since; None where it would not."""
    approval = _find_approval(session, row)
    return None if approval is None else staleness.explain_outdated(session, approval, row)


def _refuse_unsigned(session: Session, actor: Actor, row: ParameterSet) -> None:
    """Refuse an approved set that has changed since it was signed; a baseline is not checked."""
    approval = _find_approval(session, row)
    if approval is not None:
        staleness.refuse_expired(session, approval, row)
        staleness.refuse_changed_binding(session, actor, approval, row)


def _refuse_other_versions(
    session: Session,
    row: ParameterSet,
    definition: TableDefinition | None,
    flight_software_version: str | None,
    table_id: str | None,
) -> None:
    """Refuse to build a package for another flight software or table than the definition in force."""
    said = {"flight_software_version": flight_software_version, "table_id": table_id}
    asked = {key: value for key, value in said.items() if value is not None}
    if not asked:
        return
    sensor = session.get_one(Sensor, row.sensor_id)
    if definition is None:
        raise ConflictError(
            f"{sensor.name} has no table definition, so nothing can be exported for {_listed(asked)}: set one first.",
            code="no-table-definition",
        )
    wrong = [key for key in asked if definition.document[key] != asked[key]]
    if wrong:
        raise ConflictError(
            f"The table definition of {sensor.name} in force, number {definition.number}, is for "
            f"{_listed({key: definition.document[key] for key in wrong})}, not for {_listed({key: asked[key] for key in wrong})}: "
            "loading a table made for another version could overwrite the wrong memory. Set the definition of that version first.",
            code="other-versions",
        )


def _listed(versions: Mapping[str, str]) -> str:
    return " and ".join(f"{key.replace('_', ' ')} {value}" for key, value in versions.items())


def _gather_inputs(
    session: Session, row: ParameterSet, definition: TableDefinition | None, policy: Policy
) -> dict[str, Any]:
    """Gather the inputs of the package except the time when it was first built."""
    sensor = session.get_one(Sensor, row.sensor_id)
    baseline = set_rows.find_baseline(session, row.sensor_id)
    way_back = rows.find_baseline_before(session, row) if row.ground_state == "BASELINE" else baseline
    way_back = way_back or row
    active = set_rows.find_active_set(session, row.sensor_id)
    elsewhere = active is not None and active.id not in {row.id, way_back.id}
    return {
        "sensor": sensor.document,
        "simulated": bool(sensor.simulated),
        "subject": describe_set(session, row),
        "backout": describe_set(session, way_back),
        "active": describe_set(session, active) if active is not None and elsewhere else None,
        "definition": None
        if definition is None
        else {"number": definition.number, "sha256": definition.sha256, "document": definition.document},
        "four_eyes": describe_four_eyes(session, row, policy),
        "software": {"name": "Boresight", "version": __version__},
    }


def _find_existing(session: Session, row: ParameterSet, inputs: Mapping[str, Any], *, signed: bool) -> Package | None:
    """Return the package of the same inputs; one without a signature is none where packages are signed."""
    for package in lists.list_newest(session, Package, set=row.id):
        if signed and package.signature is None:
            continue
        if _lasting(package.inputs) == inputs:
            return package
    return None


def _keep(session: Session, blobs: BlobStore, package: Package, prepared: Prepared) -> Package:
    """Return a package, storing its file again where that was lost or altered."""
    if not _is_intact(blobs, package):
        if prepared.content is None or blobs.put(prepared.content) != package.sha256:
            blobs.path(package.sha256)  # raises what is wrong with it
        register_blob(session, blobs, package.sha256, MEDIA_TYPE)
    return package


def _is_intact(blobs: BlobStore, package: Package) -> bool:
    """Whether a package's file is stored with its bytes."""
    try:
        blobs.path(package.sha256)
    except (NotFoundError, CorruptFileError):
        return False
    return True


def _store(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    row: ParameterSet,
    definition: TableDefinition | None,
    prepared: Prepared,
    content: bytes,
) -> Package:
    """Store a package with its inputs and its signature."""
    inputs, signature = prepared.inputs, prepared.signature
    sha256 = register_blob(session, blobs, blobs.put(content), MEDIA_TYPE).sha256
    package = Package(
        parameter_set_id=row.id,
        table_definition_id=None if definition is None else definition.id,
        inputs=inputs,
        sha256=sha256,
        created_utc=inputs["first_built"]["at_utc"],
        created_by=actor.user_id,
        signature=signature,
    )
    session.put(package)
    after = {
        "parameter_set": row.name,
        "parameter_set_sha256": row.sha256,
        "sha256": sha256,
        "table_definition_id": package.table_definition_id,
        "backout": inputs["backout"]["name"],
        "audit_head": inputs["first_built"]["audit_head"],
        "signed_by": None if signature is None else signature["key"],
    }
    audit.append(session, actor, "exported", f"packages/{package.id}", None, after)
    return package


def rebuild(inputs: Mapping[str, Any], signature: Mapping[str, str] | None = None) -> bytes:
    """Build the bytes of a package from its inputs and its signature; they hash to the `sha256` of its row."""
    return build_package(inputs, None if signature is None else base64.b64decode(signature["signature"]))


def read(session: Session, blobs: BlobStore, package_id: int) -> bytes:
    """Return the bytes of a package, checked against their hash."""
    return blobs.read(session.get_known(Package, package_id).sha256)


def make_file_name(session: Session, package: Package) -> str:
    """Return a name for the file: the set, and the first digits of the hash."""
    row = session.get_one(ParameterSet, package.parameter_set_id)
    return f"{row.name.replace(' ', '_')}-{package.sha256[:12]}.zip"


def set_named(session: Session, name: str) -> ParameterSet:
    """Return a set by its number or its name, `PS-<sensor>-<n>`."""
    row = rows.find_set(session, name) or (
        session.get(ParameterSet, int(name)) if name.isdecimal() and len(name) < 19 else None
    )
    if row is None:
        raise RefusedInputError(f"There is no parameter set {name}: give its name, PS-<sensor>-<n>, or its number.")
    return row
