"""Blobs in an object store: a real S3 server in this process, fetched once, right or not at all, refusals in one sentence."""

import hashlib
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import obstore
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from obstore.store import MemoryStore, from_url

from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError, UnavailableError
from boresight.platform.blobs.bucket import KEPT_S, BucketBlobStore
from boresight.platform.blobs.locations import BlobLocation
from boresight.platform.blobs.opening import open_blobs
from boresight.settings import read_settings
from tests.object_store import SECRET, serving_s3
from tests.refusals import has_code

PLENTY = 10**9
Open = Callable[..., BucketBlobStore]


@pytest.fixture(scope="module")
def s3() -> Iterator[str]:
    with serving_s3("flight") as address:
        yield address


@pytest.fixture
def blobs(s3: str, tmp_path: Path) -> Open:
    assert s3

    def machine(name: str = "here", bucket: str = "flight", limit_bytes: int = PLENTY) -> BucketBlobStore:
        opened = open_blobs(BlobLocation(f"s3://{bucket}/blobs", tmp_path / name, limit_bytes))
        assert isinstance(opened, BucketBlobStore)
        return opened

    return machine


def _kept(folder: Path) -> set[str]:
    return {path.name for path in folder.rglob("*") if path.is_file()}


def test_what_one_machine_puts_another_reads(blobs: Open) -> None:
    sha256 = blobs("server").put(b"stars")
    assert sha256 == hashlib.sha256(b"stars").hexdigest()
    assert blobs("worker").path(sha256).read_bytes() == b"stars"
    bucket = from_url("s3://flight", client_options={"allow_http": True})
    assert obstore.get(bucket, f"blobs/{sha256[:2]}/{sha256[2:4]}/{sha256}").bytes() == b"stars"


def test_a_large_file_arrives_whole_in_parts(blobs: Open, tmp_path: Path) -> None:
    (tmp_path / "table").write_bytes(os.urandom(12 << 20))
    sha256 = blobs("server").put(tmp_path / "table")
    fetched = blobs("worker").path(sha256)
    assert hashlib.sha256(fetched.read_bytes()).hexdigest() == sha256


def test_putting_again_sends_nothing_and_a_fetched_file_is_not_fetched_again(
    blobs: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    server, worker = blobs("server"), blobs("worker")
    sha256 = server.put(b"once")
    worker.path(sha256)
    for name in ("put", "get"):
        monkeypatch.setattr(obstore, name, lambda *_: pytest.fail("it was there already"))
    assert server.put(b"once") == sha256
    assert worker.read(sha256) == b"once"


def test_what_was_sent_ahead_is_not_sent_while_others_wait(
    blobs: Open, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "table").write_bytes(b"stars")
    server = blobs("server")
    server.send_ahead(tmp_path / "table")
    monkeypatch.setattr(obstore, "put", lambda *_: pytest.fail("it was there already"))
    server.put(tmp_path / "table")


def test_a_document_is_parsed_once_though_its_file_is_marked_as_used(blobs: Open) -> None:
    server = blobs("server")
    sha256 = server.put(b'{"a":1}')
    assert server.document(sha256) is server.document(sha256)


def test_bytes_altered_in_the_bucket_are_refused_and_not_kept(blobs: Open) -> None:
    sha256 = blobs("server").put(b"as they were")
    bucket = from_url("s3://flight", client_options={"allow_http": True})
    obstore.put(bucket, f"blobs/{sha256[:2]}/{sha256[2:4]}/{sha256}", b"as they are!")
    worker = blobs("worker")
    with pytest.raises(ConflictError, match="s3://flight/blobs", check=has_code("altered-file")):
        worker.path(sha256)
    assert _kept(worker.folder) == set()


def test_what_is_missing_forbidden_or_out_of_reach_is_told_in_one_sentence(
    blobs: Open, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(NotFoundError, match=r"000000000000.*s3://flight/blobs", check=has_code("not-in-store")):
        blobs().path("0" * 64)
    with pytest.raises(NotFoundError, match="s3://nowhere/blobs", check=has_code("not-in-store")):
        blobs(bucket="nowhere").put(b"x")
    for raised, kind, says in (
        (obstore.exceptions.PermissionDeniedError(SECRET), ForbiddenError, "check the key"),
        (obstore.exceptions.UnauthenticatedError(SECRET), ForbiddenError, "check the key"),
        (obstore.exceptions.GenericError(SECRET), UnavailableError, "does not answer"),
    ):
        monkeypatch.setattr(obstore, "head", _raising(raised))
        with pytest.raises(kind, match=says) as told:
            blobs().put(b"y")
        assert SECRET not in str(told.value)
    assert SECRET not in caplog.text
    assert not _kept(tmp_path / "here")


def _raising(error: Exception) -> Callable[..., None]:
    def raise_it(*_: object) -> None:
        raise error

    return raise_it


def test_nobody_listening_is_told_within_seconds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("ENDPOINT_URL", "http://127.0.0.1:9"), ("ACCESS_KEY_ID", "k"), ("SECRET_ACCESS_KEY", "s")):
        monkeypatch.setenv(f"AWS_{name}", value)
    blobs, begun_s = open_blobs(BlobLocation("s3://closed/blobs", tmp_path, PLENTY)), time.monotonic()
    with pytest.raises(UnavailableError, match="s3://closed/blobs", check=has_code("store-unreachable")):
        blobs.put(b"x")
    assert time.monotonic() - begun_s < 30


def test_a_store_is_looked_at_quickly_whoever_is_there(
    blobs: Open, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blobs().refuse_unusable()
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    gone, begun_s = open_blobs(BlobLocation("s3://gone/blobs", tmp_path, PLENTY)), time.monotonic()
    with pytest.raises(UnavailableError, match="s3://gone/blobs", check=has_code("store-unreachable")):
        gone.refuse_unusable()
    assert time.monotonic() - begun_s < 4


def test_what_was_asked_for_longest_ago_goes_first_and_nothing_of_the_last_hour(blobs: Open) -> None:
    server = blobs("server")
    old, used, new = (server.put(bytes([n]) * 400) for n in range(3))
    worker = blobs("worker", limit_bytes=1000)
    long_ago_s = time.time() - 2 * KEPT_S
    for sha256 in (old, used):
        os.utime(worker.path(sha256), (long_ago_s, long_ago_s))
    worker.path(used)
    worker.path(new)
    assert _kept(worker.folder) == {used, new}
    worker.path(old)
    assert _kept(worker.folder) == {used, new, old}
    assert worker.read(old) == bytes([0]) * 400


@settings(max_examples=25)
@given(content=st.binary(max_size=5000))
def test_any_bytes_come_back_and_a_lost_cache_costs_nothing_but_time(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    folder, store = tmp_path_factory.mktemp("any"), MemoryStore()
    first, second = (BucketBlobStore(BlobLocation("memory:///", folder / name, PLENTY), store) for name in "ab")
    sha256 = first.put(content)
    assert second.read(sha256) == content
    second.path(sha256).unlink()
    assert second.read(sha256) == content


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("ftp://host/x", "names no place"),
        ("s3://", "names no place"),
        ("s3://key:secret@bucket/x", "must not contain credentials"),
        ("s3://bucket/x?secret=1", "must not contain credentials"),
    ],
)
def test_an_address_that_is_no_place_or_holds_a_password_is_refused_without_repeating_it(given: str, says: str) -> None:
    with pytest.raises(RefusedInputError, match=says) as told:
        _ = read_settings({"BORESIGHT_BLOBS": given}).blob_location
    assert "secret" not in str(told.value)


def test_a_folder_or_nothing_means_a_folder(tmp_path: Path) -> None:
    own = read_settings({"BORESIGHT_DATA_FOLDER": str(tmp_path)}).blob_location
    shared = read_settings({"BORESIGHT_BLOBS": f"{tmp_path}/x/../shared"}).blob_location
    assert (own.address, shared.address) == (f"{tmp_path}/blobs", f"{tmp_path}/shared")
    assert open_blobs(shared).folder == tmp_path / "shared"
    assert open_blobs(shared).kept_at is None
