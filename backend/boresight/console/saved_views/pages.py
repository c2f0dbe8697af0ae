"""Saved views: the list of them, what the palette and the star ask for, and their forms, which every page has in its frame."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from fastapi import Depends, Form, Request
from fastapi.responses import HTMLResponse, JSONResponse, Response

from boresight.console.access import users
from boresight.console.access.dependencies import Reading, Who, csrf, same_for_one
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import make_change, render
from boresight.console.saved_views import service as views
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session
from boresight.platform.web.origins import is_own_path

router = PageRouter(dependencies=[Depends(csrf)])
PLACE = "/saved-views"


@router.get("/saved-views", response_class=HTMLResponse, dependencies=[Depends(same_for_one)])
def saved_views_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show a person's own views and those that others share."""
    rows = views.list_views(session, actor)
    return render(
        request,
        "saved_views/saved_views.html",
        own=[row for row in rows if row.user_id == actor.user_id],
        others=[row for row in rows if row.user_id != actor.user_id],
        names={person.id: person.printed_name for person in users.list_users(session)},
    )


@router.get("/saved-views/known", response_class=JSONResponse, dependencies=[Depends(same_for_one)])
def known_views(session: Reading, actor: Who) -> JSONResponse:
    """Send what there is to open: favourites, own views, shared ones."""
    found = [
        {
            "kind": "Favourite" if row.favourite else "View",
            "title": row.name,
            "note": "shared" if row.shared else "",
            "href": row.path,
            "own": row.user_id == actor.user_id,
        }
        for row in views.list_views(session, actor)
    ]
    return JSONResponse({"found": found})


@router.post("/saved-views", response_class=HTMLResponse)
async def save(
    request: Request,
    actor: Who,
    name: Annotated[str, Form()] = "",
    path: Annotated[str, Form()] = "",
    shared: Annotated[str, Form()] = "",
) -> Response:
    """Save the view that a page shows."""
    change = partial(views.save_view, actor=actor, name=name, path=path, shared=bool(shared))
    return await make_change(request, change, path if is_own_path(path) else PLACE, "The view is saved as {0.name}.")


@router.post("/favourites", response_class=HTMLResponse)
async def toggle_favourite(
    request: Request, actor: Who, name: Annotated[str, Form()] = "", path: Annotated[str, Form()] = ""
) -> Response:
    """Make a page a favourite, or none."""
    change = partial(_toggle, actor=actor, name=name, path=path)
    return await make_change(request, change, path if is_own_path(path) else PLACE, "{}")


def _toggle(session: Session, actor: Actor, name: str, path: str) -> str:
    is_one = views.toggle_favourite(session, actor, name, path)
    return "Added to your favourites." if is_one else "Removed from your favourites."


@router.post("/saved-views/{view_id:int}/remove", response_class=HTMLResponse)
async def remove(request: Request, actor: Who, view_id: int) -> Response:
    """Remove a view."""
    change = partial(views.remove_view, actor=actor, view_id=view_id)
    return await make_change(request, change, PLACE, "The view {0.name} is removed.")
