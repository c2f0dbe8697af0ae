"""Views are saved by their owners, seen by whom they were meant for, and lead nowhere but to pages of this server."""

import pytest

from boresight.console.saved_views import service as views
from boresight.console.saved_views.tables import SavedView
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.actors import COMMAND_LINE

FAILED = "/runs?sensor=1&state=FAILED"
ZOOMED = "/runs/2?part=convergence#zoom.run-2-rms=x_10_20&at=frame_15"


def test_who_saves_a_view_sees_it_and_others_only_what_is_shared(session, people):
    views.save_view(session, people["ana"], "Failed", FAILED)
    views.save_view(session, people["ana"], " The  step ", ZOOMED, shared=True)
    assert [(row.name, row.path) for row in views.list_views(session, people["ana"])] == [
        ("Failed", FAILED),
        ("The step", ZOOMED),
    ]
    assert [row.path for row in views.list_views(session, people["eve"])] == [ZOOMED]
    assert [row.path for row in views.list_views(session, COMMAND_LINE)] == [ZOOMED]


def test_only_the_owner_removes_a_view(session, people):
    row = views.save_view(session, people["ana"], "Failed", FAILED, shared=True)
    for other in ("eve", "root"):
        with pytest.raises(ForbiddenError):
            views.remove_view(session, people[other], row.id)
    views.remove_view(session, people["ana"], row.id)
    session.flush()
    assert session.get(SavedView, row.id) is None
    with pytest.raises(NotFoundError):
        views.remove_view(session, people["ana"], row.id)


@pytest.mark.parametrize(
    "path",
    ["", "runs", "//elsewhere.invalid/", "/\\elsewhere.invalid", "https://elsewhere.invalid/", "javascript:alert(1)",
     "/api/v1/audit/export", "/logout", "/runs\n", "/runs?q=" + "x" * 2000],
)  # fmt: skip
def test_only_pages_of_this_server_are_saved(session, people, path):
    with pytest.raises(RefusedInputError):
        views.save_view(session, people["ana"], "x", path)


@pytest.mark.parametrize("name", ["", "  ", "x" * 81, "a\x00b"])
def test_a_view_has_a_name_that_can_be_read(session, people, name):
    with pytest.raises(RefusedInputError):
        views.save_view(session, people["ana"], name, FAILED)


def test_an_address_is_saved_once_by_each_and_two_hundred_are_enough(session, people, monkeypatch):
    monkeypatch.setattr(views, "MOST_VIEWS", 2)
    views.save_view(session, people["ana"], "Failed", FAILED)
    with pytest.raises(ConflictError, match="Failed"):
        views.save_view(session, people["ana"], "Again", FAILED)
    views.toggle_favourite(session, people["ana"], "ST16-1", "/sensors/1")
    with pytest.raises(ConflictError):
        views.save_view(session, people["ana"], "One more", ZOOMED)
    views.save_view(session, people["eve"], "Failed", FAILED)
    with pytest.raises(ForbiddenError):
        views.save_view(session, COMMAND_LINE, "Failed", FAILED)


def test_an_object_is_a_favourite_until_its_star_is_pressed_again(session, people):
    assert views.toggle_favourite(session, people["eve"], "ST16-1", "/sensors/1")
    assert [row.name for row in views.list_favourites(session, people["eve"])] == ["ST16-1"]
    assert views.list_favourites(session, people["ana"]) == []
    assert not views.toggle_favourite(session, people["eve"], "ST16-1", "/sensors/1")
    assert views.list_favourites(session, people["eve"]) == []
    with pytest.raises(RefusedInputError):
        views.toggle_favourite(session, people["eve"], "All runs", "/runs")


def test_a_star_keeps_a_view_that_was_saved_under_a_name_and_shared(session, people):
    views.save_view(session, people["eve"], "Reference run", "/runs/1", shared=True)
    stars = [views.toggle_favourite(session, people["eve"], "Run 1", "/runs/1") for _ in range(2)]
    assert stars == [True, False]
    assert [(row.name, row.shared) for row in views.list_views(session, people["ana"])] == [("Reference run", 1)]


def _send(visitor, place, **form):
    answer = visitor.send("POST", place, data={**form, "csrf_token": visitor.csrf_token})
    assert answer.status_code == 303
    return answer.headers["location"]


def test_favourites_stand_on_the_overview_and_first_among_what_the_palette_knows(site):
    victor = site.visitor("victor")
    _send(victor, "/saved-views", name="All failed", path=FAILED, shared="on")
    assert _send(victor, "/favourites", name="The tracker", path="/sensors/1") == "/sensors/1"
    assert 'href="/sensors/1">★ The tracker</a>' in victor.get("/")
    found = victor.send("GET", "/saved-views/known").json()["found"]
    assert [(one["kind"], one["href"], one["own"]) for one in found] == [
        ("Favourite", "/sensors/1", True),
        ("View", FAILED, True),
    ]
    ada = site.visitor("ada")
    assert [one["own"] for one in ada.send("GET", "/saved-views/known").json()["found"]] == [False]
    assert "The tracker" not in ada.get("/")
    assert "Victor Viewer" in ada.get("/saved-views")
    assert _send(victor, "/saved-views", name="x", path="//elsewhere.invalid") == "/saved-views"
