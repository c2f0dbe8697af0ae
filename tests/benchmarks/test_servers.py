"""Small versions of the parts that start servers: everybody is answered, nobody misses an event, no run is lost."""

import pytest

from benchmarks import clients, footprint, queue
from benchmarks.servers import PostgreSQL
from benchmarks.stores import add_sensors, fill, opened
from boresight.console.fleet import status as fleet
from boresight.console.runs import service as runs
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading


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
