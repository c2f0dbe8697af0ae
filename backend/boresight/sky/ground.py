"""From the ground: where the zenith is, how the observer moves, and how the air bends the stars towards the zenith.

A site's latitude, longitude and height are turned into ICRS axes at a time by precession and nutation (IAU 2006/2000A), the
Earth's rotation angle and the motion of its pole (`erfa.apco`, which is `apco13` with these given). Its velocity, 465 m/s at the
equator, is diurnal aberration: 0.3 arcsec, which goes where a satellite's velocity goes. Air moves a star at zenith distance Z,

    Z_observed = Z - (A tan Z + B tan^3 Z)                   A, B of pressure, temperature, humidity, wavelength (`erfa.refco`)

as `erfa.atioq` applies it; the direction that is observed is turned back into the axes it came from by `erfa.atoiq` without air, so
that it stands beside directions of the catalogue. Refraction is 58 arcsec at 45 degrees and 320 at 10; its common part is a
rotation, which arclengths do not see, but it shrinks the field by A = 290 ppm across the vertical and by A / cos^2 Z along it,
which is fitted as focal length, aspect and principal point where it is left out.

Accuracy: erfa states 0.06 arcsec at worst down to 15 degrees above the horizon, for the pressure and temperature that are given,
and better than 30 arcsec at 5 degrees; below 3 degrees the formula is held still.

The Earth's rotation (UT1 - UTC, up to 0.9 s) and its pole come from the tables of the IERS that `astropy-iers-data` ships, read
offline: measured up to the package's date, predicted for a year after it. Beyond the last table the last value is taken; then the
zenith may be off by some arcseconds, which moves refraction by less than 1e-8 rad. Leap seconds are those that erfa was built with.

References: Urban & Seidelmann, Explanatory Supplement to the Astronomical Almanac, 2013, section 7.4; IERS Conventions 2010.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

from boresight.arrays import DAY_US, FloatArray, IntArray, TimeArray
from boresight.errors import RefusedInputError
from boresight.estimation.blocks import in_blocks
from boresight.site import Site
from boresight.sky.apparent import (
    C_AU_DAY,
    C_M_S,
    J2000,
    JD_J2000,
    ROWS,
    apparent_directions,
    days_since_j2000,
    earth_state,
)
from boresight.sky.catalogue import Catalogue

_MJD_J2000 = 51544.5
_HOUR_DAYS = 1.0 / 24.0
_KELVIN = 273.15


def air(site: Site) -> tuple[float, float, float, float]:
    """Return pressure (hPa), temperature (deg C), humidity (0 to 1) and wavelength (um) of a site.

    A pressure that nobody gave is that of the height, by the formula that `erfa.apco13` recommends.
    """
    temperature = site.get("temperature_c")
    pressure = site.pressure_hpa
    if pressure is None:
        pressure = 1013.25 * float(np.exp(-site.get("height_m") / (29.3 * (temperature + _KELVIN))))
    return pressure, temperature, site.get("relative_humidity"), site.get("wavelength_um")


def refraction_constants(site: Site) -> tuple[float, float]:
    """Return A and B of the refraction A tan Z + B tan^3 Z above a site, rad."""
    A, B = erfa.refco(*air(site))
    return float(A), float(B)


@dataclass(frozen=True)
class EarthTables:
    """What is known of the Earth's rotation, offline.

    `mjd`: (n,) days. `ut1_minus_utc_s`, `x_rad`, `y_rad`: (n,) at these days. `measured_to`, `predicted_to`: last days of either.
    `leap_seconds_to`: until when the leap seconds known here are sure.
    """

    mjd: FloatArray
    ut1_minus_utc_s: FloatArray
    x_rad: FloatArray
    y_rad: FloatArray
    measured_to: np.datetime64
    predicted_to: np.datetime64
    leap_seconds_to: np.datetime64


@lru_cache(maxsize=1)
def earth_tables() -> EarthTables:
    """Read the tables of the IERS that are installed; half a second, once a process, and nothing is downloaded."""
    import astropy_iers_data  # noqa: PLC0415 - read on the ground only
    from astropy.utils.iers import IERS_A, LeapSeconds  # noqa: PLC0415 - slow to import, and of the ground only

    table: Any = IERS_A.open(astropy_iers_data.IERS_A_FILE)
    mjd = np.asarray(table["MJD"].value, np.float64)
    known = np.isfinite(np.asarray(table["UT1_UTC"].value, np.float64))
    leap = LeapSeconds.open(astropy_iers_data.IERS_LEAP_SECOND_FILE)
    return EarthTables(
        mjd=mjd[known],
        ut1_minus_utc_s=np.asarray(table["UT1_UTC"].to_value("s"), np.float64)[known],
        x_rad=np.asarray(table["PM_x"].to_value("rad"), np.float64)[known],
        y_rad=np.asarray(table["PM_y"].to_value("rad"), np.float64)[known],
        measured_to=_day(float(table.meta["predictive_mjd"]) - 1.0),
        predicted_to=_day(float(mjd[known][-1])),
        leap_seconds_to=np.datetime64(leap.expires.utc.isot, "D"),
    )


def _day(mjd: float) -> np.datetime64:
    return np.datetime64("1858-11-17", "D") + np.timedelta64(int(mjd), "D")


def earth_orientation(days_utc: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return UT1 - UTC (s) and the pole's x and y (rad), (n,) each, at days of UTC since J2000.0; the last ones known beyond."""
    tables, mjd = earth_tables(), days_utc + _MJD_J2000
    whole = np.floor(mjd)
    # UT1 - UTC jumps by a leap second at midnight: within a day it goes on from that day's start
    start, end = (np.interp(whole + k, tables.mjd, tables.ut1_minus_utc_s) for k in (0, 1))
    slope = end - start - np.round(end - start)
    x, y = (np.interp(mjd, tables.mjd, values) for values in (tables.x_rad, tables.y_rad))
    return start + slope * (mjd - whole), x, y


@dataclass(frozen=True)
class GroundView:
    """An observer on the ground at moments (n,).

    `astrom`: (n,) erfa's star-independent parameters without air. `zenith`: (n, 3) geodetic, ICRS axes. `velocity_m_s`: (n, 3)
    about the Earth's centre, ICRS axes. `A`, `B`: constants of refraction, rad.
    """

    astrom: NDArray[np.void]
    zenith: FloatArray
    velocity_m_s: FloatArray
    A: float
    B: float

    def direction(self, azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
        """Return the directions (n, 3), ICRS axes, of azimuths from north by east and elevations (n,), without air."""
        return _to_icrs(azimuth_rad, np.pi / 2 - elevation_rad, self.astrom)

    def select(self, place: IntArray) -> GroundView:
        """Return the views of some moments, each as often as it is named."""
        return GroundView(self.astrom[place], self.zenith[place], self.velocity_m_s[place], self.A, self.B)


def view_from(site: Site, time_utc: TimeArray) -> GroundView:
    """Say where an observer on the ground is at times (n,), and how it moves.

    Raises RefusedInputError when a time is none that UTC is defined for.
    """
    days_utc = (time_utc - J2000).astype(np.int64) / DAY_US
    try:
        with warnings.catch_warnings(action="ignore", category=erfa.ErfaWarning):  # of years without known leap seconds
            tt = erfa.taitt(*erfa.utctai(JD_J2000, days_utc))
    except erfa.ErfaError as error:
        raise RefusedInputError(
            "A camera on the ground needs times from 1960 on, in UTC: correct time_utc, or omit the site."
        ) from error
    ut1_minus_utc, pole_x, pole_y = earth_orientation(days_utc)
    theta = erfa.era00(JD_J2000, days_utc + ut1_minus_utc / 86400.0)
    position, velocity = earth_state(days_since_j2000(time_utc))
    earth = np.zeros(len(time_utc), erfa.dt_pv)
    earth["p"], earth["v"] = position, velocity
    x, y, s = _celestial_pole(tt[1])
    astrom = erfa.apco(
        *tt, earth, position, x, y, s, theta, np.radians(site.longitude_deg), np.radians(site.latitude_deg),
        site.get("height_m"), pole_x, pole_y, erfa.sp00(*tt), 0.0, 0.0,
    )  # fmt: skip
    A, B = refraction_constants(site)
    zero = np.zeros(len(time_utc))
    zenith = _to_icrs(zero, zero, astrom)
    return GroundView(astrom, zenith, (astrom["v"] - velocity / C_AU_DAY) * C_M_S, A, B)


def _celestial_pole(days_tt: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the celestial pole's x, y and the origin's s (n,) at the full hours nearest to days of TT since J2000.0.

    The pole moves by 0.02 arcsec an hour at most, and its series takes a tenth of a millisecond a time.
    """
    hours, place = np.unique(np.round(days_tt / _HOUR_DAYS), return_inverse=True)
    x, y, s = erfa.xys06a(JD_J2000, hours * _HOUR_DAYS)
    return x[place], y[place], s[place]


def _to_icrs(azimuth_rad: FloatArray, zenith_distance_rad: FloatArray, astrom: NDArray[np.void]) -> FloatArray:
    """Turn azimuths and zenith distances (n,), without air, into unit vectors (n, 3), ICRS axes."""
    ra, dec = erfa.atoiq("A", azimuth_rad, zenith_distance_rad, astrom)
    return np.asarray(erfa.trxp(astrom["bpn"], erfa.s2c(ra, dec)))


def refracted(s: FloatArray, view: GroundView) -> FloatArray:
    """Bend directions towards the zenith.

    Parameters
    ----------
    s
        (n, 3) unit vectors in ICRS axes, with aberration; NaN stays NaN.
    view
        The observer at each of them.

    Returns
    -------
    (n, 3) unit vectors as they are observed, in the same axes.
    """
    answer = np.full(s.shape, np.nan)
    known = np.flatnonzero(np.isfinite(s).all(axis=1))
    if len(known):
        here = view.select(known)
        airy = here.astrom.copy()
        airy["refa"], airy["refb"] = view.A, view.B
        ra, dec = erfa.c2s(erfa.rxp(here.astrom["bpn"], s[known]))
        azimuth, zenith_distance, *_ = erfa.atioq(ra, dec, airy)
        answer[known] = _to_icrs(azimuth, zenith_distance, here.astrom)
    return answer


def lift(s: FloatArray, zenith: FloatArray, A: float, B: float) -> FloatArray:
    """Return the vectors (n, 3) by which air moves directions s (n, 3) towards a zenith (n, 3), to first order; rad.

    For a zenith that is only supposed; directions nearer to the horizon than 3 degrees are moved as there.
    """
    along = np.einsum("ij,ij->i", s, zenith)
    high = np.maximum(along, 0.05)
    towards = zenith - along[:, None] * s
    return np.asarray((A / high + B * (1 - high**2) / high**3)[:, None] * towards)


def zeniths_from(places: FloatArray, time_utc: TimeArray) -> FloatArray:
    """Return the zeniths (n, n_places, 3), ICRS axes, of places on Earth (n_places, 3), unit vectors, at times (n,).

    For places that are only supposed: the pole stands where it stood in 2000, within half a degree for sixty years, and UT1 is UTC.
    """
    angle = erfa.era00(JD_J2000, (time_utc - J2000).astype(np.int64) / DAY_US)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y, z = places.T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, np.broadcast_to(z, (len(angle), len(z)))], axis=-1)


def refracted_at(s: FloatArray, site: Site, time_utc: TimeArray) -> FloatArray:
    """Bend directions (n, 3), ICRS axes, by the air above a site at times (n,); NaN where either is absent."""
    answer = np.full(s.shape, np.nan)
    rows = np.flatnonzero(np.isfinite(s).all(axis=1) & ~np.isnat(time_utc))
    if not len(rows):
        return answer
    moments, place = np.unique(time_utc[rows].astype("datetime64[us]"), return_inverse=True)
    view = view_from(site, moments)

    def bend(first: int, last: int) -> None:
        answer[rows[first:last]] = refracted(s[rows[first:last]], view.select(place[first:last]))

    in_blocks(bend, len(rows), ROWS)
    return answer


def observed_directions(
    catalogue: Catalogue,
    index: IntArray,
    time_utc: TimeArray,
    velocity_m_s: FloatArray | None,
    site: Site | None,
) -> FloatArray:
    """Return where stars are seen, (n, 3): as `apparent_directions` in space, and from a site with its velocity and its air."""
    if site is None:
        return apparent_directions(catalogue, index, time_utc, velocity_m_s)
    velocity = velocity_at(site, time_utc) if velocity_m_s is None else velocity_m_s
    return refracted_at(apparent_directions(catalogue, index, time_utc, velocity), site, time_utc)


def velocity_at(site: Site, time_utc: TimeArray) -> FloatArray:
    """Return the velocity of a site about the Earth's centre at times (n,), (n, 3) m/s, ICRS axes; NaN where a time is absent."""
    velocity = np.full((len(time_utc), 3), np.nan)
    moments, place = np.unique(time_utc.astype("datetime64[us]"), return_inverse=True)
    known = ~np.isnat(moments)
    if known.any():
        at_moments = np.full((len(moments), 3), np.nan)
        at_moments[known] = view_from(site, moments[known]).velocity_m_s
        velocity = at_moments[place]
    return velocity


def elevation_deg(s: FloatArray, site: Site, time_utc: TimeArray) -> FloatArray:
    """Return how far directions (n, 3), ICRS axes, stand above the horizon of a site at times (n,), degrees; NaN where unknown."""
    answer = np.full(len(s), np.nan)
    rows = np.flatnonzero(np.isfinite(s).all(axis=1) & ~np.isnat(time_utc))
    moments, place = np.unique(time_utc[rows].astype("datetime64[us]"), return_inverse=True)
    if len(rows):
        zenith = view_from(site, moments).zenith[place]
        answer[rows] = np.degrees(np.arcsin(np.clip(np.einsum("ij,ij->i", zenith, s[rows]), -1.0, 1.0)))
    return answer
