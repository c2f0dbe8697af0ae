"""Catalogue stars that an exposure should show and did not: projected by its attitude under the run's parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.detections import cone_rad
from boresight.calibration.frame_states import RunStates
from boresight.estimation.attitude import triad
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry

MOST_SHOWN = 60
#: A detection so near to where a star should be is taken for its image, whatever it was matched with.
NEAR_PX = 5.0


def undetected(here: Telemetry, states: RunStates, C: FloatArray, catalogue: Catalogue) -> list[dict[str, Any]]:
    """Stars within the sensor's limit that lie on the detector and have no detection near them, the brightest first.

    Parameters
    ----------
    here
        Detections of the exposure; without a time no catalogue star has a direction, and there are none.
    states
        The run's; the sensor's `magnitude_limit` is how faint stars are expected.
    C
        (3, 3) attitude, ICRS to the triad.
    """
    sensor, limit = states.sensor, states.sensor.magnitude_limit
    if here.time_utc is None or np.isnat(here.time_utc[0]) or limit is None:
        return []
    x = (states.new or states.old).x
    star = _in_the_cone(catalogue, C[2], cone_rad(sensor, x), limit)
    velocity = None if here.velocity_m_s is None else np.repeat(here.velocity_m_s[:1], len(star), axis=0)
    s_i = apparent_directions(catalogue, star, np.repeat(here.time_utc[:1], len(star)), velocity)
    row, col = CAMERA_MODELS[sensor.camera_model].project(x, triad(s_i @ C.T, sensor.parity), sensor.pixel_pitch_m)
    inside = (row >= -0.5) & (row <= sensor.rows - 0.5) & (col >= -0.5) & (col <= sensor.columns - 0.5)
    inside[inside] &= ~_near_a_detection(row[inside], col[inside], here)
    order = np.flatnonzero(inside)[np.argsort(catalogue.magnitude[star[inside]])][:MOST_SHOWN]
    return [
        {
            "star_id": int(catalogue.hip[star[k]]),
            "magnitude": float(catalogue.magnitude[star[k]]),
            "row_px": float(row[k]),
            "col_px": float(col[k]),
        }
        for k in order.tolist()
    ]


def _in_the_cone(catalogue: Catalogue, axis: FloatArray, cone: float, limit: float) -> IntArray:
    """Places in the catalogue of bright stars about an axis; a star moves less than the cone's margin since its epoch."""
    bright = np.flatnonzero(catalogue.magnitude <= limit)
    ra, dec = catalogue.ra_rad[bright], catalogue.dec_rad[bright]
    cosine = np.cos(dec) * (np.cos(ra) * axis[0] + np.sin(ra) * axis[1]) + np.sin(dec) * axis[2]
    return np.asarray(bright[cosine >= np.cos(cone)])


def _near_a_detection(row: FloatArray, col: FloatArray, here: Telemetry) -> NDArray[np.bool_]:
    """(n,) which places have a detection near them."""
    apart = np.hypot(row[:, None] - here.row_px, col[:, None] - here.col_px)
    return np.asarray(apart.min(axis=1) < NEAR_PX)
