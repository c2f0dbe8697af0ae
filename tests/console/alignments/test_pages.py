"""The pages of alignments: the form, the page of one with both rotations, gates, figure and history, and links to them."""

import csv
import io
import re
from dataclasses import replace

import pytest

from boresight.console.alignments import queries, service
from boresight.platform.db.sessions import open_reading
from tests.console.alignments.pairs import aligned, ask, ended, run_of, trackers
from tests.served import PASSWORD
from tests.sites import put_documentation


@pytest.fixture(scope="module")
def row(house):
    return aligned(house)


def _read(house, who, address):
    answer = house.person(who).get(address, headers={"Accept": "text/html"})
    assert answer.status_code == 200, answer.text[-2000:]
    return answer.text


def _post(house, who, address="/alignments/new", **form):
    client = house.person(who)
    data = {"csrf_token": client.headers["X-CSRF-Token"], **form}
    return client.post(address, data=data, headers={"Accept": "text/html"}, follow_redirects=False)


def test_the_page_of_one_has_verdict_rotations_gates_and_figure_and_says_how_to_load_it(house, row):
    page = _read(house, "victor", f"/alignments/{row['id']}")
    assert 'id="to-load"' in page
    assert 'id="between"' in page
    for sigma in (row["summary"]["sigma_arcsec"], row["summary"]["load_sigma_arcsec"]):
        assert len(sigma) == 3
    assert page.count('class="num strong"') >= 6
    assert 'id="gate-angles"' in page
    assert f'src="/api/v1/alignments/{row["id"]}/figure"' in page
    assert "uplink packages" in page
    assert "boresight table encode --alignment" in page
    assert row["verdict"] in page


def test_each_sentence_of_advice_leads_to_its_section_of_the_guide(house, row, tmp_path, monkeypatch):
    read = service.read_result

    def read_with_advice(*given):
        found, report = read(*given)
        return replace(found, advice=["The pairs scatter."], advice_codes=["alignment_scatter"]), report

    monkeypatch.setattr(service, "read_result", read_with_advice)
    put_documentation(tmp_path, monkeypatch)
    page = _read(house, "ada", f"/alignments/{row['id']}?guide=1")
    assert page.count('href="/docs/how-to/respond-to-advice.html#advice-alignment-scatter"') == 1


def test_the_form_starts_one_and_keeps_what_was_typed_when_it_is_refused(house, row):
    form = {"run_a_id": str(row["run_a_id"]), "run_b_id": str(row["run_b_id"]), "tolerance_s": "0.2", "drift": "no"}
    page = _read(house, "ada", f"/alignments/new?a={row['run_a_id']}")
    assert re.search(rf'<option value="{row["run_a_id"]}" selected', page)
    assert _post(house, "victor", **form).status_code == 403
    for typed in ({"temperature": "inf"}, {"temperature": "nan"}, {"temperature": "1.5"}, {"tolerance_s": "nan"}):
        assert _post(house, "ada", **form | typed).status_code == 422, typed
    refused = _post(house, "ada", **{**form, "tolerance_s": "soon"})
    assert (refused.status_code, 'value="soon"' in refused.text) == (422, True)
    assert _post(house, "ada", run_a_id="", run_b_id="").status_code == 422
    answer = _post(house, "ada", **form)
    assert answer.status_code == 303
    place = answer.headers["location"]
    other = ended(house, int(place.rsplit("/", 1)[1]))
    assert (other["state"], other["options"]) == ("SUCCEEDED", {"tolerance_s": 0.2, "drift": False})
    assert f'href="/alignments/{row["id"]}"' in _read(house, "ada", place)  # each is in the other's history
    assert f'href="{place}"' in _read(house, "ada", f"/alignments/{row['id']}")


def test_both_sensors_lead_to_their_alignments(house, row):
    for sensor_id in (row["sensor_a_id"], row["sensor_b_id"]):
        place = f"/alignments?sensor={sensor_id}"
        assert f'href="{place}"' in _read(house, "victor", f"/sensors/{sensor_id}")
        assert f'href="/alignments/{row["id"]}"' in _read(house, "victor", place)
    assert 'href="/alignments/new"' not in _read(house, "victor", "/alignments")


def test_one_that_waits_or_failed_says_so(house, row):
    house.app.state.alignment_thread.close()
    number = ask(house, row["run_a_id"], row["run_b_id"], options={"longest_gap_s": 3.0}).json()["id"]
    page = _read(house, "ada", f"/alignments/{number}")
    house.app.state.alignment_thread.start()
    assert "QUEUED" in page
    assert "plot-figure src" not in page
    assert ended(house, number)["state"] == "SUCCEEDED"


@pytest.fixture(scope="module")
def good(house, tmp_path_factory):
    """An alignment that no gate blocks."""
    made = [run_of(house, one) for one in trackers(tmp_path_factory.getbasetemp())]
    return ended(house, ask(house, *made).json()["id"])


def _requests(house, row):
    with open_reading(house.app.state.engine) as session:
        return [(one.id, one.state, one.version) for one in queries.list_requests(session, row["id"])]


def _dialogs(page):
    return re.findall(r'<dialog id="([^"]*)" class="panel act-dialog"', page)


def test_one_is_submitted_on_its_page_and_withdrawn_by_the_same_person_or_an_administrator(house, good):
    place = f"/alignments/{good['id']}"
    assert _dialogs(_read(house, "ada", place)) == ["submit"]
    assert _dialogs(_read(house, "victor", place)) == []
    assert _post(house, "victor", f"{place}/submit", reason="Mine.").status_code == 403
    refused = _post(house, "ada", f"{place}/submit", reason=" ")
    assert refused.status_code == 422
    assert re.search(r'<dialog id="submit"[^>]* open>', refused.text)
    answer = _post(house, "ada", f"{place}/submit", reason="Calibrated again.")
    assert (answer.status_code, answer.headers["location"]) == (303, place)
    ((number, state, version),) = _requests(house, good)
    assert (state, version) == ("OPEN", 1)
    assert _dialogs(_read(house, "ada", place)) == ["withdraw"]
    sent = {"version": "1", "reason": "A later one."}
    assert _post(house, "alan", f"/alignment-requests/{number}/withdraw", **sent).status_code == 403
    assert _post(house, "ada", f"/alignment-requests/{number}/withdraw", **sent).status_code == 303
    assert [one[1] for one in _requests(house, good)] == ["WITHDRAWN"]
    assert _dialogs(_read(house, "ada", place)) == ["submit"]
    _post(house, "ada", f"{place}/submit", reason="Again.")
    number = _requests(house, good)[0][0]
    assert _dialogs(_read(house, "adele", place)) == ["withdraw"]
    assert _post(house, "adele", f"/alignment-requests/{number}/withdraw", **sent).status_code == 303
    assert [one[1] for one in _requests(house, good)] == ["WITHDRAWN", "WITHDRAWN"]


def test_the_inbox_leads_an_approver_to_the_page_where_it_is_signed_or_refused(house, good):
    place = f"/alignments/{good['id']}"
    before = int(re.search(r'waiting</span></span><b class="badge[^>]*>(\d+)', _read(house, "alan", "/approvals"))[1])
    _post(house, "ada", f"{place}/submit", reason="First.")
    number = _requests(house, good)[0][0]
    line = f'href="{place}">Review and sign</a>'
    for view in ("", "?show=mine", "?show=all"):
        assert line in _read(house, "alan", f"/approvals{view}")
    assert line not in _read(house, "ada", "/approvals")
    assert f'href="{place}"' in _read(house, "ada", "/approvals?show=submitted")
    assert f'href="{place}"' not in _read(house, "ada", "/approvals?show=mine")
    assert f'"{place}"' in house.person("alan").get("/waiting").text
    assert f'waiting</span></span><b class="badge badge-some">{before + 1}</b>' in _read(house, "alan", "/approvals")
    for query, listed in (("", True), ("&q=first", True), ("&q=last", False)):
        assert (f'href="{place}">Review and sign</a>' in _read(house, "alan", f"/approvals?show=mine{query}")) == listed
        text = house.person("alan").get(f"/approvals.csv?show=mine{query}").text
        mine = [one for one in csv.DictReader(io.StringIO(text)) if one["kind"] == "ALIGNMENT"]
        assert [(one["request"], one["state"], one["needed"]) for one in mine] == [(str(number), "OPEN", "1")] * listed
        assert all(one["set"].startswith(f"Alignment {good['id']}: ") for one in mine)
    asked = house.person("alan").get(f"/api/v1/alignment-requests?state=OPEN&alignment_id={good['id']}").json()
    assert [one["id"] for one in asked["items"]] == [number]
    led = house.person("alan").get(
        f"/alignment-requests/{number}", headers={"Accept": "text/html"}, follow_redirects=False
    )
    assert (led.status_code, led.headers["location"]) == (303, place)

    assert _dialogs(_read(house, "alan", place)) == ["approve", "refuse"]
    sign, sent = f"/alignment-requests/{number}/sign", {"version": "1", "password": PASSWORD}
    assert _post(house, "ada", sign, **sent, decision="APPROVE").status_code == 403
    assert _post(house, "alan", sign, **sent, decision="LATER").status_code == 422
    refused = _post(house, "alan", sign, **sent, decision="REFUSE", meaning="Not like this")
    assert refused.status_code == 422
    assert re.search(r'<dialog id="refuse"[^>]* open>', refused.text)
    assert ('value="Not like this"' in refused.text, PASSWORD in refused.text) == (True, False)
    wrong = {**sent, "password": "guess"}
    assert _post(house, "alan", sign, **wrong, decision="APPROVE").status_code in {401, 403}
    assert _post(house, "alan", sign, **sent, decision="REFUSE", comment="Too few pairs.").status_code == 303
    assert _requests(house, good)[0] == (number, "REJECTED", 2)
    assert "Too few pairs." in _read(house, "ada", place)

    _post(house, "ada", f"{place}/submit", reason="Again.")
    number = _requests(house, good)[0][0]
    approved = _post(house, "alan", f"/alignment-requests/{number}/sign", **sent, decision="APPROVE")
    assert (approved.status_code, approved.headers["location"]) == (303, place)
    assert _requests(house, good)[0] == (number, "APPROVED", 2)
    assert _dialogs(_read(house, "ada", place)) == _dialogs(_read(house, "alan", place)) == []
    late = _post(house, "alan", f"/alignment-requests/{number}/sign", **{**sent, "version": "2"}, decision="APPROVE")
    assert (late.status_code, _dialogs(late.text), 'class="notice notice-serious"' in late.text) == (409, [], True)
    assert line not in _read(house, "alan", "/approvals")


def test_one_that_a_gate_blocks_offers_no_submission(house, row):
    page = _read(house, "ada", f"/alignments/{row['id']}")
    assert 'disabled aria-describedby="submit-blocked"' in page
    assert 'id="submit-blocked"' in page
    assert _dialogs(page) == []
    assert _post(house, "ada", f"/alignments/{row['id']}/submit", reason="All the same.").status_code == 409
