"""The camera models in words and formulas, for whoever reads the numbers without this program.

A set of numbers is no camera: the same eight values mean another direction under another order of operations, pixel origin or
sense of the distortion. So every `parameters.json` says how a pixel becomes a direction.
"""

from __future__ import annotations

from typing import Any

from boresight.telemetry.sensors import Sensor

EQUATIONS: dict[str, dict[str, Any]] = {
    "inverted_wang": {
        "runs": "from a detector position to a direction, without iteration",
        "source": "Enright, Jovanovic, Vaz 2018, doi:10.1109/JSEN.2018.2857621, Eqs 1-7",
        "steps": [
            "u = pitch (row - m0)",
            "v = g_y pitch (column - n0)",
            "U = u f / (a1 v + a2 u + f)",
            "V = v f / (a1 v + a2 u + f)",
            "rho^2 = U^2 + V^2",
            "B = 1 + b2 rho^2 + b4 rho^4",
            "s = (B U, B V, f) / |(B U, B V, f)|",
        ],
        "inverse": "solve rho (1 + b2 rho^2 + b4 rho^4) = f |(s_x, s_y)| / s_z on the branch through zero, then u and v linearly",
    },
    "pinhole_radial": {
        "runs": "from a direction to a detector position; its inverse needs an iteration",
        "source": "Wu et al. 2019, Sensors 19, Eqs 1-8, with the distortion radial about the principal point (Eq 6 corrected)",
        "steps": [
            "t_x = s_x / s_z",
            "t_y = s_y / s_z",
            "r^2 = t_x^2 + t_y^2",
            "B = 1 + k1 r^2 + k2 r^4",
            "row = v0 + t_x B f / (s pitch)",
            "column = u0 + t_y B f / pitch",
        ],
        "inverse": "solve r (1 + k1 r^2 + k2 r^4) = R on the branch through zero, R = pitch |(s (row - v0), column - u0)| / f",
    },
}


def conventions(sensor: Sensor) -> dict[str, Any]:
    """Say what axes, pixels and units are."""
    hand = "right" if sensor.parity == 1 else "left"
    return {
        "axes": "s is a unit vector in the detector frame D: x along increasing rows, y along increasing columns, "
        "z out along the boresight",
        "parity": sensor.parity,
        "handedness": f"(rows, columns, boresight) is a {hand}-handed triad"
        + ("" if sensor.parity == 1 else "; (x, y, z) of D stands for the right-handed vector (x, -y, z)"),
        "pixel_origin": "the centre of the top-left pixel is row 0, column 0; rows count down, columns to the right",
        "angles": "radians",
        "quaternions": "x, y, z, w; scalar last",
        "sigma": "one standard deviation; null where it was not estimated",
        "numbers": "IEEE 754 double precision, written in the fewest digits that read back as the same number",
    }
