"""Gate inputs made by hand: a sound set of a sensor, and anything that a test wants otherwise."""

from dataclasses import replace
from typing import Any

import numpy as np

from boresight.calibration.calibration import (
    Assumption,
    Calibration,
    ChiSquareTest,
    Coverage,
    InnovationTest,
    Observability,
    TrustTest,
    Values,
    WeakestDirection,
)
from boresight.calibration.trust.trust_tests import TRUST_TESTS
from boresight.simulation.sensors import st16_sensor
from boresight.verdicts.gates import GateInputs
from boresight.verdicts.gates.assessed_set import AssessedSet, ground_set, parse_assessed_set

SENSOR = st16_sensor(1)
NAMES = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")


SIGMA = 0.02 * SENSOR.typical_sigma


def a_set(**changed: Any) -> dict[str, Any]:
    sigma = SIGMA
    return {
        "sensor": SENSOR.name,
        "camera_model": SENSOR.camera_model,
        "parameters": dict(zip(NAMES, (SENSOR.initial + 5 * sigma).tolist(), strict=True)),
        "sigma": dict(zip(NAMES, sigma.tolist(), strict=True)),
        "covariance": {"names": list(NAMES), "matrix": np.diag(sigma**2).tolist()},
        "status": "converged",
    } | changed


def a_result(**changed: Any) -> Calibration:
    test: dict[str, Any] = {"dof": 1000, "lower": 0.91, "upper": 1.09, "consistent": True}
    sound = Calibration(
        status="converged",
        method="batch",
        chi2_per_dof=1.02,
        chi2=ChiSquareTest(value=1020.0, **test),
        nis=InnovationTest(mean=1.02, **test),
        observability=Observability(
            parameter_names=["n0_px", "a1_rad"],
            singular_values=[100.0, 10.0],
            condition_number=10.0,
            right_singular_vectors=[[1.0, 0.0], [0.0, 1.0]],
            sigma_of_direction=[0.01, 0.1],
            weakest=WeakestDirection(direction=Values(), sentence="n0 and a1 move together."),
        ),
        tests=[TrustTest(name=kind.name, probability=0.5, adjusted=1.0, noticed=False) for kind in TRUST_TESTS],
        coverage=Coverage(row_edges_px=[], col_edges_px=[], counts=np.ones((12, 16), int).tolist()),
        assumptions=[Assumption(name="readout", declared=True, value="global shutter", sentence="Declared.")],
    )
    return replace(sound, **changed)


def as_read(document: Any) -> AssessedSet:
    return document if isinstance(document, AssessedSet) else parse_assessed_set(document, SENSOR)


def gate_inputs(**changed: Any) -> GateInputs:
    values: dict[str, Any] = {
        "sensor": SENSOR,
        "candidate": a_set(),
        "incumbent": ground_set(SENSOR),
        "result": a_result(),
        "no_validation": "There are none.",
    }
    values |= changed
    return GateInputs(**values | {name: as_read(values[name]) for name in ("candidate", "incumbent")})
