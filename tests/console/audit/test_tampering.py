"""Whoever edits the database by hand is found: any row of any sealed table, any lasting column, any record of the chain.

The store is one after the whole way of a parameter set, and every sealed table has a row in it. It is edited as an
attacker would who owns the file: by SQLite alone, with triggers, checks and foreign keys out of the way.
"""

import re
import sqlite3
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from boresight.console import list_queries as lists
from boresight.console.access import api_keys, users
from boresight.console.access.tables import ExternalIdentity, RecoveryCode, SecondFactor
from boresight.console.alarms import rules
from boresight.console.alarms.rules import check_chain
from boresight.console.alignments.tables import Alignment, AlignmentRequest
from boresight.console.approvals import service as approvals
from boresight.console.approvals import threads
from boresight.console.approvals.tables import Approval, GateProfile, GateReport, Waiver
from boresight.console.backups.tables import Backup, BackupSchedule
from boresight.console.campaigns.tables import Campaign, CampaignRun
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.ingest.tables import IngestDecision, IngestPolicy
from boresight.console.messages.tables import MessageAddress
from boresight.console.notes import service as notes
from boresight.console.notes.attachments import attach, check_file
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import JointSet, Preset, Run
from boresight.console.telemetry.tables import ImportProfile
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.tables import Package, TableDefinition
from boresight.console.webhooks import service as webhooks
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.audit import seals
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.declared import Base
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Engine, Session, open_engine, open_reading, open_writing, utc_now
from tests.effort import effort

pytestmark = pytest.mark.sqlite(
    "its owner edits the file; tests/platform/audit/test_verification.py has both engines edited"
)
NOW = "2026-11-21T00:00:00.000000Z"
TRIGGERS = "the trigger alarm_events_no_change"  # the first of those that an attacker took out of the way
SEALED = {model.__tablename__: model for model in seals.list_sealed()}
PLAIN: Mapping[type, Any] = {int: 7, str: "x", dict: {}, list: []}


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("tampering") / "store.sqlite3"


@pytest.fixture
def store(kept, request) -> Iterator[Engine]:
    if not kept.exists():
        engine: Engine = request.getfixturevalue("engine")
        row, blobs = request.getfixturevalue("approved")(), request.getfixturevalue("blobs")
        _go_the_whole_way(engine, request.getfixturevalue("people"), row, blobs)
        with open_writing(engine) as session:
            _fill_the_rest(session)
        engine.dispose()
        with closing(sqlite3.connect(str(engine.url.database))) as source, closing(sqlite3.connect(kept)) as target:
            source.backup(target)
    opened = open_engine(f"sqlite:///{kept}")
    yield opened
    opened.dispose()


def _go_the_whole_way(engine: Engine, people: Mapping[str, Actor], row: ParameterSet, blobs: BlobStore) -> None:
    with open_writing(engine) as session:
        approvals.promote(session, people["dee"], row.id, row.version)
        for state in ("SENT", "LOADED"):
            uplinks.record(session, people["dee"], row.id, state, "pass 4711")
        approval = lists.list_newest(session, Approval, set=row.id)[0]
        threads.open_thread(session, people["ana"], approval.id, "gate", "coverage", "The focus moved.")
        api_keys.create_key(session, people["ana"], label="passes", scopes=["runs"])
        users.change_roles(session, people["root"], people["eve"].user_id or 0, ["viewer", "operator"])
        with tempfile.TemporaryDirectory() as folder:
            box = SecretBox(Path(folder) / "webhooks.key")
            webhooks.create_webhook(session, people["root"], box, label="desk", url="https://example.org/hook")
        note = notes.add_note(session, people["ana"], "sensors", row.sensor_id, "The focus moved.")
        blobs.put(b"12:00 safe mode")
        attach(session, people["ana"], blobs, note.id, check_file("pass.log", b"12:00 safe mode"))
        notes.annotate(session, people["ana"], row.sensor_id, NOW, "The focus moved.")
        rules.update_installation_alarms(session, {rules.CHAIN: check_chain("broken", "For the sake of an alarm.")})


def _fill_the_rest(session: Session) -> None:
    for model in (
        TableDefinition,
        GateProfile,
        GateReport,
        Waiver,
        Package,
        Preset,
        Campaign,
        CampaignRun,
        ChangeProposal,
        ImportProfile,
        IngestPolicy,
        IngestDecision,
        JointSet,
        Alignment,
        AlignmentRequest,
        MessageAddress,
        ExternalIdentity,
        RecoveryCode,
        SecondFactor,
        BackupSchedule,
        Backup,
    ):
        if session.scalar(sa.select(sa.func.count()).select_from(model)) == 0:
            row = _plain(model)
            if isinstance(row, ChangeProposal):
                row.kind, row.state = "gate-profile", "OPEN"
            if isinstance(row, IngestPolicy):
                row.state, row.pause_code = "ACTIVE", "PERSON"
            if isinstance(row, IngestDecision):
                row.state, row.source, row.answer = "ANSWERED", "FOLDER", "WAIT"
            if isinstance(row, Alignment):
                row.state, row.result_sha256 = "SUCCEEDED", _any_blob()
            if isinstance(row, RecoveryCode | SecondFactor):
                row.ended_because = "reset"
            if isinstance(row, SecondFactor):
                row.kind = "totp"
            if isinstance(row, AlignmentRequest | Backup):
                row.state = "APPROVED" if isinstance(row, AlignmentRequest) else "SUCCEEDED"
            session.add(row)
            session.flush()
    audit.append(session, COMMAND_LINE, "filled", "tables")


def _plain(model: type[Base]) -> Base:
    values: dict[str, Any] = {}
    for column in model.__table__.columns:
        if column.name == "sha256":
            values[column.name] = _any_blob()
        elif column.name != "id":
            values[column.name] = 1 if column.type.python_type is int else PLAIN.get(column.type.python_type, {})
    return model(**values)


def _any_blob() -> sa.ScalarSelect[Any]:
    return sa.select(Run.__table__.columns["result_sha256"]).limit(1).scalar_subquery()


def _verify(engine: Engine, head: str | None = None) -> audit.ChainReport:
    with open_reading(engine) as session:
        return audit.verify(session, head)


class _Attacker:
    def __init__(self, path: Path) -> None:
        self.path, self.whole = path, path.read_bytes()

    def __enter__(self) -> sqlite3.Connection:
        self.connection = sqlite3.connect(self.path, isolation_level=None)
        self.connection.execute("PRAGMA ignore_check_constraints=ON")
        for (trigger,) in self.connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
            self.connection.execute(f"DROP TRIGGER {trigger}")
        return self.connection

    def __exit__(self, *_: object) -> None:
        self.connection.close()


@pytest.fixture
def attacker(store, kept) -> Iterator[_Attacker]:
    attacker = _Attacker(kept)
    yield attacker
    store.dispose()
    for name in (f"{kept}-wal", f"{kept}-shm"):
        Path(name).unlink(missing_ok=True)
    kept.write_bytes(attacker.whole)


def _last(connection: sqlite3.Connection, table: str) -> int:
    return int(connection.execute(f"SELECT max(id) FROM {table}").fetchone()[0])  # noqa: S608 - names of our own


def _sealing_record(connection: sqlite3.Connection, row: str) -> int:
    query = (
        "SELECT audit.id FROM audit, json_each(audit.rows) AS seal WHERE seal.key = ? ORDER BY audit.id DESC LIMIT 1"
    )
    return int(connection.execute(query, (row,)).fetchone()[0])


def test_every_sealed_table_has_a_row_and_all_is_as_it_was_written(store):
    report = _verify(store)
    assert (report.ok, report.first_broken_id, report.first_broken_row) == (True, None, None), report.sentence
    with open_reading(store) as session:
        counts = {
            model.__tablename__: session.scalar(sa.select(sa.func.count()).select_from(model))
            for model in seals.list_sealed()
        }
    assert all(counts.values()), counts
    assert report.rows == sum(count or 0 for count in counts.values())


@pytest.mark.few(40)
@pytest.mark.parametrize("table", SEALED)
def test_any_lasting_column_of_a_sealed_row_edited_by_hand_is_found(store, attacker, table):
    with attacker as connection:
        row_id = _last(connection, table)
        record_id = _sealing_record(connection, f"{table}/{row_id}")
        lasting = seals.lasting(SEALED[table])
        for column in reversed(lasting[: effort(3, len(lasting))]):  # the key last: the row is another one then
            before = connection.execute(f'SELECT "{column}" FROM {table} WHERE id = ?', (row_id,)).fetchone()[0]  # noqa: S608 - names of our own
            write = f'UPDATE {table} SET "{column}" = ? WHERE id = ?'  # noqa: S608 - names of our own
            connection.execute(write, (_another(before), row_id))
            report = _verify(store)
            assert (report.ok, report.first_broken_id) == (False, record_id), column
            assert report.first_broken_row == f"{table}/{row_id}", column
            assert re.search(f"record {record_id} .*: {table}/{row_id} was", report.sentence)
            if column != "id":
                connection.execute(write, (before, row_id))
                assert _verify(store).first_broken_row == TRIGGERS, column  # they were out of the way all the time


def _another(value: int | str | None) -> int | str:
    if isinstance(value, int):
        return value + 1000
    return 1 if value is None else f"{value} "


@pytest.mark.few(15)
@pytest.mark.parametrize("table", SEALED)
def test_any_sealed_row_removed_by_hand_is_found(store, attacker, table):
    with attacker as connection:
        row_id = _last(connection, table)
        record_id = _sealing_record(connection, f"{table}/{row_id}")
        connection.execute(f"DELETE FROM {table} WHERE id = ?", (row_id,))  # noqa: S608 - names of our own
    report = _verify(store)
    assert (report.ok, report.first_broken_id) == (False, record_id)
    assert f"{table}/{row_id} was removed" in report.sentence


@pytest.mark.few(15)
@pytest.mark.parametrize("table", SEALED)
def test_any_row_inserted_by_hand_is_found(store, attacker, table):
    with attacker as connection:
        connection.execute("PRAGMA writable_schema=ON")
        connection.execute("DELETE FROM sqlite_master WHERE type = 'index' AND sql IS NOT NULL")  # unique ones too
        names = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
        row_id = _last(connection, table) + 1
        copied = ", ".join(str(row_id) if name == "id" else f'"{name}"' for name in names)
        try:
            connection.execute(f"INSERT INTO {table} SELECT {copied} FROM {table} WHERE id = {row_id - 1}")  # noqa: S608 - names of our own
        except sqlite3.IntegrityError:
            _insert_a_unique_one(connection, table, row_id, names)
    report = _verify(store)
    assert (report.ok, report.first_broken_id, report.first_broken_row) == (False, None, f"{table}/{row_id}")
    assert "inserted outside" in report.sentence


def _insert_a_unique_one(connection: sqlite3.Connection, table: str, row_id: int, names: list[str]) -> None:
    moved = ", ".join(
        str(row_id)
        if name == "id"
        else f"CASE typeof(\"{name}\") WHEN 'integer' THEN \"{name}\" + 1000 WHEN 'text' THEN \"{name}\" || ' ' END"
        for name in names
    )
    connection.execute(f"INSERT INTO {table} SELECT {moved} FROM {table} WHERE id = {row_id - 1}")  # noqa: S608 - names of our own


def test_of_many_edits_the_oldest_record_is_named_and_the_others_counted(store, attacker):
    with store.connect() as connection:
        query = "SELECT name FROM sqlite_master WHERE type = 'trigger'"
        kept_triggers = connection.exec_driver_sql(query).all()
    with attacker as connection:
        connection.execute("UPDATE users SET roles = '[\"administrator\"]' WHERE id = 1")
        connection.execute("UPDATE parameter_sets SET ground_state = 'EXPIRED' WHERE id = 1")
        first = min(_sealing_record(connection, row) for row in ("users/1", "parameter_sets/1"))
    report = _verify(store)
    assert report.first_broken_id == first
    others = 1 + len(kept_triggers)
    assert f", and {others} more " in report.sentence


@pytest.mark.parametrize(
    "edit",
    [
        "UPDATE audit SET rows = NULL WHERE id = {id}",
        "UPDATE audit SET rows = '{{}}' WHERE id = {id}",
        "UPDATE audit SET roles = '[\"administrator\"]' WHERE id = {id}",
        "UPDATE audit SET after = after || ' ' WHERE id = {id}",
        "UPDATE audit SET at_utc = '2020-01-01T00:00:00.000000Z' WHERE id = {id}",
        "DELETE FROM audit WHERE id = {id} - 1",
    ],
)
def test_a_record_with_its_seals_edited_by_hand_is_named(store, attacker, edit):
    with attacker as connection:
        query = "SELECT min(id) FROM audit WHERE rows IS NOT NULL AND after IS NOT NULL AND id > 9"
        row_id = connection.execute(query).fetchone()[0]
        connection.execute(edit.format(id=row_id))
    report = _verify(store)
    assert (report.ok, report.first_broken_id) == (False, row_id)


def test_two_records_in_each_others_place_are_found(store, attacker):
    with attacker as connection:
        for move in ("-6 WHERE id = 5", "5 WHERE id = 6", "6 WHERE id = -6"):
            connection.execute(f"UPDATE audit SET id = {move}")  # noqa: S608 - words of our own
    assert _verify(store).first_broken_id == 5


def test_a_tail_that_was_cut_is_found_by_its_rows_and_by_a_head_from_outside(store, attacker):
    head = _verify(store).head
    with attacker as connection:
        connection.execute("DELETE FROM audit WHERE id > 12")
    alone, with_head = _verify(store), _verify(store, head)
    assert not alone.ok  # what the cut records sealed stands there without a seal, or with an older one
    assert not with_head.ok


def test_a_column_that_is_not_lasting_may_move(store, attacker):
    with attacker as connection:
        connection.execute("UPDATE api_keys SET last_used_utc = ?", (utc_now(),))
        connection.execute("UPDATE webhooks SET told_audit_id = 3")
    assert _verify(store).first_broken_row == TRIGGERS
