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
    "robust": {"none": "Least squares", "huber": "Huber: bounds what a false star may say"},
}

_BY_NAME = {method.name: method for method in METHODS}


def title_of(name: str) -> str:
    """Return a method's title; a name without one stands for itself."""
    return _BY_NAME[name].title if name in _BY_NAME else name


def is_sequential(name: str) -> bool:
    """Tell whether a method takes the frames one after the other."""
    return name in _BY_NAME and _BY_NAME[name].sequential
