"""Which star is which: the ground's re-run of a tracker's matching, under any parameters and with what is known of their errors.

From where the attitude comes, in this order:

1. the matches given in the file, after their arcs have voted out the wrong ones (three must agree, or two of at most three);
2. the frame's other exposure; the quaternion in the file; the attitude of the neighbouring frames, carried on at constant rate;
3. lost-in-space identification, which gives an attitude and nothing else.

2 and 3 only say where to look: a first set of stars is found by geometric voting. Every pair (detection, star) near
enough to the start votes for every other pair whose arc agrees, and the largest set in which all agree is kept.

Growth. The tolerance follows from the centroid noise and the present uncertainty of the parameters. Let theta be the
attitude's error and x = x_0 + P^(1/2) w the true parameters, w ~ N(0, I). To first order a detection's residual is
linear in (theta, w) (`kernels.matching`), so the stars already matched, in both exposures, condition a Gaussian, and
every other star of the frame has a predicted place with a covariance V of its own: wide in an unvisited corner under a
ground calibration, the bare centroid noise under a good one. A detection takes the star inside its gate, nu^T V^-1 nu <
GATE^2, when

- no other star, and no other detection, is nearly as likely (a likelihood ratio of e^4.5 or more must stand between them),
- the gate is small enough that it would hold less than 0.03 chance stars;

the best predicted first, and then all are predicted again. What a frame's stars say of the parameters serves that frame
alone, so the answer depends on x_0 and P, not on the order of the frames.

Verification. A star that the joint fit of all the others rejects is dropped; then all arcs are compared pair by pair
with the catalogue's, inside GATE sigma of their own variance, and stars that disagree with most others are dropped: the
check that flight code does. An exposure with N_min = 4 stars left is valid. Its attitude is Wahba's, with the
covariance of centroid noise and of the parameters through it.

References
----------
Kolomenkin, Pollak, Shimshoni, Lindenbaum, "Geometric voting algorithm for star trackers", IEEE TAES 44, 2008. Markley, "Attitude
determination using vector observations and the singular value decomposition", J. Astronaut. Sci. 36, 1988.

What a tracker detected, ready to be matched with the sky.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.estimation.attitude import to_matrix, to_quaternion
from boresight.estimation.blocks import in_blocks
from boresight.kernels import matching as loops
from boresight.sky.guide_stars import GuideStars, ObserverMotion
from boresight.sky.identification import carried_on


@dataclass(frozen=True)
class Detections:
    """Detections of a set in the right-handed triad of D, exposure after exposure.

    Parameters
    ----------
    frame_start
        (n_frames + 1,) first exposure of each frame.
    row_start
        (n_exposures + 1,) first detection of each exposure.
    s
        (n_rows, 3) measured directions under the parameters matched with.
    G
        (n_rows, 3, p) their derivative times the square root of the parameters' covariance, ds/dx P^(1/2).
    sigma_rad
        (n_rows,) isotropic direction error.
    star_id
        (n_rows,) given Hipparcos numbers, 0 = none.
    given_s
        (n_rows, 3) apparent directions of the given stars, ICRS, NaN where there is none.
    own
        (n_rows,) True where that direction is the file's own and not the catalogue's.
    quaternion
        (n_exposures, 4) attitude given in the file, x y z w, ICRS to the triad; NaN where there is none.
    time_s
        (n_frames,) time of each frame, seconds from any epoch; NaN where unknown.
    """

    frame_start: IntArray
    row_start: IntArray
    s: FloatArray
    G: FloatArray
    sigma_rad: FloatArray
    star_id: IntArray
    given_s: FloatArray
    own: NDArray[np.bool_]
    quaternion: FloatArray
    time_s: FloatArray

    @property
    def n_exposures(self) -> int:
        """Number of exposures."""
        return len(self.row_start) - 1

    def frames(self, chosen: IntArray) -> tuple[Detections, IntArray, IntArray]:
        """Return some frames as a set of their own, with the places of its rows and exposures in this one."""
        if len(chosen) == len(self.frame_start) - 1:
            return self, np.arange(len(self.star_id)), np.arange(self.n_exposures)
        exposures = _ranges(self.frame_start, chosen)
        rows = _ranges(self.row_start, exposures)
        part = Detections(
            frame_start=np.append(0, np.cumsum(np.diff(self.frame_start)[chosen])),
            row_start=np.append(0, np.cumsum(np.diff(self.row_start)[exposures])),
            s=self.s[rows],
            G=self.G[rows],
            sigma_rad=self.sigma_rad[rows],
            star_id=self.star_id[rows],
            given_s=self.given_s[rows],
            own=self.own[rows],
            quaternion=self.quaternion[exposures],
            time_s=self.time_s[chosen],
        )
        return part, rows, exposures


def _ranges(start: IntArray, chosen: IntArray) -> IntArray:
    """All places start[k] to start[k + 1] of the chosen k, one after another."""
    counts = np.diff(start)[chosen]
    offsets = np.repeat(start[chosen] - np.append(0, np.cumsum(counts))[:-1], counts)
    return np.asarray(np.arange(counts.sum()) + offsets, np.int64)


#: Gates are this many sigma wide: one true star in 25,000 falls outside by chance.
GATE = 4.5
ROW_REASONS = (
    "matched",
    "no catalogue star within the tolerance",
    "two stars or two detections fit about equally well",
    "the tolerance is too wide to exclude a chance match",
    "its arcs to the other stars disagree with the catalogue",
    "no attitude to start from",
    "too few other stars of its exposure were matched",
    "left out as a double or for its unreliable astrometry",
    "its centroid is off the detector",
    "left out because a close neighbour shifts its centroid",
)
STARTS = (
    "none",
    "given matches",
    "other exposure",
    "quaternion",
    "neighbouring frame",
    "lost in space",
)
EXPOSURE_REASONS = (
    "valid",
    "no attitude to start from: too few given matches, and no matching quaternion, neighbour or lost-in-space solution",
    "too few stars agree with the catalogue",
    "no time, so catalogue stars have no direction",
)
NO_TIME = EXPOSURE_REASONS.index("no time, so catalogue stars have no direction")
LEFT_OUT = ROW_REASONS.index("left out as a double or for its unreliable astrometry")
BLENDED = ROW_REASONS.index("left out because a close neighbour shifts its centroid")
OFF_DETECTOR = ROW_REASONS.index("its centroid is off the detector")
OTHER_EXPOSURE, QUATERNION, NEIGHBOUR, LOST = (
    STARTS.index(name) for name in ("other exposure", "quaternion", "neighbouring frame", "lost in space")
)

#: How far the first stars are sought from where a start says, rad: under a ground calibration the boresight may be off by degrees.
START_RADIUS = {OTHER_EXPOSURE: 0.03, QUATERNION: 0.06, NEIGHBOUR: 0.06, LOST: 0.03}
NEIGHBOUR_ROUNDS = 8
#: Frames a block: their matching takes some milliseconds, and a block's own space for the guide stars nothing beside it.
FRAMES = 256
#: Frames that lost-in-space identification may fail on in a row before it is given up: under a wrong focal length it knows none.
GIVE_UP = 40

Identify = Callable[[int], FloatArray | None]


@dataclass(frozen=True)
class Association:
    """What matching says; arrays over detections and exposures as in `Detections`.

    Parameters
    ----------
    star_id
        (n_rows,) matched Hipparcos number, 0 = none.
    s_i
        (n_rows, 3) apparent direction of the matched star, ICRS, NaN where none.
    row_reason
        (n_rows,) place in `ROW_REASONS`.
    tolerance_rad
        (n_rows,) radius of the gate about the place that the frame's other stars predict; NaN where unmatched.
    start
        (n_exposures,) place in `STARTS`.
    reason
        (n_exposures,) place in `EXPOSURE_REASONS`.
    C
        (n_exposures, 3, 3) attitude, ICRS to the triad, NaN where not valid.
    covariance
        (n_exposures, 3, 3) of the attitude about the axes of D, rad^2: centroid noise and parameters.
    """

    star_id: IntArray
    s_i: FloatArray
    row_reason: NDArray[np.int8]
    tolerance_rad: FloatArray
    start: NDArray[np.int8]
    reason: NDArray[np.int8]
    C: FloatArray
    covariance: FloatArray


def match(
    detections: Detections,
    stars: GuideStars,
    motion: ObserverMotion,
    cone_rad: float,
    minimum_stars: int,
    identify: Identify | None = None,
) -> Association:
    """Match every frame, those without a start after their neighbours.

    Parameters
    ----------
    detections
        What was seen.
    stars
        What may be matched with.
    motion
        Time and velocity of each exposure.
    cone_rad
        Angle from the boresight to the farthest corner of the detector.
    minimum_stars
        Stars that make an exposure valid (E: N_min = 4).
    identify
        Lost-in-space identification of one exposure: its quaternion or None; not asked when None.
    """
    answer = _empty(detections)
    everything = np.arange(len(detections.frame_start) - 1)
    hint, kind = detections.quaternion.copy(), np.where(np.isnan(detections.quaternion[:, 0]), 0, QUATERNION)
    run = _Matcher(detections, stars, motion, cone_rad, minimum_stars, answer)
    run(everything, hint, kind, believe=True)
    if len(lost := run.unsolved()):
        run(lost, hint, kind)  # their given matches may be wrong
    _fill_from_exposures(run)
    _fill_from_neighbours(run)
    if identify is not None and len(lost := run.unsolved()):
        _identify(run, lost, identify)
        _fill_from_neighbours(run)
    return answer


def _empty(detections: Detections) -> Association:
    n, e = len(detections.star_id), detections.n_exposures
    return Association(
        star_id=np.zeros(n, np.int64),
        s_i=np.full((n, 3), np.nan),
        row_reason=np.full(n, loops.NO_ATTITUDE, np.int8),
        tolerance_rad=np.full(n, np.nan),
        start=np.zeros(e, np.int8),
        reason=np.ones(e, np.int8),
        C=np.full((e, 3, 3), np.nan),
        covariance=np.full((e, 3, 3), np.nan),
    )


class _Matcher:
    """Runs the compiled loop over some frames and puts their answer in place."""

    def __init__(
        self,
        detections: Detections,
        stars: GuideStars,
        motion: ObserverMotion,
        cone_rad: float,
        minimum_stars: int,
        answer: Association,
    ) -> None:
        self.detections, self.answer = detections, answer
        self._stars, self._motion, self._cone, self._minimum_stars = stars, motion, cone_rad, minimum_stars

    def unsolved(self) -> IntArray:
        """Frames of which no exposure is valid."""
        valid = np.logical_or.reduceat(self.answer.reason == 0, self.detections.frame_start[:-1])
        return np.flatnonzero(~valid)

    def __call__(self, frames: IntArray, hint: FloatArray, kind: IntArray, *, believe: bool = False) -> None:
        """Match frames with hints (n_exposures, 4) of kinds (n_exposures,); exposures with more stars than before replace these.

        `believe` starts from the given matches where they agree among themselves.
        """
        part, rows, exposures = self.detections.frames(frames)
        n, e, stars, motion = len(rows), len(exposures), self._stars, self._motion
        star_id, direction, reason = np.zeros(n, np.int64), np.full((n, 3), np.nan), np.zeros(n, np.int64)
        tolerance = np.full(n, np.nan)
        start, valid = np.zeros(e, np.int64), np.zeros(e, np.bool_)
        C, covariance = np.zeros((e, 3, 3)), np.zeros((e, 3, 3))
        kind = kind[exposures]
        radius = np.array([START_RADIUS.get(place, 0.0) for place in range(len(STARTS))])[kind]
        hints, any_own = to_matrix(hint[exposures]), bool(part.own.any())
        above = np.zeros((len(motion.years), 5)) if motion.air is None else motion.air
        years, earth_au, beta, air = (
            values[exposures] for values in (motion.years, motion.earth_au, motion.beta, above)
        )

        guides = loops.Guides(stars.hip, stars.place, stars.motion, stars.parallax_rad, stars.density)
        rules = loops.Rules(any_own, believe, self._cone, GATE, self._minimum_stars)

        def match_block(first: int, last: int) -> None:
            e0, e1 = part.frame_start[first], part.frame_start[last]
            r0, r1 = part.row_start[e0], part.row_start[e1]
            x, r = slice(e0, e1), slice(r0, r1)
            sigma = part.sigma_rad[r]
            seen = loops.Seen(
                part.s[r], part.G[r], sigma, 1.0 / (sigma * sigma), part.star_id[r], part.given_s[r], part.own[r]
            )
            frame_start, row_start = part.frame_start[first : last + 1] - e0, part.row_start[e0 : e1 + 1] - r0
            loops.match_frames(
                frame_start,
                row_start,
                seen,
                loops.Observer(years[x], earth_au[x], beta[x], air[x]),
                guides,
                loops.Hints(hints[x], radius[x], kind[x]),
                rules,
                loops.AssociationArrays(
                    star_id[r], direction[r], reason[r], tolerance[r], start[x], valid[x], C[x], covariance[x]
                ),
                loops.frame_space(frame_start, row_start, seen.G.shape[2], len(stars.hip)),
            )

        in_blocks(match_block, len(frames), FRAMES)
        before = np.add.reduceat(self.answer.star_id[rows] > 0, part.row_start[:-1], dtype=np.int64)
        after = np.add.reduceat(star_id > 0, part.row_start[:-1], dtype=np.int64)
        new = (after > before) | ((before == 0) & (self.answer.start[exposures] == 0))
        new_rows = np.repeat(new, np.diff(part.row_start))
        rows, exposures = rows[new_rows], exposures[new]
        self.answer.star_id[rows], self.answer.s_i[rows] = star_id[new_rows], direction[new_rows]
        self.answer.row_reason[rows] = reason[new_rows]
        self.answer.tolerance_rad[rows] = np.where(star_id > 0, tolerance, np.nan)[new_rows]
        self.answer.start[exposures] = start[new]
        self.answer.reason[exposures] = np.where(valid, 0, np.where(start == 0, 1, 2))[new]
        self.answer.C[exposures], self.answer.covariance[exposures] = C[new], covariance[new]


def _fill_from_exposures(run: _Matcher) -> None:
    """Match exposures that their given matches led astray from the attitude of the frame's other exposure."""
    frame_start, valid = run.detections.frame_start, run.answer.reason == 0
    counts = np.add.reduceat(valid, frame_start[:-1], dtype=np.int64)
    partly = np.flatnonzero((counts > 0) & (counts < np.diff(frame_start)))
    if not len(partly):
        return
    hint = np.full((run.detections.n_exposures, 4), np.nan)
    for k in partly:
        exposures = np.arange(frame_start[k], frame_start[k + 1])
        hint[exposures] = to_quaternion(run.answer.C[exposures[valid[exposures]][0]])
    run(partly, hint, np.where(np.isnan(hint[:, 0]), 0, OTHER_EXPOSURE))


def _fill_from_neighbours(run: _Matcher) -> None:
    """Match unsolved frames from the attitudes of solved neighbours, outwards, until no more are solved."""
    for _ in range(NEIGHBOUR_ROUNDS):
        lost = run.unsolved()
        if not len(lost) or len(lost) == len(run.detections.time_s):
            return
        hint, hinted = carried_on(
            run.detections.frame_start, run.detections.time_s, run.answer.reason == 0, run.answer.C, lost
        )
        if not len(hinted):
            return
        run(hinted, hint, np.where(np.isnan(hint[:, 0]), 0, NEIGHBOUR))
        if len(run.unsolved()) == len(lost):
            return


def _identify(run: _Matcher, lost: IntArray, identify: Identify) -> None:
    """Ask the lost-in-space identification for the exposures of lost frames, and match those it answers for."""
    frame_start = run.detections.frame_start
    hint = np.full((run.detections.n_exposures, 4), np.nan)
    in_vain = 0
    for k in lost:
        for e in range(frame_start[k], frame_start[k + 1]):
            quaternion = identify(e)
            if quaternion is not None:
                hint[e] = quaternion
                in_vain = 0
        in_vain += 1
        if in_vain > GIVE_UP:
            break
    answered = np.flatnonzero(np.logical_or.reduceat(np.isfinite(hint[:, 0]), frame_start[:-1]))
    if len(answered):
        run(answered, hint, np.where(np.isnan(hint[:, 0]), 0, LOST))
