"""The quality report says what an operator should know, with rows, and is clean JSON; put together part by part it is the same."""

import dataclasses
import json
import re
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings

from boresight.telemetry.quality import report as quality_parts
from boresight.telemetry.quality.findings import FINDINGS, SEVERITIES
from boresight.telemetry.quality.report import QualityParts, quality_report
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.schema import IMAGE_COLUMNS, select_rows
from boresight.telemetry.sensors import read_sensor
from tests.effort import effort
from tests.strategies import sensors, telemetry_tables
from tests.telemetry.troubles import EXPOSURES, ROWS, STARS, Stars, calm_telemetry, codes, finding, with_rows


@pytest.fixture
def telemetry():
    return calm_telemetry()


def test_a_set_with_nothing_wrong_is_normal_and_every_usable_star_counted_once(telemetry, sensor):
    report = quality_report(telemetry, sensor, Stars())
    assert (report["verdict"], report["findings"], report["warnings"]) == ("NORMAL", [], [])
    assert [report[key] for key in ("stars", "matched", "unmatched", "usable")] == [ROWS, ROWS, 0, ROWS]
    counted = ("frames", "exposures", "usable_frames", "usable_exposures")
    assert [report[key] for key in counted] == [EXPOSURES] * 4
    times = {"start_utc": "2024-01-01T00:00:00.000000Z", "end_utc": "2024-01-01T00:00:29.000000Z", "span_s": 29.0}
    assert report["time"] == times | {"median_interval_s": 1.0, "gap_count": 0, "gaps": []}
    detected = {"smallest": 12, "median": 12.0, "largest": 12, "stars": [12], "exposures": [30]}
    assert report["stars_per_exposure"]["detected"] == detected
    assert report["unknown_ids"] == {"count": 0, "ids": []}
    assert report["temperature_c"] == {"smallest": 20.0, "largest": 20.0}
    for counts in (report["detector_coverage"]["counts"], report["radial_coverage"]["counts"]):
        assert np.sum(counts) == ROWS
    assert report["detector_coverage"]["row_edges_px"][0] == -0.5
    assert report["detector_coverage"]["row_edges_px"][-1] == sensor.rows - 0.5
    assert report["radial_coverage"]["largest_radius_px"] == pytest.approx(np.hypot(383.5, 511.5))
    assert report["radial_coverage"]["corner_radius_px"] == pytest.approx(640.0)
    assert np.sum(report["magnitudes"]["counts"]) == ROWS


PLACE = np.arange(ROWS) % STARS
IN_LINE = {"row_px": 10.0 + 50 * PLACE, "col_px": 20.0 + 80.0 * PLACE}
ONE_IN_LINE = {
    "row_px": lambda t: np.where(t.frame == 2, 50.0, t.row_px),
    "col_px": lambda t: np.where(t.frame == 2, 20.0 + 80 * PLACE, t.col_px),
}
STUCK = {
    "row_px": lambda t: np.where(PLACE == 3, 100.2, t.row_px),
    "col_px": lambda t: np.where(PLACE == 3, 800.4, t.col_px),
    "star_id": lambda t: np.where(PLACE == 3, 0, t.star_id),
}
CLOSE = {
    key: (lambda t, key=key: with_rows(getattr(t, key), {1: getattr(t, key)[0] + 1.0})) for key in ("row_px", "col_px")
}
OFF_BY_5 = [{"row_px": lambda t, n=n: with_rows(t.row_px, dict.fromkeys(range(n), 772.5))} for n in (3, 4)]
OFF_UNMATCHED = {"row_px": lambda t: with_rows(t.row_px, {7: 900.0}), "star_id": lambda t: with_rows(t.star_id, {7: 0})}
INNER = {"row_px": lambda t: t.row_px * 0.5 + 190, "col_px": lambda t: t.col_px * 0.5 + 250}
DIRECTED = {"star_id": lambda t: with_rows(t.star_id, {0: 900}), "ra_rad": np.zeros(ROWS), "dec_rad": np.zeros(ROWS)}
SAME_STAR_TWICE = {"star_id": lambda t: with_rows(t.star_id, {1: t.star_id[0]})}
SAME_PLACE_TWICE = {
    "row_px": lambda t: with_rows(t.row_px, {1: t.row_px[0]}),
    "col_px": lambda t: with_rows(t.col_px, {1: t.col_px[0]}),
}
DAY = np.timedelta64(86400_000000, "us")

CASES = [
    ("NO_MATCHES", "SERIOUS", {"star_id": np.zeros(ROWS, dtype=np.int64)}, ROWS, []),
    ("FEW_STARS", "NORMAL", {"star_id": lambda t: np.where(np.arange(ROWS) < 9, 0, t.star_id)}, 1, [2]),
    ("ON_ONE_LINE", "CAUTION", ONE_IN_LINE, 1, [26]),
    ("ON_ONE_LINE", "SERIOUS", IN_LINE, None, None),
    ("FRAME_ORDER", "SERIOUS", {"frame": lambda t: np.where(t.frame == 3, 9, t.frame)}, 1, [50]),
    ("OFF_DETECTOR", "NORMAL", {"row_px": lambda t: with_rows(t.row_px, {7: 767.6, 8: -0.6, 9: 767.4})}, 2, [9, 10]),
    ("OFF_DETECTOR", "CAUTION", OFF_BY_5[0], 3, [2, 3, 4]),
    ("OFF_DETECTOR", "SERIOUS", OFF_BY_5[1], 4, [2, 3, 4, 5]),
    ("REPEATED_STARS", "CAUTION", SAME_STAR_TWICE, 1, [3]),
    ("REPEATED_CENTROIDS", "SERIOUS", SAME_PLACE_TWICE, 1, [3]),
    ("TIME_MISSING", "SERIOUS", {"time_utc": None}, ROWS, list(range(2, 22))),
    ("TIME_MISSING", "CAUTION", {"time_utc": lambda t: with_rows(t.time_utc, {4: np.datetime64("NaT")})}, 1, [6]),
    ("CLOCK_UNSET", "SERIOUS", {"time_utc": lambda t: t.time_utc - 50 * 365 * DAY}, ROWS, list(range(2, 22))),
    ("TIME_ORDER", "CAUTION", {"time_utc": lambda t: t.time_utc - DAY * (t.frame == 5)}, 1, [62]),
    (
        "TIME_VARIES",
        "CAUTION",
        {"time_utc": lambda t: t.time_utc + np.timedelta64(1, "us") * (np.arange(ROWS) == 30)},
        1,
        [32],
    ),
    ("GAPS", "NORMAL", {"time_utc": lambda t: t.time_utc + np.timedelta64(3, "s") * (t.frame > 9)}, 1, [122]),
    ("GAPS", "CAUTION", {"time_utc": lambda t: t.time_utc + np.timedelta64(90, "s") * (t.frame > 9)}, 1, [122]),
    ("UNKNOWN_STARS", "CAUTION", {"star_id": lambda t: with_rows(t.star_id, {0: 900, 5: 901})}, 2, [2, 7]),
    ("UNMATCHED", "CAUTION", {"star_id": lambda t: np.where(np.arange(ROWS) % STARS < 5, t.star_id, 0)}, 210, None),
    ("MAGNITUDE_RANGE", "CAUTION", {"magnitude": lambda t: with_rows(t.magnitude, {2: 99.0})}, 1, [4]),
    ("MAGNITUDE_MISMATCH", "CAUTION", {"magnitude": lambda t: with_rows(t.magnitude, {2: 9.9})}, 1, [4]),
    ("VELOCITY_MISSING", "CAUTION", {"velocity_m_s": None}, ROWS, []),
    ("VELOCITY_MISSING", "CAUTION", {"velocity_m_s": lambda t: with_rows(t.velocity_m_s, {3: np.nan})}, 1, [5]),
    ("OFF_DETECTOR_UNMATCHED", "CAUTION", OFF_UNMATCHED, 1, [9]),
    ("CLOSE_PAIRS", "NORMAL", CLOSE, 2, [2, 3]),
    ("HOT_PIXELS", "NORMAL", STUCK, EXPOSURES, [5 + STARS * k for k in range(20)]),
    ("POOR_COVERAGE", "CAUTION", {"row_px": lambda t: t.row_px * 0.3}, None, []),
    ("POOR_RADIUS", "CAUTION", INNER, ROWS, []),
    ("TEMPERATURE_RANGE", "CAUTION", {"temperature_c": lambda t: t.temperature_c + t.frame}, ROWS, []),
    ("SIGMA_MISSING", "NORMAL", {"sigma_px": with_rows(np.full(ROWS, 0.1), {6: np.nan})}, 1, [8]),
    ("UNKNOWN_COLUMNS", "NORMAL", {"unknown": {"flux": pa.chunked_array([["1"] * ROWS])}}, 1, []),
    ("UNKNOWN_STARS_WITH_DIRECTION", "NORMAL", DIRECTED, 1, [2]),
]


@pytest.mark.parametrize(
    ("code", "severity", "changes", "count", "rows"), CASES, ids=[f"{case[0]}-{case[1]}" for case in CASES]
)
def test_each_trouble_is_found_with_its_rows_in_a_sentence_that_agrees(
    telemetry, sensor, code, severity, changes, count, rows
):
    made = {name: change(telemetry) if callable(change) else change for name, change in changes.items()}
    report = quality_report(dataclasses.replace(telemetry, **made), sensor, Stars())
    found = finding(report, code)
    assert found["severity"] == severity
    assert count is None or found["count"] == count
    assert rows is None or found["rows"] == rows
    assert SEVERITIES.index(report["verdict"]) >= SEVERITIES.index(severity)
    assert (found["sentence"] in report["warnings"]) == (severity != "NORMAL")
    assert disagreements(report) == []


NOUNS = "row|star|detection|match|magnitude|interval|column|exposure|cell"
PLURAL_OF_ONE = re.compile(
    rf"(?<![\d,.])1 (?!of )(?:\w+ ){{0,2}}?(?:(?:{NOUNS})e?s|are|have|lie|differ|exceed|name|return)\b"
)
HAVE_OF_ONE = re.compile(r"(?<![\d,.])1 of [\d,]+ \w+ (?:have|are)\b")
SINGULAR_OF_MANY = re.compile(rf"(?:\d{{2}}|[02-9]) (?:matched |unmatched )?(?:{NOUNS})\b")


def disagreements(report):
    wrong = (PLURAL_OF_ONE, HAVE_OF_ONE, SINGULAR_OF_MANY)
    return [found["sentence"] for found in report["findings"] if any(rule.search(found["sentence"]) for rule in wrong)]


@pytest.mark.parametrize(
    "sentence",
    ["1 rows name a star.", "1 matched stars lie off.", "1 of 12 exposures have few.", "2 row.", "1 row are."],
)
def test_a_sentence_that_does_not_agree_is_noticed(sentence):
    assert disagreements({"findings": [{"sentence": sentence}]})


def test_few_stars_everywhere_gaps_and_unknown_numbers_are_listed_in_rows_of_the_file_they_came_from(telemetry, sensor):
    troubled = dataclasses.replace(telemetry, star_id=np.where(np.arange(ROWS) % STARS < 3, telemetry.star_id, 0))
    report = quality_report(troubled, sensor, Stars())
    assert finding(report, "FEW_STARS")["severity"] == "SERIOUS"
    assert report["usable_frames"] == 0
    late = dataclasses.replace(telemetry, time_utc=telemetry.time_utc + np.timedelta64(60, "s") * (telemetry.frame > 9))
    time = quality_report(late, sensor)["time"]
    assert (time["gap_count"], time["gaps"]) == (1, [{"row": 122, "frame": 10, "seconds": 61.0}])
    troubled = dataclasses.replace(telemetry, star_id=with_rows(telemetry.star_id, {0: 901, 20: 900, 40: 901}))
    assert quality_report(troubled, sensor, Stars())["unknown_ids"] == {"count": 2, "ids": [900, 901]}
    assert quality_report(troubled, sensor)["unknown_ids"] is None
    json_lines = dataclasses.replace(telemetry, row_px=with_rows(telemetry.row_px, {7: 900.0}), first_row=1)
    assert finding(quality_report(json_lines, sensor), "OFF_DETECTOR")["rows"] == [8]


def test_stars_that_stay_in_place_do_not_make_detections_hot_pixels(telemetry, sensor):
    still = np.arange(ROWS) % STARS
    staring = dataclasses.replace(
        telemetry,
        row_px=telemetry.row_px[still],
        col_px=telemetry.col_px[still],
        star_id=np.where(still == 3, 0, telemetry.star_id),
    )
    assert "HOT_PIXELS" not in codes(quality_report(staring, sensor, Stars()))


def test_what_the_extraction_from_images_keeps_is_no_column_of_another_name(telemetry, sensor):
    of_images = {name: pa.chunked_array([["1"] * ROWS]) for name in IMAGE_COLUMNS}
    report = quality_report(dataclasses.replace(telemetry, unknown=of_images), sensor, Stars())
    assert "UNKNOWN_COLUMNS" not in codes(report)


def test_the_worst_finding_comes_first_and_every_finding_of_the_registry_has_a_case(telemetry, sensor):
    troubled = dataclasses.replace(
        telemetry,
        unknown={"flux": pa.chunked_array([["1"] * ROWS])},
        velocity_m_s=None,
        row_px=with_rows(telemetry.row_px, {7: 900.0}),
    )
    report = quality_report(troubled, sensor, Stars())
    assert codes(report) == ["OFF_DETECTOR", "VELOCITY_MISSING", "UNKNOWN_COLUMNS"]
    assert (report["verdict"], len(report["warnings"])) == ("CAUTION", 2)
    assert len({case[0] for case in CASES}) == len(FINDINGS)


@settings(max_examples=effort(12, 60), deadline=None)
@given(telemetry=telemetry_tables(), sensor=sensors())
def test_any_readable_set_has_a_report_in_clean_json(telemetry, sensor):
    report = quality_report(telemetry, sensor, Stars())
    document = json.loads(json.dumps(report, allow_nan=False))
    assert document == report
    assert report["matched"] + report["unmatched"] == report["stars"] == len(telemetry)
    assert np.sum(report["radial_coverage"]["counts"]) == report["usable"] <= report["matched"]
    assert report["verdict"] in SEVERITIES
    assert disagreements(report) == []


def test_the_real_star_fields_are_usable_and_betray_their_hot_pixels(real_sky):
    report = quality_report(read_telemetry(real_sky / "esa-5-frames.csv"), read_sensor(real_sky / "esa.sensor.json"))
    assert (report["verdict"], report["usable_frames"], report["matched"]) == ("NORMAL", 5, 596)
    assert codes(report) == ["HOT_PIXELS"]
    assert finding(report, "HOT_PIXELS")["count"] == 55


TOTALS = (
    "time", "stars_per_exposure", "detector_coverage", "radial_coverage", "magnitudes", "unknown_ids", "temperature_c",
    "unmatched_share", "stars_off_detector",
)  # fmt: skip


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
    for name in (*TOTALS, *(name for name, value in whole.items() if isinstance(value, int))):
        assert report[name] == whole[name], name
    for code in ("GAPS", "OFF_DETECTOR"):
        assert finding(report, code) == finding(whole, code)


def test_findings_of_a_set_that_is_not_held_name_rows_of_the_file_and_say_what_was_looked_at(sensor, monkeypatch):
    calm = calm_telemetry()
    hot = replace(calm, magnitude=with_rows(calm.magnitude, dict.fromkeys(range(0, len(calm), STARS), 25.0)))
    monkeypatch.setattr(quality_parts, "MOST_ROWS", 8 * STARS)
    report = in_parts(hot, sensor, 1)
    rows = finding(report, "MAGNITUDE_RANGE")["rows"]
    assert rows == [2 + frame * STARS for frame in range(0, 30, 4)]
    assert finding(report, "PART_OF_THE_SET")["sentence"].startswith("Findings are based on 8 of 30 frames")
    assert "PART_OF_THE_SET" not in codes(quality_report(hot, sensor, Stars()))
