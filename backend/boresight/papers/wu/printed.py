"""The printed numbers of W Tables 2 to 4, as they stand in the paper (doi 10.3390/s19153301).

The paper repeats its Model 4 {2, 3} in all three tables and its angular distances (AD) in Table 4 alone. Criterion columns are mean
and standard deviation over the last 100 images; W Table 1, the truth, stands in `simulation.sensors`.
"""

from __future__ import annotations

from math import atan, degrees

MODELS = (1, 2, 3, 4)
SUBSETS = ((1, 2, 3), (2, 3), (1, 2), (1, 3), (1,), (2,), (3,))
#: Limiting magnitudes of groups 1 to 3, and the mean number of stars of an image.
GROUPS = {6.0: 31.4, 5.5: 19.1, 4.6: 7.7}

#: Error of each parameter by Model 1 to 4, per cent of its truth.
TABLE_2 = {
    "s": (-0.0032, 0.0005, -0.0012, 0.0024),
    "f_m": (0.0044, 0.0044, 0.0050, 0.0044),
    "u0_px": (-2.6354, 0.1126, -0.0599, -0.2159),
    "v0_px": (0.9508, -0.1315, 0.0940, -0.6011),
    "k1": (-0.4379, 1.1205, 0.8043, 1.0729),
    "k2": (-47.4027, 32.7026, 15.7377, 25.0508),
}
TABLE_2_A = {"mean": (0.852, 1.106, 4.392, 0.465), "deviation": (0.029, 0.060, 0.022, 0.038)}

#: By `SUBSETS`: arcseconds, and milliseconds a frame.
TABLE_3_A = {
    "mean": (0.472, 0.465, 0.701, 2.127, 3.383, 0.384, 2.246),
    "deviation": (0.029, 0.038, 0.028, 0.066, 0.096, 0.058, 0.065),
}
TABLE_3_TIME = (8.28, 6.88, 6.92, 6.88, 5.8, 5.88, 5.76)

#: By `GROUPS`, AD and SVD of each: arcseconds, and milliseconds a frame.
TABLE_4 = {
    ("A", "mean"): (0.535, 0.436, 0.419, 0.465, 0.344, 0.244),
    ("A", "deviation"): (0.293, 0.039, 0.073, 0.038, 0.004, 0.003),
    ("B", "mean"): (10.824, 10.854, 10.608, 10.630, 10.611, 10.612),
    ("B", "deviation"): (0.879, 0.888, 1.295, 1.304, 2.569, 2.565),
}
TABLE_4_TIME = (260.12, 14.36, 31.12, 6.88, 4.68, 2.76)

#: The field experiment of 4.2: criterion B in arcseconds, stars of an image, and images until the estimates rest.
FIELD = {"B mean": 8.33, "B deviation": 0.803, "stars": 14.7, "images": 2200.0}
#: Images that “could ensure the convergence” of a simulation (4.1).
IMAGES = 2400.0
#: Time that SVD saves in group 1, per cent (4.1, Test 3).
SAVING_PERCENT = 94.48


def time_ratios() -> tuple[float, ...]:
    """How many times longer AD takes than SVD in each group of Table 4: 18.1, 4.5, 1.7."""
    return tuple(ad / svd for ad, svd in zip(TABLE_4_TIME[::2], TABLE_4_TIME[1::2], strict=True))


def stated_angle_deg(columns: int, pitch_m: float, f_m: float) -> float:
    """Width of a distortion-free field, which W 4.1 prints as 19.14 degrees."""
    return degrees(2 * atan(columns * pitch_m / (2 * f_m)))
