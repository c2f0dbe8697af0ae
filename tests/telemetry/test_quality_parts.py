"""A report put together part by part is the report; of a set too large to be held, totals are of all and findings of a part."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.telemetry.quality import report as quality_parts
from boresight.telemetry.quality.report import QualityParts, quality_report
from boresight.telemetry.schema import select_rows
from tests.telemetry.troubles import STARS, Stars, calm_telemetry, codes, finding, with_rows

TOTALS = (
    "time",
    "stars_per_exposure",
    "detector_coverage",
    "radial_coverage",
    "magnitudes",
    "unknown_ids",
    "temperature_c",
)


def in_parts(telemetry, sensor, frames, catalogue=None):
    report = QualityParts(sensor, catalogue or Stars())
    rows = frames * STARS
    for first in range(0, len(telemetry), rows):
        report.add(select_rows(telemetry, slice(first, min(first + rows, len(telemetry)))))
    return report.report()


@pytest.fixture
def troubled():
    calm = calm_telemetry()
    return replace(
        calm,
        time_utc=calm.time_utc + np.where(calm.frame >= 12, 50_000_000, 0),
        magnitude=with_rows(calm.magnitude, {3: 19.0, 200: -1.5, 201: np.nan}),
        star_id=with_rows(calm.star_id, {40: 900, 150: 0, 300: 901}),
        row_px=with_rows(calm.row_px, {150: 900.0, 170: 772.5, 290: -7.0}),
        temperature_c=np.linspace(-5.0, 12.0, len(calm)),
    )


@pytest.mark.parametrize("frames", [1, 4, 7, 30])
def test_in_memory_the_report_is_that_of_the_whole(troubled, sensor, frames):
    assert in_parts(troubled, sensor, frames) == quality_report(troubled, sensor, Stars())


@pytest.mark.parametrize("frames", [1, 2, 5])
def test_the_totals_of_a_set_that_is_not_held_are_of_all_of_it(troubled, sensor, frames, monkeypatch):
    whole = quality_report(troubled, sensor, Stars())
    monkeypatch.setattr(quality_parts, "MOST_ROWS", 10 * STARS)
    report = in_parts(troubled, sensor, frames)
    assert list(report) == list(whole)
    for name in TOTALS:
        assert report[name] == whole[name], name
    counts = {name: value for name, value in whole.items() if isinstance(value, int)}
    assert {name: report[name] for name in counts} == counts
    assert report["unmatched_share"] == whole["unmatched_share"]
    assert finding(report, "GAPS") == finding(whole, "GAPS")
    assert report["stars_off_detector"] == whole["stars_off_detector"]
    assert finding(report, "OFF_DETECTOR") == finding(whole, "OFF_DETECTOR")


def test_findings_of_a_set_that_is_not_held_name_rows_of_the_file_and_say_what_was_looked_at(sensor, monkeypatch):
    calm = calm_telemetry()
    hot = replace(calm, magnitude=with_rows(calm.magnitude, dict.fromkeys(range(0, len(calm), STARS), 25.0)))
    monkeypatch.setattr(quality_parts, "MOST_ROWS", 8 * STARS)
    report = in_parts(hot, sensor, 1)
    rows = finding(report, "MAGNITUDE_RANGE")["rows"]
    assert rows == [2 + frame * STARS for frame in range(0, 30, 4)]
    assert finding(report, "PART_OF_THE_SET")["sentence"].startswith("Findings were looked for in 8 of 30 frames")
    assert "PART_OF_THE_SET" not in codes(quality_report(hot, sensor, Stars()))
