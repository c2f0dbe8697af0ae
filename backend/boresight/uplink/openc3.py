"""The table for OpenC3's Table Manager: `table_def.txt` in its own words, `table_report.csv` for everyone else.

One `PARAMETER` line a field, in the order of the table::

    PARAMETER <name> <bit offset> <bit size> <INT|UINT|FLOAT> <minimum> <maximum> <default> "<description>" <byte order>
    PARAMETER <name> <bit offset> <bit size> BLOCK <default> "<description>" <byte order>

Values are raw, because OpenC3 converts in floating point where the table counts; the description says what a raw unit is.
Bytes that nothing lies in have lines of their own, or Table Manager would write zeros into them.
"""

from __future__ import annotations

from collections.abc import Iterator

from boresight.uplink.archive import csv_bytes
from boresight.uplink.fields import Field
from boresight.uplink.table_definition import DecodedField, TableDefinition, decode

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
    """Write a field."""
    field = one.field
    if field.floating:
        kind, low, high = "FLOAT", f"MIN_FLOAT{field.bits}", f"MAX_FLOAT{field.bits}"
    else:
        kind = "UINT" if field.kind.startswith("u") else "INT"
        low, high = (str(limit) for limit in field.limits)
    order = "LITTLE_ENDIAN" if field.little else "BIG_ENDIAN"
    described = f'"{_quoted(_description(field))}"'
    return f"  PARAMETER {field.name} {field.bit} {field.bits} {kind} {low} {high} {one.raw!r} {described} {order}"


def _description(field: Field) -> str:
    """Say what a raw value stands for."""
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
