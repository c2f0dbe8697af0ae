"""Two people for one baseline: who may not sign cannot, and who refuses says why where the submitter reads it."""

import pytest
from playwright.sync_api import expect

from tests.browser.people import get_password
from tests.browser.work import make_set, sign, submit

pytestmark = pytest.mark.browser

WHY = "The tail is still falling at the last frame: take a longer set."
MEANING = "I have read the evidence and answer for it"


@pytest.fixture(scope="module")
def set_id(people, promoted, sequential_run):
    assert promoted.set_id
    with people.seat("analyst") as window:
        return make_set(window, sequential_run)


@pytest.fixture(scope="module")
def request_id(people, set_id):
    with people.seat("analyst") as window:
        window.open(f"/parameter-sets/{set_id}")
        return submit(window, "The filter's own estimate, for comparison.")


def test_who_submitted_cannot_sign_and_the_page_says_why(people, request_id):
    with people.seat("analyst") as window:
        window.open(f"/approvals/{request_id}")
        expect(window.page.get_by_role("button", name="Approve")).to_be_disabled()
        expect(window.page.locator("#sign-blocked")).to_contain_text("role approver")
        window.shoot("20-cannot-sign")


@pytest.mark.full
def test_the_server_refuses_a_signature_that_no_button_offered(people, request_id):
    with people.seat("analyst") as window:
        window.open(f"/approvals/{request_id}")
        before = window.read(f"/api/v1/approvals/{request_id}")
        form = {"decision": "APPROVE", "meaning": MEANING, "password": get_password("analyst"), "version": "1"}
        answer = window.send(f"/approvals/{request_id}/sign", form)
        assert answer.status == 403
        assert "role approver" in answer.text()
        assert window.read(f"/api/v1/approvals/{request_id}") == before


def test_an_administrator_cannot_sign_either(people, request_id):
    with people.seat("administrator") as window:
        window.open(f"/approvals/{request_id}")
        expect(window.page.locator("#sign-blocked")).to_be_visible()
        expect(window.page.get_by_role("button", name="Approve")).to_be_disabled()


def answer_points(window):
    for reason in window.page.locator("#sign .reason").all():
        reason.fill("Known.")


def test_an_approval_with_open_points_is_held_in_its_dialog_which_leads_to_the_first(people, request_id):
    with people.seat("approver") as window:
        window.open(f"/approvals/{request_id}")
        window.page.locator("#password").fill(get_password("approver"))
        window.page.locator("#sign").get_by_role("button", name="Approve").first.click()
        asked = window.page.get_by_role("dialog")
        expect(asked.get_by_role("button", name="Approve")).to_be_disabled()
        asked.get_by_role("link", name="To the first open point").click()
        expect(window.page.locator("#sign .point .reason").first).to_be_focused()
        answer_points(window)
        window.page.locator("#sign").get_by_role("button", name="Approve").first.click()
        expect(asked.get_by_role("button", name="Approve")).to_be_enabled()


def test_who_asks_for_all_figures_is_led_through_them_as_each_counts(people, request_id):
    with people.seat("approver") as window:
        window.open(f"/approvals/{request_id}")
        window.page.get_by_role("link", name="Open all figures").click()
        expect(window.page.locator("[data-view] [data-opened]", has_text="not opened")).to_have_count(0)


@pytest.mark.full
def test_a_wrong_password_is_refused_in_place_and_what_was_typed_stays(people, request_id):
    with people.seat("approver") as window:
        window.open(f"/approvals/{request_id}")
        window.page.locator("#meaning").fill(MEANING)
        answer_points(window)
        sign(window, "Approve", "not my password", "Looks right to me.")
        expect(window.page.locator("#sign").get_by_role("alert")).to_contain_text("password")
        expect(window.page.locator("#comment")).to_have_value("Looks right to me.")
        expect(window.page.locator("#meaning")).to_have_value(MEANING)
        expect(window.page.locator("#password")).to_have_value("")
        window.shoot("21-wrong-password")
        assert window.read(f"/api/v1/approvals/{request_id}")["state"] == "OPEN"
        window.forgive("401")


@pytest.mark.full
def test_a_refusal_needs_a_comment(people, request_id):
    with people.seat("approver") as window:
        window.open(f"/approvals/{request_id}")
        sign(window, "Refuse", get_password("approver"))
        expect(window.page.locator("#sign").get_by_role("alert")).to_contain_text("comment")
        assert window.read(f"/api/v1/approvals/{request_id}")["state"] == "OPEN"
        window.forgive("422")


def test_a_refused_set_is_rejected_and_the_analyst_reads_why(people, request_id, set_id, promoted):
    with people.seat("approver") as window:
        window.open(f"/approvals/{request_id}")
        sign(window, "Refuse", get_password("approver"), WHY)
        expect(window.page.get_by_role("heading", level=1)).to_contain_text("Refused")
    with people.seat("analyst") as window:
        window.open(f"/approvals/{request_id}")
        expect(window.page.get_by_role("region", name="Who has signed")).to_contain_text(WHY)
        window.open(f"/parameter-sets/{set_id}")
        expect(window.page.locator(".page-head")).to_contain_text("REJECTED")
        expect(window.page.get_by_role("region", name="Approval")).to_contain_text(f"refuse this set: {WHY}")
        window.shoot("22-rejected")
        assert window.read(f"/api/v1/parameter-sets/{promoted.set_id}")["ground_state"] == "BASELINE"
