"""The table on board that holds a sensor's camera, as its mission configured it: parameters to bytes, and bytes back.

The image is one whole number of bytes, filled with one value where no field lies. Fields, constants and the CRC may not
overlap, and every parameter of the sensor's camera model is in the table once: a focal length beside the distortion of
another calibration is a wrong camera, so a calibration goes as one image or not at all.

The CRC is taken of the bytes `over`, from the first to before the second, and stored at `offset_bytes` when the table holds
its own; cFE Table Services keep it in telemetry instead, taken of the whole image.

A table to begin with: a camera model's parameters in single precision, big-endian, one after the other, with a CRC.

Length and place of everything follow from the model; a mission changes what its flight software has otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.uplink.checksum import CHECKSUMS, Checksum
from boresight.uplink.definition_document import TableDefinition, parse_definition, read_definition
from boresight.uplink.fields import Field
from boresight.uplink.quantisation import quantisation_effect

__all__ = [
    "Decoded",
    "DecodedField",
    "TableDefinition",
    "crc_told",
    "crc_value",
    "decode",
    "encode",
    "parse_definition",
    "quantisation_effect",
    "quantised",
    "read_definition",
    "table_crc",
]


@dataclass(frozen=True)
class DecodedField:
    """A field of an image.

    `value`: scale raw + offset; of a parameter in SI.
    """

    field: Field
    raw: float | int
    value: float
    hexadecimal: str


@dataclass(frozen=True)
class Decoded:
    """An image read back."""

    values: dict[str, float]
    fields: tuple[DecodedField, ...]
    crc_ok: bool | None
    crc: int | None
    stored_crc: int | None


def encode(definition: TableDefinition, parameters: Mapping[str, float]) -> bytes:
    """Lay parameters into the table.

    `parameters`: Number of each parameter of the camera model, SI. Returns (length_bytes,) bytes, the CRC in its
    place.: .
    """
    image = int.from_bytes(bytes([definition.fill]) * definition.length_bytes, "big")
    for field in definition.fields:
        number = field.constant if field.parameter is None else parameters[field.parameter]
        image = _with_bits(definition, image, field, field.pack(number or 0))
    if definition.crc_field is not None:
        crc = table_crc(definition, image.to_bytes(definition.length_bytes, "big")) or 0
        image = _with_bits(definition, image, definition.crc_field, definition.crc_field.pack(crc))
    return image.to_bytes(definition.length_bytes, "big")


def _with_bits(definition: TableDefinition, image: int, field: Field, bits: int) -> int:
    """Put a field's bits in their place."""
    shift = 8 * definition.length_bytes - field.end
    return image & ~(((1 << field.bits) - 1) << shift) | bits << shift


def decode(definition: TableDefinition, content: bytes) -> Decoded:
    """Read an image as the flight software does."""
    if len(content) != definition.length_bytes:
        raise RefusedInputError(
            f"The image has {len(content)} bytes and the table {definition.table_id} has {definition.length_bytes}: "
            "give the whole table, without anything before or after it."
        )
    fields = tuple(_decoded(definition, content, field) for field in definition.fields)
    crc = table_crc(definition, content)
    stored = None
    if definition.crc_field is not None:
        stored = int(_decoded(definition, content, definition.crc_field).raw)
    values = {one.field.parameter: one.value for one in fields if one.field.parameter is not None}
    return Decoded(values, fields, None if stored is None else stored == crc, crc, stored)


def _decoded(definition: TableDefinition, content: bytes, field: Field) -> DecodedField:
    """Read one field of an image."""
    shift = 8 * definition.length_bytes - field.end
    bits = int.from_bytes(content, "big") >> shift & ((1 << field.bits) - 1)
    raw, value = field.unpack(bits)
    return DecodedField(field, raw, value, f"{bits:0{-(-field.bits // 4)}X}")


def quantised(definition: TableDefinition, parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters as the table holds them, in the order given."""
    held = decode(definition, encode(definition, parameters)).values
    return {name: held[name] for name in parameters if name in held}


def crc_value(crc: Checksum, content: bytes) -> int:
    """Compute a CRC of some bytes, all of them."""
    return crc.value(content)


def table_crc(definition: TableDefinition, content: bytes) -> int | None:
    """Compute the table's CRC of an image, of the bytes that it is over; None when the definition names none."""
    if definition.crc is None:
        return None
    first, end = definition.crc_over
    return crc_value(definition.crc, content[first:end])


def crc_told(definition: TableDefinition, content: bytes) -> tuple[Checksum, int] | None:
    """Return the CRC that the spacecraft tells of an image that it holds, and its algorithm; None when it tells none.

    cFE Table Services tell CRC-16/ARC of the whole image, whatever CRC the table may hold inside; others tell the table's own.
    """
    if definition.cfe is not None:
        crc = CHECKSUMS["CRC-16/ARC"]
        return crc, crc_value(crc, content)
    value = table_crc(definition, content)
    return None if definition.crc is None or value is None else (definition.crc, value)


BYTES_A_NUMBER = 4
CRC_BYTES = 2


def plain_definition(camera_model: str) -> dict[str, Any]:
    """Return a table definition that holds a camera model, as `boresight.uplink.definition_document` reads it."""
    names = CAMERA_MODELS[camera_model].parameter_names
    length = BYTES_A_NUMBER * (len(names) + 1)  # the CRC stands at the end of the last word
    fields = [
        {"name": name.upper(), "parameter": name, "offset_bytes": BYTES_A_NUMBER * place, "type": "float32"}
        for place, name in enumerate(names)
    ]
    over = length - CRC_BYTES
    return {
        "table_id": "STR_CAM",
        "flight_software_version": "1.0.0",
        "byte_order": "big",
        "length_bytes": length,
        "fill": 0,
        "fields": fields,
        "crc": {"name": "CRC-16/CCITT-FALSE", "offset_bytes": over, "over": [0, over]},
    }
