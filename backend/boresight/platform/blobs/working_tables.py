"""Working tables of stored sets as memory-mapped files, converted from Parquet where an older version stored that."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from boresight import disks as integrity
from boresight.platform.blobs.store import CONVERTED, BlobStore
from boresight.telemetry.read.limits import STORED
from boresight.telemetry.readers import read_chunks
from boresight.telemetry.working_table import WorkingTableParts, is_working_table


def working_table(blobs: BlobStore, sha256: str) -> tuple[Path, str]:
    """Return the memory-mapped table of an address, and the SHA-256 of its bytes."""
    path = blobs.path(sha256)
    if is_working_table(path):
        return path, sha256
    folder = blobs.folder / CONVERTED
    for made in folder.glob(f"{sha256}-*"):
        if integrity.is_intact(made, own := made.name.rpartition("-")[2]):
            return made, own
    return _converted(path, sha256, folder)


def table_path(blobs: BlobStore, sha256: str) -> Path:
    """Return the path of the memory-mapped table of an address; refuses as `working_table` does."""
    return working_table(blobs, sha256)[0]


def _converted(path: Path, sha256: str, folder: Path) -> tuple[Path, str]:
    """Convert a Parquet table to one that can be mapped, written atomically."""
    folder.mkdir(mode=0o700, exist_ok=True)
    unfinished = folder / f"unfinished-{secrets.token_hex(8)}"
    try:
        with WorkingTableParts(unfinished) as parts:
            for chunk in read_chunks(path, f"{sha256[:12]}.parquet", limits=STORED):
                parts.write(chunk)
        with unfinished.open("rb+") as file:
            os.fsync(file.fileno())
        own = integrity.compute_digest(unfinished)
        return unfinished.rename(folder / f"{sha256}-{own}"), own
    finally:
        unfinished.unlink(missing_ok=True)
