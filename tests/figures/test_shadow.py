"""The side-by-side chart: the set it shows, the frames it marks, what it says."""

import numpy as np
import orjson
import pytest

from boresight.figures import Trace, figure_json
from boresight.figures.charts.shadow import SHADOW


def side(valid, matched):
    return {"valid": valid, "matched": matched if valid else 0, "reason": None if valid else "too few stars"}


def view(n_frames=40, lost=(7,), gained=(1, 2, 3)):
    rng = np.random.default_rng(3)
    return {
        "frames": [
            {
                "frame": k,
                "time_utc": None,
                "baseline": side(k not in gained, int(rng.integers(4, 20))),
                "candidate": side(k not in lost, int(rng.integers(10, 30))),
                "lost": [1, 2] if k in lost else [],
                "gained": [3],
            }
            for k in range(n_frames)
        ],
        "frames_in_set": n_frames,
        "flight_tolerance_rad": 4.2e-4,
        "summary": {"baseline_only": len(lost), "candidate_only": len(gained), "sentence": "So it is."},
    }


def result(**sets):
    return {"shadow": {"calibration": None, "validation": None} | sets}


def test_the_validation_set_is_shown_before_the_calibration_set():
    both = SHADOW.draw([Trace("run", result(calibration=view(10), validation=view(20)))])
    one = SHADOW.draw([Trace("run", result(calibration=view(10)))])
    assert both.layout.title.text == "Validation set: 3 frames gained, 1 lost"
    assert one.layout.title.text.startswith("Calibration set")
    assert len(both.data[0].x) == 20


def test_frames_that_one_side_alone_solves_are_marked_by_their_own_shapes():
    drawn = {
        trace.marker.symbol: list(trace.x)
        for trace in SHADOW.draw([Trace("run", result(calibration=view()))]).data
        if trace.mode == "markers"
    }
    assert drawn == {"triangle-up-open": [1, 2, 3], "x-thin-open": [7]}


def test_baseline_and_candidate_are_both_drawn_and_named():
    names = [trace.name for trace in SHADOW.draw([Trace("run", result(calibration=view()))]).data]
    assert names == [
        "baseline",
        "candidate",
        "only the candidate solves it (3)",
        "only the baseline solves it: lost (1)",
    ]


def test_nothing_lost_leaves_no_cross_in_the_legend():
    drawn = SHADOW.draw([Trace("run", result(calibration=view(lost=())))])
    assert [trace.showlegend for trace in drawn.data if trace.mode == "markers"] == [True, False]


def test_a_comparison_gives_each_candidate_its_colour_and_stays_small():
    many = [
        Trace(f"run {i}", result(validation=view(2000, lost=range(500), gained=range(500, 1000)))) for i in range(8)
    ]
    text = figure_json(SHADOW.draw(many))
    assert b"#3b8fe0" in text
    assert b"#d9730d" in text
    assert len(text) < 500_000


@pytest.mark.parametrize("document", [{}, {"shadow": None}, result(), result(validation={"frames": []})])
def test_without_a_view_it_says_what_is_missing(document):
    drawn = SHADOW.draw([Trace("run", document)])
    assert not drawn.data
    assert "side by side when the run ends" in drawn.layout.annotations[0].text
    assert SHADOW.table(document) == {}


def test_the_table_lists_every_frame_with_the_stars_that_moved():
    columns = SHADOW.table(result(calibration=view()))
    assert {len(column) for column in columns.values()} == {40}
    assert columns["lost"][7] == "1 2"
    assert columns["candidate_reason"][7] == "too few stars"
    assert orjson.dumps(columns)
