"""A star off the detector takes no part anywhere: every result is that of the set without the row, and says that it left it out."""

from dataclasses import fields, replace

import numpy as np
import pytest

from boresight.calibration.matching.matched_frames import match_under_states
from boresight.calibration.options import CalibrationSettings
from boresight.telemetry.schema import Telemetry
from tests.calibration.conftest import telemetry
from tests.calibration.rematched import sky
from tests.calibration.streamed import differences, in_memory, streamed, written

#: Rows of the sets below that are moved off.
MOVED = (17, 101)
PARTS = ("parameters", "sigma", "chi2", "frames", "exposures", "stars", "pairs", "rms_arc_rad", "evaluation")


def moved(whole, sensor, px=5.0):
    col_px = whole.col_px.copy()
    col_px[list(MOVED)] = sensor.columns - 0.5 + px
    return replace(whole, col_px=col_px)


def without(whole):
    kept = np.delete(np.arange(len(whole)), MOVED)
    arrays = {item.name: getattr(whole, item.name) for item in fields(Telemetry)}
    return replace(whole, **{name: value[kept] for name, value in arrays.items() if isinstance(value, np.ndarray)})


@pytest.mark.parametrize("px", [1.0, 5.0, 3000.0])
def test_given_matches_give_the_calibration_of_the_set_without_the_row(px, sensor, catalogue):
    whole = telemetry(8, frames=30)
    left = in_memory(moved(whole, sensor, px), sensor, catalogue, match="given")
    without_row = in_memory(without(whole), sensor, catalogue, match="given")
    for name in PARTS:
        assert left[name] == without_row[name], name
    assert left["left_out"] == [{"what": "stars", "count": 2, "reason": "centroid off the detector"}]
    assert left["stars_off_detector"]["stars"] == 2
    assert [star["row"] for star in left["stars_off_detector"]["rows"]] == [row + 2 for row in MOVED]
    told = sum("off the detector" in sentence for sentence in left["advice"])
    assert told == (px > 2.0)  # an image that the edge cuts is no fault


def test_stars_matched_again_are_those_of_the_set_without_the_row(catalogue):
    field = sky(catalogue, frames=12)
    whole = field.blanked(0.3)
    shifted = moved(whole, field.sensor)
    found, expected = field.match(shifted), field.match(without(whole))
    rest = np.delete(np.arange(len(whole)), MOVED)
    assert found.star_id[list(MOVED)].tolist() == [0, 0]
    np.testing.assert_array_equal(found.star_id[rest], expected.star_id)
    np.testing.assert_array_equal(found.quaternion, expected.quaternion)


@pytest.mark.parametrize("match", ["given", "rematch"])
def test_flight_scores_are_those_of_the_set_without_the_row(match, catalogue):
    field = sky(catalogue, frames=12)
    settings, states = CalibrationSettings(match=match), [(field.x, field.P)]
    (found,) = match_under_states(moved(field.telemetry, field.sensor), field.sensor, catalogue, states, settings)
    (expected,) = match_under_states(without(field.telemetry), field.sensor, catalogue, states, settings)
    assert not found.taken()[list(MOVED)].any()
    assert found.view.matched_stars == expected.view.matched_stars
    np.testing.assert_array_equal(found.view.valid, expected.view.valid)


@pytest.mark.parametrize("rows_a_group", [100, 10_000], ids=["read apart", "read from its start"])
def test_a_file_in_pieces_leaves_out_the_same_rows(rows_a_group, sensor, catalogue, tmp_path):
    path, whole = written(moved(telemetry(8, frames=30), sensor), tmp_path, rows_a_group)
    choices = {"match": "given", "validation": whole}
    one, other = in_memory(whole, sensor, catalogue, **choices), streamed(path, sensor, catalogue, 4, **choices)
    assert one["stars_off_detector"]["stars"] == 2
    assert sum("in the validation set" in sentence for sentence in one["advice"]) == 1
    assert differences(one, other) == []
