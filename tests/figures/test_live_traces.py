"""A growing curve's own description: applied to the points of a course it gives the curve that the figure draws."""

from __future__ import annotations

import numpy as np
import pytest

from boresight.figures import FIGURES, Trace


def grown(follow, history, first):
    """What a page draws for the points from the first on, by the trace's own words."""
    values = np.array(history[follow["column"]], float)[first:]
    value = values if follow.get("index") is None else values[:, follow["index"]]
    return (value - follow.get("origin", 0.0)) * follow["factor"]


@pytest.fixture
def running(sequential_result):
    return {**sequential_result, "status": "running"}


@pytest.mark.parametrize("name", ["convergence", "rms"])
def test_what_a_trace_says_of_its_growth_gives_the_points_that_it_shows(running, name):
    history = running["history"]
    figure = FIGURES[name].draw([Trace("Run", running)])
    growing = [trace for trace in figure.data if "follow" in (trace.meta or {})]
    curves = [trace for trace in growing if not {"band", "level"} & set(trace.meta["follow"])]
    assert len(curves) == {"convergence": 9, "rms": 4}[name]
    for trace in curves:
        follow = trace.meta["follow"]
        if follow["column"] == "nis_per_dof":
            continue
        shown = np.asarray(trace.y, float)
        assert grown(follow, history, -len(shown)) == pytest.approx(shown, rel=1e-5, abs=1e-4)


def test_a_band_lies_three_sigmas_around_its_curve(running):
    figure = FIGURES["convergence"].draw([Trace("Run", running)])
    for trace in figure.data:
        if (trace.meta or {}).get("follow", {}).get("band"):
            follow = trace.meta["follow"]
            half = len(trace.y) // 2
            sigma = np.array(running["history"]["sigma"], float)[-half:, follow["index"]]
            centre = grown(follow, running["history"], -half)
            expected = centre + follow["band"] * sigma * follow["factor"]
            assert expected == pytest.approx(np.asarray(trace.y, float)[:half], rel=1e-5, abs=1e-4)


@pytest.mark.parametrize("name", ["convergence", "rms"])
def test_only_the_figure_of_one_running_filter_says_how_it_grows(running, sequential_result, name):
    for traces in ([Trace("Run", sequential_result)], [Trace("a", running), Trace("b", running)]):
        assert not any("follow" in (trace.meta or {}) for trace in FIGURES[name].draw(traces).data)
