"""A dialog names the consequences of its act, and the server asks for what the dialog asks."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading
from tests.console.uplinks.pages import advance, define, version
from tests.console.uplinks.test_update_of_c_sd import send_turning
from tests.sites import PASSWORD, answer_points

STEPS = "/parameter-sets/1/uplink"
TEMPLATES = Path(__file__).resolve().parents[3] / "frontend" / "templates"
TOKENS = re.compile(r"{% call\b[^%]*?(?P<call>\w+)\(|(?P<end>{% endcall %})|(?P<form><form\b(?:{{.*?}}|[^>])*>)")
OPENS = re.compile(r"\b(?:act_dialog|change_dialog|decision_buttons)\(")
#: Addresses of forms without a dialog: what they do can be done again, undone, or adds only a record of what somebody typed.
WITHOUT_DIALOG = """
    * /alarms/*/* /alignments/new /approvals/*/assign /approvals/*/remarks /approvals/*/threads /approvals/*/threads/*/*
    /audit/anchors /campaigns/*/cancel /campaigns/*/launch-failed /campaigns/new* /favourites /import-profiles
    /import-profiles/*/archive /login /login/second-factor /logout /notes/*/* /parameter-sets/*/assess /parameter-sets/*/submit
    /parameter-sets/*/uplink/package /password /preferences /preferences/messages /preferences/messages/*
    /preferences/messages/*/try /presets/*/archive /runs/*/cancel /runs/*/choice /runs/batch /runs/new /runs/new* /saved-views
    /saved-views/*/remove /second-factor/begin /second-factor/enrol /sensors /sensors/* /sensors/*/annotations /sensors/*/ingest
    /sensors/*/ingest/rehearse /sensors/*/plan /sensors/propose /sessions/*/end /sessions/end-others /telemetry
    /telemetry/*/accept-as-new-sensor /telemetry/*/accept-mapping /telemetry/*/accept-sensor /telemetry/*/archive
    /telemetry/*/diagnose /users /users/*/enable /users/*/end-sessions /users/*/password /users/*/roles /users/keys /webhooks
    /webhooks/*/deliveries/*/redeliver /webhooks/*/enable /webhooks/*/try
"""


def dialogs(page):
    return dict(re.findall(r'<dialog id="([^"]*)" class="panel act-dialog"(.*?)</dialog>', page, re.DOTALL))


def list_forms_without_dialog(text: str) -> Iterator[str]:
    """Yield the addresses of a template's forms that are neither in the dialog of an act nor hold one."""
    calls = []
    for token in TOKENS.finditer(text):
        if token["call"]:
            calls.append(token["call"])
        elif token["end"]:
            calls.pop()
        elif 'method="post"' in token["form"]:
            address = re.search(r' action="((?:{{.*?}}|[^"])*)"', token["form"])[1]
            inside = text[token.end() :].partition("</form>")[0]
            if "act_dialog" not in calls and not OPENS.search(inside):
                yield re.split(r"[?#]", re.sub(r"{{.*?}}", "*", address))[0]


def test_no_form_of_an_act_that_cannot_be_taken_back_is_without_its_dialog():
    found = {one for path in TEMPLATES.rglob("*.html") for one in list_forms_without_dialog(path.read_text())}
    assert found == set(WITHOUT_DIALOG.split())


@pytest.fixture
def approved(site):
    ada, alan = site.visitor("ada"), site.visitor("alan")
    place = ada.post("/runs/1/parameter-set").headers["location"]
    seen = ada.get(place).split('name="version" value="')[1].split('"')[0]
    request = ada.post(f"{place}/submit", version=seen, reason="Lower RMS.").headers["location"]
    signed = {"decision": "APPROVE", "meaning": "Read.", "comment": "", "password": PASSWORD, "version": "1"}
    page = alan.get(request)
    shown, signed = dialogs(page)["approve"], signed | answer_points(page)
    assert alan.post(f"{request}/sign", **signed).status_code == 303
    return place, request, shown


def test_a_dialog_on_a_set_names_sensor_old_and_new_set_what_changes_most_and_what_stays(site, approved):
    place, _, approving = approved
    olga = site.visitor("olga")
    for shown in (approving, dialogs(olga.get(place))["promote"]):
        words = " ".join(re.sub(r"<[^>]+>", " ", shown).split())
        assert re.search(r"Sensor ST16-1 .*PS-ST16-1-0 .*PS-ST16-1-1", words)
        assert "Cannot be undone" in words
        worth = [abs(float(one.replace("−", "-"))) for one in re.findall(r'<td class="num">([−\d.]+)</td></tr>', shown)]
        assert len(worth) == 4
        assert worth == sorted(worth, reverse=True)


def test_no_key_answers_a_dialog_whose_answer_stays_and_no_answer_of_several_stands_out(site, results):
    place = f"/parameter-sets/{send_turning(site, results)}/uplink"
    shown = dialogs(site.visitor("olga").get(place)) | dialogs(site.visitor("olga").get(STEPS))
    sending = {name: re.findall(r"<button(?! type=)([^>]*)>", text) for name, text in shown.items()}
    assert {name for name, buttons in sending.items() if " disabled" not in buttons[0]} == set()
    several = {name: buttons[1:] for name, buttons in sending.items() if len(buttons) > 2}
    assert several.keys() == {"record-loaded"}
    assert [button for button in several["record-loaded"] if "button-primary" in button] == []


def state_of(site, set_id=2):
    with open_reading(site.engine) as session:
        return session.get_known(ParameterSet, set_id).ground_state


def test_a_promotion_on_a_page_needs_a_reason_and_the_password_and_keeps_what_was_typed(site, approved):
    place, _, _ = approved
    olga = site.visitor("olga")
    seen = olga.get(place).split('name="version" value="')[1].split('"')[0]
    for said, status in (
        ({"reason": " ", "password": PASSWORD}, 422),
        ({"reason": "Tonight.", "password": "guess"}, 401),
    ):
        answer = olga.post(f"{place}/promote", version=seen, **said)
        assert answer.status_code == status
        assert " open" in dialogs(answer.text)["promote"].split(">")[0]
        assert said["reason"] in answer.text
        assert state_of(site) == "APPROVED"
    assert olga.post(f"{place}/promote", version=seen, reason="Tonight.", password=PASSWORD).status_code == 303
    with open_reading(site.engine) as session:
        assert set_queries.list_promotions(session, 1)[0].reason == "Tonight."


def test_the_password_of_a_promotion_is_a_setting(site, approved):
    place, _, _ = approved
    server = site.app.state
    server.policy = replace(server.policy, promotion_password=False)
    olga = site.visitor("olga")
    page = olga.get(place)
    assert 'id="promote-password"' not in page
    seen = page.split('name="version" value="')[1].split('"')[0]
    assert olga.post(f"{place}/promote", version=seen, reason="Tonight.").status_code == 303


@pytest.mark.parametrize(
    ("asked", "status"), [({}, 200), ({"promotion_reason": True}, 422), ({"rest_review": True}, 422)]
)
@pytest.mark.usefixtures("approved")
def test_over_rest_a_reason_is_needed_where_the_installation_says_so_and_the_record_says_what_was_given(
    site, asked, status
):
    server, olga = site.app.state, site.visitor("olga")
    server.policy = replace(server.policy, **asked)
    headers = {"If-Match": '"v3"', "X-CSRF-Token": olga.csrf_token}
    assert olga.send("POST", "/api/v1/parameter-sets/2:promote", headers=headers).status_code == status
    if status == 200:
        with open_reading(site.engine) as session:
            record = next(
                one for one in audit.list_records(session, subject="parameter-sets/2") if one.action == "promoted"
            )
        assert (record.after["reason_given"], record.after["password_given"]) == (False, False)


def test_nothing_is_preselected_on_a_record_and_the_expected_crc_is_shown_after_the_told_one(site):
    define(site)
    olga = site.visitor("olga")
    assert olga.post(f"{STEPS}/package").status_code == 303
    page = olga.get(STEPS)
    assert set(dialogs(page)) == {"record-sent"}
    assert not re.search(
        r"<(option|input)[^>]* (selected|checked)>", page.partition("<main")[2].partition("</main>")[0]
    )
    advance(site, "SENT", "LOADED")
    page = olga.get(STEPS)
    assert {"compare", "record-mismatch", "record-unknown"} == set(dialogs(page))
    comparing = " ".join(re.sub(r"<[^>]+>", " ", dialogs(page)["compare"]).split())
    assert re.search(r"Sensor ST16-1 .*PS-ST16-1-0 .*Cannot be undone.*VERIFIED.*MISMATCH", comparing)
    assert not re.search(r"0x[0-9A-F]{4}\b", page)
    refused = olga.post(f"{STEPS}/read-back", crc="nothing", source="TM 1", version=version(site))
    assert refused.status_code == 422
    assert not re.search(r"0x[0-9A-F]{4}\b", refused.text)
    assert olga.post(f"{STEPS}/read-back", crc="0", source="TM 1", version=version(site)).status_code == 303
    assert re.search(r"0x[0-9A-F]{4}\b", olga.get(STEPS))
