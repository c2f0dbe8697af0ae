"""Backup and restore: what comes back is what was there, and nothing is ever written over."""

import io
import json
import sqlite3
import stat
import tracemalloc
import zipfile
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from boresight import disks as integrity
from boresight.console.webhooks.tables import Webhook
from boresight.errors import RefusedInputError
from boresight.platform.audit import chain
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.store import register_blob
from boresight.platform.db import backup as backups
from boresight.platform.db.sessions import open_store, open_writing
from boresight.settings import read_settings
from tests.cli.conftest import accepted, assert_refused
from tests.stores import environment_in, on_postgresql

PASSWORD = "correct horse battery"
ADD = ("user", "add", "ana", "--role", "analyst", "--printed-name", "Ana", "--password-stdin")


@pytest.fixture
def filled(boresight, monkeypatch, tmp_path) -> Any:
    _into(monkeypatch, tmp_path / "first")
    (tmp_path / "first").mkdir()
    accepted(boresight(*ADD, stdin=f"{PASSWORD}\n"))
    sha256 = FolderBlobStore(tmp_path / "first" / "blobs").put(b"telemetry")
    done = accepted(boresight("backup", "--out", tmp_path / "all.zip"))
    assert " 1 files" in done.stdout
    return boresight, tmp_path / "all.zip", sha256


def _into(monkeypatch, folder: Path) -> Path:
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(folder))
    for name, value in environment_in(folder).items():
        monkeypatch.setenv(name, value)
    return folder


def test_what_was_backed_up_comes_back_and_its_audit_log_holds(filled, monkeypatch, tmp_path):
    boresight, archive, sha256 = filled
    folder = _into(monkeypatch, tmp_path / "second")
    done = accepted(boresight("restore", archive))
    assert "sealed rows are intact" in done.stdout
    assert FolderBlobStore(folder / "blobs").read(sha256) == b"telemetry"
    assert on_postgresql() or stat.S_IMODE((folder / "boresight.sqlite3").stat().st_mode) == 0o600
    accepted(boresight("audit", "verify"))
    assert_refused(boresight(*ADD, stdin=f"{PASSWORD}\n"), "'ana'", code="name-taken")


def test_nothing_is_written_over(filled):
    boresight, archive, _ = filled
    assert_refused(boresight("restore", archive), code="not-empty")
    assert_refused(boresight("backup", "--out", archive), code="backup-exists")


@pytest.mark.parametrize("name", ["boresight.sqlite3", "blobs"])
def test_a_file_that_is_not_as_it_was_backed_up_is_refused_and_no_database_appears(filled, monkeypatch, tmp_path, name):
    boresight, archive, _ = filled
    altered = tmp_path / "altered.zip"
    with zipfile.ZipFile(archive) as source, zipfile.ZipFile(altered, "w") as target:
        for member in source.namelist():
            content = source.read(member)
            target.writestr(member, content[:-1] + b"?" if member.startswith(name) else content)
    folder = _into(monkeypatch, tmp_path / "third")
    assert_refused(boresight("restore", altered), code="altered-backup")
    assert not (folder / "boresight.sqlite3").exists()
    assert boresight(*ADD, stdin=f"{PASSWORD}\n").exit_code == 0  # nobody of the backup is there


@pytest.mark.parametrize("manifest", [None, "[]", json.dumps({"schema": "another/1"})])
def test_another_zip_is_no_backup(boresight, monkeypatch, tmp_path, manifest):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        if manifest is not None:
            archive.writestr("MANIFEST.json", manifest)
    _into(monkeypatch, tmp_path / "fourth")
    assert_refused(boresight("restore", tmp_path / "a.zip"), code="no-backup")


def test_what_is_no_zip_is_refused_in_one_sentence(boresight, monkeypatch, tmp_path):
    (tmp_path / "a.zip").write_text("no zip")
    _into(monkeypatch, tmp_path / "fifth")
    assert_refused(boresight("restore", tmp_path / "a.zip"), code="unreadable-backup")


def test_an_installation_moves_to_postgresql_and_back_with_its_log(filled, monkeypatch, tmp_path, postgresql):
    boresight, archive, sha256 = filled
    _into(monkeypatch, tmp_path / "second")
    monkeypatch.setenv("BORESIGHT_DATABASE_URL", postgresql.url.render_as_string(hide_password=False))
    accepted(boresight("restore", archive))
    added = boresight(
        *ADD[:2], "bo", *ADD[3:6], "Bo", ADD[-1], stdin=f"{PASSWORD}\n"
    )  # numbered after those that came over
    assert added.exit_code == 0, added.stderr
    again = boresight("restore", archive)
    assert_refused(again, code="not-empty")
    saved = accepted(boresight("backup", "--out", tmp_path / "moved.zip"))
    folder = _into(monkeypatch, tmp_path / "third")
    monkeypatch.setenv("BORESIGHT_DATABASE_URL", f"sqlite:///{folder}/own.sqlite3")
    accepted(boresight("restore", tmp_path / "moved.zip"))
    assert FolderBlobStore(folder / "blobs").read(sha256) == b"telemetry"
    heads = [line.split()[-1] for line in saved.stdout.splitlines() if line.startswith("audit head")]
    accepted(boresight("audit", "verify", "--head", *heads))
    for name in ("ana", "bo"):
        again = boresight(*ADD[:2], name, *ADD[3:], stdin=f"{PASSWORD}\n")
        assert_refused(again, f"'{name}'", code="name-taken")


def test_files_of_an_object_store_stay_there_and_are_named(filled, monkeypatch, tmp_path):
    boresight, _, _ = filled
    monkeypatch.setenv("BORESIGHT_BLOBS", "memory:///flight")
    saved = boresight("backup", "--out", tmp_path / "rows.zip")
    assert "0 files" in saved.stdout
    assert "in memory:///flight" in saved.stdout
    _into(monkeypatch, tmp_path / "sixth")
    monkeypatch.setenv("BORESIGHT_BLOBS", "")
    assert "in memory:///flight" in boresight("restore", tmp_path / "rows.zip").stdout


def test_the_log_is_exported_with_its_verifier_or_alone(filled, tmp_path):
    boresight, _, _ = filled
    for name in ("log.zip", "log.jsonl"):
        accepted(boresight("audit", "export", "--out", tmp_path / name))
    with zipfile.ZipFile(tmp_path / "log.zip") as archive:
        assert set(archive.namelist()) == {"audit.jsonl", "anchors.jsonl", "verify_audit.py", "README.txt"}
    last = json.loads((tmp_path / "log.jsonl").read_text(encoding="utf-8").splitlines()[-1])
    accepted(boresight("audit", "verify", "--head", last["head"]))
    other = boresight("audit", "verify", "--head", "0" * 63 + "1")
    assert (other.exit_code, "rewritten" in other.stderr) == (1, True)


def test_a_backup_holds_no_secret_of_a_webhook_and_without_the_key_a_restore_says_what_to_do(
    filled, monkeypatch, tmp_path
):
    boresight, _, _ = filled
    _into(monkeypatch, tmp_path / "first")
    settings = read_settings()
    secret = "whsec_" + "A" * 43  # as an older version stored it
    with open_store(settings.database_url) as engine, open_writing(engine) as session:
        session.add(
            Webhook(label="Mission chat", url="https://a.example", actions=[], secret=secret, created_utc="2026")
        )
        chain.append_own(session, "brought in", "webhooks/1")
    accepted(boresight("backup", "--out", tmp_path / "secret.zip"))
    with zipfile.ZipFile(tmp_path / "secret.zip") as archive:
        assert not any(secret.encode() in archive.read(name) for name in archive.namelist())
        assert not any("key" in name for name in archive.namelist())
    folder = _into(monkeypatch, tmp_path / "elsewhere")
    restored = accepted(boresight("restore", tmp_path / "secret.zip"))
    assert "paused: Mission chat. Copy the key file" in restored.stderr
    folder.joinpath("webhooks.key").write_bytes(tmp_path.joinpath("first", "webhooks.key").read_bytes())
    rotated = accepted(boresight("webhook", "rotate-key", "--forget-old"))
    assert "old keys removed: 1" in rotated.stdout
    assert rotated.stderr == ""


def test_a_backup_of_a_corrupt_file_is_refused_or_names_it(filled, monkeypatch, tmp_path):
    boresight, _, sha256 = filled
    blobs = FolderBlobStore(tmp_path / "first" / "blobs")
    good = blobs.put(b"another")
    blobs.path(sha256).write_bytes(b"telemetrx")
    refused = boresight("backup", "--out", tmp_path / "b.zip")
    assert (refused.exit_code, sha256[:12] in refused.stderr, (tmp_path / "b.zip").exists()) == (1, True, False)
    kept = boresight("backup", "--keep-going", "--out", tmp_path / "b.zip")
    assert (kept.exit_code, sha256 in kept.stderr) == (1, True)
    with zipfile.ZipFile(tmp_path / "b.zip") as archive:
        assert {name for name in archive.namelist() if name.startswith("blobs/")} == {f"blobs/{good}"}
        assert json.loads(archive.read("MANIFEST.json"))["left_out"] == [sha256]
    folder = _into(monkeypatch, tmp_path / "restored")
    back = boresight("restore", tmp_path / "b.zip")
    assert (back.exit_code, sha256 in back.stderr) == (1, True)
    assert FolderBlobStore(folder / "blobs").read(good) == b"another"


def test_every_corrupt_member_of_a_backup_is_named(filled, monkeypatch, tmp_path):
    boresight, archive, sha256 = filled
    blobs = FolderBlobStore(tmp_path / "first" / "blobs")
    others = [blobs.put(content) for content in (b"one", b"two")]
    accepted(boresight("backup", "--out", tmp_path / "more.zip"))
    with zipfile.ZipFile(tmp_path / "more.zip") as packed:
        places = {info.filename: info.header_offset for info in packed.infolist()}
    content = bytearray((tmp_path / "more.zip").read_bytes())
    for name in (sha256, others[0]):  # a bit of the member's bytes, behind its header of 30 bytes and its name
        content[places[f"blobs/{name}"] + 30 + len(f"blobs/{name}")] ^= 1
    (tmp_path / "more.zip").write_bytes(content)
    folder = _into(monkeypatch, tmp_path / "nowhere")
    done = boresight("restore", tmp_path / "more.zip")
    assert done.exit_code == 1
    assert [name[:12] in done.stderr for name in (sha256, *others)] == [True, True, False]
    assert not (folder / "boresight.sqlite3").exists()
    assert archive.exists()


def _register(folder: Path, content: bytes) -> str:
    blobs, settings = FolderBlobStore(folder / "blobs"), read_settings()
    with open_store(settings.database_url) as engine, open_writing(engine) as session:
        sha256 = register_blob(session, blobs, blobs.put(content), "text/csv").sha256
        chain.append_own(session, "uploaded", f"files/{sha256[:12]}")
    return sha256


def _named_by(archive: Path, folder: Path) -> tuple[set[str], set[str]]:
    with zipfile.ZipFile(archive) as packed:
        database = Path(packed.extract("boresight.sqlite3", folder))
        held = {name.removeprefix("blobs/") for name in packed.namelist() if name.startswith("blobs/")}
    with closing(sqlite3.connect(database)) as connection:
        return {sha256 for (sha256,) in connection.execute("SELECT sha256 FROM blobs")}, held


def test_an_upload_while_the_files_are_verified_leaves_no_row_without_its_file(filled, monkeypatch, tmp_path):
    boresight, _, _ = filled
    folder = _into(monkeypatch, tmp_path / "first")
    first, late, whole = _register(folder, b"first"), [], integrity.is_intact

    def uploading(path: Path, sha256: str, *, again: bool = False) -> bool:
        if not late:
            late.append("")
            late[0] = _register(folder, b"uploaded meanwhile")
        return whole(path, sha256, again=again)

    for place in (integrity, backups):  # wherever the name is known
        monkeypatch.setattr(place, "is_intact", uploading, raising=False)
    done = boresight("backup", "--out", tmp_path / "live.zip")
    assert (done.exit_code, len(late)) == (0, 1), done.stderr
    monkeypatch.setattr(integrity, "is_intact", whole)
    named, held = _named_by(tmp_path / "live.zip", tmp_path / "seen")
    assert first in named
    assert named <= held
    _into(monkeypatch, tmp_path / "second")
    accepted(boresight("restore", tmp_path / "live.zip"))
    accepted(boresight("audit", "verify"))


def test_an_upload_before_the_files_are_listed_is_in_the_archive(filled, monkeypatch, tmp_path):
    boresight, _, _ = filled
    folder, late, copying = _into(monkeypatch, tmp_path / "first"), [], backups._copy_database

    def uploading(url: str, copy: Path) -> None:
        late.append(_register(folder, b"uploaded meanwhile"))
        copying(url, copy)

    monkeypatch.setattr(backups, "_copy_database", uploading)
    accepted(boresight("backup", "--out", tmp_path / "live.zip"))
    named, held = _named_by(tmp_path / "live.zip", tmp_path / "seen")
    assert set(late) <= named <= held


def test_a_registered_file_that_is_missing_is_refused_or_named_by_backup_and_restore(filled, monkeypatch, tmp_path):
    boresight, _, other = filled
    folder = _into(monkeypatch, tmp_path / "first")
    sha256 = _register(folder, b"to be lost")
    FolderBlobStore(folder / "blobs").path(sha256).unlink()
    refused = boresight("backup", "--out", tmp_path / "lost.zip")
    assert (refused.exit_code, sha256[:12] in refused.stderr, (tmp_path / "lost.zip").exists()) == (1, True, False)
    kept = boresight("backup", "--keep-going", "--out", tmp_path / "lost.zip")
    assert (kept.exit_code, sha256 in kept.stderr) == (1, True)
    with zipfile.ZipFile(tmp_path / "lost.zip") as archive:
        manifest = json.loads(archive.read("MANIFEST.json"))
    assert (manifest["missing"], manifest["left_out"], manifest["blobs"]) == ([sha256], [], 1)
    folder = _into(monkeypatch, tmp_path / "restored")
    back = boresight("restore", tmp_path / "lost.zip")
    assert (back.exit_code, sha256 in back.stderr) == (1, True)
    assert FolderBlobStore(folder / "blobs").read(other) == b"telemetry"


def test_restore_names_a_file_that_an_older_backup_lost_unseen(filled, monkeypatch, tmp_path):
    boresight, _, _ = filled
    sha256 = _register(_into(monkeypatch, tmp_path / "first"), b"in the rows only")
    accepted(boresight("backup", "--out", tmp_path / "whole.zip"))
    with zipfile.ZipFile(tmp_path / "whole.zip") as source, zipfile.ZipFile(tmp_path / "less.zip", "w") as target:
        manifest = json.loads(source.read("MANIFEST.json"))
        for member in source.namelist():
            if member not in {f"blobs/{sha256}", "MANIFEST.json"}:
                target.writestr(member, source.read(member))
        target.writestr("MANIFEST.json", json.dumps(manifest | {"blobs": manifest["blobs"] - 1}))
    _into(monkeypatch, tmp_path / "restored")
    back = boresight("restore", tmp_path / "less.zip")
    assert (back.exit_code, sha256[:12] in back.stderr) == (1, True)


def test_an_object_store_is_asked_whether_it_has_every_registered_file(filled, monkeypatch, tmp_path):
    boresight, _, _ = filled
    sha256 = _register(_into(monkeypatch, tmp_path / "first"), b"in the folder only")
    monkeypatch.setenv("BORESIGHT_BLOBS", "memory:///empty")
    saved = boresight("backup", "--out", tmp_path / "rows.zip")
    assert (saved.exit_code, sha256[:12] in saved.stderr) == (1, True)


def _altered(archive: Path, changes: dict[str, Any]) -> bytes:
    written = io.BytesIO()
    with zipfile.ZipFile(archive) as source, zipfile.ZipFile(written, "w", zipfile.ZIP_STORED) as target:
        for member in source.namelist():
            content = source.read(member)
            target.writestr(member, json.dumps(json.loads(content) | changes) if member == "MANIFEST.json" else content)
    return written.getvalue()


@pytest.mark.few(4)
@pytest.mark.parametrize(
    "changes",
    [
        {"database_sha256": None},
        {"database_sha256": 5},
        {"blobs": "1"},
        {"blobs": True},
        {"blobs": 0},
        {"blobs": 7},
        {"left_out": {"a": 1}},
        {"left_out": [["a"]]},
        {"missing": "abc"},
        {"audit_head": []},
        {"blobs_at": 3},
        {"taken_utc": {}},
    ],
)
def test_a_manifest_of_another_shape_is_refused_in_a_sentence(filled, monkeypatch, tmp_path, changes):
    boresight, archive, _ = filled
    (tmp_path / "other.zip").write_bytes(_altered(archive, changes))
    folder = _into(monkeypatch, tmp_path / "nowhere")
    done = boresight("restore", tmp_path / "other.zip")
    assert (done.exit_code, "unexpected" in done.stderr, "another backup" in done.stderr) == (1, False, True)
    assert not (folder / "boresight.sqlite3").exists()


@pytest.mark.parametrize("name", ["MANIFEST.json", "blobs/" + "0" * 64, "boresight.sqlite3"])
def test_a_zip_bomb_is_refused_in_little_memory_and_place(filled, monkeypatch, tmp_path, name):
    _, archive, _ = filled
    bomb = tmp_path / "bomb.zip"
    with (
        zipfile.ZipFile(archive) as source,
        zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as target,
    ):
        manifest = source.read("MANIFEST.json")
        for member in {"MANIFEST.json", "boresight.sqlite3", name} - {name}:
            target.writestr(member, manifest if member == "MANIFEST.json" else source.read(member))
        with target.open(name, "w") as member:
            for _ in range(128):
                member.write(bytes(1 << 20))
    assert bomb.stat().st_size < 2e6
    monkeypatch.setattr("shutil.disk_usage", lambda _place: type("Usage", (), {"free": 100 << 20})())
    tracemalloc.start()
    try:
        with pytest.raises(RefusedInputError):
            backups.read_backup(
                bomb, f"sqlite:///{tmp_path}/nowhere/own.sqlite3", FolderBlobStore(tmp_path / "nowhere" / "blobs")
            )
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 16 << 20
    assert not (tmp_path / "nowhere").exists()
