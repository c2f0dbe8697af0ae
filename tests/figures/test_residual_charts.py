"""What the charts of the residuals promise: arrows to scale beside their noise, shares of all, chance bands, reasons counted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.figures import FIGURES, Trace
from boresight.figures.charts.residual_distribution import shares
from boresight.figures.charts.residual_map import CIRCLE, MeanCells, choose_scale, read_cells
from boresight.figures.charts.residual_outliers import reasons


def draw(name, result):
    return FIGURES[name].draw([Trace("Run", result)])


def numbers(values):
    return np.array(values, dtype=float)


def test_arrows_and_noise_circles_are_drawn_to_the_scale_of_the_bar(sequential_result):
    drawn = draw("residual-quiver", sequential_result)
    field = sequential_result["trust"]["residual_field"]
    circles, arrows, _, bar = [trace for trace in drawn.data if trace.xaxis == "x2"]
    cells = read_cells(field, "after")
    scale = (bar.x[1] - bar.x[0]) / float(bar.text[1].split("px")[0])
    x, y = numbers(arrows.x).reshape(-1, 3), numbers(arrows.y).reshape(-1, 3)
    np.testing.assert_allclose(x[:, 1] - x[:, 0], scale * cells.d_col, rtol=1e-3, atol=0.02)
    np.testing.assert_allclose(y[:, 1] - y[:, 0], scale * cells.d_row, rtol=1e-3, atol=0.02)
    around = numbers(circles.x).reshape(-1, len(CIRCLE))[:, :-1]
    np.testing.assert_allclose(np.ptp(around, axis=1), 6 * scale * cells.s_col, rtol=1e-3)


def test_only_cells_clear_of_their_noise_are_diamonds_and_counted(sequential_result):
    drawn = draw("residual-quiver", sequential_result)
    feet = [trace for trace in drawn.data if trace.mode == "markers"][1]
    assert list(feet.marker.symbol[:16]) == ["diamond"] * 16  # the first row of cells is off by ten of its sigmas
    assert list(feet.marker.symbol[16:]).count("diamond") <= 3
    assert f"{list(feet.marker.symbol).count('diamond')} of 192 cell means" in drawn.layout.title.text


def test_before_is_left_out_where_the_old_parameters_have_no_residuals(sequential_result):
    trust = sequential_result["trust"]
    field = trust["residual_field"] | {"before": None}
    drawn = draw("residual-quiver", sequential_result | {"trust": trust | {"residual_field": field}})
    assert {trace.xaxis for trace in drawn.data} == {"x"}
    assert set(FIGURES["residual-quiver"].table(sequential_result)["when"]) == {"before", "after"}


@given(st.floats(1e-6, 1e3), st.floats(1.0, 1e3))
def test_the_scale_of_arrows_is_round_and_keeps_them_inside_their_cells(length_px, size_px):
    one = np.ones(3)
    scale = choose_scale(MeanCells(one, one, length_px * one, 0 * one, one, one, one), size_px)
    assert scale * length_px <= size_px
    assert scale * length_px >= 0.3 * size_px
    assert float(f"{scale:.0e}"[0]) in {1, 2, 5}


def test_shares_are_of_all_residuals_beyond_the_bins_too(sequential_result):
    part = sequential_result["trust"]["residual_distribution"]
    counts = part["before"]["counts"]
    assert shares(part, "before").sum() == pytest.approx(sum(counts) / (sum(counts) + 2010))
    assert shares(part, "after").sum() == pytest.approx(1)
    names = [trace.name for trace in draw("residual-distribution", sequential_result).data]
    assert any("beyond 6 σ" in name for name in names)


def test_quantiles_stand_beside_the_band_of_chance(sequential_result):
    part = sequential_result["trust"]["residual_distribution"]
    band, line = [trace for trace in draw("residual-distribution", sequential_result).data if trace.xaxis == "x2"]
    np.testing.assert_allclose(numbers(line.y), 0.01 * numbers(part["normal"]), atol=1e-6)
    np.testing.assert_allclose(numbers(band.y).max(), 3 * max(part["sigma_of_quantile"]), rtol=1e-5)


def test_reasons_are_counted_once_and_the_most_frequent_come_first():
    result = {
        "matching": {"row_reasons": {"no star is near": 5, "two are near": 9}},
        "left_out": [
            {"what": "stars", "count": 14, "reason": "not matched to a catalogue star"},
            {"what": "exposures", "count": 7, "reason": "fewer than 4 usable stars"},
        ],
    }
    assert list(reasons(result).items()) == [
        ("two are near", 9), ("exposures: fewer than 4 usable stars", 7), ("no star is near", 5)
    ]  # fmt: skip
    assert reasons({"left_out": result["left_out"]})["stars: not matched to a catalogue star"] == 14
    assert reasons({}) == {}


def test_outliers_name_their_frame_and_star(sequential_result):
    part = sequential_result["trust"]["residual_outliers"]
    places = draw("residual-outliers", sequential_result).data[0]
    assert places.text[0] == f"HIP {part['star_id'][0]}, frame {part['frame'][0]}"
    assert FIGURES["residual-outliers"].table(sequential_result)["frame"] == part["frame"]


def test_one_outlier_is_drawn_on_the_whole_detector(sequential_result):
    drawn = draw("residual-outliers", sequential_result)
    assert drawn.layout.xaxis.range == (-0.5, 2591.5)
    assert drawn.layout.yaxis.range == (1943.5, -0.5)
    trust = sequential_result["trust"]
    part = {name: value for name, value in trust["residual_outliers"].items() if name not in {"rows", "columns"}}
    former = draw("residual-outliers", sequential_result | {"trust": trust | {"residual_outliers": part}})
    assert former.layout.xaxis.range[1] == pytest.approx(max(part["col_px"]) + 0.5)


def test_the_rms_map_leaves_cells_without_stars_open(sequential_result):
    trust = sequential_result["trust"]
    field = trust["residual_field"]
    rms = numbers(field["after"]["rms_px"])
    rms[3, 4] = np.nan
    after = field["after"] | {"rms_px": [[None if np.isnan(value) else value for value in row] for row in rms]}
    part = field | {"after": after}
    drawn = draw("residual-rms", sequential_result | {"trust": trust | {"residual_field": part}})
    z = numbers(drawn.data[0].z)
    assert np.isnan(z[3, 4])
    assert np.isfinite(z).sum() == 191
    assert drawn.data[0].zmin == 0
