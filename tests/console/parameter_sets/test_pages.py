"""The list of parameter sets and the page of one."""

import pytest

from boresight.console import transitions
from boresight.console.parameter_sets import queries as set_queries
from boresight.platform.db.sessions import open_reading


@pytest.fixture
def candidate(site):
    return site.visitor("ada").post("/runs/1/parameter-set").headers["location"]


def version(page):
    return page.split('name="version" value="')[1].split('"')[0]


@pytest.mark.usefixtures("candidate")
def test_the_list_shows_ground_and_board_as_two_states(site, read):
    text = read(site.visitor("victor").get("/parameter-sets"))
    assert "PS-ST16-1-0" in text
    assert "BASELINE" in text
    assert "CANDIDATE" in text
    assert text.partition("Baseline since")[2].count("NOT SENT") == 2


def test_filters_that_fit_nothing_say_so(site):
    assert 'class="empty"' in site.visitor("victor").get("/parameter-sets?state=REJECTED")


def test_a_set_shows_its_values_against_the_baseline_and_where_it_comes_from(site, candidate, read):
    text = read(site.visitor("victor").get(candidate))
    assert "Against the baseline PS-ST16-1-0." in text
    assert "TS-calibration" in text
    assert "#1 reference" in text
    assert "Nothing recorded: this set was not sent." in text


def test_a_set_is_submitted_with_a_reason_and_the_request_opens(site, candidate, read):
    ada = site.visitor("ada")
    answer = ada.post(
        f"{candidate}/submit", version=version(ada.get(candidate)), reason="Lower RMS on the held-out set."
    )
    assert answer.headers["location"] == "/approvals/1"
    text = read(ada.get("/approvals/1"))
    assert "Lower RMS on the held-out set." in text
    assert "SUBMITTED" in read(ada.get(candidate))


def test_a_submission_without_a_reason_is_refused_in_its_place(site, candidate, read):
    ada = site.visitor("ada")
    answer = ada.post(f"{candidate}/submit", version=version(ada.get(candidate)), reason="  ")
    assert answer.status_code == 422
    assert "CANDIDATE" in read(ada.get(candidate))


def test_a_submission_from_an_old_page_is_refused_and_keeps_the_reason(site, candidate):
    answer = site.visitor("ada").post(f"{candidate}/submit", version="99", reason="My long reason.")
    assert answer.status_code == 412
    assert "My long reason." in answer.text


def test_a_form_that_does_not_say_what_was_seen_is_refused(site, candidate):
    answer = site.visitor("ada").post(f"{candidate}/submit", reason="Because.")
    assert answer.status_code == 422


def test_a_viewer_sees_the_submit_button_blocked_with_the_reason(site, candidate):
    page = site.visitor("victor").get(candidate)
    assert 'aria-describedby="submit-blocked"' in page


def test_promotion_is_blocked_until_an_approver_has_signed(site, candidate):
    ada = site.visitor("ada")
    ada.post(f"{candidate}/submit", version=version(ada.get(candidate)), reason="Because.")
    olga = site.visitor("olga")
    assert 'id="promote-blocked"' in olga.get(candidate)
    assert olga.post(f"{candidate}/promote", version="2").status_code == 409


def test_the_submitter_withdraws_and_may_submit_again(site, candidate, read):
    ada = site.visitor("ada")
    ada.post(f"{candidate}/submit", version=version(ada.get(candidate)), reason="Because.")
    ada.post(f"{candidate}/withdraw", version=version(ada.get(candidate)))
    text = read(ada.get(candidate))
    assert "WITHDRAWN" in text


def test_withdrawing_another_s_request_is_refused_with_the_reason_beside_the_button(site, candidate):
    ada = site.visitor("ada")
    ada.post(f"{candidate}/submit", version=version(ada.get(candidate)), reason="Because.")
    assert 'id="withdraw-blocked"' in site.visitor("olga").get(candidate)


def test_an_approved_set_becomes_the_baseline_and_supersedes_the_old_one(site, candidate, read):
    ada, alan, olga = (site.visitor(name) for name in ("ada", "alan", "olga"))
    ada.post(f"{candidate}/submit", version=version(ada.get(candidate)), reason="Because.")
    words = {"decision": "APPROVE", "meaning": "I approve.", "comment": "", "password": "correct horse battery"}
    alan.post("/approvals/1/sign", version=version(alan.get("/approvals/1")), **words)
    answer = olga.post(f"{candidate}/promote", version=version(olga.get(candidate)))
    assert answer.headers["location"] == candidate
    text = read(olga.get(candidate))
    assert "This set is the baseline; it replaced PS-ST16-1-0." in text
    with open_reading(site.engine) as session:
        assert set_queries.baseline(session, 1).name == "PS-ST16-1-1"
        assert transitions.get_parameter_set(session, 1).ground_state == "SUPERSEDED"


def test_a_set_that_does_not_exist_is_not_found(site):
    site.visitor("victor").get("/parameter-sets/99", status=404)


def test_a_former_baseline_offers_a_roll_back_with_a_request_of_its_own(site, read):
    ada, alan, olga = (site.visitor(name) for name in ("ada", "alan", "olga"))
    place = ada.post("/runs/1/parameter-set").headers["location"]
    request = ada.post(f"{place}/submit", version=version(ada.get(place)), reason="Better.").headers["location"]
    words = {"decision": "APPROVE", "meaning": "", "comment": "", "password": "correct horse battery"}
    alan.post(f"{request}/sign", version="1", **words)
    olga.post(f"{place}/promote", version=version(olga.get(place)))
    page = olga.get("/parameter-sets/1")
    assert "Ask to roll back to PS-ST16-1-0" in read(page)
    back = olga.post("/parameter-sets/1/roll-back", version=version(page), reason="The new one lost stars.")
    text = read(alan.get(back.headers["location"]))
    assert "Roll back to PS-ST16-1-0" in text
    assert "The new one lost stars." in text
