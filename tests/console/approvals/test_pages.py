"""The inbox and the page of a request."""

import pytest

from boresight.console.approvals.pages.approval import list_warnings
from boresight.figures.tables import parameter_rows

PASSWORD = "correct horse battery"
WORDS = {"decision": "APPROVE", "meaning": "I approve this set for baseline.", "comment": "Read all of it."}


@pytest.fixture
def request_page(site):
    return submitted(site, "ada", 1)


def submitted(site, name, run_id):
    person = site.visitor(name)
    place = person.post(f"/runs/{run_id}/parameter-set").headers["location"]
    version = person.get(place).split('name="version" value="')[1].split('"')[0]
    return person.post(f"{place}/submit", version=version, reason="The held-out RMS fell.").headers["location"]


@pytest.mark.usefixtures("request_page")
def test_the_inbox_says_what_waits_and_why_one_may_not_sign(site, read):
    assert "Review and sign" in read(site.visitor("alan").get("/approvals"))
    text = read(site.visitor("both").get("/approvals"))
    assert "The held-out RMS fell." in text


def test_an_empty_inbox_says_what_will_appear(site):
    assert 'class="empty"' in site.visitor("alan").get("/approvals")


def test_the_request_is_read_in_the_order_of_a_review(site, request_page):
    page = site.visitor("alan").get(request_page)
    order = ("reason", "change", "gates", "warnings", "evidence", "discussion", "signed", "sign")
    places = [page.index(f'id="{name}-title"') for name in order]
    assert places == sorted(places)
    assert 'src="/api/v1/runs/1/figures/radial"' in page


def test_the_buttons_name_their_effect(site, request_page, read):
    text = read(site.visitor("alan").get(request_page))
    assert "Approve PS-ST16-1-1 for baseline" in text
    assert "Refuse PS-ST16-1-1" in text


def test_a_signature_approves_and_stands_in_the_roll_with_name_meaning_and_comment(site, request_page, read):
    answer = site.visitor("alan").post(f"{request_page}/sign", version="1", password=PASSWORD, **WORDS)
    assert answer.headers["location"] == request_page
    text = read(site.visitor("victor").get(request_page))
    for words in ("Alan Approver", "APPROVE", "I approve this set for baseline.", "Read all of it."):
        assert words in text


def test_a_wrong_password_is_refused_in_its_place_and_everything_else_is_kept(site, request_page, read):
    answer = site.visitor("alan").post(f"{request_page}/sign", version="1", password="wrong wrong wrong", **WORDS)
    assert answer.status_code == 401
    assert "Read all of it." in answer.text
    assert "wrong wrong wrong" not in answer.text
    assert "nobody yet" in read(site.visitor("alan").get(request_page))


def test_a_refusal_needs_a_comment(site, request_page):
    words = {"decision": "REFUSE", "meaning": "I refuse.", "comment": "", "password": PASSWORD}
    answer = site.visitor("alan").post(f"{request_page}/sign", version="1", **words)
    assert answer.status_code == 422


def test_one_refusal_blocks(site, request_page, read):
    words = {"decision": "REFUSE", "meaning": "I refuse.", "comment": "Too few stars.", "password": PASSWORD}
    site.visitor("alan").post(f"{request_page}/sign", version="1", **words)
    text = read(site.visitor("both").get(request_page))
    assert "REJECTED" in text
    assert "Too few stars." in text


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("ada", "needs the role approver"),
        ("adele", "An administrator cannot sign"),
        ("victor", "needs the role approver"),
    ],
)
def test_who_may_not_sign_is_told_why_instead_of_a_form(site, request_page, read, name, said):
    page = site.visitor(name).get(request_page)
    assert said in read(page)
    assert 'id="password"' not in page
    assert said in read(site.visitor(name).post(f"{request_page}/sign", version="1", password=PASSWORD, **WORDS).text)


def test_the_submitter_is_told_that_another_approver_must_sign(site):
    request_page = submitted(site, "both", 2)
    assert 'id="password"' not in site.visitor("both").get(request_page)


def test_who_launched_the_run_is_told_so(site, read, results):
    run_id = site.add_run(state="SUCCEEDED", result={**results["batch"], "iterations": 99}, launched_by=6)
    request_page = submitted(site, "ada", run_id)
    assert f"You launched run {run_id}" in read(site.visitor("both").get(request_page))


def test_a_request_of_before_a_promotion_is_stale_and_cannot_be_signed(site, request_page, read):
    other = submitted(site, "ada", 2)
    alan, olga = site.visitor("alan"), site.visitor("olga")
    alan.post(f"{request_page}/sign", version="1", password=PASSWORD, **WORDS)
    page = olga.get(request_page)
    olga.post("/parameter-sets/2/promote", version=page.split('name="version" value="')[1].split('"')[0])
    text = read(alan.get(other))
    assert "STALE" in text


def test_a_change_beyond_what_such_sensors_make_is_a_warning(results):
    moved = {**results["batch"], "initial": {**results["batch"]["initial"], "f_m": 0.0150}}
    said = list_warnings(moved, parameter_rows(moved), is_ground=False)
    assert any(sentence.startswith("f_m moves by") for sentence in said)
    assert not any("g_y" in sentence for sentence in said)


def test_a_result_without_validation_is_a_warning(results):
    said = list_warnings({**results["batch"], "validation": None}, [], is_ground=False)
    assert "No validation set" in said[-1]
