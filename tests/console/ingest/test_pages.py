"""The pages of new telemetry: each state of a decision and of a policy, with the acts that it offers and to whom."""

import re

import pytest

from boresight.console.ingest.service import supersede_overtaken
from boresight.console.ingest.tables import IngestDecision
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_writing
from boresight.verdicts.gates import GATES
from tests.console.approvals.gates import TIGHT, tight_profile
from tests.console.ingest.decisions import asked, draft, in_force, received, send, step


def _read(house, who, address):
    answer = house.person(who).get(address, headers={"Accept": "text/html"})
    assert answer.status_code == 200, answer.text[-2000:]
    return answer.text


def _post(house, who, address, **form):
    client = house.person(who)
    data = {"csrf_token": client.headers["X-CSRF-Token"], **form}
    return client.post(address, data=data, headers={"Accept": "text/html"}, follow_redirects=False)


def _acts(page):
    return set(re.findall(r'action="/sensors/\d+/ingest/([a-z-]+)"', page))


def test_a_decision_that_is_calibrating_follows_its_run_and_asks_nothing(house):
    row = received(house)
    page = _read(house, "ada", f"/ingest/{row['id']}")
    assert f'href="/runs/{row["run_id"]}"' in page
    assert "live-page.js" in page
    assert 'name="answer"' not in page


def test_a_question_that_a_newer_set_replaced_says_so(house):
    row = asked(house)
    with open_writing(house.app.state.engine) as session:
        supersede_overtaken(session, row["id"])
    page = _read(house, "ada", f"/ingest/{row['id']}")
    assert 'id="superseded"' in page
    assert 'name="answer"' not in page


def test_a_refused_file_shows_why(house):
    policy = in_force(house)
    send(house, policy["sensor_id"], b"frame\n1")
    (row,) = (
        house.person("ada").get("/api/v1/ingest-decisions", params={"sensor_id": policy["sensor_id"]}).json()["items"]
    )
    page = _read(house, "victor", f"/ingest/{row['id']}")
    assert "REFUSED" in page
    assert f'href="/ingest/{row["id"]}"' in _read(
        house, "victor", f"/ingest?sensor={policy['sensor_id']}&state=REFUSED"
    )
    assert _read(house, "victor", f"/ingest.csv?sensor={policy['sensor_id']}").count("\r\n") == 2


def test_a_question_waits_on_the_overview_of_an_analyst_and_is_answered_on_its_page(house):
    row = asked(house)
    waiting = house.person("ada").get("/waiting").json()
    assert any(one["address"] == f"/ingest/{row['id']}" for one in waiting["first"]) or waiting["count"] > 8
    form = {"answer": "WAIT", "reason": "Seen.", "version": str(row["version"])}
    refused = _post(house, "ada", f"/ingest/{row['id']}/answer", **{**form, "days": "soon"})
    assert refused.status_code == 422
    assert _post(house, "victor", f"/ingest/{row['id']}/answer", **form).status_code == 403
    answer = _post(house, "ada", f"/ingest/{row['id']}/answer", **form, days="3")
    assert (answer.status_code, answer.headers["location"]) == (303, f"/ingest/{row['id']}")
    assert "Seen." in _read(house, "ada", f"/ingest/{row['id']}")


def test_a_submission_of_a_set_that_a_gate_stops_says_so_on_its_button_and_leads_to_the_gate(house):
    row = asked(house)
    offered = [{"answer": "SUBMIT", "sentence": "Ask.", "recommended": True}]
    with open_writing(house.app.state.engine) as session:
        decision = session.get_one(IngestDecision, row["id"])
        gates = {"verdict": "FAIL", "blocking": ["validation-rms-incumbent"]}
        decision.evidence = {**decision.evidence, "alternatives": offered, "gates": gates}
        set_id = decision.parameter_set_id
        audit.append(session, COMMAND_LINE, "decided", f"ingest-decisions/{decision.id}")
    page = _read(house, "ada", f"/ingest/{row['id']}")
    assert "although" not in page
    assert (GATES["validation-rms-incumbent"].title in page, "validation-rms-incumbent" in page) == (True, False)
    assert "button-primary" in page.split('id="answer-1"')[0].rpartition("<button")[2]
    tight_profile(house, row["sensor_id"])
    assert house.person("ada").post(f"/api/v1/parameter-sets/{set_id}:assess").json()["blocking"] == [TIGHT["name"]]
    page = _read(house, "ada", f"/ingest/{row['id']}")
    dialog = page.split('<dialog id="answer-1"')[1].split("</dialog>")[0]
    assert "although 1 gate stops it" in dialog
    assert "button-primary" not in dialog
    assert f'href="/parameter-sets/{set_id}/gates">Open its gates' in page


def test_a_policy_is_drafted_rehearsed_enabled_paused_and_resumed_by_its_page(house):
    sensor_id = house.new_sensor()["id"]
    address = f"/sensors/{sensor_id}/ingest"
    assert _acts(_read(house, "ada", address)) == set()
    assert _post(house, "ada", address, confirmations="many", reason="x").status_code == 422
    assert _post(house, "ada", address, confirmations="2", reason="x").status_code == 303
    assert _acts(_read(house, "adele", address)) == {"rehearse", "switch-off"}
    (row,) = house.person("ada").get("/api/v1/ingest-policies", params={"sensor_id": sensor_id}).json()["items"]
    assert row["document"]["confirmations"] == 2
    seen = {"policy_id": str(row["id"]), "version": "1"}
    assert _post(house, "ada", f"{address}/rehearse", **seen).status_code == 303
    assert _acts(_read(house, "ada", address)) == {"rehearse", "switch-off"}
    assert _acts(_read(house, "adele", address)) == {"rehearse", "enable", "switch-off"}
    assert _post(house, "adele", f"{address}/enable", **{**seen, "version": "2"}).status_code == 303
    assert _acts(_read(house, "victor", address)) == set()
    assert _acts(_read(house, "olga", address)) == {"pause", "switch-off"}
    assert _post(house, "olga", f"{address}/pause", **{**seen, "version": "3"}, reason="x").status_code == 303
    assert _acts(_read(house, "ada", address)) == {"rehearse", "resume", "switch-off"}
    assert _post(house, "ada", f"{address}/resume", **{**seen, "version": "4"}, reason="x").status_code == 303
    found = house.person("ada").get(f"/api/v1/ingest-policies/{row['id']}").json()
    assert (found["state"], found["version"]) == ("ACTIVE", 5)


@pytest.mark.parametrize("page", ["/ingest", "/sensors/{sensor_id}", "/sensors/{sensor_id}/ingest?version=1"])
def test_pages_show_a_policy_that_was_stopped(house, page):
    policy = step(house, in_force(house), "pause", reason="The downlink is tested.")
    draft(house, policy["sensor_id"])
    text = _read(house, "victor", page.format(**policy))
    assert "The downlink is tested." in text or page.endswith("}")
