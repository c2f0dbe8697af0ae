"""What one more thing costs is what a step added over what it made: rows exactly, bytes and seconds more than none."""

import pytest

from boresight.measurements import ledger as ledgers
from boresight.measurements.footprint import measure
from boresight.measurements.ledger import Ledger
from boresight.services import runs
from boresight.store.sessions import migrate, open_engine, reading
from boresight.store.sizes import table_sizes


@pytest.fixture(scope="module")
def sqlite():
    """Measure a small store, on SQLite alone: PostgreSQL has no server for us here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("boresight.measurements.footprint.installed", lambda: False)
        return measure(lambda _fraction, _message: None, frames=60, sensors=3, runs=2, launches=5)["databases"][
            "sqlite"
        ]


def test_a_sensor_is_its_row_its_ground_calibration_and_audit_records(sqlite):
    assert sqlite["sensor"]["rows"]["sensors"] == 1
    assert sqlite["sensor"]["rows"]["audit"] >= 1
    assert sqlite["sensor"]["database_bytes"] > 0


def test_a_longer_set_takes_more_files_and_no_more_rows(sqlite):
    short, long = sqlite["set"].values()

    assert short["rows"] == long["rows"]
    assert long["blob_bytes"] > 4 * short["blob_bytes"]


def test_a_launch_is_a_row_and_a_record_and_takes_time(sqlite):
    assert sqlite["launch"]["rows"]["runs"] == 1
    assert sqlite["launch"]["seconds"] > 0
    assert sqlite["launch"]["blob_bytes"] == 0


@pytest.mark.parametrize("method", ["batch", "sqrf"])
def test_a_run_costs_its_worker_time_and_a_result_and_its_line_goes_through_both_lengths(sqlite, method):
    cost = sqlite["run"][method]

    for frames in (10, 60):
        found, line = cost[str(frames)], cost["line"]["blob_bytes"]
        assert found["rows"]["runs"] == 1
        assert found["worker_cpu_s"] > 0
        assert found["server_cpu_s"] > 0
        assert line["constant"] + line["per_frame"] * frames == pytest.approx(found["blob_bytes"])


def test_launches_in_bulk_write_the_same_rows_and_processor_time_is_told_beside_seconds(sqlite):
    bulk = sqlite["launch_in_bulk"]

    assert bulk["rows"] == sqlite["launch"]["rows"]
    assert 0 < bulk["seconds"] < sqlite["launch"]["seconds"]
    for cost in (sqlite["sensor"], sqlite["launch"], *sqlite["set"].values()):
        assert cost["own_cpu_s"] > 0


def test_a_table_s_bytes_are_pages_and_an_empty_one_has_no_rows(tmp_path):
    engine = open_engine(f"sqlite:///{tmp_path}/store.db")
    migrate(engine)
    sizes = table_sizes(engine)
    engine.dispose()

    assert sizes["runs"].rows == 0
    assert sizes["runs"].size % 4096 == 0
    assert sizes["runs"].size > 0


def test_all_that_was_queued_for_the_clock_is_taken_away_however_many_pages_it_fills(tmp_path, monkeypatch):
    monkeypatch.setattr(ledgers, "RUNS_AT_ONCE", 2)
    with Ledger(tmp_path, "") as ledger:
        ledger.register(1)
        ledger.store(10)
        ledger.launch_only(5)
        ledger.cancel_all()

        with reading(ledger._engine) as session:
            assert runs.count_by_state(session)["QUEUED"] == 0
