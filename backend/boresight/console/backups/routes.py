"""Scheduled backups, for whoever monitors them."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.console.access.dependencies import Reading
from boresight.console.backups import service, tables
from boresight.console.operation import operations
from boresight.console.schemas import Row
from boresight.platform.web.paging import Listing, Page, Paged


class Backup(Row):
    """A scheduled backup."""

    id: int
    due_utc: str = Field(description="The time of the schedule that it was taken for.")
    state: Literal["RUNNING", "TESTING", "SUCCEEDED", "FAILED"] = Field(
        description="SUCCEEDED only after it has been restored into a temporary store and verified."
    )
    name: str = Field(description="Name of its file.")
    started_utc: str
    ended_utc: str | None
    size_bytes: int | None
    files: int | None = Field(description="Stored files in it.")
    key_id: str | None = Field(description="Id of the key that decrypts it.")
    head: str | None = Field(description="Head of the audit log when it was taken.")
    tested_utc: str | None = Field(description="The newest restore test.")
    sentence: str | None = Field(description="Result of the test, or why there is no backup.")
    removed_utc: str | None = Field(description="When its file was removed, because newer backups replaced it.")


router = operations("/backups", tags=["backups"])


@router.get("", summary="List backups", response_model=Page[Backup])
def list_backups(session: Reading, page: Paged) -> Listing[tables.Backup]:
    """List the scheduled backups, newest first, each with its restore test."""
    return page.cut(service.list_backups(session, page.limit + 1, page.last_id))
