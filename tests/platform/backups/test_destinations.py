"""Places for backups: a file is there whole or not at all, is read from any place, and no other is touched."""

import io
from collections.abc import Iterator
from pathlib import Path

import pytest

from boresight.errors import ConflictError, NotFoundError, RefusedInputError, StorageError
from boresight.platform.backups.destinations import Destination, open_destination
from tests.object_store import serving_s3

CONTENT = bytes(range(256)) * 1000


@pytest.fixture(params=["folder", "bucket"])
def destination(request, tmp_path) -> Iterator[Destination]:
    if request.param == "folder":
        (tmp_path / "there").mkdir()
        yield open_destination(str(tmp_path / "there"), tmp_path)
        return
    with serving_s3("backups"):
        yield open_destination("s3://backups/of/us", tmp_path)


def test_what_is_written_is_read_and_removed(destination, tmp_path):
    destination.refuse_unusable()
    assert destination.write("a", lambda place: place.write_bytes(CONTENT) and None) == len(CONTENT)
    with destination.open("a") as file:
        assert file.seek(-10, io.SEEK_END) == len(CONTENT) - 10
        assert file.read() == CONTENT[-10:]
        file.seek(1000)
        assert file.read(5) == CONTENT[1000:1005]
    destination.remove("a")
    destination.remove("a")
    with pytest.raises(NotFoundError):
        destination.open("a")
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_what_failed_leaves_nothing(destination, tmp_path):
    def fail(place: Path) -> None:
        place.write_bytes(b"half")
        raise ConflictError("stopped")

    with pytest.raises(ConflictError):
        destination.write("a", fail)
    with pytest.raises(NotFoundError):
        destination.open("a")
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_folder_is_neither_made_nor_written_over(tmp_path):
    with pytest.raises(StorageError):
        open_destination(str(tmp_path / "unmounted"), tmp_path).write(
            "a", lambda place: place.write_bytes(b"") and None
        )
    (tmp_path / "a").write_bytes(b"before")
    with pytest.raises(ConflictError):
        open_destination(str(tmp_path), tmp_path).write("a", lambda place: place.write_bytes(b"after") and None)
    assert (tmp_path / "a").read_bytes() == b"before"


def test_an_address_with_a_password_is_refused(tmp_path):
    with pytest.raises(RefusedInputError):
        open_destination("s3://key:secret@bucket", tmp_path)
