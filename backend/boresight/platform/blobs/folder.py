"""Blobs in a folder, named by the SHA-256 of their bytes: `ab/cd/abcd...`."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from boresight import disks as integrity
from boresight.disks import Opened, refuse_unwritable
from boresight.errors import CorruptFileError, NotFoundError, StorageError, UnavailableError
from boresight.platform.blobs.store import CONVERTED, BlobStore, open_content, written_beside


class FolderBlobStore(BlobStore):
    """The folder of blobs. One that holds copies alone (`is_cache`) may be emptied or removed at any time, and is made again."""

    def __init__(self, folder: Path, *, is_cache: bool = False) -> None:
        super().__init__(folder)
        self._is_cache = is_cache
        self._opened: Opened | None = None

    def put(self, content: bytes | Path) -> str:
        """Store bytes, or a copy of a file, and return their address."""
        with open_content(content) as source, self.writing(), written_beside(source, self.folder) as (written, sha256):
            self.keep(written, sha256)
        return sha256

    def open(self, *, make: bool = True) -> None:
        """Open the folder, created where there is none; it is never created again later.

        If the same folder returns it is used again; another one in its place, such as an empty mount point, is refused.
        """
        with self._explain_failures():
            if make:
                self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._opened = Opened(self.folder)

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Check, before writing, that the folder is the one that was opened; the first use opens it."""
        with self._explain_failures():
            if self._is_cache:
                self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            elif self._opened is None:
                self.open()
            else:
                self._opened.refuse_another()
            yield

    @contextmanager
    def _explain_failures(self) -> Iterator[None]:
        """Turn an error into one sentence that the folder cannot be written."""
        try:
            yield
        except OSError as error:
            raise StorageError(
                f"The folder of files {self.folder} cannot be written ({error.strerror or error}): let the server write there, "
                "make room on its disk, or name another by BORESIGHT_BLOBS.",
                code="folder-not-writable",
            ) from error

    def refuse_unusable(self) -> None:
        """Check that the folder exists and can be written, with a temporary file."""
        with self.writing(), tempfile.TemporaryFile(dir=self.folder) as file:
            file.write(b"Boresight")
            file.flush()
        refuse_unwritable(self.folder / "file")

    def discard(self, sha256: str) -> None:
        """Remove a stored file that no row will name, because a related file could not be stored."""
        self.locate(sha256).unlink(missing_ok=True)

    def remove(self, sha256: str) -> None:
        """Remove a file on purpose, and what was converted from it."""
        self.discard(sha256)
        for made in (self.folder / CONVERTED).glob(f"{sha256}-*"):
            made.unlink(missing_ok=True)

    def send_ahead(self, *files: Path) -> None:
        """Do nothing, because a folder needs no network transfer."""

    def keep(self, written: Path, sha256: str) -> None:
        """Rename a complete file to its address, also over a corrupt one, and sync the folder against a power cut."""
        location = self.locate(sha256)
        if location.exists() and integrity.is_intact(location, sha256):
            return
        location.parent.mkdir(parents=True, exist_ok=True)
        written.replace(location)
        folder = os.open(location.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def locate(self, sha256: str) -> Path:
        """Return the path for the bytes of an address."""
        return self.folder / sha256[:2] / sha256[2:4] / sha256

    def path(self, sha256: str) -> Path:
        """Return the read-only file of an address, with its content checked."""
        return self._checked(self._located(sha256), sha256)

    def _located(self, sha256: str) -> Path:
        """Return the file of an address without checking its content."""
        location = self.locate(sha256)
        if not location.is_file():
            if self._opened is not None:
                self._opened.refuse_another()
            self.refuse_removed(sha256)
            raise NotFoundError(
                f"The stored file {sha256[:12]} is missing from {self.folder}; restore it from a backup.",
                code="missing-file",
            )
        return location

    def _checked(self, location: Path, sha256: str, *, again: bool = False) -> Path:
        """Return a file after checking that its bytes match its address."""
        try:
            intact = integrity.is_intact(location, sha256, again=again)
        except OSError as error:
            raise UnavailableError(
                f"The stored file {sha256[:12]} in {self.folder} cannot be read ({error.strerror or error}): let the server "
                "read it, and check the disk."
            ) from error
        if not intact:
            self.tell_corrupt(sha256)
            raise CorruptFileError(
                f"The stored file {sha256[:12]} was altered on the disk, so it is not used; restore it in "
                f"{self.folder} from a backup.",
                sha256,
                code="altered-file",
            )
        return location

    def check(self, sha256: str, *, again: bool) -> int:
        """Check a file against its address and return its size."""
        return self._checked(self._located(sha256), sha256, again=again).stat().st_size

    def size(self, sha256: str) -> int:
        """Return the size of an address's file without checking it; refuses a missing one as `path` does."""
        return self._located(sha256).stat().st_size
