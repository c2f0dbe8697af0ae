"""What is wrong with a set that its tests call into question: the likeliest cause first.

One cause trips many tests: a decentred lens bends the residual field, spoils two halves and lengthens the tails. So causes are
compared by how well they explain all residuals, and not by which test noticed them. Each is a model of the residuals with its own
number k of coefficients; n are the arcs. Its gain over the camera alone, both with the noise that fits best, is

    n ln(RSS_0 / RSS_j) - k ln n                                displaced stars, from the sums of `displacements`
    2 (ln L_mixture - ln L_normal) - 2 ln n                     wrong identities: a share of the stars lies anywhere within reach
    2 (ln L_t - ln L_normal) - ln n                             heavy tails: Student's distribution with the best of a few degrees
    sum over stars (z^2 - 2 ln n)                               catalogue places: a star seen twice or more, off by z sigmas
    n (r - 1 - ln r) - ln n                                     noise misstated: r times the stated variance

the difference of Schwarz's criterion, less 2 ln m for the best of m places on the ground; of aberration and refraction, of which
all may be missing or none, and of readout, whose lines take some time that is not long, the evidence itself: with c
normal of sigma one beforehand, F and s in units of the noise,

    n ln(RSS_0 / (RSS_0 - s^T (F + I)^-1 s)) - ln det(I + F),                    but no more than by the first line.

e^(gain / 2) is the cause's likelihood beside the camera's (Schwarz 1978). Where more than `FEW` centroids lie `FARTHEST` spreads
off, tails and places are none of the causes: no noise does that, and the attitudes that places rest on are spoiled. r is taken from
what the best displacement leaves, or where the tails are heavy from the median, so that no other cause passes for noise.

A cause explains every test that is not of a single departure (`GENERAL`), its own, and those of other displacements that notice
nothing any more where its coefficients are free. The cause with the largest gain is told first, with its share of likelihood among
all; that the noise is misstated is told last, for every other cause makes it so. A displacement is then taken out, the other
displacements are tested with it free, and what is still noticed comes next. Nothing is told of a set in which no test notices
anything.

Reference: G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6, 1978.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.calibration import Cause, TrustTest
from boresight.calibration.trust.departures import ANY_VELOCITY, SOUGHT
from boresight.calibration.trust.displacements import Score, find_score
from boresight.calibration.trust.fitted_set import UNLIKELY
from boresight.calibration.trust.flaws import Flaw
from boresight.calibration.trust.trust_tests import TRUST_TESTS, Examined, get_test_gate
from boresight.cameras import name_camera_with
from boresight.cameras.model import Role
from boresight.estimation.statistics.special import fdtrc

#: Degrees of freedom of Student's distribution that are tried, and rounds of its fit and of the mixture's.
DEGREES, ROUNDS = (3.0, 4.0, 6.0, 10.0), 30
#: Variance of the noise over the stated one from which on, either way, it is worth a word.
NOISE_OFF = 1.01
#: What the Earth's velocity is, and a satellite's, km/s.
VELOCITIES_KM_S = (29.8, 7.5)
#: Departures whose fields have the size that a coefficient of one gives them.
KNOWN_SIZE = ("aberration", "readout", "refraction")
#: Largest displacement of fields that leave most stars where they are, for a coefficient of one.
LARGEST = {"edges": 1.0, "flaw": float(np.exp(-0.5))}
#: Departures of the directions, whose size is known beforehand: tails of the centroids make none of them.
OF_THE_SKY = ("aberration", "refraction")
#: Fields of a velocity of which nothing is known.
FREE_VELOCITY = 3
#: More centroids than `FEW` beyond so many spreads are no noise, whatever its tails.
FARTHEST, FEW = 30.0, 2
#: Causes of which one alone is told: each takes up most of what the others leave.
ONE_OF = ({"trend", "time", "temperature", "drift"}, {"lens", "tangential", "radial", "edges", "flaw", "seam", "trail"})
#: Sightings of a star that tell its place from one wrong identity.
SEEN_AGAIN = 2


@dataclass(frozen=True)
class CauseKind:
    """One row of the table of causes: its name, what a person reads of it and should do, and the tests that it may trip."""

    name: str
    sentence: str
    remedy: str
    tests: tuple[str, ...]


#: Tests that are no test of one departure: any displacement may trip them.
GENERAL = (
    "residual_field", "residual_spline", "residual_radius", "residual_magnitude", "residual_time", "residual_temperature",
    "two_halves", "whiteness", "nis_over_time", "worst_frames", "chi_square", "residual_distribution", "outliers", "stars",
)  # fmt: skip
#: Every cause by its name; those of displaced stars have the name of their departure.
CAUSES: dict[str, CauseKind] = {
    kind.name: kind
    for kind in (
        CauseKind(
            "tangential",
            "The lens is decentred: tangential distortion that the camera model does not have displaces stars by about {size} px",
            f"calibrate with a camera model that has it, such as {name_camera_with(Role.DECENTRING)}, or free the tilt",
            ("tangential", *GENERAL),
        ),
        CauseKind(
            "radial",
            "The lens has radial distortion of a higher order than is free, which displaces stars by about {size} px",
            "free the higher radial terms, or calibrate with a camera model that has them; `boresight choose` finds the simplest",
            ("radial", *GENERAL),
        ),
        CauseKind(
            "affine",
            "The image is skewed or stretched by about {size} px: lines are read out one after another while the "
            "image moves steadily, or the pixels are not square",
            "state readout mode and line time in the sensor file, or free the aspect where the camera model has one",
            ("affine", *GENERAL),
        ),
        CauseKind(
            "lens",
            "The lens leaves a smooth residual of about {size} px that no simple term describes",
            "try `boresight choose`; if no camera model is sufficient, load the correction table of the residual spline",
            ("lens", *GENERAL),
        ),
        CauseKind(
            "edges",
            "Centroids near the edges of the detector are displaced by about {size} px, as happens to windows cut by the edge",
            "leave out stars whose window crosses the edge, or correct their centroids",
            ("edges", *GENERAL),
        ),
        CauseKind(
            "seam",
            "One half of the detector is displaced against the other by about {size} px, as where each half has its own amplifier",
            "give the centroids of both halves in one pixel frame: look for a column or row that one of them counts twice or skips",
            ("seam", *GENERAL),
        ),
        CauseKind(
            "trail",
            "Stars are displaced by about {size} px, increasing with the distance over which their charge is moved for readout: "
            "charge is left behind",
            "correct the centroids for charge transfer, or calibrate out warm traps; include the remainder in the centroid sigma",
            ("trail", *GENERAL),
        ),
        CauseKind(
            "flaw",
            "A local defect{where} displaces nearby stars by up to {size} px: for example a window flaw, a droplet or dust",
            "leave out stars near it, or load the correction table of the residual spline",
            ("flaw", *GENERAL),
        ),
        CauseKind(
            "readout",
            "Lines are read out one after another: stars are displaced by about {size} px with their line and the image's velocity",
            "state readout mode and line time in the sensor file, or use frames taken without motion",
            ("readout", *GENERAL),
        ),
        CauseKind(
            "trend",
            "The focal length drifts one way during the set, which moves stars by about {size} px",
            "calibrate shorter stretches separately, or run a filter with process noise and use its last state",
            ("trend", *GENERAL),
        ),
        CauseKind(
            "time",
            "The focal length changes during the set, which moves stars by about {size} px",
            "calibrate shorter stretches separately, or run a filter with process noise and use its last state",
            ("time", *GENERAL),
        ),
        CauseKind(
            "temperature",
            "The focal length changes with temperature, which moves stars by about {size} px",
            "calibrate at operating temperatures, or make one set per temperature range",
            ("temperature", *GENERAL),
        ),
        CauseKind(
            "drift",
            "The camera drifts over the set, not only in its focal length",
            "calibrate shorter stretches separately, or run a filter with process noise and use its last state",
            ("drift", *GENERAL),
        ),
        CauseKind(
            "exposure",
            "The camera differs between the exposures of a frame: parameters change from the first exposure to the last",
            "calibrate them separately; check exposure times, motion during the exposure and how each is read",
            ("exposure", *GENERAL),
        ),
        CauseKind(
            "magnitude",
            "Centroids shift with brightness, by about {size} px between the brightest and the faintest stars",
            "check saturation, background and charge transfer in the centroiding, or leave the brightest stars out",
            ("magnitude", *GENERAL),
        ),
        CauseKind(
            "colour",
            "Centroids depend on the star's colour, by about {size} px: the lens is not achromatic",
            "restrict the set to stars of similar colour, or add the colour term to the noise model",
            ("colour", *GENERAL),
        ),
        CauseKind(
            "phase",
            "Centroids shift towards fixed places within the pixel, by about {size} px",
            "correct the centroiding for pixel phase, or defocus more; otherwise state a larger centroid sigma",
            ("phase", *GENERAL),
        ),
        CauseKind(
            "aberration",
            "Directions do not match the satellite's velocity: the velocity is off by {size} km/s",
            "give apparent directions, or the satellite's velocity and correct times; J2000 positions are not apparent",
            ("aberration", *GENERAL),
        ),
        CauseKind(
            "refraction",
            "These residuals look like refraction: stars are displaced {size} times as much as by a standard atmosphere",
            "give the site in the sensor file (`site`: latitude_deg, longitude_deg, pressure_hpa, temperature_c), or on the "
            "command line with --site, and times in UTC; if directions in the telemetry include refraction already, declare it "
            "corrected",
            ("refraction", *GENERAL),
        ),
        CauseKind(
            "identities",
            "Single stars are misidentified or are not stars: about {size} % of the sightings are too far off to be explained by "
            "noise",
            "match the stars again (`--match rematch`) and check the outliers",
            tuple(kind.name for kind in TRUST_TESTS),
        ),
        CauseKind(
            "places",
            "{size} stars are off their catalogue positions in all their sightings",
            "leave them out: they are double, or their catalogue entries are wrong",
            GENERAL,
        ),
        CauseKind(
            "tails",
            "The centroid noise has heavier tails than the normal distribution: Student's with {size} degrees of freedom fits",
            "check for hot pixels and blends, or calibrate with robust 'stars'",
            GENERAL,
        ),
        CauseKind(
            "noise",
            "The centroid noise is {size} times the stated one, and the claimed sigmas are off by the same factor",
            "state it so in the sensor file or with the telemetry",
            ("chi_square", "nis_over_time", "worst_frames", "two_halves"),
        ),
    )
}
UNKNOWN = CauseKind(
    "unknown",
    "The data contradict the model, but no known cause explains it",
    "Check the tests that detected it",
    tuple(kind.name for kind in TRUST_TESTS),
)


#: Gates of the causes that are no displacement; the others have that of the test of their name.
GATES_OF_OTHERS = {
    "identities": "identities",
    "places": "identities",
    "tails": "centroid-noise",
    "noise": "centroid-noise",
}


def get_cause_gate(name: str) -> str:
    """The gate that hears of a cause."""
    return GATES_OF_OTHERS.get(name) or get_test_gate(name)


@dataclass(frozen=True)
class Candidate:
    """A cause with its gain, and the number that its sentence tells."""

    name: str
    gain: float
    size: float


def find_causes(examined: Examined, tests: Sequence[TrustTest]) -> list[Cause]:
    """Name what explains the tests that noticed something, the likeliest first; none where no test did."""
    noticed = [test.name for test in sorted(tests, key=lambda test: test.probability) if test.noticed]
    if not noticed:
        return []
    candidates = [*_find_displacements(examined), *_find_star_causes(examined)]
    candidates.append(_noise(examined, candidates))
    found = _in_order(examined, [one for one in candidates if one.gain > 0], noticed)
    explained = _explained(examined, [one.name for one, _ in found if one.name in examined.scores], noticed)
    causes = [
        _describe(examined, one, share, noticed, explained if not place else ())
        for place, (one, share) in enumerate(found)
    ]
    causes = [cause for place, cause in enumerate(causes) if cause.tests or not place]
    return causes or [_guess(examined, candidates, noticed)]


def _explained(examined: Examined, free: list[str], noticed: list[str]) -> list[str]:
    """Tests of displacements that notice nothing any more where those that were found are free."""
    others = [name for name in noticed if name in examined.scores and name not in free]
    return [name for name in others if free and not _notices(examined, free, name)]


def _notices(examined: Examined, free: list[str], name: str) -> float:
    """Gain of a displacement beside those that are free where its test notices it there; else 0."""
    alone, both = find_score(examined.sums, *free), find_score(examined.sums, *free, name)
    k, n = both.dof - alone.dof, examined.sums.n_arcs
    if k < 1:
        return 0.0
    freedom = n - both.dof - len(examined.sums.A)
    p = fdtrc(k, freedom, (alone.left - both.left) / k / (both.left / freedom)) * examined.trials.get(name, 1)
    return (
        max(float(n * np.log(alone.left / both.left) - (k + SOUGHT.get(name, 0)) * np.log(n)), 0.0)
        if p < UNLIKELY
        else 0.0
    )


def _guess(examined: Examined, candidates: list[Candidate], noticed: list[str]) -> Cause:
    """Name the best of the causes that may trip the tests where none explains the residuals better than the camera alone."""
    may = [
        one for one in candidates if set(noticed) & set(CAUSES[one.name].tests) and one.name not in {"places", "noise"}
    ]
    best = max(may, key=lambda one: (one.name == noticed[0], one.gain), default=None)
    if best is not None:
        return _describe(examined, best, _share(best, may), noticed)
    return Cause(
        name="unknown", likelihood=1.0, sentence=f"{UNKNOWN.sentence}.", remedy=f"{UNKNOWN.remedy}.", tests=noticed
    )


def _gain(n: int, before: Score, coefficients: int) -> float:
    """Gain of a displacement whose fall and rest of chi-square are known."""
    return float(n * np.log((before.fall + before.left) / before.left) - coefficients * np.log(n))


def _evidence(n: int, score: Score) -> float:
    """Gain of a departure whose coefficients were known to be of order one beforehand."""
    F = np.linalg.pinv(score.covariance, rcond=1e-12, hermitian=True)
    s, one = F @ score.c, np.eye(len(score.c))
    fall = score.fall / max(score.statistic, 1e-9) * float(s @ np.linalg.solve(F + one, s))
    before = score.fall + score.left
    evidence = n * np.log(before / (before - fall)) - np.linalg.slogdet(one + F)[1]
    return min(float(evidence), _gain(n, score, score.dof))


def _find_displacements(examined: Examined) -> list[Candidate]:
    n = examined.sums.n_arcs
    return [
        Candidate(
            name,
            (_evidence(n, score) if name in KNOWN_SIZE else _gain(n, score, score.dof + SOUGHT.get(name, 0)))
            - 2 * np.log(examined.trials.get(name, 1)),
            _size(examined, name, score),
        )
        for name, score in examined.scores.items()
        if score.dof and score.left > 0
    ]


def _size(examined: Examined, name: str, score: Score) -> float:
    """How far a departure still displaces stars, as the amplitude of a wave would: its root mean square times the root of two.

    Of aberration the velocity, km/s; of what is near the edges or about one place the largest displacement there; of refraction
    how many times that of the usual air.
    """
    if name in LARGEST:
        return abs(float(score.c[0])) * LARGEST[name]
    if name == "refraction":
        return float(np.abs(score.c[0]))
    if name == "aberration":
        speeds = VELOCITIES_KM_S[: len(score.c)] if len(score.c) < FREE_VELOCITY else [ANY_VELOCITY] * FREE_VELOCITY
        return float(np.linalg.norm(score.c * speeds))
    sigma = float(np.sqrt(np.mean(examined.fitted.arcs.sigma_px**2)))
    return sigma * float(np.sqrt(2 * max(score.fall - score.dof, 0.0) / examined.sums.n_arcs))


def _find_star_causes(examined: Examined) -> list[Candidate]:
    """Causes that single stars show."""
    found = examined.found
    if found is None:
        return []
    q = np.sum(found.z[found.known] ** 2, axis=1)
    n = 2 * len(q)
    plain = _normal(q)
    mixed, share = _mixture(q)
    student, degrees = _student(q)
    gross = np.sum(q > (FARTHEST * found.spread) ** 2) > FEW
    if gross:
        student = -np.inf
    candidates = [
        Candidate("identities", 2 * (mixed - plain) - 2 * np.log(n), 100 * share),
        Candidate("tails", 2 * (student - plain) - np.log(n), degrees),
    ]
    return candidates if gross else [*candidates, *_find_mixed_places(examined, n)]


def _find_mixed_places(examined: Examined, n: int) -> list[Candidate]:
    """Stars that are off in all their sightings."""
    table = examined.table
    if table is None:
        return []
    off = table.suspect & (table.sightings >= SEEN_AGAIN)
    return [Candidate("places", float(np.sum(table.z[off] ** 2 - 2 * np.log(n))), float(off.sum()))]


def _normal(q: FloatArray) -> float:
    """Log likelihood of squared residuals q (n,) along two axes, the variance being what fits best."""
    variance = max(float(np.mean(q)) / 2, np.finfo(float).tiny)
    return float(np.sum(-q / (2 * variance)) - len(q) * np.log(2 * np.pi * variance))


def _mixture(q: FloatArray) -> tuple[float, float]:
    """Log likelihood with a share of the stars anywhere within the farthest, and that share, by expectation and maximisation."""
    area = np.pi * max(float(q.max()), 1.0)
    share, variance = 0.01, float(np.median(q)) / (2 * np.log(2))
    for _ in range(ROUNDS):
        good = (1 - share) * np.exp(-q / (2 * variance)) / (2 * np.pi * variance)
        wrong = share / area
        weight = good / (good + wrong)
        share = float(np.clip(1 - weight.mean(), 1e-9, 1 - 1e-9))
        variance = max(float(np.sum(weight * q) / (2 * weight.sum())), np.finfo(float).tiny)
    return float(np.sum(np.log(good + wrong))), share


def _student(q: FloatArray) -> tuple[float, float]:
    """Log likelihood of Student's distribution in two dimensions, and its degrees of freedom."""
    return max(_fit_student(q, degrees) for degrees in DEGREES)


def _fit_student(q: FloatArray, degrees: float) -> tuple[float, float]:
    variance = float(np.median(q)) / (2 * np.log(2))
    for _ in range(ROUNDS):
        weight = (degrees + 2) / (degrees + q / variance)
        variance = max(float(np.mean(weight * q)) / 2, np.finfo(float).tiny)
    value = -(degrees + 2) / 2 * np.log1p(q / (degrees * variance)) - np.log(2 * np.pi * variance)
    return float(np.sum(value)), degrees


def _noise(examined: Examined, others: Sequence[Candidate]) -> Candidate:
    """Noise of another size than stated, after the best of the other causes."""
    n = examined.sums.n_arcs
    best = max(others, key=lambda one: one.gain, default=None)
    left = examined.scores[next(iter(examined.scores))]
    variance = (left.fall + left.left) / (n - len(examined.sums.A))
    if best is not None and best.gain > 0:
        if best.name in examined.scores:
            variance = examined.scores[best.name].left / (n - len(examined.sums.A) - examined.scores[best.name].dof)
        elif examined.found is not None:
            variance = examined.found.spread**2
    off = n * (variance - 1 - np.log(variance)) - np.log(n)
    little = 1 / NOISE_OFF < variance < NOISE_OFF
    return Candidate("noise", -np.inf if little else float(off), float(np.sqrt(variance)))


def _in_order(examined: Examined, candidates: list[Candidate], noticed: list[str]) -> list[tuple[Candidate, float]]:
    """Take the best, then what is still noticed beside it, and so on; each with its share of likelihood at its turn."""
    left, found = list(candidates), list[tuple[Candidate, float]]()
    while left:
        special = [one for one in left if one.name != "noise"]
        best = max(special or left, key=lambda one: one.gain)
        found.append((best, _share(best, special or left)))
        left = _beside(examined, [one for one, _ in found], [one for one in left if one is not best], noticed)
    return found


def _share(one: Candidate, among: list[Candidate]) -> float:
    """Share of a candidate's likelihood among some that it is one of, and the camera with no cause at all."""
    gains = np.array([0.0, *(other.gain for other in among)])
    return float(1 / np.sum(np.exp(np.clip((gains - one.gain) / 2, -700, 700))))


def _beside(examined: Examined, taken: list[Candidate], left: list[Candidate], noticed: list[str]) -> list[Candidate]:
    """What stands beside the causes that were taken: displacements with theirs free, and those of another kind."""
    free = [one.name for one in taken if one.name in examined.scores]
    stars = {"identities", "tails", "places"}
    told = {one.name for one in taken}
    found = []
    for one in left:
        if any(one.name in group and told & group for group in ONE_OF):
            continue
        if one.name not in examined.scores:
            if not (stars & told - {"tails"} if one.name == "noise" else free or stars & told):
                found.append(one)
            continue
        if not free:
            of_sky = one.name in OF_THE_SKY and one.name in noticed and stars & told == {"tails"}
            if stars & told and not of_sky:
                continue  # what displaces stars can be told when the stars are right
            found.append(one)
            continue
        gain = _notices(examined, free, one.name)
        if gain > 0:
            found.append(replace(one, gain=gain))
    return found


def _describe(
    examined: Examined, one: Candidate, share: float, noticed: list[str], besides: Sequence[str] = ()
) -> Cause:
    kind = CAUSES[one.name]
    if one.name == "noise" and np.isfinite(examined.fitted.threshold):
        kind = replace(
            kind,
            sentence="The centroid noise is {size} times the stated one; the sigmas use the measured scale",
        )
    flaw = examined.fitted.computed.get("flaw")
    where = f" at row {flaw.row_px:.0f}, column {flaw.col_px:.0f}" if isinstance(flaw, Flaw) else ""
    return Cause(
        name=one.name,
        likelihood=share,
        sentence=kind.sentence.format(size=f"{one.size:.2g}", where=where) + ".",
        remedy=kind.remedy[0].upper() + kind.remedy[1:] + ".",
        tests=[name for name in noticed if name in kind.tests or name in besides],
    )
