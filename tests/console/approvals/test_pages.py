"""The inbox and the page of a request."""

import html
import re

import pytest

from boresight.calibration.parameter_set import ParameterSetDocument
from boresight.console.approvals import gate_profiles, review
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
from boresight.console.approvals.pages.gates import ONLY_WAIVERS
from boresight.console.approvals.review import warn_of_shifts, warn_of_turn
from boresight.console.approvals.tables import Approval
from boresight.console.help.glossary import terms_of_parameters
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.db.sessions import open_reading, open_writing, utc_now
from boresight.verdicts.numbers import duration
from tests.sites import PASSWORD, answer_points, as_shown, codes, strip_tags, text_of

WORDS = {"decision": "APPROVE", "meaning": "I approve this set for baseline.", "comment": "Read all of it."}


@pytest.fixture
def request_page(site):
    return submitted(site, "ada", 1)


def submitted(site, name, run_id):
    person = site.visitor(name)
    place = person.post(f"/runs/{run_id}/parameter-set").headers["location"]
    version = person.get(place).split('name="version" value="')[1].split('"')[0]
    return person.post(f"{place}/submit", version=version, reason="The held-out RMS fell.").headers["location"]


def signed(visitor, request_page, action="sign", **given):
    form = {"version": "1", "password": PASSWORD, **WORDS, **answer_points(visitor.get(request_page)), **given}
    return visitor.post(f"{request_page}/{action}", **form)


def test_the_inbox_says_what_waits_and_separates_what_is_mine_to_sign(site, read):
    assert 'class="empty"' in site.visitor("alan").get("/approvals")
    submitted(site, "ada", 1)
    assert "The held-out RMS fell." in read(site.visitor("both").get("/approvals"))
    for address in ("/approvals", "/approvals?show=mine"):
        assert 'data-to-sign="1"' in site.visitor("alan").get(address)
    assert 'class="empty"' in site.visitor("ada").get("/approvals?show=mine")


def test_the_request_is_read_from_what_stands_against_it_to_the_views_beside_the_panel(site, request_page, read):
    page = site.visitor("alan").get(request_page)
    order = ("warnings", "gates", "change", "views", "discussion", "signed", "sign")
    places = [page.index(f'id="{name}-title"') for name in order]
    assert places == sorted(places)
    against, _, passing = page.split('id="gates-title"')[1].split('id="change-title"')[0].partition("gates pass")
    assert (against.count("<tr id="), 'id="gate-quantisation"' in against) == (1, True)
    assert passing.count("<tr id=") > 1
    for name in ("convergence", "rms", "radial", "observability"):
        assert f'src="/api/v1/approvals/1/figures/{name}"' in page
    assert "Approve PS-ST16-1-1 for baseline" in read(page)
    assert "Refuse PS-ST16-1-1" in read(page)


def test_who_cannot_sign_reads_the_points_and_who_can_and_ticks_only_for_a_second_person(site, request_page):
    page = site.visitor("ada").get(request_page)
    own, _, of_another = page.split('id="sign"')[1].partition("A second person signs here")
    assert 'name="tick:' not in own
    assert own.count('class="point"') == of_another.count('name="tick:')
    assert "sign</li>" in page.split('aria-current="step"')[1][:400], "the next station is a thing to do"
    assert "Alan Approver" in page.split('id="who-may-sign"')[1].split("</details>")[0]
    assert (
        'name="tick:'
        in site.visitor("alan").get(request_page).split('id="sign"')[1].partition("A second person signs here")[0]
    )


def test_an_approval_that_leaves_a_point_open_is_refused_by_its_name_and_its_words_are_kept(site, request_page):
    alan = site.visitor("alan")
    given = answer_points(alan.get(request_page))
    gate = next(name for name in given if name.startswith("tick:gate:"))
    for missing, changed in ((gate, {}), (gate.replace("tick", "reason", 1), {gate.replace("tick", "reason", 1): " "})):
        form = {name: value for name, value in given.items() if name != missing} | changed
        refused = alan.post(f"{request_page}/sign", version="1", password=PASSWORD, **WORDS, **form)
        assert refused.status_code == 422
        assert "Known and accepted." in refused.text
    with open_reading(site.engine) as session:
        assert session.get_known(Approval, 1).state == "OPEN"


def test_a_signature_lands_on_its_confirmation_and_stands_in_the_roll_with_its_reasons(site, request_page, read):
    alan = site.visitor("alan")
    answer = signed(alan, request_page)
    assert answer.headers["location"] == f"{request_page}/signatures/1"
    page = alan.get(answer.headers["location"])
    confirmed = read(page)
    for words in ("Alan Approver", "I approve this set for baseline.", "now APPROVED", "Olga Operator"):
        assert words in confirmed
    assert re.search(r'id="audit-record">#\d+<', page)
    text = read(site.visitor("victor").get(request_page))
    for words in ("Alan Approver", "APPROVE", "Read all of it.", "Known and accepted.", "not opened Radial difference"):
        assert words in text
    site.visitor("victor").get(f"{request_page}/signatures/9", status=404)


def test_a_figure_given_to_a_person_is_opened_by_that_person_and_needs_no_reason(site, request_page, monkeypatch):
    monkeypatch.setattr(approvals, "SHOWN_S", 0.0)
    alan = site.visitor("alan")
    for _ in range(2):
        alan.get("/api/v1/approvals/1/figures/radial")
    assert 'name="tick:evidence:radial"' in alan.get(request_page)  # it was not in sight yet
    token = {"X-CSRF-Token": alan.csrf_token}
    answer = alan.send("POST", "/api/v1/approvals/1/openings", json={"evidence": "radial"}, headers=token)
    assert answer.json()["opened_utc"]
    page = alan.get(request_page)
    assert 'name="tick:evidence:radial"' not in page
    assert 'name="tick:evidence:rms"' in page
    assert 'name="tick:evidence:radial"' in site.visitor("both").get(request_page)


def test_a_signature_without_words_of_its_own_names_the_figures_that_were_not_opened(site, request_page):
    signed(site.visitor("alan"), request_page, meaning="")
    with open_reading(site.engine) as session:
        meaning = session.get_known(Approval, 1).signatures[-1].meaning
    assert all(title in meaning for title in review.VIEWS.values())
    assert "reviewed" not in meaning


def test_a_wrong_password_is_refused_in_its_place_and_everything_else_is_kept(site, request_page, read):
    answer = site.visitor("alan").post(f"{request_page}/sign", version="1", password="wrong wrong wrong", **WORDS)
    assert answer.status_code == 401
    assert "Read all of it." in answer.text
    assert "wrong wrong wrong" not in answer.text
    assert "nobody yet" in read(site.visitor("alan").get(request_page))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("ada", "requires the role approver"),
        ("adele", "An administrator cannot sign"),
        ("victor", "requires the role approver"),
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


def test_a_request_of_before_a_promotion_is_stale_and_cannot_be_signed(site, request_page, read):
    other = submitted(site, "ada", 2)
    alan, olga = site.visitor("alan"), site.visitor("olga")
    signed(alan, request_page)
    assert 'href="/parameter-sets/2#promote"' in olga.get(request_page)
    version = olga.get("/parameter-sets/2").split('name="version" value="')[1].split('"')[0]
    olga.post("/parameter-sets/2/promote", version=version, reason="The pass of tonight.", password=PASSWORD)
    text = read(alan.get(other))
    assert "STALE" in text


@pytest.mark.parametrize(("typical_sigmas", "warned"), [(14.0, False), (16.0, True), (-16.0, True)])
def test_an_estimate_farther_than_sensors_move_is_a_warning_and_a_held_parameter_is_none(typical_sigmas, warned):
    moved = {"f_m": 0.016 + typical_sigmas * 1e-4, "g_y": 9.0}
    found = ParameterSetDocument(camera_model="inverted_wang", parameters=moved, sigma={"f_m": 1e-6, "g_y": None})
    said = warn_of_shifts(found, {"f_m": 0.016, "g_y": 1.0}, {"f_m": 1e-4, "g_y": 1e-3})
    assert list(said) == (["shift-f_m"] if warned else [])


@pytest.mark.parametrize(
    ("rotation", "consistent", "warned"),
    [((3.0, 0.0, 4.0), True, True), ((1.5, 0.0, 0.0), True, False), ((1.5, 0.0, 0.0), False, True)],
)
def test_a_turn_of_the_attitude_that_the_data_show_is_a_warning_and_one_of_chance_is_none(rotation, consistent, warned):
    alignment = {
        "rotation_arcsec": list(rotation),
        "sigma_of_mean_arcsec": [1.0, 1.0, 1.0],
        "consistent": consistent,
        "sentence": "Loading these parameters turns the reported attitude.",
    }
    found = ParameterSetDocument(camera_model="inverted_wang", parameters={}, alignment=alignment)
    assert warn_of_turn(found) == ({"attitude-turn": alignment["sentence"]} if warned else {})
    assert warn_of_turn(ParameterSetDocument(camera_model="inverted_wang", parameters={})) == {}


def test_a_change_stands_beside_one_sigma_and_the_others_are_a_press_away(site, request_page):
    """Of a set the one that its gate is in, of a run the one with misfit."""
    page = site.visitor("alan").get(request_page)
    set_page = re.search(r"(/parameter-sets/\d+)/gates", page)[1]
    pages = {page: ('id="change-title"', "difference", {"σ with misfit", "Change / σ with misfit"})}
    pages |= {site.visitor("ada").get(set_page): ('<table class="data parameters">', "difference", {"σ with misfit"})}
    pages |= {site.visitor("ada").get("/runs/1"): ('<table class="data parameters">', "misfit", set())}
    for shown, (begin, leading, folded_away) in pages.items():
        changes = shown[shown.index(begin) :]
        table, folded = re.findall(r"<thead>.*?</thead>", changes, re.DOTALL)[:2]
        of_sigma, others = (
            {
                html.unescape(re.sub("<[^>]+>", "", cell)).strip()
                for cell in re.findall(r"<th .*?</th>", head, re.DOTALL)
            }
            for head in (table, folded)
        )
        assert [cell for cell in of_sigma if "σ" in cell and not cell.endswith(leading)] == []
        assert {"Noise σ", "Typical σ", "Change / noise σ"} | folded_away <= others
        assert changes.index('<details class="panel-details other-sigmas">') < changes.index(folded)
        assert terms_of_parameters()["reliable_sigma"].address in shown


def test_a_request_counts_changes_in_the_sigmas_of_its_gate(site, request_page):
    page = site.visitor("alan").get(request_page)
    name, worth, moved = re.search(
        r"(\w+) changed most, by (\S+) σ of the difference.*?(\d+) of \d+ parameters", page
    ).groups()
    rows = re.findall(
        r'<tr id="parameter-(\w+)">.*?<td class="num">([^<]*)(?:<small.*?</small>)?</td>\s*</tr>', page, re.DOTALL
    )
    worths = {one: float(told.replace("−", "-")) for one, told in rows}
    assert worths[name] == float(worth.replace("−", "-"))
    assert sum(abs(one) > 3 for one in worths.values()) == int(moved)


def test_a_comment_stands_on_its_gate_is_answered_resolved_and_reopened(site, request_page):
    alan, ada = site.visitor("alan"), site.visitor("ada")
    about = {"kind": "gate", "name": "coverage"}
    made = alan.post(f"{request_page}/threads", **about, text="@ada is one <b>corner</b> empty?")
    assert made.headers["location"] == f"{request_page}#thread-gate-coverage"
    listed = strip_tags(ada.get(request_page).split('href="#thread-gate-coverage"')[-1].split("</li>")[0])
    assert re.search("Detector coverage .*open .*Alan Approver: @ada is one", listed)
    assert '<b class="mention">@ada</b> is one &lt;b&gt;corner' in ada.get(request_page)
    assert ada.post(f"{request_page}/threads", **about, thread="1", text="Yes.").status_code == 303
    for action in ("resolved", "reopened"):
        ada.post(f"{request_page}/threads/1/{action}", version={"resolved": "1", "reopened": "2"}[action])
        state = re.search('data-thread="(\\w+)">(.*?)</div>', alan.get(request_page), re.DOTALL)
        assert state[1] == {"resolved": "RESOLVED", "reopened": "OPEN"}[action]
        assert ("by Ada Analyst" in strip_tags(state[2])) == (action == "resolved")
    refused = alan.post(f"{request_page}/threads", **about, text="@nobody knows")
    assert refused.status_code == 422
    assert ">@nobody knows</textarea>" in refused.text
    assert alan.post(f"{request_page}/threads/1/forgotten", version="3").status_code == 404
    assert f'action="{request_page}/threads' not in site.visitor("victor").get(request_page)


def test_a_remark_stands_under_its_name_and_a_refused_one_is_kept_in_its_place(site, request_page, read):
    alan = site.visitor("alan")
    alan.post(f"{request_page}/remarks", text="Why is <b>n0</b> so far off?")
    page = site.visitor("ada").get(request_page)
    assert "Why is &lt;b&gt;n0&lt;/b&gt; so far off?" in page
    assert "Alan Approver" in read(page)
    refused = alan.post(f"{request_page}/remarks", text="x" * 4001)
    assert refused.status_code == 422
    assert "x" * 4001 in refused.text
    page = site.visitor("victor").get(request_page)
    assert 'id="read-along"' in page
    assert f'action="{request_page}/remarks' not in page


def test_a_request_is_asked_of_one_who_may_sign_and_the_inbox_says_whom(site, request_page, read):
    page = site.visitor("ada").get(request_page)
    asked = page.split('id="person"')[1].split("</select>")[0]
    assert "Alan Approver" in asked
    assert "Olga Operator" not in asked
    number = asked.split(">Alan Approver")[0].rsplit('value="', 1)[1].split('"')[0]
    assert site.visitor("ada").post(f"{request_page}/assign", person=number, version="1").status_code == 303
    assert "Alan Approver" in text_of(site.visitor("ada").get(request_page), "assigned-to")
    stale = site.visitor("ada").post(f"{request_page}/assign", person="", version="1")
    assert stale.status_code == 412
    assert "Alan Approver" in read(site.visitor("both").get("/approvals"))


def test_a_second_person_signs_at_the_submitters_console_and_the_roll_says_so(site, request_page, read):
    ada = site.visitor("ada")
    answer = signed(ada, request_page, "sign-over-the-shoulder", name="alan", their_password=PASSWORD)
    assert answer.status_code == 303
    text = read(ada.get(request_page))
    assert re.search("Alan Approver .*console of Ada Analyst .* Command line at 20", text)
    assert "Ada Analyst" in ada.get("/approvals"), "the console's log-in became another's"
    with open_reading(site.engine) as session:
        assert session.get_known(Approval, 1).state == "APPROVED"


def test_a_second_person_answers_for_what_only_the_person_at_the_console_opened(site, request_page, monkeypatch):
    monkeypatch.setattr(approvals, "SHOWN_S", 0.0)
    ada = site.visitor("ada")
    ada.get("/api/v1/approvals/1/figures/radial")
    token = {"X-CSRF-Token": ada.csrf_token}
    ada.send("POST", "/api/v1/approvals/1/openings", json={"evidence": "radial"}, headers=token)
    assert 'name="their:evidence:radial"' in ada.get(request_page)
    theirs = {"name": "alan", "their_password": PASSWORD, "their:evidence:radial": "1"}
    refused = signed(ada, request_page, "sign-over-the-shoulder", **theirs)
    assert refused.status_code == 422
    assert "Radial difference was" in refused.text
    answer = signed(ada, request_page, "sign-over-the-shoulder", **theirs, their_reason="Seen on paper.")
    assert answer.status_code == 303
    with open_reading(site.engine) as session:
        (signature,) = session.get_known(Approval, 1).signatures
    (point,) = (point for point in signature.points if point["name"] == "radial")
    assert (point["opened_utc"], point["reason"]) == (None, "Seen on paper.")


def test_nobody_signs_over_ones_own_shoulder(site, request_page):
    alan = site.visitor("alan")
    refused = signed(alan, request_page, "sign-over-the-shoulder", name="alan", their_password=PASSWORD)
    assert refused.status_code == 403
    assert 'value="alan"' in refused.text
    assert PASSWORD not in refused.text


EDITOR = "/sensors/1/gates"
REASON = "The shift is the one that launch made; we know it."


@pytest.fixture
def candidate(site):
    with open_writing(site.engine) as session:
        return parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, 1).id


def fields(page):
    typed = dict(re.findall(r'<input class="number" name="([^"]+)"[^>]* value="([^"]*)"', page))
    typed |= dict.fromkeys(re.findall(r'type="checkbox" name="([^"]+)" value="yes"[^>]* checked', page), "yes")
    return typed | {"number": re.search(r'name="number" value="(\d+)"', page)[1]}


@pytest.fixture
def blocked(site, candidate):
    document = {"gates": [{"name": "parameter-shift", "limit": 0.5, "marginal": 0.5}]}
    with open_writing(site.engine) as session:
        gate_profiles.set_profile(session, site.actor("adele"), 1, document, "To be tried.", 0)
    assert site.visitor("ada").post(f"/parameter-sets/{candidate}/assess").status_code == 303
    return candidate


def test_the_editor_shows_every_gate_with_its_limit_and_unit(site, read):
    page = site.visitor("adele").get(EDITOR)
    typed = fields(page)
    assert typed["validation-rms.limit"] == "3"
    assert typed["parameter-shift.limit"] == ""
    assert typed["coverage.waivable"] == "yes"
    assert not any(name.startswith(("finite.", "covariance.", "sensor.")) for name in typed)
    assert "χ² per degree of freedom" in read(page)


def test_an_administrator_sets_limits_and_the_version_says_what_changed(site, read):
    visitor = site.visitor("adele")
    typed = fields(visitor.get(EDITOR)) | {"coverage.limit": "0.25", "action": "set", "reason": "Corners matter."}
    assert visitor.post(EDITOR, **typed).status_code == 303
    words = read(visitor.get(EDITOR))
    assert "version 1" in words
    assert re.search("Detector coverage.*: none → 0.25", words)
    assert "Corners matter." in words


def test_limits_are_tried_on_past_runs_and_stay_in_the_form_and_who_is_no_administrator_sets_none(site, read):
    visitor = site.visitor("ada")
    typed = fields(visitor.get(EDITOR)) | {"parameter-shift.limit": "0.5", "parameter-shift.marginal": "0.5"}
    page = visitor.post(EDITOR, **typed, action="try").text
    words = read(page)
    assert re.search("blocked 2 of the newest 2 .* #2, #1", words)
    assert fields(page)["parameter-shift.limit"] == "0.5"
    viewer = site.visitor("victor")
    form = fields(viewer.get(EDITOR)) | {"coverage.limit": "0.3", "reason": "I wish."}
    assert 'disabled aria-describedby="set-blocked"' in viewer.get(EDITOR)
    assert 'value="set"' not in viewer.get(EDITOR)
    assert [viewer.post(EDITOR, **form, action=action).status_code for action in ("set", "try")] == [403, 200]
    with open_reading(site.engine) as session:
        assert gate_profiles.get_profile_in_force(session, 1).number == 0


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("coverage.limit", "many", "Detector coverage: the limit 'many' is not a number"),
        ("coverage.limit", "2", "coverage: limit is 2.0; give a number from 0 to 1"),
        ("availability.marginal", "0.1", "give a marginal of at least the limit"),
    ],
)
def test_a_limit_that_makes_no_sense_is_refused_by_name_and_stays_in_the_form(site, read, field, value, words):
    visitor = site.visitor("adele")
    typed = fields(visitor.get(EDITOR)) | {field: value}
    for action in ("try", "set"):
        answer = visitor.post(EDITOR, **typed, action=action, reason="x")
        assert answer.status_code == 422
        assert words in read(answer.text)
        assert f'value="{value}"' in answer.text


def test_limits_that_somebody_else_changed_meanwhile_are_not_overwritten(site):
    visitor = site.visitor("adele")
    typed = fields(visitor.get(EDITOR)) | {"action": "set", "reason": "Both."}
    assert visitor.post(EDITOR, **(typed | {"coverage.limit": "0.2"})).status_code == 303
    answer = visitor.post(EDITOR, **(typed | {"coverage.limit": "0.4"}))
    assert answer.status_code == 412


def test_a_set_is_assessed_from_its_page_but_by_no_viewer(site, read, candidate):
    visitor = site.visitor("ada")
    answer = visitor.post(f"/parameter-sets/{candidate}/assess")
    assert answer.headers["location"] == f"/parameter-sets/{candidate}/gates"
    words = read(visitor.get(f"/parameter-sets/{candidate}/gates"))
    assert "ncumbent" not in words
    assert "by Ada Analyst" in words
    assert "× baseline" in words
    viewer = site.visitor("victor")
    assert 'id="assess-blocked"' in viewer.get(f"/parameter-sets/{candidate}/gates")
    assert viewer.post(f"/parameter-sets/{candidate}/assess").status_code == 403


def test_a_gate_that_blocks_is_named_and_waived_with_a_reason_for_1_to_30_days_and_the_waiver_stays(
    site, read, blocked
):
    visitor = site.visitor("ada")
    assert ONLY_WAIVERS in read(site.visitor("olga").get(f"/parameter-sets/{blocked}/gates"))
    page = visitor.get(f"/parameter-sets/{blocked}/gates")
    assert "blocked-by-gates" in codes(page)
    assert ": Parameter shift blocks" in read(page)
    version = re.search(r'name="version" value="(\d+)"', page)[1]
    form = {"gate": "parameter-shift", "code": "known-cause", "version": version, "password": PASSWORD}
    for days in ("0", "31", "many", ""):
        assert visitor.post(f"/parameter-sets/{blocked}/waive", **form, reason=REASON, days=days).status_code == 422
    form["days"] = "30"
    short = visitor.post(f"/parameter-sets/{blocked}/waive", **form, reason="Known.")
    assert short.status_code == 422
    assert ">Known.</textarea>" in short.text
    assert PASSWORD not in short.text
    assert visitor.post(f"/parameter-sets/{blocked}/waive", **form, reason=REASON).status_code == 303
    page = visitor.get(f"/parameter-sets/{blocked}/gates")
    words = read(page)
    assert "(1 gate waived)" in words
    assert REASON in words
    assert "blocked-by-gates" not in codes(page)
    with open_reading(site.engine) as session:
        assert [one.gate for one in approval_queries.list_waivers_in_force(session, blocked, utc_now())] == [
            "parameter-shift"
        ]


@pytest.mark.parametrize(("ended", "explained"), [("2025-12-31", True), ("2026-03-01", False)])
def test_a_gate_that_older_validation_frames_fail_says_first_by_how_much_they_are_older(
    site, candidate, ended, explained
):
    with open_writing(site.engine) as session:
        for number, day in ((1, "2026-03-01"), (2, ended)):
            row = session.get_known(TelemetrySet, number)
            row.quality = row.quality | {"time": {"start_utc": f"{day}T00:00:00Z", "end_utc": f"{day}T00:10:00Z"}}
        document = {"gates": [{"name": "validation-rms", "limit": 0.001, "marginal": 0.001}]}
        gate_profiles.set_profile(session, site.actor("adele"), 1, document, "To be tried.", 0)
    ada = site.visitor("ada")
    assert ada.post(f"/parameter-sets/{candidate}/assess").status_code == 303
    for page in ("", "/gates"):
        gate = ada.get(f"/parameter-sets/{candidate}{page}").split('<tr id="gate-validation-rms">')[1].split("</tr>")[0]
        why = strip_tags(gate.split('<td class="words">')[1])
        assert ("TS-validation" in why, as_shown(duration(59.993 * 86400)) in why) == (explained, explained)
        passing = text_of(ada.get(f"/parameter-sets/{candidate}{page}"), "gate-coverage")
        assert "TS-validation" not in passing


def test_there_are_no_gates_of_what_does_not_exist(site):
    visitor = site.visitor("adele")
    for address in ("/sensors/99/gates", "/parameter-sets/99/gates"):
        visitor.get(address, status=404)
    for address in ("/sensors/99/gates", "/parameter-sets/99/assess", "/parameter-sets/99/waive"):
        assert visitor.post(address).status_code in {404, 422}
