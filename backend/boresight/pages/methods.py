"""The choices of a calibration as a person makes them: methods with a title and when to use them, and what the other words mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Method:
    """One method of `CalibrationSettings.method`."""

    name: str
    title: str
    when: str
    sequential: bool


METHODS = (
    Method(
        "batch",
        "Batch",
        "All frames at once by least squares: the reference answer, and the first run to make on a new set.",
        sequential=False,
    ),
    Method(
        "sqrf",
        "Square-root filter",
        "Frame by frame with a square-root covariance, as it would run on board: use it to see how fast the parameters"
        " settle and whether they drift.",
        sequential=True,
    ),
    Method(
        "ekf",
        "Extended Kalman filter",
        "The same filter with a full covariance: use it to check the square-root filter, not instead of it.",
        sequential=True,
    ),
    Method(
        "ukf",
        "Unscented filter",
        "Slopes from points spread as wide as the parameters are uncertain, not from derivatives: use it as an independent"
        " check of the square-root filter; it takes longer and is not more accurate.",
        sequential=True,
    ),
    Method(
        "svd",
        "Singular values",
        "Singular values of star combinations in place of arcs: use it to reproduce or compare with the method of Wu et al.;"
        " with honest weights it holds a little less than the arcs do, and costs more.",
        sequential=True,
    ),
    Method(
        "angular",
        "All angular distances",
        "Every pair of stars, the baseline that singular values are usually measured against: use it beside them; it says"
        " exactly what the arcs of the square-root filter say, at a higher price.",
        sequential=True,
    ),
)

#: What the words of the other choices mean, by setting and word.
WORDS: Mapping[str, Mapping[str, str]] = {
    "variant": {
        "no-q": "No-Q: parameters are constant",
        "q": "Q: parameters may drift",
        "no-refit": "No-Refit: Q, with the matches of the baseline only",
    },
    "match": {"given": "As given in the file", "rematch": "Made again as parameters improve"},
    "match_parameters": {"latest": "The latest, frame by frame", "baseline": "The baseline it started from"},
    "match_rule": {
        "statistical": "Statistical: from centroid noise and parameter uncertainty",
        "flight": "Flight: the fixed tolerance of the flight code",
    },
    "error": {
        "arclength": "Arclength, with its full covariance",
        "cosine": "Cosine of the arc, unweighted: worse, for comparison",
    },
    "gain_form": {
        "information": "Information form",
        "gain": "Gain form, as printed: slower, the same result",
    },
    "robust": {"none": "Least squares", "huber": "Huber: bounds what a false star may say"},
}

#: What the numbers mean that are chosen like words.
NUMBERS: Mapping[str, Mapping[str, str]] = {
    "star_model": {
        "1": "1: three neighbours at a time",
        "2": "2: half of the stars at a time",
        "3": "3: all stars but one at a time",
        "4": "4: the first three, four, five … all stars",
    },
    "singular_values": {
        "2,3": "σ2 and σ3: all that a combination says",
        "1,2,3": "σ1, σ2 and σ3: the same, for σ1 follows from the others",
        "1,2": "σ1 and σ2: the same by another name",
        "1,3": "σ1 and σ3: the same by another name",
        "1": "σ1 alone",
        "2": "σ2 alone",
        "3": "σ3 alone",
    },
}

_BY_NAME = {method.name: method for method in METHODS}


def title_of(name: str) -> str:
    """Return a method's title; a name without one stands for itself."""
    return _BY_NAME[name].title if name in _BY_NAME else name


def is_sequential(name: str) -> bool:
    """Tell whether a method takes the frames one after the other."""
    return name in _BY_NAME and _BY_NAME[name].sequential
