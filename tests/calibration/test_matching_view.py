"""The `matching` object: counts that add up, phrases instead of numbers, nulls instead of nothing."""

import json
from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.matching.match_report import CyclesEnd, counted, matching_view
from boresight.calibration.matching.matched import Matched, MatchedRange
from boresight.calibration.matching.matched_frames import read_given_matches
from boresight.calibration.telemetry_pieces import MatchedRows
from boresight.sky.guide_stars import DOUBLE, UNRELIABLE
from boresight.sky.matching import EXPOSURE_REASONS, ROW_REASONS, STARTS
from tests.calibration.rematched import sky

EVALUATION = {"flight_tolerance_rad": 4e-4, "availability": {"initial": 0.1}, "matched_stars": {"initial": 9}}


@pytest.fixture(scope="module")
def field(catalogue):
    return sky(catalogue, 3, 20)


class AtState:
    def __init__(self, x):
        self.x = x


def view(field, telemetry, matches):
    ended = CyclesEnd(
        Matched(None, (MatchedRange(MatchedRows(telemetry, matches, matches.star_id)),)), AtState(field.x)
    )
    return matching_view(telemetry, field.sensor, ended, EVALUATION)


def test_every_count_adds_up(field):
    telemetry = field.blanked(0.5)
    wrong = telemetry.star_id.copy()
    named = np.flatnonzero(wrong)
    wrong[named[:5]] = np.roll(wrong[named[:5]], 1)
    telemetry = replace(telemetry, star_id=wrong)
    matches = field.match(telemetry)
    shown = view(field, telemetry, matches)
    assert shown["given"] == shown["kept"] + shown["removed"] == (wrong > 0).sum()
    assert shown["matched"] == shown["kept"] + shown["renamed"] + shown["added"] == (matches.star_id > 0).sum()
    assert shown["removed"] >= 1
    assert sum(shown["row_reasons"].values()) == len(telemetry) - shown["matched"]
    assert sum(shown["removed_reasons"].values()) == shown["removed"] - shown["renamed"]
    assert sum(shown["starts"].values()) == sum(shown["exposure_reasons"].values()) == 40
    assert set(shown["row_reasons"]) <= set(ROW_REASONS[1:])
    assert set(shown["starts"]) <= set(STARTS)
    assert set(shown["exposure_reasons"]) <= set(EXPOSURE_REASONS)
    json.dumps(shown, allow_nan=False)


def test_the_flight_scores_and_the_tolerance_in_pixels_are_shown(field):
    shown = view(field, field.telemetry, field.match(field.telemetry))
    assert shown["flight"] == {
        "tolerance_rad": 4e-4, "availability": {"initial": 0.1}, "matched_stars": {"initial": 9},
    }  # fmt: skip
    # no gate is narrower than its own centroid noise
    assert 4.5 * 0.437 * 0.95 < shown["tolerance_px"]["median"] <= shown["tolerance_px"]["p95"]


def test_flagged_stars_are_counted_by_what_is_against_them(field):
    matches = field.match(field.blanked(0.5), leave_out_doubles=True)
    flagged = view(field, field.blanked(0.5), matches)["flagged"]
    assert flagged["doubles"] == (matches.flags & DOUBLE > 0).sum()
    assert flagged["unreliable"] == (matches.flags & UNRELIABLE > 0).sum()
    assert max(flagged["doubles"], flagged["unreliable"]) <= flagged["left_out"]
    assert flagged["left_out"] <= flagged["doubles"] + flagged["unreliable"]


def test_where_nothing_is_matched_there_are_nulls(field):
    bare = replace(field.telemetry, star_id=None, quaternion=None, time_utc=None)
    shown = view(field, bare, field.match(bare))
    assert shown["matched"] == shown["given"] == 0
    assert shown["tolerance_px"] == {"median": None, "p95": None}
    assert shown["row_reasons"] == {ROW_REASONS[5]: len(bare)}


def test_given_matches_have_no_view(field, catalogue):
    assert view(field, field.telemetry, read_given_matches(field.telemetry, field.sensor, catalogue)) is None


def test_the_most_frequent_phrase_comes_first():
    assert list(counted(np.array([1, 0, 1], np.int8), ("a", "b")).items()) == [("b", 2), ("a", 1)]
