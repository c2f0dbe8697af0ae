"""The administration page: how people, keys, workers, approval, audit and backup are at."""

import dataclasses
import re
from types import SimpleNamespace

import orjson
import pytest

from boresight.console.access import users
from boresight.console.access.tables import ApiKey, User
from boresight.console.administration.pages import STATES, keys_at, warnings
from boresight.console.pages.formats import LEVEL_OF_STATE, LEVELS
from boresight.figures import FIGURES
from boresight.platform.db.sessions import open_writing
from boresight.platform.jobs.worker_news import WorkerState
from tests.passwords import new_password


@pytest.fixture
def site(site):
    site.app.state.workers = SimpleNamespace(
        state=lambda: WorkerState(owner="host/1", connected=True), notify=lambda: None
    )
    return site


NOW, SOON, LATER = ("2026-11-21T00:00:00.000000Z", "2026-12-01T00:00:00.000000Z", "2027-11-21T00:00:00.000000Z")


def _person(*roles: str, disabled_utc: str | None = None) -> User:
    return User(name="x", printed_name="X", roles=list(roles), disabled_utc=disabled_utc)


def test_the_page_says_who_must_set_a_password_and_how_to_back_up(site, read):
    with open_writing(site.engine) as session:
        users.change_password(session, site.actor("adele"), 5, new_password("a given password"))
    page = read(site.visitor("adele").get("/administration"))
    assert "Must still set their own password: Victor Viewer." in page
    assert "boresight backup --out FILE.zip" in page
    assert "FOUR-EYES RULE ON" in page


def test_a_single_user_install_says_so_on_every_page(site):
    visitor = site.visitor("ada")
    assert 'id="four-eyes-off"' not in visitor.get("/sensors")
    site.app.state.policy = dataclasses.replace(site.app.state.policy, four_eyes=False)
    for path in ("/", "/sensors", "/audit", "/administration"):
        assert 'id="four-eyes-off"' in visitor.get(path)


def test_where_one_person_works_alone_every_download_says_so(site):
    visitor, report = site.visitor("ada"), "/api/v1/runs/1/report"
    addresses = ["/runs.csv", "/runs/1/log", "/runs/1/sensor.json", "/api/v1/runs/1/figures/radial/data", report]
    addresses += ["/api/v1/runs/1/result", "/api/v1/parameter-sets/1", "/api/v1/audit/export", "/api/v1/runs/999"]
    for four_eyes in (True, False):
        site.app.state.policy = dataclasses.replace(site.app.state.policy, four_eyes=four_eyes)
        for address in addresses:
            answer = visitor.send("GET", address)
            assert answer.headers.get("boresight-four-eyes") == (None if four_eyes else "off"), address
            named = answer.headers.get("content-disposition")
            assert named is None or ('filename="four-eyes-off-' in named) is not four_eyes, named
            assert address != report or ("FOUR-EYES RULE OFF" in answer.text) is not four_eyes


def test_what_would_hold_up_work_is_said():
    people = [_person("analyst", "approver"), _person("operator"), _person("administrator", disabled_utc=NOW)]
    said = warnings(people, four_eyes=True)
    assert "There is only one user with the role approver; nobody can stand in." in said
    assert "No user has the role administrator." in said
    assert "Every approver is also an analyst: whoever submits a set needs another approver to sign it." in said
    assert (
        warnings([_person(role) for role in ("analyst", "operator", "approver", "administrator") * 2], four_eyes=True)
        == []
    )


def test_keys_are_counted_by_what_needs_a_look():
    keys = [
        ApiKey(expires_utc=None),
        ApiKey(expires_utc=LATER, last_used_utc=NOW),
        ApiKey(expires_utc="2026-11-25T00:00:00.000000Z"),
        ApiKey(expires_utc=None, revoked_utc=NOW),
        ApiKey(expires_utc=NOW),
    ]
    found = keys_at(keys, NOW, SOON)
    assert (found.valid, found.unused, found.expiring, found.endless) == (3, 2, 1, 1)


def test_every_figure_of_the_registry_is_in_the_gallery_with_its_guide(site, read):
    page = site.visitor("victor").get("/gallery")
    drawn = re.findall(r'<plot-figure src="/gallery/figures/([\w-]+)\?of=one"', page)
    assert sorted(drawn) == sorted(FIGURES)
    assert all(figure.title in read(page) for figure in FIGURES.values())


def test_every_state_word_and_level_is_among_the_elements(site, read):
    shown = read(site.visitor("victor").get("/gallery?part=elements"))
    assert all(re.search(rf"\b{word}\b", shown) for word in (*LEVEL_OF_STATE, *LEVELS))
    for state in ("Empty", "Loading", "Partial", "Stale", "Error", "Forbidden", "Disconnected", "Conflict"):
        assert state in shown


@pytest.mark.parametrize("of", STATES)
def test_a_figure_of_the_gallery_comes_as_drawing_and_as_numbers(site, of):
    visitor = site.visitor("victor")
    drawn = orjson.loads(visitor.get(f"/gallery/figures/rms?of={of}"))
    lines = visitor.get(f"/gallery/figures/rms/data?of={of}").splitlines()
    assert bool(drawn["data"]) == (of != "nothing") == (len(lines) > 2)


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/gallery?part=secrets", 404),
        ("/gallery?of=secrets", 404),
        ("/gallery/figures/secrets", 404),
        ("/gallery/figures/rms?of=secrets", 404),
        ("/gallery/figures/rms/data?of=secrets", 404),
        ("/gallery/figures/rms?of=broken", 422),
    ],
)
def test_what_the_gallery_does_not_have_is_refused_in_a_sentence(site, path, status):
    assert re.search(r"There is no|fails on purpose", site.visitor("victor").get(path, status=status))


@pytest.mark.parametrize("path", ["/gallery", "/gallery/figures/rms", "/gallery/figures/rms/data"])
def test_nobody_who_is_not_logged_in_sees_the_gallery(site, path):
    stranger = site.visitor("victor")
    stranger.cookies.clear()
    assert stranger.send("GET", path).status_code in {303, 401}


def test_the_administration_page_leads_to_the_gallery(site):
    site.app.state.workers = None
    assert 'href="/gallery"' in site.visitor("adele").get("/administration")
