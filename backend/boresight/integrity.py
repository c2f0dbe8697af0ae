"""Whether a file holds the bytes that its SHA-256 promises; every reader of a stored file asks here first.

A file is read and hashed the first time that a process asks. After that its identity on the disk answers: folder entry,
inode, size and times, so that a file that is replaced, written to or given another's name is read again. A SHA-256 of
200 MB takes a tenth of a second on a processor that has instructions for it, and half a second on one that has not.

Times on a disk move in steps of some milliseconds, so a file that was written a moment ago is read again once more.
What changes under an unchanged identity, as on a disk that fails, is found by whoever reads again on purpose:
`boresight audit verify`, a backup, and the server's upkeep.
"""

from __future__ import annotations

import hashlib
import threading
import time
from collections import OrderedDict
from pathlib import Path

MOST_REMEMBERED = 100_000
FRESH_NS = 50_000_000  # a second write so soon after might leave the times as they are

Identity = tuple[int, ...]

_checked: OrderedDict[tuple[str, str], Identity] = OrderedDict()
_guard = threading.Lock()


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_intact(path: Path, sha256: str, *, again: bool = False) -> bool:
    """Whether a file has these bytes; read when this process has not seen it so, or when asked to read it again.

    Raises
    ------
    OSError
        When it cannot be read.
    """
    identity, now_ns = _identity(path), time.time_ns()
    with _guard:
        if not again and _checked.get((str(path), sha256)) == identity:
            return True
    if digest_of(path) != sha256:
        with _guard:
            _checked.pop((str(path), sha256), None)
        return False
    if _identity(path) == identity and abs(now_ns - identity[-1]) > FRESH_NS:
        _remember(path, sha256, identity)
    return True


def _remember(path: Path, sha256: str, identity: Identity) -> None:
    with _guard:
        _checked[str(path), sha256] = identity
        _checked.move_to_end((str(path), sha256))
        while len(_checked) > MOST_REMEMBERED:
            _checked.popitem(last=False)


def _identity(path: Path) -> Identity:
    """Return what tells a file from another one, and from itself after a change of bytes, name or owner."""
    found = path.stat()
    return (found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)
