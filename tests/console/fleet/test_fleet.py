"""The fleet at a glance: the worst that is known of a sensor, with the sentence why."""

import re
from dataclasses import replace
from types import SimpleNamespace
from weakref import WeakKeyDictionary

import numpy as np
import pytest

from boresight.calibration.advice_kinds import ADVICE_KINDS
from boresight.calibration.calibration import parse_calibration, to_plain
from boresight.console.alarms import queries as alarms_queries
from boresight.console.alarms import rules
from boresight.console.alarms import service as alarms
from boresight.console.alarms.rules import evaluate_rules
from boresight.console.approvals import service as approvals
from boresight.console.fleet import queries as sensor_rows
from boresight.console.fleet import service as sensors
from boresight.console.fleet import status as fleet
from boresight.console.fleet import trend as drift
from boresight.console.fleet.pages import overview
from boresight.console.fleet.status import (
    STATUS_WORDS,
    SensorFacts,
    SensorTile,
    list_findings,
    list_fleet_tiles,
    list_sensor_statuses,
)
from boresight.console.fleet.trend import GROUND_SHIFTED, read_trend
from boresight.console.fleet.trend_document import make_trend_document
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks import service as uplinks
from boresight.figures.example_calibration import get_example_calibrations
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_after
from boresight.platform.jobs.worker_news import WorkerState
from boresight.resources import folder
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document
from boresight.verdicts.numbers import urad_interval
from boresight.verdicts.verdict import summarise_run
from tests.console.uplinks.services import advance, promote_by_hand
from tests.missions import add_run, add_set, make_baseline
from tests.sites import PASSWORD, answer_points

NOTHING = SensorFacts(baseline=None, last_run=None, onboard=(), waiting=None, telemetry_sets=0, days=None)


def find_tile(engine: Engine) -> SensorTile:
    with open_reading(engine) as session:
        return list_fleet_tiles(session)[0]


def test_a_new_sensor_is_off_for_want_of_telemetry(engine):
    tile = find_tile(engine)
    assert (tile.status, tile.telemetry_sets, tile.last_run) == ("off", 0, None)
    assert "upload" in tile.sentence
    assert tile.baseline is not None
    assert tile.baseline.number == 0
    assert 0.0 <= tile.days_since_calibration < 1.0


@pytest.mark.parametrize(
    ("made", "status", "says"),
    [
        ({}, "normal", "Run 1 converged"),
        ({"status": "max_iterations"}, "caution", "stopped at max iterations"),
        ({"status": "rank_deficient"}, "serious", "ended rank deficient"),
        ({"status": "diverged"}, "serious", "ended diverged"),
        ({"state": "FAILED"}, "serious", "Run 1 failed"),
        ({"state": "LOST"}, "serious", "Run 1 lost"),
        ({"state": "QUEUED"}, "standby", "Run 1 is queued"),
        ({"state": "RUNNING"}, "standby", "Run 1 is running"),
        ({"state": "CANCELLED"}, "standby", "Run 1 was cancelled"),
    ],
)
def test_the_newest_run_speaks_for_the_sensor(engine, finished_run, made, status, says):
    with open_writing(engine) as session:
        finished_run(session, **made)
    tile = find_tile(engine)
    assert tile.status == status
    assert says in tile.sentence


EXAMPLE = get_example_calibrations()["batch"].to_dict()
CONSISTENT = EXAMPLE | {
    "status": "converged",
    "chi2": {"value": 90.0, "consistent": True, "dof": 90, "lower": 0.8, "upper": 1.2},
    "chi2_per_dof": 1.0,
    "observability": None,
    "advice": [],
    "validation": None,
    "trust": None,
    "covariance": {"names": [], "matrix": []},  # a trend has a voice of its own
}
WEAK = EXAMPLE["observability"] | {"sigma_of_direction": [0.1, 0.7], "singular_values": [10.0, 1.4]}
WORSE = EXAMPLE["validation"] | {"rms_arc_rad": {"initial": 1e-5, "final": 2e-5}}


@pytest.mark.parametrize(
    ("found", "status", "says"),
    [
        ({}, "normal", "Run 1 converged."),
        (
            {"chi2": CONSISTENT["chi2"] | {"consistent": False}, "chi2_per_dof": 4.0, "tests": []},
            "caution",
            "degree of freedom is 4",
        ),
        ({"observability": WEAK}, "caution", "with warnings"),
        (
            {"advice": ["Only 12 frames took part. Add some.", "More."]},
            "caution",
            ": Only 12 frames took part. Add some.",
        ),
        ({"advice": ["Not yet."], "advice_codes": ["drop_one"]}, "caution", f": {ADVICE_KINDS['drop_one']}."),
        (
            {"status": "diverged", "advice": ["The fit diverged: stop."]},
            "serious",
            "ended diverged: The fit diverged: stop.",
        ),
        ({"status": "rank_deficient", "advice": ["Hold a1."]}, "serious", "ended rank deficient: Hold a1."),
        ({"validation": WORSE}, "serious", "On the validation set"),
    ],
)
def test_a_fit_that_its_page_doubts_is_not_normal_for_the_fleet(engine, finished_run, found, status, says):
    with open_writing(engine) as session:
        run = finished_run(session)
        run.summary = to_plain(summarise_run(parse_calibration(CONSISTENT | found)))
    tile = find_tile(engine)
    assert tile.status == status
    assert says in tile.sentence
    assert tile.sentence.endswith(".")


def test_age_a_waiting_request_and_a_mismatch_speak_louder_than_an_older_run(
    engine, people, finished_run, candidate, blobs
):
    row = candidate()
    with open_writing(engine) as session:
        finished_run(session, state="FAILED")
        finished_run(session)
    assert find_tile(engine).status == "normal"
    with open_writing(engine) as session:
        approvals.submit(session, people["ana"], blobs, row.id, "better", row.version)
    tile = find_tile(engine)
    assert (tile.status, tile.sentence.startswith(f"{row.name} is waiting")) == ("caution", True)
    with open_writing(engine) as session:
        approvals.withdraw(session, people["ana"], row.id, row.version + 1)
        session.get_one(ParameterSet, 1).baseline_from_utc = utc_after(-200 * 86400.0)
    tile = find_tile(engine)
    assert (tile.status, "200 days" in tile.sentence) == ("caution", True)
    with open_writing(engine) as session:
        finished_run(session, state="FAILED")
        for state in ("SENT", "MISMATCH"):
            uplinks.record(session, people["dee"], 1, state, "pass 4711")
    tile = find_tile(engine)
    assert (tile.status, "PS-ST16-1-0" in tile.sentence) == ("critical", True)
    with open_reading(engine) as session:
        stand, tiles = list_sensor_statuses(session), list_fleet_tiles(session)
        told = [(tile.sensor.id, tile.sensor.name, tile.status, tile.sentence) for tile in tiles]
        assert [(one.sensor_id, one.name, one.status, one.sentence) for one in stand] == told
        assert (list_sensor_statuses(session, [1]), list_sensor_statuses(session, [99])) == (stand, [])


def test_an_active_set_that_is_not_the_baseline_is_a_caution(engine, people, candidate):
    row = candidate()
    advance(engine, people["dee"], "SENT", "LOADED", "VERIFIED", "ACTIVE")
    with open_writing(engine) as session:
        promote_by_hand(session, session.get_one(ParameterSet, row.id), utc_after(0.0))
    tile = find_tile(engine)
    assert tile.active is not None
    assert tile.active.id == 1
    assert (tile.status, f"baseline is {row.name}" in tile.sentence) == ("caution", True)


def test_every_finding_is_one_of_the_words_and_there_always_is_one(session, finished_run, blobs):
    assert blobs.folder.parent.is_dir()
    for number in range(2):
        for run in (None, finished_run(session), finished_run(session, state="QUEUED")):
            found = list(list_findings(replace(NOTHING, last_run=run, telemetry_sets=number)))
            assert found
            assert all(word in STATUS_WORDS and sentence.endswith(".") for word, sentence in found)
    assert [word for word, _ in list_findings(NOTHING)] == ["serious", "off"]
    known = replace(NOTHING, baseline=ParameterSet(name="PS-X-0", run_id=None), telemetry_sets=1, days=1.0)
    assert [word for word, _ in list_findings(known)] == ["standby"]


def test_a_ground_shift_beyond_what_a_look_asks_anew_is_said_once_it_is_known(session, monkeypatch):
    rng = np.random.default_rng(6)
    for day in range(4):
        add_run(session, add_set(session, 1, 30.0 * day), rng, 30.0 * np.eye(8)[0])
    monkeypatch.setattr("boresight.console.fleet.status.MOST_JUDGED", 0)
    assert [one.status for one in list_sensor_statuses(session)] == ["normal"]
    evaluate_rules(session)
    assert [one.status for one in list_sensor_statuses(session)] == ["caution"]
    assert "ground calibration" in list_sensor_statuses(session)[0].sentence


@pytest.fixture
def site(site):
    site.app.state.workers = SimpleNamespace(state=lambda: WorkerState(connected=True), notify=lambda: None)
    return site


def submitted(site):
    with open_writing(site.engine) as session:
        row = parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, 1)
        approvals.submit(session, site.actor("ada"), site.blobs, row.id, "Focus moved with temperature.", row.version)
        return row.name


def test_a_sensor_shows_its_status_baseline_and_rms_before_and_after(site, read, results):
    page = read(site.visitor("victor").get("/"))
    summary = summarise_run(parse_calibration(results["sqrf"]))
    after = f"{summary.rms_final_arc_rad * 1e6:.2f} {urad_interval(summary.rms_final_interval_rad)}"
    before = f"{summary.rms_initial_arc_rad * 1e6:.1f} {urad_interval(summary.rms_initial_interval_rad)}"
    assert GROUND_SHIFTED in page
    assert "PS-ST16-1-0" in page
    assert "ground calibration" in page
    assert f"{after} from {before}" in page
    site.app.state.workers.state = WorkerState
    assert "Not connected" in read(site.visitor("victor").get("/"))


def test_names_of_sensors_and_sets_may_wrap(site):
    page = site.visitor("victor").get("/?view=tiles")
    assert '<h3 class="name"><a href="/sensors/1">' in page
    assert '<dd class="name"><a href="/parameter-sets/1">' in page
    sheets = folder("frontend") / "static"
    assert re.search(r"\.tile \.name {[^}]*overflow-wrap: anywhere", (sheets / "fleet" / "fleet.css").read_text())
    sheet = (sheets / "shared" / "style.css").read_text()
    assert re.search(r"\.todo li {[^}]*overflow-wrap: anywhere", sheet)


def test_a_failed_run_is_serious_for_the_fleet_on_every_page(site, read):
    site.add_run(state="FAILED", reason="No usable frame.")
    visitor = site.visitor("ada")
    assert re.search("Run 3 .*: No usable frame.", read(visitor.get("/")))
    assert "status-serious" in visitor.get("/audit").split("<main")[0]
    assert "run 3 FAILED" in read(visitor.get("/"))


def to_do(page, address):
    """Return the sentences of the actions that a person is asked for at an address."""
    asked = page.split('<ul class="todo">')[1].split("</ul>")[0] if '<ul class="todo">' in page else ""
    return [one for one in asked.split("<li>")[1:] if f'href="{address}"' in one]


def test_the_approver_and_nobody_else_is_asked_to_sign_and_none_but_an_analyst_offered_a_launch(site):
    name = submitted(site)
    (sentence,) = to_do(site.visitor("alan").get("/"), "/approvals/1#review")
    assert name in sentence
    waiting = site.visitor("alan").send("GET", "/waiting").json()
    assert (waiting["count"], [one["address"] for one in waiting["first"]]) == (1, ["/approvals/1#review"])
    for other in ("ada", "victor", "adele"):
        page = site.visitor(other).get("/")
        assert to_do(page, "/approvals/1#review") == []
        assert 'class="badge badge-some">1<' in page.split("<main")[0]
        assert ("New run" in page) == (other == "ada")


def test_the_overview_leads_from_an_open_request_to_it_and_from_an_approved_set_to_its_promotion(site):
    submitted(site)
    viewer, alan = site.visitor("victor"), site.visitor("alan")
    of_request, of_set = (re.compile(rf'<td><a href="/{place}"') for place in ("approvals/1", "parameter-sets/2"))
    page = viewer.get("/?view=rows")
    assert (len(of_request.findall(page)), len(of_set.findall(page))) == (1, 0)
    signature = {"decision": "APPROVE", "meaning": "Good.", "comment": "", "password": PASSWORD, "version": "1"}
    alan.post("/approvals/1/sign", **signature, **answer_points(alan.get("/approvals/1")))
    page = viewer.get("/?view=rows")
    assert (len(of_request.findall(page)), len(of_set.findall(page))) == (0, 1)


def test_an_analyst_is_asked_to_judge_a_converged_run_until_a_set_is_made_of_it(site):
    visitor = site.visitor("ada")
    assert to_do(visitor.get("/"), "/runs/2")
    with open_writing(site.engine) as session:
        parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, 2)
    assert not to_do(visitor.get("/"), "/runs/2")


def test_what_happened_is_listed_with_the_ends_of_runs(site, read):
    site.add_run(state="CANCELLED", reason="Not needed.", ended_utc="2100-01-01T00:00:00.000000Z")
    events = read(site.visitor("victor").get("/")).split("Recent events")[1]
    assert "CANCELLED" in events.split("created")[0]
    assert "Not needed." in events


def test_of_a_large_fleet_those_that_stand_worst_are_drawn_and_the_page_says_so(site, read, monkeypatch):
    levels = ("normal", "critical", "off", "caution", "critical")
    stand = [SimpleNamespace(sensor_id=number, status=level) for number, level in enumerate(levels)]
    monkeypatch.setattr(overview, "MOST_TILES", 3)
    assert [one.sensor_id for one in overview.choose_drawn_sensors(stand)] == [1, 4, 3]
    assert [one.sensor_id for one in overview.choose_drawn_sensors(stand[:3])] == [1, 0, 2]  # of a small fleet too
    assert "show all" not in read(site.visitor("ada").get("/"))
    monkeypatch.setattr(overview, "MOST_TILES", 0)
    page = site.visitor("ada").get("/")
    assert "The 0 worst of 1" in page
    assert '<th scope="row">' not in page


def test_what_the_page_counts_and_what_it_draws_are_one_look_and_it_says_what_is_not_judged_yet(site, monkeypatch):
    monkeypatch.setattr("boresight.console.fleet.status._known", WeakKeyDictionary())
    monkeypatch.setattr("boresight.console.fleet.status.MOST_JUDGED", 0)
    page = site.visitor("ada").get("/?view=tiles")
    assert 'data-unjudged="1"' in page
    assert '<a href="/sensors?status=normal">1</a>' in page
    assert '<li class="tile tile-normal">' in page
    monkeypatch.setattr("boresight.console.fleet.status.MOST_JUDGED", 1)
    assert "data-unjudged" not in site.visitor("victor").get("/?again=1")


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request) -> Engine:
    store: Engine = request.getfixturevalue(request.param)
    rng = np.random.default_rng(4)
    with open_writing(store) as session:
        number = sensors.register_sensor(session, COMMAND_LINE, sensor_document(st16_sensor(1))).id
        made = [add_run(session, add_set(session, number, 30.0 * k), rng, 0.1 * k * np.eye(8)[0]) for k in range(5)]
        make_baseline(session, made[0])
        assert rules.update_alarms(session) == 1
    return store


def test_an_alarm_is_found_by_its_state_and_counted_while_it_waits(store):
    with open_writing(store) as session:
        (row,) = alarms.list_alarms(session, alarms.AlarmFilter(state="unacknowledged", kind="DRIFT", sensor_id=1))
        assert alarms.count_unacknowledged(session) == 1
        row.shelved_until_utc = utc_after(60)
        alarms.record_step(session, COMMAND_LINE, row, "SHELVED", "Later.")
        assert alarms.count_unacknowledged(session) == 0
        found = {state: len(alarms.list_alarms(session, alarms.AlarmFilter(state=state))) for state in alarms.STATES}
        assert found == {"unacknowledged": 0, "acknowledged": 0, "shelved": 1, "closed": 0}
        row.shelved_until_utc = utc_after(-1)
        assert [late.id for late in alarms_queries.list_overdue_shelves(session)] == [row.id]
        alarms.record_step(session, COMMAND_LINE, row, "UNSHELVED", "")


def test_a_trend_and_the_newest_summaries_are_read(store):
    with open_reading(store) as session:
        document = make_trend_document(session, 1)
        assert (document.drift.verdict, len(document.points)) == ("DRIFT", 5)
        newest = sensor_rows.list_recent_summaries(session, [1], 3)[1]
        assert [summary.trend.parameters for summary in newest if summary.trend] == [
            run.summary["trend"]["parameters"] for run in sensor_rows.list_finished_runs(session, [1])[1][-3:]
        ]


def test_of_each_sensor_its_own_newest_run_is_found_and_a_head_says_what_its_row_does(store):
    rng = np.random.default_rng(5)
    with open_writing(store) as session:
        for name in ("B", "C"):
            document = sensor_document(st16_sensor(1)) | {"name": name}
            number = sensors.register_sensor(session, COMMAND_LINE, document).id
            for day in range(3) if name == "B" else ():
                add_run(session, add_set(session, number, 30.0 * day), rng)
    with open_reading(store) as session:
        newest = {
            number: max(run.id for run in runs)
            for number, runs in sensor_rows.list_finished_runs(session, [1, 2]).items()
        }
        for asked in (None, [1, 2, 3]):
            runs, heads = sensor_rows.list_last_runs(session, asked), sensor_rows.list_last_run_heads(session, asked)
            assert {number: run.id for number, run in runs.items()} == newest
            assert {number: head[1:] for number, head in heads.items()} == {
                number: (run.id, run.state, run.reason, run.summary) for number, run in runs.items()
            }
            sets, short = sensor_rows.list_baselines(session, asked), sensor_rows.list_baseline_heads(session, asked)
            assert {number: head[1:] for number, head in short.items()} == {
                number: (row.id, row.name, row.run_id, row.baseline_from_utc) for number, row in sets.items()
            }
        assert set(sensor_rows.list_last_runs(session, [2])) == {2}
        assert len({head.status for head in fleet.list_sensor_statuses(session)}) > 1
        one_by_one = [one for number in (2, 3, 1) for one in fleet.list_sensor_statuses(session, [number])]
        assert fleet.list_sensor_statuses(session) == one_by_one


def _verdicts(session: Session, most: int | None = None) -> dict[int, fleet.DriftVerdict]:
    heads, baselines = sensor_rows.list_sensor_heads(session), sensor_rows.list_baseline_heads(session)
    return fleet.get_drift_verdicts(session, heads, baselines, sensor_rows.read_trend_stamps(session), most=most)


def test_it_equals_a_judgement_made_anew_after_every_change_of_the_trend(session):
    rng = np.random.default_rng(1)
    verdicts = []

    def look() -> None:
        found = drift.judge_drift(read_trend(session, 1))
        remembered = _verdicts(session)[1]
        assert (remembered.verdict, remembered.sentence) == (found.verdict, found.sentence)
        assert remembered.document == to_plain(drift.document(found))
        verdicts.append(found.verdict)

    look()
    first = add_run(session, add_set(session, 1, 0), rng)
    look()
    make_baseline(session, first)
    look()
    moved = add_run(session, add_set(session, 1, 90), rng, np.eye(8)[0])
    look()
    make_baseline(session, moved)
    look()
    assert "DRIFT" in verdicts
    assert verdicts[-1] != "DRIFT"


def test_a_second_look_at_an_unchanged_fleet_reads_no_run(engine, monkeypatch):
    with open_writing(engine) as session:
        add_run(session, add_set(session, 1, 0), np.random.default_rng(1))
        audit.append(session, COMMAND_LINE, "calibrated", "sensors/1")
    with open_reading(engine) as session:
        before = evaluate_rules(session)
    monkeypatch.setattr(fleet, "read_trends", lambda *_: pytest.fail("a trend was read again"))
    for transaction in (open_reading, open_writing):
        with transaction(engine) as session:
            assert evaluate_rules(session) == before


def test_who_must_not_wait_asks_of_a_few_anew_and_what_is_out_of_date_stands_until_it_is_made_anew(session):
    assert _verdicts(session, 0) == {}
    before = _verdicts(session, 1)
    assert list(before) == [1]
    rng = np.random.default_rng(2)
    for day in range(4):
        add_run(session, add_set(session, 1, 30.0 * day), rng, 30.0 * np.eye(8)[0])
    assert _verdicts(session, 0) == before
    assert _verdicts(session, 1)[1].verdict != before[1].verdict
