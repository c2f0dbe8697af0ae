"""Trust: how far a calibration can be believed, beyond its own sigmas; one part a file, each with its sentence.

=================  ====================================================================================================
`arc_map`          error of an arc about the detector, from the parameters alone
`two_halves`       two halves of the set fitted apart, their difference against what both claim
`efficiency`       claimed sigmas against the Cramér-Rao bound of the centroids
`more_data`        predicted sigmas against further frames of the same kind
`drop_one`         what holding each free parameter at its start would cost
`innovations`      normalised innovations over time, with their bounds
`whiteness`        whether the residuals drift
`worst_frames`     the frames that are explained worst
`residuals`        centroids against the projected catalogue, in pixels
`field`            their means over the detector, before and after
`distribution`     their histogram and quantiles against the normal curve, and outliers
`stars`            every star over its sightings, suspects named
`against`          the residual against radius, magnitude, temperature and time
`residual_spline`  what the camera model leaves over the detector, as a spline with its sigma, and which camera has it
=================  ====================================================================================================

`displacements` and `departures` test what moves stars, `flaws` looks for the place of a flaw, `trust_tests` makes one family of
all tests, `causes` says what explains those that notice something.

A part that cannot be had is null, and `unavailable` says why in a sentence. Large sets are thinned where a part needs more than
a pass over the set a frame; such a part says how many frames it used.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.calibration import Cause, Minima, ModelMisfit, Trust, TrustTest, UnseenDeparture, Values
from boresight.calibration.estimate import Asked, Estimate, Parameters, never
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.calibration.trust.advice import cause_advice, trust_advice
from boresight.calibration.trust.causes import find_causes
from boresight.calibration.trust.departures import TANGENTIAL_AT_CORNER, find_companions, find_departures
from boresight.calibration.trust.displacements import (
    LEAST_SHARE,
    OWN_SHARE,
    Departure,
    Score,
    ScoreSums,
    add_up,
    find_score,
    find_unseen,
)
from boresight.calibration.trust.efficiency import arc_sigma_map, efficiency, more_data
from boresight.calibration.trust.field import residual_against, residual_distribution, residual_field, residual_outliers
from boresight.calibration.trust.fitted_set import UNLIKELY, FittedSet, Unavailable, fit_best
from boresight.calibration.trust.innovations import nis_over_time, whiteness, worst_frames
from boresight.calibration.trust.misfit import find_misfit
from boresight.calibration.trust.refits import drop_one, drop_one_sentence, two_halves
from boresight.calibration.trust.residual_spline import find_residual_spline
from boresight.calibration.trust.residuals import StarResiduals, compute_star_residuals, residuals
from boresight.calibration.trust.stars import StarTable, star_table, stars, stars_sentence
from boresight.calibration.trust.trust_tests import STAYING, TANGENTIAL, Examined, make_tests
from boresight.estimation.executor import refuse_cancelled
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry

__all__ = ["TrustReport", "cause_advice", "judge_trust", "trust_advice"]

Part = Callable[[FittedSet], Any]
#: Members of the trust by name.
Parts = dict[str, Any]

#: Parts that need the ground alone.
OF_THE_FIT: dict[str, Part] = {
    "arc_sigma_map": arc_sigma_map,
    "two_halves": two_halves,
    "efficiency": efficiency,
    "more_data": more_data,
    "drop_one": drop_one,
    "nis_over_time": nis_over_time,
    "whiteness": whiteness,
    "worst_frames": worst_frames,
}
#: Parts that need the residuals of single stars too.
OF_THE_RESIDUALS: dict[str, Callable[[FittedSet, StarResiduals], Any]] = {
    "residuals": residuals,
    "residual_field": residual_field,
    "residual_distribution": residual_distribution,
    "residual_outliers": residual_outliers,
    "residual_spline": lambda fitted, _: find_residual_spline(fitted).describe(),
}
OF_THE_STARS = (*OF_THE_RESIDUALS, "stars", "residual_against")
#: Frames that the score tests look at, in blocks spread over the set: a pass over many stars a departure.
MOST_TESTED = 1_792
SINGULAR = "This fit is nearly singular: free fewer parameters."


@dataclass(frozen=True)
class TrustReport:
    """What trust makes of an estimate: its parts, the tests made, and what explains those that noticed something.

    `sigma_with_misfit`, `misfit`: by how much that widens the sigmas; empty and None where it is not known.
    """

    trust: Trust
    tests: list[TrustTest]
    causes: list[Cause]
    sigma_with_misfit: Values[float | None] = dataclasses.field(default_factory=Values)
    misfit: ModelMisfit | None = None


def judge_trust(
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    estimate: Estimate,
    telemetry: Telemetry,
    catalogue: Catalogue | None = None,
    minima: Minima | None = None,
    cancelled: Asked = never,
) -> TrustReport:
    """Judge a finished estimate in every way there is.

    `problem`, `parameters`, `settings`, `estimate`: as `calibrate` has them at its end; the arcs are whitened here. `telemetry`:
    the set that the problem was built from, with the star numbers that it was built with. `catalogue`: for what it says against
    a star's place; None says nothing. `cancelled`: asked before each part and each iteration of a fit, raises CancelledError
    when it says so. A part that cannot be had is None, with the reason in `unavailable`.
    """
    try:
        fitted = fit_best(problem, parameters, settings, estimate, telemetry, catalogue, cancelled)
    except Unavailable as reason:
        return TrustReport(Trust(unavailable=dict.fromkeys((*OF_THE_FIT, *OF_THE_STARS), str(reason))), [], [])
    parts, unavailable = _computed(fitted, {name: partial(part, fitted) for name, part in OF_THE_FIT.items()})
    if "drop_one" in parts:
        parts["drop_one_sentence"] = drop_one_sentence(fitted, parts["drop_one"])
    stars = _judge_stars(fitted)
    parts |= stars.parts
    trust = Trust(**parts, unavailable=unavailable | stars.unavailable)
    spread = None if minima is None or minima.spread is None else np.asarray(minima.spread)
    if spread is not None:
        spread = spread / np.outer(parameters.scale, parameters.scale)
    return _tested(fitted, trust, parts, stars, spread)


def _tested(fitted: FittedSet, trust: Trust, parts: Parts, stars: StarParts, spread: FloatArray | None) -> TrustReport:
    """Make every test that can be made, look for what explains them, and widen the sigmas by it."""
    refuse_cancelled(fitted.cancelled, "before the tests of the residuals")
    departures, _ = find_departures(fitted)
    try:
        sums = add_up(fitted, [*departures, *find_companions(fitted)], MOST_TESTED)
        scores = {one.name: find_score(sums, one.name) for one in departures}
        trials = {one.name: one.trials for one in departures}
        examined = Examined(fitted, sums, scores, parts, stars.found, stars.table, trials)
        tests = make_tests(examined)
        causes = find_causes(examined, tests)
    except np.linalg.LinAlgError:  # the numbers are too near to singular
        return TrustReport(trust, [], [])
    wider = find_misfit(fitted, sums, scores, tests, spread)
    trust = replace(trust, unseen=list(_unseen(fitted, departures, sums, scores)))
    return TrustReport(trust, tests, causes) if wider is None else TrustReport(trust, tests, causes, *wider)


def _unseen(
    fitted: FittedSet, departures: Sequence[Departure], sums: ScoreSums, scores: Mapping[str, Score]
) -> Iterator[UnseenDeparture]:
    """Say what the tests may miss of each departure that stays in the camera."""
    tested = float(np.sqrt(len(fitted.e) / sums.n_arcs))  # a part is tested, the sigmas are of all
    fields: Mapping[str, FloatArray] = fitted.computed["first fields"]
    for one in (one for one in departures if one.name in STAYING):
        score, tangential = scores[one.name], one.name == TANGENTIAL
        found = find_unseen(sums, score, UNLIKELY, LEAST_SHARE if tangential else OWN_SHARE)
        if found is None:
            continue
        largest = np.linalg.norm(fields[one.name] @ found.c, axis=1).max()
        yield UnseenDeparture(
            name=one.name,
            size_px=float(TANGENTIAL_AT_CORNER * np.linalg.norm(found.c) if tangential else largest),
            parameter=fitted.names[found.parameter],
            sigmas=None if tangential and score.dof < len(score.c) else found.sigmas * tested,
        )


def _computed(fitted: FittedSet, parts: Mapping[str, Callable[[], Any]]) -> tuple[Parts, dict[str, str]]:
    """Compute the parts that can be had, and say why the others cannot."""
    found: Parts = {}
    unavailable: dict[str, str] = {}
    for name, part in parts.items():
        refuse_cancelled(fitted.cancelled, f"before {name} was judged")
        try:
            found[name] = part()
        except Unavailable as reason:
            unavailable[name] = str(reason)
        except np.linalg.LinAlgError:
            unavailable[name] = SINGULAR
    return found, unavailable


@dataclass(frozen=True)
class StarParts:
    """The parts that rest on residuals in pixels, why others are missing, and what they were made of."""

    parts: Parts
    unavailable: dict[str, str]
    found: StarResiduals | None = None
    table: StarTable | None = None


def _judge_stars(fitted: FittedSet) -> StarParts:
    """Judge the residuals in pixels."""
    try:
        found = compute_star_residuals(fitted)
    except (Unavailable, np.linalg.LinAlgError) as error:
        return StarParts({}, dict.fromkeys(OF_THE_STARS, str(error) if isinstance(error, Unavailable) else SINGULAR))
    parts, unavailable = _computed(
        fitted, {name: partial(part, fitted, found) for name, part in OF_THE_RESIDUALS.items()}
    )
    against, missing = residual_against(fitted, found)
    unavailable |= {f"residual_against.{name}": reason for name, reason in missing.items()}
    tables, why = _computed(fitted, {"stars": partial(star_table, fitted, found)})
    if "stars" in tables:
        parts |= _describe_stars(fitted, found, tables["stars"], fits=against.radius is None or against.radius.even)
    return StarParts({**parts, "residual_against": against}, unavailable | why, found, tables.get("stars"))


def _describe_stars(fitted: FittedSet, found: StarResiduals, table: StarTable, *, fits: bool) -> Parts:
    """The table of stars, and what is told of it beside; `fits` where the camera model leaves no radial residual."""
    worst_first = np.argsort(-table.z)
    return {
        "stars": stars(fitted, table),
        "suspects": [int(table.star_id[i]) for i in worst_first if table.suspect[i]],
        "stars_in_all": len(table.z),
        "stars_sentence": stars_sentence(table, found.arcs.n_frames, fitted.arcs.n_frames, fits=fits),
    }
