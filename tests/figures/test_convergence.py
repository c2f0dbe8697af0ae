"""Convergence shows each parameter with its three-sigma band, and says what is missing."""

import numpy as np
import pytest

from boresight.figures import FIGURES, Trace


def lines(drawn, name):
    return [trace for trace in drawn.data if trace.name == name]


def test_there_is_one_panel_a_free_parameter_and_two_that_judge(sequential_result):
    narrow = sequential_result | {"free": ["f_m", "b2_per_m2"]}
    drawn = FIGURES["convergence"].draw([Trace("Run", narrow)])
    panels = {trace.yaxis for trace in drawn.data}
    assert len(panels) == 4
    assert len(lines(drawn, "Run")) == 4


def test_the_focal_length_is_drawn_as_micrometres_since_the_initial_value(sequential_result):
    drawn = FIGURES["convergence"].draw([Trace("Run", sequential_result)])
    first = lines(drawn, "Run")[0]
    change_m = sequential_result["parameters"]["f_m"] - sequential_result["initial"]["f_m"]
    assert first.y[-1] == pytest.approx(change_m * 1e6, rel=1e-4)
    assert "µm" in drawn.layout.yaxis.title.text


def test_the_band_is_three_sigma_about_the_estimate(sequential_result):
    drawn = FIGURES["convergence"].draw([Trace("Run", sequential_result)])
    outline = np.array(lines(drawn, "Run ±3σ")[0].y, dtype=float)
    upper, lower = outline[: len(outline) // 2], outline[len(outline) // 2 :][::-1]
    sigma_um = np.array(sequential_result["history"]["sigma"])[:, 0] * 1e6
    assert (upper - lower) / 2 == pytest.approx(3 * sigma_um, rel=1e-3)


def test_truth_is_drawn_only_where_a_simulation_knows_it(sequential_result):
    known = FIGURES["convergence"].draw([Trace("Run", sequential_result)])
    assert lines(known, "truth")
    unknown = FIGURES["convergence"].draw([Trace("Run", sequential_result | {"truth": None})])
    assert not lines(unknown, "truth")
    assert lines(unknown, "initial")


def test_beside_a_filter_a_batch_run_is_a_level_over_the_frames(sequential_result, batch_result):
    drawn = FIGURES["convergence"].draw([Trace("filter", sequential_result), Trace("batch", batch_result)])
    level = lines(drawn, "batch")[0]
    assert list(level.x) == [0, 199]
    assert level.y[0] == level.y[1]


def test_a_fixed_parameter_has_null_sigmas_and_no_panel(sequential_result):
    history = sequential_result["history"]
    sigma = [[*row[:7], None] for row in history["sigma"]]
    free = sequential_result["free"][:7]
    fixed = sequential_result | {"history": history | {"sigma": sigma}, "free": free}
    drawn = FIGURES["convergence"].draw([Trace("Run", fixed)])
    assert len(lines(drawn, "Run")) == 9
    assert FIGURES["convergence"].table(fixed)["sigma_g_y"] == [None] * 200


def test_the_cost_of_a_batch_run_is_on_a_log_axis(batch_result):
    drawn = FIGURES["convergence"].draw([Trace("Run", batch_result)])
    assert drawn.layout.yaxis9.title.text == "cost"
    assert drawn.layout.yaxis9.type == "log"


def test_the_step_of_a_batch_is_in_final_sigmas_and_may_be_seen_on_either_scale(batch_result):
    drawn = FIGURES["convergence"].draw([Trace("Run", batch_result)])
    value, sigma = (np.array(batch_result["trace"][key]) for key in ("parameters", "sigma"))
    expected = np.sqrt(np.mean((np.diff(value, axis=0) / sigma[-1]) ** 2, axis=1))
    step = next(trace for trace in lines(drawn, "Run") if trace.yaxis == "y10")
    assert step.y[1:] == pytest.approx(expected, rel=1e-4)
    assert set(drawn.layout.meta["log"]) == {"yaxis9", "yaxis10"}


def test_the_step_from_which_on_nothing_leaves_three_final_sigmas_is_marked_in_every_panel(sequential_result):
    history, free = sequential_result["history"], range(8)
    value, sigma = (np.array(history[key])[:, free] for key in ("parameters", "sigma"))
    inside = (np.abs(value - value[-1]) <= 3 * sigma[-1]).all(axis=1)
    first = next(k for k in range(len(inside)) if inside[k:].all())
    drawn = FIGURES["convergence"].draw([Trace("Run", sequential_result)])
    marks = [shape for shape in drawn.layout.shapes if shape.x0 == shape.x1]
    assert {shape.x0 for shape in marks} == {float(history["frame"][first])}
    assert len({shape.yref for shape in marks}) == 10
    assert lines(drawn, f"settled at {history['frame'][first]}")


def test_a_run_on_its_way_has_not_settled(sequential_result):
    drawn = FIGURES["convergence"].draw([Trace("Run", sequential_result | {"status": "running"})])
    assert not any("settled" in (trace.name or "") for trace in drawn.data)


def test_the_baseline_is_a_line_where_it_is_not_what_the_run_started_from(sequential_result):
    moved = {name: 1.001 * value for name, value in sequential_result["initial"].items()}
    drawn = FIGURES["convergence"].draw([Trace("Run", sequential_result | {"baseline": moved})])
    level = lines(drawn, "baseline")[0]
    assert level.y[0] == pytest.approx((moved["f_m"] - sequential_result["initial"]["f_m"]) * 1e6, rel=1e-4)


def test_the_charts_over_frames_share_their_cursor(sequential_result):
    for name in ("convergence", "rms", "frame-observability"):
        assert FIGURES[name].draw([Trace("Run", sequential_result)]).layout.meta["axis"] == "frame"
