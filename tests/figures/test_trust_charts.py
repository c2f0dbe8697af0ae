"""What the charts of trust, residuals, shadow and trend promise: levels, bounds, marks, and reasons in place of what is missing."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.calibration.calibration import Calibration, LeftOut, Shadow, ShadowOfSet, parse_part
from boresight.figures import CHAPTERS, FIGURES, Trace, figure_json, trend
from boresight.figures.charts.innovations import running_mean
from boresight.figures.charts.matching import GIVEN
from boresight.figures.charts.more_data import round_ticks
from boresight.figures.charts.residual_distribution import shares
from boresight.figures.charts.residual_map import (
    CIRCLE,
    CLEAR_SIGMAS,
    ArrowField,
    MeanCells,
    cell_means,
    choose_scale,
    read_cells,
)
from boresight.figures.charts.residual_outliers import reasons
from boresight.figures.charts.rms import compute_axis_residuals, running
from boresight.figures.charts.shadow import SHADOW
from boresight.verdicts.trend import Trend
from boresight.verdicts.verdict import NEVER
from tests.calibrations import changed
from tests.figures.examined import shadow

PART_OF = {
    "two-halves": "two_halves",
    "arc-uncertainty": "arc_sigma_map",
    "efficiency": "efficiency",
    "more-data": "more_data",
    "drop-one": "drop_one",
    "innovations": "nis_over_time",
    "whiteness": "whiteness",
    "residual-against": "residual_against",
    "residual-map": "residuals",
    "rms-axes": "residuals",
    "residual-quiver": "residual_field",
    "residual-rms": "residual_field",
    "residual-distribution": "residual_distribution",
    "residual-outliers": "residual_outliers",
    "residual-spline": "residual_spline",
    "stars": "stars",
}


def draw(name, result):
    return FIGURES[name].draw([Trace("Run", result)])


def without(result, part, reason):
    return changed(result, trust={part: None, "unavailable": {part: reason}})


def values(trace, axis="y"):
    return np.array(getattr(trace, axis), dtype=float)


def test_every_chart_of_trust_is_held_to_its_part():
    assert set(PART_OF) >= {figure.name for figure in CHAPTERS["trust"]}


@pytest.mark.parametrize("name", PART_OF)
def test_a_part_that_is_missing_is_drawn_as_its_own_reason(name, sequential_result):
    drawn = draw(name, without(sequential_result, PART_OF[name], "Twenty frames are needed <and more>."))
    assert not drawn.data
    assert drawn.layout.annotations[0].text == "Twenty frames are needed &lt;and more&gt;."
    old = draw("whiteness", replace(sequential_result, trust=None))
    assert old.layout.annotations[0].text.replace("<br>", " ") == NEVER


def test_halves_are_held_against_three_sigmas_and_only_those_that_differ_are_called_so(sequential_result):
    def title(value):
        differing = changed(sequential_result, trust={"two_halves": {"chi2": {"value": value, "consistent": False}}})
        return draw("two-halves", differing).layout.title.text

    drawn = draw("two-halves", sequential_result)
    assert {shape.y0 for shape in drawn.layout.shapes} == {-3.0, 3.0}
    assert ["agree" in drawn.layout.title.text, *("differ" in title(value) for value in (40.0, 0.4))] == [
        True,
        True,
        False,
    ]


def test_levels_stand_where_chance_and_the_bound_put_them_and_predictions_begin_at_the_run_as_it_is(sequential_result):
    drawn = draw("arc-uncertainty", sequential_result)
    assert (drawn.data[0].zmin, drawn.layout.yaxis.autorange, "5°" in drawn.layout.title.text) == (0, "reversed", True)
    drawn = draw("efficiency", sequential_result)
    assert [shape.y0 for shape in drawn.layout.shapes] == [1]
    ratios = sequential_result.trust.efficiency.ratio.values()
    assert values(drawn.data[0]) == pytest.approx(list(ratios))
    levels = sorted(shape.y0 for shape in draw("whiteness", sequential_result).layout.shapes)
    bound = sequential_result.trust.whiteness.bound
    assert levels == pytest.approx([-bound, bound])
    first = draw("more-data", sequential_result).data[0]
    assert values(first, "x")[0] == sequential_result.trust.more_data.frames
    assert values(first)[0] == pytest.approx(sequential_result.sigma.f_m * 1e3, rel=1e-4)
    assert draw("more-data", sequential_result).layout.xaxis.type == "log"


@given(st.floats(1e-9, 1e9), st.floats(1.0, 1e6))
def test_ticks_of_a_log_axis_are_few_round_and_inside(low, ratio):
    ticks = round_ticks(np.array([low, low * ratio]))
    assert len(ticks) <= 8
    assert all(low <= tick <= low * ratio for tick in ticks)
    assert len(ticks) >= 2 or ratio < 2.5


def test_spare_parameters_are_hatched_outside_frames_have_another_shape_and_suspects_are_diamonds(sequential_result):
    drawn = draw("drop-one", sequential_result)
    assert list(drawn.data[0].marker.pattern.shape) == ["", "", "", "", "", "", "/", ""]
    assert "<i>a</i><sub>2</sub>" in drawn.layout.title.text
    part = sequential_result.trust.nis_over_time
    points = next(trace for trace in draw("innovations", sequential_result).data if trace.mode == "markers")
    nis, low, high = (np.array(numbers) for numbers in (part.nis_per_dof, part.lower, part.upper))
    outside = (nis < low) | (nis > high)
    assert [symbol != "circle" for symbol in points.marker.symbol] == outside.tolist()
    drawn = draw("stars", sequential_result).data[0]
    assert [text for text in drawn.text if text] == ["1000", "1017"]
    assert list(drawn.marker.symbol).count("diamond") == 2
    assert f"2 of {sequential_result.trust.stars_in_all}" in draw("stars", sequential_result).layout.title.text


@given(st.lists(st.floats(-100, 100) | st.just(float("nan")), min_size=1, max_size=60), st.integers(1, 20))
def test_the_running_mean_is_the_mean_of_the_values_around(numbers, width):
    series = np.array(numbers)
    for k, mean in enumerate(running_mean(series, width)):
        around = series[max(k - width // 2, 0) : k + (width + 1) // 2]
        expected = np.nanmean(around) if np.isfinite(around).any() else np.nan
        assert mean == pytest.approx(expected, abs=1e-9, nan_ok=True)


def test_a_cause_without_data_says_why_in_its_own_panel_and_a_mean_residual_has_its_sigma_as_bar(sequential_result):
    drawn, bins = draw("residual-against", sequential_result), sequential_result.trust.residual_against.radius
    (said,) = drawn.layout.annotations
    assert said.text.replace("<br>", " ") == "The telemetry has no temperatures."
    assert said.xref == "x3 domain"
    bars = np.array(drawn.data[0].error_y.array)
    assert bars == pytest.approx(1.96 * np.array(bins.sigma_of_mean_px), rel=1e-6)


def test_a_cell_mean_is_clear_only_where_it_leaves_its_noise():
    rng = np.random.default_rng(3)
    row, col = rng.uniform(0, 1000, (2, 20_000))
    noise = 0.1 * rng.normal(size=(2, 20_000))
    shifted = row < 100
    means = cell_means(ArrowField(row, col, noise[0] + 0.2 * shifted, noise[1], np.zeros(20_000, dtype=bool)))
    assert means.clear[means.row < 90].all()
    assert means.clear[means.row > 110].mean() < 0.05  # 0.5 % are expected beyond three sigmas in either component
    assert CLEAR_SIGMAS == 3.0


def test_matching_draws_both_counts_of_every_cycle_or_says_that_matches_were_given(sequential_result):
    drawn = draw("matching", sequential_result)
    assert [values(trace).tolist() for trace in drawn.data[:2]] == [[4401, 4466, 4466], [2297, 65, 0]]
    assert "settled after 3 cycles" in drawn.layout.title.text
    given = changed(sequential_result, matching=None, inputs={"settings": {"match": "given"}})
    assert draw("matching", given).layout.annotations[0].text.replace("<br>", " ") == GIVEN


def test_residuals_are_turned_to_the_radius_at_their_length_and_an_axis_has_its_rms_with_sigma(sequential_result):
    found = compute_axis_residuals(sequential_result)
    rows, columns, along, across = found.by_axis.values()
    assert np.hypot(rows, columns) == pytest.approx(np.hypot(along, across))
    seen = sequential_result.trust.residuals
    centre = [sequential_result.parameters[name] for name in ("m0_px", "n0_px")]
    outward = np.array([seen.row_px, seen.col_px]).T - centre
    expected = np.sum(outward * np.array([rows, columns]).T, axis=1) / np.linalg.norm(outward, axis=1)
    assert along == pytest.approx(expected)
    columns = FIGURES["rms-axes"].table(sequential_result)
    rows = np.array(sequential_result.trust.residuals.d_row_px)
    assert columns["rms_px"][0] == pytest.approx(np.sqrt(np.mean(rows**2)))
    assert columns["sigma_of_rms_px"][0] == pytest.approx(columns["rms_px"][0] / np.sqrt(2 * len(rows)))
    frame, level, sigma = running(compute_axis_residuals(sequential_result), "across the radius")
    assert len(frame) == 40
    assert (np.diff(frame) > 0).all()
    assert sigma == pytest.approx(level / np.sqrt(2 * len(rows) / 40), rel=0.02)


def test_arrows_and_circles_are_to_the_scale_of_the_bar_and_cells_clear_of_their_noise_are_diamonds(sequential_result):
    drawn = draw("residual-quiver", sequential_result)
    circles, arrows, _, bar = [trace for trace in drawn.data if trace.xaxis == "x2"]
    cells = read_cells(sequential_result.trust.residual_field, sequential_result.trust.residual_field.after)
    cells_in_all = sum(map(len, sequential_result.trust.residual_field.after.mean_row_px))
    scale = (bar.x[1] - bar.x[0]) / float(bar.text[1].split("px")[0])
    x, y = values(arrows, "x").reshape(-1, 3), values(arrows).reshape(-1, 3)
    np.testing.assert_allclose(x[:, 1] - x[:, 0], scale * cells.d_col, rtol=1e-3, atol=0.02)
    np.testing.assert_allclose(y[:, 1] - y[:, 0], scale * cells.d_row, rtol=1e-3, atol=0.02)
    around = values(circles, "x").reshape(-1, len(CIRCLE))[:, :-1]
    np.testing.assert_allclose(np.ptp(around, axis=1), 6 * scale * cells.s_col, rtol=1e-3)
    symbols = list([trace for trace in drawn.data if trace.mode == "markers"][1].marker.symbol)
    assert symbols[:9] == ["diamond"] * 9  # the first row of cells, of which one is empty, is off by ten of its sigmas
    assert symbols[9:].count("diamond") <= 3
    counted = [symbols.count("diamond"), len(symbols), cells_in_all - len(symbols), cells_in_all]
    assert [int(found) for found in re.findall(r"\d+", drawn.layout.title.text)] == counted


def test_before_is_left_out_where_the_old_parameters_have_no_residuals(sequential_result):
    drawn = draw("residual-quiver", changed(sequential_result, trust={"residual_field": {"before": None}}))
    assert {trace.xaxis for trace in drawn.data} == {"x"}
    assert set(FIGURES["residual-quiver"].table(sequential_result)["when"]) == {"before", "after"}


@given(st.floats(1e-6, 1e3), st.floats(1.0, 1e3))
def test_the_scale_of_arrows_is_round_and_keeps_them_inside_their_cells(length_px, size_px):
    one = np.ones(3)
    scale = choose_scale(MeanCells(one, one, length_px * one, 0 * one, one, one, one), size_px)
    assert scale * length_px <= size_px
    assert scale * length_px >= 0.3 * size_px
    assert float(f"{scale:.0e}"[0]) in {1, 2, 5}


def test_shares_are_of_all_residuals_beyond_the_bins_too_and_quantiles_stand_in_the_band_of_chance(sequential_result):
    part = sequential_result.trust.residual_distribution
    counts, drawn = part.before.counts, draw("residual-distribution", sequential_result).data
    assert shares(part.before).sum() == pytest.approx(
        sum(counts) / (sum(counts) + part.before.below + part.before.above)
    )
    assert shares(part.after).sum() == pytest.approx(1)
    assert any("beyond 6 σ" in trace.name for trace in drawn)
    band, line = [trace for trace in drawn if trace.xaxis == "x2"]
    np.testing.assert_allclose(values(line), np.subtract(part.quantile, part.normal), atol=1e-6)
    np.testing.assert_allclose(values(band).max(), 3 * max(part.sigma_of_quantile), rtol=1e-5)


def test_reasons_are_counted_once_and_the_most_frequent_come_first(sequential_result):
    left_out = [
        LeftOut(what="stars", count=14, reason="not matched to a catalogue star"),
        LeftOut(what="exposures", count=7, reason="fewer than 4 usable stars"),
    ]
    matching = replace(sequential_result.matching, row_reasons={"no star is near": 5, "two are near": 9})
    found = reasons(Calibration(status="converged", matching=matching, left_out=left_out))
    ordered = [("two are near", 9), ("exposures: fewer than 4 usable stars", 7), ("no star is near", 5)]
    assert list(found.items()) == ordered
    assert reasons(Calibration(status="converged", left_out=left_out))["stars: not matched to a catalogue star"] == 14
    assert reasons(Calibration(status="running")) == {}


def test_outliers_name_their_frame_and_star_and_are_drawn_on_the_whole_detector(sequential_result):
    part = sequential_result.trust.residual_outliers
    places = draw("residual-outliers", sequential_result).data[0]
    assert places.text[0] == f"HIP {part.star_id[0]}, frame {part.frame[0]}"
    assert FIGURES["residual-outliers"].table(sequential_result)["frame"] == part.frame
    drawn = draw("residual-outliers", sequential_result)
    assert drawn.layout.xaxis.range == (-0.5, 2591.5)
    assert drawn.layout.yaxis.range == (1943.5, -0.5)


def test_the_rms_map_leaves_cells_without_stars_open(sequential_result):
    rms = [[*row] for row in sequential_result.trust.residual_field.after.rms_px]
    rms[3][4] = None
    (cells,) = draw(
        "residual-rms", changed(sequential_result, trust={"residual_field": {"after": {"rms_px": rms}}})
    ).data
    assert np.isnan(values(cells, "z")[3, 4])
    assert cells.zmin == 0
    assert np.isnan(values(cells, "z")).sum() == sum(row.count(None) for row in rms)


def make_shadow(n_frames=40, lost=(7,), gained=(1, 2, 3)):
    return parse_part(ShadowOfSet, shadow(n_frames, lost, gained)["validation"], ValueError)


def flown(**sets):
    return Calibration(status="converged", shadow=Shadow(**sets))


def test_the_validation_set_is_shown_first_and_the_table_lists_every_frame_with_the_stars_that_moved():
    both = SHADOW.draw([Trace("run", flown(calibration=make_shadow(10), validation=make_shadow(20)))])
    one = SHADOW.draw([Trace("run", flown(calibration=make_shadow(10)))])
    assert both.layout.title.text == "Validation set: 3 frames gained, 1 lost"
    assert one.layout.title.text.startswith("Calibration set")
    assert len(both.data[0].x) == 20
    columns = SHADOW.table(flown(calibration=make_shadow()))
    assert {len(column) for column in columns.values()} == {40}
    assert columns["lost"][7] == "1 2"
    assert columns["candidate_reason"][7] == "too few stars"
    assert orjson.dumps(columns)


def test_both_sides_are_named_and_frames_that_one_alone_solves_have_their_own_shapes():
    drawn, kept = (SHADOW.draw([Trace("run", flown(calibration=make_shadow(lost=lost)))]).data for lost in ((7,), ()))
    alone = {trace.marker.symbol: list(trace.x) for trace in drawn if trace.mode == "markers"}
    assert alone == {"triangle-up-open": [1, 2, 3], "x-thin-open": [7]}
    marks = ["only the candidate solves it (3)", "only the baseline solves it: lost (1)"]
    assert [trace.name for trace in drawn] == ["baseline", "candidate", *marks]
    assert [trace.showlegend for trace in kept if trace.mode == "markers"] == [True, False]


def test_a_comparison_gives_each_candidate_its_colour_and_stays_small():
    long = flown(validation=make_shadow(2000, range(500), range(500, 1000)))
    text = figure_json(SHADOW.draw([Trace(f"run {i}", long) for i in range(8)]))
    assert b"#3b8fe0" in text
    assert b"#d9730d" in text
    assert len(text) < 500_000


@pytest.mark.parametrize(
    "result", [flown(), flown(validation=replace(make_shadow(), frames=[]))], ids=["none", "empty"]
)
def test_without_a_view_it_says_what_is_missing(result):
    drawn = SHADOW.draw([Trace("run", result)])
    assert not drawn.data
    assert "are compared when the run ends" in drawn.layout.annotations[0].text
    assert SHADOW.table(result) == {}


NAMES = ["f_m", "b2_per_m2"]


def _point(number: int, **changed: Any) -> dict[str, Any]:
    names = {
        "run_id": number,
        "label": "",
        "method": "batch",
        "telemetry_set_id": number,
        "telemetry": f"Pass {number}",
    }
    times = {
        f"{when}_utc": f"2026-01-{number:02}T0{k}:00:00.000000Z" for k, when in enumerate(("begins", "at", "ends"))
    }
    found = {"f_m": 0.016 + 1e-6 * number, "b2_per_m2": 10.0 * number}
    estimate = {"camera_model": "inverted_wang", "parameters": found, "sigma": {"f_m": 2e-6, "b2_per_m2": 3.0}}
    counted = {"stars": 1000, "rms_arc_rad": 8e-5, "counted": True, "left_out": None, "said": None}
    return names | times | estimate | counted | {"timed": True, "temperature_c": 20.0 + number} | changed


def _period(number: int, to_utc: str | None) -> dict[str, Any]:
    return {
        "parameter_set_id": number,
        "name": f"PS-ST1-{number}",
        "from_utc": f"2026-01-{10 * number:02}T00:00:00.000000Z",
        "to_utc": to_utc,
        "measured": True,
        "parameters": {"f_m": 0.016, "b2_per_m2": 5.0 * number},
        "sigma": {"f_m": 1e-6, "b2_per_m2": 2.0},
    }


@pytest.fixture
def document() -> dict[str, Any]:
    return {
        "sensor_id": 1,
        "sensor": "ST1",
        "baseline": {"parameter_set_id": 2, "name": "PS-ST1-2"},
        "advice": {"answer": "NOT YET", "sentence": "It is still valid.", "code": "trend_valid"},
        "camera_model": "inverted_wang",
        "parameter_names": NAMES,
        "points": [_point(2), _point(3, counted=False, left_out="its data overlap"), _point(5)],
        "others": [_point(7, camera_model="pinhole_radial", parameters={"k1": 0.1}, sigma={"k1": 0.01})],
        "baselines": [_period(1, "2026-01-20T00:00:00.000000Z"), _period(2, None)],
        "on_board": [
            {"at_utc": "2026-01-21T00:00:00.000000Z", "state": "SENT", "parameter_set_id": 2, "name": "PS-ST1-2"}
        ],
        "truth": {"f_m": 0.016001, "b2_per_m2": 12.0},
        "annotations": [],
        "drift": {"verdict": "HOLDS", "sentence": "It holds.", "false_alarm_rate": 0.001},
    }


def _read(document: dict[str, Any]) -> Trend:
    return parse_part(Trend, document, AssertionError)


def _named(figure: Any, name: str) -> list[Any]:
    return [trace for trace in figure.data if trace.name == name]


def test_a_point_is_its_difference_from_the_baseline_of_now_with_three_sigmas_and_open_where_it_does_not_count(
    document: dict[str, Any],
) -> None:
    figure, table = trend.draw(_read(document)), trend.table(_read(document))
    focus, distortion = _named(figure, "Calibration ±3σ")
    assert list(focus.y) == pytest.approx([0.002, 0.005])  # mm
    assert list(focus.error_y.array) == pytest.approx([0.006, 0.006])
    assert list(distortion.y) == pytest.approx([10.0, 40.0])
    assert list(focus.x) == ["2026-01-02T01:00:00.000", "2026-01-05T01:00:00.000"]
    shown = _named(figure, "Not used")[0]
    assert (shown.marker.symbol, shown.customdata[0][1]) == ("circle-open", "its data overlap")
    assert table["f_m"] == pytest.approx([0.016002, 0.016003, 0.016005])
    assert table["sigma_b2_per_m2"] == [3.0] * 3
    assert table["counted"] == ["yes", "no", "yes"]


def test_baselines_truth_temperature_and_records_have_their_places(document: dict[str, Any]) -> None:
    figure = trend.draw(_read(document))
    assert [list(trace.y) for trace in _named(figure, "Baseline PS-ST1-2")] == [[0.0, 0.0]] * 2
    assert list(_named(figure, "Earlier baselines")[1].y) == [-5.0, -5.0]
    assert _named(figure, "Truth")[1].y[0] == pytest.approx(2.0)
    assert list(_named(figure, "Temperature")[0].y) == [22.0, 23.0, 25.0]
    assert "PS-ST1-2 SENT" in _named(figure, "Records")[0].text


def test_an_old_value_far_away_stands_at_the_edge_with_its_number_and_the_scale_is_that_of_the_newest(
    document: dict[str, Any],
) -> None:
    ground = _period(1, "2026-01-20T00:00:00.000000Z") | {"parameters": {"f_m": 0.0156, "b2_per_m2": 10.0}}
    crowd = [_point(k, parameters={"f_m": 0.016 + 1e-7 * k, "b2_per_m2": 10.0}) for k in range(2, 20)]
    first = _point(1, parameters={"f_m": 0.0165, "b2_per_m2": 10.0})
    figure = trend.draw(_read(document | {"points": [first, *crowd], "baselines": [ground, _period(2, None)]}))
    low, high = figure.layout.yaxis.range
    assert -0.02 < low < -0.0042
    assert 0.0079 < high < 0.02
    up, down = _named(figure, trend.BEYOND)
    assert (up.text, down.text) == (("run 1 +0.500",), ("PS-ST1-1 \u22120.400",))
    assert low < down.y[0] < -0.0042
    assert 0.0079 < up.y[0] < high
    assert (up.marker.symbol, down.marker.symbol) == ("triangle-up", "triangle-down")


@pytest.mark.parametrize("jump", [0.0, 1e4])
def test_the_newest_calibration_is_on_the_scale_wherever_it_lies_and_without_spread_there_is_none(jump: float) -> None:
    values = np.array([0.0] * 10 + [jump])
    low, high = trend.find_limits(values, np.ones(11), [(0.0, 0.5)])
    assert low < -0.5
    assert jump < high < 1.2 * (jump + 2)
    assert trend.find_limits(np.zeros(3), np.zeros(3), []) is None


def test_labels_at_one_edge_are_half_the_time_apart() -> None:
    marks = [(f"2026-01-{day:02}T00:00:00Z", 5.0, "run", "#ffffff") for day in (1, 2, 3, 20, 31)]
    drawn = trend._beyond(marks, 1.0, "triangle-up", (marks[0][0], marks[-1][0]))
    assert [bool(text) for text in drawn.text] == [True, False, False, True, False]
    assert list(drawn.textposition)[::4] == ["middle right", "middle left"]


def test_an_annotation_is_a_line_through_all_panels_whose_label_is_text_and_no_markup(document: dict[str, Any]) -> None:
    said = {
        "at_utc": "2026-01-04T00:00:00.000000Z",
        "text": "<b>Safe mode</b> of six long hours & more",
        "printed_name": "Ana",
        "made_utc": "2026-01-05T00:00:00.000000Z",
    }
    figure = trend.draw(_read({**document, "annotations": [said]}))
    line = figure.layout.shapes[-1]
    assert (line.x0, line.x1, line.y0, line.y1) == ("2026-01-04T00:00:00.000", "2026-01-04T00:00:00.000", 0, 1)
    label = figure.layout.annotations[-1]
    assert label.text == "&lt;b&gt;Safe mode&lt;/b&gt; of six lon…"
    assert label.hovertext == "&lt;b&gt;Safe mode&lt;/b&gt; of six long hours &amp; more (Ana)"


def test_another_model_stands_apart_nothing_yet_says_what_to_do_and_two_hundred_stay_small(
    document: dict[str, Any],
) -> None:
    figure = trend.draw(_read(document), "pinhole_radial")
    assert list(_named(figure, "Calibration ±3σ")[0].y) == [0.0]
    assert _named(figure, "Baseline PS-ST1-2") == []
    assert set(trend.table(_read(document), "pinhole_radial")) >= {"k1", "sigma_k1"}
    figure = trend.draw(_read({**document, "points": []}))
    assert "launch a run" in figure.layout.annotations[0].text
    assert trend.table(_read({**document, "points": []}))["run"] == []
    many = {**document, "points": [_point(1 + k % 28) for k in range(200)]}
    assert len(figure_json(trend.draw(_read(many)))) < 250_000
