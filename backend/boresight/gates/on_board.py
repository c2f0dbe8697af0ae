"""What the number format on board does to the parameters: the largest move of a direction anywhere on the detector.

A table holds parameters as float32 or as whole numbers with a scale. Rounding each to its nearest step moves directions, and
nothing on the ground would show it: every number here is float64.
"""

from __future__ import annotations

from boresight.errors import RefusedInputError
from boresight.gates.evidence import Evidence
from boresight.gates.measurement import Measurement, absent, answer
from boresight.uplink import table_definition

NO_DEFINITION = "There is no table definition: an administrator or analyst adds it under the sensor's table on board."


def quantisation(evidence: Evidence) -> Measurement:
    """Measure how far directions move when the table's number format rounds the parameters."""
    if evidence.definition is None:
        return absent(NO_DEFINITION)
    parameters = dict(zip(evidence.names, map(float, evidence.x), strict=True))
    try:
        definition = table_definition.parse_definition(evidence.definition, evidence.sensor)
        held = table_definition.quantised(definition, parameters)
    except RefusedInputError as refusal:
        return answer("FAIL", f"The table on board cannot hold this set: {refusal}")
    effect = table_definition.quantisation_effect(evidence.camera, evidence.sensor, parameters, held)
    return Measurement(
        float(effect["max_px"]),
        f"The table's number format moves directions by up to {effect['max_arcsec']:.2g} arcsec over the detector.",
    )
