"""Blobs: named by what is in them, whole or absent, whoever puts them at once."""

import hashlib
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import ConflictError, NotFoundError, UnavailableError
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.sessions import Engine, open_writing


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
    with pytest.raises(UnavailableError, match=f"^The folder of files {folder} cannot be written"):
        act(FolderBlobStore(folder))


def test_looking_at_the_folder_leaves_nothing_behind(blobs: BlobStore) -> None:
    blobs.refuse_unusable()
    assert blobs.folder.is_dir()
    assert list(blobs.folder.iterdir()) == []
