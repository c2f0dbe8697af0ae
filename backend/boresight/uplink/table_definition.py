"""The table on board that holds a sensor's camera, as its mission configured it: parameters to bytes, and bytes back.

The image is one whole number of bytes, filled with one value where no field lies. Fields, constants and the CRC may not
overlap, and every parameter of the sensor's camera model is in the table once: a focal length beside the distortion of
another calibration is a wrong camera, so a calibration goes as one image or not at all.

The CRC is taken of the bytes `over`, from the first to before the second, and stored at `offset_bytes` when the table holds
its own; cFE Table Services keep it in telemetry instead, taken of the whole image.

A table to begin with: a camera model's parameters in single precision, big-endian, one after the other, with a CRC.

Length and place of everything follow from the model; a mission changes what its flight software has otherwise.

A mission's table definition: one JSON object, every entry of it checked, so that a slip is refused and not flown.

::

    {"table_id": "STR_CAM", "flight_software_version": "4.2.1", "byte_order": "big", "length_bytes": 40, "fill": 0,
     "fields": [{"name": "VERSION", "constant": 3, "offset_bytes": 0, "type": "uint16"},
                {"name": "FOCAL_LENGTH", "parameter": "f_m", "offset_bytes": 4, "type": "float32", "scale": 0.001}, ...],
     "crc": {"name": "CRC-16/CCITT-FALSE", "offset_bytes": 38, "over": [0, 38]},
     "cfe": {"table_name": "STR_APP.CAMERA"},
     "pus": {"id_type": "uint16", "count_type": "uint8", "parameter_ids": {"f_m": 4096, ...}}}

`offset_bits` may stand for `offset_bytes`; `byte_order` may stand in a field; `crc`, `cfe` and `pus` may be left out. A CRC of
another name gives `width`, `poly`, `init`, `refin`, `refout` and `xorout`, and may give `check` to be held to.

A field may name a number of the sensor's alignment instead, `"alignment": "q_x"`: one of the quaternion q_x q_y q_z q_w that turns
vectors of the detector into those of the other frame, or of its matrix c_11 ... c_33, row by row; then C_SD goes in the same image
as the parameters that it belongs to.

What the number format on board does to the camera: the same star, seen with and without rounding.

At each place p of a grid over the detector, corners included, the camera has a direction s(x, p). The parameters x' that the
table holds give that place another direction, and that direction another place:

    angle = 2 asin(|s(x', p) - s(x, p)| / 2)        shift = |project(x', s(x, p)) - project(x, s(x, p))|

Both are taken whole, a common rotation included, because the star tracker on board knows no other camera.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import ARCSEC_PER_RAD
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.errors import RefusedInputError
from boresight.estimation.attitude import to_matrix
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.read.formats import read_json
from boresight.telemetry.sensors import Sensor
from boresight.uplink.cfe import CfeHeaders, parse_cfe
from boresight.uplink.checksum import CHECKSUMS, Checksum
from boresight.uplink.definition_entries import MOST_BYTES, Entries, parse_checksum
from boresight.uplink.fields import Field
from boresight.uplink.parameter_service import ParameterService, parse_pus

PLACES = 41


def quantisation_effect(
    camera_model: CameraModel, sensor: Sensor, parameters: Mapping[str, float], quantised: Mapping[str, float]
) -> dict[str, float]:
    """Return the greatest shift over the detector, `max_px` pixels and `max_arcsec` seconds of arc.

    `parameters`, `quantised`: Every parameter of the camera model before and after the table, SI.
    """
    row, col = np.meshgrid(
        np.linspace(-0.5, sensor.rows - 0.5, PLACES), np.linspace(-0.5, sensor.columns - 0.5, PLACES), indexing="ij"
    )
    names, pitch = camera_model.parameter_names, sensor.pixel_pitch_m
    exact, rounded = (np.array([values[name] for name in names], float) for values in (parameters, quantised))
    with np.errstate(all="ignore"):
        s = camera_model.directions(exact, row.ravel(), col.ravel(), pitch)
        seen = camera_model.directions(rounded, row.ravel(), col.ravel(), pitch)
        rows, cols = camera_model.project(exact, s, pitch)
        moved_rows, moved_cols = camera_model.project(rounded, s, pitch)
    angle = 2 * np.arcsin(np.minimum(np.linalg.norm(seen - s, axis=-1) / 2, 1.0))
    shift = np.hypot(moved_rows - rows, moved_cols - cols)
    if not (np.isfinite(angle).all() and np.isfinite(shift).all()):
        raise RefusedInputError(
            "With the precision of this table, part of the detector has no direction: give its fields more bits."
        )
    return {"max_px": float(shift.max()), "max_arcsec": float(angle.max() * ARCSEC_PER_RAD)}


KEYS = (
    "schema",
    "table_id",
    "flight_software_version",
    "byte_order",
    "length_bytes",
    "fill",
    "fields",
    "crc",
    "cfe",
    "pus",
)
FIELD_KEYS = (
    "name", "parameter", "alignment", "constant", "offset_bytes", "offset_bits", "type", "byte_order", "scale", "offset",
)  # fmt: skip
#: Numbers of an alignment: the quaternion, and the matrix row by row.
ALIGNMENT_NAMES = ("q_x", "q_y", "q_z", "q_w", *(f"c_{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)))
#: What a field may hold, with its article.
SOURCES = (("a", "parameter"), ("an", "alignment"), ("a", "constant"))
MOST_FIELDS = 512
ORDERS = ("big", "little")
WHOLE = (8, 16, 32, 64)
SCHEMA = "boresight.table-definition/1"


@dataclass(frozen=True)
class TableDefinition:
    """A table on board."""

    table_id: str
    flight_software_version: str
    length_bytes: int
    fill: int
    fields: tuple[Field, ...]
    crc: Checksum | None
    crc_over: tuple[int, int]
    crc_field: Field | None
    cfe: CfeHeaders | None
    pus: ParameterService | None
    document: Mapping[str, Any] = attribute(repr=False)

    @property
    def is_aligned(self) -> bool:
        """Whether the table holds an alignment too."""
        return any(field.alignment is not None for field in self.fields)


def read_definition(path: Path, sensor: Sensor) -> TableDefinition:
    """Read a sensor's table definition from a file."""
    try:
        document = read_json(path, path.name)
    except json.JSONDecodeError as error:
        raise RefusedInputError(f"{path.name} is not JSON: write the table definition as one JSON object.") from error
    return parse_definition(document, sensor)


def parse_definition(document: Mapping[str, Any], sensor: Sensor) -> TableDefinition:
    """Read a sensor's table definition."""
    if not isinstance(document, Mapping):
        raise RefusedInputError("This is not a table definition: write one JSON object with a table_id and fields.")
    faults = Faults("The table definition")
    entries = Entries(document, "", KEYS, faults)
    if document.get("schema", SCHEMA) != SCHEMA:
        faults.add(f"schema is {document['schema']!r}: write {SCHEMA}, or omit it")
    length = entries.whole("length_bytes", 1, MOST_BYTES)
    little = entries.word("byte_order", ORDERS, "big") == "little"
    fields = _fields(document.get("fields"), little, sensor, faults)
    crc, crc_field, over = _crc(document.get("crc"), length, little, faults)
    definition = TableDefinition(
        table_id=entries.text("table_id"),
        flight_software_version=entries.text("flight_software_version"),
        length_bytes=length,
        fill=entries.whole("fill", 0, 255, 0),
        fields=fields,
        crc=crc,
        crc_over=over,
        crc_field=crc_field,
        cfe=parse_cfe(document.get("cfe"), faults),
        pus=parse_pus(document.get("pus"), fields, faults),
        document=dict(document),
    )
    faults.refuse()
    _check_layout(definition, sensor, faults)
    faults.refuse()
    return definition


def _fields(listed: Any, little: bool, sensor: Sensor, faults: Faults) -> tuple[Field, ...]:
    if not isinstance(listed, list) or not 0 < len(listed) <= MOST_FIELDS:
        faults.add(f"fields is not a list of 1 to {MOST_FIELDS} objects: list what the table contains")
        return ()
    fields = [_field(entry, f"fields[{place}]", little, sensor, faults) for place, entry in enumerate(listed)]
    return tuple(sorted(fields, key=lambda one: one.bit))


def _field(document: Any, place: str, little: bool, sensor: Sensor, faults: Faults) -> Field:
    entries = Entries(document, place, FIELD_KEYS, faults)
    kind = entries.kind("type")
    parameter = entries.optional_word("parameter", CAMERA_MODELS[sensor.camera_model].parameter_names)
    alignment = entries.optional_word("alignment", ALIGNMENT_NAMES)
    constant = entries.constant("constant") if parameter is None and alignment is None else None
    named = [f"{article} {key}" for article, key in SOURCES if entries.has(key)]
    if len(named) > 1:
        faults.add(f"{place} names {' and '.join(named)}: keep one of them")
    field = Field(
        name=entries.name("name"),
        parameter=parameter,
        bit=entries.position(),
        kind=kind,
        little=entries.word("byte_order", ORDERS, "little" if little else "big") == "little",
        scale=entries.number("scale", 1.0),
        offset=entries.number("offset", 0.0),
        constant=constant,
        alignment=alignment,
    )
    if field.scale == 0:
        faults.add(f"{place}.scale is 0: give the step of one raw unit")
    elif constant is not None and not faults.count:
        _check_constant(field, place, faults)
    if field.floating and field.bit % 8:
        faults.add(
            f"{place} is a {kind} that begins inside a byte, where no ground system reads floats: begin it at a whole byte"
        )
    if field.little and (field.bit % 8 or field.bits not in WHOLE):
        faults.add(f"{place} is little-endian, which needs 8, 16, 32 or 64 bits from a whole byte: give byte_order big")
    return field


def _check_constant(field: Field, place: str, faults: Faults) -> None:
    try:
        field.pack(field.constant or 0)
    except RefusedInputError as refusal:
        faults.add(f"{place}: {refusal}")


def _crc(
    document: Any, length: int, little: bool, faults: Faults
) -> tuple[Checksum | None, Field | None, tuple[int, int]]:
    """Read the algorithm, where it is stored, and the bytes that it is over."""
    if document is None:
        return None, None, (0, 0)
    crc, entries = parse_checksum(document, faults)
    offset = entries.whole("offset_bytes", 0, MOST_BYTES, None)
    over = document.get("over", [0, length if offset is None else offset]) if isinstance(document, Mapping) else [0, 0]
    whole = isinstance(over, list) and len(over) == 2 and all(type(end) is int for end in over)
    if not whole or not 0 <= over[0] < over[1] <= length:
        faults.add(
            f"crc.over is {over!r}: give the first byte and the first byte after the range, inside {length} bytes"
        )
        over = [0, 0]
    order = entries.word("byte_order", ORDERS, "little" if little else "big")
    if offset is None:
        return crc, None, (over[0], over[1])
    if over[0] < offset + crc.width // 8 and offset < over[1]:
        faults.add(f"crc is stored at byte {offset}, inside the bytes that it covers: give `over` without it")
    return crc, Field("CRC", None, 8 * offset, f"uint{crc.width}", order == "little"), (over[0], over[1])


def _check_layout(definition: TableDefinition, sensor: Sensor, faults: Faults) -> None:
    """Note fields that overlap or reach past the end, names twice, and parameters that are not there once."""
    stored = () if definition.crc_field is None else (definition.crc_field,)
    placed = sorted((*definition.fields, *stored), key=lambda one: one.bit)
    for before, after in itertools.pairwise(placed):
        if after.bit < before.end:
            faults.add(f"{after.name} begins at bit {after.bit}, inside {before.name}: move one of them")
    for field in placed:
        if field.end > 8 * definition.length_bytes:
            faults.add(
                f"{field.name} ends at bit {field.end}, past the {definition.length_bytes} bytes of the table: "
                "move it, or correct length_bytes"
            )
    names = [field.name.upper() for field in placed]  # ground systems know no other letters
    for name in sorted({name for name in names if names.count(name) > 1}):
        faults.add(f"{name} is the name of {names.count(name)} fields: name each once")
    held = [field.parameter for field in definition.fields]
    for parameter in CAMERA_MODELS[sensor.camera_model].parameter_names:
        if held.count(parameter) != 1:
            faults.add(
                f"the parameter {parameter} is in {held.count(parameter)} fields: "
                f"give each parameter of {sensor.camera_model} one field"
            )


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


def alignment_numbers(quaternion: Sequence[float]) -> dict[str, float]:
    """Return the numbers of an alignment by the names of fields, from its quaternion x, y, z, w."""
    matrix = to_matrix(np.array(quaternion, np.float64))
    return dict(zip(ALIGNMENT_NAMES, [*map(float, quaternion), *map(float, matrix.ravel())], strict=True))


#: The alignment of what is not turned, where a table is laid out to look at its parameters.
NO_TURN = alignment_numbers((0.0, 0.0, 0.0, 1.0))


def encode(
    definition: TableDefinition, parameters: Mapping[str, float], alignment: Mapping[str, float] | None = None
) -> bytes:
    """Lay parameters into the table.

    `parameters`: Number of each parameter of the camera model, SI. `alignment`: as `alignment_numbers` gives them, for a table that
    holds one. Returns (length_bytes,) bytes, the CRC in its place.
    """
    if definition.is_aligned and alignment is None:
        raise RefusedInputError(
            f"The table {definition.table_id} contains an alignment: give one from `boresight align`, made with these parameters."
        )
    image = int.from_bytes(bytes([definition.fill]) * definition.length_bytes, "big")
    for field in definition.fields:
        number = field.constant
        if field.parameter is not None:
            number = parameters[field.parameter]
        elif field.alignment is not None and alignment is not None:
            number = alignment[field.alignment]
        image = _with_bits(definition, image, field, field.pack(number or 0))
    if definition.crc_field is not None:
        crc = table_crc(definition, image.to_bytes(definition.length_bytes, "big")) or 0
        image = _with_bits(definition, image, definition.crc_field, definition.crc_field.pack(crc))
    return image.to_bytes(definition.length_bytes, "big")


def _with_bits(definition: TableDefinition, image: int, field: Field, bits: int) -> int:
    shift = 8 * definition.length_bytes - field.end
    return image & ~(((1 << field.bits) - 1) << shift) | bits << shift


def decode(definition: TableDefinition, content: bytes) -> Decoded:
    """Read an image as the flight software does."""
    if len(content) != definition.length_bytes:
        raise RefusedInputError(
            f"The image has {len(content)} bytes and the table {definition.table_id} has {definition.length_bytes}: "
            "give the whole table and nothing else.",
            code="wrong-image-size",
        )
    fields = tuple(_decoded(definition, content, field) for field in definition.fields)
    crc = table_crc(definition, content)
    stored = None
    if definition.crc_field is not None:
        stored = int(_decoded(definition, content, definition.crc_field).raw)
    values = {one.field.parameter: one.value for one in fields if one.field.parameter is not None}
    return Decoded(values, fields, None if stored is None else stored == crc, crc, stored)


def _decoded(definition: TableDefinition, content: bytes, field: Field) -> DecodedField:
    shift = 8 * definition.length_bytes - field.end
    bits = int.from_bytes(content, "big") >> shift & ((1 << field.bits) - 1)
    raw, value = field.unpack(bits)
    return DecodedField(field, raw, value, f"{bits:0{-(-field.bits // 4)}X}")


def quantised(definition: TableDefinition, parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters as the table holds them, in the order given."""
    held = decode(definition, encode(definition, parameters, NO_TURN)).values
    return {name: held[name] for name in parameters if name in held}


def table_crc(definition: TableDefinition, content: bytes) -> int | None:
    """Compute the table's CRC of an image, of the bytes that it is over; None when the definition names none."""
    if definition.crc is None:
        return None
    first, end = definition.crc_over
    return definition.crc.value(content[first:end])


def crc_told(definition: TableDefinition, content: bytes) -> tuple[Checksum, int] | None:
    """Return the CRC that the spacecraft tells of an image that it holds, and its algorithm; None when it tells none.

    cFE Table Services tell CRC-16/ARC of the whole image, whatever CRC the table may hold inside; others tell the table's own.
    """
    if definition.cfe is not None:
        crc = CHECKSUMS["CRC-16/ARC"]
        return crc, crc.value(content)
    value = table_crc(definition, content)
    return None if definition.crc is None or value is None else (definition.crc, value)


BYTES_A_NUMBER = 4
CRC_BYTES = 2


def plain_definition(camera_model: str) -> dict[str, Any]:
    """Return a table definition that holds a camera model, as `boresight.uplink.table_definition` reads it."""
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
