"""The quality report says what an operator should know, with rows, and is clean JSON."""

import dataclasses
import json
import re

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings

from boresight.telemetry.quality.findings import FINDINGS, SEVERITIES
from boresight.telemetry.quality.report import quality_report
from boresight.telemetry.read.readers import read_telemetry
from boresight.telemetry.sensors import read_sensor
from tests.effort import effort
from tests.strategies import sensors, telemetry_tables
from tests.telemetry.troubles import EXPOSURES, ROWS, STARS, Stars, calm_telemetry, codes, finding, with_rows


@pytest.fixture
def telemetry():
    return calm_telemetry()


def test_a_set_with_nothing_wrong_is_normal_and_counted(telemetry, sensor):
    report = quality_report(telemetry, sensor, Stars())

    assert (report["verdict"], report["findings"], report["warnings"]) == ("NORMAL", [], [])
    assert [report[key] for key in ("frames", "exposures", "stars", "matched", "unmatched", "usable")] == [
        EXPOSURES,
        EXPOSURES,
        ROWS,
        ROWS,
        0,
        ROWS,
    ]
    assert (report["usable_frames"], report["usable_exposures"]) == (EXPOSURES, EXPOSURES)
    assert report["time"] == {
        "start_utc": "2024-01-01T00:00:00.000000Z",
        "end_utc": "2024-01-01T00:00:29.000000Z",
        "span_s": 29.0,
        "median_interval_s": 1.0,
        "gap_count": 0,
        "gaps": [],
    }
    assert report["stars_per_exposure"]["detected"] == {
        "smallest": 12,
        "median": 12.0,
        "largest": 12,
        "stars": [12],
        "exposures": [30],
    }
    assert report["unknown_ids"] == {"count": 0, "ids": []}
    assert report["temperature_c"] == {"smallest": 20.0, "largest": 20.0}


def test_coverage_counts_every_usable_star_once_and_reaches_the_corner(telemetry, sensor):
    report = quality_report(telemetry, sensor, Stars())
    for counts in (report["detector_coverage"]["counts"], report["radial_coverage"]["counts"]):
        assert np.sum(counts) == ROWS
    assert report["detector_coverage"]["row_edges_px"][0] == -0.5
    assert report["detector_coverage"]["row_edges_px"][-1] == sensor.rows - 0.5
    assert report["radial_coverage"]["largest_radius_px"] == pytest.approx(np.hypot(383.5, 511.5))
    assert report["radial_coverage"]["corner_radius_px"] == pytest.approx(640.0)
    assert np.sum(report["magnitudes"]["counts"]) == ROWS


SAME_STAR_TWICE = {"star_id": lambda t: with_rows(t.star_id, {1: t.star_id[0]})}
SAME_PLACE_TWICE = {
    "row_px": lambda t: with_rows(t.row_px, {1: t.row_px[0]}),
    "col_px": lambda t: with_rows(t.col_px, {1: t.col_px[0]}),
}
DAY = np.timedelta64(86400_000000, "us")

CASES = [
    ("NO_MATCHES", "SERIOUS", {"star_id": np.zeros(ROWS, dtype=np.int64)}, ROWS, []),
    (
        "FEW_STARS",
        "NORMAL",
        {"star_id": lambda t: np.where(np.arange(ROWS) < 9, 0, t.star_id)},
        1,
        [2],
    ),
    (
        "ON_ONE_LINE",
        "CAUTION",
        {
            "row_px": lambda t: np.where(np.arange(ROWS) // STARS == 2, 50.0, t.row_px),
            "col_px": lambda t: np.where(
                np.arange(ROWS) // STARS == 2, 20.0 + 80 * (np.arange(ROWS) % STARS), t.col_px
            ),
        },
        1,
        [26],
    ),
    ("FRAME_ORDER", "SERIOUS", {"frame": lambda t: np.where(t.frame == 3, 9, t.frame)}, 1, [50]),
    ("OFF_DETECTOR", "NORMAL", {"row_px": lambda t: with_rows(t.row_px, {7: 767.6, 8: -0.6, 9: 767.4})}, 2, [9, 10]),
    (
        "OFF_DETECTOR",
        "CAUTION",
        {"row_px": lambda t: with_rows(t.row_px, dict.fromkeys(range(3), 772.5))},
        3,
        [2, 3, 4],
    ),
    (
        "OFF_DETECTOR",
        "SERIOUS",
        {"row_px": lambda t: with_rows(t.row_px, dict.fromkeys(range(4), 772.5))},
        4,
        [2, 3, 4, 5],
    ),
    ("REPEATED_STARS", "SERIOUS", SAME_STAR_TWICE, 1, [3]),
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
    (
        "OFF_DETECTOR_UNMATCHED",
        "CAUTION",
        {"row_px": lambda t: with_rows(t.row_px, {7: 900.0}), "star_id": lambda t: with_rows(t.star_id, {7: 0})},
        1,
        [9],
    ),
    (
        "CLOSE_PAIRS",
        "NORMAL",
        {
            key: (lambda t, key=key: with_rows(getattr(t, key), {1: getattr(t, key)[0] + 1.0}))
            for key in ("row_px", "col_px")
        },
        2,
        [2, 3],
    ),
    (
        "HOT_PIXELS",
        "NORMAL",
        {
            "row_px": lambda t: np.where(np.arange(ROWS) % STARS == 3, 100.2, t.row_px),
            "col_px": lambda t: np.where(np.arange(ROWS) % STARS == 3, 800.4, t.col_px),
            "star_id": lambda t: np.where(np.arange(ROWS) % STARS == 3, 0, t.star_id),
        },
        EXPOSURES,
        [5 + STARS * k for k in range(20)],
    ),
    ("POOR_COVERAGE", "CAUTION", {"row_px": lambda t: t.row_px * 0.3}, None, []),
    (
        "POOR_RADIUS",
        "CAUTION",
        {"row_px": lambda t: t.row_px * 0.5 + 190, "col_px": lambda t: t.col_px * 0.5 + 250},
        ROWS,
        [],
    ),
    ("TEMPERATURE_RANGE", "CAUTION", {"temperature_c": lambda t: t.temperature_c + t.frame}, ROWS, []),
    ("SIGMA_MISSING", "NORMAL", {"sigma_px": with_rows(np.full(ROWS, 0.1), {6: np.nan})}, 1, [8]),
    ("UNKNOWN_COLUMNS", "NORMAL", {"unknown": {"flux": pa.chunked_array([["1"] * ROWS])}}, 1, []),
    (
        "UNKNOWN_STARS_WITH_DIRECTION",
        "NORMAL",
        {
            "star_id": lambda t: with_rows(t.star_id, {0: 900}),
            "ra_rad": np.zeros(ROWS),
            "dec_rad": np.zeros(ROWS),
        },
        1,
        [2],
    ),
]


@pytest.mark.parametrize(
    ("code", "severity", "changes", "count", "rows"), CASES, ids=[f"{case[0]}-{case[1]}" for case in CASES]
)
def test_each_trouble_is_found_with_its_rows(telemetry, sensor, code, severity, changes, count, rows):
    troubled = dataclasses.replace(
        telemetry, **{name: change(telemetry) if callable(change) else change for name, change in changes.items()}
    )
    report = quality_report(troubled, sensor, Stars())
    found = finding(report, code)
    assert found["severity"] == severity
    assert count is None or found["count"] == count
    assert rows is None or found["rows"] == rows
    assert SEVERITIES.index(report["verdict"]) >= SEVERITIES.index(severity)
    assert (found["sentence"] in report["warnings"]) == (severity != "NORMAL")


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


@pytest.mark.parametrize("changes", [case[2] for case in CASES], ids=[f"{case[0]}-{case[1]}" for case in CASES])
def test_every_sentence_of_the_registry_agrees_with_its_number(telemetry, sensor, changes):
    troubled = dataclasses.replace(
        telemetry, **{name: change(telemetry) if callable(change) else change for name, change in changes.items()}
    )
    assert disagreements(quality_report(troubled, sensor, Stars())) == []


def test_every_finding_of_the_registry_has_a_case_above():
    assert len({case[0] for case in CASES}) == len(FINDINGS)


def test_too_few_stars_everywhere_is_serious(telemetry, sensor):
    troubled = dataclasses.replace(telemetry, star_id=np.where(np.arange(ROWS) % STARS < 3, telemetry.star_id, 0))
    report = quality_report(troubled, sensor, Stars())
    assert finding(report, "FEW_STARS")["severity"] == "SERIOUS"
    assert report["usable_frames"] == 0


def test_gaps_are_listed_with_the_frame_after_them(telemetry, sensor):
    late = dataclasses.replace(telemetry, time_utc=telemetry.time_utc + np.timedelta64(60, "s") * (telemetry.frame > 9))
    time = quality_report(late, sensor)["time"]
    assert (time["gap_count"], time["gaps"]) == (1, [{"row": 122, "frame": 10, "seconds": 61.0}])


def test_unknown_numbers_are_listed_once_each(telemetry, sensor):
    troubled = dataclasses.replace(telemetry, star_id=with_rows(telemetry.star_id, {0: 901, 20: 900, 40: 901}))
    assert quality_report(troubled, sensor, Stars())["unknown_ids"] == {"count": 2, "ids": [900, 901]}
    assert quality_report(troubled, sensor)["unknown_ids"] is None


def test_stars_that_stay_in_place_do_not_make_detections_hot_pixels(telemetry, sensor):
    still = np.arange(ROWS) % STARS
    staring = dataclasses.replace(
        telemetry,
        row_px=telemetry.row_px[still],
        col_px=telemetry.col_px[still],
        star_id=np.where(still == 3, 0, telemetry.star_id),
    )
    assert "HOT_PIXELS" not in codes(quality_report(staring, sensor, Stars()))


def test_the_worst_finding_comes_first(telemetry, sensor):
    troubled = dataclasses.replace(
        telemetry,
        unknown={"flux": pa.chunked_array([["1"] * ROWS])},
        velocity_m_s=None,
        row_px=with_rows(telemetry.row_px, {7: 900.0}),
    )
    report = quality_report(troubled, sensor, Stars())
    assert codes(report) == ["OFF_DETECTOR", "VELOCITY_MISSING", "UNKNOWN_COLUMNS"]
    assert (report["verdict"], len(report["warnings"])) == ("CAUTION", 2)


def test_rows_are_counted_as_in_the_file_they_came_from(telemetry, sensor):
    json_lines = dataclasses.replace(telemetry, row_px=with_rows(telemetry.row_px, {7: 900.0}), first_row=1)
    assert finding(quality_report(json_lines, sensor), "OFF_DETECTOR")["rows"] == [8]


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
