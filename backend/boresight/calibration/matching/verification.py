r"""Verification of proposed stars: identities that a file gives are proposals, held against one another and against the estimate.

**Vote.** Under a state x with covariance P the arc of two detections i, j differs from that of their proposed stars by

    d_ij = phi(s_i(x), s_j(x)) - phi_ij,        var d_ij = kappa^2 (sigma_i^2 + sigma_j^2) + h_ij^T P h_ij,     h_ij = d phi / dx,

and the two agree where |d_ij| <= `GATE` sigmas. The largest set found in which every two stars agree is believed first; it is right
however wrong the others are, as long as it is larger than any set of wrong stars that agree by chance.

**Gate.** Let r_i be the residual of star i under the attitude of the believed ones, two coordinates across its direction, and
y = (theta, w) the errors of that attitude and, in units of P^(1/2), of the parameters. As in `sky.matching`

    r_i = A_i y + noise,      Lambda = diag(0, I) + sum_j A_j^T A_j / (kappa sigma_j)^2,      t_i = r_i^T S_i^-1 r_i,

with y at its estimate from Lambda. For a star that Lambda holds S_i = (kappa sigma_i)^2 I - A_i Lambda^-1 A_i^T is the covariance
of its residual; for another, with a plus, that of its innovation. Both are the same number, the residual of the deleted star over
its own covariance (matrix inversion lemma): attitude and parameters are marginalised and leverage is in it, so t_i is chi-square
with 2 degrees of freedom and exceeds a limit t with the probability exp(-t / 2). The worst beyond the limit is taken out, then
the nearest within it taken in, one at a time, until nothing moves.

**Limit.** Of n proposed stars each is refused with the probability `FAMILY_LEVEL` / n, and `LARGEST_LEVEL` at most, if it is right:

    t = -2 ln min(FAMILY_LEVEL / n, LARGEST_LEVEL),

so one clean set in a hundred loses any star.

**Cycles.** Before the estimate P is that of the ground calibration and kappa is `START_NOISE`, for stated noise may be too small;
where that refuses more than half of all stars it says more of the start than of the stars, and none is refused. After an estimate
P is that of the estimate, widened by chi-square, and kappa^2 the median of the t_i over 2 ln 2, the median of chi-square with 2
degrees of freedom, where chi-square is above its bound: the median does not follow the stars that are to be found. Every proposed
star is judged again in each cycle, so that none is lost for good, until the set rests.

**Names.** A star is seen once in an exposure. Of detections that all stand under one star the nearest to its place, by t_i, keeps
it; the others are refused, however near they lie.

A first-order residual r misses a share of the correction that it makes, so (`BENT` |r|)^2 is added to its variance.

**Cost.** Few exposures need that closer look. Before the estimate they are those in which one of the estimator's own 2 N - 3 arcs
disagrees. After it, sum_i e_i'^2 over the whitened arcs of an exposure is its chi-square and no t_i can exceed it, since it is t_i
plus the chi-square of the others: exposures below the limit are done.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.calibration.advice_kinds import Advice
from boresight.calibration.calibration import RemovedStar
from boresight.calibration.evaluation.pixel_residuals import FreeCovariance, pixel_residuals
from boresight.calibration.matching.rematch import square_root
from boresight.calibration.problem import Problem
from boresight.calibration.telemetry_pieces import Pieces
from boresight.cameras import CAMERA_MODELS
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import ArcSet
from boresight.estimation.attitude import triad
from boresight.estimation.statistics.consistency import chi_square
from boresight.estimation.stored_arcs import Arcs
from boresight.kernels import verification as loops
from boresight.sky.matching import GATE
from boresight.telemetry.read.checks import repeats_within

#: Of clean sets the share that loses any star, and the largest share of the stars of a small one.
FAMILY_LEVEL, LARGEST_LEVEL = 0.01, 1e-4
#: Statistic beyond which a probability would be written as zero, which none is.
LARGEST_T = 1400.0
#: Stated centroid noise is believed so many times before there is an estimate to measure it by.
START_NOISE = 3.0
#: Share of a correction that its first order misses: 2 px where a ground calibration is 20 px off, little after an estimate.
START_BENT, BENT = 0.1, 0.02
#: Share of the proposed stars beyond which refusals speak against the start.
MOST_REFUSED = 0.5
#: Arcs for each free parameter from which the share of a star in the parameters is too small to matter.
MANY_ARCS = 100
#: Stars of which the noise is measured.
SAMPLE_STARS = 20_000
#: Removed stars that a calibration lists; the others are counted.
MOST_LISTED = 10_000
BY_VOTE = "its arcs to the other stars of its exposure disagree with the catalogue"
BY_GATE = "it is too far from where the other stars of its exposure place it"
BY_NAME = "its star is given twice in its exposure, and the other detection is nearer to the star's place"
REASONS = (BY_VOTE, BY_GATE, BY_NAME)
#: Directions, rad, that are one star's: two of a catalogue that lie so close are one image.
SAME_DIRECTION = 1e-8


@dataclass(frozen=True)
class Refusals:
    """Proposed stars that do not stand, by ascending row.

    `row`: (n,) place in the set. `reason`: (n,) which of `REASONS`. `probability`: (n,) that a right star lies as far from its
    place; NaN where too few others agree to tell.
    """

    row: IntArray
    reason: IntArray
    probability: FloatArray

    @classmethod
    def joined(cls, parts: Sequence[Refusals]) -> Refusals:
        """Put those of parts of a set together."""
        row = np.concatenate([np.zeros(0, np.int64), *(part.row for part in parts)])
        order = np.argsort(row)
        reason = np.concatenate([np.zeros(0, np.int64), *(part.reason for part in parts)])
        probability = np.concatenate([np.zeros(0), *(part.probability for part in parts)])
        return cls(row[order], reason[order], probability[order])

    def __len__(self) -> int:
        """Count them."""
        return len(self.row)

    def differ(self, other: Refusals) -> int:
        """Count the stars that stand by one of the two only."""
        return len(np.setxor1d(self.row, other.row, assume_unique=True))

    def counted(self) -> dict[str, int]:
        """How many were refused for each reason."""
        return dict(zip(REASONS, np.bincount(self.reason, minlength=len(REASONS)).tolist(), strict=True))


NONE = Refusals.joined(())


@dataclass(frozen=True)
class Verification:
    """How the proposed stars of a set are held against a state.

    `camera`, `parity`: of the sensor; the parity is the data's. `x`: (n_parameters,) state, SI. `root`: (n_parameters, n_roots)
    P^(1/2). `noise`: kappa. `limit`: largest t of a star that stands. `before_estimate`: whether the estimator's own arcs, not
    chi-square, tell which exposures to look at. `everywhere`: whether to look at all.
    """

    camera: str
    parity: int
    x: FloatArray
    root: FloatArray
    noise: float
    limit: float
    before_estimate: bool = False
    everywhere: bool = False

    def verify(self, proposed: Arcs) -> Refusals:
        """Verify a set of proposed stars, whitened at x."""
        return Refusals.joined(proposed.over_blocks(_verify_block, self))


def compute_limit(n_stars: int) -> float:
    """Largest statistic of a star that stands, of so many."""
    return float(-2 * np.log(min(FAMILY_LEVEL / max(n_stars, 1), LARGEST_LEVEL)))


def _verify_block(block: ArcSet, how: Verification) -> Refusals:
    """Verify one block of exposures."""
    part = block.exposures(_doubtful(block, how) | _names_twice(block))
    if not part.n_exposures:
        return NONE
    camera = CAMERA_MODELS[how.camera]
    s, ds_dx = camera.directions_and_jacobian(how.x, part.row_px, part.col_px, part.pitch)
    sign = np.array([1.0, float(how.parity), 1.0])[:, None]
    use, voted, t = np.zeros(part.n_stars, np.bool_), np.zeros(part.n_stars, np.bool_), np.empty(part.n_stars)
    sigma = how.noise * arcsets.angular_sigma(camera, how.x, part)
    loops.verify_stars(
        part.star_start, triad(s, how.parity), np.ascontiguousarray(sign * (ds_dx @ how.root)), sigma, part.s_i, GATE,
        how.limit, START_BENT if how.before_estimate else BENT, use, voted, t,
    )  # fmt: skip
    reason = np.where(voted, REASONS.index(BY_GATE), REASONS.index(BY_VOTE))
    second = _second_of_one_name(part, use, t)
    reason[second] = REASONS.index(BY_NAME)
    use[second] = False
    probability = np.where(np.isfinite(t), np.exp(-np.minimum(t, LARGEST_T) / 2), np.nan)
    return Refusals(part.source_row[~use], reason[~use], probability[~use])


def _names_twice(block: ArcSet) -> BoolArray:
    """Exposures (n_exposures,) in which two stars may have one direction: one coordinate tells it, at half the cost."""
    exposure = np.repeat(np.arange(block.n_exposures), np.diff(block.star_start))
    found = np.zeros(block.n_exposures, np.bool_)
    found[exposure[_repeats(exposure, block.s_i[:, :1])]] = True
    return found


def _second_of_one_name(part: ArcSet, use: BoolArray, t: FloatArray) -> IntArray:
    """Stars of a set that stand, by their places, though another of their name stands nearer to its place."""
    standing = np.flatnonzero(use)
    nearest_first = standing[np.argsort(t[standing], kind="stable")]
    exposure = np.repeat(np.arange(part.n_exposures), np.diff(part.star_start))
    return nearest_first[_repeats(exposure[nearest_first], part.s_i[nearest_first])]


def _repeats(exposure: IntArray, s_i: FloatArray) -> IntArray:
    """Places of stars whose direction, or some coordinates of it, (n, 1 to 3), an earlier one of their exposure (n,) has."""
    later, _ = repeats_within(exposure, *np.rint(s_i / SAME_DIRECTION).astype(np.int64).T)
    return later


def _doubtful(block: ArcSet, how: Verification) -> BoolArray:
    """Exposures (n_exposures,) that need a closer look."""
    doubtful = np.ones(block.n_exposures, np.bool_)
    if how.everywhere:
        return doubtful
    if how.before_estimate:
        loops.find_disagreeing(*block.begin_whitened_loop(how.x), how.root, GATE, doubtful)
        return doubtful
    return ~(_chi2_in_block(block, how.x) <= how.limit * how.noise**2)


def _chi2_in_block(block: ArcSet, x: FloatArray) -> FloatArray:
    """Chi-square of each exposure of one block, (n_exposures,)."""
    chi2 = np.empty(block.n_exposures)
    loops.exposure_chi2(*block.begin_whitened_loop(x), chi2)
    return chi2


def measure_noise(arcs: Arcs, x: FloatArray, parity: int) -> float:
    """Return kappa of whitened arcs at x: 1 where chi-square is within its bounds, else from the median of the t_i."""
    chi2 = float(sum(arcs.over_blocks(_chi2_of_block, x)))
    if not arcs.n_arcs or chi2 <= arcs.n_arcs * chi_square(arcs.n_arcs, arcs.n_arcs).upper:
        return 1.0
    step = max(1, arcs.n_stars // SAMPLE_STARS)
    t = np.concatenate(arcs.over_blocks(_statistics_in_block, x, parity, step))
    t = t[np.isfinite(t)]
    return max(1.0, float(np.sqrt(np.median(t) / (2 * np.log(2))))) if len(t) else 1.0


def _chi2_of_block(block: ArcSet, x: FloatArray) -> float:
    return float(_chi2_in_block(block, x).sum())


def _statistics_in_block(block: ArcSet, x: FloatArray, parity: int, step: int) -> FloatArray:
    """Statistics t of the stars of every so many exposures of one block, x taken as known, (n,)."""
    part = block.exposures(np.arange(block.n_exposures) % step == 0)
    nothing = FreeCovariance(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 0)))
    seen = pixel_residuals(part.camera, x, part, parity, nothing)
    r, M = seen.r / part.sigma_px[:, None], seen.M
    determinant = M[:, 0, 0] * M[:, 1, 1] - M[:, 0, 1] ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (M[:, 1, 1] * r[:, 0] ** 2 - 2 * M[:, 0, 1] * r[:, 0] * r[:, 1] + M[:, 0, 0] * r[:, 1] ** 2) / determinant
    return np.asarray(t)


def verification_before(problem: Problem, P: FloatArray, parity: int) -> Verification:
    """How the stars of a problem are held against one another under the sensor's start, of covariance P, SI."""
    sensor = problem.sensor
    return Verification(
        sensor.camera_model, parity, sensor.initial, square_root(P), START_NOISE, compute_limit(problem.arcs.n_stars),
        before_estimate=True,
    )  # fmt: skip


def verification_after(
    proposed: Problem, x: FloatArray, P: FloatArray, noise: float, n_free: int, parity: int
) -> Verification:
    """How the proposed stars of a problem are held against an estimate x of covariance P, SI, centroid errors times `noise`."""
    arcs = proposed.arcs
    return Verification(
        proposed.sensor.camera_model, parity, x, square_root(P), noise, compute_limit(arcs.n_stars),
        everywhere=2 * arcs.n_stars - 3 * arcs.n_exposures < MANY_ARCS * n_free,
    )  # fmt: skip


def list_removed(pieces: Pieces, refused: Refusals) -> Iterator[RemovedStar]:
    """List the first `MOST_LISTED` refused stars of a set by row."""
    rows = refused.row[:MOST_LISTED]
    for piece in pieces.pieces:
        low, high = (int(place) for place in np.searchsorted(rows, [piece.begins, piece.begins + piece.rows]))
        if low == high:
            continue
        telemetry = piece.read()
        for k in range(low, high):
            at = int(rows[k]) - piece.begins
            star = None if telemetry.star_id is None else int(telemetry.star_id[at])
            known = bool(np.isfinite(refused.probability[k]))
            yield RemovedStar(
                frame=int(telemetry.frame[at]),
                exposure=int(telemetry.exposure[at]),
                row=telemetry.first_row + at,
                star_id=star if star is not None and star > 0 else None,
                reason=REASONS[refused.reason[k]],
                probability=float(refused.probability[k]) if known else None,
            )


#: Share of removed stars beyond which a file's identification as a whole is in doubt.
MANY_REMOVED = 0.02


def advise(proposed: int, removed: int, listed: Sequence[RemovedStar]) -> list[Advice]:
    """Say how many proposed stars were removed, why most likely, and what to do."""
    if not removed:
        return []
    first = listed[0]
    named = "" if first.star_id is None else f", HIP {first.star_id}"
    which = f"row {first.row:,} (frame {first.frame}{named})"
    which = f"It is {which}" if removed == 1 else f"The first is {which}; all are listed under Matching"
    many = removed > MANY_REMOVED * proposed
    remedy = (
        "So many mean that the identification is faulty: match the stars again (match 'rematch')"
        if many
        else f"The result does not use {'it' if removed == 1 else 'them'}: correct the file, or match the stars again "
        "(match 'rematch')"
    )
    did = (
        "was removed: the other stars of its exposure contradict it"
        if removed == 1
        else ("were removed: the other stars of their exposures contradict them")
    )
    sentence = (
        f"{removed:,} of {proposed:,} proposed stars {did}, most likely because of wrong identities in the file or false "
        f"detections. {which}. {remedy}."
    )
    return [Advice(sentence, "removed")]
