"""Stored results of runs, calibrations and choices of a camera, checked for completeness before they are used."""

from __future__ import annotations

from typing import Any

from boresight.calibration.calibration import parse_calibration
from boresight.calibration.choice.result import Choice, parse_choice
from boresight.console.runs.tables import Run
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
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
        f"The stored result {sha256[:12]}{whose} cannot be read as a calibration: launch the run again, or restore the "
        "store from a backup.",
        code="unreadable-result",
    )


def read_choice(blobs: BlobStore, sha256: str, run_id: int | None = None) -> Choice:
    """Read the stored choice of a camera for a run's data; refuses one that is missing too, for it can be made again."""
    try:
        return parse_choice(blobs.document(sha256))
    except (ValueError, RefusedInputError, NotFoundError):
        whose = "" if run_id is None else f" of run {run_id}"
        raise ConflictError(
            f"The stored choice {sha256[:12]}{whose} cannot be read as a choice: choose again, or restore the store from "
            "a backup.",
            code="unreadable-choice",
        ) from None


def refuse_choice(run: Run) -> None:
    """Refuse a run that chooses a camera where a calibration is wanted."""
    if run.choice_of is not None:
        raise ConflictError(
            f"Run {run.id} is the choice of a camera and has no calibration: read the choice of run {run.choice_of} instead.",
            code="run-is-a-choice",
        )


def _is_whole(document: Any) -> bool:
    """Whether a document has every member of an ended calibration, each of its type."""
    try:
        return parse_calibration(document).status != "running"
    except RefusedInputError:
        return False
