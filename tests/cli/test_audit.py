"""`boresight audit verify` on a database that was edited by hand."""

import pytest

from boresight.store.chain import append_own
from boresight.store.sessions import open_engine, writing
from boresight.store.tables import Blob, Sensor, TelemetrySet
from tests.stores import drop_triggers, url_in

NOW = "2026-11-21T00:00:00.000000Z"
ADD = ("user", "add", "ana", "--role", "analyst", "--printed-name", "Ana", "--password-stdin")


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ("UPDATE users SET roles = '[\"administrator\"]'", "Record 1 sealed it otherwise: users/1 was changed"),
        ("UPDATE users SET password_hash = 'x'", "Record 1 sealed it otherwise: users/1 was changed"),
        ("DELETE FROM users", "users/1 was removed outside Boresight"),
        (
            "INSERT INTO users SELECT 2, 'eve', printed_name, password_hash, roles, created_utc, NULL, 0, 0 FROM users",
            "No record put it there: users/2 was inserted",
        ),
        (
            "UPDATE audit SET id = id + 1000",
            "Record 1001 is not as it was written, or it was renumbered",
        ),
        ("UPDATE audit SET actor = 'Mallory'", "Record 1 is not as it was written"),
    ],
)
def test_an_edit_by_hand_is_found_and_named(store, tmp_path, edit, said):
    assert store(*ADD, stdin="correct horse battery\n").exit_code == 0
    assert store("audit", "verify").exit_code == 0
    _edit_by_hand(tmp_path, edit)
    found = store("audit", "verify")
    assert found.exit_code == 1
    assert said in found.stderr


def _edit_by_hand(folder, edit):
    """Edit the database as its owner could, with triggers and foreign keys out of the way."""
    engine = open_engine(url_in(folder))
    with engine.connect() as connection:
        if connection.dialect.name == "sqlite":
            connection.connection.driver_connection.execute("PRAGMA foreign_keys=OFF")
        else:
            connection.exec_driver_sql("SET session_replication_role = replica")
        drop_triggers(connection)
        connection.exec_driver_sql(edit)
        connection.commit()
    engine.dispose()


def test_a_blob_edited_by_hand_is_found_by_the_row_that_named_it(store, tmp_path):
    assert store(*ADD, stdin="correct horse battery\n").exit_code == 0
    engine = open_engine(url_in(tmp_path))
    with writing(engine) as session:
        session.add(Sensor(name="ST1", document={}, created_utc=NOW))
        session.add(Blob(sha256="a" * 64, size_bytes=1, media_type="text/csv", created_utc=NOW))
        session.flush()
        session.add(_telemetry())
        append_own(session, "uploaded", "telemetry-sets/1")
    engine.dispose()
    assert store("audit", "verify").exit_code == 0
    _edit_by_hand(tmp_path, "UPDATE blobs SET sha256 = 'b' || substr(sha256, 2)")
    found = store("audit", "verify")
    assert found.exit_code == 1
    assert "Record 2 sealed it otherwise: telemetry_sets/1 was parted from a row that it refers to" in found.stderr


def _telemetry():
    """A telemetry set that names the blob twice."""
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
    assert store("migrate").exit_code == 0
    assert store("migrate", "--down", "0002").exit_code == 0
    before = path.read_bytes()
    found = store("audit", "verify")
    assert found.exit_code == 1
    assert "has schema 0002" in found.stderr
    assert "boresight migrate" in found.stderr
    assert path.read_bytes() == before
