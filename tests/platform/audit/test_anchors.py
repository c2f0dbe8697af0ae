"""Signed heads: what anchors cover, who signed them, and that every change of log or anchor is found, with a stamp and without."""

import base64
import hashlib
import json
import stat
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from boresight.errors import ConflictError, RefusedInputError, UnavailableError
from boresight.platform.actors import SYSTEM, Policy
from boresight.platform.audit import audit_verifier
from boresight.platform.audit import log as audit
from boresight.platform.audit import queries as rows
from boresight.platform.audit.anchors import TrustedKeys, keep_time_stamp, make_anchor, spell_statement
from boresight.platform.audit.export import write_export
from boresight.platform.audit.log import ChainReport
from boresight.platform.audit.signing import PublicKey, SigningKey, read_public_keys
from boresight.platform.audit.tables import AuditAnchor
from boresight.platform.audit.time_stamps import TimeStampService, read_certificates, read_time_stamp
from boresight.platform.db.documents import canonical
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from boresight.platform.db.times import seconds_between, utc_now
from tests.refusals import has_code
from tests.stores import drop_triggers
from tests.time_stamps import StandIn, time_stamp_service


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest) -> Engine:
    store: Engine = request.getfixturevalue(request.param)
    return store


@pytest.fixture
def key(tmp_path: Path) -> SigningKey:
    return SigningKey(tmp_path / "keys" / "signing.key")


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StandIn]:
    with time_stamp_service(tmp_path_factory.mktemp("tsa")) as stand_in:
        yield stand_in


def _service(stand_in: StandIn) -> TimeStampService:
    return TimeStampService(stand_in.url, read_certificates(stand_in.authority.read_bytes(), stand_in.authority))


def _append(store: Engine, count: int = 1) -> None:
    with open_writing(store) as session:
        for number in range(count):
            audit.append(session, SYSTEM, "counted", f"numbers/{number}")


def _anchor(store: Engine, key: SigningKey) -> AuditAnchor:
    with open_writing(store) as session:
        return make_anchor(session, key, "Boresight")


def _trust(key: SigningKey, **more: object) -> TrustedKeys:
    return replace(TrustedKeys(key.list_public_keys(), key.name), **more)  # type: ignore[arg-type]


def _verify(store: Engine, trust: TrustedKeys) -> ChainReport:
    with open_reading(store) as session:
        return audit.verify(session, trust=trust)


def _by_hand(store: Engine, *statements: str) -> None:
    with store.begin() as connection:
        drop_triggers(connection)
        for statement in statements:
            connection.exec_driver_sql(statement)


def test_an_anchor_covers_the_log_up_to_its_record_and_one_head_is_signed_once(store, key):
    with open_writing(store) as session, pytest.raises(ConflictError, match="empty"):
        make_anchor(session, key, "Boresight")
    _append(store, 3)
    first = _anchor(store, key)
    assert _anchor(store, key).id == first.id
    _append(store, 2)
    report = _verify(store, _trust(key))
    assert (report.ok, report.anchors, report.anchored_id, report.time_stamped) == (True, 1, first.record_id, 0)
    second = _anchor(store, key)
    report = _verify(store, _trust(key))
    assert (second.record_id - first.record_id, report.anchors, report.anchored_id) == (2, 2, second.record_id)


def test_anybody_verifies_an_anchor_with_its_public_key_and_ed25519_alone(store, key):
    _append(store)
    anchor = _anchor(store, key)
    (pem,) = (one.pem for one in key.list_public_keys())
    public = serialization.load_pem_public_key(pem.encode())
    assert isinstance(public, Ed25519PublicKey)
    statement = (
        f'{{"at_utc":"{anchor.at_utc}","head":"{anchor.head}","key":"{key.list_public_keys()[0].id}",'
        f'"made_by":"Boresight","record":{anchor.record_id},"schema":"boresight.audit-anchor/1"}}'
    )
    public.verify(base64.b64decode(anchor.signature), statement.encode())


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("UPDATE audit_anchors SET at_utc = '2020-01-01T00:00:00.000000Z' WHERE id = 1", "was changed"),
        ("UPDATE audit_anchors SET record_id = record_id - 1 WHERE id = 1", "was changed"),
        ("UPDATE audit_anchors SET made_by = 'Eve' WHERE id = 1", "was changed"),
        ("DELETE FROM audit WHERE id >= 3", "does not match the chain"),
    ],
)
def test_a_changed_anchor_and_a_log_that_lost_its_anchored_records_are_found(store, key, statement, words):
    _append(store, 5)
    _anchor(store, key)
    _by_hand(store, statement)
    report = _verify(store, _trust(key))
    assert not report.ok
    assert words in report.sentence


def test_a_chain_that_its_owner_rebuilt_whole_verifies_alone_and_not_against_its_anchors(store, key):
    _append(store, 4)
    _anchor(store, key)
    with open_reading(store) as session:
        forged = [dict(record) for record in rows.walk(session)]
    with store.begin() as connection:
        drop_triggers(connection)
        connection.exec_driver_sql("DELETE FROM audit WHERE id >= 2")
    _append(store, len(forged) - 1)  # as well chained as the ones before, and at another time
    with open_reading(store) as session:
        assert audit.verify(session).first_broken_id is None
    report = _verify(store, _trust(key))
    assert (report.ok, report.first_broken_id) == (False, None)
    assert "rewritten" in report.sentence


@pytest.fixture
def exported(store, key, tmp_path):
    """The folder of an unpacked export whose third record is signed, with the public keys that were kept."""
    _append(store, 3)
    _anchor(store, key)
    _append(store, 2)
    with open_reading(store) as session, (tmp_path / "log.zip").open("wb") as stream:
        write_export(session, stream, "zip", Policy())
    with zipfile.ZipFile(tmp_path / "log.zip") as archive:
        archive.extractall(tmp_path / "log")
    (tmp_path / "log" / "kept.pem").write_text("".join(one.pem for one in key.list_public_keys()))
    return tmp_path / "log"


def _verified_elsewhere(folder: Path, keys: str = "kept.pem") -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable,
        "-I",
        "verify_audit.py",
        "audit.jsonl",
        "--anchors",
        "anchors.jsonl",
        "--public-keys",
        keys,
    ]
    return subprocess.run(command, cwd=folder, env={}, capture_output=True, text=True, check=False)


def test_an_export_has_its_anchors_and_verifies_against_keys_that_were_kept(exported):
    found = _verified_elsewhere(exported)
    assert (found.returncode, "1 heads" in found.stdout) == (0, True), found.stderr
    SigningKey(exported / "other.key").load()
    other = read_public_keys("".join(one.pem for one in SigningKey(exported / "other.key").list_public_keys()), "x")
    (exported / "other.pem").write_text(other[0].pem)
    assert _verified_elsewhere(exported, "other.pem").returncode == 1
    (exported / "anchors.jsonl").write_bytes(b"")
    assert _verified_elsewhere(exported).returncode == 1  # whoever rewrites the log can leave its anchors out


def _rehashed(folder: Path, changed: int, count: int) -> None:
    """Rewrite the export as whoever owns the database could: one record changed, all chained again, the last line right."""
    lines = (folder / "audit.jsonl").read_bytes().splitlines()
    records, last = [json.loads(line) for line in lines[:count]], json.loads(lines[-1])
    previous = audit_verifier.FIRST_HASH
    for number, record in enumerate(records):
        record["reason"] = "forged" if number == changed else record["reason"]
        record["previous_hash"] = previous
        record["hash"] = previous = audit_verifier.compute_hash(previous, record)
    body = b"".join(f"{canonical(record)}\n".encode() for record in records)
    del last["sha256"]
    last |= {"records": count, "head": previous}
    last["sha256"] = hashlib.sha256(body + canonical(last).encode()).hexdigest()
    (folder / "audit.jsonl").write_bytes(body + f"{canonical(last)}\n".encode())


@pytest.mark.few(4)
@pytest.mark.parametrize(("changed", "count", "is_found"), [(0, 5, True), (2, 5, True), (3, 5, False), (9, 2, True)])
def test_an_export_that_was_rewritten_or_cut_before_its_anchor_is_found_elsewhere(exported, changed, count, is_found):
    assert len((exported / "audit.jsonl").read_bytes().splitlines()) == 6
    _rehashed(exported, changed, count)
    with (exported / "audit.jsonl").open("rb") as export:
        assert audit_verifier.verify(export)[0]  # the chain alone does not show it
    assert (_verified_elsewhere(exported).returncode == 1) == is_found


def test_an_anchor_that_was_removed_is_missed_by_the_next_record(store, key):
    _append(store)
    _anchor(store, key)
    _append(store)
    _anchor(store, key)
    _append(store)
    _by_hand(store, "DELETE FROM audit_anchors WHERE id = 1")
    report = _verify(store, _trust(key))
    assert (report.ok, report.first_broken_row) == (False, "audit_anchors/1")


def test_after_a_rotation_old_anchors_verify_by_the_public_half_and_the_new_key_signs(store, key):
    _append(store)
    first = _anchor(store, key)
    new = key.rotate()
    second = _anchor(store, key)  # the same head under the new key
    assert PublicKey.decode(second.public_key) == new
    assert (second.head, second.public_key != first.public_key) == (first.head, True)
    assert [one.id for one in key.list_public_keys()] == [new.id, PublicKey.decode(first.public_key).id]
    assert key.file.read_text().count("PRIVATE KEY") == 2  # begin and end of one
    assert _verify(store, _trust(key)).ok


def test_a_key_that_is_not_trusted_is_named_and_trusted_again_once_its_public_half_is_back(store, key, tmp_path):
    _append(store)
    lost = PublicKey.decode(_anchor(store, key).public_key)
    other = SigningKey(tmp_path / "other.key")
    other.load()
    report = _verify(store, _trust(other))
    assert not report.ok
    assert lost.id in report.sentence
    other.trust(lost)
    assert _verify(store, _trust(other)).ok
    assert read_public_keys(lost.pem, "x") == (lost,)


def test_the_key_is_made_once_for_its_owner_alone_and_refused_where_others_can_read_it(key):
    first = key.load().public
    assert stat.S_IMODE(key.file.stat().st_mode) == 0o600
    assert SigningKey(key.file).load().public == first
    key.file.chmod(0o640)
    with pytest.raises(RefusedInputError, match="chmod 600"):
        key.load()
    text = SigningKey(_read(key.file))
    assert text.load().public == first
    with pytest.raises(RefusedInputError, match="setting"):
        text.rotate()


def _read(file: Path) -> str:
    return file.read_text()


@pytest.mark.parametrize("text", ["", "no key", "-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n"])
def test_a_file_without_a_usable_key_is_refused_and_left_as_it_is(key, text):
    key.file.parent.mkdir()
    key.file.write_text(text)
    key.file.chmod(0o600)
    for act in (key.load, key.rotate, key.list_public_keys):
        with pytest.raises(RefusedInputError, check=has_code("unusable-key")):
            act()
    assert key.file.read_text() == text


def test_a_public_key_of_another_kind_is_refused():
    public = rsa.generate_private_key(65537, 2048).public_key()
    pem = public.public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo).decode()
    for text, words in ((pem, "not Ed25519"), ("", "no public key")):
        with pytest.raises(RefusedInputError, match=words):
            read_public_keys(text, "keys.pem")


def test_a_stamp_is_of_the_signature_and_verifies_against_the_authority(store, key, service):
    _append(store)
    anchor = _anchor(store, key)
    stamp = _service(service).stamp(anchor.signature.encode())
    assert abs(seconds_between(stamp.at_utc, utc_now())) < 10
    with open_writing(store) as session:
        keep_time_stamp(session, anchor.id, stamp)
    _append(store)
    authorities = _service(service).authorities
    report = _verify(store, _trust(key, authorities=authorities))
    assert (report.ok, report.anchors, report.time_stamped) == (True, 1, 1)
    assert read_time_stamp(stamp.text, b"another content", authorities) is None
    _by_hand(store, "UPDATE audit_anchors SET stamped_utc = '2020-01-01T00:00:00.000000Z'")
    report = _verify(store, _trust(key, authorities=authorities))
    assert not report.ok


def test_a_stamp_of_another_authority_or_none_at_all_is_refused(service, tmp_path):
    content = b"signature"
    with time_stamp_service(tmp_path / "other") as other:
        mixed = TimeStampService(other.url, _service(service).authorities)
        with pytest.raises(UnavailableError, check=has_code("invalid-time-stamp")):
            mixed.stamp(content)
        kept = base64.b64decode(_service(other).stamp(content).text)
        for instead in (b"", b"<html>", kept, kept[:-1], bytes(1 << 17)):  # kept: of another nonce
            other.instead = instead
            with pytest.raises(UnavailableError, check=has_code("invalid-time-stamp")):
                _service(other).stamp(content)
    with pytest.raises(UnavailableError, check=has_code("no-answer")):
        _service(other).stamp(content)
    with pytest.raises(RefusedInputError, match="no certificate"):
        read_certificates(b"", "x")


def test_the_newest_anchors_alone_are_verified_where_that_is_asked_for(store, key):
    for _ in range(3):
        _append(store)
        anchor = _anchor(store, key)
    report = _verify(store, _trust(key, newest=2))
    assert (report.anchors, report.anchored_id) == (2, anchor.record_id)


def test_the_statement_is_what_is_signed_whatever_became_of_the_row(store, key):
    _append(store)
    anchor = _anchor(store, key)
    assert PublicKey.decode(anchor.public_key).verifies(anchor.signature, spell_statement(anchor))
    anchor.head = "0" * 64
    assert not PublicKey.decode(anchor.public_key).verifies(anchor.signature, spell_statement(anchor))
