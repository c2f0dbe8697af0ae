"""Score tests of departures from the model: what a field of displaced centroids would have left in the residuals.

A departure is a displacement of the stars with a few unknown coefficients c: u_i = sum_c c_c g_c,i with the fields g_c,i known,
from the star's place on the detector, its magnitude, temperature, time, or whatever else it may depend on. With whitened
residuals e, scaled Jacobian H at the estimate (`fitted_set`) and G the whitened change of the arcs by c, a set that departs by c
and is fitted with parameters off by z leaves

    e = noise + H z + G c.

Least squares of z and c together, z eliminated with A = H^T H, gives

    F = G^T G - G^T H A^-1 H^T G        s = G^T e - G^T H A^-1 H^T e        c_hat = F^-1 s        covariance of c_hat = F^-1,

and chi-square falls by s^T F^-1 s, which has a chi-square distribution with as many degrees of freedom as F has rank when c = 0
(Rao's score test). Nothing is fitted again: all fields share one pass, and each test takes its own rows and columns of the sums.
A camera that was fitted to stars displaced by c is off by

    d = z_fitted - z_true = -A^-1 H^T G c_hat,

how far its parameters are wrong if this departure is real. A direction of c that the
camera nearly has itself is hardly known and moves the parameters far: what is told of d in claimed sigmas counts only those
directions that stand clear of the noise.

Sigmas that are to hold if it is real may not leave such a direction out: it is as likely displaced as the others (`expect`). Let
the coefficients a in units of the fields' own noise be normal about zero, those of group g with a variance t_g. Given T, the
diagonal matrix of the t_g, with F and s in these units and of noise one, the coefficients are

    a = (F + T^-1)^-1 s        with the covariance (F + T^-1)^-1,

what was found where F is large, and no more than zero +- t^1/2 where it is small; and T has the likelihood

    det(I + T F)^-1/2 exp(s^T (F + T^-1)^-1 s / 2),

from which all directions of a group together tell its size. All t_g of a grid up to the likeliest are weighed by it, flat in their
logarithms before.
One group are the departures that are named, the other what else a lens or a detector may do: no field is just as it is called.

What the test may miss follows before any data speak. A departure c falls short of being noticed once in ten times where its
noncentrality c^T F c is

    lambda = (sqrt(q) + z)^2 - (k - 1),    q the chi-square that is noticed, z = 1.28 the normal deviate of nine in ten,

for sqrt(s^T F^-1 s), of k degrees of freedom, is nearly normal about sqrt(lambda + k - 1) with sigma one. Of all c of that size
the parameter i is moved most, by

    sqrt(lambda g_i^T F^-1 g_i),           g_i the row of -A^-1 H^T G,     along c = sqrt(lambda / g_i^T F^-1 g_i) F^-1 g_i:

the external reliability of geodesy, told in claimed sigmas (`find_unseen`). Among many fields there are some that arcs hardly see,
as a turn of the image, and some that the camera takes up, as a scale: along them c grows without bound. With W the directions of
G^T G that stand clear of zero, W^T G^T G W = 1, the eigenvalues of W^T F W are the shares of what arcs see that the camera
leaves. Where it leaves less than `OWN_SHARE`, a tenth of the displacement, the departure is a change of the camera, which the
directions of stars do not suffer from; F^-1 is then that of the other directions alone.

Three kinds of field have three kinds of rows: displaced centroids, pixels (J = -ds/d(principal point), for a camera knows a place
only by its distance from it); directions displaced in the sky, rad east and north, where the arcs of the catalogue are what moves;
and what changes from frame to frame by f_k, whose rows are those of the unchanging field times f_k: -H f_k for a parameter.

Directions of c that no data could show are left out: those that turn an exposure as a whole, which arcs do not see, and those that
the camera has itself. Both show as eigenvalues of F small beside the sum of squares of the displacements over their sigmas.

The level of the noise is a question of its own, which chi-square answers. A stated sigma that is wrong by half would trip every
test here without any departure; so the statistic is held against the residuals that remain after it,

    (s^T F^-1 s / k) / ((e^T e - s^T F^-1 s) / (n - k)),        an F distribution with k and n - k degrees of freedom.

Reference: C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters", Proc. Camb. Phil. Soc. 44, 1948;
W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic Commission, New Series 2(5), 1968.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, reduce
from itertools import pairwise
from typing import Literal

import numpy as np

from boresight import kernels
from boresight.arrays import FloatArray, IntArray
from boresight.calibration.trust.fitted_set import FittedSet
from boresight.estimation.arcs import ArcSet
from boresight.estimation.batch import covariance
from boresight.estimation.blocks import in_blocks
from boresight.estimation.statistics.special import chdtri, fdtrc

#: Share of a displacement's information below which a direction of it is the camera's own, or a turn of the exposure.
LEAST_SHARE = 1e-7
#: Share of a smooth displacement's information below which what is unseen of it is the camera's own.
OWN_SHARE = 1e-2
#: Sigmas from which on a direction of c is clear.
CLEAR = 3.0
#: Variances of coefficients in units of their fields' own noise that are weighed.
SIZES = np.geomspace(0.1, 1e8, 19)
#: And how much larger than the likeliest they may be.
BEYOND = 4.0
#: Normal deviate that nine in ten stay below.
NINE_IN_TEN = 1.2816
#: Frames whose rows are made at a time: they stay in the processor's cache.
FRAMES = 256


@dataclass(frozen=True)
class Block:
    """Frames `first` <= k < `last` of a fitted set: their arcs, whitened residuals e and scaled Jacobian H."""

    fitted: FittedSet
    first: int
    last: int

    @cached_property
    def arcs(self) -> ArcSet:
        """Their arcs and stars."""
        return self.fitted.arcs.frames(self.first, self.last)

    @property
    def rows(self) -> slice:
        """Their arcs among those of the set."""
        start = self.fitted.arcs.frame_arcs
        return slice(int(start[self.first]), int(start[self.last]))

    @property
    def stars(self) -> slice:
        """Their stars among those of the set."""
        arcs = self.fitted.arcs
        return slice(*(int(arcs.star_start[arcs.frame_start[k]]) for k in (self.first, self.last)))

    @property
    def e(self) -> FloatArray:
        """(n_arcs,) whitened residuals."""
        return self.fitted.e[self.rows]

    @property
    def H(self) -> FloatArray:
        """(n_arcs, n_free) scaled Jacobian."""
        return self.fitted.H[self.rows]

    @cached_property
    def frame_of_arc(self) -> IntArray:
        """(n_arcs,) place of each arc's frame in the set."""
        return np.repeat(np.arange(self.first, self.last), np.diff(self.arcs.frame_arcs))

    @cached_property
    def on_detector(self) -> tuple[FloatArray, FloatArray]:
        """Directions s (n_stars, 3) at the estimate, and ds/d(row, column) (n_stars, 3, 2), a pixel."""
        camera, arcs = self.fitted.problem.camera, self.arcs
        s, ds_dx = camera.directions_and_jacobian(self.fitted.x, arcs.row_px, arcs.col_px, arcs.pitch)
        return s, np.ascontiguousarray(-ds_dx[:, :, camera.principal_places])

    @cached_property
    def in_sky(self) -> tuple[FloatArray, FloatArray]:
        """Directions of the catalogue s (n_stars, 3), and their derivative to the east and to the north (n_stars, 3, 2)."""
        s = np.ascontiguousarray(self.arcs.s_i)
        reach = np.maximum(np.hypot(s[:, 0], s[:, 1]), np.finfo(float).tiny)
        east = np.stack([-s[:, 1] / reach, s[:, 0] / reach, np.zeros(len(s))], axis=-1)
        return s, np.ascontiguousarray(np.stack([east, np.cross(s, east)], axis=-1))

    def displace(self, u: FloatArray, kind: str) -> FloatArray:
        """Whitened change (n_arcs, n_fields) of the arcs by displacements u (n_stars, 2, n_fields) of a kind."""
        s, J = self.on_detector if kind == "detector" else self.in_sky
        rows = np.empty((self.arcs.n_arcs, u.shape[2]))
        kernels.displaced_rows(self.arcs.star_start, s, J, self.arcs.band, np.ascontiguousarray(u), rows)
        return rows

    @cached_property
    def computed(self) -> dict[str, FloatArray]:
        """Rows that several departures are made of."""
        return {}

    @cached_property
    def sigma_rad(self) -> FloatArray:
        """(n_stars,) isotropic direction error of each star."""
        J = self.on_detector[1]
        pixel = np.linalg.norm(np.cross(J[:, :, 0], J[:, :, 1]), axis=1)
        return np.asarray(self.arcs.sigma_px * np.sqrt(pixel))


Kind = Literal["detector", "sky", "rows"]


@dataclass(frozen=True)
class Departure:
    """A departure from the model with its fields.

    `fields` makes them of a block: of kind `detector` displacements (n_stars, 2, n_fields), pixels; `sky`: the same, rad east and
    north; `rows`: their rows G (n_arcs, n_fields), where these are those of another field times numbers of the frame. `trials`: of
    how many fields these are the best, by which its probability is multiplied (Bonferroni).
    """

    name: str
    kind: Kind
    fields: Callable[[Block], FloatArray]
    trials: int = 1


@dataclass(frozen=True)
class ScoreSums:
    """Sums over all arcs; see the module's derivation.

    `places`: of the fields of each departure. `G_G`: (n_fields, n_fields). `G_H`: (n_fields, n_free). `G_e`: (n_fields,).
    `squares`: (n_fields,) sums of squares of the displacements over their sigmas. `A`, `b`, `chi2`, `n_arcs`: H^T H, H^T e, e^T e
    and how many.
    """

    places: dict[str, slice]
    G_G: FloatArray
    G_H: FloatArray
    G_e: FloatArray
    squares: FloatArray
    A: FloatArray
    b: FloatArray
    chi2: float
    n_arcs: int

    @cached_property
    def P(self) -> FloatArray:
        """A^-1, once for all departures."""
        return covariance(self.A)

    def __add__(self, other: ScoreSums) -> ScoreSums:
        """The sums over the arcs of both."""
        values = {one.name: getattr(self, one.name) + getattr(other, one.name) for one in fields(self)[1:]}
        return ScoreSums(self.places, **values)


@dataclass(frozen=True)
class Score:
    """What the score test of one departure found.

    `statistic`: fall of chi-square in the noise found, and `dof` its degrees of freedom; `p`: chance of as much. `c`, `covariance`:
    (n_fields,) and (n_fields, n_fields) the coefficients, zero along directions that were left out. `d`: (n_free,) how far the
    parameters are off if it is real, typical sigmas. `misled`: that of the parameter that is misled most, in its claimed sigmas,
    from the directions of c that stand clear of noise; `clear`: (n_fields,) c along these alone. `fall`, `left`: of chi-square, in
    the stated noise, and what remains of it.
    """

    name: str
    statistic: float
    dof: int
    p: float
    c: FloatArray
    covariance: FloatArray
    d: FloatArray
    misled: float
    fall: float
    left: float
    clear: FloatArray


def add_up(fitted: FittedSet, departures: Sequence[Departure], most_frames: int | None = None) -> ScoreSums:
    """Make the rows of every departure, block by block, and add their products up.

    `most_frames`: blocks of frames evenly spread over the set that hold about so many are taken; all where None.
    """
    n = fitted.arcs.n_frames
    every = 1 if most_frames is None else max(1, -(-n // most_frames))

    def run(first: int, last: int) -> ScoreSums | None:
        return None if first // FRAMES % every else _add_block(Block(fitted, first, last), departures)

    found = [part for part in in_blocks(run, n, FRAMES) if part is not None]
    return reduce(ScoreSums.__add__, found)


def _add_block(block: Block, departures: Sequence[Departure]) -> ScoreSums:
    """The sums of one block; displacements of one kind go through the loop together."""
    u = {one.name: one.fields(block) for one in departures}
    if block.first == 0:
        block.fitted.computed["first fields"] = u
    G, squares = dict[str, FloatArray](), dict[str, FloatArray]()
    for kind in ("detector", "sky"):
        names = [one.name for one in departures if one.kind == kind]
        if names:
            _displace(block, kind, names, u, G, squares)
    for one in departures:
        if one.kind == "rows":
            G[one.name] = u[one.name]
            squares[one.name] = np.sum(G[one.name] ** 2, axis=0)
    ends = np.cumsum([0, *(len(squares[one.name]) for one in departures)])
    places = {one.name: slice(int(a), int(b)) for one, (a, b) in zip(departures, pairwise(ends), strict=True)}
    rows = np.concatenate([G[one.name] for one in departures], axis=1)
    e, H = block.e, block.H
    every_square = np.concatenate([squares[one.name] for one in departures])
    return ScoreSums(
        places, rows.T @ rows, rows.T @ H, rows.T @ e, every_square, H.T @ H, H.T @ e, float(e @ e), len(e)
    )


def _displace(
    block: Block,
    kind: str,
    names: list[str],
    u: dict[str, FloatArray],
    G: dict[str, FloatArray],
    squares: dict[str, FloatArray],
) -> None:
    """Fill rows and squares of the fields that displace stars on the detector, or in the sky."""
    sigma = block.arcs.sigma_px if kind == "detector" else block.sigma_rad
    fields = np.concatenate([u[name] for name in names], axis=2)
    rows = block.displace(fields, kind)
    weighted = np.repeat(1 / sigma**2, 2) @ (fields * fields).reshape(-1, fields.shape[2])
    begin = 0
    for name in names:
        end = begin + u[name].shape[2]
        G[name], squares[name] = rows[:, begin:end], weighted[begin:end]
        begin = end


def find_score(sums: ScoreSums, *names: str) -> Score:
    """Test a departure, or several together; the answer is called by the first."""
    every = np.arange(len(sums.squares))
    return _solve(sums, names[0], np.concatenate([every[sums.places[name]] for name in names]))


def score_fields(sums: ScoreSums, places: IntArray) -> Score:
    """Test some fields of a departure alone, by their places among all."""
    return _solve(sums, "", places)


@dataclass(frozen=True)
class Unseen:
    """The departure of a kind that its test misses once in ten times and that moves a parameter most.

    `c`: (n_fields,) its coefficients. `parameter`: place of that parameter among the free ones. `sigmas`: how far it is moved, in
    its claimed sigmas.
    """

    c: FloatArray
    parameter: int
    sigmas: float


def find_unseen(sums: ScoreSums, score: Score, level: float, least_share: float = LEAST_SHARE) -> Unseen | None:
    """Find what of a departure a test may miss at its level; None where nothing of it can be told.

    `score`: of the test. `least_share`: of a direction's information that arcs see, and that the camera leaves, below which it is
    left out.
    """
    if score.dof == 0:
        return None
    P, places = sums.P, sums.places[score.name]
    noise = score.left / (sums.n_arcs - len(P) - score.dof)
    apart = _find_apart(sums, P, places, noise, least_share)
    moving = -P @ sums.G_H[places].T @ apart
    moved = np.linalg.norm(moving, axis=1)
    i = int(np.argmax(moved / np.sqrt(np.diag(P))))
    if not moved[i] > 0:
        return None
    size = np.sqrt((np.sqrt(chdtri(score.dof, level)) + NINE_IN_TEN) ** 2 - (score.dof - 1))
    c = apart @ moving[i] * size / moved[i]
    return Unseen(c, i, float(size * moved[i] / np.sqrt(P[i, i])))


def _find_apart(sums: ScoreSums, P: FloatArray, places: slice, noise: float, least_share: float) -> FloatArray:
    """Directions (n_fields, k) that arcs see and the camera leaves enough of, each of noncentrality one in the noise found."""
    size = 1 / np.sqrt(np.maximum(sums.squares[places], np.finfo(float).tiny))
    G_G, G_H = sums.G_G[places, places], sums.G_H[places]
    seen, vectors = np.linalg.eigh(G_G * np.outer(size, size))
    W = size[:, None] * vectors[:, seen > least_share] / np.sqrt(seen[seen > least_share])
    share, vectors = np.linalg.eigh(W.T @ (G_G - G_H @ P @ G_H.T) @ W)
    return np.asarray(W @ vectors[:, share > least_share] * np.sqrt(noise / share[share > least_share]))


@dataclass(frozen=True)
class _Directions:
    """Independent directions of c that the data show.

    `F`, `s`: of all fields, see the module. `inverse`: (n_fields, k), each of information one. `fall`: (k,) along them, whose
    squares are the fall of chi-square. `P`, `towards`: A^-1 and -A^-1 H^T G. `left`: chi-square of the fit.
    """

    F: FloatArray
    s: FloatArray
    inverse: FloatArray
    fall: FloatArray
    P: FloatArray
    towards: FloatArray
    left: float


def _find_directions(sums: ScoreSums, places: IntArray) -> _Directions:
    P, G_H = sums.P, sums.G_H[places]
    F = sums.G_G[np.ix_(places, places)] - G_H @ P @ G_H.T
    s = sums.G_e[places] - G_H @ P @ sums.b
    size = 1 / np.sqrt(np.maximum(sums.squares[places], np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(F * np.outer(size, size))
    known = values > LEAST_SHARE
    inverse = size[:, None] * vectors[:, known] / np.sqrt(values[known])
    return _Directions(F, s, inverse, inverse.T @ s, P, -P @ G_H.T, sums.chi2 - float(sums.b @ P @ sums.b))


def expect(sums: ScoreSums, named: Sequence[str], others: Sequence[str] = ()) -> tuple[FloatArray, FloatArray]:
    """How far parameters are off if departures are real, (n_free,) typical sigmas, and the covariance (n_free, n_free) of it."""
    every = np.arange(len(sums.squares))
    groups = [np.concatenate([every[sums.places[name]] for name in group]) for group in (named, others) if group]
    places = np.concatenate(groups)
    found = _find_directions(sums, places)
    k, freedom = len(found.fall), sums.n_arcs - len(found.P)
    # fields that take up most of a small set leave nothing to tell the noise from
    noise = (found.left - float(found.fall @ found.fall)) / (freedom - k) if 2 * k < freedom else found.left / freedom
    size = 1 / np.sqrt(np.maximum(sums.squares[places], np.finfo(float).tiny))
    F, s = found.F * np.outer(size, size) / noise, found.s * size / noise
    towards = found.towards * size
    sizes = np.stack(np.meshgrid(*[SIZES] * len(groups), indexing="ij"), axis=-1).reshape(-1, len(groups))
    logs, d, square = [], [], []
    for t in sizes:
        T = np.repeat(t, [len(group) for group in groups])
        root = np.linalg.cholesky(F + np.diag(1 / T))
        half = np.linalg.solve(root, np.column_stack([s, towards.T]))
        logs.append(half[:, 0] @ half[:, 0] / 2 - np.log(np.diag(root)).sum() - np.log(T).sum() / 2)
        d.append(half[:, 1:].T @ half[:, 0])
        square.append(half[:, 1:].T @ half[:, 1:])
    weight = np.exp(np.array(logs) - max(logs))
    # where one direction alone shows, sizes beyond the likeliest hardly lose likelihood, and without end they would tell most
    weight *= (sizes <= BEYOND * sizes[int(np.argmax(logs))]).all(axis=1)
    weight /= weight.sum()
    mean, apart = weight @ np.array(d), np.array(d) - weight @ np.array(d)
    return mean, np.tensordot(weight, np.array(square), 1) + apart.T @ (weight[:, None] * apart)


def _solve(sums: ScoreSums, name: str, places: IntArray) -> Score:
    found = _find_directions(sums, places)
    inverse, fall, P = found.inverse, found.fall, found.P
    k, n = len(fall), len(places)
    freedom = sums.n_arcs - len(P) - k
    if k == 0 or freedom < 1:
        nothing = np.zeros(n)
        return Score(name, 0.0, 0, 1.0, nothing, np.zeros((n, n)), np.zeros(len(P)), 0.0, 0.0, found.left, nothing)
    square = float(fall @ fall)
    left = found.left - square
    noise = max(left, np.finfo(float).tiny) / freedom
    c = inverse @ fall
    clear = np.abs(fall) >= min(CLEAR * np.sqrt(noise), float(np.abs(fall).max()))
    by_clear = inverse[:, clear] @ fall[clear]
    misled = np.abs(found.towards @ by_clear) / np.sqrt(np.maximum(np.diag(P), np.finfo(float).tiny))
    p = float(fdtrc(k, freedom, square / k / noise))
    return Score(
        name, square / noise, k, p, c, inverse @ inverse.T * noise, found.towards @ c, float(misled.max()), square, left, by_clear
    )  # fmt: skip
