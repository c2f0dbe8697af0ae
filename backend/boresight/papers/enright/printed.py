"""The printed numbers of E Tables I to VII, as they stand in the paper, and the arithmetic on them that its text gets wrong.

Doi 10.1109/JSEN.2018.2857621. Columns are the paper's; units are those of the print. Table III is also the simulated truth
(`simulation.sensors`), so that what is made again is the estimation, not the sensors' own change.
"""

from __future__ import annotations

SENSORS = (1, 2, 3, 4, 5, 6)

#: Altitude (km), inclination (deg), motion and sample period (s), the same for both sets of a sensor.
TABLE_I = {
    1: (570.0, 97.8, "nadir pointing", 40.0),
    2: (570.0, 97.8, "nadir pointing", 40.0),
    3: (620.0, 98.4, "nadir pointing", 40.0),
    4: (620.0, 98.4, "nadir pointing", 40.0),
    5: (730.0, 97.7, "slew", 10.0),
    6: (670.0, 98.0, "coarse hold and slew", 10.0),
}

#: Mean and typical sigma in SI: f m, m0 n0 px, b4 m^-4, b2 m^-2, a1 a2 rad, g_y.
TABLE_II = {
    "f_m": (16e-3, 8e-6),
    "m0_px": (972.0, 30.0),
    "n0_px": (1296.0, 30.0),
    "b4_per_m4": (0.0, 1e8),
    "b2_per_m2": (0.0, 1e3),
    "a1_rad": (0.0, 0.01),
    "a2_rad": (0.0, 0.01),
    "g_y": (1.0, 2e-4),
}

#: Change of each parameter by the batch, sensors 1 to 6, in typical sigmas.
TABLE_III = {
    "f_m": (-8.54, -8.04, -8.17, -9.46, 0.08, -0.46),
    "m0_px": (1.34, 0.71, 1.12, 0.39, -2.59, 3.16),
    "n0_px": (1.68, -8.37, 1.61, 8.08, 4.00, -9.81),
    "b4_per_m4": (1.04, 1.41, 1.37, 0.67, -0.10, 0.44),
    "b2_per_m2": (-1.03, -1.17, -1.22, -0.90, 0.09, -0.60),
    "a1_rad": (0.51, -4.96, 1.02, 3.58, 2.34, -4.93),
    "a2_rad": (0.15, 0.47, 0.41, -0.10, -1.52, 1.94),
    "g_y": (3.76, 5.14, 3.05, 2.97, 0.36, -1.30),
}

#: Availability initial and final, matched star ratio, RMS arc error initial and final (urad), on the calibration set.
TABLE_IV = {
    1: (0.96, 1.00, 1.55, 422.6, 80.3),
    2: (0.98, 1.00, 1.20, 332.7, 91.4),
    3: (0.44, 0.98, 2.46, 377.0, 89.9),
    4: (0.46, 1.00, 2.70, 412.9, 95.6),
    5: (1.00, 1.00, 1.00, 83.0, 62.2),
    6: (0.93, 0.97, 1.04, 248.3, 123.1),
}

ESTIMATORS = ("batch", "q", "no-q", "no-refit")

#: RMS arc error on the validation set (urad): raw, then `ESTIMATORS`; 1R is sensor 1 with f, m0 and n0 only.
TABLE_V = {
    "1": (385.3, 101.8, 108.0, 98.9, 93.5),
    "1R": (385.3, 175.6, 132.3, 114.0, 103.3),
    "2": (316.9, 106.8, 118.9, 106.4, 102.1),
    "3": (402.1, 86.2, 85.8, 85.0, 90.0),
    "4": (415.1, 104.2, 103.6, 105.0, 111.5),
    "5": (71.3, 52.9, 59.7, 59.0, 59.2),
    "6": (247.4, 174.1, 164.3, 167.5, 201.6),
}

#: Matched star ratio, then availability, each by `ESTIMATORS`, on the validation set.
TABLE_VI = {
    1: (1.41, 1.41, 1.41, 1.41, 1.00, 1.00, 1.00, 1.00),
    2: (1.16, 1.16, 1.16, 1.16, 0.95, 0.95, 0.95, 0.95),
    3: (0.98, 0.99, 1.01, 0.97, 0.95, 0.95, 0.95, 0.95),
    4: (1.01, 1.01, 1.02, 0.88, 0.94, 0.94, 0.94, 0.91),
    5: (1.00, 1.00, 1.00, 1.00, 1.00, 1.00, 1.00, 1.00),
    6: (1.01, 0.99, 0.99, 0.99, 0.85, 0.85, 0.85, 0.85),
}

#: Distortion of sensor 2 by `ESTIMATORS`: f in mm, b4 in 1e8 m^-4, b2 in 1e3 m^-2.
TABLE_VII = {
    "f_m": (16.031, 16.035, 16.039, 16.035),
    "b4_per_m4": (1.370, 0.583, 0.320, 1.374),
    "b2_per_m2": (-2.152, -1.771, -1.662, -2.144),
}
TABLE_VII_UNITS = {"f_m": (1e-3, "mm"), "b4_per_m4": (1e8, "10⁸ m⁻⁴"), "b2_per_m2": (1e3, "10³ m⁻²")}

#: What the text says of the condition number of the scaled Jacobian (II-C), and of the reduced model's excess (III-B).
CONDITION_NUMBERS = (120.0, 150.0)
UNSCALED_CONDITION = 1e14
REDUCED_EXCESS = (0.05, 0.13)
#: By how much errors fall, per cent: abstract, III-A (“most are better than”), and IV (“typically”).
FALLS, MOST_FALL, TYPICAL_FALLS = (20.0, 80.0), 70.0, (30.0, 70.0)
#: Cycles of fitting and matching after which little changes (II-C).
CYCLES = (2.0, 3.0)


def reduced_excess() -> dict[str, float]:
    """Share by which Table V's reduced model (1R) exceeds the full one (1), by estimator."""
    return {
        name: reduced / full - 1
        for name, full, reduced in zip(ESTIMATORS, TABLE_V["1"][1:], TABLE_V["1R"][1:], strict=True)
    }


def no_refit_rank() -> dict[str, list[int]]:
    """Sensors for which No-Refit is the worst, and the best, of the three sequential estimators in Table V."""
    sequential = {sensor: TABLE_V[str(sensor)][2:] for sensor in SENSORS}
    return {
        "worst": [sensor for sensor, errors in sequential.items() if errors[2] == max(errors)],
        "best": [sensor for sensor, errors in sequential.items() if errors[2] == min(errors)],
    }


def same_sign(first: str, second: str) -> list[int]:
    """Sensors whose two parameters move in the same direction in Table III."""
    pairs = zip(SENSORS, TABLE_III[first], TABLE_III[second], strict=True)
    return [sensor for sensor, a, b in pairs if a * b > 0]
