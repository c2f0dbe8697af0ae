"""The stars a tracker may match with, and where its observer is and how it moves: what the matching loops need of the sky.

The loops take a star's apparent direction from its place, proper motion and parallax at the epoch by the same formula
as `sky.apparent`,

    s = unit(p + t m - w E),    then aberration by v,

with p, m Cartesian and t in Julian years since J1991.25 (the light time, minutes, is left out: below 1e-9 rad a star).
Of two stars that one image would swallow, closer than a few pixels, only the brighter can be matched.

Stars to be careful with: doubles that one image blends, and stars whose catalogue place may not be where they are.

Two stars nearer than the blend radius make one image, with its centroid between them by brightness. A companion m magnitudes
fainter, at separation d, pulls it by d / (1 + 10^(0.4 m)): beyond `FAINTER_MAG` = 3 by less than d / 16, and the star is left in
peace. The brighter of a pair is flagged only by a companion that close in brightness, the fainter always.

Where the width of a star's image is known more can be said. A centroid under a Gaussian window of the width s of the image itself
rests, to first order in a neighbour's flux G beside its own F, at

    pull = (G / F) d exp(-d^2 / 4 s^2)

from its star towards the neighbour at distance d, which counts from nothing (they melt into one) to some 6 s (they stand apart). A
star that is drawn by more than `LARGEST_PULL` of its own sigma is blended; faint stars bear a neighbour that bright ones do not.

A Hipparcos solution of another type than 5 (single star, five parameters) says that the star moves in another way: types 7 and 9
accelerate, type 3 moves its light between components, type 1 scatters more than its errors say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.site import Site
from boresight.sky.apparent import C_AU_DAY, C_M_S, DAYS_PER_YEAR, J1991_25_DAYS, days_since_j2000, earth_state
from boresight.sky.catalogue import SINGLE_STAR, Catalogue, directions_at_epoch, unit_vectors
from boresight.sky.ground import velocity_at, view_from

#: Bands of z are so far apart where places are put in one order: x and a reach fit between, each two at most.
BAND = 8.0
#: Narrower bands would leave x too few digits in that order; the square of it covers what is lost of these.
NARROWEST_BAND = 1e-4


@dataclass(frozen=True)
class GuideStars:
    """Stars ascending in declination; arrays (n_stars,) or (n_stars, 3).

    Parameters
    ----------
    hip
        Hipparcos numbers.
    place
        Unit vectors at J1991.25, ICRS.
    motion
        Proper motion, rad a Julian year.
    parallax_rad
        Annual parallax.
    density
        Stars a steradian, for the odds of a chance one.
    """

    hip: IntArray
    place: FloatArray
    motion: FloatArray
    parallax_rad: FloatArray
    density: float


@dataclass(frozen=True)
class ObserverMotion:
    """Of each exposure: years since J1991.25 (n,), the Earth's place in au (n, 3) and the observer's velocity in c (n, 3).

    `air`: (n, 5) the zenith, ICRS axes, and the constants A and B of refraction, rad; None in space.
    """

    years: FloatArray
    earth_au: FloatArray
    beta: FloatArray
    air: FloatArray | None = None

    def __getitem__(self, exposures: slice) -> ObserverMotion:
        """Return the motion of consecutive exposures."""
        air = None if self.air is None else self.air[exposures]
        return ObserverMotion(self.years[exposures], self.earth_au[exposures], self.beta[exposures], air)


def guide_stars(catalogue: Catalogue, magnitude_limit: float, blend_rad: float) -> GuideStars:
    """Choose the stars brighter than a limit that no brighter neighbour within `blend_rad` swallows."""
    bright = np.flatnonzero(catalogue.magnitude <= magnitude_limit)
    place, east, north = _triad(catalogue, bright)
    magnitude = catalogue.magnitude[bright]
    a, b = close_pairs(place, blend_rad)
    fainter = np.where(magnitude[a] > magnitude[b], a, b)
    alone = np.ones(len(bright), np.bool_)
    alone[fainter] = False
    chosen = np.flatnonzero(alone)[np.argsort(place[alone, 2], kind="stable")]
    motion = catalogue.pm_ra_cosdec_rad_yr[bright, None] * east + catalogue.pm_dec_rad_yr[bright, None] * north
    return GuideStars(
        hip=catalogue.hip[bright[chosen]],
        place=np.ascontiguousarray(place[chosen]),
        motion=np.ascontiguousarray(motion[chosen]),
        parallax_rad=catalogue.parallax_rad[bright[chosen]],
        density=len(chosen) / (4 * np.pi),
    )


def _triad(catalogue: Catalogue, star: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors to stars, and east and north of them, each (n, 3)."""
    ra, dec = catalogue.ra_rad[star], catalogue.dec_rad[star]
    zero = np.zeros_like(ra)
    east = np.stack([-np.sin(ra), np.cos(ra), zero], axis=-1)
    north = np.stack([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)], axis=-1)
    return unit_vectors(ra, dec), east, north


def close_pairs(place: FloatArray, reach: float) -> tuple[IntArray, IntArray]:
    """Pairs of unit vectors (n, 3) at most `reach` apart, each once: its smaller index, and its larger.

    They are put into bands of z as wide as reach, and in a band into the order of x. Each is held against those that follow it in
    its band, and against those of the next band, as long as these are within reach along x. SciPy's tree of neighbours does the
    same, and costs a third of a second to import.
    """
    reach = min(reach, 2.0)
    along = BAND * np.floor((place[:, 2] + 1) / max(reach, NARROWEST_BAND)) + place[:, 0]
    order = np.argsort(along)
    along, (x, y, z) = along[order], np.ascontiguousarray(place[order].T)
    each, close = np.arange(len(order)), reach + NARROWEST_BAND**2
    found = list[tuple[IntArray, IntArray]]()
    for first, last in (
        (each + 1, along + close),
        (np.searchsorted(along, along + (BAND - close)), along + (BAND + close)),
    ):
        one, other = each, first
        while len(one):
            one, other = one[other < len(order)], other[other < len(order)]
            near = along[other] <= last[one]
            one, other = one[near], other[near]
            far = (x[other] - x[one]) ** 2 + (y[other] - y[one]) ** 2 + (z[other] - z[one]) ** 2
            both = far <= reach * reach
            found.append((order[one[both]], order[other[both]]))
            other = other + 1
    pairs = np.sort(np.concatenate([np.empty((2, 0), np.int64), *map(np.stack, found)], axis=1), axis=0)
    return pairs[0], pairs[1]


def observer_motion(
    time_utc: NDArray[np.datetime64], velocity_m_s: FloatArray | None, site: Site | None = None
) -> ObserverMotion:
    """Place and velocity of the observer at times (n,), datetime64[us]; at NaT the catalogue's stars are nowhere (NaN years).

    Parameters
    ----------
    velocity_m_s
        (n, 3) of the satellite, GCRS; None, or NaN, = that of the Earth's centre.
    site
        Where on the ground stars are seen through air, and whose velocity counts where none is given; None in space.
    """
    if site is not None and velocity_m_s is None:
        velocity_m_s = velocity_at(site, time_utc)
    moments, place = np.unique(time_utc.astype("datetime64[us]"), return_inverse=True)
    known = ~np.isnat(moments)
    years, earth, beta = np.full(len(moments), np.nan), np.zeros((len(moments), 3)), np.zeros((len(moments), 3))
    if known.any():
        days = days_since_j2000(moments[known])
        years[known] = (days - J1991_25_DAYS) / DAYS_PER_YEAR
        earth[known], velocity_au_day = earth_state(days)
        beta[known] = velocity_au_day / C_AU_DAY
    beta = beta[place]
    if velocity_m_s is not None:
        beta = beta + np.nan_to_num(velocity_m_s) / C_M_S
    air = None
    if site is not None:
        air = np.zeros((len(moments), 5))
        if known.any():
            view = view_from(site, moments[known])
            air[known, :3], air[known, 3:] = view.zenith, (view.A, view.B)
        air = np.ascontiguousarray(air[place])
    return ObserverMotion(years[place], np.ascontiguousarray(earth[place]), np.ascontiguousarray(beta), air)


FAINTER_MAG = 3.0
#: A neighbour may draw a centroid by so many of its sigmas, and counts within so many widths of an image.
LARGEST_PULL, REACH_WIDTHS = 0.4, 8.0
#: Pairs that are looked at in one go.
PAIRS = 1_000_000
UNRELIABLE, DOUBLE = 1, 2
#: Bits of `star_flags` and what they mean.
FLAGS = {UNRELIABLE: "unreliable astrometry", DOUBLE: "double"}


def star_flags(catalogue: Catalogue, blend_rad: float) -> NDArray[np.int8]:
    """Flag every star of a catalogue.

    Parameters
    ----------
    blend_rad
        Separation below which two stars make one image: some pixels wide.

    Returns
    -------
    (n_stars,) sums of the bits of `FLAGS`, 0 = nothing against it.
    """
    flags = _unreliable(catalogue.solution_type)
    flags[_blended(catalogue, blend_rad)] |= DOUBLE
    return flags


def flag_stars(catalogue: Catalogue, star: IntArray, blend_rad: float) -> NDArray[np.int8]:
    """Flags of some stars (n,), places in the catalogue, as `star_flags` gives them, without a look at the whole sky."""
    order, dec = catalogue.by_declination
    first, last = (np.searchsorted(dec, catalogue.dec_rad[star] + edge * blend_rad) for edge in (-1.01, 1.01))
    of = np.repeat(np.arange(len(star)), last - first)
    other = order[np.arange(len(of)) + np.repeat(first - np.append(0, np.cumsum(last - first)[:-1]), last - first)]
    chord = directions_at_epoch(catalogue, other) - directions_at_epoch(catalogue, star)[of]
    reach = 2 * np.sin(blend_rad / 2)
    near = (np.sum(chord * chord, axis=1) <= reach * reach) & (other != star[of])
    matters = catalogue.magnitude[other] - catalogue.magnitude[star[of]] <= FAINTER_MAG
    flags = _unreliable(catalogue.solution_type[star])
    flags[of[near & matters]] |= DOUBLE
    return flags


def compute_pulls(catalogue: Catalogue, star: IntArray, psf_rad: float) -> FloatArray:
    """Return by how much its neighbours draw the centroid of each of some stars, as the module says.

    Parameters
    ----------
    star
        (n,) places in the catalogue, which holds stars `FAINTER_MAG` fainter than any of them.
    psf_rad
        Width of a star's image, one sigma.

    Returns
    -------
    (n,) rad, the sum over neighbours within `REACH_WIDTHS`.
    """
    order, dec = catalogue.by_declination
    reach = REACH_WIDTHS * psf_rad
    first, last = (np.searchsorted(dec, catalogue.dec_rad[star] + edge * reach) for edge in (-1.01, 1.01))
    pull = np.zeros(len(star))
    for part in np.array_split(np.arange(len(star)), 1 + int((last - first).sum()) // PAIRS):
        count = last[part] - first[part]
        of = np.repeat(part, count)
        other = order[np.arange(len(of)) + np.repeat(first[part] - np.append(0, np.cumsum(count)[:-1]), count)]
        chord = directions_at_epoch(catalogue, other) - directions_at_epoch(catalogue, star)[of]
        d = np.sqrt(np.sum(chord * chord, axis=1))
        near = (d <= reach) & (other != star[of])
        of, other, d = of[near], other[near], d[near]
        ratio = 10.0 ** (0.4 * (catalogue.magnitude[star[of]] - catalogue.magnitude[other]))
        pull += np.bincount(of, ratio * d * np.exp(-((d / psf_rad) ** 2) / 4.0), len(star))
    return pull


def _unreliable(solution_type: IntArray) -> NDArray[np.int8]:
    return np.where(solution_type == SINGLE_STAR, 0, UNRELIABLE).astype(np.int8)


def phrases(flag: int) -> list[str]:
    """What is against a star with this flag, in words."""
    return [phrase for bit, phrase in FLAGS.items() if flag & bit]


def _blended(catalogue: Catalogue, blend_rad: float) -> NDArray[np.int64]:
    """Stars, some more than once, with a companion within the radius that is brighter or at most `FAINTER_MAG` fainter."""
    a, b = close_pairs(directions_at_epoch(catalogue, slice(None)), 2 * np.sin(blend_rad / 2))
    fainter_by = catalogue.magnitude[b] - catalogue.magnitude[a]
    return np.concatenate([a[fainter_by <= FAINTER_MAG], b[-fainter_by <= FAINTER_MAG]])
