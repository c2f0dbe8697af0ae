"""Around a request: who opened its evidence, what was said, whom it is asked of, and a signature over the shoulder."""

import pytest

from boresight.console import transitions
from boresight.platform.db.sessions import open_reading

PASSWORD = "correct horse battery"
WORDS = {"decision": "APPROVE", "meaning": "", "comment": "Seen."}


@pytest.fixture
def address(site) -> str:
    ada = site.visitor("ada")
    place = ada.post("/runs/1/parameter-set").headers["location"]
    version = ada.get(place).split('name="version" value="')[1].split('"')[0]
    return ada.post(f"{place}/submit", version=version, reason="The held-out RMS fell.").headers["location"]


def test_opening_evidence_leads_there_and_is_shown_once(site, address, read):
    alan = site.visitor("alan")
    for _ in range(2):
        answer = alan.post(f"{address}/open", evidence="trust")
        assert answer.headers["location"] == "/runs/1?part=trust"
    row = read(alan.get(address)).split("Trust: two halves")[1].split("Open")[0]
    assert row.count("Alan Approver") == 1
    assert alan.post(f"{address}/open", evidence="the-moon").status_code == 404


def test_a_remark_stands_under_its_name_and_a_refused_one_is_kept_in_its_place(site, address, read):
    alan = site.visitor("alan")
    alan.post(f"{address}/remarks", text="Why is <b>n0</b> so far off?")
    page = site.visitor("ada").get(address)
    assert "Why is &lt;b&gt;n0&lt;/b&gt; so far off?" in page
    assert "Alan Approver" in read(page)
    refused = alan.post(f"{address}/remarks", text="x" * 4001)
    assert refused.status_code == 422
    assert "x" * 4001 in refused.text


def test_a_viewer_reads_the_discussion_and_is_told_how_to_take_part(site, address, read):
    page = site.visitor("victor").get(address)
    assert "Viewers read along" in read(page)
    assert f'action="{address}/remarks' not in page


def test_a_request_is_asked_of_one_who_may_sign_and_the_inbox_says_whom(site, address, read):
    page = site.visitor("ada").get(address)
    asked = page.split('id="person"')[1].split("</select>")[0]
    assert "Alan Approver" in asked
    assert "Olga Operator" not in asked
    number = asked.split(">Alan Approver")[0].rsplit('value="', 1)[1].split('"')[0]
    assert site.visitor("ada").post(f"{address}/assign", person=number, version="1").status_code == 303
    assert "Asked of Alan Approver." in read(site.visitor("ada").get(address))
    assert "Alan Approver" in read(site.visitor("both").get("/approvals"))


def test_whom_it_is_asked_of_is_refused_to_who_saw_an_older_request(site, address):
    ada = site.visitor("ada")
    ada.post(f"{address}/assign", person="", version="1")
    refused = ada.post(f"{address}/assign", person="", version="1")
    assert refused.status_code == 412


def test_a_second_person_signs_at_the_submitters_console_and_the_roll_says_so(site, address, read):
    ada = site.visitor("ada")
    answer = ada.post(f"{address}/sign-over-the-shoulder", version="1", name="alan", password=PASSWORD, **WORDS)
    assert answer.status_code == 303
    text = read(ada.get(address))
    assert "Alan Approver at the console of Ada Analyst Password given by Command line at 20" in text
    assert "Ada Analyst" in ada.get("/approvals"), "the console's log-in became another's"
    with open_reading(site.engine) as session:
        assert transitions.get_approval(session, 1).state == "APPROVED"


def test_nobody_signs_over_ones_own_shoulder(site, address):
    alan = site.visitor("alan")
    refused = alan.post(f"{address}/sign-over-the-shoulder", version="1", name="alan", password=PASSWORD, **WORDS)
    assert refused.status_code == 403
    assert 'value="alan"' in refused.text
    assert PASSWORD not in refused.text


@pytest.mark.usefixtures("address")
def test_the_inbox_separates_what_is_mine_to_sign(site, read):
    assert "Review and sign" in read(site.visitor("alan").get("/approvals?show=mine"))
    assert 'class="empty"' in site.visitor("ada").get("/approvals?show=mine")
