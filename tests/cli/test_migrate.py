"""`boresight migrate --down` says what it would remove, and removes it only when agreed to and backed up."""

import pytest

from boresight.platform.db.sessions import current_revision, head_revision, open_engine
from tests.stores import url_in

ADD = ("--role", "analyst", "--password-stdin")
PASSWORD = "correct horse battery\n"


@pytest.fixture(autouse=True)
def _own_files(monkeypatch, tmp_path):
    monkeypatch.setenv("BORESIGHT_BLOBS", str(tmp_path / "blobs"))


def _revision(folder):
    engine = open_engine(url_in(folder))
    try:
        return current_revision(engine)
    finally:
        engine.dispose()


def test_what_a_way_back_removes_is_told_and_wants_agreement_and_a_backup_of_just_now(store, tmp_path):
    assert store("user", "add", "ana", "--printed-name", "Analyst ana", *ADD, stdin=PASSWORD).exit_code == 0
    assert store("backup", "--out", tmp_path / "old.zip").exit_code == 0
    assert store("user", "add", "bo", "--printed-name", "Analyst bo", *ADD, stdin=PASSWORD).exit_code == 0
    for words in ((), ("--yes",), ("--backup", tmp_path / "old.zip"), ("--yes", "--backup", tmp_path / "old.zip")):
        refused = store("migrate", "--down", "base", *words)
        assert (refused.exit_code, "removes 2 rows of users" in refused.stdout) == (1, True), words
        assert "Nothing was changed" in refused.stderr
        assert _revision(tmp_path) == head_revision()
    assert (
        store("user", "add", "cy", "--printed-name", "Analyst cy", *ADD, stdin=PASSWORD).exit_code == 0
    )  # the tables are all there
    assert store("backup", "--out", tmp_path / "new.zip").exit_code == 0
    done = store("migrate", "--down", "base", "--yes", "--backup", tmp_path / "new.zip")
    assert (done.exit_code, "removes 3 rows of users" in done.stdout) == (0, True), done.stderr
    assert _revision(tmp_path) is None


def test_a_way_back_that_removes_columns_with_content_names_them(store, tmp_path):
    assert store("user", "add", "ana", "--printed-name", "Analyst ana", *ADD, stdin=PASSWORD).exit_code == 0
    refused = store("migrate", "--down", "0002")
    assert refused.exit_code == 1
    assert "removes audit.rows of" in refused.stdout
    assert _revision(tmp_path) == head_revision()


def test_a_way_back_on_an_empty_store_asks_nothing(store, tmp_path):
    store("migrate")
    assert store("migrate", "--down", "base").exit_code == 0
    assert _revision(tmp_path) is None


def test_what_is_no_backup_is_refused(store, tmp_path):
    assert store("user", "add", "ana", "--printed-name", "Analyst ana", *ADD, stdin=PASSWORD).exit_code == 0
    (tmp_path / "a.zip").write_text("no zip")
    refused = store("migrate", "--down", "base", "--yes", "--backup", tmp_path / "a.zip")
    assert (refused.exit_code, "cannot be read as a backup" in refused.stderr) == (1, True)
    assert _revision(tmp_path) == head_revision()
