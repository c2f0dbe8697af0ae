"""The table on board as files: the image, the image to read, cFE's file, OpenC3's definition, the list for PUS service 20.

`table.hex.txt` has sixteen bytes a line after their offset, as `xxd` writes and reads them.

The table for OpenC3's Table Manager: `table_def.txt` in its own words, `table_report.csv` for everyone else.

One `PARAMETER` line a field, in the order of the table::

    PARAMETER <name> <bit offset> <bit size> <INT|UINT|FLOAT> <minimum> <maximum> <default> "<description>" <byte order>
    PARAMETER <name> <bit offset> <bit size> BLOCK <default> "<description>" <byte order>

Values are raw, because OpenC3 converts in floating point where the table counts; the description says what a raw unit is.
Bytes that nothing lies in have lines of their own, or Table Manager would write zeros into them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from typing import Any

from boresight.uplink import cfe
from boresight.uplink.archive import csv_bytes
from boresight.uplink.fields import Field
from boresight.uplink.parameter_service import ATOMICITY, application_data, type_code, value_bytes
from boresight.uplink.table_definition import (
    NO_TURN,
    DecodedField,
    TableDefinition,
    crc_told,
    decode,
    encode,
    table_crc,
)

PUS_COLUMNS = ("order", "parameter_id", "name", "parameter", "type", "ptc", "pfc", "raw_hex", "value", "note")


def table_files(
    definition: TableDefinition,
    parameters: Mapping[str, float],
    title: str,
    alignment: Mapping[str, float] | None = None,
) -> dict[str, bytes]:
    """Return the files of a table by name; `alignment`: as `encode` takes it."""
    image = encode(definition, parameters, alignment)
    files = {
        "table.bin": image,
        "table.hex.txt": ("\n".join(_hex_lines(image)) + "\n").encode(),
        "table_def.txt": table_def(definition, image, title),
        "table_report.csv": table_report(definition, image),
    }
    if definition.cfe is not None:
        files["table.tbl"] = cfe.table_file(definition.cfe, image, title)
    if definition.pus is not None:
        files["pus_st20.csv"] = _pus_list(definition, parameters)
    return files


def held_by(definition: TableDefinition, parameters: Mapping[str, float]) -> dict[str, DecodedField]:
    """Return each parameter as the table holds it, whatever alignment it holds."""
    fields = decode(definition, encode(definition, parameters, NO_TURN)).fields
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


REPORT = ("name", "parameter", "bit_offset", "bit_size", "type", "byte_order", "raw", "scale", "offset", "value", "hex")


def table_def(definition: TableDefinition, image: bytes, title: str) -> bytes:
    """Write OpenC3's definition of a table, with an image's values as defaults."""
    lines = [
        f"# {_quoted(title)} for flight software {_quoted(definition.flight_software_version)}",
        f'TABLE "{_quoted(definition.table_id)}" BIG_ENDIAN KEY_VALUE "{_quoted(title)}"',
    ]
    place = 0
    for one in (*_placed(definition, image), None):
        end = 8 * definition.length_bytes if one is None else one.field.bit
        lines += _fill(definition, place, end)
        if one is not None:
            lines.append(_line(one))
            place = one.field.end
    return ("\n".join(lines) + "\n").encode()


def table_report(definition: TableDefinition, image: bytes) -> bytes:
    """Write every field of an image as a row."""
    return csv_bytes(REPORT, (_row(one) for one in _placed(definition, image)))


def _row(one: DecodedField) -> list[object]:
    field = one.field
    order = "little" if field.little else "big"
    placed = [field.name, field.parameter, field.bit, field.bits, field.kind, order]
    return [*placed, one.raw, field.scale, field.offset, one.value, one.hexadecimal]


def _placed(definition: TableDefinition, image: bytes) -> list[DecodedField]:
    """Return every field of an image with the stored CRC among them, in the order of the table."""
    decoded = decode(definition, image)
    fields = list(decoded.fields)
    if definition.crc_field is not None and decoded.stored_crc is not None:
        field, crc = definition.crc_field, decoded.stored_crc
        fields.append(DecodedField(field, crc, float(crc), f"{field.pack(crc):0{field.bits // 4}X}"))
    return sorted(fields, key=lambda one: one.field.bit)


def _line(one: DecodedField) -> str:
    field = one.field
    if field.floating:
        kind, low, high = "FLOAT", f"MIN_FLOAT{field.bits}", f"MAX_FLOAT{field.bits}"
    else:
        kind = "UINT" if field.unsigned else "INT"
        low, high = (str(limit) for limit in field.limits)
    order = "LITTLE_ENDIAN" if field.little else "BIG_ENDIAN"
    described = f'"{_quoted(_description(field))}"'
    return f"  PARAMETER {field.name} {field.bit} {field.bits} {kind} {low} {high} {one.raw!r} {described} {order}"


def _description(field: Field) -> str:
    what = field.parameter or ("CRC" if field.constant is None else "constant")
    return what if field.plain else f"{what} = {field.scale!r} raw + {field.offset!r}"


def _fill(definition: TableDefinition, start: int, end: int) -> Iterator[str]:
    """Write the bits between two fields: parts of a byte as numbers, whole bytes as one block."""
    while start < end:
        stop = end - end % 8 if start % 8 == 0 and end - start >= 8 else min(end, start + 8 - start % 8)
        size = stop - start
        if size >= 8:
            content = bytes([definition.fill]) * (size // 8)
            yield f'  PARAMETER FILL_{start} {start} {size} BLOCK 0x{content.hex().upper()} "fill" BIG_ENDIAN'
        else:
            value = definition.fill >> (8 - start % 8 - size) & ((1 << size) - 1)
            yield f'  PARAMETER FILL_{start} {start} {size} UINT 0 {(1 << size) - 1} {value} "fill" BIG_ENDIAN'
        start = stop


def _quoted(text: str) -> str:
    """Return a text that may stand between quotes on one line."""
    return text.replace('"', "'").replace("\\", "/").replace("\n", " ")
