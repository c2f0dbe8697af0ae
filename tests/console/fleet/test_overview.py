"""The fleet at a glance."""

import re
from types import SimpleNamespace
from weakref import WeakKeyDictionary

import pytest

from boresight.console.approvals import service as approvals
from boresight.console.fleet.pages import overview
from boresight.console.parameter_sets import service as parameter_sets
from boresight.platform.db.sessions import open_writing
from boresight.resources import folder


@pytest.fixture
def site(site):
    site.app.state.workers = SimpleNamespace(state=lambda: {"connected": True, "tasks": 0}, notify=lambda: None)
    return site


def submitted(site):
    with open_writing(site.engine) as session:
        row = parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, 1)
        approvals.submit(session, site.actor("ada"), site.blobs, row.id, "Focus moved with temperature.", row.version)
        return row.name


def test_a_sensor_shows_its_status_baseline_and_rms_before_and_after(site, read, results):
    page = read(site.visitor("victor").get("/"))
    rms = results["sqrf"]["rms_arc_rad"]
    assert "The ground calibration does not hold any more: promote a calibration made on orbit." in page
    assert "PS-ST16-1-0" in page
    assert "ground calibration" in page
    assert f"{rms['initial'] * 1e6:.1f} → {rms['final'] * 1e6:.2f}" in page


def test_names_of_sensors_and_sets_may_wrap(site):
    page = site.visitor("victor").get("/")
    assert '<h3 class="name"><a href="/sensors/1">' in page
    assert '<dd class="name"><a href="/parameter-sets/1">' in page
    sheets = folder("frontend") / "static"
    assert re.search(r"\.tile \.name {[^}]*overflow-wrap: anywhere", (sheets / "fleet" / "fleet.css").read_text())
    sheet = (sheets / "shared" / "style.css").read_text()
    assert re.search(r"\.todo li {[^}]*overflow-wrap: anywhere", sheet)


def test_a_failed_run_is_serious_for_the_fleet_on_every_page(site, read):
    site.add_run(state="FAILED", reason="No usable frame.")
    visitor = site.visitor("ada")
    assert "Run 3 failed: No usable frame." in read(visitor.get("/"))
    assert "status-serious" in visitor.get("/audit").split("<main")[0]
    assert "run 3 FAILED" in read(visitor.get("/"))


def test_the_approver_and_nobody_else_is_asked_to_sign(site, read):
    name = submitted(site)
    assert f"{name} waits for your signature." in read(site.visitor("alan").get("/"))
    for other in ("ada", "victor", "adele"):
        assert "waits for your signature" not in read(site.visitor(other).get("/"))


def test_a_waiting_request_is_counted_in_the_bar_of_every_page(site):
    submitted(site)
    top = site.visitor("victor").get("/audit").split("<main")[0]
    assert 'class="badge badge-some">1<' in top


def test_an_analyst_is_asked_to_judge_a_converged_run_until_a_set_is_made_of_it(site, read):
    visitor = site.visitor("ada")
    assert "run 2 converged; judge it." in read(visitor.get("/"))
    with open_writing(site.engine) as session:
        parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, 2)
    assert "judge it" not in read(visitor.get("/"))


def test_what_happened_is_listed_with_the_ends_of_runs(site, read):
    site.add_run(state="CANCELLED", reason="Not needed.", ended_utc="2100-01-01T00:00:00.000000Z")
    events = read(site.visitor("victor").get("/")).split("Recent events")[1]
    assert "CANCELLED" in events.split("created")[0]
    assert "Not needed." in events


def test_workers_that_are_away_are_said_to_be(site, read):
    site.app.state.workers.state = lambda: {"connected": False, "tasks": 0}
    assert "Not connected" in read(site.visitor("victor").get("/"))


def test_who_may_not_launch_is_offered_no_launch(site):
    assert "New run" in site.visitor("ada").get("/")
    assert "New run" not in site.visitor("victor").get("/")


def test_of_a_large_fleet_those_that_stand_worst_are_drawn_and_the_page_says_so(site, read, monkeypatch):
    levels = ("normal", "critical", "off", "caution", "critical")
    stand = [SimpleNamespace(sensor_id=number, status=level) for number, level in enumerate(levels)]
    monkeypatch.setattr(overview, "MOST_TILES", 3)
    assert [one.sensor_id for one in overview.choose_drawn_sensors(stand)] == [1, 4, 3]
    assert overview.choose_drawn_sensors(stand[:3]) == stand[:3]
    assert "that stand worst" not in read(site.visitor("ada").get("/"))
    monkeypatch.setattr(overview, "MOST_TILES", 0)
    page = site.visitor("ada").get("/")
    assert "The 0 that stand worst; all 1" in page
    assert '<h3 class="name">' not in page


def test_what_the_page_counts_and_what_it_draws_are_one_look_and_it_says_what_is_not_judged_yet(
    site, read, monkeypatch
):
    monkeypatch.setattr("boresight.console.fleet.status._known", WeakKeyDictionary())
    monkeypatch.setattr("boresight.console.fleet.status.MOST_JUDGED", 0)
    page = site.visitor("ada").get("/")
    assert "of 1 it is not known yet whether the ground calibration holds" in read(page)
    assert '<a href="/sensors?status=normal">1</a>' in page
    assert '<li class="tile tile-normal">' in page
    monkeypatch.setattr("boresight.console.fleet.status.MOST_JUDGED", 1)
    assert "not known yet" not in read(site.visitor("victor").get("/?again=1"))
