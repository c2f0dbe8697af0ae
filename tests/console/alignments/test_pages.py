"""The pages of alignments: the form, the page of one with both rotations, gates, figure and history, and links to them."""

import re
from dataclasses import replace

import pytest

from boresight.console.alignments import service
from boresight.console.pages.rendering import TEMPLATES
from tests.console.alignments.pairs import aligned, ask, ended


@pytest.fixture(scope="module")
def row(house):
    return aligned(house)


def _read(house, who, address):
    answer = house.person(who).get(address, headers={"Accept": "text/html"})
    assert answer.status_code == 200, answer.text[-2000:]
    return answer.text


def _post(house, who, **form):
    client = house.person(who)
    data = {"csrf_token": client.headers["X-CSRF-Token"], **form}
    return client.post("/alignments/new", data=data, headers={"Accept": "text/html"}, follow_redirects=False)


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


def test_each_sentence_of_advice_leads_to_its_section_of_the_guide(house, row, monkeypatch):
    read = service.read_result

    def read_with_advice(*given):
        found, report = read(*given)
        return replace(found, advice=["The pairs scatter."], advice_codes=["alignment_scatter"]), report

    monkeypatch.setattr(service, "read_result", read_with_advice)
    monkeypatch.setitem(TEMPLATES.globals, "has_documentation", lambda: True)
    page = _read(house, "ada", f"/alignments/{row['id']}?guide=1")
    assert page.count('href="/docs/how-to/respond-to-advice.html#advice-alignment-scatter"') == 1


def test_the_form_starts_one_and_keeps_what_was_typed_when_it_is_refused(house, row):
    form = {"run_a_id": str(row["run_a_id"]), "run_b_id": str(row["run_b_id"]), "tolerance_s": "0.2", "drift": "no"}
    page = _read(house, "ada", f"/alignments/new?a={row['run_a_id']}")
    assert re.search(rf'<option value="{row["run_a_id"]}" selected', page)
    assert _post(house, "victor", **form).status_code == 403
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
