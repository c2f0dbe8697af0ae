"""Which direction belongs to each row of telemetry: the file's own where it gives one, else the catalogue's.

==================================  ==========================================================================
row                                 direction
==================================  ==========================================================================
unmatched (`star_id` 0)             none (NaN): the row is not used
matched, `ra` and `dec` given       as given: it is apparent already
matched, no `ra`, in the catalogue  proper motion, parallax, aberration at the row's time (`sky.apparent`), and
                                    from the ground refraction (`sky.ground`)
matched, no `ra`, unknown number    none (NaN): the quality report lists the number
the file has no `star_id` column    as given where `ra` and `dec` are, else none
==================================  ==========================================================================

A matched row that needs the catalogue but has no time, or an absent velocity in a file that gives velocities, has no
direction either; a file in which no such row has a time is refused, for nobody wants that by accident.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.errors import RefusedInputError
from boresight.site import Site
from boresight.sky.catalogue import Catalogue, unit_vectors
from boresight.sky.ground import observed_directions


def star_directions(
    star_id: IntArray | None,
    ra_rad: FloatArray | None,
    dec_rad: FloatArray | None,
    time_utc: NDArray[np.datetime64] | None,
    velocity_m_s: FloatArray | None,
    catalogue: Catalogue,
    site: Site | None = None,
) -> FloatArray:
    """Return the apparent direction of every row.

    Parameters
    ----------
    star_id
        (n_rows,) Hipparcos numbers, 0 = unmatched; None when the file names no stars.
    ra_rad, dec_rad
        (n_rows,) apparent direction in ICRS axes, NaN where absent; None when the file gives none.
    time_utc
        (n_rows,) datetime64[us], NaT where absent; None when the file gives none.
    velocity_m_s
        (n_rows, 3) satellite velocity, GCRS; None when the file gives none.
    catalogue
        Where directions come from that the file does not give.
    site
        Where on the ground these are seen through air; None in space.

    Returns
    -------
    (n_rows, 3) unit vectors in ICRS axes, NaN for rows that cannot be used.

    Raises
    ------
    RefusedInputError
        When neither numbers nor directions are given, or directions must come from the catalogue and no row that
        needs one has a time.
    """
    given = _given_directions(ra_rad, dec_rad)
    if star_id is None:
        if given is None:
            raise RefusedInputError(
                "The telemetry gives no star numbers: give a star_id column (Hipparcos numbers) or ra_deg and dec_deg.",
                code="no-star-numbers",
            )
        return given
    directions = np.full((len(star_id), 3), np.nan) if given is None else np.where(star_id[:, None] > 0, given, np.nan)
    index = catalogue.find_index(star_id)
    wanted = np.flatnonzero((star_id > 0) & (index >= 0) & np.isnan(directions[:, 0]))
    if len(wanted):
        times = _get_times(time_utc, wanted)
        velocity = None if velocity_m_s is None else velocity_m_s[wanted]
        directions[wanted] = observed_directions(catalogue, index[wanted], times, velocity, site)
    return directions


def _given_directions(ra_rad: FloatArray | None, dec_rad: FloatArray | None) -> FloatArray | None:
    """Return the (n_rows, 3) unit vectors that the file gives, NaN where it gives none; None without such columns."""
    if ra_rad is None or dec_rad is None:
        return None
    return unit_vectors(ra_rad, dec_rad)


def _get_times(time_utc: NDArray[np.datetime64] | None, rows: IntArray) -> NDArray[np.datetime64]:
    """Return the times of rows whose direction comes from the catalogue; refuse when not one of them has a time."""
    if time_utc is None or np.isnat(time_utc[rows]).all():
        raise TimelessError(len(rows))
    return time_utc[rows]


class TimelessError(RefusedInputError):
    """No row that needs a direction from the catalogue has a time.

    Parameters
    ----------
    stars
        How many rows need one.
    """

    def __init__(self, stars: int) -> None:
        super().__init__(
            f"{stars:,} matched stars take their direction from the catalogue, which needs a time: "
            "add a time_utc column (ISO 8601, UTC), for images give --times, or give ra_deg and dec_deg."
        )
        self.stars = stars
