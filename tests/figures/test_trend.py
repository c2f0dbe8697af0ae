"""The trend's figure: every number at its place, what does not count open, models apart, nothing too large to send."""

from typing import Any

import pytest

from boresight.figures import figure_json
from boresight.figures.charts import trend

NAMES = ["f_m", "b2_per_m2"]


def _point(number: int, **changed: Any) -> dict[str, Any]:
    return {
        "run_id": number,
        "label": "",
        "method": "batch",
        "camera_model": "inverted_wang",
        "telemetry_set_id": number,
        "telemetry": f"Pass {number}",
        "begins_utc": f"2026-01-{number:02}T00:00:00.000000Z",
        "at_utc": f"2026-01-{number:02}T01:00:00.000000Z",
        "ends_utc": f"2026-01-{number:02}T02:00:00.000000Z",
        "timed": True,
        "temperature_c": 20.0 + number,
        "parameters": {"f_m": 0.016 + 1e-6 * number, "b2_per_m2": 10.0 * number},
        "sigma": {"f_m": 2e-6, "b2_per_m2": 3.0},
        "stars": 1000,
        "rms_arc_rad": 8e-5,
        "counted": True,
        "left_out": None,
        "said": None,
    } | changed


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
        "camera_model": "inverted_wang",
        "parameter_names": NAMES,
        "points": [_point(2), _point(3, counted=False, left_out="its data overlap"), _point(5)],
        "others": [_point(7, camera_model="pinhole_radial", parameters={"k1": 0.1}, sigma={"k1": 0.01})],
        "baselines": [_period(1, "2026-01-20T00:00:00.000000Z"), _period(2, None)],
        "on_board": [
            {"at_utc": "2026-01-21T00:00:00.000000Z", "state": "SENT", "parameter_set_id": 2, "name": "PS-ST1-2"}
        ],
        "truth": {"f_m": 0.016001, "b2_per_m2": 12.0},
        "drift": {"verdict": "HOLDS"},
    }


def _named(figure: Any, name: str) -> list[Any]:
    return [trace for trace in figure.data if trace.name == name]


def test_a_point_is_its_difference_from_the_baseline_of_now_with_three_sigmas(document: dict[str, Any]) -> None:
    figure = trend.draw(document)
    focus, distortion = _named(figure, "Calibration ±3σ")
    assert list(focus.y) == pytest.approx([2.0, 5.0])  # µm
    assert list(focus.error_y.array) == pytest.approx([6.0, 6.0])
    assert list(distortion.y) == pytest.approx([10.0, 40.0])
    assert list(focus.x) == ["2026-01-02T01:00:00.000", "2026-01-05T01:00:00.000"]


def test_what_does_not_count_is_open_and_says_why(document: dict[str, Any]) -> None:
    shown = _named(trend.draw(document), "Not counted")[0]
    assert shown.marker.symbol == "circle-open"
    assert shown.customdata[0][1] == "its data overlap"


def test_baselines_truth_temperature_and_records_have_their_places(document: dict[str, Any]) -> None:
    figure = trend.draw(document)
    assert [list(trace.y) for trace in _named(figure, "Baseline PS-ST1-2")] == [[0.0, 0.0]] * 2
    assert list(_named(figure, "Baselines before")[1].y) == [-5.0, -5.0]
    assert _named(figure, "Truth")[1].y[0] == pytest.approx(2.0)
    assert list(_named(figure, "Temperature")[0].y) == [22.0, 23.0, 25.0]
    assert "PS-ST1-2 SENT" in _named(figure, "Records")[0].text


def test_another_model_stands_apart_and_about_its_own_first(document: dict[str, Any]) -> None:
    figure = trend.draw(document, "pinhole_radial")
    assert list(_named(figure, "Calibration ±3σ")[0].y) == [0.0]
    assert _named(figure, "Baseline PS-ST1-2") == []
    assert set(trend.table(document, "pinhole_radial")) >= {"k1", "sigma_k1"}


def test_nothing_yet_says_what_to_do(document: dict[str, Any]) -> None:
    figure = trend.draw({**document, "points": []})
    assert "launch a run" in figure.layout.annotations[0].text
    assert trend.table({**document, "points": []})["run"] == []


def test_the_table_has_a_sigma_beside_every_estimate(document: dict[str, Any]) -> None:
    table = trend.table(document)
    assert table["f_m"] == pytest.approx([0.016002, 0.016003, 0.016005])
    assert table["sigma_b2_per_m2"] == [3.0] * 3
    assert table["counted"] == ["yes", "no", "yes"]


def test_two_hundred_calibrations_stay_small(document: dict[str, Any]) -> None:
    many = {**document, "points": [_point(1 + k % 28) for k in range(200)]}
    assert len(figure_json(trend.draw(many))) < 250_000
