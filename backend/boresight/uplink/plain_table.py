"""A table to begin with: a camera model's parameters in single precision, big-endian, one after the other, with a CRC.

Length and place of everything follow from the model; a mission changes what its flight software has otherwise.
"""

from __future__ import annotations

from typing import Any

from boresight.estimation.cameras import CAMERA_MODELS

BYTES_A_NUMBER = 4
CRC_BYTES = 2


def plain_definition(camera_model: str) -> dict[str, Any]:
    """Return a table definition that holds a camera model, as `boresight.uplink.definition_document` reads it.

    Raises
    ------
    KeyError
        When there is no such camera model.
    """
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
