"""The attitudes that a matched telemetry set has, exposure by exposure, with what undoes the aberration of its directions."""

from __future__ import annotations

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.exports.export import ExposureAttitude
from boresight.calibration.matching.rematch import Matches
from boresight.sky.apparent import C_AU_DAY, C_M_S, days_since_j2000, earth_state
from boresight.telemetry.schema import Telemetry


def list_attitudes(telemetry: Telemetry, matches: Matches) -> list[ExposureAttitude]:
    """List the exposures that have an attitude, in file order. `telemetry`: the rows that were matched."""
    usable = np.flatnonzero(matches.valid & np.isfinite(matches.quaternion).all(axis=-1))
    velocity = _velocities(telemetry, matches, usable)
    matched = matches.matched
    return [
        ExposureAttitude(
            frame=int(matches.frame[k]),
            exposure=int(matches.exposure[k]),
            stars=int(matched[k]),
            quaternion=matches.quaternion[k],
            covariance=matches.attitude_covariance[k],
            time_utc=_time(telemetry, int(matches.exposure_start[k])),
            velocity_c=v if np.isfinite(v).all() else None,
        )
        for k, v in zip(usable.tolist(), velocity, strict=True)
    ]


def _time(telemetry: Telemetry, row: int) -> str | None:
    """Time of a row, ISO 8601 to the microsecond."""
    if telemetry.time_utc is None or np.isnat(telemetry.time_utc[row]):
        return None
    return str(telemetry.time_utc[row].astype("datetime64[us]"))


def _velocities(telemetry: Telemetry, matches: Matches, usable: np.ndarray) -> FloatArray:
    """Velocity (n_usable, 3) of the observer, ICRS axes, units of c; NaN where no time tells it."""
    velocity = np.full((len(usable), 3), np.nan)
    if telemetry.time_utc is None:
        return velocity
    rows = matches.exposure_start[usable]
    known = np.flatnonzero(~np.isnat(telemetry.time_utc[rows]))
    if not len(known):
        return velocity
    _, earth_au_day = earth_state(days_since_j2000(telemetry.time_utc[rows[known]]))
    satellite = 0.0 if telemetry.velocity_m_s is None else telemetry.velocity_m_s[rows[known]] / C_M_S
    velocity[known] = earth_au_day / C_AU_DAY + satellite
    return velocity
