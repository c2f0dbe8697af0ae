"""Small versions of the parts that start servers and processes: everybody is answered, no run is lost."""

import numpy as np
import pytest

from benchmarks import clients, footprint, growth, queue, whole
from benchmarks.servers import PostgreSQL
from benchmarks.stars import CHUNK, write_synthetic
from benchmarks.stores import add_sensors, fill, opened
from boresight.console.fleet import status as fleet
from boresight.console.runs import service as runs
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading
from boresight.telemetry.read.readers import read_telemetry


def test_everybody_in_a_crowd_is_answered_and_every_listener_hears_every_event_once_and_in_order():
    found = clients.measure(lambda *_: None, runs=60, clients=8, seconds=0.2, listeners=40, changes=8)
    for name in clients.CROWDS:
        assert found[name]["failures"] == 0, found[name]
        assert found[name]["asked"] > 0, name
    assert found["list_unchanged"]["statuses"].get("304", 0) > 0
    feed = found["feed"]
    assert (feed["listening"], feed["events"]) >= (40, 4 * 8)
    faults = ("lost", "twice", "out_of_order", "not_theirs", "ended_by_the_server")
    assert {name: feed[name] for name in faults} == dict.fromkeys(faults, 0)
    assert found["limits"]["events_lost"]["kept"]


def test_no_page_of_a_large_fleet_names_every_sensor():
    found = clients.measure_fleet(lambda *_: None, sensors=(260,), runs_each=1, looks=1)["fleets"]["260"]
    assert set(found["pages"]) == set(clients.FLEET_PAGES)
    for path, page in found["pages"].items():
        assert 0 < page["kb"] < 300, path


def test_a_store_that_was_filled_fast_verifies_as_any_other(tmp_path):
    add_sensors(tmp_path, fill(tmp_path, 30, 2), 5, 2)
    with opened(tmp_path) as engine, open_reading(engine) as session:
        assert [one.name for one in fleet.list_sensor_statuses(session)][:-1] == [
            f"ST-{number:05d}" for number in range(1, 5)
        ]
        assert audit.verify(session).ok


def test_what_one_more_thing_costs_is_its_rows_exactly_and_a_line_through_both_lengths(monkeypatch):
    monkeypatch.setattr(PostgreSQL, "installed", lambda: False)
    found = footprint.measure(lambda *_: None, frames=60, sensors=2, runs=1, launches=5)["databases"]["sqlite"]
    assert found["sensor"]["rows"]["sensors"] == found["launch"]["rows"]["runs"] == 1
    assert found["launch_in_bulk"]["rows"] == found["launch"]["rows"]
    short, long = found["set"].values()
    assert short["rows"] == long["rows"]
    assert long["blob_bytes"] > 4 * short["blob_bytes"]
    for method, cost in found["run"].items():
        for frames in (10, 60):
            line = cost["line"]["blob_bytes"]
            assert cost[str(frames)]["rows"]["runs"] == 1, method
            assert line["constant"] + line["per_frame"] * frames == pytest.approx(cost[str(frames)]["blob_bytes"])


def test_all_that_was_queued_for_the_clock_is_taken_away_however_many_pages_it_fills(tmp_path, monkeypatch):
    monkeypatch.setattr(footprint, "RUNS_AT_ONCE", 2)
    with footprint.Ledger.opened(tmp_path) as ledger:
        ledger.register(1)
        ledger.store(10)
        ledger.launch_only(5)
        ledger.cancel_all()
        with open_reading(ledger.engine) as session:
            assert runs.count_by_state(session)["QUEUED"] == 0


def test_an_undisturbed_run_is_computed_once_and_its_time_is_known():
    calm = queue.one_pass(lambda *_: None, 6, 12, 3, {})
    assert calm["attempts"] == {"1": 6}
    assert calm["not_as_promised"] == 0
    assert 0 < calm["computing_cpu_s"] <= 1.1 * calm["computing_s"]
    assert calm["overhead_ms_per_run"] == pytest.approx((calm["wall_s"] * 2 - calm["computing_s"]) / 6 * 1e3)
    assert 0 < calm["claims_per_run"] <= 1


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
