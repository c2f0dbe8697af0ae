"""The watched folder: one sub-folder a sensor, named as it; files are taken from there once they are complete, and moved away.

    <folder>/<sensor>/pass-17.csv          new: taken once its size and time have not changed for `settle_s`
    <folder>/<sensor>/done/pass-17.csv     taken in
    <folder>/<sensor>/refused/pass-17.csv  refused, with the reason in pass-17.csv.reason.txt

A name that begins with a dot, or ends as an upload that is under way does, is left alone: whoever writes renames at the end. Every
step goes by descriptors of folders that are no symbolic links; a symbolic link, a device or a pipe is refused and never opened, and
what is read is a copy, so that a file that changes afterwards is another file.
"""

from __future__ import annotations

import hashlib
import os
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from boresight.errors import RefusedInputError, UnavailableError

DONE, REFUSED = "done", "refused"
UNDER_WAY = (".part", ".partial", ".tmp", ".temp", ".filepart", ".crdownload", ".reason.txt", "~")
MOST_ENTRIES = 10_000
CHUNK_BYTES = 1 << 20
FOLDER_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
FILE_FLAGS = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC  # a pipe is not waited for


@dataclass(frozen=True)
class Arrival:
    """A file in a sensor's sub-folder, as it was seen: what changes while it is written is in it."""

    sensor: str
    name: str
    size_bytes: int
    mtime_ns: int
    inode: int
    is_file: bool


@dataclass(frozen=True)
class TakenFile:
    """The copy of a file that is read, with its SHA-256."""

    path: Path
    name: str
    sha256: str
    size_bytes: int


class WatchedFolder:
    """The watched folder, which remembers since when each file has been as it is."""

    def __init__(self, folder: Path, settle_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.folder = folder
        self._settle_s = settle_s
        self._clock = clock
        self._seen: dict[Arrival, float] = {}

    def list_complete(self) -> list[Arrival]:
        """Return the files that have not changed for long enough, oldest first."""
        now, found = self._clock(), list(self._look())
        self._seen = {one: self._seen.get(one, now) for one in found}
        complete = [one for one in found if now - self._seen[one] >= self._settle_s]
        return sorted(complete, key=lambda one: (one.mtime_ns, one.sensor, one.name))

    def count_waiting(self, sensor: str) -> int:
        """Count the files that lie in a sensor's sub-folder, as of the last look."""
        return sum(one.sensor == sensor for one in tuple(self._seen))

    def _look(self) -> Iterator[Arrival]:
        try:
            with _opened(self.folder) as root:
                names = sorted(entry.name for entry in _scan(root) if entry.is_dir(follow_symlinks=False))
                for name in names:
                    if not name.startswith("."):
                        yield from _look_into(root, name)
        except OSError as error:
            raise UnavailableError(
                f"The watched folder {self.folder} cannot be read ({error.strerror}): correct its rights, "
                "or BORESIGHT_WATCH_FOLDER."
            ) from error

    def take(self, arrival: Arrival, into: Path, most_bytes: int) -> TakenFile | None:
        """Copy a file, or return None where it changed meanwhile; refuse what is no plain file, and one that is too large."""
        if not arrival.is_file:
            raise RefusedInputError(
                f"{arrival.name} is a link, folder or device, not a regular file; send the file itself.",
                code="not-a-plain-file",
            )
        refuse_too_large(arrival.name, arrival.size_bytes, most_bytes)
        with self._open_sensor(arrival.sensor) as place, _opened(arrival.name, FILE_FLAGS, place) as file:
            if _described(arrival, os.fstat(file)) != arrival:
                return None
            digest, size = hashlib.sha256(), 0
            with into.open("xb") as copy:
                while size <= arrival.size_bytes and (chunk := os.read(file, CHUNK_BYTES)):
                    digest.update(chunk)
                    size += len(chunk)
                    copy.write(chunk)
            if size != arrival.size_bytes or _described(arrival, os.fstat(file)) != arrival:
                into.unlink()
                return None
        return TakenFile(into, arrival.name, digest.hexdigest(), size)

    def settle(self, arrival: Arrival, to: str, reason: str = "") -> None:
        """Move a file to `done` or `refused`, there with its reason; a name that is taken gets a number before it."""
        with self._open_sensor(arrival.sensor) as place:
            with suppress(FileExistsError):
                os.mkdir(to, 0o750, dir_fd=place)
            with _opened(to, FOLDER_FLAGS, place) as target:
                name = _free_name(target, arrival.name)
                os.rename(arrival.name, name, src_dir_fd=place, dst_dir_fd=target)
                if reason:
                    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
                    with os.fdopen(os.open(f"{name}.reason.txt", flags, 0o640, dir_fd=target), "w") as file:
                        file.write(f"{reason}\n")
        self._seen.pop(arrival, None)

    @contextmanager
    def _open_sensor(self, sensor: str) -> Iterator[int]:
        with _opened(self.folder) as root, _opened(sensor, FOLDER_FLAGS, root) as place:
            yield place


def refuse_too_large(name: str, size_bytes: int, most_bytes: int) -> None:
    """Refuse a file that has more bytes than an upload may have."""
    if size_bytes > most_bytes:
        raise RefusedInputError(
            f"{name} is {size_bytes / 1e6:.0f} MB; the limit is {most_bytes / 1e6:.0f} MB: split it, or "
            "have an administrator raise BORESIGHT_UPLOAD_LIMIT_MB."
        )


@contextmanager
def _opened(
    path: Path | str, flags: int = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC, at: int | None = None
) -> Iterator[int]:
    """Open a folder or a file for as long as it is needed; the watched folder itself may be a link."""
    handle = os.open(path, flags, dir_fd=at)
    try:
        yield handle
    finally:
        os.close(handle)


def _scan(handle: int) -> list[os.DirEntry[str]]:
    """Return the entries of a folder; one with too many is not read on."""
    found: list[os.DirEntry[str]] = []
    with os.scandir(handle) as entries:
        for entry in entries:
            found.append(entry)
            if len(found) >= MOST_ENTRIES:
                break
    return found


def _look_into(root: int, sensor: str) -> Iterator[Arrival]:
    with suppress(OSError), _opened(sensor, FOLDER_FLAGS, root) as place:
        for entry in _scan(place):
            name = entry.name
            if name in {DONE, REFUSED} or name.startswith(".") or name.lower().endswith(UNDER_WAY):
                continue
            with suppress(OSError):  # gone since
                yield _described(Arrival(sensor, name, 0, 0, 0, is_file=False), entry.stat(follow_symlinks=False))


def _described(arrival: Arrival, found: os.stat_result) -> Arrival:
    is_file = stat.S_ISREG(found.st_mode)
    return Arrival(arrival.sensor, arrival.name, found.st_size, found.st_mtime_ns, found.st_ino, is_file)


def _free_name(target: int, name: str) -> str:
    """Return a name that is free in a folder."""
    for number in range(1, MOST_ENTRIES):
        candidate = name if number == 1 else f"{number}-{name}"
        try:
            os.stat(candidate, dir_fd=target, follow_symlinks=False)
        except FileNotFoundError:
            return candidate
    raise UnavailableError(f"There are too many files named {name} in the folder; move the older ones elsewhere.")
