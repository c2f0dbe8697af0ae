"""Small versions of the parts that calibrate in fresh processes, and what their figures say."""

import numpy as np
import pytest

from benchmarks import growth, whole
from benchmarks.stars import CHUNK, write_synthetic
from boresight.telemetry.read.readers import read_telemetry


def test_every_step_of_a_whole_calibration_is_told_and_its_limit_is_judged_at_full_size_only():
    heard = []
    found = whole.measure(lambda *told: heard.append(told), frames=60, small_frames=20)
    for name in ("given", "small", "rematch"):
        assert found[name]["status"] == "converged"
        assert sum(found[name]["steps_s"].values()) == pytest.approx(found[name]["total_s"], rel=0.2)
    given = found["given"]
    assert 2 <= given["evaluations_of_one_weighing"] < given["evaluations"] <= 40
    if "c_fit_s" in given:
        assert given["over_c_fit"] == pytest.approx(given["total_s"] / given["c_evaluation_s"] / given["evaluations"])
    assert found["limits"]["over_c_fit"]["kept"] is None
    assert heard[-1] == (1.0, "done")


def test_each_size_is_calibrated_in_a_process_of_its_own(monkeypatch):
    monkeypatch.setattr(growth, "EMPTY_RUNS", 1)
    found = growth.measure(lambda *_: None, sizes=(60,), methods=("batch",), rematch_sizes=(24,))
    (row,), (matched,) = found["runs"]["batch"], found["rematch"]
    assert (row["frames"], row["status"], matched["frames"], matched["status"]) == (60, "converged", 24, "converged")
    assert 50 < row["peak_mb"] < 2000
    assert found["limits"]["batch_exponent_of_the_two_largest"]["measured"] is None


def test_the_first_calibration_is_counted_from_before_the_interpreter_starts():
    found = growth.measure_fresh(lambda *_: None, frames=60, repeats=1, uncompiled=False)
    assert found["first_s"] > found["warm_s"] > 0
    assert found["limits"]["fresh_over_warm"]["measured"] == pytest.approx(found["first_s"] - found["warm_s"])


def test_what_a_process_costs_to_start_hides_no_growth():
    rows = [{"frames": n, "seconds": 4.0 + 2e-5 * n**1.3, "peak_mb": 1.0} for n in (1000, 10_000, 100_000, 1_000_000)]
    limits = growth.limits_of_growth({"batch": rows}, {"batch": growth.growth(rows, 4.0)})
    assert limits["batch_exponent"]["kept"]
    assert not limits["batch_exponent_of_the_two_largest"]["kept"]
    assert limits["batch_exponent_beyond_start"]["measured"] == pytest.approx(1.3)


def test_a_longer_file_begins_with_the_rows_of_a_shorter_one(tmp_path):
    for name, frames in (("short", CHUNK), ("long", CHUNK + 10)):
        write_synthetic(tmp_path / f"{name}.parquet", frames)
    first, second = (read_telemetry(tmp_path / f"{name}.parquet") for name in ("short", "long"))
    assert len(np.unique(second.frame)) == CHUNK + 10
    np.testing.assert_array_equal(first.row_px, second.row_px[: len(first)])
