"""Stored results of runs, checked for completeness before they are used."""

from __future__ import annotations

from typing import Any

from boresight.calibration.calibration import parse_calibration
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.data_version import SizeLimitedCache

MOST_REMEMBERED = 4096

#: Outcomes of the check by content address, whose bytes never change.
_looked_at: SizeLimitedCache[bool] = SizeLimitedCache(MOST_REMEMBERED)


def read_result(blobs: BlobStore, sha256: str, run_id: int | None = None) -> dict[str, Any]:
    """Read the stored result of a run, parsed once for all who ask: nobody may change it."""
    try:
        document: dict[str, Any] | None = blobs.document(sha256)
    except ValueError:
        document = None
    if document is not None and _looked_at.get(sha256, lambda: (_is_whole(document), 1)):
        return document
    whose = "" if run_id is None else f" of run {run_id}"
    raise ConflictError(
        f"The stored result {sha256[:12]}{whose} is no calibration that can be read: launch the run again, or restore the "
        "store from a backup."
    )


def _is_whole(document: Any) -> bool:
    """Whether a document has every member of an ended calibration, each of its type."""
    try:
        return parse_calibration(document).status != "running"
    except RefusedInputError:
        return False
