"""An installation of a released version is upgraded: nothing is lost, its log verifies, its backup moves to PostgreSQL."""

from __future__ import annotations

import hashlib
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
import sqlalchemy as sa

from boresight.platform.db.sessions import current_revision, head_revision, open_engine
from boresight.settings import read_settings
from tests.cli.conftest import accepted, boresight, data_folder
from tests.platform.db.released import RELEASED, make, unpack
from tests.served import serving

__all__ = ["boresight", "data_folder"]
pytestmark = pytest.mark.sqlite("version 0.1.0 stored in SQLite; the restore is on PostgreSQL")


@dataclass
class Stored:
    rows: dict[str, list[dict[str, Any]]]
    files: dict[str, str]

    @property
    def counts(self) -> dict[str, int]:
        return {table: len(rows) for table, rows in self.rows.items()}


def _read(data: Path) -> Stored:
    with closing(sqlite3.connect(data / "boresight.sqlite3")) as connection:
        connection.row_factory = sqlite3.Row
        tables = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        rows = {
            table: [dict(row) for row in connection.execute(f"SELECT * FROM {table} ORDER BY rowid")]  # noqa: S608 - names of its own
            for table in tables
            if not table.startswith(("sqlite_", "alembic_"))
        }
    files = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in _files(data)}
    return Stored(rows, files)


def _files(data: Path) -> list[Path]:
    return [path for path in (data / "blobs").rglob("*") if path.is_file()]


@pytest.fixture(params=RELEASED)
def small(request, tmp_path) -> Path:
    return unpack(request.param, tmp_path)


def _upgrade_and_move(boresight, monkeypatch, data: Path, postgresql) -> None:
    before = _read(data)
    head = before.rows["audit"][-1]["hash"]
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(data))
    accepted(boresight("migrate"))
    after = _read(data)
    assert after.files == before.files == {name: name for name in before.files}
    log = before.rows.pop("audit")
    assert [{name: row[name] for name in log[0]} for row in after.rows["audit"][: len(log)]] == log
    gone = {table: count for table, count in before.counts.items() if after.counts.get(table, 0) != count}
    assert gone == {}
    for table in ("runs", "parameter_sets", "signatures", "uplinks", "promotions", "telemetry_sets"):
        kept = before.rows[table][0].keys() & after.rows[table][0].keys()
        assert kept >= before.rows[table][0].keys() - {"cancel_requested"}, table
        assert [{name: row[name] for name in kept} for row in after.rows[table]] == [
            {name: row[name] for name in kept} for row in before.rows[table]
        ]
    assert f"All {len(after.rows['audit'])} records" in accepted(boresight("audit", "verify", "--head", head)).stdout
    accepted(boresight("backup", "rotate-key"))
    archive = data.parent / "all.backup"
    accepted(boresight("backup", "--out", archive, "--encrypt"))
    accepted(boresight("backup", "verify", archive))
    key = data / "backup.key"
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(data.parent / "moved"))
    monkeypatch.setenv("BORESIGHT_DATABASE_URL", postgresql.url.render_as_string(hide_password=False))
    accepted(boresight("restore", archive, "--key-file", key))
    accepted(boresight("audit", "verify", "--head", head))
    assert {path.name for path in _files(data.parent / "moved")} == before.files.keys()
    engine = open_engine(postgresql.url.render_as_string(hide_password=False))
    assert current_revision(engine) == head_revision()
    with engine.connect() as connection:
        there = {
            table: connection.scalar(sa.select(sa.func.count()).select_from(sa.table(table)))
            for table in before.counts.keys() & after.counts
        }
    engine.dispose()
    assert there == {table: before.counts[table] for table in there}


def test_a_small_installation_of_each_release_loses_nothing(boresight, monkeypatch, small, postgresql):
    _upgrade_and_move(boresight, monkeypatch, small, postgresql)


@pytest.mark.full
@pytest.mark.parametrize("version", RELEASED)
def test_a_thousand_runs_and_ten_thousand_records_of_each_release_lose_nothing(
    boresight, monkeypatch, tmp_path, postgresql, version
):
    data = make(version, tmp_path, 1000, 10_000)
    counts = _read(data).counts
    assert (counts["runs"], counts["audit"]) == (1000, 10_000)
    _upgrade_and_move(boresight, monkeypatch, data, postgresql)


def test_people_log_in_and_find_their_work_after_the_upgrade(small):
    settings = read_settings(
        {"BORESIGHT_DATA_FOLDER": str(small), "BORESIGHT_WORKERS": "0", "BORESIGHT_ANCHOR_MINUTES": "0"}
    )
    with serving(settings) as (address, _), httpx.Client(base_url=address, timeout=60) as client:
        answer = client.post("/api/v1/sessions", json={"name": "analyst", "password": "analyst-of-the-fleet"})
        assert answer.status_code == 201, answer.text
        states = [client.get(f"/api/v1/runs/{number}").json()["state"] for number in (1, 10, 20)]
        assert states == ["SUCCEEDED", "FAILED", "QUEUED"]
        for path in ("/", "/runs", "/runs/1", "/parameter-sets/2", "/sensors/1", "/approvals/1", "/audit", "/uplink"):
            assert client.get(path).status_code == 200, path
        assert client.get("/api/v1/audit/verification").json()["ok"]
