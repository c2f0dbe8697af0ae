"""Whether the update of C_SD was loaded with a set that turns the attitude: asked, recorded, and missed where it is not."""

import re

import pytest

from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.stations import make_workflow
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.actors import POLICY
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing
from tests.console.parameter_sets.test_pages import TURNED, promoted
from tests.console.uplinks.pages import advance, version
from tests.sites import codes


@pytest.fixture
def turning(site, results):
    """The baseline is a set whose loading turns the attitude; it was sent."""
    run = site.add_run("batch", state="SUCCEEDED", result={**results["batch"], "alignment": TURNED})
    place = site.visitor("ada").post(f"/runs/{run}/parameter-set").headers["location"]
    promoted(site, place)
    set_id = int(place.rpartition("/")[2])
    advance(site, "SENT", set_id=set_id)
    return set_id


def recorded(site, set_id, state, answer=None, said=""):
    visitor = site.visitor("olga")
    form = {"onboard_state": state, "source": "Pass 1", "version": version(site, set_id), "c_sd_said": said}
    form |= {} if answer is None else {"c_sd": answer}
    return visitor.post(f"/parameter-sets/{set_id}/uplink/record", **form)


def stays_open(site, set_id):
    with open_reading(site.engine) as session:
        return uplinks.is_c_sd_open(session, session.get_known(ParameterSet, set_id))


def test_the_page_asks_with_nothing_preselected_and_takes_no_loading_without_an_answer(site, turning):
    page = site.visitor("olga").get(f"/parameter-sets/{turning}/uplink")
    asked = page.split('id="record-loaded"')[1].split("</dialog>")[0]
    assert re.findall(r'name="c_sd" value="([A-Z ]+)"', asked) == ["LOADED", "NOT YET", "NOT NEEDED"]
    assert " checked" not in asked
    assert 'name="c_sd"' not in page.split('id="record-unknown"')[1].split("</dialog>")[0]
    refused = recorded(site, turning, "LOADED")
    assert refused.status_code == 422
    assert re.search(r'<dialog id="record-loaded"[^>]* open', refused.text)
    for answer in ("LOADED", "NOT NEEDED"):
        assert recorded(site, turning, "LOADED", answer, " ").status_code == 422, "when and how, or why, is missing"
    assert recorded(site, turning, "LOADED", "LOADED", "Pass 1, TC 7").status_code == 303
    assert not stays_open(site, turning)
    page = site.visitor("olga").get(f"/parameter-sets/{turning}/uplink")
    assert "c-sd-recorded" in codes(page)
    assert "attitude-turn" not in codes(page)
    assert "Pass 1, TC 7" in page
    with open_reading(site.engine) as session:
        told = audit.find_last_change(session, f"parameter-sets/{turning}").after
    assert (told["c_sd"], told["c_sd_said"]) == ("LOADED", "Pass 1, TC 7")


def test_a_set_that_turns_nothing_is_not_asked(site):
    advance(site, "SENT")
    page = site.visitor("olga").get("/parameter-sets/1/uplink")
    assert 'name="c_sd"' not in page
    assert recorded(site, 1, "LOADED").status_code == 303
    assert recorded(site, 1, "UNKNOWN", "LOADED", "Pass 1").status_code == 422, "there is no update to load"


def test_active_warns_while_the_update_is_not_loaded_and_leads_to_its_record(site, turning):
    assert recorded(site, turning, "LOADED", "NOT YET").status_code == 303
    advance(site, "VERIFIED", set_id=turning)
    page = site.visitor("olga").get(f"/parameter-sets/{turning}/uplink")
    assert "c-sd-open" in codes(page.split('id="activate"')[1].split("</dialog>")[0])
    advance(site, "ACTIVE", set_id=turning)
    with open_reading(site.engine) as session:
        row = session.get_known(ParameterSet, turning)
        step = make_workflow(session, site.actor("olga"), POLICY, row).next_step
        assert (step.href.partition("#")[2], step.is_mine) == ("c-sd", True)
    assert recorded(site, turning, "ACTIVE", "LOADED", "Pass 2").status_code == 303
    with open_reading(site.engine) as session:
        row = session.get_known(ParameterSet, turning)
        assert row.onboard_state == "ACTIVE"
        workflow = make_workflow(session, site.actor("olga"), POLICY, row)
        assert workflow.next_step.label == ""
        assert workflow.stations[-1].who == "Olga Operator"
        assert workflow.stations[-1].how == "signed", "the record beside it is not the activation"
        assert audit.find_last_change(session, f"parameter-sets/{turning}").action == "recorded C_SD for"


def test_a_record_beside_the_state_does_not_undo_a_read_back(site, turning):
    recorded(site, turning, "LOADED", "NOT YET")
    advance(site, "VERIFIED", set_id=turning)
    assert recorded(site, turning, "VERIFIED", "LOADED", "Pass 2").status_code == 303
    with open_reading(site.engine) as session:
        row = session.get_known(ParameterSet, turning)
        assert uplinks.explain_why_not_activate(session, site.actor("olga"), row) is None
    advance(site, "ACTIVE", set_id=turning)


def test_sending_again_asks_again(site, turning):
    recorded(site, turning, "LOADED", "LOADED", "Pass 1")
    assert not stays_open(site, turning)
    advance(site, "MISMATCH", "SENT", "LOADED", set_id=turning)
    assert stays_open(site, turning)


def test_over_rest_the_answer_may_be_left_out_and_is_then_not_told(site, turning):
    olga = site.visitor("olga")

    def post(state, **said):
        body = {"parameter_set_id": turning, "onboard_state": state, "source": "Pass 1", **said}
        headers = {"X-CSRF-Token": olga.csrf_token, "If-Match": f'"v{version(site, turning)}"'}
        return olga.send("POST", "/api/v1/uplinks", json=body, headers=headers)

    loaded = post("LOADED")
    assert loaded.status_code == 201
    assert (loaded.json()["c_sd"], loaded.json()["c_sd_said"]) == (None, None)
    assert stays_open(site, turning)
    assert post("LOADED", c_sd="PERHAPS").status_code == 422
    later = post("LOADED", c_sd="NOT NEEDED", c_sd_said="The payload's own alignment is used.")
    assert later.status_code == 201
    assert later.json()["c_sd"] == "NOT NEEDED"
    assert not stays_open(site, turning)


def test_an_answer_before_loading_or_with_another_state_is_refused(site, turning):
    with open_writing(site.engine) as session, pytest.raises(ConflictError):
        uplinks.record(
            session, site.actor("olga"), turning, "UNKNOWN", "Pass 1", c_sd=uplinks.CsdAnswer("LOADED", "Pass 1")
        )
    with open_writing(site.engine) as session, pytest.raises(RefusedInputError):
        uplinks.record(session, site.actor("olga"), turning, "LOADED", "Pass 1", c_sd=uplinks.CsdAnswer("MAYBE"))
