"""Forms keep what was typed: whatever a form is refused for, its page comes back with the words of whoever filled it in."""

from html import unescape

import pytest

from boresight.console.parameter_sets import service as parameter_sets
from boresight.platform.db.sessions import open_writing

WORDS = 'Words of a tired operator, "quoted" & <kept>.'
ODD = '{"name": "half of a document'
STALE = "99"
FORMS = {  # who sends what to which address, and what of it must be there again
    "log in": ("victor", "/login", {"name": "viktor", "password": "wrong"}, ["viktor"]),
    "register a sensor": ("ada", "/sensors", {"document": ODD}, [ODD]),
    "edit a sensor": ("ada", "/sensors/1", {"document": ODD, "version": "1"}, [ODD]),
    "limits": ("adele", "/sensors/1/gates", {"action": "set", "reason": WORDS, "coverage.limit": "x7"}, [WORDS, "x7"]),
    "table": ("ada", "/sensors/1/table-definition", {"action": "set", "document": ODD, "reason": WORDS}, [ODD, WORDS]),
    "launch": (
        "ada",
        "/runs/new",
        {"sensor_id": "1", "set_id": "1", "label": WORDS * 9, "intent": "queue"},
        [WORDS * 9],
    ),
    "submit": ("ada", "/parameter-sets/2/submit", {"reason": WORDS, "version": STALE}, [WORDS]),
    "roll back": ("ada", "/parameter-sets/2/roll-back", {"reason": WORDS, "version": STALE}, [WORDS]),
    "sign": ("alan", "/approvals/1/sign", {"decision": "REFUSE", "comment": WORDS, "version": STALE}, [WORDS]),
    "remark": ("ada", "/approvals/1/remarks", {"text": WORDS * 99}, [WORDS * 99]),
    "record": (
        "olga",
        "/parameter-sets/1/uplink/record",
        {"onboard_state": "SENT", "source": WORDS, "version": STALE},
        [WORDS],
    ),
    "person": (
        "adele",
        "/users",
        {"name": "new", "printed_name": WORDS, "password": "x", "roles": "viewer"},
        [WORDS, "new"],
    ),
    "key": ("ada", "/users/keys", {"label": WORDS, "days": "many"}, [WORDS, "many"]),
    "webhook": (
        "adele",
        "/webhooks",
        {"label": WORDS, "url": "gopher://x", "actions": "signed"},
        [WORDS, "gopher://x"],
    ),
    "note": ("ada", "/notes/runs/1", {"text": WORDS * 999}, [WORDS * 99]),
}


@pytest.fixture
def office(site, results):
    run_id = site.add_run(state="SUCCEEDED", result=results["batch"] | {"iterations": 77})
    with open_writing(site.engine) as session:
        parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, 1)
        parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, run_id)
    ada = site.visitor("ada")
    asked = ada.post("/parameter-sets/3/submit", reason="Lower validation RMS.", version="1")
    assert asked.headers["location"] == "/approvals/1"
    return site


@pytest.mark.parametrize("name", FORMS)
def test_a_refused_form_comes_back_with_what_was_typed(office, name):
    who, address, form, kept = FORMS[name]
    visitor = office.visitor(who)
    filled = {"csrf_token": visitor.csrf_token, **form}
    answer = visitor.send("POST", address, data=filled, headers={"Accept": "text/html"})
    assert 400 <= answer.status_code < 500, answer.headers
    page = unescape(answer.text)
    assert "notice-" in page or "fault" in page or "problem" in page, "the page does not say why"
    for words in kept:
        assert words in page, f"{words[:60]} is lost"
