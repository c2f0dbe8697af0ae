"""Two states side by side: every frame and star that one alone has is named, and the test says what chance would do."""

from dataclasses import replace

import numpy as np
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from boresight.calibration.evaluation import shadow
from boresight.calibration.evaluation.shadow import mcnemar, shadow_view, summary
from boresight.calibration.matching.matched_frames import match_under_states
from boresight.calibration.options import CalibrationSettings
from tests.estimation.fields import GROUND, TRUTH

GIVEN = CalibrationSettings(match="given")


@pytest.fixture
def seen_under(sensor, catalogue):
    return lambda telemetry, x: match_under_states(telemetry, sensor, catalogue, [(x, None)], GIVEN)[0]


def test_what_one_side_loses_the_other_gains(telemetry_of, seen_under):
    telemetry = telemetry_of(1)
    ground, truth = seen_under(telemetry, GROUND), seen_under(telemetry, TRUTH)
    there, back = shadow_view(telemetry, ground, truth), shadow_view(telemetry, truth, ground)
    assert orjson.loads(orjson.dumps(there)) == there
    assert there["summary"]["candidate_only"] == back["summary"]["baseline_only"] > 0
    assert there["summary"]["stars_gained"] == back["summary"]["stars_lost"] > 0
    for one, other in zip(there["frames"], back["frames"], strict=True):
        assert (one["gained"], one["lost"]) == (other["lost"], other["gained"])
        assert (one["baseline"], one["candidate"]) == (other["candidate"], other["baseline"])


def test_the_counts_of_stars_and_the_lists_of_frames_agree(telemetry_of, seen_under):
    telemetry = telemetry_of(2)
    ground, truth = seen_under(telemetry, GROUND), seen_under(telemetry, TRUTH)
    found = shadow_view(telemetry, ground, truth)
    assert [frame["frame"] for frame in found["frames"]] == list(range(40))
    for frame in found["frames"]:
        difference = frame["candidate"]["matched"] - frame["baseline"]["matched"]
        assert len(frame["gained"]) - len(frame["lost"]) == difference
        assert (frame["baseline"]["reason"] is None) == frame["baseline"]["valid"]
        own = telemetry.star_id[telemetry.frame == frame["frame"]]
        assert set(frame["gained"]) | set(frame["lost"]) <= set(own.tolist())
    assert sum(frame["baseline"]["valid"] for frame in found["frames"]) == ground.view.valid_frames.sum()
    assert sum(len(frame["gained"]) for frame in found["frames"]) == found["summary"]["stars_gained"]


def test_a_state_beside_itself_loses_and_gains_nothing(telemetry_of, seen_under):
    telemetry = telemetry_of(3)
    seen = seen_under(telemetry, TRUTH)
    found = shadow_view(telemetry, seen, seen)["summary"]
    assert (found["baseline_only"], found["candidate_only"], found["stars_lost"], found["stars_gained"]) == (0, 0, 0, 0)
    assert found["p"] == 1
    assert found["sentence"].startswith("Both parameter sets solve the same frames")


def test_a_long_set_keeps_the_frames_that_differ_and_counts_them_all(telemetry_of, seen_under, monkeypatch):
    telemetry = telemetry_of(4)
    seen = seen_under(telemetry, TRUTH)
    failing = seen.view.valid_frames.copy()
    failing[[5, 17]] = False
    worse = replace(seen, view=replace(seen.view, valid_frames=failing))
    monkeypatch.setattr(shadow, "MOST_FRAMES", 6)
    monkeypatch.setattr(shadow, "MOST_DIFFERING", 3)
    found = shadow_view(telemetry, seen, worse)
    kept = [frame["frame"] for frame in found["frames"]]
    assert {0, 5, 17, 39} <= set(kept)
    assert kept == sorted(set(kept))
    assert len(kept) <= 6
    assert found["frames_in_set"] == 40
    assert found["summary"]["baseline_only"] == 2


def test_frames_bear_the_time_they_were_taken(telemetry_of, seen_under):
    telemetry = telemetry_of(5, frames=2)
    times = np.datetime64("2026-10-01T00:00:00", "us") + telemetry.frame * np.timedelta64(40, "s")
    seen = seen_under(telemetry, TRUTH)
    timed, untimed = shadow_view(replace(telemetry, time_utc=times), seen, seen), shadow_view(telemetry, seen, seen)
    assert timed["frames"][1]["time_utc"] == "2026-10-01T00:00:40.000000Z"
    assert untimed["frames"][1]["time_utc"] is None


@given(b=st.integers(0, 60), c=st.integers(0, 60))
def test_the_test_is_the_exact_binomial_one(b, c):
    expected = binomtest(b, b + c).pvalue if b + c else 1.0
    assert mcnemar(b, c) == pytest.approx(expected, rel=1e-9)


def test_alike_states_are_told_apart_no_more_often_than_the_test_says():
    rng = np.random.default_rng(6)
    p = [mcnemar(int(rng.binomial(40, 0.5)), 0) for _ in range(3)]  # one-sided splits are never called chance
    fair = [mcnemar(b, 40 - b) for b in rng.binomial(40, 0.5, 2000).tolist()]
    assert max(p) < 0.05
    assert np.mean(np.array(fair) < 0.05) < 0.05


@pytest.mark.parametrize(
    ("baseline", "candidate", "words"),
    [
        ([1, 1, 0, 0], [1, 1, 0, 0], "solve the same frames"),
        ([0] * 9, [1] * 9, "solves 9 frames that the baseline loses and loses no frame that the baseline solves"),
        ([1, 1], [0, 1], "loses 1 frame that the baseline solves and solves no frame that the baseline loses"),
        ([1, 1], [0, 1], "which chance alone would explain"),
    ],
)
def test_the_summary_says_it_in_a_sentence(baseline, candidate, words):
    found = summary(np.array(baseline, bool), np.array(candidate, bool), 1, 2)
    assert words in found["sentence"]
    assert "2 sightings of stars are gained and 1 lost" in found["sentence"]
