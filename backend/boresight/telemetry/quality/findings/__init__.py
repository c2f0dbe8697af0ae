"""Findings: one function each, one line in the registry below; the worst come first in a report."""

from __future__ import annotations

from collections.abc import Callable

from boresight.telemetry.quality.findings import centroids, columns, stars
from boresight.telemetry.quality.inputs import SEVERITIES, Finding, QualityInputs, Severity

FINDINGS: tuple[Callable[[QualityInputs], Finding | None], ...] = (
    stars.nothing_matched,
    stars.few_stars,
    stars.on_one_line,
    columns.frames_descend,
    centroids.stars_off_detector,
    centroids.repeated_stars,
    centroids.repeated_centroids,
    columns.times_missing,
    columns.clock_unset,
    columns.times_descend,
    columns.times_vary_in_exposure,
    columns.sampling_gaps,
    stars.unknown_numbers,
    stars.unknown_but_directed,
    stars.many_unmatched,
    stars.absurd_magnitudes,
    stars.mismatched_magnitudes,
    stars.velocity_missing,
    centroids.detections_off_detector,
    centroids.close_pairs,
    centroids.stuck_detections,
    centroids.poor_coverage,
    centroids.poor_radius,
    columns.wide_temperature,
    columns.partial_noise,
    columns.unknown_columns,
)

__all__ = ["FINDINGS", "SEVERITIES", "Finding", "Severity"]
