"""The list of parameter sets and the page of one."""

import re
from dataclasses import replace

import pytest

from boresight.cameras import CAMERA_MODELS
from boresight.console.approvals import queries as approval_queries
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.verdicts.gates import parse_report
from boresight.verdicts.gates.judgement import STATUSES
from tests.console.approvals.gates import TIGHT
from tests.console.uplinks.pages import advance
from tests.sites import PASSWORD, answer_points, as_shown, codes, strip_tags, text_of

TURNED = {
    "quaternion": [0.0, 1e-5, 0.0, 1.0],
    "rotation_arcsec": [0.0, 4.1, -1234.5],
    "sigma_arcsec": [0.4, 0.7, None],
    "sigma_of_mean_arcsec": [0.1, 0.1, 0.2],
    "frames": 10,
    "scatter_arcsec": 1.0,
    "noise_arcsec": 2.0,
    "consistent": True,
    "sentence": "Loading these parameters turns the reported attitude by 4.1 ± 0.1 arcsec about y.",
    "c_sd_update": [[1.0, 0.0, -2e-5], [0.0, 1.0, 0.0], [2e-5, 0.0, 1.0]],
}
SIGNED = {"decision": "APPROVE", "meaning": "Good.", "comment": "", "password": PASSWORD}


@pytest.fixture
def candidate(site):
    return site.visitor("ada").post("/runs/1/parameter-set").headers["location"]


def version(page):
    return page.split('name="version" value="')[1].split('"')[0]


def requested(site, place):
    ada = site.visitor("ada")
    return ada.post(f"{place}/submit", version=version(ada.get(place)), reason="Better.").headers["location"]


def tighten(site):
    """Set a limit that blocks whatever moved at all."""
    adele, body = site.visitor("adele"), {"gates": [TIGHT], "reason": "To be tried."}
    headers = {"If-Match": '"v0"', "X-CSRF-Token": adele.csrf_token}
    answer = adele.send("POST", "/api/v1/sensors/1/gate-profiles", json=body, headers=headers)
    assert answer.status_code == 201, answer.text


def promoted(site, place):
    request, alan, olga = requested(site, place), site.visitor("alan"), site.visitor("olga")
    given = SIGNED | answer_points(alan.get(request))
    assert alan.post(f"{request}/sign", version="1", **given).status_code == 303
    said = {"version": version(olga.get(place)), "reason": "The pass of tonight.", "password": PASSWORD}
    assert olga.post(f"{place}/promote", **said).headers["location"] == place
    return olga


@pytest.mark.usefixtures("candidate")
def test_the_list_shows_ground_and_board_as_two_states(site, read):
    text = read(site.visitor("victor").get("/parameter-sets"))
    assert "PS-ST16-1-0" in text
    assert "BASELINE" in text
    assert "CANDIDATE" in text
    assert text.partition("Baseline since")[2].count("NOT SENT") == 2
    assert 'class="empty"' in site.visitor("victor").get("/parameter-sets?state=REJECTED")
    site.visitor("victor").get("/parameter-sets/99", status=404)


def test_a_set_shows_its_values_against_the_baseline_and_where_it_comes_from(site, candidate, read):
    page = site.visitor("victor").get(candidate)
    text = read(page)
    assert "PS-ST16-1-0" in text_of(page, "values-against")
    assert "TS-calibration" in text
    assert "#1 reference" in text
    assert "not-sent" in codes(page)


def test_the_verdict_of_a_set_stands_in_its_head_with_the_worst_warning(site, candidate):
    ada = site.visitor("ada")
    verdict = re.compile('<details class="verdict-fold[^>]*id="verdict".*?</details>', re.DOTALL)
    warning = re.compile(r'<span class="worst">(.*?)</span>\s*<span class="more">', re.DOTALL)
    ground = verdict.search(ada.get("/parameter-sets/1"))[0]
    assert "declared" in ground
    assert "typical spread" in ground
    page = ada.get(candidate)
    head = verdict.search(page)[0]
    assert page.index('id="verdict"') < page.index('id="lineage-title"')
    with open_reading(site.engine) as session:
        report = parse_report(approval_queries.find_newest_report(session, 2).document)
    against = [gate for gate in report.gates if gate.status != "PASS"]
    passing = len(report.gates) - len(against)
    assert f"{passing} of {len(report.gates)} gates pass" in head
    worst = max(
        (gate for gate in against), key=lambda gate: (gate.name in report.blocking, STATUSES.index(gate.status))
    )
    assert as_shown(f"{worst.title}: {worst.sentence}") == strip_tags(warning.search(head)[1]).strip()
    assert head.count("<li") >= len(against)


def test_a_set_leads_with_what_is_wrong_and_what_changes_and_ends_with_the_other_camera_models(site, candidate):
    page = site.visitor("ada").get(candidate)
    order = ("stations", "verdict", "submit-form", "gates", "values-title", "alignment-title")
    order += ("lineage-title", "identity-title", "do-title", "conversions-title")
    places = [page.index(f'id="{name}"') for name in order]
    assert places == sorted(places)
    against, _, passing = page.split('id="gates-title"')[1].split("</section>")[0].partition("<details")
    with open_reading(site.engine) as session:
        report = parse_report(approval_queries.find_newest_report(session, 2).document)
    wrong = {gate.name for gate in report.gates if gate.status != "PASS"}
    assert set(re.findall(r'<tr id="gate-([\w-]+)"', against)) == wrong
    assert len(re.findall(r'<tr id="gate-([\w-]+)"', passing)) == len(report.gates) - len(wrong)
    table = page.split('id="conversions-title"')[1].split("</table>")[0]
    assert table.count('<th scope="row">') == len(CAMERA_MODELS) - 1
    assert re.search(r"brown_conrady.*?no</span>.*?[1-9]\d* *</td>.*?0\.\d+", table, re.DOTALL)


def test_the_page_has_each_act_once_and_a_submission_says_which_gates_stop_it(site, candidate):
    ada = site.visitor("ada")
    acts = re.findall(r"<button[^>]*>([^<]*)", ada.get(candidate).split("<main")[1])
    assert [one for one in acts if "Submit" in one] == ["Submit PS-ST16-1-1 for approval"]
    tighten(site)
    ada.post(f"{candidate}/assess")
    assert "although 1 gate stops it" in text_of(ada.get(candidate), "submit-form")


@pytest.mark.parametrize("page", ["", "/gates"])
def test_a_set_that_a_gate_stops_leads_an_analyst_to_its_recalibration_and_names_one_to_others(site, candidate, page):
    tighten(site)
    site.visitor("ada").post(f"{candidate}/assess")
    steps = [site.visitor(name).get(f"{candidate}{page}").split('class="next-act"')[1] for name in ("ada", "victor")]
    mine, theirs = (step.split("</div>")[0] for step in steps)
    assert 'href="/runs/new?clone=1"' in mine
    assert "href" not in theirs
    assert "Ada Analyst" in theirs


def test_an_approved_set_has_one_promotion_on_its_page_and_its_request_leads_there(site, candidate):
    request, alan, olga = requested(site, candidate), site.visitor("alan"), site.visitor("olga")
    assert alan.post(f"{request}/sign", version="1", **SIGNED, **answer_points(alan.get(request))).status_code == 303
    pages = [olga.get(candidate).split("<main")[1], olga.get(request).split("<main")[1]]
    openers = [re.findall(r'popovertarget="promote"(?! popovertargetaction)', page) for page in pages]
    assert [len(one) for one in openers] == [1, 0]
    assert f'href="{candidate}#promote"' in pages[1].split('class="next-act"')[1].split("</div>")[0]


def test_a_promotion_that_the_server_would_refuse_is_held_with_its_reason(site):
    server, both, olga = site.app.state, site.visitor("both"), site.visitor("olga")
    server.policy = replace(server.policy, four_eyes=False)
    place = both.post("/runs/1/parameter-set").headers["location"]
    request = both.post(f"{place}/submit", version=version(both.get(place)), reason="Alone.").headers["location"]
    assert both.post(f"{request}/sign", version="1", **SIGNED, **answer_points(both.get(request))).status_code == 303
    assert 'popovertarget="promote"' in olga.get(place)
    server.policy = replace(server.policy, four_eyes=True)
    for page in (olga.get(place), olga.get(request)):
        assert "disabled" in page.split('class="next-act"')[1].split("</div>")[0]
        assert "0 of 1 approvals" in text_of(page, "step-held")
        assert 'popovertarget="promote"' not in page
    said = {"version": "3", "reason": "Now.", "password": PASSWORD}
    assert olga.post(f"{place}/promote", **said).status_code == 409


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


def test_a_submission_from_an_old_page_or_none_is_refused_and_keeps_the_reason(site, candidate):
    answer = site.visitor("ada").post(f"{candidate}/submit", version="99", reason="My long reason.")
    assert answer.status_code == 412
    assert "My long reason." in answer.text
    assert site.visitor("ada").post(f"{candidate}/submit", reason="Because.").status_code == 422
    assert 'aria-describedby="submit-blocked"' in site.visitor("victor").get(candidate)


def test_promotion_is_blocked_until_an_approver_has_signed_and_the_submitter_alone_may_withdraw(site, candidate, read):
    requested(site, candidate)
    ada, olga = site.visitor("ada"), site.visitor("olga")
    page = olga.get(candidate)
    assert 'id="promote-blocked"' in page
    assert 'id="withdraw-blocked"' in page
    said = {"version": "2", "reason": "Now.", "password": PASSWORD}
    assert olga.post(f"{candidate}/promote", **said).status_code == 409
    ada.post(f"{candidate}/withdraw", version=version(ada.get(candidate)))
    assert "WITHDRAWN" in read(ada.get(candidate))


def test_an_approved_set_becomes_the_baseline_and_the_former_offers_a_roll_back(site, candidate, read):
    olga = promoted(site, candidate)
    assert re.search("baseline; .* PS-ST16-1-0", text_of(olga.get(candidate), "values-against"))
    with open_reading(site.engine) as session:
        assert set_queries.find_baseline(session, 1).name == "PS-ST16-1-1"
        assert session.get_known(ParameterSet, 1).ground_state == "SUPERSEDED"
    page = olga.get("/parameter-sets/1")
    assert 'action="/parameter-sets/1/roll-back"' in page
    back = olga.post("/parameter-sets/1/roll-back", version=version(page), reason="The new one lost stars.")
    text = read(site.visitor("alan").get(back.headers["location"]))
    assert "The new one lost stars." in text


@pytest.fixture
def set_with(engine, blobs, people, finished_run):
    def make(**result):
        with open_writing(engine) as session:
            run = finished_run(session, people["ana"].user_id, **result)
            return parameter_sets.create_from_run(session, people["ana"], blobs, run.id)

    return make


def test_a_set_carries_the_alignment_of_its_run_in_its_hash_or_none(set_with):
    row = set_with(alignment=TURNED)
    assert row.document["alignment"] == TURNED
    assert row.sha256 == compute_sha256(row.document)
    assert row.sha256 != compute_sha256(row.document | {"alignment": TURNED | {"frames": 11}})
    assert set_with().document["alignment"] is None  # a result from before alignments were found


@pytest.fixture
def submit_with(site, results):
    def place(alignment):
        run = site.add_run("batch", state="SUCCEEDED", result={**results["batch"], "alignment": alignment})
        return site.visitor("ada").post(f"/runs/{run}/parameter-set").headers["location"]

    return place


def test_the_page_of_a_set_and_of_its_request_show_rotation_uncertainty_and_update_before_the_signature(
    site, submit_with, read
):
    place = submit_with(TURNED)
    for address in (place, requested(site, place)):
        page = site.visitor("alan").get(address)
        text = read(page)
        assert TURNED["sentence"] in text
        assert "10 frames" in text
        assert strip_tags(page.split('data-axis="y"')[1].split("</tr>")[0]).endswith("4.1 0.1 0.7 arcsec")
        assert "0.000020000" in text
        assert "old C_SD × this matrix" in text
    page = site.visitor("alan").get(address)
    assert page.index('id="change-title"') < page.index('id="alignment-title"') < page.index('id="sign-title"')


def test_a_rotation_that_changes_through_the_set_is_a_caution(site, submit_with):
    def notices(alignment):
        return site.visitor("victor").get(submit_with(alignment)).count('class="notice notice-caution"')

    assert notices(TURNED | {"consistent": False}) == notices(TURNED) + 1


def test_a_set_without_one_says_why(site, submit_with):
    assert "run-without-alignment" in codes(site.visitor("victor").get(submit_with(None)))
    assert "set-without-run" in codes(site.visitor("victor").get("/parameter-sets/1"))


def test_from_promotion_to_active_the_pages_say_in_full_that_the_attitude_turns_and_lead_to_the_update(
    site, submit_with
):
    place = submit_with(TURNED)
    number = int(place.rsplit("/", 1)[1])
    assert "attitude-turn" not in codes(site.visitor("olga").get(place))
    olga = promoted(site, place)
    for states in ((), ("SENT",), ("LOADED", "VERIFIED", "ACTIVE")):
        advance(site, *states, set_id=number)
        for address in (place, f"{place}/uplink"):
            page = olga.get(address)
            said = re.search(r'data-code="attitude-turn".*?</div>', page, re.DOTALL)[0]
            assert TURNED["sentence"] in said
            assert f'href="{place}#alignment-title"' in said
    assert 'popovertarget="c-sd"' in page.split('class="next-act"')[1].split("</div>")[0]
    small = TURNED | {"rotation_arcsec": [0.0, 0.1, 0.1], "frames": 12}
    assert "attitude-turn" not in codes(olga.get(f"{submit_with(small)}/uplink"))


def test_a_baseline_that_was_calibrated_itself_is_a_caution_for_the_next(site, submit_with):
    olga = promoted(site, submit_with(TURNED))
    assert "incumbent-calibrated" in codes(olga.get(submit_with(TURNED | {"frames": 11})))
