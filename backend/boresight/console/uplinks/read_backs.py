"""Read-backs: comparing the dump of a table, or the CRC that the spacecraft reports, with what was sent.

Equal bytes make a set VERIFIED; so does an equal CRC, which is weaker: of w bits it passes one wrong table in 2^w.
Anything else is MISMATCH, and one that bytes showed is taken back by bytes only, or by sending again.
"""

from __future__ import annotations

import hashlib
import io
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.console.fleet import queries as history
from boresight.console.fleet.timeline import happened_on
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.transitions import require_seen
from boresight.console.uplinks import packages
from boresight.console.uplinks import queries as rows
from boresight.console.uplinks.service import (
    EntryBasis,
    add_entry,
    get_set_for_entry,
    refuse_shown_mismatch,
    require_entrant,
)
from boresight.console.uplinks.table_definitions import parse_stored
from boresight.console.uplinks.tables import Package, TableDefinition, Uplink
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.sessions import Session, is_dry_run, utc_now
from boresight.uplink import table_definition as tables
from boresight.uplink.cfe import table_image
from boresight.uplink.comparison import compare

READABLE = ("LOADED", "VERIFIED", "ACTIVE", "MISMATCH", "UNKNOWN")
MOST_DUMP_BYTES = 200_000  # over the largest table with any header
TABLE_FILE = "table.bin"
HEXADECIMAL = re.compile(r"(?:0[xX])?([0-9a-fA-F]{1,16})")


@dataclass(frozen=True)
class SentTable:
    """The table that a read-back is held against.

    `content`: (length_bytes,) bytes as they were sent.
    """

    row: TableDefinition
    definition: tables.TableDefinition
    content: bytes
    package: Package | None

    @property
    def crc(self) -> str | None:
        """The CRC that the spacecraft should report, with all its digits; None where the definition has none."""
        value = tables.table_crc(self.definition, self.content)
        return None if value is None or self.definition.crc is None else self.definition.crc.text(value)

    def document(self) -> dict[str, Any]:
        """Return the description of the reference."""
        named = {"definition": {"number": self.row.number, "sha256": self.row.sha256}}
        if self.package is not None:
            named["package"] = {"id": self.package.id, "sha256": self.package.sha256}
        return named


def get_sent_table(session: Session, blobs: BlobStore, parameter_set: ParameterSet) -> SentTable:
    """Return the table that was sent of a set."""
    sent = rows.find_newest_record(session, parameter_set.id, "SENT")
    package = _get_sent_package(session, sent)
    row = None if package is None else session.get(TableDefinition, package.table_definition_id or 0)
    if row is None:
        at_utc = utc_now() if sent is None else sent.recorded_utc
        row = history.find_in_force_at(session, TableDefinition, parameter_set.sensor_id, at_utc)
    row = row or history.find_in_force_at(session, TableDefinition, parameter_set.sensor_id, utc_now())
    if row is None:
        raise RefusedInputError(
            f"There is no table definition to compare a read-back of {parameter_set.name} with: "
            "have an analyst or an administrator set one.",
            code="no-table-definition",
        )
    definition = parse_stored(session, row)
    if package is not None and package.table_definition_id == row.id:
        return SentTable(row, definition, _read_table(session, blobs, package), package)
    return SentTable(row, definition, tables.encode(definition, parameter_set.document["parameters"]), None)


def _read_table(session: Session, blobs: BlobStore, package: Package) -> bytes:
    """Return the table inside a package: the very bytes that were sent."""
    with zipfile.ZipFile(io.BytesIO(packages.read(session, blobs, package.id))) as packed:
        return packed.read(TABLE_FILE)


def _get_sent_package(session: Session, sent: Uplink | None) -> Package | None:
    """Return the package that a record says was sent."""
    named = sent.typed_evidence.package if sent else None
    return None if named is None else session.get(Package, named.id)


def read_back(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    parameter_set_id: int,
    read: bytes | str,
    source: str,
    seen_version: int | None,
    happened: str | None = None,
) -> Uplink:
    """Hold a dump, or the CRC that was told, against what was sent, and record what came of it.

    `read`: The dump, bytes as they were read from the spacecraft, with or without cFE's file headers, which were stored before
    this transaction; or the CRC that it told, text in hexadecimal.
    """
    row = get_set_for_entry(session, actor, parameter_set_id, source, seen_version)
    require_seen(session, row, seen_version)
    _refuse_unreadable(session, row, read)
    reference = get_sent_table(session, blobs, row)
    if isinstance(read, str):
        matches, found = _compare_crc(reference, read)
    else:
        matches, found = _compare_bytes(session, blobs, row, reference, read)
    details = {**reference.document(), **found, **happened_on(happened)}
    held = "ACTIVE" if row.onboard_state == "ACTIVE" else "VERIFIED"
    basis = EntryBasis(details, method="crc" if isinstance(read, str) else "bytes")
    return add_entry(session, actor, row, held if matches else "MISMATCH", source, basis)


def list_to_store(actor: Actor, dump: bytes | None) -> tuple[bytes, ...]:
    """Return what is stored before the transaction of a read-back; refuses who may not enter one, and stores no large file."""
    if dump is None or len(dump) > MOST_DUMP_BYTES:
        return ()
    require_entrant(actor)
    return (dump,)


def choose_dump_or_crc(dump: bytes | None, crc: str) -> bytes | str:
    """Return whichever was given, the dump or the CRC."""
    if (dump is None) == (not crc.strip()):
        raise RefusedInputError("Give either the dump or the CRC that the spacecraft reported.")
    if dump is not None and len(dump) > MOST_DUMP_BYTES:
        raise RefusedInputError(f"The dump is over {MOST_DUMP_BYTES:,} bytes; upload the dump of this table alone.")
    return crc if dump is None else dump


def _refuse_unreadable(session: Session, row: ParameterSet, read: bytes | str) -> None:
    """Refuse a read-back of a set that was not loaded, and a CRC after a dump that differed."""
    if row.onboard_state not in READABLE:
        raise ConflictError(
            f"{row.name} is {row.onboard_state} on board; record it as LOADED before a read-back of it.",
            code="not-loaded",
        )
    if isinstance(read, str):
        refuse_shown_mismatch(session, row)


def _compare_crc(reference: SentTable, told: str) -> tuple[bool, dict[str, Any]]:
    """Compare a typed CRC with that of the sent table."""
    checksum, expected = reference.definition.crc, reference.crc
    if checksum is None or expected is None:
        raise RefusedInputError(
            "The table definition contains no CRC, so a typed one cannot be compared; upload the dump.", code="no-crc"
        )
    digits = -(-checksum.width // 4)  # the expected one is no example: nobody copies it
    match = HEXADECIMAL.fullmatch(told.strip())
    if match is None or int(match[1], 16) >> checksum.width:
        raise RefusedInputError(f"{told.strip()!r} is not a {checksum.name}; write it in hexadecimal, {digits} digits.")
    found = checksum.text(int(match[1], 16))
    same = found == expected
    sentence = (
        f"{checksum.name} is {found}, which matches the table sent."
        if same
        else f"{checksum.name} is {found}, which differs from the table sent: upload the dump to see the differences."
    )
    return same, {"sentence": sentence, "crc": {"name": checksum.name, "expected": expected, "found": found}}


def _compare_bytes(
    session: Session, blobs: BlobStore, row: ParameterSet, reference: SentTable, dump: bytes
) -> tuple[bool, dict[str, Any]]:
    """Compare a dump with the bytes that were sent; names the stored dump and returns the evidence."""
    definition = reference.definition
    image = table_image(definition.cfe, definition.length_bytes, dump)
    comparison = compare(definition, reference.content, image)
    size = len(dump) if is_dry_run(session) else None
    sha256 = register_blob(session, blobs, hashlib.sha256(dump).hexdigest(), "application/octet-stream", size).sha256
    kept: Mapping[str, Any] = {"sha256": sha256, "bytes": len(dump), "header_bytes": len(dump) - len(image)}
    found = {**comparison.document(), "dump": kept}
    if not comparison.matches and (other := _find_identical_set(session, row, definition, image)) is not None:
        found["same_as"] = other
        found["sentence"] += f" The dump is identical to {other}."
    return comparison.matches, found


def _find_identical_set(
    session: Session, row: ParameterSet, definition: tables.TableDefinition, image: bytes
) -> str | None:
    """Return the name of another set of the sensor whose table the dump is, most often the former one."""
    for other in rows.list_other_sets(session, row):
        try:
            if tables.encode(definition, other.document["parameters"]) == image:
                return other.name
        except RefusedInputError:
            continue  # a set that does not fit in the table cannot be in the dump
    return None
