"""The head of the audit log, kept outside the database, because nothing else reveals a loss of the newest records.

A file of the operator's choice, outside the data folder and best on another machine's disk, gets a line when the head has moved::

    {"id": 812, "hash": "3f...", "at_utc": "2026-11-21T03:04:05.123456Z"}

Lines are only added, and each is synced. The chain must hold the last whole one: a log that was cut, rewritten, or came back
from an older state of the disk does not. Webhooks that ask for `audit.head` get the same.
"""

from __future__ import annotations

import json
import os
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

from boresight.errors import RefusedInputError, UnavailableError

TAIL_BYTES = 1 << 16
HASH_DIGITS = 64


@dataclass(frozen=True)
class ExternalHead:
    """Number, hash and time of a record that was once the newest."""

    id: int
    hash: str
    at_utc: str


def refuse_within_data_folder(file: Path, data_folder: Path) -> None:
    """Refuse a file that would be lost together with the data folder."""
    if file.resolve().is_relative_to(data_folder.resolve()):
        raise RefusedInputError(
            f"BORESIGHT_AUDIT_HEAD_FILE names {file}, which is in the data folder and would be lost with it: "
            "name a file elsewhere.",
            code="head-in-data-folder",
        )


def write_head(file: Path, head: ExternalHead) -> None:
    """Append a line and sync it to the disk."""
    line = json.dumps(asdict(head)).encode()
    try:
        handle = os.open(file, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o640)
        with closing(os.fdopen(handle, "r+b", buffering=0)) as stream:
            size = os.fstat(handle).st_size
            torn = size > 0 and os.pread(handle, 1, size - 1) != b"\n"  # a partial line left by a full disk
            stream.write(b"\n" * torn + line + b"\n")
            os.fsync(handle)
    except OSError as error:
        raise UnavailableError(
            f"The head of the audit log cannot be written to {file} ({error.strerror or error}): make room or let the server write "
            "there, or name another file by BORESIGHT_AUDIT_HEAD_FILE."
        ) from error


def read_head(file: Path) -> ExternalHead | None:
    """Return the head of the last whole line; None where there is no file yet."""
    try:
        with file.open("rb") as stream:
            stream.seek(max(0, file.stat().st_size - TAIL_BYTES))
            lines = stream.read().splitlines()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise RefusedInputError(
            f"The kept head of the audit log {file} cannot be read ({error.strerror}): let this process read it."
        ) from error
    for line in reversed(lines):
        if (head := _head_in(line)) is not None:
            return head
    if lines:
        raise RefusedInputError(
            f"{file} contains no head of an audit log; name the file that BORESIGHT_AUDIT_HEAD_FILE named before.",
            code="no-audit-head",
        )
    return None


def _head_in(line: bytes) -> ExternalHead | None:
    """Read a line; None where it is incomplete."""
    try:
        found = json.loads(line)
        head = ExternalHead(int(found["id"]), str(found["hash"]), str(found["at_utc"]))
    except (ValueError, KeyError, TypeError):
        return None
    return head if len(head.hash) == HASH_DIGITS else None
