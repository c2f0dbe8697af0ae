"""The growth part: files of any length that begin alike, and each size calibrated in a process of its own."""

import numpy as np
import pytest

from boresight.measurements import growth
from boresight.measurements.synthetic_file import CHUNK, write_synthetic
from boresight.telemetry.readers import read_telemetry


def test_a_longer_file_begins_with_the_rows_of_a_shorter_one(tmp_path):
    short, long = tmp_path / "short.parquet", tmp_path / "long.parquet"
    write_synthetic(short, CHUNK)
    write_synthetic(long, CHUNK + 10)

    first, second = read_telemetry(short), read_telemetry(long)
    assert len(np.unique(second.frame)) == CHUNK + 10
    np.testing.assert_array_equal(first.row_px, second.row_px[: len(first)])


def test_each_size_is_calibrated_and_held_against_the_limits():
    heard = []
    found = growth.measure(
        lambda *told: heard.append(told), sizes=(60, 120), methods=("batch",), rematch_sizes=(24, 48)
    )

    rows = found["runs"]["batch"]
    assert [row["frames"] for row in rows] == [60, 120]
    assert {row["status"] for row in rows} == {"converged"}
    assert all(50 < row["peak_mb"] < 2000 for row in rows)
    assert len(found["growth"]["batch"]["between_neighbours"]) == 1
    assert found["limits"]["batch_exponent"]["kept"] is not None
    assert found["limits"]["batch_peak_growth"]["measured"] is None
    assert found["limits"]["batch_exponent_of_the_two_largest"]["measured"] is None
    assert 0 < found["empty_s"] < 60
    assert [row["frames"] for row in found["rematch"]] == [24, 48]
    assert {row["status"] for row in found["rematch"]} == {"converged"}
    assert found["limits"]["rematch_exponent"]["kept"] is not None
    assert [share for share, _ in heard] == sorted(share for share, _ in heard)


def test_the_exponent_is_the_slope_of_time_over_frames():
    rows = [{"frames": n, "seconds": 1e-5 * n**1.2} for n in (1000, 10_000, 100_000)]
    assert growth._growth(rows) == {
        "exponent": pytest.approx(1.2),
        "between_neighbours": [pytest.approx(1.2), pytest.approx(1.2)],
        "exponent_beyond_start": pytest.approx(1.2),
    }


def test_what_a_process_costs_to_start_hides_no_growth():
    """Seconds of starting flatten the slope over all sizes below its limit; the other two exponents see n^1.3 all the same."""
    rows = [{"frames": n, "seconds": 4.0 + 2e-5 * n**1.3, "peak_mb": 1.0} for n in (1000, 10_000, 100_000, 1_000_000)]
    grown = {"batch": growth._growth(rows, 4.0)}
    limits = growth._limits({"batch": rows}, grown)

    assert limits["batch_exponent"]["kept"]
    assert not limits["batch_exponent_of_the_two_largest"]["kept"]
    assert limits["batch_exponent_beyond_start"]["measured"] == pytest.approx(1.3)
    assert not limits["batch_exponent_beyond_start"]["kept"]
