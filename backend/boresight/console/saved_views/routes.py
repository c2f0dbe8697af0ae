"""Saved views: read them, save one, remove one."""

from __future__ import annotations

from pydantic import Field

from boresight.console.access.dependencies import Reading, Who, Writing
from boresight.console.operation import operations
from boresight.console.saved_views import service as views
from boresight.console.saved_views import tables
from boresight.console.schemas import Row, Shape
from boresight.platform.web.paging import Id, Listing, Page


class SavedView(Row):
    """The address of a page under a name; a favourite is one of an object's page."""

    id: int
    user_id: int
    name: str
    path: str
    favourite: bool
    shared: bool
    made_utc: str


router = operations("/saved-views", tags=["saved views"])


class NewView(Shape):
    """An address of this server under a name."""

    name: str = Field(examples=["Failed runs of ST16-1"])
    path: str = Field(examples=["/runs?sensor=1&state=FAILED"])
    shared: bool = Field(default=False, description="Whether it is visible to everyone.")


@router.get("", summary="List saved views", response_model=Page[SavedView])
def list_saved_views(actor: Who, session: Reading) -> Listing[tables.SavedView]:
    """List your own views, favourites first, and those that others share."""
    return Listing(views.list_views(session, actor))


@router.post("", summary="Save a view", status_code=201, response_model=SavedView)
def save_view(new: NewView, actor: Who, session: Writing) -> tables.SavedView:
    """Save the address of a page under a name."""
    return views.save_view(session, actor, new.name, new.path, shared=new.shared)


@router.post("/{view_id}:remove", summary="Remove a view", response_model=SavedView)
def remove_view(view_id: Id, actor: Who, session: Writing) -> tables.SavedView:
    """Remove a view of your own."""
    return views.remove_view(session, actor, view_id)
