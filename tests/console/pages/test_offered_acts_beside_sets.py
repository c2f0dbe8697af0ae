"""What pages of alarms, alignments, change proposals and ingest offer to whom is what the server would accept, in each state."""

from dataclasses import dataclass, replace
from typing import Any

import pytest

from boresight.console.alarms import service as alarms
from boresight.console.change_proposals import service as proposals
from boresight.console.ingest.service import supersede_overtaken
from boresight.console.ingest.tables import ANSWERS
from boresight.platform.db.sessions import open_writing, utc_after
from tests.console.alarms.alarms import alarm as raise_alarm
from tests.console.alignments.pairs import aligned, aligned_well
from tests.console.approvals.gates import TIGHT
from tests.console.change_proposals.proposals import proposed
from tests.console.ingest.decisions import draft, received, step, with_alternatives
from tests.console.pages.offers import REASON, Offers, is_accepted
from tests.console.telemetry.test_imports import PROFILE
from tests.served import PASSWORD, PEOPLE

DAY_S = 86400.0
SIGNED = {"meaning": "Read.", "comment": REASON, "password": PASSWORD}


@dataclass(frozen=True)
class Act:
    """An act as REST has it: on which address, with what."""

    address: str
    body: dict[str, Any] | None = None
    version: int | None = None


def holds(house, state, page, acts):
    """Hold that of some acts, by the forms that make them, a page offers each person those that the server accepts."""
    for name in PEOPLE:
        client = house.person(name)
        shown = client.get(page, headers={"Accept": "text/html"})
        assert shown.status_code == 200, shown.text
        offered = {
            " ".join(
                [place.partition("#")[0], *(fields[key] for key in ("action", "answer", "decision") if key in fields)]
            )
            for place, fields in Offers(shown.text).reachable()
        }
        accepted = {form for form, act in acts.items() if _is_accepted(client, form, act)}
        pages = offered & set(acts)
        assert pages == accepted, f"{state}, {name}: offered {pages - accepted}, hidden {accepted - pages}"


def _is_accepted(client, form, act):
    options = {} if act.body is None else {"json": act.body}
    headers = {} if act.version is None else {"If-Match": f'"v{act.version}"'}
    answer = client.post(f"/api/v1/{act.address}", params={"validate_only": "true"}, headers=headers, **options)
    return is_accepted(form, answer)


def _read(house, address):
    return house.person("ada").get(f"/api/v1/{address}").json()


def _do(house, who, act):
    headers = {} if act.version is None else {"If-Match": f'"v{act.version}"'}
    answer = house.person(who).post(f"/api/v1/{act.address}", json=act.body, headers=headers)
    assert answer.status_code < 300, answer.text
    return answer.json()


def _of_alarm(house, alarm_id, days=5):
    verbs = {
        "acknowledge": {"text": REASON},
        "comment": {"text": REASON},
        "shelve": {"until_utc": utc_after(days * DAY_S), "reason": REASON},
        "unshelve": None,
        "assign": {"user_id": 1},
    }
    seen = _read(house, f"alarms/{alarm_id}")["version"]
    return {f"/alarms/{alarm_id}/{verb}": Act(f"alarms/{alarm_id}:{verb}", body, seen) for verb, body in verbs.items()}


def test_the_page_of_an_alarm_offers_what_the_server_accepts(house, monkeypatch):
    row = raise_alarm(house)
    page = f"/alarms/{row['id']}"

    def held(state):
        holds(house, state, page, _of_alarm(house, row["id"]))

    def act(verb):
        _do(house, "olga", _of_alarm(house, row["id"], days=1)[f"{page}/{verb}"])

    held("unacknowledged")
    act("shelve")
    held("shelved")
    monkeypatch.setattr(alarms, "utc_now", lambda: utc_after(2 * DAY_S))
    held("its shelving is over")
    monkeypatch.undo()
    act("acknowledge")
    held("acknowledged and shelved")
    act("unshelve")
    held("acknowledged")
    (on_board,) = _read(house, f"parameter-sets?sensor_id={row['sensor_id']}")["items"]
    sent = {"parameter_set_id": on_board["id"], "onboard_state": "SENT", "source": "Pass 2"}
    _do(house, "olga", Act("uplinks", sent, on_board["version"]))
    assert _read(house, f"alarms/{row['id']}")["state"] == "closed"
    held("closed")


def _of_proposal(house, proposal_id):
    seen = _read(house, f"change-proposals/{proposal_id}")["version"]
    verbs = {"confirm": {"comment": REASON}, "refuse": {"comment": REASON}, "withdraw": None}
    return {
        f"/change-proposals/{proposal_id}/decide {verb}": Act(f"change-proposals/{proposal_id}:{verb}", body, seen)
        for verb, body in verbs.items()
    }


@pytest.mark.parametrize("who", ["ada", "adele"])
def test_the_page_of_a_proposal_offers_what_the_server_accepts(house, monkeypatch, who):
    first, second = proposed(house, who)["id"], proposed(house, who)["id"]

    def held(state, number):
        holds(house, state, f"/change-proposals/{number}", _of_proposal(house, number))

    held("OPEN", first)
    other = "ada" if who == "adele" else "adele"
    _do(house, other, _of_proposal(house, first)[f"/change-proposals/{first}/decide confirm"])
    held("CONFIRMED", first)
    _do(house, who, _of_proposal(house, second)[f"/change-proposals/{second}/decide withdraw"])
    held("WITHDRAWN", second)
    third = proposed(house, who)["id"]
    # Last, for the server lets every proposal expire that it meets meanwhile.
    monkeypatch.setattr(proposals, "utc_now", lambda: utc_after(31 * DAY_S))
    held("its time is over", third)


@pytest.fixture
def second_person_is(house):
    state, before = house.app.state, house.app.state.policy

    def choose(asked):
        state.policy = replace(before, second_person=asked)

    yield choose
    state.policy = before


@pytest.mark.parametrize("second_person", [False, True])
def test_the_pages_of_limits_and_layouts_offer_a_change_to_whom_the_server_accepts_it_from(
    house, second_person_is, second_person
):
    second_person_is(second_person)
    sensor_id = house.new_sensor()["id"]
    place = f"/sensors/{sensor_id}"
    layout = _read(house, f"change-proposals/{proposed(house)['id']}")["document"]
    limits = Act(f"sensors/{sensor_id}/gate-profiles", {"gates": [TIGHT], "reason": REASON}, 0)
    fields = Act(f"sensors/{sensor_id}/table-definitions", {"document": layout, "reason": REASON}, 0)
    holds(house, "limits", f"{place}/gates", {f"{place}/gates set": limits})
    holds(house, "layout", f"{place}/table-definition", {f"{place}/table-definition set": fields})


def _of_alignment(house, alignment_id):
    place = f"/alignments/{alignment_id}"
    acts = {f"{place}/submit": Act(f"alignments/{alignment_id}:submit", {"reason": REASON})}
    for one in _read(house, f"alignments/{alignment_id}/requests")["items"]:
        name, seen = f"alignment-requests/{one['id']}", one["version"]
        acts |= {
            f"/{name}/sign APPROVE": Act(f"{name}:approve", SIGNED, seen),
            f"/{name}/sign REFUSE": Act(f"{name}:refuse", SIGNED, seen),
            f"/{name}/withdraw": Act(f"{name}:withdraw", {"reason": REASON}, seen),
        }
    return acts


def test_the_page_of_an_alignment_offers_what_the_server_accepts(house):
    row = aligned_well(house)
    page = f"/alignments/{row['id']}"

    def held(state):
        holds(house, state, page, _of_alignment(house, row["id"]))

    def submit(who):
        number = _do(house, who, _of_alignment(house, row["id"])[f"{page}/submit"])["id"]
        return lambda name, act: _do(
            house, name, _of_alignment(house, row["id"])[f"/alignment-requests/{number}/{act}"]
        )

    held("not submitted")
    act = submit("ada")
    held("OPEN")
    act("adele", "withdraw")
    held("WITHDRAWN")
    act = submit("bo")
    held("OPEN, by somebody who signs")
    act("alan", "sign REFUSE")
    held("REJECTED")
    submit("ada")("alan", "sign APPROVE")
    held("APPROVED")


def test_the_page_of_an_alignment_that_a_gate_blocks_offers_what_the_server_accepts(house):
    row = aligned(house)
    holds(house, "blocked", f"/alignments/{row['id']}", _of_alignment(house, row["id"]))


def test_the_form_of_an_alignment_is_offered_to_whom_the_server_accepts_it_from(house):
    runs = {"run_a_id": house.finished(), "run_b_id": house.finished()}
    holds(house, "new", "/alignments/new", {"/alignments/new": Act("alignments", runs)})


def _of_policy(house, row):
    place, reason = f"/sensors/{row['sensor_id']}/ingest", {"reason": REASON}
    verbs = {"rehearse": None, "enable": None, "pause": reason, "resume": reason, "switch-off": reason}
    seen = _read(house, f"ingest-policies/{row['id']}")["version"]
    new = {"sensor_id": row["sensor_id"], "rules": {}, "reason": REASON}
    return {place: Act("ingest-policies", new)} | {
        f"{place}/{verb}": Act(f"ingest-policies/{row['id']}:{verb}", body, seen) for verb, body in verbs.items()
    }


def test_the_page_of_a_policy_offers_what_the_server_accepts(house):
    row = draft(house, house.new_sensor()["id"])

    def held(state):
        holds(house, state, f"/sensors/{row['sensor_id']}/ingest", _of_policy(house, row))

    held("DRAFT")
    row = step(house, row, "rehearse")
    held("rehearsed")
    row = step(house, row, "enable", "adele")
    held("ACTIVE")
    row = step(house, row, "pause", "olga", reason=REASON)
    held("PAUSED")
    row = step(house, row, "switch-off", "olga", reason=REASON)
    held("OFF")


def test_a_rehearsed_policy_whose_profile_was_archived_is_offered_as_the_server_accepts_it(house):
    profile = _do(house, "ada", Act("import-profiles", {**PROFILE, "name": "of-one-policy"}))
    row = step(house, draft(house, house.new_sensor()["id"], profile=profile["name"]), "rehearse")
    ada = house.person("ada")
    archived = ada.post(f"/import-profiles/{profile['id']}/archive", data={"csrf_token": ada.headers["X-CSRF-Token"]})
    assert archived.status_code == 303
    holds(house, "its profile archived", f"/sensors/{row['sensor_id']}/ingest", _of_policy(house, row))


def _of_decision(house, decision_id):
    seen = _read(house, f"ingest-decisions/{decision_id}")["version"]
    return {
        f"/ingest/{decision_id}/answer {one}": Act(
            f"ingest-decisions/{decision_id}:answer", {"answer": one, "reason": REASON}, seen
        )
        for one in ANSWERS
    }


def test_the_page_of_a_decision_offers_what_the_server_accepts(house):
    row = received(house)
    holds(house, "CALIBRATING", f"/ingest/{row['id']}", _of_decision(house, row["id"]))
    row = with_alternatives(house)
    acts, page = _of_decision(house, row["id"]), f"/ingest/{row['id']}"
    holds(house, "ASKED", page, acts)
    prepared = _read(house, f"parameter-sets/{row['parameter_set_id']}")
    act = Act(f"parameter-sets/{prepared['id']}:submit", {"reason": REASON}, prepared["version"])
    _do(house, "bo", act)
    holds(house, "its set was submitted on its own page", page, acts)
    _do(house, "ada", acts[f"{page}/answer WAIT"])
    holds(house, "ANSWERED", page, _of_decision(house, row["id"]))
    row = with_alternatives(house)
    with open_writing(house.app.state.engine) as session:
        supersede_overtaken(session, row["id"])
    holds(house, "SUPERSEDED", f"/ingest/{row['id']}", _of_decision(house, row["id"]))
