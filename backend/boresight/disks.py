"""What a disk answers: its errors, each with one sentence, and whether a file holds the bytes that its SHA-256 promises."""

from __future__ import annotations

import errno
import hashlib
import os
import tempfile
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from boresight.errors import RefusedInputError, StorageError

FULL = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))
READ_ONLY = frozenset((errno.EROFS, errno.EACCES, errno.EPERM))
ABSENT = frozenset((errno.ENOENT, errno.ENOTDIR))
LEAST_FREE_BYTES = 4 << 20  # a page or a log line still fits, and somebody has time to make room


def storage_error(error: OSError, place: Path | str | None = None) -> StorageError | None:
    """Return what a system error says of a disk; None where it is about something else."""
    named = place if place is not None else error.filename or "a temporary file"
    if error.errno in FULL:
        return StorageError(full(named))
    if error.errno in READ_ONLY and (place is not None or error.errno == errno.EROFS):
        return StorageError(read_only(named))
    if error.errno in ABSENT and place is not None:
        return StorageError(absent(named))
    return None


@contextmanager
def writing(place: object) -> Iterator[None]:
    """Say in a sentence why a file or folder cannot be written; raises StorageError of a disk and RefusedInputError of a path."""
    if not isinstance(place, str | os.PathLike):
        raise RefusedInputError(f"No file can be written to {type(place).__name__}: give a path.", code="unwritable")
    try:
        yield
    except OSError as error:
        why = f"{place} cannot be written ({error.strerror or error}): choose another place."
        raise storage_error(error) or RefusedInputError(why, code="unwritable") from error


def full(place: object) -> str:
    """Say that a disk is full."""
    return f"The disk of {place} is full, or a limit on sizes is reached, so nothing was stored: make room there, and try again."


def failing(place: object) -> str:
    """Say that a disk takes no write, for no reason that it gives."""
    return f"The disk of {place} fails to read or write, so nothing was stored: make room there, and check the disk."


def read_only(place: object) -> str:
    """Say that a place cannot be written."""
    return f"{place} cannot be written: mount its disk for writing, or let the user of this process write there, and try again."


def absent(place: object) -> str:
    """Say that a folder is not there."""
    return f"The folder of {place} does not exist: mount its disk or make the folder, and try again."


class Opened:
    """A file or folder as it was opened: it may go away and come back, and nothing else is taken for it."""

    def __init__(self, place: Path) -> None:
        self.place = place
        self._identity = _identity(place)

    def refuse_another(self) -> None:
        """Refuse to go on while it is not there, or something else is: some microseconds, so every transaction asks."""
        try:
            found = _identity(self.place)
        except OSError as error:
            raise StorageError(
                f"{self.place} is gone: mount its disk, or move it back to where it was, and try again.",
                code="folder-gone",
            ) from error
        if found != self._identity:
            raise StorageError(
                f"{self.place} is not what this process opened: mount its disk or move it back to where it was and try again; "
                "restart Boresight if it was replaced on purpose.",
                code="folder-replaced",
            )


def _identity(place: Path) -> tuple[int, int]:
    """Return what tells a file from every other of this machine."""
    found = place.stat()
    return found.st_dev, found.st_ino


def refuse_unwritable(file: Path) -> None:
    """Refuse a file that a write would fail on now."""
    folder = file.parent
    if not folder.is_dir():
        raise StorageError(absent(file))
    if not os.access(folder, os.W_OK) or (file.exists() and not os.access(file, os.W_OK)):
        raise StorageError(read_only(file))
    if hasattr(os, "statvfs"):
        found = os.statvfs(folder)
        if found.f_bavail * found.f_frsize < LEAST_FREE_BYTES:
            raise StorageError(full(file))


def write_private(file: Path, text: str, *, replace: bool = True) -> None:
    """Write a text file that its owner alone can read, whole or not at all; without `replace` an existing one stays."""
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=".keys-", dir=file.parent)  # 0600 from the start
    try:
        with os.fdopen(handle, "w") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        if replace:
            Path(name).replace(file)
        else:
            with suppress(FileExistsError):  # another process was first: its file is the file
                os.link(name, file)
    finally:
        Path(name).unlink(missing_ok=True)


MOST_REMEMBERED = 100_000
FRESH_NS = 50_000_000  # a second write so soon after might leave the times as they are

Identity = tuple[int, ...]

_checked: OrderedDict[tuple[str, str], Identity] = OrderedDict()
_guard = threading.Lock()


def compute_digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_intact(path: Path, sha256: str, *, again: bool = False) -> bool:
    """Whether a file has these bytes; read when this process has not seen it so, or when asked to read it again."""
    identity, now_ns = _file_identity(path), time.time_ns()
    with _guard:
        if not again and _checked.get((str(path), sha256)) == identity:
            return True
    if compute_digest(path) != sha256:
        with _guard:
            _checked.pop((str(path), sha256), None)
        return False
    if _file_identity(path) == identity and abs(now_ns - identity[-1]) > FRESH_NS:
        _remember(path, sha256, identity)
    return True


def _remember(path: Path, sha256: str, identity: Identity) -> None:
    with _guard:
        _checked[str(path), sha256] = identity
        _checked.move_to_end((str(path), sha256))
        while len(_checked) > MOST_REMEMBERED:
            _checked.popitem(last=False)


def _file_identity(path: Path) -> Identity:
    """Return what tells a file from another one, and from itself after a change of bytes, name or owner."""
    found = path.stat()
    return (found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)
