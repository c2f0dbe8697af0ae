"""The table on board as files: the image, the image to read, cFE's file, OpenC3's definition, the list for PUS service 20.

`table.hex.txt` has sixteen bytes a line after their offset, as `xxd` writes and reads them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from typing import Any

from boresight.uplink import cfe, openc3
from boresight.uplink.archive import csv_bytes
from boresight.uplink.parameter_service import ATOMICITY, application_data, type_code, value_bytes
from boresight.uplink.table_definition import DecodedField, TableDefinition, crc_told, decode, encode, table_crc

PUS_COLUMNS = ("order", "parameter_id", "name", "parameter", "type", "ptc", "pfc", "raw_hex", "value", "note")


def table_files(definition: TableDefinition, parameters: Mapping[str, float], title: str) -> dict[str, bytes]:
    """Return the files of a table by name."""
    image = encode(definition, parameters)
    files = {
        "table.bin": image,
        "table.hex.txt": ("\n".join(_hex_lines(image)) + "\n").encode(),
        "table_def.txt": openc3.table_def(definition, image, title),
        "table_report.csv": openc3.table_report(definition, image),
    }
    if definition.cfe is not None:
        files["table.tbl"] = cfe.table_file(definition.cfe, image, title)
    if definition.pus is not None:
        files["pus_st20.csv"] = _pus_list(definition, parameters)
    return files


def held_by(definition: TableDefinition, parameters: Mapping[str, float]) -> dict[str, DecodedField]:
    """Return each parameter as the table holds it."""
    fields = decode(definition, encode(definition, parameters)).fields
    return {one.field.parameter: one for one in fields if one.field.parameter is not None}


def table_facts(definition: TableDefinition, files: Mapping[str, bytes]) -> dict[str, Any]:
    """Say what to compare on board: length, hash and CRC of the image, the CRC that is told, and their algorithms beyond doubt."""
    image = files["table.bin"]
    facts: dict[str, Any] = {"bytes": len(image), "sha256": hashlib.sha256(image).hexdigest(), "crc": None}
    told = crc_told(definition, image)
    facts["crc_told"] = None if told is None else told[0].document() | {"value": told[0].text(told[1])}
    value = table_crc(definition, image)
    if definition.crc is not None and value is not None:
        stored = definition.crc_field
        facts["crc"] = definition.crc.document() | {
            "value": definition.crc.text(value),
            "over_bytes": list(definition.crc_over),
            "stored_at_byte": None if stored is None else stored.bit // 8,
        }
    return facts


def _hex_lines(image: bytes) -> Iterator[str]:
    """Yield sixteen bytes a line."""
    for start in range(0, len(image), 16):
        yield f"{start:08x}: {image[start : start + 16].hex(' ', -2)}"


def _pus_list(definition: TableDefinition, parameters: Mapping[str, float]) -> bytes:
    """Write each value of the request TC[20,3], the request's application data, and who answers for all or nothing."""
    service = definition.pus
    if service is None:
        return b""
    sent = [field for field in definition.fields if field.name in service.ids]
    rows: list[list[Any]] = []
    for order, field in enumerate(sent, 1):
        ptc, pfc = type_code(field) or (None, None)
        raw = value_bytes(field, parameters).hex().upper()
        number = f"0x{service.ids[field.name]:0{service.id_bits // 4}X}"
        value = parameters[str(field.parameter)]
        rows.append([order, number, field.name, field.parameter, field.kind, ptc, pfc, raw, value, None])
    data = application_data(service, definition.fields, parameters).hex().upper()
    rows.append([None, None, "TC[20,3] application data", None, None, None, None, data, None, ATOMICITY])
    return csv_bytes(PUS_COLUMNS, rows)
