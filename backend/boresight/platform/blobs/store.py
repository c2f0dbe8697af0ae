"""Where files are kept under the SHA-256 of their bytes: what every store of them does, in a folder or in a bucket."""

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

from boresight.platform.blobs.tables import Blob
from boresight.platform.db.data_version import SizeLimitedCache
from boresight.platform.db.sessions import Session, utc_now

CHUNK_BYTES = 1 << 20
PARSED_BYTES = 64 << 20  # of JSON: twenty results of 100,000 frames; in memory some four times that


class BlobStore(ABC):
    """Files by their addresses; many threads and processes may use it at once."""

    kept_at: str | None = None  # the object store that holds what the folder may lack

    def __init__(self, folder: Path) -> None:
        self.folder = folder  # of this machine: all files, or those used lately
        self.tell_corrupt: Callable[[str], None] = lambda _sha256: None
        self._parsed: SizeLimitedCache[Any] = SizeLimitedCache(PARSED_BYTES)

    @abstractmethod
    def open(self, *, make: bool = True) -> None:
        """Take the folder for the one to use from now on, made where there is none."""

    @abstractmethod
    def refuse_unusable(self) -> None:
        """Refuse a place that cannot be written, or does not answer."""

    @abstractmethod
    def put(self, content: bytes | Path) -> str:
        """Store bytes, or a copy of a file, and return their address."""

    @abstractmethod
    def send_ahead(self, *files: Path) -> None:
        """Bring files over the network before the transaction that puts them, which holds others up."""

    @abstractmethod
    def discard(self, sha256: str) -> None:
        """Remove what was put and that no row will name, for what belongs to it could not be put."""

    @abstractmethod
    def path(self, sha256: str) -> Path:
        """Return a file with the bytes of an address, to be read only."""

    @abstractmethod
    def check(self, sha256: str, *, again: bool) -> int:
        """Hold the bytes of an address against it; return how many they are."""

    @abstractmethod
    def size(self, sha256: str) -> int:
        """Return how many bytes are kept of an address, whatever they are; refuses as `path` what is missing."""

    def read(self, sha256: str) -> bytes:
        """Return the bytes of an address; refuses as `path`."""
        return self.path(sha256).read_bytes()

    def document(self, sha256: str) -> Any:
        """Return a JSON document, parsed once for all who ask while it is among the recent ones: nobody may change it.

        Refuses as `path`. A file that was altered on the disk is held against its address anew.
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
    """Write what is read to the disk under a passing name; gives the file, to be renamed, and its address."""
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


def register_blob(session: Session, blobs: BlobStore, sha256: str, media_type: str) -> Blob:
    """Return the row of stored bytes, made now when there is none; rows that refer to the bytes need it."""
    row = session.scalar(sa.select(Blob).where(Blob.sha256 == sha256))
    if row is None:
        row = Blob(sha256=sha256, size_bytes=blobs.size(sha256), media_type=media_type, created_utc=utc_now())
        session.add(row)
        session.flush()
    return row
