"""Every test of the data against the model, as one table: what it asks, what it says, what helps, and the gate that hears of it.

All tests that a set allows are one family. Holm's correction (1979) takes their probabilities in ascending order p_1 <= ... <= p_m,

    adjusted_i = max over j <= i of (m - j + 1) p_j,        noticed where adjusted < FAMILY_LEVEL,

which holds the chance that a sound set is called into question by any of them to `FAMILY_LEVEL`, however the tests hang together.
`UNLIKELY` is what one of them must fall below for it alone; the parts of trust say "more than noise explains" by the same number.

What a finding matters is told in claimed sigmas. A displacement that stays (a lens, a drift) is an error of the directions
themselves: with fall the fall of chi-square that k coefficients bring, the whitened arcs are off by sqrt(fall - k), where n_free
parameters claim sqrt(n_free), and where it moves a parameter farther that counts: `misled` of `displacements`. One that does not
belong to the camera (pixel phase, colour, aberration) does harm by what it does to the parameters alone. What moves stars by less
than `LITTLE` of their noise is never more than `MATTERS` sigmas, so that a very large set does not fail on nothing.

Reference: S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J. Statist. 6, 1979.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from boresight.calibration.calibration import TrustTest
from boresight.calibration.trust.displacements import Score, ScoreSums
from boresight.calibration.trust.field import two_sided
from boresight.calibration.trust.fitted_set import FAMILY_LEVEL, FittedSet, probability
from boresight.calibration.trust.innovations import deviates
from boresight.calibration.trust.residuals import StarResiduals
from boresight.calibration.trust.stars import StarTable
from boresight.estimation.batch import covariance
from boresight.estimation.statistics.consistency import CONFIDENCE
from boresight.estimation.statistics.special import chdtrc, ndtr

#: Claimed sigmas from which on an error fails a set, and share of a star's noise below which none does.
MATTERS, LITTLE = 3.0, 0.05
#: The departure of a decentred lens.
TANGENTIAL = "tangential"
#: Departures that belong to the lens, the detector or the light on it and stay: what the tests may miss of each is told.
STAYING = (TANGENTIAL, "radial", "affine", "lens", "magnitude", "seam", "trail")
#: Frames that tell a spread of their own.
FEWEST_FRAMES = 20
#: Spreads beyond which a sighting is taken out to see what it did to the parameters.
FAR_OFF = 5.0


@dataclass(frozen=True)
class Examined:
    """What the tests look at: a fitted set, its score tests, the parts of its trust, and its star residuals where it has any.

    `trials`: of how many the departure of a name is the best, where it is of more than one.
    """

    fitted: FittedSet
    sums: ScoreSums
    scores: Mapping[str, Score]
    parts: Mapping[str, object]
    found: StarResiduals | None
    table: StarTable | None
    trials: Mapping[str, int] = field(default_factory=dict)


#: Probability of as much where all is as the model says, and the size in claimed sigmas, where it is known.
Outcome = tuple[float, float | None]


@dataclass(frozen=True)
class TrustTestKind:
    """One row of the table.

    `title`: as a table says it. `gate`: that hears of it. `finding`, `sound`: what a noticed test says, and what another. `ask`:
    its outcome; None where the set does not allow it.
    """

    name: str
    title: str
    gate: str
    finding: str
    sound: str
    ask: Callable[[Examined], Outcome | None]


def _excess(examined: Examined, score: Score) -> float:
    """Error of the arcs by a displacement that stays, in claimed sigmas."""
    return float(np.sqrt(max(score.fall - score.dof, 0.0) / len(examined.sums.A)))


def _bounded(examined: Examined, score: Score, effect: float) -> float:
    """The same, but no failure where stars move by next to nothing."""
    little = score.fall < LITTLE**2 * examined.sums.n_arcs
    return min(effect, MATTERS) if little else effect


def _ask_score(name: str, *, stays: bool) -> Callable[[Examined], Outcome | None]:
    """Ask the score test of a departure."""

    def ask(examined: Examined) -> Outcome | None:
        score = examined.scores.get(name)
        if score is None or score.dof == 0:
            return None
        effect = max(_excess(examined, score), score.misled) if stays else score.misled
        return min(1.0, score.p * examined.trials.get(name, 1)), _bounded(examined, score, effect)

    return ask


def _ask_part(name: str, read: Callable[..., float]) -> Callable[[Examined], Outcome | None]:
    """Ask a part of trust for its probability."""

    def ask(examined: Examined) -> Outcome | None:
        part = examined.parts.get(name)
        return None if part is None else (min(1.0, read(part)), None)

    return ask


def _ask_dependence(cause: str) -> Callable[[Examined], Outcome | None]:
    """Ask whether the radial residual depends on something."""

    def ask(examined: Examined) -> Outcome | None:
        against = examined.parts.get("residual_against")
        part = None if against is None else getattr(against, cause)
        return None if part is None else (part.p, None)

    return ask


def _ask_flaw(examined: Examined) -> Outcome | None:
    """Ask the place that was found, with its chance at any place."""
    flaw, score = examined.fitted.computed.get("flaw"), examined.scores.get("flaw")
    if flaw is None or score is None or score.dof == 0:
        return None
    return flaw.p, _bounded(examined, score, _excess(examined, score))


def _ask_chi_square(examined: Examined) -> Outcome | None:
    fitted = examined.fitted
    dof = fitted.arcs.n_arcs - len(fitted.names)
    above = float(chdtrc(dof, float(fitted.e @ fitted.e)))
    return 2 * min(above, 1 - above), None


def _nis(part: object) -> float:
    """Share of frames beyond their bounds, and their order."""
    n, outside, runs = (getattr(part, name) for name in ("points_in_all", "outside_share", "runs_p"))
    return float(2 * min(two_sided(round(outside * n), n, 1 - CONFIDENCE), runs))


def _ask_worst_frame(examined: Examined) -> Outcome | None:
    """Ask the frame that is explained worst, in the spread of all: arcs of wide fields are not quite as independent as said."""
    chi2, dof = examined.fitted.sums.chi2, examined.fitted.sums.dof
    deviation = deviates(chi2[dof >= 1], dof[dof >= 1])
    if len(deviation) < FEWEST_FRAMES:
        return None
    spread = max(
        1.0, float(np.median(np.abs(deviation)) / 0.67449), float(np.std(np.sort(deviation)[: -len(deviation) // 50]))
    )
    return float(min(1.0, len(deviation) * ndtr(-deviation.max() / spread))), None


def _ask_stars(examined: Examined) -> Outcome | None:
    if examined.table is None or not len(examined.table.z):
        return None
    return float(min(1.0, len(examined.table.z) * np.exp(-(np.max(examined.table.z) ** 2) / 2))), None


def _ask_outliers(examined: Examined) -> Outcome | None:
    found = examined.found
    if found is None:
        return None
    size = sizes(found)
    return float(min(1.0, 4 * np.sum(found.known) * ndtr(-size.max()))), _pull(examined, size > FAR_OFF)


def sizes(found: StarResiduals) -> np.ndarray:
    """Residuals over their spread, the larger axis of each star, (n_stars,); zero where there is none."""
    return np.where(found.known, np.abs(found.z).max(axis=1), 0.0) / max(found.spread, 1.0)


def _pull(examined: Examined, far: np.ndarray) -> float | None:
    """How far the exposures with stars far off (n_stars,) pull the parameters, in claimed sigmas; None of a thinned set."""
    fitted = examined.fitted
    if len(far) != fitted.arcs.n_stars:
        return None
    per_exposure = np.logical_or.reduceat(far, fitted.arcs.star_start[:-1])
    arcs = np.repeat(per_exposure, 2 * np.diff(fitted.arcs.star_start) - 3)
    e, H = fitted.e[arcs], fitted.H[arcs]
    try:
        d = np.linalg.solve(fitted.A - H.T @ H, H.T @ e)
        sigma = np.sqrt(np.diag(covariance(fitted.A)))
        return float(np.max(np.abs(d[sigma > 0]) / sigma[sigma > 0])) if (sigma > 0).any() else None
    except np.linalg.LinAlgError:
        return None


#: Every test, in the order of the table.
TRUST_TESTS: tuple[TrustTestKind, ...] = (
    TrustTestKind(
        "tangential", "Tangential distortion", "lens-structure",
        "Star displacements indicate a decentred lens", "No residual tangential distortion", _ask_score("tangential", stays=True),
    ),
    TrustTestKind(
        "radial", "Higher radial orders", "lens-structure",
        "Radial displacements indicate higher-order distortion", "No residual radial distortion",
        _ask_score("radial", stays=True),
    ),
    TrustTestKind(
        "affine", "Skew and aspect", "lens-structure",
        "The image is skewed or stretched along one axis", "The image is neither skewed nor stretched",
        _ask_score("affine", stays=True),
    ),
    TrustTestKind(
        "lens", "Smooth residual of the lens", "lens-structure",
        "Residuals have a smooth pattern over the detector", "Residuals have no smooth pattern over the detector",
        _ask_score("lens", stays=True),
    ),
    TrustTestKind(
        "edges", "Edges of the detector", "lens-structure",
        "Centroids are displaced near the edges of the detector", "Centroids near the edges of the detector are not displaced",
        _ask_score("edges", stays=True),
    ),
    TrustTestKind(
        "seam", "Seam between readout halves", "lens-structure",
        "One half of the detector is displaced against the other", "No half of the detector is displaced against the other",
        _ask_score("seam", stays=True),
    ),
    TrustTestKind(
        "trail", "Charge left behind in readout", "lens-structure",
        "Displacement grows with the distance the charge is moved",
        "Stars are not displaced with the distance their charge is moved",
        _ask_score("trail", stays=True),
    ),
    TrustTestKind(
        "flaw", "Flaw at one place", "lens-structure",
        "One place of the detector displaces the stars around it", "No place of the detector displaces the stars around it",
        _ask_flaw,
    ),
    TrustTestKind(
        "residual_field", "Residuals over the detector", "lens-structure",
        "Mean residuals differ from cell to cell of the detector", "Mean residuals are equal in all cells of the detector",
        _ask_part("residual_field", lambda part: part.after.p),
    ),
    TrustTestKind(
        "residual_spline", "Residual spline", "lens-structure",
        "A spline of the residuals contains more than noise", "A spline of the residuals contains only noise",
        _ask_part("residual_spline", lambda part: part.test.p),
    ),
    TrustTestKind(
        "residual_radius", "Residual against radius", "lens-structure",
        "The radial residual depends on the radius", "The radial residual does not depend on the radius",
        _ask_dependence("radius"),
    ),
    TrustTestKind(
        "readout", "Line-by-line readout", "lens-structure",
        "Stars are displaced with their line and the image's velocity", "Stars are not displaced with line and velocity",
        _ask_score("readout", stays=False),
    ),
    TrustTestKind(
        "trend", "Trend of the scale", "stability",
        "The scale of the image drifts one way over the set", "The scale of the image does not drift over the set",
        _ask_score("trend", stays=True),
    ),
    TrustTestKind(
        "time", "Scale over time", "stability",
        "The scale of the image changes with time", "The scale of the image does not change with time",
        _ask_score("time", stays=True),
    ),
    TrustTestKind(
        "temperature", "Scale with temperature", "stability",
        "The scale of the image changes with temperature", "The scale of the image does not change with temperature",
        _ask_score("temperature", stays=True),
    ),
    TrustTestKind(
        "drift", "Drift of all parameters", "stability",
        "The parameters drift over the set", "The parameters do not drift over the set", _ask_score("drift", stays=True),
    ),
    TrustTestKind(
        "exposure", "Exposures of a frame", "stability",
        "The camera differs between the exposures of a frame", "The camera is the same in all exposures of a frame",
        _ask_score("exposure", stays=True),
    ),
    TrustTestKind(
        "two_halves", "Two halves", "stability",
        "Two halves of the set, fitted separately, disagree", "Two halves of the set, fitted separately, agree",
        _ask_part("two_halves", lambda part: part.chi2.p),
    ),
    TrustTestKind(
        "whiteness", "Whiteness", "stability",
        "Residuals of successive frames are correlated", "Residuals of successive frames are independent",
        _ask_part("whiteness", lambda part: part.ljung_box.p),
    ),
    TrustTestKind(
        "nis_over_time", "Frames over time", "stability",
        "The fit quality changes over time", "The fit quality is constant over time", _ask_part("nis_over_time", _nis),
    ),
    TrustTestKind(
        "worst_frames", "Worst frame", "identities",
        "A frame fits worse than chance allows", "No frame fits worse than chance allows",
        _ask_worst_frame,
    ),
    TrustTestKind(
        "residual_time", "Residual against time", "stability",
        "The radial residual depends on time", "The radial residual does not depend on time", _ask_dependence("time"),
    ),
    TrustTestKind(
        "residual_temperature", "Residual against temperature", "stability",
        "The radial residual depends on temperature", "The radial residual does not depend on temperature",
        _ask_dependence("temperature"),
    ),
    TrustTestKind(
        "chi_square", "Size of the noise", "centroid-noise",
        "The residuals are not as large as the stated noise", "The residuals are as large as the stated noise", _ask_chi_square,
    ),
    TrustTestKind(
        "residual_distribution", "Tails of the residuals", "centroid-noise",
        "The residuals are not normally distributed", "The residuals are normally distributed",
        _ask_part("residual_distribution", lambda part: part.p_tail),
    ),
    TrustTestKind(
        "phase", "Pixel phase", "centroid-noise",
        "Centroids depend on the star's place in its pixel", "Centroids do not depend on the star's place in its pixel",
        _ask_score("phase", stays=False),
    ),
    TrustTestKind(
        "magnitude", "Magnitude", "centroid-noise",
        "Centroids depend on the star's brightness", "Centroids do not depend on the star's brightness",
        _ask_score("magnitude", stays=False),
    ),
    TrustTestKind(
        "colour", "Colour", "centroid-noise",
        "Centroids depend on the star's colour", "Centroids do not depend on the star's colour",
        _ask_score("colour", stays=False),
    ),
    TrustTestKind(
        "residual_magnitude", "Residual against magnitude", "centroid-noise",
        "The radial residual depends on magnitude", "The radial residual does not depend on magnitude",
        _ask_dependence("magnitude"),
    ),
    TrustTestKind(
        "outliers", "Single sightings", "identities",
        "Single centroids are further off than noise explains", "No centroid is further off than noise explains",
        _ask_outliers,
    ),
    TrustTestKind(
        "stars", "Star positions", "identities",
        "Stars are off their catalogue positions", "No star is off its catalogue position", _ask_stars,
    ),
    TrustTestKind(
        "aberration", "Aberration", "identities",
        "Directions do not match the satellite's velocity", "Directions match the satellite's velocity",
        _ask_score("aberration", stays=False),
    ),
    TrustTestKind(
        "refraction", "Refraction", "identities",
        "Stars are displaced as by atmospheric refraction", "No residual refraction",
        _ask_score("refraction", stays=False),
    ),
)  # fmt: skip
#: The same by name.
KIND_OF_TEST: dict[str, TrustTestKind] = {kind.name: kind for kind in TRUST_TESTS}


def get_test_title(name: str) -> str:
    """Return the title of a test; its name where an older version made it."""
    return KIND_OF_TEST[name].title if name in KIND_OF_TEST else name


def get_test_gate(name: str) -> str:
    """Return the gate that a test counts for; empty where an older version made it."""
    return KIND_OF_TEST[name].gate if name in KIND_OF_TEST else ""


def make_tests(examined: Examined) -> list[TrustTest]:
    """Make every test that the set allows, and adjust their probabilities for their number."""
    outcomes = [(kind, kind.ask(examined)) for kind in TRUST_TESTS]
    made = [(kind, outcome) for kind, outcome in outcomes if outcome is not None and np.isfinite(outcome[0])]
    adjusted = adjust([p for _, (p, _) in made])
    return [_describe(kind, outcome, p) for (kind, outcome), p in zip(made, adjusted, strict=True)]


def adjust(probabilities: list[float]) -> list[float]:
    """Correct probabilities for how many there are, after Holm."""
    p = np.array(probabilities)
    order = np.argsort(p, kind="stable")
    steps = np.minimum(np.maximum.accumulate(p[order] * (len(p) - np.arange(len(p)))), 1.0)
    found = np.empty(len(p))
    found[order] = steps
    return [float(value) for value in found]


def _describe(kind: TrustTestKind, outcome: Outcome, adjusted: float) -> TrustTest:
    p, effect = outcome
    noticed = adjusted < FAMILY_LEVEL
    size = "" if effect is None or not noticed else f", an error of {effect:.2g} claimed sigmas"
    return TrustTest(
        name=kind.name,
        probability=max(p, 0.0),
        adjusted=adjusted,
        noticed=noticed,
        effect=effect,
        unit="" if effect is None else "σ",
        sentence=f"{kind.finding if noticed else kind.sound} ({probability(p)}{size}).",
    )
