"""The settings of `calibration/options.py` as keywords, for type checkers, which read no registry; a test holds these to it.

A list may be one text with commas. Names and values are checked where they are read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict


class CalibrationKeywords(TypedDict, total=False):
    """Every setting of a calibration."""

    method: str
    variant: str
    free: str | Sequence[str] | None
    match: str
    match_parameters: str
    match_rule: str
    flight_tolerance_urad: float | None
    leave_out_doubles: bool
    leave_out_stars: str | Sequence[int]
    blends: str
    noise_model: str
    minimum_stars: int
    vary: str | Sequence[str] | None
    vary_as: str
    degree: str
    events: str | Sequence[str] | None
    walk_sigma: float | None
    prior_covariance: str
    prior_inflation: float
    prior_drift_sigma: float
    prior_age_days: float | None
    max_iterations: int
    error: str
    robust: str
    huber_threshold: float
    linearisations: int
    process_noise_sigma: float | None
    process_noise_of: str | Sequence[str] | None
    process_noise_per: str
    smooth: bool
    forgetting_factor: float
    initial_sigma_scale: float
    star_model: int
    singular_values: str | Sequence[int]
    gain_form: str
    replay_frames_per_s: float


class ChoiceKeywords(TypedDict, total=False):
    """The settings of a calibration that choosing a camera takes."""

    match: str
    minimum_stars: int


class EvaluationKeywords(TypedDict, total=False):
    """The settings of a calibration that an evaluation takes."""

    match: str
    flight_tolerance_urad: float | None
