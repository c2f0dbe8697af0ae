"""The pages about gates: limits that are edited and tried, a set's report, waivers."""

import re

import pytest

from boresight.console.approvals import gate_profiles
from boresight.console.approvals import queries as approval_queries
from boresight.console.parameter_sets import service as parameter_sets
from boresight.platform.db.sessions import open_reading, open_writing, utc_now
from tests.sites import PASSWORD

EDITOR = "/sensors/1/gates"
REASON = "The shift is the one that launch made; we know it."


@pytest.fixture
def candidate(site):
    with open_writing(site.engine) as session:
        return parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, 1).id


def fields(page):
    typed = dict(re.findall(r'<input class="number" name="([^"]+)"[^>]* value="([^"]*)"', page))
    typed |= dict.fromkeys(re.findall(r'type="checkbox" name="([^"]+)" value="yes"[^>]* checked', page), "yes")
    return typed | {"number": re.search(r'name="number" value="(\d+)"', page)[1]}


@pytest.fixture
def blocked(site, candidate):
    document = {"gates": [{"name": "parameter-shift", "limit": 0.5, "marginal": 0.5}]}
    with open_writing(site.engine) as session:
        gate_profiles.set_profile(session, site.actor("adele"), 1, document, "To be tried.", 0)
    assert site.visitor("ada").post(f"/parameter-sets/{candidate}/assess").status_code == 303
    return candidate


def test_the_editor_shows_every_gate_with_its_limit_and_unit(site, read):
    page = site.visitor("adele").get(EDITOR)
    typed = fields(page)
    assert typed["validation-rms.limit"] == "3"
    assert typed["parameter-shift.limit"] == ""
    assert typed["coverage.waivable"] == "yes"
    assert not any(name.startswith(("finite.", "covariance.", "sensor.")) for name in typed)
    assert "χ² per degree of freedom" in read(page)


def test_an_administrator_sets_limits_and_the_version_says_what_changed(site, read):
    visitor = site.visitor("adele")
    typed = fields(visitor.get(EDITOR)) | {"coverage.limit": "0.25", "action": "set", "reason": "Corners matter."}
    assert visitor.post(EDITOR, **typed).status_code == 303
    words = read(visitor.get(EDITOR))
    assert "version 1" in words
    assert "Detector coverage, limit: none → 0.25" in words
    assert "Corners matter." in words


def test_who_is_no_administrator_reads_and_tries_but_does_not_set(site):
    visitor = site.visitor("victor")
    page = visitor.get(EDITOR)
    assert 'value="set" disabled' in page
    answer = visitor.post(EDITOR, **(fields(page) | {"coverage.limit": "0.3", "action": "set", "reason": "I wish."}))
    assert answer.status_code == 403
    assert visitor.post(EDITOR, **(fields(page) | {"action": "try"})).status_code == 200


def test_limits_are_tried_on_past_runs_and_stay_in_the_form(site, read):
    visitor = site.visitor("ada")
    typed = fields(visitor.get(EDITOR)) | {"parameter-shift.limit": "0.5", "parameter-shift.marginal": "0.5"}
    page = visitor.post(EDITOR, **typed, action="try").text
    words = read(page)
    assert "These limits would have blocked 2 of the newest 2 runs. Blocked that are not now: #2, #1." in words
    assert fields(page)["parameter-shift.limit"] == "0.5"
    with open_reading(site.engine) as session:
        assert gate_profiles.profile_in_force(session, 1).number == 0


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("coverage.limit", "many", "Detector coverage: the limit 'many' is no number"),
        ("coverage.limit", "2", "coverage: limit is 2.0; give a number from 0 to 1"),
        ("availability.marginal", "0.1", "give a marginal of at least the limit"),
    ],
)
def test_a_limit_that_makes_no_sense_is_refused_by_name_and_stays_in_the_form(site, read, field, value, words):
    visitor = site.visitor("adele")
    typed = fields(visitor.get(EDITOR)) | {field: value}
    for action in ("try", "set"):
        answer = visitor.post(EDITOR, **typed, action=action, reason="x")
        assert answer.status_code == 422
        assert words in read(answer.text)
        assert f'value="{value}"' in answer.text


def test_limits_that_somebody_else_changed_meanwhile_are_not_overwritten(site):
    visitor = site.visitor("adele")
    typed = fields(visitor.get(EDITOR)) | {"action": "set", "reason": "Both."}
    assert visitor.post(EDITOR, **(typed | {"coverage.limit": "0.2"})).status_code == 303
    answer = visitor.post(EDITOR, **(typed | {"coverage.limit": "0.4"}))
    assert answer.status_code == 412


def test_a_set_that_was_not_assessed_says_so_and_can_be(site, read, candidate):
    visitor = site.visitor("ada")
    answer = visitor.post(f"/parameter-sets/{candidate}/assess")
    assert answer.headers["location"] == f"/parameter-sets/{candidate}/gates"
    words = read(visitor.get(f"/parameter-sets/{candidate}/gates"))
    assert "assessed by Ada Analyst" in words
    assert "× incumbent" in words


def test_a_viewer_reads_gates_but_does_not_assess(site, candidate):
    visitor = site.visitor("victor")
    assert 'id="assess-blocked"' in visitor.get(f"/parameter-sets/{candidate}/gates")
    answer = visitor.post(f"/parameter-sets/{candidate}/assess")
    assert answer.status_code == 403


def test_a_gate_that_blocks_is_named_and_waived_with_a_reason_and_the_waiver_stays(site, read, blocked):
    visitor = site.visitor("ada")
    page = visitor.get(f"/parameter-sets/{blocked}/gates")
    assert "cannot be approved: Parameter shift blocks it." in read(page)
    version = re.search(r'name="version" value="(\d+)"', page)[1]
    form = {"gate": "parameter-shift", "code": "known-cause", "days": "30", "version": version, "password": PASSWORD}
    short = visitor.post(f"/parameter-sets/{blocked}/waive", **form, reason="Known.")
    assert short.status_code == 422
    assert ">Known.</textarea>" in short.text
    assert PASSWORD not in short.text
    assert visitor.post(f"/parameter-sets/{blocked}/waive", **form, reason=REASON).status_code == 303
    words = read(visitor.get(f"/parameter-sets/{blocked}/gates"))
    assert "(1 gate waived)" in words
    assert "cannot be approved" not in words
    assert REASON in words
    with open_reading(site.engine) as session:
        assert [one.gate for one in approval_queries.waivers_in_force(session, blocked, utc_now())] == [
            "parameter-shift"
        ]


@pytest.mark.parametrize("days", ["0", "31", "many", ""])
def test_a_waiver_of_a_wrong_length_is_refused(site, blocked, days):
    visitor = site.visitor("ada")
    page = visitor.get(f"/parameter-sets/{blocked}/gates")
    version = re.search(r'name="version" value="(\d+)"', page)[1]
    form = {"gate": "parameter-shift", "code": "other", "reason": REASON, "version": version, "password": PASSWORD}
    assert visitor.post(f"/parameter-sets/{blocked}/waive", **form, days=days).status_code == 422


def test_who_may_not_waive_reads_why(site, read, blocked):
    assert "Only an analyst or an approver may waive" in read(
        site.visitor("olga").get(f"/parameter-sets/{blocked}/gates")
    )


def test_there_are_no_gates_of_what_does_not_exist(site):
    visitor = site.visitor("adele")
    for address in ("/sensors/99/gates", "/parameter-sets/99/gates"):
        visitor.get(address, status=404)
    for address in ("/sensors/99/gates", "/parameter-sets/99/assess", "/parameter-sets/99/waive"):
        assert visitor.post(address).status_code in {404, 422}
