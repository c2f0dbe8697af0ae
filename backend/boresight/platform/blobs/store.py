"""The interface of a blob store, which keeps files under the SHA-256 of their bytes, in a folder or a bucket."""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import orjson
import sqlalchemy as sa

from boresight.errors import NotFoundError
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.data_version import SizeLimitedCache
from boresight.platform.db.sessions import Session, utc_now

CHUNK_BYTES = 1 << 20
CONVERTED = "converted"  # folder of tables that were converted from an older form
PARSED_BYTES = 64 << 20  # of JSON: twenty results of 100,000 frames; in memory some four times that


class BlobStore(ABC):
    """Files by their addresses; many threads and processes may use it at once."""

    kept_at: str | None = None  # the object store behind the cache folder

    def __init__(self, folder: Path) -> None:
        self.folder = folder  # on this machine: all files, or those used recently
        self.tell_corrupt: Callable[[str], None] = lambda _sha256: None
        self.find_removed: Callable[[str], str | None] = lambda _sha256: None  # when a file was removed on purpose
        self._parsed: SizeLimitedCache[Any] = SizeLimitedCache(PARSED_BYTES)

    @abstractmethod
    def open(self, *, make: bool = True) -> None:
        """Open the folder, created where there is none."""

    @abstractmethod
    def refuse_unusable(self) -> None:
        """Refuse a store that cannot be written or does not answer."""

    @abstractmethod
    def put(self, content: bytes | Path) -> str:
        """Store bytes, or a copy of a file, and return their address."""

    @abstractmethod
    def send_ahead(self, *files: Path) -> None:
        """Send files over the network before the transaction that stores them, to keep it short."""

    @abstractmethod
    def discard(self, sha256: str) -> None:
        """Remove a stored file that no row will name, because a related file could not be stored."""

    @abstractmethod
    def remove(self, sha256: str) -> None:
        """Remove a file on purpose, from everywhere; one that is gone already is no error."""

    def refuse_removed(self, sha256: str) -> None:
        """Refuse a file that is missing because it was removed on purpose."""
        removed_utc = self.find_removed(sha256)
        if removed_utc is not None:
            raise NotFoundError(
                f"The file {sha256[:12]} was removed on {removed_utc[:10]} under the retention policy; results computed from it "
                "are kept. Upload it again to use it.",
                code="removed-by-retention",
            )

    @abstractmethod
    def path(self, sha256: str) -> Path:
        """Return a read-only file with the bytes of an address."""

    @abstractmethod
    def check(self, sha256: str, *, again: bool) -> int:
        """Check a file against its address and return its size."""

    @abstractmethod
    def size(self, sha256: str) -> int:
        """Return the size of an address's file without checking it; refuses a missing one as `path` does."""

    def read(self, sha256: str) -> bytes:
        """Return the bytes of an address; refuses as `path` does."""
        return self.path(sha256).read_bytes()

    def document(self, sha256: str) -> Any:
        """Return a JSON document, parsed once and cached while recently used; callers must not change it.

        Refuses as `path` does. A file that was altered on the disk is checked again.
        """
        location = self.path(sha256)
        written = location.stat()

        def parse() -> tuple[Any, int]:
            return orjson.loads(location.read_bytes()), written.st_size

        return self._parsed.get((sha256, written.st_mtime_ns, written.st_size), parse)


def open_content(content: bytes | Path) -> BinaryIO:
    """Open bytes, or a file, to be read piece by piece."""
    return io.BytesIO(content) if isinstance(content, bytes) else content.open("rb")


@contextmanager
def written_beside(source: BinaryIO, folder: Path) -> Iterator[tuple[Path, str]]:
    """Write what is read to a temporary file; yields the file, to be renamed, and its address."""
    digest = hashlib.sha256()
    handle, name = tempfile.mkstemp(prefix=".put-", dir=folder)
    try:
        with os.fdopen(handle, "wb") as file:
            while chunk := source.read(CHUNK_BYTES):
                digest.update(chunk)
                file.write(chunk)
            file.flush()
            os.fsync(file.fileno())
        yield Path(name), digest.hexdigest()
    finally:
        Path(name).unlink(missing_ok=True)


def register_blob(
    session: Session, blobs: BlobStore, sha256: str, media_type: str, size_bytes: int | None = None
) -> Blob:
    """Return the row of a blob, created if needed, for rows that refer to it; of what a dry run did not store, by its size."""
    row = session.scalar(sa.select(Blob).where(Blob.sha256 == sha256))
    if row is None:
        row = Blob(
            sha256=sha256,
            size_bytes=blobs.size(sha256) if size_bytes is None else size_bytes,
            media_type=media_type,
            created_utc=utc_now(),
        )
        session.add(row)
        session.flush()
    elif row.removed_utc is not None:
        blobs.size(sha256)  # refuses bytes that were removed again meanwhile
        row.removed_utc = None
    return row
