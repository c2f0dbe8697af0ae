"""Uplink packages: what an approved set, or the baseline, goes to the spacecraft as.

`inputs` gathers everything that the bytes follow from into one document, which is kept in the row; the bytes are built of it
alone. So the same set under the same definition, signatures and way back is the package that exists already, byte for byte,
with the audit head of the moment when it was first built.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from boresight import __version__
from boresight.errors import ConflictError, CorruptFileError, NotFoundError, RefusedInputError
from boresight.services import audit, staleness
from boresight.services.actors import POLICY, Actor, Policy, require_role, require_scope
from boresight.services.package_inputs import described, four_eyes
from boresight.services.transitions import get_parameter_set, who_changed
from boresight.store import approvals as approval_rows
from boresight.store import packages as rows
from boresight.store import parameter_sets as set_rows
from boresight.store import table_definitions as definition_rows
from boresight.store.blobs import BlobStore, register_blob
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import Package, ParameterSet, Sensor, TableDefinition
from boresight.uplink.package import build_package

EXPORTED = ("APPROVED", "BASELINE")
MEDIA_TYPE = "application/zip"


def build(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    parameter_set_id: int,
    *,
    flight_software_version: str | None = None,
    table_id: str | None = None,
    policy: Policy = POLICY,
) -> Package:
    """Build the package of a set, or return the one that exists.

    Parameters
    ----------
    flight_software_version, table_id
        What the spacecraft has, where the caller says so: a table for another is refused.
    policy
        Whether four eyes are asked here; the package says so.

    Raises
    ------
    ForbiddenError
        When the actor is neither operator nor analyst, or a key without the scope.
    NotFoundError
        When there is no such set.
    ConflictError
        When the set is neither approved nor baseline, its approval expired, or the spacecraft's versions are not those of the
        definition in force.
    StaleError
        When what an approval was bound to has moved: it is STALE from now on, and what was signed is not what would be sent.
    RefusedInputError
        When a set does not fit into the table.
    """
    require_role(actor, "operator", "analyst")
    require_scope(actor, "uplinks")
    row = get_parameter_set(session, parameter_set_id)
    if row.ground_state not in EXPORTED:
        raise ConflictError(
            f"{row.name} is {row.ground_state}: {who_changed(session, row)}. Only an approved set or the baseline is exported."
        )
    _refuse_unsigned(session, actor, row)
    definition = definition_rows.definition_in_force(session, row.sensor_id)
    _refuse_other_versions(session, row, definition, flight_software_version, table_id)
    inputs = _inputs(session, row, definition, policy)
    existing = _existing(session, row, inputs)
    if existing is not None:
        return _kept(session, blobs, existing)
    inputs["first_built"] = {"at_utc": utc_now(), "audit_head": audit.head(session)}
    return _store(session, actor, blobs, row, definition, inputs)


def _refuse_unsigned(session: Session, actor: Actor, row: ParameterSet) -> None:
    """Refuse an approved set that is not any more what was signed; a baseline stays what it became."""
    approval = approval_rows.latest_of(session, row.id, "APPROVED") if row.ground_state == "APPROVED" else None
    if approval is not None:
        staleness.refuse_expired(session, approval, row)
        staleness.refuse_moved(session, actor, approval, row)


def _refuse_other_versions(
    session: Session,
    row: ParameterSet,
    definition: TableDefinition | None,
    flight_software_version: str | None,
    table_id: str | None,
) -> None:
    """Refuse a table for other flight software, or another table, than the definition in force."""
    said = {"flight_software_version": flight_software_version, "table_id": table_id}
    asked = {key: value for key, value in said.items() if value is not None}
    if not asked:
        return
    sensor = session.get_one(Sensor, row.sensor_id)
    if definition is None:
        raise ConflictError(f"{sensor.name} has no table definition, so nothing can be exported for {_listed(asked)}.")
    wrong = [key for key in asked if definition.document[key] != asked[key]]
    if wrong:
        raise ConflictError(
            f"The table definition of {sensor.name} in force, number {definition.number}, is for "
            f"{_listed({key: definition.document[key] for key in wrong})}, not for {_listed({key: asked[key] for key in wrong})}: "
            "a table laid out for another version overwrites what it was not meant for. Set the definition of that version first."
        )


def _listed(versions: Mapping[str, str]) -> str:
    """Name versions in a sentence."""
    return " and ".join(f"{key.replace('_', ' ')} {value}" for key, value in versions.items())


def _inputs(session: Session, row: ParameterSet, definition: TableDefinition | None, policy: Policy) -> dict[str, Any]:
    """Gather what the bytes follow from, apart from when they were first built."""
    sensor = session.get_one(Sensor, row.sensor_id)
    baseline = set_rows.baseline(session, row.sensor_id)
    way_back = rows.baseline_before(session, row) if row.ground_state == "BASELINE" else baseline
    way_back = way_back or row
    active = set_rows.active_set(session, row.sensor_id)
    elsewhere = active is not None and active.id not in {row.id, way_back.id}
    return {
        "sensor": sensor.document,
        "simulated": bool(sensor.simulated),
        "subject": described(session, row),
        "backout": described(session, way_back),
        "active": described(session, active) if active is not None and elsewhere else None,
        "definition": None
        if definition is None
        else {"number": definition.number, "sha256": definition.sha256, "document": definition.document},
        "four_eyes": four_eyes(session, row, policy),
        "software": {"name": "Boresight", "version": __version__},
    }


def _existing(session: Session, row: ParameterSet, inputs: Mapping[str, Any]) -> Package | None:
    """Return the package that was built from the same inputs."""
    for package in rows.packages(session, parameter_set_id=row.id, limit=None):
        if {key: value for key, value in package.inputs.items() if key != "first_built"} == inputs:
            return package
    return None


def _kept(session: Session, blobs: BlobStore, package: Package) -> Package:
    """Return a package, its bytes laid down again where the folder lost or spoiled them."""
    try:
        blobs.path(package.sha256)
    except (NotFoundError, CorruptFileError):
        if blobs.put(rebuild(package.inputs)) != package.sha256:
            raise
        register_blob(session, blobs, package.sha256, MEDIA_TYPE)
    return package


def _store(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    row: ParameterSet,
    definition: TableDefinition | None,
    inputs: dict[str, Any],
) -> Package:
    """Build the bytes and keep them with what they follow from."""
    sha256 = register_blob(session, blobs, blobs.put(rebuild(inputs)), MEDIA_TYPE).sha256
    package = Package(
        parameter_set_id=row.id,
        table_definition_id=None if definition is None else definition.id,
        inputs=inputs,
        sha256=sha256,
        created_utc=inputs["first_built"]["at_utc"],
        created_by=actor.user_id,
    )
    session.add(package)
    session.flush()
    after = {
        "parameter_set": row.name,
        "parameter_set_sha256": row.sha256,
        "sha256": sha256,
        "table_definition_id": package.table_definition_id,
        "backout": inputs["backout"]["name"],
        "audit_head": inputs["first_built"]["audit_head"],
    }
    audit.append(session, actor, "exported", f"packages/{package.id}", None, after)
    return package


def rebuild(inputs: Mapping[str, Any]) -> bytes:
    """Build the bytes of a package from its inputs; they hash to the `sha256` of its row."""
    return build_package(inputs)


def get_package(session: Session, package_id: int) -> Package:
    """Return a package.

    Raises
    ------
    NotFoundError
        When there is none with this number.
    """
    package = session.get(Package, package_id)
    if package is None:
        raise NotFoundError(f"There is no package {package_id}.")
    return package


def read(session: Session, blobs: BlobStore, package_id: int) -> bytes:
    """Return the bytes of a package, checked against their hash.

    Raises
    ------
    NotFoundError, ConflictError
        When there is no such package, or its bytes are missing or were altered on the disk.
    """
    return blobs.read(get_package(session, package_id).sha256)


def file_name(session: Session, package: Package) -> str:
    """Return a name for the file: the set, and the first digits of the hash."""
    row = session.get_one(ParameterSet, package.parameter_set_id)
    return f"{row.name.replace(' ', '_')}-{package.sha256[:12]}.zip"


def list_packages(
    session: Session,
    *,
    parameter_set_id: int | None = None,
    sensor_id: int | None = None,
    before_id: int | None = None,
    limit: int | None = None,
) -> Sequence[Package]:
    """Return a page of packages, newest first; the next page starts before the last one's id."""
    return rows.packages(
        session, parameter_set_id=parameter_set_id, sensor_id=sensor_id, before_id=before_id, limit=limit
    )


def set_named(session: Session, name: str) -> ParameterSet:
    """Return a set by its number or its name, `PS-<sensor>-<n>`.

    Raises
    ------
    RefusedInputError
        When there is none.
    """
    row = rows.set_named(session, name) or (
        session.get(ParameterSet, int(name)) if name.isdecimal() and len(name) < 19 else None
    )
    if row is None:
        raise RefusedInputError(f"There is no parameter set {name}: give its name, PS-<sensor>-<n>, or its number.")
    return row
