"""Where backups are stored: a folder, best on another machine's disk, or a bucket of an object store.

A file appears complete or not at all, and none is ever written over. Only files that are named are ever removed, so others may
lie beside them.
"""

from __future__ import annotations

import io
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, cast

from boresight.errors import ConflictError, NotFoundError, RefusedInputError, StorageError, UnavailableError
from boresight.platform.backups.encryption import SeekableFile
from boresight.platform.blobs.locations import parse_address

if TYPE_CHECKING:
    from obstore.store import ObjectStore

CONNECTS_WITHIN, ENDS_WITHIN, TRIED_FOR = (timedelta(seconds=number) for number in (5, 600, 60))


class Destination(ABC):
    """A place for backups."""

    def __init__(self, address: str) -> None:
        self.address = address

    @abstractmethod
    def write(self, name: str, write: Callable[[Path], None]) -> int:
        """Have a file written and put it in its place; return its size."""

    @abstractmethod
    def open(self, name: str) -> BinaryIO:
        """Open a file that can be read from any place."""

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file; one that is gone already is no error."""

    @abstractmethod
    def refuse_unusable(self) -> None:
        """Refuse a place that is not there."""


class FolderDestination(Destination):
    """A folder, which is never made: an empty mount point must not be taken for it."""

    def write(self, name: str, write: Callable[[Path], None]) -> int:
        """Have a file written beside its place, then rename it."""
        self.refuse_unusable()
        file, part = Path(self.address) / name, Path(self.address) / f".{name}.part"
        if file.exists():
            raise ConflictError(f"{file} already exists and backups are never overwritten: try again.")
        try:
            write(part)
            with part.open("rb") as written:
                os.fsync(written.fileno())
            part.chmod(0o600)
            os.link(part, file)  # unlike a rename, never over one that came meanwhile
        except OSError as error:
            raise self._unusable(error) from error
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)
        return file.stat().st_size

    def open(self, name: str) -> BinaryIO:
        """Open a file."""
        try:
            return (Path(self.address) / name).open("rb")
        except FileNotFoundError as error:
            raise NotFoundError(
                f"The backup {name} is missing from {self.address}: restore it there, or use another."
            ) from error
        except OSError as error:
            raise self._unusable(error) from error

    def remove(self, name: str) -> None:
        """Remove a file."""
        self.refuse_unusable()
        try:
            (Path(self.address) / name).unlink(missing_ok=True)
        except OSError as error:
            raise self._unusable(error) from error

    def refuse_unusable(self) -> None:
        """Refuse a folder that is not there."""
        if not Path(self.address).is_dir():
            raise StorageError(f"There is no folder {self.address} for backups: mount its disk, or make the folder.")

    def _unusable(self, error: OSError) -> StorageError:
        return StorageError(
            f"The folder of backups {self.address} cannot be used ({error.strerror or error}): let the server write there, or make "
            "room on its disk."
        )


class BucketDestination(Destination):
    """A bucket, whose credentials are in the environment."""

    def __init__(self, address: str, scratch: Path) -> None:
        super().__init__(address)
        self._scratch = scratch
        self._opened: ObjectStore | None = None

    @property
    def _store(self) -> ObjectStore:
        if self._opened is None:
            try:
                from obstore.store import from_url  # noqa: PLC0415 - an optional part
            except ImportError as error:
                raise RefusedInputError(
                    "An object store needs its library: pip install 'boresight[object-store]'."
                ) from error
            self._opened = from_url(
                self.address,
                client_options={"allow_http": True, "connect_timeout": CONNECTS_WITHIN, "timeout": ENDS_WITHIN},
                retry_config={"max_retries": 4, "retry_timeout": TRIED_FOR},
            )
        return self._opened

    def write(self, name: str, write: Callable[[Path], None]) -> int:
        """Have a file written on this machine, then send it."""
        store = self._store
        import obstore  # noqa: PLC0415 - an optional part

        part = self._scratch / name
        try:
            write(part)
            size = part.stat().st_size
            with self._asking(name):
                obstore.put(store, name, part)
                if obstore.head(store, name)["size"] != size:
                    raise UnavailableError(f"{name} did not arrive completely in {self.address}; try again.")
        finally:
            part.unlink(missing_ok=True)
        return size

    def open(self, name: str) -> BinaryIO:
        """Open an object, whose bytes are fetched as they are read."""
        return cast("BinaryIO", io.BufferedReader(_RemoteFile(self, name), 1 << 20))

    def size(self, name: str) -> int:
        """Return the size of an object."""
        store = self._store
        import obstore  # noqa: PLC0415 - an optional part

        with self._asking(name):
            return obstore.head(store, name)["size"]

    def fetch(self, name: str, start: int, length: int) -> bytes:
        """Return some bytes of an object."""
        store = self._store
        import obstore  # noqa: PLC0415 - an optional part

        with self._asking(name):
            return bytes(obstore.get_range(store, name, start=start, length=length))

    def remove(self, name: str) -> None:
        """Remove an object."""
        store = self._store
        import obstore  # noqa: PLC0415 - an optional part

        with self._asking(name), suppress(FileNotFoundError):
            obstore.delete(store, name)

    def refuse_unusable(self) -> None:
        """Refuse a bucket that does not answer."""
        with suppress(NotFoundError):
            self.size("is-it-there")

    @contextmanager
    def _asking(self, name: str) -> Iterator[None]:
        """Turn the store's errors into one sentence, without its message, which may contain addresses and headers."""
        from obstore.exceptions import BaseError  # noqa: PLC0415 - an optional part

        try:
            yield
        except FileNotFoundError as error:
            raise NotFoundError(
                f"The backup {name} is missing from {self.address}: restore it there, or use another."
            ) from error
        except BaseError as error:
            raise UnavailableError(
                f"The object store at {self.address} does not answer, or not to these credentials; check address, key and network."
            ) from error


class _RemoteFile(SeekableFile):
    """An object that is read by ranges."""

    def __init__(self, store: BucketDestination, name: str) -> None:
        self._store, self._name = store, name
        self.size = store.size(name)

    def readinto(self, buffer: bytearray | memoryview, /) -> int:  # type: ignore[override]
        length = min(len(buffer), self.size - self._place)
        if length <= 0:
            return 0
        buffer[:length] = self._store.fetch(self._name, self._place, length)
        self._place += length
        return length


def open_destination(address: str, scratch: Path) -> Destination:
    """Open a place for backups; files on their way to a bucket are written in `scratch`."""
    parsed = parse_address(address, "The place for backups")
    return FolderDestination(parsed) if "://" not in parsed else BucketDestination(parsed, scratch)
