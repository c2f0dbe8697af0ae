"""Saved views as the API shows them."""

from __future__ import annotations

from boresight.console.schemas import Row


class SavedView(Row):
    """The address of a page under a name; a favourite is one of an object's page."""

    id: int
    user_id: int
    name: str
    path: str
    favourite: bool
    shared: bool
    made_utc: str
