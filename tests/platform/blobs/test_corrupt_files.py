"""A stored file is held against its address by whoever reads it, and a changed one is refused, never used."""

import os
import random
import time
from pathlib import Path

import pytest

from boresight import disks as integrity
from boresight.errors import CorruptFileError
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.store import BlobStore


@pytest.fixture
def blobs(tmp_path: Path) -> BlobStore:
    return FolderBlobStore(tmp_path / "blobs")


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
        if ".place_of(" in path.read_text(encoding="utf-8") or "._located(" in path.read_text(encoding="utf-8")
    }
    assert readers == known
