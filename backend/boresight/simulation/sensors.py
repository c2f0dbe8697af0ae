"""The Sinclair ST-16 as published, six of them as the demo fleet, and the sensor of Wu et al. 2019.

Detector: 1944 rows by 2592 columns of 2.2 um behind a 16 mm lens, so 20.2 by 15.2 deg. E Table II gives the fleet's
mean and unit-to-unit spread of each parameter; its principal point (972, 1296) is half the detector: row, column.

Ground calibration and truth
----------------------------
E Table III lists only *changes*: the on-orbit minus the ground value, in typical sigmas, for six sensors. The absolute
values are published for one of them: Table VII, sensor 2, batch, f = 16.031 mm, b_2 = -2.152e3, b_4 = 1.370e8. Then

    ground = on orbit - change * sigma_p:   f = 16.031 mm + 8.04 * 8 um   = 16 mm + 95 um
                                            b_2 = -2.152e3 + 1.17e3       = -1.0e3 per m2
                                            b_4 = 1.370e8 - 1.41e8        = 0 within rounding

We give all six sensors this one ground calibration, nominal in the other parameters, and the truth

    x_true = x_ground + change * sigma_p.

Odd things, kept as they are published: Table II prints b_4 and b_2 without units (only m^-4 and m^-2 give the paper's
condition numbers, erratum); sensors 2, 4 and 6 move n_0 by 240 to 290 px, so their principal points lie far off the
centre; sensor 2's published initial RMS (333 urad) is a third of what these numbers give (about 1200).

Centroid noise
--------------
The error of an arc has the variance of its two ends (Eq 16), sigma_phi^2 = 2 sigma^2, and a pixel is Delta / f radians:

    sigma_phi = sqrt(2) * 0.437 px * 2.2 um / 16.095 mm = 84.5 urad,

the middle of the final RMS column of E Table IV (62 to 123 urad); so 0.437 px one-axis is the default.

Wu's sensor
-----------
1080 rows by 1920 columns of 2.9 um behind 16 mm, `pinhole_radial`; W Table 1 is the truth and the typical sigma, W 4.1 Test 1 the
start. The start is 5,000 typical sigmas of f away: a filter from there needs a covariance of its own. 0.5 px is the stated
centroid noise, 0.2 px what its tables imply (erratum). Its frame is right-handed as W draws it, so D is left-handed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from boresight.arrays import FloatArray
from boresight.cameras import CAMERA_MODELS
from boresight.errors import NotFoundError
from boresight.telemetry.declarations import GLOBAL, ROLLING, Declared, Readout
from boresight.telemetry.sensors import Sensor

ST16_ROWS, ST16_COLUMNS = 1944, 2592
ST16_PIXEL_PITCH_M = 2.2e-6
ST16_CENTROID_SIGMA_PX = 0.437
ST16_MAGNITUDE_LIMIT = 5.5

CAMERA_MODEL = "inverted_wang"

# E Table II, in the order f m0 n0 b4 b2 a1 a2 g_y
NOMINAL = np.array([0.016, 972.0, 1296.0, 0.0, 0.0, 0.0, 0.0, 1.0])
TYPICAL_SIGMA = np.array([8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4])

# nominal plus what Table VII minus Table III implies for f and b2
GROUND = NOMINAL + np.array([95e-6, 0.0, 0.0, 0.0, -1e3, 0.0, 0.0, 0.0])

# E Table III: one row a sensor, in typical sigmas
CHANGES = np.array(
    [
        [-8.54, 1.34, 1.68, 1.04, -1.03, 0.51, 0.15, 3.76],
        [-8.04, 0.71, -8.37, 1.41, -1.17, -4.96, 0.47, 5.14],
        [-8.17, 1.12, 1.61, 1.37, -1.22, 1.02, 0.41, 3.05],
        [-9.46, 0.39, 8.08, 0.67, -0.90, 3.58, -0.10, 2.97],
        [0.08, -2.59, 4.00, -0.10, 0.09, 2.34, -1.52, 0.36],
        [-0.46, 3.16, -9.81, 0.44, -0.60, -4.93, 1.94, -1.30],
    ]
)

WU_ROWS, WU_COLUMNS = 1080, 1920
WU_PIXEL_PITCH_M = 2.9e-6
WU_MAGNITUDE_LIMIT = 5.5
WU_STATED_SIGMA_PX, WU_IMPLIED_SIGMA_PX = 0.5, 0.2
WU_CAMERA_MODEL = "pinhole_radial"

# W Table 1 and W 4.1, in the order s f u0 v0 k1 k2
WU_TRUTH = np.array([1.0, 0.016, 970.0, 550.0, -0.5, 0.5])
WU_TYPICAL_SIGMA = np.array([1e-5, 1e-7, 1.0, 1.0, 1e-2, 1e-1])
WU_START = np.array([1.0, 0.0155, 960.0, 540.0, 0.0, 0.0])

#: What telemetry from orbit with its velocity declares; the ST-16 has a rolling shutter, and its centroids are corrected for it.
IN_SPACE = Declared(
    satellite_velocity="given", directions="apparent", refraction="none", decentring="centred", centroids="unbiased"
)

SENSOR_NUMBERS = tuple(range(1, len(CHANGES) + 1))


def st16_sensor(number: int) -> Sensor:
    """Describe sensor 1 to 6 of E Table I as its ground calibration does; all eight parameters free, parity +1.

    Raises NotFoundError when there is no such sensor.
    """
    _require_number(number)
    return Sensor(
        name=f"ST16-{number}",
        rows=ST16_ROWS,
        columns=ST16_COLUMNS,
        pixel_pitch_m=ST16_PIXEL_PITCH_M,
        camera_model=CAMERA_MODEL,
        parity=1,
        centroid_sigma_px=ST16_CENTROID_SIGMA_PX,
        initial=GROUND.copy(),
        typical_sigma=TYPICAL_SIGMA.copy(),
        free=CAMERA_MODELS[CAMERA_MODEL].parameter_names,
        magnitude_limit=ST16_MAGNITUDE_LIMIT,
        readout=Readout(ROLLING, corrected=True),
        declared=IN_SPACE,
    )


def wu_sensor(centroid_sigma_px: float = WU_IMPLIED_SIGMA_PX) -> Sensor:
    """Describe the sensor of W 4.1 as its printed start does; all six parameters free."""
    return Sensor(
        name="Wu 2019",
        rows=WU_ROWS,
        columns=WU_COLUMNS,
        pixel_pitch_m=WU_PIXEL_PITCH_M,
        camera_model=WU_CAMERA_MODEL,
        parity=-1,
        centroid_sigma_px=centroid_sigma_px,
        initial=WU_START.copy(),
        typical_sigma=WU_TYPICAL_SIGMA.copy(),
        free=CAMERA_MODELS[WU_CAMERA_MODEL].parameter_names,
        magnitude_limit=WU_MAGNITUDE_LIMIT,
        readout=Readout(GLOBAL),
        declared=replace(IN_SPACE, tilt="aligned"),
    )


def st16_truth(number: int) -> FloatArray:
    """Return the true parameters (8,) of sensor 1 to 6, SI, in state order: ground plus E Table III.

    Raises NotFoundError when there is no such sensor.
    """
    _require_number(number)
    truth: FloatArray = GROUND + CHANGES[number - 1] * TYPICAL_SIGMA
    return truth


def _require_number(number: int) -> None:
    if number not in SENSOR_NUMBERS:
        raise NotFoundError(f"There is no simulated ST-16 number {number}; choose 1 to {len(CHANGES)}.")
