"""Convergence shows each parameter with its three-sigma band, and says what is missing."""

import numpy as np
import pytest

from boresight.figures import FIGURES, Trace


def lines(drawn, name):
    return [trace for trace in drawn.data if trace.name == name]


def test_there_is_one_panel_a_free_parameter_and_one_that_judges(sequential_result):
    narrow = sequential_result | {"free": ["f_m", "b2_per_m2"]}
    drawn = FIGURES["convergence"].draw([Trace("Run", narrow)])
    panels = {trace.yaxis for trace in drawn.data}
    assert len(panels) == 3
    assert len(lines(drawn, "Run")) == 3


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
    assert len(lines(drawn, "Run")) == 8
    assert FIGURES["convergence"].table(fixed)["sigma_g_y"] == [None] * 200


def test_the_cost_of_a_batch_run_is_on_a_log_axis(batch_result):
    drawn = FIGURES["convergence"].draw([Trace("Run", batch_result)])
    assert drawn.layout.yaxis9.title.text == "cost"
    assert drawn.layout.yaxis9.type == "log"
