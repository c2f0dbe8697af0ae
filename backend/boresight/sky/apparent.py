"""From the catalogue's epoch to what a moving tracker sees.

With p the direction at the epoch, m the proper motion, w the parallax and E the Earth's barycentric position in au,

    s = unit(p + t m - w E),    t = years since J1991.25 plus the light time p.E / c           (`erfa.pmpx`)

and the observer's velocity v, in units of c, Earth's plus the satellite's, turns it towards v:

    s' = unit(s / g + (1 + s.v / (1 + 1/g)) v),    1/g = sqrt(1 - v^2)                           (`erfa.ab`)

Aberration is 20.5 arcsec for the Earth and 5 for a low orbit. Its common part is a rotation, which arclengths do not
see; its gradient stretches the field by 1e-4, and left out it would be fitted as focal length and distortion.

Traps of the two routines: `pmpx` wants the motion in right ascension *without* cos(declination), the parallax in
arcseconds, and the epoch difference in Julian years; `ab` wants the direction before the velocity in units of c.

Left out, each below 0.02 arcsec for the stars used: light deflection by the Sun beyond 30 degrees from it, radial
velocity (perspective acceleration), the satellite's own place in the parallax.

Reference: Urban & Seidelmann, Explanatory Supplement to the Astronomical Almanac, 2013, sections 7.2 and 7.40.

Where the Earth is and how fast it moves, at very many times.

`erfa.epv00` sums the series of VSOP2000 in 20 us a time: a second for the forty thousand times of a long telemetry
set. The Earth moves so smoothly that its state at a time t is found from nodes a quarter of a day apart,

    y(t) = sum_k L_k(s) y(T_k),   T_k = (floor(t / h) + k) h,   k = -1, 0, 1, 2,   s = t / h - floor(t / h),

with the cubic Lagrange polynomials L_k. The error is h^4 y''''(t) 3/128 at most: the Moon (27.3 days, 13 m/s) makes it
3 micrometres a second, which is 1e-14 rad of aberration.

Times are UTC; the series wants TDB. TDB - UTC is taken as 69.184 s, right since 2017 and within 27 s since 1972. The
Earth's acceleration is 6 mm/s^2, so that the worst case is 0.16 m/s: 5e-10 rad, a ten-thousandth of an arcsecond.
"""

from __future__ import annotations

import erfa
import numpy as np
from numpy.typing import NDArray

from boresight.arrays import ARCSEC_PER_RAD, DAY_US, FloatArray, IntArray
from boresight.estimation.blocks import in_blocks
from boresight.sky.catalogue import Catalogue

J2000 = np.datetime64("2000-01-01T12:00:00", "us")
JD_J2000 = 2451545.0
_TDB_MINUS_UTC_DAYS = 69.184 / 86400.0
_STEP_DAYS = 0.25


def days_since_j2000(time_utc: NDArray[np.datetime64]) -> FloatArray:
    """Return (n,) days of TDB since J2000.0 for (n,) UTC times."""
    return (time_utc - J2000).astype(np.int64) / DAY_US + _TDB_MINUS_UTC_DAYS


def earth_state(days: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Earth's barycentric position and velocity.

    Parameters
    ----------
    days
        (n,) days of TDB since J2000.0, between the years 1900 and 2100.

    Returns
    -------
    position_au, velocity_au_day
        (n, 3) each, ICRS axes.
    """
    cell = np.floor(days / _STEP_DAYS).astype(np.int64)
    nodes = np.unique(np.unique(cell)[:, None] + np.arange(-1, 3))
    _, barycentric = erfa.epv00(JD_J2000, nodes * _STEP_DAYS)
    first = np.searchsorted(nodes, cell - 1)
    weights = _cubic_weights(days / _STEP_DAYS - cell)
    position = sum(w[:, None] * barycentric["p"][first + k] for k, w in enumerate(weights))
    velocity = sum(w[:, None] * barycentric["v"][first + k] for k, w in enumerate(weights))
    return np.asarray(position), np.asarray(velocity)


def _cubic_weights(s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the four Lagrange polynomials of the nodes -1, 0, 1, 2 at (n,) places 0 <= s < 1."""
    return (
        -s * (s - 1) * (s - 2) / 6,
        (s + 1) * (s - 1) * (s - 2) / 2,
        -(s + 1) * s * (s - 2) / 2,
        (s + 1) * s * (s - 1) / 6,
    )


J1991_25_DAYS = 2448349.0625 - 2451545.0
DAYS_PER_YEAR = 365.25
C_AU_DAY = 173.1446326846693
C_M_S = 299792458.0
#: Directions found at a time: few enough to stay in the processor's cache, many enough to be worth a thread.
ROWS = 16_384


def apparent_directions(
    catalogue: Catalogue,
    index: IntArray,
    time_utc: NDArray[np.datetime64],
    velocity_m_s: FloatArray | None,
) -> FloatArray:
    """Return the directions in which stars are seen.

    Parameters
    ----------
    catalogue
        The stars.
    index
        (n,) positions in the catalogue, -1 for none.
    time_utc
        (n,) datetime64[us].
    velocity_m_s
        (n, 3) the satellite's velocity, GCRS; None = that of the Earth's centre.

    Returns
    -------
    (n, 3) unit vectors in ICRS axes; NaN where the index is -1, the time is NaT or the velocity is NaN.
    """
    directions = np.full((len(index), 3), np.nan)
    known = np.flatnonzero((index >= 0) & ~np.isnat(time_utc))

    def see(first: int, last: int) -> None:
        rows = known[first:last]
        velocity = None if velocity_m_s is None else velocity_m_s[rows]
        directions[rows] = _seen(catalogue, index[rows], time_utc[rows], velocity)

    in_blocks(see, len(known), ROWS)
    return directions


def _seen(
    catalogue: Catalogue, star: IntArray, time_utc: NDArray[np.datetime64], velocity_m_s: FloatArray | None
) -> FloatArray:
    """Return (n, 3) apparent directions of (n,) catalogue stars."""
    motion = (catalogue.pm_ra_cosdec_rad_yr[star], catalogue.pm_dec_rad_yr[star])
    return _moved_and_aberrated(
        catalogue.ra_rad[star], catalogue.dec_rad[star], motion, catalogue.parallax_rad[star], J1991_25_DAYS,
        time_utc, velocity_m_s,
    )  # fmt: skip


def _moved_and_aberrated(
    ra_rad: FloatArray,
    dec_rad: FloatArray,
    motion_rad_yr: tuple[FloatArray, FloatArray],
    parallax_rad: FloatArray,
    epoch_days: float,
    time_utc: NDArray[np.datetime64],
    velocity_m_s: FloatArray | None,
) -> FloatArray:
    """Return (n, 3) apparent directions of places (n,) at an epoch, days since J2000.0.

    The Earth is asked once for every distinct time.
    """
    moments, moment_of_row = np.unique(time_utc.astype("datetime64[us]"), return_inverse=True)
    days = days_since_j2000(moments)
    position_au, velocity_au_day = earth_state(days)
    years = (days - epoch_days) / DAYS_PER_YEAR
    s = erfa.pmpx(
        ra_rad,
        dec_rad,
        motion_rad_yr[0] / np.cos(dec_rad),
        motion_rad_yr[1],
        parallax_rad * ARCSEC_PER_RAD,
        0.0,
        years[moment_of_row],
        position_au[moment_of_row],
    )
    v = velocity_au_day[moment_of_row] / C_AU_DAY
    if velocity_m_s is not None:
        v = v + velocity_m_s / C_M_S
    return aberrated(s, v)


def apparent_from_j2000(
    ra_rad: FloatArray,
    dec_rad: FloatArray,
    catalogue: Catalogue,
    index: IntArray,
    time_utc: NDArray[np.datetime64],
    velocity_m_s: FloatArray | None,
) -> FloatArray:
    """Return the directions in which stars are seen whose places a file gives at epoch J2000.0.

    Parameters
    ----------
    ra_rad, dec_rad
        (n,) barycentric place at J2000.0, ICRS.
    catalogue, index
        Where proper motion and parallax come from: (n,) positions in the catalogue, -1 for a star that it does not have, which is
        then taken to rest and to be far.
    time_utc, velocity_m_s
        As in `apparent_directions`.

    Returns
    -------
    (n, 3) unit vectors in ICRS axes; NaN where the place, the time or the velocity is absent.
    """
    directions = np.full((len(index), 3), np.nan)
    rows = np.flatnonzero(np.isfinite(ra_rad) & ~np.isnat(time_utc))
    star, known = np.maximum(index[rows], 0), index[rows] >= 0

    def take(values: FloatArray) -> FloatArray:
        return np.where(known, values[star], 0.0) if len(values) else np.zeros(len(rows))

    velocity = None if velocity_m_s is None else velocity_m_s[rows]
    motion = (take(catalogue.pm_ra_cosdec_rad_yr), take(catalogue.pm_dec_rad_yr))
    directions[rows] = _moved_and_aberrated(
        ra_rad[rows], dec_rad[rows], motion, take(catalogue.parallax_rad), 0.0, time_utc[rows], velocity
    )
    return directions


def aberrated(s: FloatArray, v: FloatArray) -> FloatArray:
    """Turn directions towards the observer's velocity.

    Parameters
    ----------
    s
        (n, 3) unit vectors as an observer at rest sees them.
    v
        (n, 3) or (3,) the observer's velocity in units of c.

    Returns
    -------
    (n, 3) unit vectors. The Sun's potential (0.4 microarcseconds) is taken at 1 au.
    """
    inverse_lorentz = np.sqrt(1.0 - np.sum(v * v, axis=-1))
    return np.asarray(erfa.ab(s, v, 1.0, inverse_lorentz))
