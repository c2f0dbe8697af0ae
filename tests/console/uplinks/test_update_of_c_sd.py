"""Whether the update of C_SD was loaded with a set that turns the attitude: asked, recorded, and missed where it is not."""

import re

import pytest

from boresight.console.fleet import queries as fleet_rows
from boresight.console.fleet import timeline
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks import queries as uplink_rows
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.stations import make_workflow
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.actors import POLICY
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.platform.web.text_validation import LONGEST_TEXT
from tests.console.parameter_sets.test_pages import TURNED, promoted
from tests.console.uplinks.pages import advance, version
from tests.sites import codes


@pytest.fixture
def turning(site, results):
    return send_turning(site, results)


def send_turning(site, results):
    """Make a set whose loading turns the attitude the baseline, and record that it was sent."""
    run = site.add_run("batch", state="SUCCEEDED", result={**results["batch"], "alignment": TURNED})
    place = site.visitor("ada").post(f"/runs/{run}/parameter-set").headers["location"]
    promoted(site, place)
    set_id = int(place.rpartition("/")[2])
    advance(site, "SENT", set_id=set_id)
    return set_id


def recorded(site, set_id, state, answer=None, said="", source="Pass 1"):
    visitor = site.visitor("olga")
    form = {"onboard_state": state, "source": source, "version": version(site, set_id), "c_sd_said": said}
    form |= {} if answer is None else {"c_sd": answer}
    return visitor.post(f"/parameter-sets/{set_id}/uplink/record", **form)


def posted(site, set_id, state, **said):
    olga = site.visitor("olga")
    body = {"parameter_set_id": set_id, "onboard_state": state, "source": "Pass 1", **said}
    headers = {"X-CSRF-Token": olga.csrf_token, "If-Match": f'"v{version(site, set_id)}"'}
    return olga.send("POST", "/api/v1/uplinks", json=body, headers=headers)


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


@pytest.mark.parametrize(
    ("states", "place"),
    [
        (["SENT"], "record-loaded"),
        (["SENT", "LOADED"], "c-sd"),
        (["SENT", "MISMATCH"], "c-sd"),
        (["SENT", "LOADED", "UNKNOWN"], "record-loaded"),
    ],
)
def test_the_page_asks_in_one_place_in_every_state(site, turning, states, place):
    for state in states[1:]:
        recorded(site, turning, state, "NOT YET" if state == "LOADED" else None)
    page = site.visitor("olga").get(f"/parameter-sets/{turning}/uplink")
    assert re.search(r"<small>on board</small>.*?<span>(\w+)</span></span>", page, re.DOTALL)[1] == states[-1]
    dialogs = re.findall(r'<dialog id="([\w-]+)".*?</dialog>', page, re.DOTALL)
    asking = [one for one in dialogs if 'name="c_sd"' in page.split(f'<dialog id="{one}"')[1].split("</dialog>")[0]]
    assert asking == [place]
    if states[-1] == "UNKNOWN":
        assert posted(site, turning, "UNKNOWN", c_sd="LOADED", c_sd_said="TC 7").status_code == 201
        assert recorded(site, turning, "LOADED").status_code == 303, "it was told, and is not asked again"
        assert not stays_open(site, turning)


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
    loaded = posted(site, turning, "LOADED")
    assert loaded.status_code == 201
    assert (loaded.json()["c_sd"], loaded.json()["c_sd_said"]) == (None, None)
    assert stays_open(site, turning)
    assert posted(site, turning, "LOADED", c_sd="PERHAPS").status_code == 422
    later = posted(site, turning, "LOADED", c_sd="NOT NEEDED", c_sd_said="The payload's own alignment is used.")
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


LONG = "é" * LONGEST_TEXT


def test_a_text_that_stays_has_at_most_as_many_characters_as_a_page_can_show(site, turning):
    assert recorded(site, turning, "LOADED", "LOADED", LONG + "é").status_code == 422
    refused = recorded(site, turning, "LOADED", "LOADED", LONG, source=LONG + "é")
    assert (refused.status_code, "text-too-long" in codes(refused.text)) == (422, True)
    for name in ("source", "c_sd_said"):
        assert (
            posted(site, turning, "LOADED", **{"c_sd": "LOADED", "c_sd_said": "TC 7", name: LONG + "é"}).status_code
            == 422
        )
    assert recorded(site, turning, "LOADED", "LOADED", LONG, source=LONG).status_code == 303


@pytest.mark.parametrize("state", ["UNKNOWN", "MISMATCH"])
def test_a_board_that_is_not_known_or_differs_asks_again(site, turning, state):
    recorded(site, turning, "LOADED", "LOADED", "Pass 1")
    advance(site, state, set_id=turning)
    assert stays_open(site, turning)
    assert recorded(site, turning, state, "LOADED", "Pass 2").status_code == 303
    assert not stays_open(site, turning), "what is told of it in that state holds"


def test_the_update_of_another_set_takes_the_place_of_that_of_before_and_the_way_back_is_asked_too(site, results):
    advance(site, "SENT", "LOADED", "UNKNOWN")
    turning = send_turning(site, results)
    assert recorded(site, turning, "LOADED", "NOT YET").status_code == 303
    assert not stays_open(site, 1), "no other C_SD is on board"
    assert recorded(site, turning, "LOADED", "LOADED", "Pass 2").status_code == 303
    assert (stays_open(site, 1), stays_open(site, turning)) == (True, False)
    assert "c-sd-of-before" in codes(site.visitor("olga").get("/parameter-sets/1/uplink"))
    assert recorded(site, 1, "LOADED").status_code == 422
    assert recorded(site, 1, "LOADED", "LOADED", "Pass 3, the former C_SD").status_code == 303
    assert (stays_open(site, 1), stays_open(site, turning)) == (False, True)


def test_a_record_of_c_sd_is_no_step_for_whoever_reads_steps(site, turning):
    recorded(site, turning, "LOADED", "NOT YET")
    with open_reading(site.engine) as session:
        step = uplink_rows.find_newest_record(session, turning)
    record = posted(site, turning, "LOADED", c_sd="LOADED", c_sd_said="TC 9", source="Pass 9").json()
    assert record["is_step"] is False
    with open_reading(site.engine) as session:
        row = session.get_known(ParameterSet, turning)
        loaded = make_workflow(session, site.actor("olga"), POLICY, row).stations[7]
        assert (loaded.at_utc, loaded.source) == (step.recorded_utc, step.source)
        assert audit.find_last_change(session, f"parameter-sets/{turning}").action == "recorded C_SD for"
        marks = [one.onboard_state for one, _ in fleet_rows.list_records(session, [1])[1]]
        assert marks == ["SENT", "LOADED"]
        later = fleet_rows.list_records_after(session, 1, "2000-01-01T00:00:00.000000Z")
        assert [one.onboard_state for _, one in later] == marks
        shown = [one.state for one in timeline.list_events(session, 1) if one.kind == "uplink"]
        assert shown == [None, "LOADED", "SENT"]


def test_a_wrong_answer_is_corrected_on_the_page(site, turning):
    recorded(site, turning, "LOADED", "LOADED", "Pass 1")
    page = site.visitor("olga").get(f"/parameter-sets/{turning}/uplink")
    assert 'name="c_sd"' in page.split('id="c-sd"')[1].split("</dialog>")[0]
    assert recorded(site, turning, "LOADED", "NOT YET").status_code == 303
    assert stays_open(site, turning)


def test_what_a_record_would_not_keep_is_refused(site, turning):
    assert posted(site, turning, "LOADED", c_sd_said="TC 7").status_code == 422
    assert posted(site, turning, "LOADED").status_code == 201
    assert posted(site, turning, "LOADED", c_sd="LOADED", c_sd_said="TC 7", package_id=1).status_code == 422
