"""The runs before and after one, for whoever reads them in turn."""

from __future__ import annotations

from boresight.store import run_lists
from boresight.store.sessions import Session


def neighbours(session: Session, run_id: int) -> tuple[int | None, int | None]:
    """Return the numbers of the runs before and after one, None at an end of the list."""
    return run_lists.neighbours(session, run_id)
