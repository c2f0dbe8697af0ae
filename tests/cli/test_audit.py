"""`boresight audit verify` on a database that was edited by hand."""

import random
import subprocess
import sys
from contextlib import nullcontext

import pytest

from boresight.console.fleet.tables import Sensor
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.audit.chain import append_own
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.store import register_blob
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.sessions import open_engine, open_writing
from tests.cli.conftest import accepted, assert_refused
from tests.stores import drop_triggers, triggers_aside, url_in

NOW = "2026-11-21T00:00:00.000000Z"


@pytest.fixture(autouse=True)
def _own_files(monkeypatch, tmp_path):
    monkeypatch.setenv("BORESIGHT_BLOBS", str(tmp_path / "blobs"))


ADD = ("user", "add", "ana", "--role", "analyst", "--printed-name", "Ana", "--password-stdin")


@pytest.mark.parametrize("command", [("verify", "--no-blobs"), ("export", "--out", "-")])
def test_a_program_of_its_own_knows_every_table_that_the_log_seals(store, monkeypatch, tmp_path, command):
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(tmp_path))
    accepted(store(*ADD, stdin="correct horse battery\n"))
    _edit_by_hand(tmp_path, "UPDATE users SET password_hash = 'x'")
    done = subprocess.run(
        [sys.executable, "-m", "boresight", "audit", *command], capture_output=True, text=True, check=False
    )
    assert "Error" not in done.stderr
    assert done.returncode == (1 if command[0] == "verify" else 0)
    assert ("users/1 was changed" in done.stderr) == (command[0] == "verify")


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ("UPDATE users SET roles = '[\"administrator\"]'", "The seal in record 1 does not match: users/1 was changed"),
        ("UPDATE users SET password_hash = 'x'", "The seal in record 1 does not match: users/1 was changed"),
        ("DELETE FROM users", "users/1 was removed outside Boresight"),
        (
            "INSERT INTO users SELECT 2, 'eve', printed_name, password_hash, roles, created_utc, NULL, 0, 0, NULL, NULL FROM users",
            "No record created it: users/2 was inserted",
        ),
        (
            "UPDATE audit SET id = id + 1000",
            "Record 1001 was altered or renumbered",
        ),
        ("UPDATE audit SET actor = 'Mallory'", "Record 1 was altered"),
    ],
)
def test_an_edit_by_hand_is_found_and_named(store, tmp_path, edit, said):
    accepted(store(*ADD, stdin="correct horse battery\n"))
    accepted(store("audit", "verify"))
    _edit_by_hand(tmp_path, edit)
    assert_refused(store("audit", "verify"), said)


def _edit_by_hand(folder, edit, *, aside=False):
    engine = open_engine(url_in(folder))
    with engine.connect() as connection:
        if connection.dialect.name == "sqlite":
            connection.connection.driver_connection.execute("PRAGMA foreign_keys=OFF")
        else:
            connection.exec_driver_sql("SET session_replication_role = replica")
        with triggers_aside(connection) if aside else nullcontext(drop_triggers(connection)):
            connection.exec_driver_sql(edit)
        connection.commit()
    engine.dispose()


def test_a_blob_edited_by_hand_is_found_by_the_row_that_named_it(store, tmp_path):
    accepted(store(*ADD, stdin="correct horse battery\n"))
    engine = open_engine(url_in(tmp_path))
    with open_writing(engine) as session:
        session.add(Sensor(name="ST1", document={}, created_utc=NOW))
        session.add(Blob(sha256="a" * 64, size_bytes=1, media_type="text/csv", created_utc=NOW))
        session.flush()
        session.add(_telemetry())
        append_own(session, "uploaded", "telemetry-sets/1")
    engine.dispose()
    accepted(store("audit", "verify", "--no-blobs"))
    _edit_by_hand(tmp_path, "UPDATE blobs SET sha256 = 'b' || substr(sha256, 2)")
    found = store("audit", "verify")
    assert_refused(
        found, "The seal in record 2 does not match: telemetry_sets/1 was separated from a row that it refers to"
    )


def _telemetry():
    sha256 = "a" * 64
    return TelemetrySet(
        sensor_id=1,
        name="stars.csv",
        purpose="calibration",
        original_sha256=sha256,
        table_sha256=sha256,
        frames=1,
        stars=1,
        quality={},
        uploaded_utc=NOW,
    )


@pytest.mark.sqlite("left alone means the bytes of its file")
def test_a_schema_of_another_version_is_refused_and_left_as_it_is(store, tmp_path):
    path = tmp_path / "boresight.sqlite3"
    empty = store("audit", "verify")
    assert (empty.exit_code, "has no tables yet" in empty.stderr) == (1, True), empty.stderr
    accepted(store("migrate"))
    accepted(store("migrate", "--down", "0002"))
    before = path.read_bytes()
    assert_refused(store("audit", "verify"), "has schema 0002", "boresight migrate")
    assert path.read_bytes() == before


def _store_a_file(folder, content=b"telemetry"):
    engine, blobs = open_engine(url_in(folder)), FolderBlobStore(folder / "blobs")
    with open_writing(engine) as session:
        row = register_blob(session, blobs, blobs.put(content), "text/csv")
        append_own(session, "stored", "blobs")
    engine.dispose()
    return blobs.path(row.sha256)


@pytest.mark.parametrize(
    ("spoil", "what"),
    [
        (lambda path: path.write_bytes(b"telemetrx"), "altered"),
        (lambda path: path.write_bytes(b""), "altered"),
        (lambda path: path.unlink(), "missing"),
    ],
)
def test_a_stored_file_that_was_altered_or_is_missing_is_named(store, tmp_path, spoil, what):
    accepted(store("migrate"))
    path = _store_a_file(tmp_path)
    found = store("audit", "verify")
    assert (found.exit_code, "1 stored file " in found.stdout) == (0, True)
    spoil(path)
    assert_refused(store("audit", "verify"), f"The stored file {path.name[:12]} (of no row): {what}")
    accepted(store("audit", "verify", "--no-blobs"))


def test_a_size_of_a_stored_file_that_was_edited_is_named(store, tmp_path):
    accepted(store("migrate"))
    path = _store_a_file(tmp_path)
    _edit_by_hand(tmp_path, "UPDATE blobs SET size_bytes = size_bytes + 1", aside=True)
    found = store("audit", "verify")
    assert (found.exit_code, f"{path.name[:12]} (of no row): of a different size" in found.stderr) == (1, True)


@pytest.mark.full
def test_twenty_bits_flipped_in_stored_files_are_twenty_noticed(store, tmp_path):
    accepted(store("migrate"))
    dice = random.Random(13)  # noqa: S311 - the same flips every time
    paths = [_store_a_file(tmp_path, dice.randbytes(size)) for size in (1, 40, 5000, 70_001, 2 << 20)]
    accepted(store("audit", "verify"))
    noticed = 0
    for _ in range(20):
        path = dice.choice(paths)
        content, bit = bytearray(path.read_bytes()), dice.randrange(8 * path.stat().st_size)
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        found = store("audit", "verify")
        noticed += found.exit_code == 1 and f"The stored file {path.name[:12]}" in found.stderr
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
    assert noticed == 20
    accepted(store("audit", "verify"))
