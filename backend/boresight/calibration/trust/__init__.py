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

A part that cannot be had is null, and `unavailable` says why in a sentence. Large sets are thinned where a part needs more than
a pass over the set a frame; such a part says how many frames it used.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.calibration.trust.advice import trust_advice
from boresight.calibration.trust.efficiency import arc_sigma_map, efficiency, more_data
from boresight.calibration.trust.field import residual_against, residual_distribution, residual_field, residual_outliers
from boresight.calibration.trust.fitted_set import FittedSet, Unavailable, fit_best
from boresight.calibration.trust.innovations import nis_over_time, whiteness, worst_frames
from boresight.calibration.trust.refits import drop_one, drop_one_sentence, two_halves
from boresight.calibration.trust.residual_spline import find_residual_spline
from boresight.calibration.trust.residuals import StarResiduals, compute_star_residuals, residuals
from boresight.calibration.trust.stars import star_table, stars, stars_sentence
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry

__all__ = ["trust_advice", "trust_view"]

Part = Callable[[FittedSet], Any]

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
    "residual_spline": lambda fitted, _: find_residual_spline(fitted).document(),
}
OF_THE_STARS = (*OF_THE_RESIDUALS, "stars", "residual_against")
SINGULAR = "The numbers of this fit are too close to singular: free fewer parameters."
BESIDE = ("drop_one_sentence", "stars_sentence", "stars_in_all")


def trust_view(
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    estimate: Estimate,
    telemetry: Telemetry,
    catalogue: Catalogue | None = None,
) -> dict[str, Any]:
    """Judge a finished estimate in every way there is.

    `problem`, `parameters`, `settings`, `estimate`: as `calibrate` has them at its end; the arcs are whitened here. `telemetry`:
    the set that the problem was built from, with the star numbers that it was built with. `catalogue`: for what it says against
    a star's place; None says nothing. Returns the `trust` object of the calibration JSON: every part, null where it cannot be
    had, with the reason in `unavailable`.
    """
    view: dict[str, Any] = {
        **dict.fromkeys((*OF_THE_FIT, *OF_THE_STARS, *BESIDE)),
        "suspects": [],
        "unavailable": {},
    }
    try:
        fitted = fit_best(problem, parameters, settings, estimate, telemetry, catalogue)
    except Unavailable as reason:
        view["unavailable"] = dict.fromkeys((*OF_THE_FIT, *OF_THE_STARS), str(reason))
        return view
    for name, part in OF_THE_FIT.items():
        _fill(view, name, partial(part, fitted))
    if view["drop_one"] is not None:
        view["drop_one_sentence"] = drop_one_sentence(fitted, view["drop_one"])
    _fill_stars(view, fitted)
    return view


def _fill(view: dict[str, Any], name: str, part: Callable[[], Any]) -> None:
    """Put a part into the view, or the reason why it is not there."""
    try:
        view[name] = part()
    except Unavailable as reason:
        view["unavailable"][name] = str(reason)
    except np.linalg.LinAlgError:
        view["unavailable"][name] = SINGULAR


def _fill_stars(view: dict[str, Any], fitted: FittedSet) -> None:
    """The parts that rest on residuals in pixels."""
    try:
        found = compute_star_residuals(fitted)
    except (Unavailable, np.linalg.LinAlgError) as error:
        reason = str(error) if isinstance(error, Unavailable) else SINGULAR
        view["unavailable"] |= dict.fromkeys(OF_THE_STARS, reason)
        return
    for name, part in OF_THE_RESIDUALS.items():
        _fill(view, name, partial(part, fitted, found))
    entries, missing = residual_against(fitted, found)
    view["residual_against"] = entries
    view["unavailable"] |= {f"residual_against.{name}": reason for name, reason in missing.items()}
    _fill(view, "stars", lambda: _stars(view, fitted, found))


def _fits(view: dict[str, Any]) -> bool:
    """Whether the camera model leaves no radial residual, as far as one can see."""
    radius = view["residual_against"]["radius"]
    return radius is None or bool(radius["even"])


def _stars(view: dict[str, Any], fitted: FittedSet, found: StarResiduals) -> list[dict[str, Any]]:
    """The table of stars, and what is told of it beside."""
    table = star_table(fitted, found)
    worst_first = np.argsort(-table.z)
    view["suspects"] = [int(table.star_id[i]) for i in worst_first if table.suspect[i]]
    view["stars_in_all"] = len(table.z)
    view["stars_sentence"] = stars_sentence(table, found.arcs.n_frames, fitted.arcs.n_frames, fits=_fits(view))
    return stars(fitted, table)
