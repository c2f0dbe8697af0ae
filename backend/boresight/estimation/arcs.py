"""Arclengths between stars: which pairs, their covariance, and its whitening (E section II-B).

A scene of N stars holds 2N - 3 independent arcs: two coordinates a star less three bulk rotations. The stars are numbered so
that no three in a row are near collinear, and arcs run from star i to i + 1 and i + 2. Together they say all that the attitude-free
scene says: with their full covariance the estimate meets the Cramer-Rao bound.

Order
-----
Star i + 2 hangs on stars i and i + 1 by two arcs, so the triangle of each three consecutive stars must be fat: no small angle,
which excludes collinear triples and coincident pairs alike. Up to seven stars every order is tried. Beyond, the stars are sorted
by azimuth about their mean, drawn in turn from three sectors of azimuth, and placed by looking a dozen candidates ahead for a
triangle whose smallest angle is over 30 degrees: O(N log N). Where that leaves a thin triangle, for its last stars have no choice,
stars of the thinnest are swapped with others as long as all the triangles that a swap touches come out fatter.

Covariance
----------
With an isotropic direction error of variance sigma_i^2 a star and phi the arcs, E Eqs 16-18::

    R(ij, ij) = sigma_i^2 + sigma_j^2
    R(ij, jk) = sigma_j^2 cos psi_ijk        row of arc ij, column of arc jk; the printed index sets are an erratum
    cos psi   = (cos phi_ik - cos phi_ij cos phi_jk) / (sin phi_ij sin phi_jk)

In the interleaved order (0,1) (0,2) (1,2) (1,3) ... R has half-bandwidth 4; L with R = L L^T is banded too, and whitening is a
forward substitution, O(N). Diagonal weights instead of R cost 20 % in sigma.

A pixel is not the same angle everywhere: cos^2 theta along the radius, cos theta across it, and the distortion's slope besides.
The isotropic sigma that covers the same solid angle is sigma_i = sigma_px sqrt|ds/dm x ds/dn|, which E allows by "position in
the field of view". Taking sigma_px Delta / f instead puts chi-square 3 % off on the ST-16.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight import kernels
from boresight.arrays import FloatArray, IntArray
from boresight.cameras import CameraModel
from boresight.estimation.blocks import in_blocks

T = TypeVar("T")
#: Rows that are copied: one by one, or whole stretches.
Chosen: TypeAlias = NDArray[np.bool_] | list[slice]

#: Sine of the smallest angle of a triangle below which an exposure counts as collinear: over 1,000 px the third star is
#: then less than 5 px off the line, where the linear error model of R ends.
COLLINEAR = 0.005
#: Exposures in a row, on average over all, from which on they are taken as stretches.
LONG_STRETCH = 20


@dataclass(frozen=True)
class ArcSet:
    """The arcs of a telemetry set, as a structure of arrays in chosen order.

    Parameters
    ----------
    camera
        The camera whose parameters are estimated.
    pitch
        Pixel pitch, metres.
    frame
        (n_frames,) frame numbers of the telemetry.
    frame_start
        (n_frames + 1,) first exposure of each frame.
    star_start
        (n_exposures + 1,) first star of each exposure.
    row_px, col_px, sigma_px
        (n_stars,) centroid and its one-axis standard deviation.
    s_i
        (n_stars, 3) apparent catalogue directions, ICRS.
    source_row
        (n_stars,) the row of the telemetry each star came from.
    phi
        (n_arcs,) catalogue arclengths, rad.
    band
        (n_arcs, 5) banded Cholesky factor of R, see `boresight.kernels`.
    """

    camera: CameraModel
    pitch: float
    frame: IntArray
    frame_start: IntArray
    star_start: IntArray
    row_px: FloatArray
    col_px: FloatArray
    sigma_px: FloatArray
    s_i: FloatArray
    source_row: IntArray
    phi: FloatArray
    band: FloatArray

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.frame)

    @property
    def n_exposures(self) -> int:
        """Number of exposures."""
        return len(self.star_start) - 1

    @property
    def n_stars(self) -> int:
        """Number of star sightings."""
        return len(self.row_px)

    @property
    def n_arcs(self) -> int:
        """Number of arcs."""
        return len(self.phi)

    @property
    def known_phi(self) -> FloatArray:
        """`phi`; raises ValueError where it has not one entry an arc, beyond which compiled loops would read and write."""
        expected = 2 * self.n_stars - 3 * self.n_exposures
        if self.n_arcs != expected:
            raise ValueError(f"Expected {expected} catalogue arcs, received {self.n_arcs}: whiten the set first")
        return self.phi

    def begin_whitened_loop(self, x: FloatArray) -> tuple[Any, ...]:
        """Return the arguments with which a loop over whitened residuals at state x begins."""
        return (
            self.camera.kind, x, self.pitch, self.star_start, self.row_px, self.col_px, self.known_phi, self.band,
        )  # fmt: skip

    @property
    def frame_arcs(self) -> IntArray:
        """First arc of each frame, and the end, (n_frames + 1,)."""
        return 2 * self.star_start[self.frame_start] - 3 * self.frame_start

    def exposures(self, chosen: NDArray[np.bool_]) -> ArcSet:
        """Return the chosen exposures (n_exposures,) as a set of their own; frames that keep none are left out."""
        if chosen.all():
            return self
        in_frame = np.add.reduceat(chosen, self.frame_start[:-1], dtype=np.int64)
        in_exposure = np.diff(self.star_start)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]])))
        stars: Chosen
        kept: Chosen
        if len(edges) * LONG_STRETCH < self.n_exposures:
            stars = _stretches(self.star_start[edges])
            kept = _stretches(2 * self.star_start[edges] - 3 * edges)
        else:
            stars, kept = np.repeat(chosen, in_exposure), np.repeat(chosen, 2 * in_exposure - 3)
        return replace(
            self,
            frame=self.frame[in_frame > 0],
            frame_start=np.append(0, np.cumsum(in_frame[in_frame > 0])),
            star_start=np.append(0, np.cumsum(in_exposure[chosen])),
            **{
                name: _rows(getattr(self, name), stars)
                for name in ("row_px", "col_px", "sigma_px", "s_i", "source_row")
            },
            phi=_rows(self.phi, kept) if self.n_arcs else self.phi,
            band=_rows(self.band, kept) if self.n_arcs else self.band,
        )

    def without(self, rows: IntArray, minimum_stars: int) -> tuple[ArcSet, int, int]:
        """Return the set without the stars of some telemetry rows, unwhitened; exposures that lose one are ordered again.

        Returns also how many exposures are lost with them: with fewer stars left than `minimum_stars`, and all on one line.
        """
        stays = ~np.isin(self.source_row, rows)
        first = self.star_start[:-1]
        left = np.add.reduceat(stays, first, dtype=np.int64) if len(first) else np.zeros(0, np.int64)
        touched, full = left < np.diff(self.star_start), left >= minimum_stars
        stays &= np.repeat(full, np.diff(self.star_start))
        stars = np.flatnonzero(stays)
        counts = left[full]
        starts = np.append(0, np.cumsum(counts))
        reordered = np.flatnonzero(np.repeat(touched[full], counts))
        fat = np.ones(len(counts), np.bool_)
        if len(reordered):
            places, fatness = order(np.append(0, np.cumsum(counts[touched[full]])), self.s_i[stars[reordered]])
            stars[reordered] = stars[reordered[places]]
            fat[touched[full]] = fatness > COLLINEAR
        chosen = np.zeros(self.n_exposures, np.bool_)
        chosen[np.flatnonzero(full)[fat]] = True
        stars, counts = stars[np.repeat(fat, counts)], counts[fat]
        starts = np.append(0, np.cumsum(counts))
        in_frame = np.add.reduceat(chosen, self.frame_start[:-1], dtype=np.int64) if self.n_frames else left
        arcs = replace(
            self,
            frame=self.frame[in_frame > 0],
            frame_start=np.append(0, np.cumsum(in_frame[in_frame > 0])),
            star_start=starts,
            **{name: getattr(self, name)[stars] for name in ("row_px", "col_px", "sigma_px", "s_i", "source_row")},
            phi=np.empty(0),
            band=np.empty((0, kernels.HALF_BANDWIDTH + 1)),
        )
        return arcs, int((~full).sum()), int((~fat).sum())

    def frames(self, first: int, last: int) -> ArcSet:
        """Return the frames first <= k < last as a set of their own (views, no copies of stars or arcs)."""
        if (first, last) == (0, self.n_frames):
            return self
        e0, e1 = int(self.frame_start[first]), int(self.frame_start[last])
        s0, s1 = int(self.star_start[e0]), int(self.star_start[e1])
        a0, a1 = 2 * s0 - 3 * e0, 2 * s1 - 3 * e1
        stars = slice(s0, s1)
        return replace(
            self,
            frame=self.frame[first:last],
            frame_start=self.frame_start[first : last + 1] - e0,
            star_start=self.star_start[e0 : e1 + 1] - s0,
            row_px=self.row_px[stars],
            col_px=self.col_px[stars],
            sigma_px=self.sigma_px[stars],
            s_i=self.s_i[stars],
            source_row=self.source_row[stars],
            phi=self.phi[a0:a1],
            band=self.band[a0:a1],
        )

    def whole(self) -> ArcSet:
        """Return the set, which is in memory."""
        return self

    def each(self, function: Callable[..., ArcSet], *arguments: Any) -> ArcSet:
        """Return `function(set, *arguments)`.

        The function stands at the top of a module and treats every exposure by itself, so that a set in pieces can do it to each.
        """
        return function(self, *arguments)

    def over_blocks(self, function: Callable[..., T], *arguments: Any) -> list[T]:
        """Call `function(block, *arguments)` for each block of frames, on as many threads as there are, in their order.

        The function stands at the top of a module, and what it takes and gives is small: see `estimation.blocks`.
        """
        return in_blocks(lambda first, last: function(self.frames(first, last), *arguments), self.n_frames)


def _stretches(edges: IntArray) -> list[slice]:
    """Stretches of rows between edges (2 n,)."""
    return [slice(first, last) for first, last in edges.reshape(-1, 2).tolist()]


def _rows(values: NDArray[Any], chosen: Chosen) -> Any:
    """Copy chosen rows; whole stretches are copied three times as fast as rows that are asked for one by one."""
    return (
        np.concatenate([values[:0], *(values[one] for one in chosen)]) if isinstance(chosen, list) else values[chosen]
    )


def order(star_start: IntArray, s_i: FloatArray) -> tuple[IntArray, FloatArray]:
    """Number the stars of each exposure so that no three in a row are near collinear.

    Parameters
    ----------
    star_start
        (n_exposures + 1,) first star of each exposure.
    s_i
        (n_stars, 3) unit directions.

    Returns
    -------
    places
        (n_stars,) input place of each star in the new order.
    fatness
        (n_exposures,) sine of the smallest angle among the triangles of three consecutive stars.
    """
    places = np.empty(len(s_i), np.int64)
    fatness = np.empty(len(star_start) - 1)
    s_i = np.ascontiguousarray(s_i)

    def order_block(first: int, last: int) -> None:
        s0, s1 = int(star_start[first]), int(star_start[last])
        stars = slice(s0, s1)
        kernels.order_stars(star_start[first : last + 1] - s0, s_i[stars], places[stars], fatness[first:last])
        places[stars] += s0

    in_blocks(order_block, len(star_start) - 1)
    return places, fatness


def angular_sigma(camera: CameraModel, x: FloatArray, arcs: ArcSet) -> FloatArray:
    """Isotropic direction error of each star under state x, (n_stars,) rad: sigma_px sqrt|ds/dm x ds/dn|."""
    return np.asarray(arcs.sigma_px * np.sqrt(camera.solid_angle(x, arcs.row_px, arcs.col_px, arcs.pitch)))


def whiten(arcs: ArcSet, sigma_rad: FloatArray) -> tuple[ArcSet, NDArray[np.bool_]]:
    """Fill catalogue arcs and the factors of R for given direction errors.

    Returns
    -------
    arcs
        The set with `phi` and `band`.
    bad
        (n_exposures,) True where R is not positive definite, which only a collinear exposure can cause (E Appendix A).
    """
    n_arcs = 2 * arcs.n_stars - 3 * arcs.n_exposures
    phi, band = np.empty(n_arcs), np.zeros((n_arcs, kernels.HALF_BANDWIDTH + 1))
    bad = np.zeros(arcs.n_exposures, np.bool_)

    def whiten_block(first: int, last: int) -> None:
        s0, s1 = int(arcs.star_start[first]), int(arcs.star_start[last])
        stars, rows = slice(s0, s1), slice(2 * s0 - 3 * first, 2 * s1 - 3 * last)
        starts = arcs.star_start[first : last + 1] - s0
        kernels.arcs_and_factors(starts, arcs.s_i[stars], sigma_rad[stars], phi[rows], band[rows], bad[first:last])

    in_blocks(whiten_block, arcs.n_exposures)
    return replace(arcs, phi=phi, band=band), bad


def pairs(n: int) -> IntArray:
    """Star pairs of an exposure of n stars in the interleaved order, (2n - 3, 2)."""
    a = np.arange(2 * n - 3)
    return np.stack([a // 2, a // 2 + 1 + a % 2], axis=1)


def covariance(s_i: FloatArray, sigma_rad: FloatArray) -> FloatArray:
    """R of one exposure as a full matrix (2n - 3, 2n - 3), rad^2: the plain form that the banded one is held against."""
    pair = pairs(len(s_i))
    phi = arclength(s_i[pair[:, 0]], s_i[pair[:, 1]])
    R = np.zeros((len(pair), len(pair)))
    for a, (i, j) in enumerate(pair):
        R[a, a] = sigma_rad[i] ** 2 + sigma_rad[j] ** 2
        for b in range(a):
            shared = {i, j} & set(pair[b])
            if shared:
                at = shared.pop()
                far_a, far_b = i + j - at, pair[b].sum() - at
                cosine = s_i[far_a] @ s_i[far_b] - np.cos(phi[a]) * np.cos(phi[b])
                R[a, b] = R[b, a] = sigma_rad[at] ** 2 * cosine / (np.sin(phi[a]) * np.sin(phi[b]))
    return R


def arclength(s_a: FloatArray, s_b: FloatArray) -> FloatArray:
    """Angle between unit vectors (n, 3) and (n, 3), rad, by atan2: exact at every separation, unlike arccos (E Eq 9)."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(s_a, s_b), axis=-1), np.sum(s_a * s_b, axis=-1)))
