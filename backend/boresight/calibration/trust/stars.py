"""Every star over all its sightings, and those whose catalogue place the set contradicts.

A star displaced by d = (east, north) from its catalogue place leaves r = M T d + noise of covariance sigma^2 M in each sighting
(T turns sky into pixels, M is its own share, see `residuals`). With

    u = sum T^T r / sigma^2         W = sum T^T M T / sigma^2         d = W^-1 u,

u^T d is chi-square with two degrees of freedom for a star that stands where the catalogue says. It is divided by the square of
the residuals' spread where that exceeds one, so that understated noise alone makes no suspect. A star is one when its p-value
times the number of stars (Bonferroni) is below `UNLIKELY`, as any test of trust must be.

A displaced star pulls the attitude and so makes its neighbours look displaced. So the worst are taken out, the residuals of the
others are taken again without them, and so on until nobody is suspect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.arrays import ARCSEC_PER_RAD, BoolArray, FloatArray, IntArray
from boresight.calibration.calibration import StarTrust
from boresight.calibration.trust.fitted_set import UNLIKELY, FittedSet, Unavailable
from boresight.calibration.trust.residuals import StarResiduals, compute_star_residuals
from boresight.sky.guide_stars import flag_stars, phrases

MOST_SHOWN = 200
MOST_ROUNDS = 6
#: Stars that an attitude must keep when suspects are taken out of it.
FEWEST_KEPT = 3
#: A sighting so many sigmas off, while its star's others are not, is a wrong match rather than a wrong place.
FAR_OFF = 6.0
#: Two stars nearer than this make one image.
BLEND_PX = 5.0


@dataclass(frozen=True)
class StarTable:
    """One entry a star; leading dimension n_stars.

    `star_id`, `sightings`: Hipparcos number and how often it was seen. `displacement_rad`, `sigma_rad`: (n_stars, 2) east and
    north from the catalogue place, and one-sigma. `z`: displacement over its sigma: the root of u^T d, spread taken into
    account. `rms_px`, `worst_z`: of its residuals an axis, and the largest single one in sigmas. `pixel_rad`: angle of a pixel
    where it was seen. `suspect`: whether the set contradicts its place.
    """

    star_id: IntArray
    sightings: IntArray
    displacement_rad: FloatArray
    sigma_rad: FloatArray
    z: FloatArray
    rms_px: FloatArray
    worst_z: FloatArray
    pixel_rad: FloatArray
    suspect: BoolArray


def star_table(fitted: FittedSet, first: StarResiduals) -> StarTable:
    """Judge every star, taking suspects out until none is left."""
    if fitted.telemetry.star_id is None:
        raise Unavailable(
            "The telemetry gives no star numbers, so sightings of the same star cannot be combined: give star_id."
        )
    ids = fitted.telemetry.star_id[first.arcs.source_row]
    table = _judged(ids, first)
    for _ in range(MOST_ROUNDS):
        new = _suspect(table) & ~table.suspect
        if not new.any():
            break
        worst = new & (table.z >= table.z[new].max() / 2)
        named = table.suspect | worst
        again = _judged(ids, compute_star_residuals(fitted, _select_for_attitudes(ids, table.star_id[named], first)))
        table = _merged(table, again, named)
    return table


def _suspect(table: StarTable) -> BoolArray:
    """Stars beyond the level, (n_stars,)."""
    return np.asarray(table.z**2 > -2 * np.log(UNLIKELY / len(table.z)))


def _select_for_attitudes(ids: IntArray, out: IntArray, found: StarResiduals) -> BoolArray:
    """Which detections attitudes are estimated from: those of other stars, or all of an exposure where too few would be left."""
    kept = ~np.isin(ids, out)
    start = found.arcs.star_start
    left = np.add.reduceat(kept.astype(int), start[:-1])
    return np.asarray(kept | np.repeat(left < FEWEST_KEPT, np.diff(start)))


def _merged(before: StarTable, after: StarTable, named: BoolArray) -> StarTable:
    """Named stars as they were when named, the others as they are now.

    Not every star has a residual both times: without a star that is none of the field's its own place is not on the detector any
    more, and an exposure that it kept from an attitude may have one. Where nothing new is known of a star the old stands.
    """
    star_id = np.union1d(before.star_id, after.star_id)
    was, now = np.searchsorted(star_id, before.star_id), np.searchsorted(star_id, after.star_id)
    suspect = np.zeros(len(star_id), np.bool_)
    suspect[was] = named
    renewed = ~suspect[now]
    values = {}
    for key, old in vars(before).items():
        values[key] = np.zeros((len(star_id), *old.shape[1:]), old.dtype)
        values[key][was] = old
        values[key][now[renewed]] = getattr(after, key)[renewed]
    return StarTable(**{**values, "suspect": suspect})


def _judged(ids: IntArray, found: StarResiduals) -> StarTable:
    """Add the sightings of each star up."""
    seen = found.known
    T, variance = found.from_sky[seen], found.arcs.sigma_px[seen] ** 2
    star_id, of = np.unique(ids[seen], return_inverse=True)
    n = len(star_id)
    u = _summed(np.einsum("nki,nk->ni", T, found.r[seen]) / variance[:, None], of, n)
    W = _summed((T.transpose(0, 2, 1) @ found.M[seen] @ T) / variance[:, None, None], of, n)
    inverse = np.linalg.pinv(W, hermitian=True)
    d = np.einsum("nij,nj->ni", inverse, u)
    counts = np.bincount(of, minlength=n)
    worst = np.zeros(n)
    np.maximum.at(worst, of, np.abs(found.z[seen]).max(axis=1))
    pixel = 1 / np.sqrt(np.abs(np.linalg.det(T)))
    return StarTable(
        star_id=star_id,
        sightings=counts,
        displacement_rad=d,
        sigma_rad=np.sqrt(np.maximum(np.diagonal(inverse, axis1=1, axis2=2), 0.0)),
        z=np.sqrt(np.maximum(np.einsum("ni,ni->n", u, d), 0.0)) / max(found.spread, 1.0),
        rms_px=np.sqrt(_summed(np.mean(found.r[seen] ** 2, axis=1), of, n) / counts),
        worst_z=worst / max(found.spread, 1.0),
        pixel_rad=_summed(pixel, of, n) / counts,
        suspect=np.zeros(n, np.bool_),
    )


def _summed(values: FloatArray, of: IntArray, n: int) -> FloatArray:
    """Sums of (n_sightings, ...) over each star, (n, ...)."""
    flat = values.reshape(len(values), -1)
    columns = [np.bincount(of, flat[:, place], minlength=n) for place in range(flat.shape[1])]
    return np.asarray(np.stack(columns, axis=-1).reshape(n, *values.shape[1:]), dtype=np.float64)


def stars(fitted: FittedSet, table: StarTable) -> list[StarTrust]:
    """The worst stars first, at most `MOST_SHOWN`, every suspect among the first."""
    order = np.lexsort((-table.z, ~table.suspect))[:MOST_SHOWN]
    said = _describe_catalogue(fitted, table.star_id[order], table.pixel_rad[order])
    d, worst, z = table.displacement_rad[order], table.worst_z[order], table.z[order]
    alone = (table.sightings[order] > 1) & (worst > FAR_OFF) & (worst > 0.9 * z)
    columns = (
        table.star_id[order],
        table.sightings[order],
        np.hypot(d[:, 0], d[:, 1]) / table.pixel_rad[order],
        table.rms_px[order],
        z,
        d * ARCSEC_PER_RAD,
        table.sigma_rad[order] * ARCSEC_PER_RAD,
        table.suspect[order],
        alone,
    )
    return [
        StarTrust(
            star_id=star_id,
            sightings=sightings,
            mean_residual_px=mean_residual_px,
            rms_px=rms_px,
            z=z_of,
            east_north_arcsec=east_north_arcsec,
            sigma_arcsec=sigma_arcsec,
            suspect=suspect,
            flags=[*flags, "one sighting far off"] if far_off else list(flags),
        )
        for flags, star_id, sightings, mean_residual_px, rms_px, z_of, east_north_arcsec, sigma_arcsec, suspect, far_off in zip(
            said, *(column.tolist() for column in columns), strict=True
        )
    ]


def _describe_catalogue(fitted: FittedSet, star_id: IntArray, pixel_rad: FloatArray) -> list[list[str]]:
    """What the catalogue says against each star's place, in phrases."""
    if fitted.catalogue is None or not len(star_id):
        return [[] for _ in star_id]
    place = fitted.catalogue.find_index(star_id)
    known = place >= 0
    flags = np.zeros(len(place), np.int8)
    flags[known] = flag_stars(fitted.catalogue, place[known], BLEND_PX * float(np.median(pixel_rad)))
    return [
        phrases(flag) if of else ["not in the catalogue"]
        for flag, of in zip(flags.tolist(), known.tolist(), strict=True)
    ]


def stars_sentence(table: StarTable, frames_used: int, frames: int, *, fits: bool) -> str:
    """How many stars were judged and who is suspect, with a caution where the camera model does not fit."""
    named = table.star_id[table.suspect]
    of = "" if frames_used == frames else f" in {frames_used} frames spaced evenly over the set"
    if not len(named):
        return (
            f"None of {len(table.z)} stars{of} is off its catalogue position by more than chance explains (1 % over all of "
            "them)."
        )
    worst = table.star_id[table.suspect][np.argsort(-table.z[table.suspect])][:10]
    what = (
        "check their matches or leave them out"
        if fits
        else "but the camera model does not fit, so free more parameters first"
    )
    more = "" if len(named) <= len(worst) else f" and {len(named) - len(worst)} more"
    return (
        f"{len(named)} of {len(table.z)} stars{of} {'is' if len(named) == 1 else 'are'} off the catalogue position by more than "
        f"chance explains (1 % over all of them): HIP {', '.join(map(str, worst))}{more}; {what}."
    )
