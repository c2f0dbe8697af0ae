"""Handing a table over to a mission control system: an operator's act in person, on record before and after.

The table of the newest package goes into the system's store, where whoever commands there finds it; nothing is commanded, and the
set's state on board stays as it is recorded. The same table again is the same object.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from boresight.console import list_queries as lists
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.transitions import require_seen
from boresight.console.uplinks import packages
from boresight.console.uplinks import queries as rows
from boresight.console.uplinks.tables import Package
from boresight.errors import ConflictError, NotFoundError
from boresight.mission_control.systems import DEFINITION, IMAGE, Link
from boresight.platform.actors import Actor, require_person, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session

BEGAN, ENDED = "began to hand over", "handed over"


@dataclass(frozen=True)
class HandOver:
    """What goes, and where."""

    link: Link
    package_id: int
    name: str
    sha256: str
    files: Mapping[str, bytes]

    def send(self) -> Sequence[str]:
        """Store it there; no transaction is open meanwhile."""
        return self.link.hand_over(self.name, self.sha256, self.files)


def begin(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    links: Mapping[str, Link],
    parameter_set_id: int,
    system: str,
    seen_version: int | None,
) -> HandOver:
    """Put on record that an operator hands the baseline's table over, and return what goes."""
    require_person(actor, "hand a table over")
    require_role(actor, "operator")
    require_scope(actor, "uplinks")
    row = session.get_known(ParameterSet, parameter_set_id)
    require_seen(session, row, seen_version)
    if row.ground_state != "BASELINE":
        raise ConflictError(f"{row.name} is {row.ground_state}: only the baseline is handed over. Promote it first.")
    link = links.get(system)
    if link is None or not link.store:
        raise ConflictError(
            f"No store is configured for {system[:20] or 'this system'}; set one in the server settings."
        )
    package = next(iter(lists.list_newest(session, Package, set=row.id, limit=1)), None)
    if package is None:
        raise ConflictError(f"{row.name} has no package: build it first.")
    files = _read_table(packages.read(session, blobs, package.id))
    audit.append(session, actor, BEGAN, f"packages/{package.id}", None, {"parameter_set": row.name, "to": link.place})
    return HandOver(link, package.id, row.name, package.sha256, files)


def end(session: Session, actor: Actor, handed: HandOver, places: Sequence[str]) -> None:
    """Put on record where it lies now."""
    session.get_known(Package, handed.package_id)
    told = {
        "parameter_set": handed.name,
        "package_sha256": handed.sha256,
        "to": handed.link.place,
        "places": list(places),
    }
    audit.append(session, actor, ENDED, f"packages/{handed.package_id}", None, told)


def list_hand_overs(session: Session, package_ids: Sequence[int]) -> Sequence[AuditRecord]:
    """Return the records of packages that were handed over, newest first."""
    return rows.list_package_records(session, package_ids, ENDED)


def _read_table(content: bytes) -> Mapping[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        names = set(packed.namelist())
        if IMAGE not in names:
            raise NotFoundError("The package has no table: give the sensor a table definition, and export it again.")
        return {name: packed.read(name) for name in (IMAGE, DEFINITION) if name in names}
