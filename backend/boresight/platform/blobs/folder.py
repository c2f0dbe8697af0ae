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
from boresight.platform.blobs.store import BlobStore, open_content, written_beside


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
        """Take the folder for the one to use from now on, made where there is none; it is never made again.

        A folder that comes back is used again; another in its place, such as the empty one under a disk that is not
        mounted, is refused.
        """
        with self._said():
            if make:
                self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._opened = Opened(self.folder)

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Write in the folder that was opened, and refuse another; the first use opens it."""
        with self._said():
            if self._is_cache:
                self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            elif self._opened is None:
                self.open()
            else:
                self._opened.refuse_another()
            yield

    @contextmanager
    def _said(self) -> Iterator[None]:
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
        with self.writing(), tempfile.TemporaryFile(dir=self.folder) as file:
            file.write(b"Boresight")
            file.flush()
        refuse_unwritable(self.folder / "file")

    def discard(self, sha256: str) -> None:
        """Remove what was put and that no row will name, for what belongs to it could not be put."""
        self.locate(sha256).unlink(missing_ok=True)

    def send_ahead(self, *files: Path) -> None:
        """Bring nothing: here there is no network."""

    def keep(self, written: Path, sha256: str) -> None:
        """Give a complete file its address, in the place of a corrupt one too, and make the name itself survive a power cut."""
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
        """Where the bytes of an address belong."""
        return self.folder / sha256[:2] / sha256[2:4] / sha256

    def path(self, sha256: str) -> Path:
        """Return the file of an address, which has its bytes, to be read only."""
        return self._checked(self._located(sha256), sha256)

    def _located(self, sha256: str) -> Path:
        """Return the file of an address, whatever is in it."""
        location = self.locate(sha256)
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
