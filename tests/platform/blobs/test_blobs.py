"""Files under the hash of their bytes: stored once, read whole, an altered one refused, the newest kept in memory."""

import hashlib
import os
import random
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest import mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight import disks as integrity
from boresight.disks import compute_digest
from boresight.errors import ConflictError, CorruptFileError, NotFoundError, UnavailableError
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.blobs.working_tables import table_path, working_table
from boresight.platform.db.data_version import LARGEST_SHARE, SizeLimitedCache
from boresight.platform.db.sessions import Engine, open_writing
from boresight.telemetry.read.limits import STORED
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.working_table import WorkingTable
from boresight.telemetry.writing import write_parquet
from tests.refusals import has_code
from tests.telemetry.test_working_table import assert_same_bits, full
from tests.working_tables import write_working_table


@pytest.fixture
def blobs(tmp_path: Path) -> BlobStore:
    return FolderBlobStore(tmp_path / "blobs")


def _files(blobs: BlobStore) -> list[Path]:
    return [path for path in blobs.folder.rglob("*") if path.is_file()]


@given(content=st.binary(max_size=2000))
def test_what_is_put_is_read_back_under_its_hash(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        blobs = FolderBlobStore(Path(folder))
        assert blobs.put(content) == hashlib.sha256(content).hexdigest()
        assert blobs.read(blobs.put(content)) == content
        assert len(_files(blobs)) == 1


def test_a_file_is_kept_in_folders_by_its_address(blobs: BlobStore) -> None:
    sha256 = blobs.put(b"stars")
    assert blobs.path(sha256) == blobs.folder / sha256[:2] / sha256[2:4] / sha256


def test_a_file_and_its_bytes_have_one_address(blobs: BlobStore, tmp_path: Path) -> None:
    content = bytes(range(256)) * 10000  # more than one chunk
    (tmp_path / "file").write_bytes(content)
    assert blobs.put(tmp_path / "file") == blobs.put(content)
    assert (tmp_path / "file").read_bytes() == content


def test_many_at_once_put_one_file_and_leave_no_scraps(blobs: BlobStore) -> None:
    contents = [bytes([number]) * 100000 for number in range(4)] * 8
    with ThreadPoolExecutor(8) as pool:
        addresses = set(pool.map(blobs.put, contents))
    assert {path.name for path in _files(blobs)} == addresses
    assert all(blobs.read(address) for address in addresses)


def test_putting_again_does_not_touch_the_file(blobs: BlobStore) -> None:
    path = blobs.path(blobs.put(b"stars"))
    before = path.stat()
    blobs.put(b"stars")
    assert (path.stat().st_ino, path.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


def test_a_put_that_fails_leaves_no_scraps(blobs: BlobStore, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        blobs.put(tmp_path / "absent")
    assert _files(blobs) == []


def test_bytes_altered_on_the_disk_are_found(blobs: BlobStore) -> None:
    sha256 = blobs.put(b"stars")
    blobs.path(sha256).write_bytes(b"spurs")
    with pytest.raises(ConflictError, match="altered"):
        blobs.read(sha256)


def test_missing_bytes_are_told_with_what_to_do(blobs: BlobStore) -> None:
    with pytest.raises(NotFoundError, match="backup"):
        blobs.read("0" * 64)


def test_a_row_is_made_once_for_the_same_bytes(blobs: BlobStore, engine: Engine) -> None:
    sha256 = blobs.put(b"stars")
    with open_writing(engine) as session:
        first = register_blob(session, blobs, sha256, "text/csv")
        assert register_blob(session, blobs, sha256, "text/csv") is first
    assert (first.size_bytes, first.media_type) == (5, "text/csv")


@pytest.mark.parametrize("act", [lambda blobs: blobs.put(b"stars"), lambda blobs: blobs.refuse_unusable()])
def test_a_folder_that_cannot_be_made_is_refused_in_a_sentence_that_names_it(
    tmp_path: Path, act: Callable[[BlobStore], object]
) -> None:
    (tmp_path / "file").touch()
    folder = tmp_path / "file" / "blobs"
    with pytest.raises(UnavailableError, match=f" {folder} ", check=has_code("folder-not-writable")):
        act(FolderBlobStore(folder))


def test_looking_at_the_folder_leaves_nothing_behind(blobs: BlobStore) -> None:
    blobs.refuse_unusable()
    assert blobs.folder.is_dir()
    assert list(blobs.folder.iterdir()) == []


@given(st.lists(st.tuples(st.integers(0, 8), st.integers(1, 60)), max_size=60))
def test_no_more_is_held_than_the_limit_and_every_answer_is_right(asked):
    recent, sizes = SizeLimitedCache(100), dict(reversed(asked))
    for key, _ in asked:
        assert recent.get(key, lambda key=key: (f"value {key}", sizes[key])) == f"value {key}"
        assert 0 <= recent.held_bytes <= 100


def test_what_was_used_last_stays_and_the_oldest_goes():
    recent, made = SizeLimitedCache(100), []

    def make(key):
        made.append(key)
        return key, 100 // LARGEST_SHARE

    for key in ("a", "b", "c", "d", "a", "e", "a", "b"):
        recent.get(key, lambda key=key: make(key))
    assert made == ["a", "b", "c", "d", "e", "b"]


def test_what_is_too_large_is_made_each_time_and_pushes_nothing_out():
    recent, made = SizeLimitedCache(100), []
    recent.get("small", lambda: ("small", 10))
    for _ in range(2):
        recent.get("large", lambda: (made.append(1), 99))
    recent.get("small", lambda: pytest.fail("it was pushed out"))
    assert len(made) == 2


def test_a_document_is_parsed_once(tmp_path):
    blobs = FolderBlobStore(tmp_path)
    sha256 = blobs.put(b'{"a": 1}')
    assert blobs.document(sha256) == {"a": 1}
    assert blobs.document(sha256) is blobs.document(sha256)


def test_a_document_that_was_altered_or_removed_is_not_answered_from_memory(tmp_path):
    blobs = FolderBlobStore(tmp_path)
    sha256 = blobs.put(b'{"a": 1}')
    blobs.document(sha256)
    blobs.path(sha256).write_bytes(b'{"a": 22}')
    with pytest.raises(CorruptFileError):
        blobs.document(sha256)
    (tmp_path / sha256[:2] / sha256[2:4] / sha256).unlink()
    with pytest.raises(NotFoundError):
        blobs.document(sha256)


@pytest.fixture
def before(blobs, tmp_path):
    """The address of a set that was stored as Parquet."""
    write_parquet(full(), tmp_path / "before.parquet")
    return blobs.put(tmp_path / "before.parquet")


def test_a_set_stored_before_has_the_arrays_that_runs_made_of_it(blobs, before):
    path, sha256 = working_table(blobs, before)

    assert compute_digest(path) == sha256 != before
    assert_same_bits(WorkingTable(path, sha256).read(), read_telemetry(blobs.path(before), "t.parquet", STORED))


def test_it_is_converted_once_and_its_address_stays(blobs, before):
    first = table_path(blobs, before)
    with mock.patch("boresight.platform.blobs.working_tables.read_chunks", side_effect=AssertionError):
        assert table_path(blobs, before) == first
    assert blobs.path(before).read_bytes()[:4] == b"PAR1"


def test_a_converted_table_that_was_altered_is_made_again(blobs, before):
    path = table_path(blobs, before)
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + b"x")

    assert table_path(blobs, before).read_bytes() == whole


def test_a_set_stored_as_a_mapped_table_is_that_file(blobs, tmp_path):
    write_working_table(full(), tmp_path / "table")
    sha256 = blobs.put(tmp_path / "table")

    assert working_table(blobs, sha256) == (blobs.path(sha256), sha256)


def _rest(path: Path) -> None:
    while time.time_ns() - path.stat().st_ctime_ns < integrity.FRESH_NS:
        time.sleep(0.005)


def _flip(path: Path, bit: int) -> None:
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


@pytest.mark.parametrize("reader", ["path", "read", "document"])
@pytest.mark.parametrize("known", [False, True])
def test_no_reader_gives_out_a_file_with_a_flipped_bit(blobs: BlobStore, reader: str, *, known: bool) -> None:
    sha256 = blobs.put(b'{"f_m":0.016}')
    place, told = blobs.path(sha256), []
    if known:  # read, and remembered as intact
        _rest(place)
        blobs.document(sha256)
    _flip(place, 60)
    blobs.tell_corrupt = told.append
    with pytest.raises(CorruptFileError) as refused:
        getattr(blobs, reader)(sha256)
    assert (refused.value.sha256, told) == (sha256, [sha256])


def test_a_bit_flipped_at_the_same_size_and_time_is_noticed(blobs: BlobStore) -> None:
    sha256 = blobs.put(b"stars")
    place = blobs.path(sha256)
    _rest(place)
    blobs.path(sha256)
    before = place.stat()
    _flip(place, 3)
    os.utime(place, ns=(before.st_atime_ns, before.st_mtime_ns))
    with pytest.raises(CorruptFileError):
        blobs.path(sha256)


def test_a_file_is_hashed_once_a_process(blobs: BlobStore, monkeypatch: pytest.MonkeyPatch) -> None:
    sha256 = blobs.put(b"stars")
    _rest(blobs.path(sha256))
    blobs.path(sha256)
    monkeypatch.setattr(integrity, "compute_digest", lambda _: pytest.fail("it was hashed again"))
    for _ in range(3):
        assert blobs.read(sha256) == b"stars"
    again = FolderBlobStore(blobs.folder)
    assert again.read(sha256) == b"stars"


def test_verifying_reads_a_file_again_whatever_is_known_of_it(
    blobs: BlobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    sha256 = blobs.put(b"stars")
    _rest(blobs.path(sha256))
    blobs.path(sha256)
    monkeypatch.setattr(integrity, "compute_digest", lambda _: "0" * 64)  # as a disk that fails below the file system
    assert blobs.path(sha256)
    with pytest.raises(CorruptFileError):
        blobs.check(sha256, again=True)


def test_putting_the_bytes_again_mends_a_corrupt_file(blobs: BlobStore) -> None:
    sha256 = blobs.put(b"stars")
    _flip(blobs.path(sha256), 0)
    assert blobs.put(b"stars") == sha256
    assert blobs.read(sha256) == b"stars"


def test_twenty_flips_in_files_of_any_size_are_all_noticed(blobs: BlobStore) -> None:
    dice = random.Random(20)  # noqa: S311 - the same flips every time
    for _ in range(20):
        sha256 = blobs.put(dice.randbytes(dice.choice([1, 100, 70_000, 3 << 20])))
        place = blobs.path(sha256)
        _flip(place, dice.randrange(8 * place.stat().st_size))
        with pytest.raises(CorruptFileError):
            blobs.path(sha256)


def test_only_the_store_knows_where_a_file_of_an_address_lies() -> None:
    sources = Path(integrity.__file__).parent
    known = {"platform/blobs/folder.py", "platform/blobs/bucket.py"}
    readers = {
        str(path.relative_to(sources))
        for path in sources.rglob("*.py")
        if ".locate(" in path.read_text(encoding="utf-8") or "._located(" in path.read_text(encoding="utf-8")
    }
    assert readers == known
