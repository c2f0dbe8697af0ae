"""Saved views: the address of a page under a name, and favourites, which are saved views of an object's page.

Whoever is logged in saves their own; who shares one shows it to everybody, and only its owner removes it. An address is of this
server alone.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from boresight.console.saved_views import queries
from boresight.console.saved_views.tables import SavedView
from boresight.errors import ConflictError, ForbiddenError, RefusedInputError
from boresight.platform.actors import Actor, require_person
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.origins import is_own_path
from boresight.platform.web.text_validation import normal_name

MOST_VIEWS = 200  # of a person
MOST_SHOWN = 1000
LONGEST_NAME, LONGEST_PATH = 80, 2000
OF_AN_OBJECT = re.compile(r"/(?:sensors|runs|parameter-sets|approvals)/\d+")
NO_PAGE = ("/api/", "/static/", "/log")


def list_views(session: Session, actor: Actor) -> Sequence[SavedView]:
    """Return the views that somebody may open: their own, favourites first, and those that are shared."""
    return queries.list_seen_by(session, actor.user_id, MOST_SHOWN)


def list_favourites(session: Session, actor: Actor) -> Sequence[SavedView]:
    """Return a person's favourites."""
    return [] if actor.user_id is None else queries.list_favourites(session, actor.user_id, MOST_VIEWS)


def save_view(session: Session, actor: Actor, name: str, path: str, *, shared: bool = False) -> SavedView:
    """Save an address under a name."""
    return _save(session, require_person(actor, "save a view"), name, path, shared=shared)


def toggle_favourite(session: Session, actor: Actor, name: str, path: str) -> bool:
    """Make an object's page a favourite, or none where it is one; return whether it is one now."""
    user_id = require_person(actor, "have favourites")
    if OF_AN_OBJECT.fullmatch(path) is None:
        raise RefusedInputError("Only a sensor, a run, a parameter set or a request can be a favourite; save a view.")
    found = queries.find_of_path(session, user_id, path)
    if found is None:
        return bool(_save(session, user_id, name, path, favourite=True).favourite)
    if found.favourite and not found.shared and found.name == normal_name("name of the view", name, LONGEST_NAME):
        session.delete(found)  # the star made it, and nothing else would be left of it
        return False
    found.favourite = 1 - found.favourite
    return bool(found.favourite)


def remove_view(session: Session, actor: Actor, view_id: int) -> SavedView:
    """Remove a view; only its owner may."""
    user_id = require_person(actor, "remove a view")
    row = session.get_known(SavedView, view_id)
    if row.user_id != user_id:
        raise ForbiddenError("Only the owner of a view can remove it; ask them to.")
    session.delete(row)
    return row


def _save(
    session: Session, user_id: int, name: str, path: str, *, favourite: bool = False, shared: bool = False
) -> SavedView:
    name = normal_name("name of the view", name, LONGEST_NAME)
    if not name:
        raise RefusedInputError("A view needs a name; enter one.")
    if not is_own_path(path) or path.startswith(NO_PAGE):
        raise RefusedInputError("A view is a page of this server; give its address from the first slash on.")
    if len(path) > LONGEST_PATH:
        raise RefusedInputError(
            f"The address has {len(path)} characters; use fewer filters: at most {LONGEST_PATH} characters can be saved."
        )
    if (known := queries.find_of_path(session, user_id, path)) is not None:
        raise ConflictError(f"You have saved this view as {known.name!r}; remove that one first.")
    if queries.count_views(session, user_id) >= MOST_VIEWS:
        raise ConflictError(f"You have saved {MOST_VIEWS} views; remove one first.")
    row = SavedView(
        user_id=user_id, name=name, path=path, favourite=int(favourite), shared=int(shared), made_utc=utc_now()
    )
    return session.put(row)
