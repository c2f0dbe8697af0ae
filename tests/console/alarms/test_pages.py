"""Alarms, trends and notes on the pages: found, handled, refused in words, and typed text kept."""

import csv
import io
import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from boresight.console.alarms import pages, rules
from boresight.console.alarms import service as alarms
from boresight.console.alarms.rules import check_chain
from boresight.console.alarms.tables import Alarm
from boresight.platform.actors import COMMAND_LINE, SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing, utc_after, utc_now
from tests.missions import add_run, add_set, make_baseline
from tests.sites import codes


@pytest.fixture
def drifting(site):
    rng = np.random.default_rng(1)
    with open_writing(site.engine) as session:
        make_baseline(session, add_run(session, add_set(session, 1, 0), rng))
        for day in (30, 60, 90):
            add_run(session, add_set(session, 1, day, temperature_c=20.0), rng, 0.01 * day * np.eye(8)[0])
        rules.update_alarms(session, [1])
    return site


def alarm(site):
    with open_reading(site.engine) as session:
        (row,) = alarms.list_alarms(session, alarms.AlarmFilter(kind="DRIFT"))
        return row


def test_a_drift_is_on_the_overview_the_bar_the_list_and_the_sensor(drifting, read):
    visitor = drifting.visitor("ada")
    overview = visitor.get("/")
    assert "status-serious" in overview.split("<main")[0]
    assert "alarm 1." in overview
    assert "Alarm 1: ST16-1 drifts." in read(overview)
    assert "unacknowledged, active" in read(visitor.get("/alarms"))
    assert "Recalibrate now? YES" in read(visitor.get("/sensors/1"))


def test_of_many_readings_of_an_alarm_the_last_is_in_sight_and_the_others_are_folded(drifting, read):
    with open_writing(drifting.engine) as session:
        for k in range(26):
            alarms.record_step(session, SYSTEM, session.get_known(Alarm, 1), "COMMENTED", f"Reading {k}.")
    drifting.visitor("ada").post("/alarms/1/acknowledge", version=str(alarm(drifting).version), text="Seen.")
    steps, _, folded = read(drifting.visitor("ada").get("/alarms/1")).partition("25 earlier readings")
    assert steps.index("Seen.") < steps.index("Reading 25.") < steps.rindex("raised")
    assert "Reading 24." not in steps
    assert folded.index("Reading 24.") < folded.index("Reading 0.")


def test_the_acts_stand_before_the_history_and_beside_them_how_the_alarm_stands(drifting):
    page = drifting.visitor("ada").get("/alarms/1")
    assert page.index('id="live-what"') < page.index('id="live-handle"') < page.index('id="live-steps"')
    for visitor in ("ada", "victor"):
        _, handle = drifting.visitor(visitor).get("/alarms/1").split('id="live-handle"')
        assert "unacknowledged, active" in handle.split('id="live-steps"')[0]


def test_the_trend_says_what_counts_and_whether_the_baseline_holds(drifting, read):
    page = read(drifting.visitor("victor").get("/sensors/1/trend"))
    assert "DRIFT" in page
    assert "of the upload: the telemetry has no times" in page  # runs 1 and 2, of sets without times
    assert page.count("Change ± σ of the difference") == 1


def test_an_alarm_is_acknowledged_assigned_and_shelved_by_its_forms(drifting, read):
    visitor, row = drifting.visitor("ada"), alarm(drifting)
    for step, form in (
        ("acknowledge", {"text": "Seen."}),
        ("assign", {"user_id": "3"}),
        ("comment", {"text": "A pass is asked for."}),
        ("shelve", {"until": row.raised_utc, "text": "x"}),
    ):
        answer = visitor.post(f"/alarms/1/{step}", version=str(alarm(drifting).version), **form)
        if step == "shelve":
            assert answer.status_code == 422
            assert "not-a-future-time" in codes(answer.text)
            assert 'value="x"' in answer.text
        else:
            assert answer.status_code == 303
    page = read(visitor.get("/alarms/1"))
    assert "acknowledged, active" in page
    assert "Olga Operator" in page
    assert "A pass is asked for." in page


def test_a_form_of_an_older_version_or_by_a_viewer_is_refused_in_words(drifting):
    stale = drifting.visitor("ada").post("/alarms/1/comment", version="77", text="What I typed.")
    assert stale.status_code == 412
    assert "What I typed." in stale.text
    viewer = drifting.visitor("victor")
    assert "Acknowledge" not in viewer.get("/alarms/1")
    assert viewer.post("/alarms/1/acknowledge", version="1").status_code == 403
    assert viewer.post("/alarms/1/silence", version="1").status_code == 404


def test_an_alarm_of_the_installation_has_no_sensor_and_leads_to_the_audit_log(site, read):
    with open_writing(site.engine) as session:
        rules.update_installation_alarms(
            session, {rules.CHAIN: check_chain("broken", "Record 7 is not as it was written.")}
        )
    visitor = site.visitor("adele")
    assert 'class="empty"' in visitor.get("/alarms?kind=DRIFT")
    assert "Record 7" in read(visitor.get("/alarms"))
    assert 'href="/audit">Audit</a>' in visitor.get("/alarms/1")


def numbers(page):
    return [int(found) for found in re.findall(r'<a href="/alarms/(\d+)">#', page)]


def test_what_waits_for_somebody_is_first_over_all_pages_and_a_shelf_ends_by_the_clock(site, monkeypatch):
    monkeypatch.setattr(pages, "ALARMS", replace(pages.ALARMS, rows_a_page=2))
    with open_writing(site.engine) as session:
        told = {"level": "caution", "sentence": "Old.", "evidence": {}, "raised_utc": utc_now()}
        rows = [Alarm(source=f"made up/{number}", kind="AGE", **told) for number in range(5)]
        session.add_all(rows)
        rows[4].acknowledged, rows[2].shelved_until_utc = 1, utc_after(3600)
        rows[1].shelved_until_utc = utc_after(-0.001)  # it was on the shelf when this test began
        audit.append(session, COMMAND_LINE, "brought in", "sensors/1")
    visitor, address, seen = site.visitor("victor"), "/alarms", []
    while address:
        page = visitor.get(address)
        seen.append(numbers(page))
        following = re.search(r'<a href="([^"]*)" rel="next">', page)
        address = following and unescape(following[1])
    assert seen == [[4, 2], [1, 5], [3]]
    file = csv.DictReader(io.StringIO(visitor.get("/alarms.csv")))
    assert [int(row["alarm"]) for row in file] == [4, 2, 1, 5, 3]


def test_a_note_is_escaped_kept_and_leads_back(site):
    visitor = site.visitor("ada")
    answer = visitor.post("/notes/sensors/1", text="Heater <b>off</b>.")
    assert answer.status_code == 303
    assert answer.headers["location"] == "/sensors/1#notes"
    assert "Heater &lt;b&gt;off&lt;/b&gt;." in visitor.get("/sensors/1")
    refused = visitor.post("/notes/runs/1", text="x" * 4001)
    assert refused.status_code == 422
    assert "x" * 4001 in refused.text
    assert "<textarea" not in site.visitor("victor").get("/notes/runs/1")


def test_the_alarms_of_a_view_can_be_had_as_csv_and_their_table_sorted(drifting):
    visitor = drifting.visitor("victor")
    page = visitor.get("/alarms?kind=DRIFT")
    assert 'href="/alarms.csv?kind=DRIFT" download data-hotkey="e"' in page
    (row,) = csv.DictReader(io.StringIO(visitor.get("/alarms.csv?kind=DRIFT")))
    assert (row["kind"], row["sensor"], row["state"]) == ("DRIFT", "ST16-1", "unacknowledged, active")
    assert row["sentence"] == alarm(drifting).sentence
    assert row["sentence"] in page
    for query in ("?state=closed", "?kind=AGE&sensor=1"):
        assert codes(visitor.get(f"/alarms{query}")) == ["no-match"]
    assert list(csv.DictReader(io.StringIO(visitor.get("/alarms.csv?state=shelved")))) == []
