"""What single charts promise: levels, hatching, bands, orientation, significance, growth, and methods beside each other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.calibration import (
    USABLE,
    Calibration,
    Covariance,
    History,
    Inputs,
    Trust,
    Values,
)  # fmt: skip
from boresight.calibration.evaluation.contrast import RadialContrast
from boresight.calibration.options import StatedSettings
from boresight.estimation.statistics.observability import WEAK
from boresight.figures import FIGURES, Trace
from boresight.figures.chart import tailed
from boresight.figures.charts import radial as radial_contrast
from boresight.figures.charts.frame_observability import NEVER
from boresight.figures.charts.methods import method_scores
from boresight.figures.charts.radial import OLDER
from boresight.figures.factory import column
from boresight.figures.style import theme
from boresight.figures.style.axes import EXTRAPOLATED
from boresight.verdicts.answers import make_four_views
from boresight.verdicts.gates.measurements import GATES
from boresight.verdicts.history import settled_step, sigma_of_rms, summarise_tail
from boresight.verdicts.verdict import summarise_run


def named(drawn, name):
    return [trace for trace in drawn.data if trace.name == name]


def draw(name, *results, **changes):
    return FIGURES[name].draw(
        [Trace(label, replace(result, **changes)) for label, result in zip(("Run", "other"), results, strict=False)]
    )


def test_rms_is_in_microradians_with_both_levels_and_a_dash_for_tail_and_aggregate(sequential_result):
    drawn = draw("rms", sequential_result)
    assert named(drawn, "old parameters")[0].y[0] == pytest.approx(412.9)
    assert named(drawn, "new parameters")[0].y[0] == pytest.approx(82.6)
    assert "µrad" in drawn.layout.yaxis.title.text
    curves = [named(drawn, f"Run · {kind}")[0].line for kind in ("tail", "aggregate")]
    assert [line.dash for line in curves] == ["solid", "dot"]
    assert curves[0].color != curves[1].color


def test_the_tail_begins_where_the_run_had_settled_or_where_a_reader_wants_it(sequential_result):
    whole, running = (Trace("Run", replace(sequential_result, status=status)) for status in (USABLE, "running"))
    starts = (
        (whole, settled_step(sequential_result)),
        (*tailed([whole], 50), 50),
        (running, 40),
    )  # a fifth is left out
    for trace, start in starts:
        drawn = FIGURES["rms"].draw([trace])
        (whole,), (mark,) = named(drawn, "Run · tail"), [shape for shape in drawn.layout.shapes if shape.x0 == shape.x1]
        assert min(whole.x) == 0
        assert mark.x0 == pytest.approx(start, abs=1)


def test_the_tail_s_mean_and_sigma_are_those_of_the_window_and_an_rms_scatters_by_its_sigma(sequential_result):
    (trace,) = tailed([Trace("Run", sequential_result)], 100)
    tail = summarise_tail(trace.result, trace.tail_from)
    mean = np.mean(sequential_result.history.tail_rms_rad[100:])
    assert (tail.points, tail.chosen) == (100, True)
    assert tail.tail_rad == pytest.approx(mean)
    assert tail.sigma_rad == pytest.approx(mean / np.sqrt(2 * sequential_result.pairs))
    arcs = np.random.default_rng(3).normal(size=(4000, 200))
    rms = np.sqrt(np.mean(arcs**2, axis=1))
    assert rms.std() == pytest.approx(sigma_of_rms(1.0, 200), rel=0.05)


@pytest.mark.parametrize(("name", "panels"), [("distortion", 1), ("radial", 3)])
def test_radii_without_stars_are_hatched_from_the_outermost_star_on_and_named_once(name, panels, sequential_result):
    hatched = named(draw(name, sequential_result), "no stars: extrapolated")
    reached, last = sequential_result.radial.data_radius_px, sequential_result.radial.radius_px[-1]
    assert [(min(one.x), max(one.x)) for one in hatched] == [(reached, pytest.approx(last))] * panels
    assert {one.fillpattern.shape for one in hatched} == {"/"}
    assert [one.showlegend for one in hatched].count(True) == 1


def test_displacements_differ_by_the_radial_difference_or_say_how_to_have_them(sequential_result):
    drawn = draw("distortion", sequential_result)
    (new,), (old,) = named(drawn, "Run"), named(drawn, "old: at launch")
    assert np.array(new.y) - np.array(old.y) == pytest.approx(sequential_result.radial.difference_px, abs=1e-5)
    radial = replace(sequential_result.radial, displacement_px=None)
    (said,) = draw("distortion", sequential_result, radial=radial).layout.annotations
    assert said.text.replace("<br>", " ") == OLDER


def test_correlations_are_the_covariance_over_the_sigmas_and_name_the_strongest_pair():
    P = np.array([[4.0, -5.4], [-5.4, 9.0]])
    result = Calibration(status=USABLE, covariance=Covariance(names=["f_m", "b2_per_m2"], matrix=P.tolist()))
    drawn = draw("correlation", result)
    assert np.array(drawn.data[0].z, float)[0, 1] == pytest.approx(-0.9)
    assert np.isnan(np.array(drawn.data[0].z, float)[0, 0])
    assert "−0.900: use them together" in drawn.layout.title.text
    assert FIGURES["correlation"].table(result)["correlation"] == pytest.approx([1.0, -0.9, 1.0])


def test_maps_beside_each_other_have_short_titles_and_one_set_of_row_labels_where_detectors_are_alike(
    sequential_result,
):
    shorter = replace(sequential_result.coverage, row_edges_px=np.linspace(-0.5, 1023.5, 13).tolist())
    short = ["Run 12", "Run 13"]
    labels = [f"{run} · Square-root filter, fed as frames come down" for run in short]
    alike, unlike = (
        FIGURES["coverage"].draw(
            list(map(Trace, labels, (sequential_result, replace(sequential_result, coverage=seen)), short))
        )
        for seen in (sequential_result.coverage, shorter)
    )
    assert [title.text for title in alike.layout.annotations] == short
    assert (alike.layout.yaxis.showticklabels, alike.layout.yaxis2.showticklabels) == (True, False)
    assert labels[1] in alike.data[1].hovertemplate
    assert unlike.layout.yaxis2.showticklabels
    assert unlike.layout.xaxis2.domain[0] - unlike.layout.xaxis.domain[1] >= 0.19


def test_the_arcsecond_axis_is_the_pixel_axis_by_the_plate_scale_where_all_runs_have_one(sequential_result):
    drawn, radial = draw("radial", sequential_result), sequential_result.radial
    scale = radial.difference_arcsec[1] / radial.difference_px[1]
    assert np.array(drawn.layout.yaxis2.range) / np.array(drawn.layout.yaxis.range) == pytest.approx(scale, rel=1e-5)
    twice = {name: [2 * v for v in getattr(radial, name)] for name in ("difference_arcsec", "sigma_arcsec")}
    other = replace(sequential_result, radial=replace(radial, **twice))
    assert draw("radial", sequential_result, other).layout.yaxis2.range is None


def test_each_direction_is_a_column_with_its_largest_share_positive_and_the_weakest_said_in_words(sequential_result):
    drawn, seen = draw("observability", sequential_result), sequential_result.observability
    shares = np.array(drawn.data[-1].z, dtype=float)
    assert np.abs(shares) == pytest.approx(np.abs(np.array(seen.right_singular_vectors).T), abs=1e-6)
    assert np.all(shares[np.argmax(np.abs(shares), axis=0), np.arange(8)] > 0)
    assert f"{seen.condition_number:.0f}" in drawn.layout.title.text
    assert any(
        "<i>g</i><sub>y</sub> and <i>f</i> move together" in annotation.text for annotation in drawn.layout.annotations
    )
    open_one = replace(seen, singular_values=[*seen.singular_values[:-1], 0.0], condition_number=None)
    assert "infinite" in draw("observability", sequential_result, observability=open_one).layout.title.text


def test_a_direction_that_is_not_seen_is_amber_and_hatched_and_figure_view_verdict_and_gate_have_one_limit(
    sequential_result,
):
    seen = sequential_result.observability
    spread = [0.1] * 5 + [WEAK, 1.01 * WEAK, None]
    values = [0.0 if one is None else 1 / one for one in spread]
    weak = replace(seen, singular_values=values, sigma_of_direction=spread, condition_number=None)
    for drawn in (
        draw("observability", sequential_result, observability=weak),
        draw_small("observability", weak, sequential_result),
    ):
        assert list(drawn.data[0].marker.pattern.shape) == [""] * 6 + ["/"] * 2
        assert len(set(drawn.data[0].marker.color[:6])) == len(set(drawn.data[0].marker.color[6:])) == 1
        assert drawn.data[0].marker.color[0] != drawn.data[0].marker.color[-1]
    result = replace(sequential_result, observability=weak)
    said = "2 of 8 directions are weak"
    assert said in draw("observability", result).layout.title.text
    assert said in make_four_views(result)[3].answer.sentence
    assert summarise_run(result).weak_directions == 2
    assert GATES["weak-directions"].marginal == WEAK


def draw_small(name, seen, result):
    return FIGURES[name].forms["small"]([Trace("Run", replace(result, observability=seen))])


def test_the_four_views_have_small_figures_without_title_or_legend_that_grow_as_the_large_ones_do(running):
    for view in make_four_views(running):
        drawn = FIGURES[view.figure].forms["small"]([Trace("Run", running)])
        assert not drawn.layout.title.text
        assert not drawn.layout.showlegend
    small = FIGURES["convergence"].forms["small"]([Trace("Run", running)])
    curves = [one for one in small.data if (one.meta or {}).get("follow", {}).get("index") is not None]
    assert len([one for one in curves if not one.fill]) == len(running.free)
    for one in curves:
        if not one.fill:
            shown = np.asarray(one.y, float)
            assert grown(one.meta["follow"], running.history, -1) == pytest.approx(shown[-1:], abs=1e-4)


def test_the_band_of_the_radial_difference_has_a_panel_of_its_own_around_nought(sequential_result):
    drawn = draw("radial", sequential_result)
    (curve,), (band,) = named(drawn, "Run"), named(drawn, "Run ±3σ")
    assert curve.yaxis != band.yaxis
    y = np.asarray(band.y, float)
    assert max(y) == pytest.approx(-min(y)) == pytest.approx(3 * max(sequential_result.radial.sigma_px), rel=1e-4)


def test_bands_are_named_in_the_legend_once_a_run(sequential_result):
    for name in ("convergence", "rms", "radial"):
        assert [one.showlegend for one in named(draw(name, sequential_result), "Run ±3σ")].count(True) == 1


def test_the_first_detector_row_is_at_the_top_and_empty_cells_are_gaps(sequential_result):
    drawn, counts = draw("coverage", sequential_result), np.array(sequential_result.coverage.counts)
    assert drawn.layout.yaxis.autorange == "reversed"
    assert np.array_equal(np.isnan(np.array(drawn.data[0].z, dtype=float)), counts == 0)


def test_a_change_within_three_sigma_is_paler_and_compared_runs_stand_beside_each_other(
    sequential_result, batch_result
):
    still = Values({**sequential_result.initial, "f_m": sequential_result.parameters.f_m})
    drawn = draw("parameters", sequential_result, parameters=still)
    assert drawn.data[0].marker.color[0] == "#3b8fe0"
    assert all(colour.startswith("rgba") for colour in drawn.data[0].marker.color[1:])
    assert "1 of 8" in drawn.layout.title.text
    both = draw("parameters", sequential_result, batch_result)
    assert [trace.offsetgroup for trace in both.data] == ["Run", "Run", "other", "other"]
    columns = FIGURES["parameters"].table(sequential_result)
    assert columns["final"][0] == sequential_result.parameters.f_m
    assert columns["delta_over_sigma"][0] == pytest.approx(sequential_result.delta_over_sigma.f_m)


def test_radii_that_no_star_of_both_runs_reached_are_hatched_over_the_height_of_the_comparison():
    curve = RadialContrast(
        radius_px=[0.0, 500.0, 1000.0],
        difference_px=[0.0, 1.0, 4.0],
        sigma_px=[0.0, 0.1, 0.5],
        difference_arcsec=[0.0, 28.0, 112.0],
        sigma_arcsec=[0.0, 2.8, 14.0],
        data_radius_px=700.0,
    )
    drawn = radial_contrast.draw_radial_contrast(["one", "other"], 0, [None, curve])
    (hatched,) = named(drawn, EXTRAPOLATED)
    assert hatched.fillpattern.shape == "/"
    assert (min(hatched.x), max(hatched.x)) == (700.0, 1000.0)
    assert min(hatched.y) < 0.0 < 4.0 + 3 * 0.5 < max(hatched.y)
    whole = radial_contrast.draw_radial_contrast(["one", "other"], 0, [None, replace(curve, data_radius_px=1000.0)])
    assert named(whole, EXTRAPOLATED) == []


def test_free_parameters_have_panels_and_fixed_ones_null_sigmas_and_none(sequential_result):
    drawn = draw("convergence", sequential_result, free=["f_m", "b2_per_m2"])
    assert len({trace.yaxis for trace in drawn.data}) == len(named(drawn, "Run")) == 4
    history = sequential_result.history
    held = replace(history, sigma=[[*row[:7], None] for row in history.sigma])
    fixed = replace(sequential_result, history=held, free=sequential_result.free[:7])
    assert len(named(draw("convergence", fixed), "Run")) == 9
    assert FIGURES["convergence"].table(fixed)["sigma_g_y"] == [None] * 200


def panel_names(drawn):
    """The names that stand over the panels, by their y axes."""
    return {one.yref.removesuffix(" domain"): one.text for one in drawn.layout.annotations}


def test_many_panels_are_named_at_one_distance_above_them_in_as_many_columns_as_there_is_room_for(sequential_result):
    for form, columns in (("large", 4), ("medium", 2), ("narrow", 1)):
        drawn = FIGURES["convergence"].draw_for(form, [Trace("Run", sequential_result)])
        assert len({axis.domain for axis in drawn.select_xaxes()}) == columns
        assert len(panel_names(drawn)) == len(list(drawn.select_yaxes({"visible": None}))) == 10
        assert {(one.x, one.y, one.yshift) for one in drawn.layout.annotations} == {(0, 1, 2)}
        assert not any(axis.title.text for axis in drawn.select_yaxes())


def test_the_focal_length_is_in_millimetres_since_its_start_with_a_band_of_three_sigmas(sequential_result):
    drawn = draw("convergence", sequential_result)
    change_m = sequential_result.parameters.f_m - sequential_result.initial.f_m
    assert named(drawn, "Run")[0].y[-1] == pytest.approx(change_m * 1e3, rel=1e-4)
    assert "mm" in panel_names(drawn)["y"]
    outline = np.array(named(drawn, "Run ±3σ")[0].y, dtype=float)
    upper, lower = outline[: len(outline) // 2], outline[len(outline) // 2 :][::-1]
    sigma_mm = np.array(sequential_result.history.sigma)[:, 0] * 1e3
    assert (upper - lower) / 2 == pytest.approx(3 * sigma_mm, rel=1e-3)


def test_truth_is_drawn_only_where_a_simulation_knows_it(sequential_result):
    assert named(draw("convergence", sequential_result), "truth")
    unknown = draw("convergence", sequential_result, truth=None)
    assert not named(unknown, "truth")
    assert named(unknown, "initial")
    drawn = draw("methods", sequential_result, truth=None)
    assert (len(drawn.data), "true" in drawn.layout.title.text) == (1, False)


def test_references_of_several_sensors_are_named_once_and_have_the_colour_of_their_run(sequential_result):
    other = replace(
        sequential_result, truth=Values({name: 1.1 * value for name, value in sequential_result.truth.items()})
    )
    drawn = FIGURES["convergence"].draw([Trace("Run 1", sequential_result), Trace("Run 2", other)])
    truths = [trace for trace in drawn.data if (trace.name or "").startswith("truth") and trace.xaxis == "x"]
    assert [trace.line.color for trace in truths] == list(theme.RUN_COLOURS[:2])
    assert [trace.showlegend for trace in truths] == [True, False]
    alike = FIGURES["convergence"].draw([Trace("Run 1", sequential_result), Trace("Run 2", sequential_result)])
    assert [trace.line.color for trace in named(alike, "truth") if trace.showlegend] == [theme.TRUTH_COLOUR]


def test_batch_and_baseline_are_levels_beside_a_filter_over_frames_that_share_their_cursor(
    sequential_result, batch_result
):
    level = named(draw("convergence", sequential_result, batch_result), "other")[0]
    assert list(level.x) == [0, 199]
    assert level.y[0] == level.y[1]
    moved = {name: 1.001 * value for name, value in sequential_result.initial.items()}
    level = named(FIGURES["convergence"].draw([Trace("Run", sequential_result, baseline=moved)]), "baseline")[0]
    assert level.y[0] == pytest.approx((moved["f_m"] - sequential_result.initial.f_m) * 1e3, rel=1e-4)
    for name in ("convergence", "rms", "frame-observability"):
        assert draw(name, sequential_result).layout.meta["axis"] == "frame"


def test_the_cost_of_a_batch_is_on_a_log_axis_and_its_step_in_final_sigmas_on_either_scale(batch_result):
    drawn = draw("convergence", batch_result)
    assert (panel_names(drawn)["y9"], drawn.layout.yaxis9.type) == ("cost", "log")
    value, sigma = (np.array(rows) for rows in (batch_result.trace.parameters, batch_result.trace.sigma))
    expected = np.sqrt(np.mean((np.diff(value, axis=0) / sigma[-1]) ** 2, axis=1))
    step = next(trace for trace in named(drawn, "Run") if trace.yaxis == "y10")
    moved = expected > 0
    assert step.y[1:][moved] == pytest.approx(expected[moved], rel=1e-4)
    assert set(drawn.layout.meta["log"]) == {"yaxis9", "yaxis10"}


def test_the_step_from_which_on_nothing_leaves_three_final_sigmas_is_marked_in_every_panel(sequential_result):
    history, free = sequential_result.history, range(8)
    value, sigma = (np.array(rows)[:, free] for rows in (history.parameters, history.sigma))
    inside = (np.abs(value - value[-1]) <= 3 * sigma[-1]).all(axis=1)
    first = next(k for k in range(len(inside)) if inside[k:].all())
    drawn = draw("convergence", sequential_result)
    marks = [shape for shape in drawn.layout.shapes if shape.x0 == shape.x1]
    assert {shape.x0 for shape in marks} == {float(history.frame[first])}
    assert len({shape.yref for shape in marks}) == 10
    assert named(drawn, f"settled at {history.frame[first]}")
    running = draw("convergence", sequential_result, status="running")
    assert not any("settled" in (trace.name or "") for trace in running.data)


def grown(follow, history, first):
    """What a page draws for the points from the first on, by the trace's own words."""
    values = np.array(getattr(history, follow["column"]), float)[first:]
    value = values if follow.get("index") is None else values[:, follow["index"]]
    return (value - follow.get("origin", 0.0)) * follow["factor"]


@pytest.fixture
def running(sequential_result):
    return replace(sequential_result, status="running")


@pytest.mark.parametrize("name", ["convergence", "rms"])
def test_what_a_trace_says_of_its_growth_gives_the_points_that_it_shows(running, name):
    history = running.history
    figure = draw(name, running)
    growing = [trace for trace in figure.data if "follow" in (trace.meta or {})]
    curves = [trace for trace in growing if not {"band", "level"} & set(trace.meta["follow"])]
    assert len(curves) == {"convergence": 9, "rms": 2}[name]
    for trace in curves:
        follow = trace.meta["follow"]
        if follow["column"] == "nis_per_dof":
            continue
        shown = np.asarray(trace.y, float)
        assert grown(follow, history, -len(shown)) == pytest.approx(shown, rel=1e-5, abs=1e-4)


def test_a_band_lies_three_sigmas_around_its_curve(running):
    figure = draw("convergence", running)
    for trace in figure.data:
        if (trace.meta or {}).get("follow", {}).get("band"):
            follow = trace.meta["follow"]
            half = len(trace.y) // 2
            sigma = np.array(running.history.sigma, float)[-half:, follow["index"]]
            centre = grown(follow, running.history, -half)
            expected = centre + follow["band"] * sigma * follow["factor"]
            assert expected == pytest.approx(np.asarray(trace.y, float)[:half], rel=1e-5, abs=1e-4)


@pytest.mark.parametrize("name", ["convergence", "rms"])
def test_only_the_figure_of_one_running_filter_says_how_it_grows(running, sequential_result, name):
    for traces in ([Trace("Run", sequential_result)], [Trace("a", running), Trace("b", running)]):
        assert not any("follow" in (trace.meta or {}) for trace in FIGURES[name].draw(traces).data)


def test_the_claimed_error_is_the_mean_ratio_and_the_true_one_counted_in_sigmas_of_the_bound(sequential_result):
    ratio, bound = Values({"f_m": 1.0, "g_y": 4.0}), Values({"f_m": 1e-7, "g_y": 1e-6})
    efficiency = replace(sequential_result.trust.efficiency, ratio=ratio, cramer_rao_sigma=bound)
    truth, parameters = Values({"f_m": 0.016, "g_y": 1.0}), Values({"f_m": 0.016 + 3e-7, "g_y": 1.0 - 4e-6})
    known = {"trust": Trust(efficiency=efficiency), "truth": truth, "parameters": parameters}
    found = method_scores(replace(sequential_result, **known))
    assert found.claimed == pytest.approx(2.0)
    assert found.true_error == pytest.approx(math.sqrt((9 + 16) / 2), rel=1e-6)


def test_the_nees_takes_correlation_into_account_over_ten_decades(sequential_result):
    sigma, correlation = np.array([1e-7, 1e3]), np.array([[1.0, 0.8], [0.8, 1.0]])
    offset, names = np.array([1.0, 1.0]), ["f_m", "b2_per_m2"]  # in sigmas, along the well-correlated direction
    covariance = Covariance(names=names, matrix=(correlation * np.outer(sigma, sigma)).tolist())
    parameters, truth = Values(dict(zip(names, sigma.tolist(), strict=True))), Values(dict.fromkeys(names, 0.0))
    known = replace(sequential_result, truth=truth, parameters=parameters, covariance=covariance)
    expected = offset @ np.linalg.solve(correlation, offset) / 2
    assert method_scores(known).honesty.mean == pytest.approx(expected)


def test_a_frame_costs_what_the_method_took_a_replay_has_no_cost_and_curves_end_at_their_scores(sequential_result):
    assert method_scores(sequential_result).ms_per_frame == pytest.approx(1e3 * 0.4 / 200)
    assert draw("methods", sequential_result).data[0].name == "Run (2.0 ms per frame)"
    replay = replace(sequential_result, inputs=Inputs(settings=StatedSettings(replay_frames_per_s=5.0)))
    assert method_scores(replay).ms_per_frame is None
    table, scores = FIGURES["methods"].table(sequential_result), method_scores(sequential_result)
    assert table["claimed_over_bound"][-1] == pytest.approx(scores.claimed, rel=1e-5)
    assert table["true_over_bound"][-1] == pytest.approx(scores.true_error, rel=1e-5)


def steps(values, sigma):
    n = len(values)
    history = History(
        frame=list(range(n)),
        parameters=[[value] for value in values],
        sigma=[[sigma]] * n,
        tail_rms_rad=[],
        aggregate_rms_rad=[],
    )
    return Calibration(status=USABLE, frames=n, history=history, parameter_names=["f_m"], free=["f_m"])


def test_a_filter_has_settled_after_its_last_departure_in_frames_of_the_set_and_a_batch_in_iterations(
    batch_result, sequential_result
):
    assert method_scores(steps([9.0, 0.0, 9.0, 0.1, 0.2, 0.0], 1.0)).settled_frames == 4
    assert method_scores(steps([0.1, 0.2, 0.0], 1.0)).settled_frames == 1
    assert method_scores(replace(steps([9.0, 0.0, 0.0], 1.0), frames=2001)).settled_frames == 1001
    found = method_scores(batch_result)
    assert found.settled_frames is None
    assert 0 < found.settled_iterations < 8
    assert method_scores(replace(sequential_result, status="running")).settled_frames is None
    assert set(vars(method_scores(Calibration(status="running"))).values()) == {None}


def test_a_batch_beside_a_filter_is_a_level_and_alone_has_iterations(sequential_result, batch_result):
    both = draw("methods", sequential_result, batch_result)
    level = next(line for line in both.data if line.name.startswith("other"))
    assert level.y[0] == level.y[-1]
    assert level.x[-1] == 199
    assert draw("methods", batch_result).layout.xaxis.title.text == "iteration"


def test_what_cannot_be_drawn_of_methods_and_frames_says_why_or_asks_to_be_computed_again(sequential_result):
    trust = Trust(unavailable={"efficiency": "There is no bound: hold a parameter fixed."})
    said = draw("methods", sequential_result, trust=trust).layout.annotations[0].text
    assert said == "There is no bound: hold a parameter fixed."
    old = replace(sequential_result, frame_observability=None)
    for name in ("frame-observability", "reference-information"):
        said = FIGURES[name].draw([Trace("Run", old)]).layout.annotations[0].text
        assert said.replace("<br>", " ") == NEVER


def test_frames_that_determine_too_little_are_gaps_in_every_curve(sequential_result):
    drawn = draw("frame-observability", sequential_result)
    assert [line.name for line in drawn.data] == [
        *(f"Model {model}" for model in (1, 2, 3, 4)), *(f"σ{k} alone" for k in (1, 2, 3))
    ]  # fmt: skip
    assert all(np.isnan(line.y[7]) and not line.connectgaps for line in drawn.data)
    assert "120 spaced evenly over 200" in drawn.layout.xaxis2.title.text


def test_one_frame_that_hardly_determines_anything_does_not_flatten_the_others_and_none_leaves_the_sentence(
    sequential_result,
):
    view = sequential_result.frame_observability

    def drawn(curves):
        seen = replace(view, minimum_singular_value=curves)
        return draw("frame-observability", sequential_result, frame_observability=seen)

    curves = view.minimum_singular_value
    low, high = drawn({**curves, "model_4": [1e-11, *curves["model_4"][1:]]}).layout.yaxis.range
    assert high - low < 4
    nothing = drawn({name: [None] * 120 for name in curves})
    assert not nothing.data
    assert nothing.layout.annotations[0].text == view.sentence


def test_a_reference_that_leaves_a_parameter_open_has_no_bar_and_says_so(sequential_result):
    drawn = draw("reference-information", sequential_result)
    bars = drawn.data[0]
    place = list(bars.x).index("σ1")
    assert np.isnan(bars.y[place])
    assert bars.text[place] == "open"
    said = " ".join(note.text.replace("<br>", " ") for note in drawn.layout.annotations if note.text)
    assert sequential_result.frame_observability.sentence in said
    table = FIGURES["reference-information"].table(sequential_result)
    share = sequential_result.frame_observability.information[5].share
    assert table["reference"][5] == "model_4"
    assert column(table["sigma_over_bound"])[5] == pytest.approx(share**-0.5)
