"""What the charts of the examination promise: levels, bounds, marks, and reasons in place of what is missing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.figures import CHAPTERS, FIGURES, Trace
from boresight.figures.charts.innovations import running_mean
from boresight.figures.charts.more_data import round_ticks
from boresight.figures.charts.residual_map import CLEAR_SIGMA, ArrowField, cell_means
from boresight.figures.charts.rms import compute_axis_residuals, running

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
    "stars": "stars",
}


def draw(name, result):
    return FIGURES[name].draw([Trace("Run", result)])


def without(result, part, reason):
    trust = result["trust"]
    return result | {"trust": trust | {part: None, "unavailable": {part: reason}}}


def values(trace, axis="y"):
    return np.array(getattr(trace, axis), dtype=float)


def test_every_chart_of_trust_is_held_to_its_part():
    assert set(PART_OF) >= {figure.name for figure in CHAPTERS["trust"]}


@pytest.mark.parametrize("name", PART_OF)
def test_a_part_that_is_missing_is_drawn_as_its_own_reason(name, sequential_result):
    drawn = draw(name, without(sequential_result, PART_OF[name], "Twenty frames are needed <and more>."))
    assert not drawn.data
    assert drawn.layout.annotations[0].text == "Twenty frames are needed &lt;and more&gt;."


def test_a_finished_result_without_trust_says_how_to_have_it(sequential_result):
    drawn = draw("whiteness", sequential_result | {"trust": None})
    assert "start it again" in drawn.layout.annotations[0].text


def test_bars_of_the_halves_are_held_against_three_sigmas(sequential_result):
    drawn = draw("two-halves", sequential_result)
    levels = {shape.y0 for shape in drawn.layout.shapes}
    assert levels == {-3.0, 3.0}
    assert "agree" in drawn.layout.title.text


def test_halves_that_differ_are_called_so_and_halves_too_alike_are_not(sequential_result):
    def title(value):
        halves = sequential_result["trust"]["two_halves"]
        chi2 = halves["chi2"] | {"value": value, "consistent": False}
        trust = sequential_result["trust"] | {"two_halves": halves | {"chi2": chi2}}
        return draw("two-halves", sequential_result | {"trust": trust}).layout.title.text

    assert "differ" in title(40.0)
    assert "differ" not in title(0.4)


def test_the_sigma_map_begins_at_zero_and_names_its_arc(sequential_result):
    drawn = draw("arc-uncertainty", sequential_result)
    assert drawn.data[0].zmin == 0
    assert "4°" in drawn.layout.title.text
    assert drawn.layout.yaxis.autorange == "reversed"


def test_the_bound_is_a_level_at_one(sequential_result):
    drawn = draw("efficiency", sequential_result)
    assert [shape.y0 for shape in drawn.layout.shapes] == [1]
    assert values(drawn.data[0]) == pytest.approx([1.03] * 8)


def test_prediction_begins_at_the_run_as_it_is_in_its_own_unit(sequential_result):
    first = draw("more-data", sequential_result).data[0]
    assert values(first, "x")[0] == 200
    assert values(first)[0] == pytest.approx(sequential_result["sigma"]["f_m"] * 1e6)
    assert draw("more-data", sequential_result).layout.xaxis.type == "log"


@given(st.floats(1e-9, 1e9), st.floats(1.0, 1e6))
def test_ticks_of_a_log_axis_are_few_round_and_inside(low, ratio):
    ticks = round_ticks(np.array([low, low * ratio]))
    assert len(ticks) <= 8
    assert all(low <= tick <= low * ratio for tick in ticks)
    assert len(ticks) >= 2 or ratio < 2.5


def test_a_spare_parameter_is_hatched_and_named(sequential_result):
    drawn = draw("drop-one", sequential_result)
    assert list(drawn.data[0].marker.pattern.shape) == ["", "", "", "", "", "", "/", ""]
    assert "<i>a</i><sub>2</sub>" in drawn.layout.title.text


def test_frames_outside_their_bounds_have_another_shape(sequential_result):
    part = sequential_result["trust"]["nis_over_time"]
    points = next(trace for trace in draw("innovations", sequential_result).data if trace.mode == "markers")
    outside = (np.array(part["nis_per_dof"]) < 0.469) | (np.array(part["nis_per_dof"]) > 1.729)
    assert [symbol != "circle" for symbol in points.marker.symbol] == outside.tolist()


@given(st.lists(st.floats(-100, 100) | st.just(float("nan")), min_size=1, max_size=60), st.integers(1, 20))
def test_the_running_mean_is_the_mean_of_the_values_around(numbers, width):
    series = np.array(numbers)
    for k, mean in enumerate(running_mean(series, width)):
        around = series[max(k - width // 2, 0) : k + (width + 1) // 2]
        expected = np.nanmean(around) if np.isfinite(around).any() else np.nan
        assert mean == pytest.approx(expected, abs=1e-9, nan_ok=True)


def test_whiteness_shows_the_bounds_of_chance(sequential_result):
    levels = sorted(shape.y0 for shape in draw("whiteness", sequential_result).layout.shapes)
    assert levels == [-0.139, 0.139]


def test_a_cause_without_data_says_why_in_its_own_panel(sequential_result):
    drawn = draw("residual-against", sequential_result)
    (said,) = drawn.layout.annotations
    assert said.text.replace("<br>", " ") == "The telemetry has no temperatures."
    assert said.xref == "x3 domain"


def test_a_mean_residual_has_its_own_sigma_as_bar(sequential_result):
    bins = sequential_result["trust"]["residual_against"]["radius"]
    drawn = draw("residual-against", sequential_result).data[0]
    assert np.array(drawn.error_y.array) == pytest.approx(1.96 * np.array(bins["sigma_of_mean_px"]), rel=1e-6)


def test_a_cell_mean_is_clear_only_where_it_leaves_its_noise():
    rng = np.random.default_rng(3)
    row, col = rng.uniform(0, 1000, (2, 20_000))
    noise = 0.1 * rng.normal(size=(2, 20_000))
    shifted = row < 100
    means = cell_means(ArrowField(row, col, noise[0] + 0.2 * shifted, noise[1], np.zeros(20_000, dtype=bool)))
    assert means.clear[means.row < 90].all()
    assert means.clear[means.row > 110].mean() < 0.05  # 0.5 % are expected beyond three sigmas in either component
    assert CLEAR_SIGMA == 3.0


def test_suspects_are_diamonds_with_their_number(sequential_result):
    drawn = draw("stars", sequential_result).data[0]
    assert [text for text in drawn.text if text] == ["1000", "1017"]
    assert list(drawn.marker.symbol).count("diamond") == 2
    assert "2 of 412" in draw("stars", sequential_result).layout.title.text


def test_matching_draws_both_counts_of_every_cycle(sequential_result):
    drawn = draw("matching", sequential_result)
    assert values(drawn.data[0]).tolist() == [4401, 4466, 4466]
    assert values(drawn.data[1]).tolist() == [2297, 65, 0]
    assert "rested after 3 cycles" in drawn.layout.title.text


def test_a_run_with_given_matches_says_so(sequential_result):
    given = sequential_result | {"matching": None, "inputs": {"settings": {"match": "given"}}}
    assert "matches it was given" in draw("matching", given).layout.annotations[0].text


def test_residuals_are_turned_to_the_radius_without_changing_their_length(sequential_result):
    found = compute_axis_residuals(sequential_result)
    rows, columns, along, across = found.by_axis.values()
    assert np.hypot(rows, columns) == pytest.approx(np.hypot(along, across))
    seen = sequential_result["trust"]["residuals"]
    centre = [sequential_result["parameters"][name] for name in ("m0_px", "n0_px")]
    outward = np.array([seen["row_px"], seen["col_px"]]).T - centre
    expected = np.sum(outward * np.array([rows, columns]).T, axis=1) / np.linalg.norm(outward, axis=1)
    assert along == pytest.approx(expected)


def test_the_rms_of_an_axis_stands_with_its_sigma_and_bins_of_frames_hold_equal_numbers(sequential_result):
    columns = FIGURES["rms-axes"].table(sequential_result)
    rows = np.array(sequential_result["trust"]["residuals"]["d_row_px"])
    assert columns["rms_px"][0] == pytest.approx(np.sqrt(np.mean(rows**2)))
    assert columns["sigma_of_rms_px"][0] == pytest.approx(columns["rms_px"][0] / np.sqrt(2 * len(rows)))
    frame, level, sigma = running(compute_axis_residuals(sequential_result), "across the radius")
    assert len(frame) == 40
    assert (np.diff(frame) > 0).all()
    assert sigma == pytest.approx(level / np.sqrt(2 * len(rows) / 40), rel=0.02)
