"""What was used last is kept within its limit, and a document that changed on the disk is read anew."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import CorruptFileError, NotFoundError
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.db.data_version import LARGEST_SHARE, SizeLimitedCache


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
