"""A folder of files that are named by the SHA-256 of their bytes: `ab/cd/abcd...`.

The name says what must be inside, so putting the same bytes twice is one file, and nothing is ever overwritten but a file
that is not what its name says. A file appears under its name complete or not at all: written beside, synced, renamed.

Nobody gets a file, its bytes or its document without the file having been held against its address (`boresight.disks`):
what does not fit is refused as corrupt, and told to whoever raises alarms. `check` reads it again when asked.
Bytes that no row refers to are harmless, so bytes are put before the row that names them is committed.
"""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import orjson
import sqlalchemy as sa

from boresight import disks as integrity
from boresight.disks import Opened, refuse_unwritable
from boresight.errors import CorruptFileError, NotFoundError, StorageError, UnavailableError
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.data_version import SizeLimitedCache
from boresight.platform.db.sessions import Session, utc_now

CHUNK_BYTES = 1 << 20
PARSED_BYTES = 64 << 20  # of JSON: twenty results of 100,000 frames; in memory some four times that


class BlobStore:
    """The folder of blobs; many threads and processes may use it at once."""

    kept_at: str | None = None  # the object store that holds what the folder may lack

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.tell_corrupt: Callable[[str], None] = lambda _sha256: None
        self._parsed: SizeLimitedCache[Any] = SizeLimitedCache(PARSED_BYTES)
        self._opened: Opened | None = None

    def put(self, content: bytes | Path) -> str:
        """Store bytes, or a copy of a file, and return their address."""
        with _opened(content) as source, self._writing():
            self._enter()
            digest = hashlib.sha256()
            handle, name = tempfile.mkstemp(prefix=".put-", dir=self.folder)
            try:
                with os.fdopen(handle, "wb") as file:
                    while chunk := source.read(CHUNK_BYTES):
                        digest.update(chunk)
                        file.write(chunk)
                    file.flush()
                    os.fsync(file.fileno())
                self._keep(Path(name), digest.hexdigest())
            finally:
                Path(name).unlink(missing_ok=True)
        return digest.hexdigest()

    def open(self, *, make: bool = True) -> None:
        """Take the folder for the one to use from now on, made where there is none; it is never made again.

        A folder that comes back is used again; another in its place, such as the empty one under a disk that is not
        mounted, is refused.
        """
        with self._writing():
            if make:
                self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._opened = Opened(self.folder)

    def _enter(self) -> None:
        """Refuse a folder other than the one that was opened; the first use opens it."""
        if self._opened is None:
            self.open()
        else:
            self._opened.refuse_another()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Say in one sentence that the folder cannot be written."""
        try:
            yield
        except OSError as error:
            raise StorageError(
                f"The folder of files {self.folder} cannot be written ({error.strerror or error}): let the server write there, "
                "make room on its disk, or name another by BORESIGHT_BLOBS."
            ) from error

    def refuse_unusable(self) -> None:
        """Refuse a folder that is not there any more, and write a file that is gone at once."""
        with self._writing():
            self._enter()
            with tempfile.TemporaryFile(dir=self.folder) as file:
                file.write(b"Boresight")
                file.flush()
        refuse_unwritable(self.folder / "file")

    def discard(self, sha256: str) -> None:
        """Remove what was put and that no row will name, for what belongs to it could not be put."""
        self._place(sha256).unlink(missing_ok=True)

    def send_ahead(self, *files: Path) -> None:
        """Bring files over the network before the transaction that puts them, which holds others up; here there is none."""

    def _keep(self, written: Path, sha256: str) -> None:
        """Give a complete file its address, in the place of a corrupt one too, and make the name itself survive a power cut."""
        location = self._place(sha256)
        if location.exists() and integrity.is_intact(location, sha256):
            return
        location.parent.mkdir(parents=True, exist_ok=True)
        written.replace(location)
        folder = os.open(location.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _place(self, sha256: str) -> Path:
        """Where the bytes of an address belong."""
        return self.folder / sha256[:2] / sha256[2:4] / sha256

    def path(self, sha256: str) -> Path:
        """Return the file of an address, which has its bytes, to be read only."""
        return self._checked(self._located(sha256), sha256)

    def _located(self, sha256: str) -> Path:
        """Return the file of an address, whatever is in it."""
        location = self._place(sha256)
        if not location.is_file():
            if self._opened is not None:
                self._opened.refuse_another()
            raise NotFoundError(
                f"The stored file {sha256[:12]} is missing from {self.folder}; restore it from a backup."
            )
        return location

    def _checked(self, location: Path, sha256: str, *, again: bool = False) -> Path:
        """Return a file that has the bytes of its address."""
        try:
            intact = integrity.is_intact(location, sha256, again=again)
        except OSError as error:
            raise UnavailableError(
                f"The stored file {sha256[:12]} in {self.folder} cannot be read ({error.strerror or error}): let the server "
                "read it, and look at the disk."
            ) from error
        if not intact:
            self.tell_corrupt(sha256)
            raise CorruptFileError(
                f"The stored file {sha256[:12]} was altered on the disk, so nothing is made of it; restore it in "
                f"{self.folder} from a backup.",
                sha256,
            )
        return location

    def check(self, sha256: str, *, again: bool) -> int:
        """Hold the bytes of an address against it; return how many they are."""
        return self._checked(self._located(sha256), sha256, again=again).stat().st_size

    def size(self, sha256: str) -> int:
        """Return how many bytes are kept of an address, whatever they are; refuses as `path` what is missing."""
        return self._located(sha256).stat().st_size

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


def _opened(content: bytes | Path) -> BinaryIO:
    """Open bytes, or a file, to be read piece by piece."""
    return io.BytesIO(content) if isinstance(content, bytes) else content.open("rb")


def register_blob(session: Session, blobs: BlobStore, sha256: str, media_type: str) -> Blob:
    """Return the row of stored bytes, made now when there is none; rows that refer to the bytes need it."""
    row = session.scalar(sa.select(Blob).where(Blob.sha256 == sha256))
    if row is None:
        row = Blob(sha256=sha256, size_bytes=blobs.size(sha256), media_type=media_type, created_utc=utc_now())
        session.add(row)
        session.flush()
    return row
