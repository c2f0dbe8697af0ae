"""Gates: what a parameter set must show before people may sign it, measured and judged apart."""

from __future__ import annotations

from boresight.verdicts.gates.assessed_set import AssessedSet
from boresight.verdicts.gates.judgement import (
    BoundGateReport,
    BoundHashes,
    BoundInput,
    GateAnswer,
    GateReport,
    HeldOut,
    judge,
    name_inputs,
    parse_bound_report,
    parse_held_out,
    parse_report,
    read_measurements,
    summarise,
    words,
)
from boresight.verdicts.gates.measurements import GATES, Gate, GateInputs, Measurement, ValidationScores, measure
from boresight.verdicts.gates.profile import DEFAULT_PROFILE, Profile, Threshold, parse_profile

__all__ = [
    "DEFAULT_PROFILE",
    "GATES",
    "AssessedSet",
    "BoundGateReport",
    "BoundHashes",
    "BoundInput",
    "Gate",
    "GateAnswer",
    "GateInputs",
    "GateReport",
    "HeldOut",
    "Measurement",
    "Profile",
    "Threshold",
    "ValidationScores",
    "judge",
    "measure",
    "name_inputs",
    "parse_bound_report",
    "parse_held_out",
    "parse_profile",
    "parse_report",
    "read_measurements",
    "summarise",
    "words",
]
