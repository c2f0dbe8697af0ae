"""PUS service 20, parameter management (ECSS-E-ST-70-41C): the values of a set as one request TC[20,3].

Application data of TC[20,3], set parameter values, every number big-endian::

    N | parameter ID_1 | value_1 | ... | parameter ID_N | value_N

A value has the type of its field in the table, and types are told by the standard's parameter type and format codes:

===============  ====  ==================================================================
type             PTC   PFC
===============  ====  ==================================================================
uint<n>          3     n - 4 up to 16 bits, 13, 14, 15, 16 for 24, 32, 48, 64 bits
int<n>           4     the same
float32          5     1
float64          5     2
===============  ====  ==================================================================

Whether a request is carried out whole or not at all is the on-board software's to decide, and not all do: one that stops at an
identifier that it does not know leaves a focal length beside the distortion of another calibration. The list says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.telemetry.read.checks import Faults
from boresight.uplink.definition_entries import Entries
from boresight.uplink.fields import FORMATS, Field

KEYS = ("id_type", "count_type", "parameter_ids")
ID_BITS = {"uint8": 8, "uint16": 16, "uint32": 32}
FORMAT_CODES = {24: 13, 32: 14, 48: 15, 64: 16}
ATOMICITY = (
    "Whether TC[20,3] sets all of these values or stops at the first one refused is decided by the on-board software: "
    "use it only if the software sets either all values or none, or if a separate command activates them; "
    "otherwise load the table as one image."
)


@dataclass(frozen=True)
class ParameterService:
    """A mission's numbers for a sensor's parameters."""

    id_bits: int
    count_bits: int
    ids: Mapping[str, int]


def type_code(field: Field) -> tuple[int, int] | None:
    """Return PTC and PFC of a field's type; None where the standard has none for it."""
    if field.kind in FORMATS:
        return 5, 1 if field.kind == "float32" else 2
    code = field.bits - 4 if 4 <= field.bits <= 16 else FORMAT_CODES.get(field.bits)
    return None if code is None else (3 if field.unsigned else 4, code)


def parse_pus(document: Any, fields: tuple[Field, ...], faults: Faults) -> ParameterService | None:
    """Read the identifiers of a table definition; None where it has none."""
    if document is None:
        return None
    entries = Entries(document, "pus", KEYS, faults)
    id_bits = ID_BITS[entries.word("id_type", tuple(ID_BITS), "uint16")]
    count_bits = ID_BITS[entries.word("count_type", tuple(ID_BITS), "uint8")]
    listed = entries.document.get("parameter_ids")
    if not isinstance(listed, Mapping):
        faults.add("pus.parameter_ids is not an object: write each camera parameter and its identifier")
        return ParameterService(id_bits, count_bits, {})
    ids = {}
    for field in fields:
        if field.parameter is not None:
            ids[field.name] = Entries(listed, "pus.parameter_ids", tuple(listed), faults).bits_word(
                field.parameter, id_bits
            )
            if type_code(field) is None or field.bits % 8:
                faults.add(
                    f"{field.name} is {field.kind}, which is not a whole number of bytes as TC[20,3] requires: choose another type"
                )
    known = {field.parameter for field in fields}
    for name in listed:
        if name not in known:
            faults.add(f"pus.parameter_ids names {name!r}, which is in no field: omit it")
    if len(set(ids.values())) != len(ids):
        faults.add("pus.parameter_ids gives one identifier to two parameters: correct it")
    return ParameterService(id_bits, count_bits, ids)


def application_data(service: ParameterService, fields: tuple[Field, ...], values: Mapping[str, float]) -> bytes:
    """Return the application data of TC[20,3] for every parameter, in the order of the table.

    `values`: Number of each camera parameter, SI.
    """
    sent = [field for field in fields if field.name in service.ids]
    content = len(sent).to_bytes(service.count_bits // 8, "big")
    for field in sent:
        content += service.ids[field.name].to_bytes(service.id_bits // 8, "big") + value_bytes(field, values)
    return content


def value_bytes(field: Field, values: Mapping[str, float]) -> bytes:
    """Return a field's value as PUS sends it: highest byte first, whatever the table's own order is."""
    content = field.pack(values[str(field.parameter)]).to_bytes(field.bits // 8, "big")
    return content[::-1] if field.little else content
