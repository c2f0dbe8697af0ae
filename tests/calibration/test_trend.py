"""What a trend keeps of a calibration: covariances that are too small are widened, what cannot be compared is left out."""

from typing import Any

import pytest

from boresight.calibration.result import trend_entry

RESULT: dict[str, Any] = {
    "camera_model": "inverted_wang",
    "status": "converged",
    "variant": None,
    "parameters": {"f_m": 0.016, "g_y": 1.0},
    "covariance": {"names": ["f_m"], "matrix": [[4e-12]]},
    "chi2": {"upper": 1.1},
    "chi2_per_dof": 1.05,
    "inputs": {"settings": {"linearisations": 6, "forgetting_factor": 1.0}},
}


def _entry(**changed: Any) -> dict[str, Any]:
    entry = trend_entry({**RESULT, **changed})
    assert entry is not None
    return entry


def test_an_honest_covariance_is_kept_as_it_is() -> None:
    entry = _entry()
    assert (entry["covariance"], entry["variance_factor"], entry["said"], entry["left_out"]) == (
        [[4e-12]],
        1.0,
        None,
        None,
    )


@pytest.mark.parametrize(
    ("changed", "factor", "word"),
    [
        ({"chi2_per_dof": 4.0}, 4.0, "chi-square"),
        ({"nis": {"mean": 2.25, "upper": 1.2}}, 2.25, "innovations"),
        ({"trust": {"efficiency": {"overall_ratio": 0.5}}}, 4.0, "Cramér-Rao"),
        ({"chi2_per_dof": 2.0, "nis": {"mean": 9.0, "upper": 1.2}}, 9.0, "innovations"),
    ],
)
def test_a_covariance_that_is_too_small_is_widened_by_the_worst_sign_of_it(
    changed: dict[str, Any], factor: float, word: str
) -> None:
    entry = _entry(**changed)
    assert entry["variance_factor"] == pytest.approx(factor)
    assert entry["covariance"][0][0] == pytest.approx(4e-12 * factor)
    assert word in entry["said"]


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"status": "max_iterations"}, "max iterations"),
        ({"variant": "q"}, "process noise"),
        ({"variant": "no-refit"}, "matches were held"),
        ({"variant": "no-q", "inputs": {"settings": {"linearisations": 1}}}, "over-confident"),
        ({"variant": "no-q", "inputs": {"settings": {"forgetting_factor": 0.99}}}, "forgets"),
    ],
)
def test_what_no_factor_makes_comparable_is_left_out(changed: dict[str, Any], why: str) -> None:
    assert why in _entry(**changed)["left_out"]


def test_nothing_estimated_is_nothing_to_keep() -> None:
    assert trend_entry({**RESULT, "covariance": {"names": [], "matrix": []}}) is None
    assert trend_entry({"status": "running"}) is None
