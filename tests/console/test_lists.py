"""Long lists: every order of every list, cut into pages, is the order of the whole; fifty thousand runs are no wait."""

from __future__ import annotations

import json
import statistics
import time
from itertools import chain
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa

from boresight.console import list_queries as lists
from boresight.console.access.tables import User
from boresight.console.approvals.tables import Approval
from boresight.console.fleet.tables import Sensor
from boresight.console.list_queries import LISTS, ListQuery, Signatory
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.dry_runs import list_timed_runs
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.audit.chain import append_own
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.sessions import open_reading, open_writing
from tests import stores

NOW = "2026-11-21T00:00:00.000000Z"
MANY = 50_000
QUICK_S = 0.1
GIVEN = {"state": "open", "board": "NOT SENT", "among": [1], "open": True, "open_to": Signatory(1, "", four_eyes=True)}
SUMMARIES = [
    None,
    {"rms_initial_arc_rad": 2e-4, "rms_final_arc_rad": 1e-4, "chi2_per_dof": 1.0},
    {"rms_initial_arc_rad": 2e-4, "rms_final_arc_rad": None, "chi2_per_dof": 0.9},
    {"rms_initial_arc_rad": 0.0, "rms_final_arc_rad": 3e-5, "validation_rms_final_arc_rad": 1 / 3e4},
]


def furnish(session):
    """A person, two sensors, two telemetry sets, and the file behind them."""
    session.add(User(name="ada", printed_name="Ada", password_hash="-", created_utc=NOW, roles=[]))
    session.add(Blob(sha256="a" * 64, size_bytes=1, media_type="text/csv", created_utc=NOW))
    session.flush()
    for number in (1, 2):
        document = {"camera_model": "brown", "detector": {"rows": 100 * number, "columns": 50}}
        session.add(Sensor(name=f"ST{3 - number}", document=document if number > 1 else {}, created_utc=NOW))
        session.flush()
        told = {"frames": 10 * number, "stars": 100, "quality": {"unmatched_share": 0.5 / number}, "uploaded_utc": NOW}
        told |= dict.fromkeys(("original_sha256", "table_sha256"), "a" * 64)
        session.add(TelemetrySet(sensor_id=number, name=f"set {3 - number}", purpose="calibration", **told))
    append_own(session, "made up", "sensors/1")


def run(number):
    """A run whose values repeat, so that every order has ties and rows without a value."""
    return Run(
        sensor_id=1 + number % 2,
        telemetry_set_id=1 + number % 2,
        method=("batch", "sqrf")[number % 3 == 0],
        settings={},
        sensor_document={},
        label=("b", "A", "_%c")[number % 3],
        state=("SUCCEEDED", "FAILED")[number % 5 == 0],
        launched_utc=f"2026-11-2{number % 4}T00:00:00.000000Z",
        launched_by=(None, 1)[number % 2],
        summary=SUMMARIES[number % len(SUMMARIES)],
    )


@pytest.fixture(params=["sqlite", "postgresql"], scope="module")
def store(request, tmp_path_factory):
    """Each engine in turn, with 23 rows of each kind that repeats, which the tests only read."""
    with stores.own(request.param, tmp_path_factory.mktemp("lists")) as engine:
        _fill(engine)
        yield engine


def _fill(engine):
    with open_writing(engine) as session:
        furnish(session)
        for number in range(23):
            session.add(run(number))
            session.flush()
            columns = {"number": number, "sha256": f"{number:064}", "document": {}, "created_utc": NOW}
            state = ("CANDIDATE", "REJECTED")[number % 2]
            made = ParameterSet(name=f"PS-{number}", sensor_id=1, ground_state=state, **columns)
            session.add(made)
            session.flush()
            columns = {"reason": "because", "bound": {}, "submitted_utc": NOW, "submitted_by": 1, "needed": 1}
            session.add(Approval(parameter_set_id=made.id, state="OPEN", **columns))
            append_own(session, ("began", "ended")[number % 2], f"runs/{number + 1}")


def values(session, name, key):
    """Every row's id and value of a key."""
    table = LISTS[name].table
    return {row[0]: row[1] for row in session.execute(sa.select(table.id, LISTS[name].keys[key]))}


def in_pages(session, name, sort, limit):
    """Every id of a list, page after page."""
    found, before = [], None
    while rows := lists.list_rows(session, name, ListQuery({}, sort, before), limit):
        found += [row.id for row in rows]
        before = found[-1]
    return found


def test_pages_joined_are_the_whole_list_in_its_order(store):
    with open_reading(store) as session:
        for name, known in LISTS.items():
            for key in known.keys:
                value = values(session, name, key)
                for sort in (key, f"-{key}"):
                    found = in_pages(session, name, sort, 4)
                    assert sorted(found) == sorted(value), (name, sort)
                    said = [value[number] for number in found]
                    there = [one for one in said if one is not None]
                    assert said[: len(there)] == there, f"{name} by {sort}: rows without a value are not last"
                    if there and not (
                        store.dialect.name == "postgresql" and isinstance(there[0], str)
                    ):  # it sorts by language
                        assert there == sorted(there, reverse=sort.startswith("-")), (name, sort)


def test_a_document_is_read_to_its_depth_and_where_nothing_is_there_nothing(store):
    with open_reading(store) as session:
        assert values(session, "sensors", "detector") == {1: None, 2: 10_000.0}
        assert values(session, "sensors", "model") == {1: None, 2: "brown"}


@pytest.mark.parametrize("ids", [[], [2], [2, 1, 99], list(range(2, 100_000))])
def test_a_list_is_narrowed_to_any_number_of_rows(store, ids):
    with open_reading(store) as session:
        found = lists.list_rows(session, "sensors", ListQuery({"among": ids}, "sensor"), 50)
    assert {row.id for row in found} == {1, 2} & set(ids)


@pytest.mark.parametrize("text", ["_%", "a", "%"])
def test_a_text_is_sought_as_it_stands_in_any_case(store, text):
    with open_reading(store) as session:
        found = lists.list_rows(session, "runs", ListQuery({"q": text}, "-run"), 50)
    assert {row.label for row in found} == {label for label in ("b", "A", "_%c") if text in label.lower()}


def test_a_walk_gives_every_row_once_and_reads_what_no_list_shows_only_when_asked(store):
    with open_reading(store) as session:
        walked = [row.id for row in lists.walk(session, "runs", ListQuery({}, "rms"))]
        assert walked == in_pages(session, "runs", "rms", 7)
        failed = [
            row.id for row in lists.list_rows(session, "runs", ListQuery({}, "state"), 50) if row.state == "FAILED"
        ]
        assert failed == sorted(failed, reverse=True)  # among equals the newest is first
        row = lists.list_rows(session, "runs", ListQuery({}, "run"), 1)[0]
        assert "settings" in sa.inspect(row).unloaded
        assert row.settings == {}


@pytest.fixture
def many(engine):
    """Fifty thousand runs with documents of the usual size."""
    document = json.dumps({"name": "ST16", "initial": {"f_m": 0.016}, "words": "x" * 300})
    drawn = np.random.default_rng(5)
    columns = "sensor_id, telemetry_set_id, method, settings, sensor_document, label, state, attempt, cancel_requested"
    insert = f"INSERT INTO runs ({columns}, launched_utc, launched_by, summary) VALUES ({', '.join('?' * 12)})"  # noqa: S608 - no word of it is given from outside
    with open_writing(engine) as session:
        furnish(session)
    with engine.begin() as connection:
        rows = [
            (
                *(1 + number % 2, 1, "sqrf", document, document, f"pass {drawn.random():.6f}"),
                *("SUCCEEDED" if number % 50 else "FAILED", 1, 0, NOW, 1),
                json.dumps({"advice": "y" * 200, "rms_initial_arc_rad": 1e-4, "rms_final_arc_rad": drawn.random()}),
            )
            for number in range(MANY)
        ]
        connection.exec_driver_sql(insert, rows)
    return engine


@pytest.mark.full
@pytest.mark.sqlite("timed is this thread, and PostgreSQL computes in a process of its own")
def test_a_page_of_fifty_thousand_runs_is_there_within_a_tenth_of_a_second(many):
    took = {}
    with open_reading(many) as session:
        for sort in ("-run", "label", "sensor", "rms", "-started"):
            for where in ({}, {"state": "SUCCEEDED"}, {"q": "0.5"}):
                for before in (None, MANY // 2):
                    began_s = time.thread_time()  # a busy machine is not the list's fault
                    rows = lists.list_rows(session, "runs", ListQuery(where, sort, before), 51)
                    took[sort, str(where), before] = time.thread_time() - began_s
                    assert len(rows) == 51
                    session.expunge_all()
    assert statistics.median(took.values()) < QUICK_S, took


@pytest.mark.few(16)
@pytest.mark.parametrize("table", lists.NAMES, ids=lambda table: table.__name__)
def test_every_listed_table_has_its_newest_rows_narrowed_by_each_filter(store, table):
    with open_reading(store) as session:
        whole = [row.id for row in lists.list_newest(session, table)]
        assert whole == sorted(session.scalars(sa.select(table.id)), reverse=True)
        for number in range(len(whole)):
            found = lists.list_newest(session, table, before_id=whole[number], limit=2)
            assert [row.id for row in found] == whole[number + 1 : number + 3]
        for name, condition in LISTS[lists.NAMES[table]].filters.items():
            given = GIVEN.get(name, "1")
            fitting = set(session.scalars(sa.select(table.id).where(condition(given))))
            assert [row.id for row in lists.list_newest(session, table, **{name: given})] == [
                number for number in whole if number in fitting
            ]


def _all(client: Any, path: str, **params: Any) -> list[list[int]]:
    pages, cursor = [], None
    while True:
        body = client.get(path, params={**params, **({"cursor": cursor} if cursor else {})}).json()
        pages.append([item["id"] for item in body["items"]])
        cursor = body["next"]
        if cursor is None:
            return pages


def test_pages_hold_every_run_once_newest_first_and_its_log_in_order(house):
    sensor_id, set_id = house.ready_sensor()
    client = house.person("ada")
    made = [
        client.post("/api/v1/runs", json={"sensor_id": sensor_id, "telemetry_set_id": set_id}).json()["id"]
        for _ in range(5)
    ]
    pages = _all(client, "/api/v1/runs", sensor_id=sensor_id, limit=2)
    assert [len(page) for page in pages] == [2, 2, 1]
    assert list(chain(*pages)) == made[::-1]
    assert client.get("/api/v1/runs", params={"sensor_id": sensor_id, "limit": 5}).json()["next"] is None
    house.end(made[0])
    pages = _all(client, f"/api/v1/runs/{made[0]}/log", limit=1)
    assert len(pages) >= 2
    assert list(chain(*pages)) == sorted(chain(*pages))


def test_a_row_added_meanwhile_does_not_move_the_pages(house):
    client, run = house.person("ada"), house.launched()
    params = {"sensor_id": run["sensor_id"], "limit": 1}
    order = {"sensor_id": run["sensor_id"], "telemetry_set_id": run["telemetry_set_id"]}
    second = client.post("/api/v1/runs", json=order).json()
    first_page = client.get("/api/v1/runs", params=params).json()
    client.post("/api/v1/runs", json=order)
    next_page = client.get("/api/v1/runs", params={**params, "cursor": first_page["next"]}).json()
    assert [first_page["items"][0]["id"], next_page["items"][0]["id"]] == [second["id"], run["id"]]


def test_a_cursor_of_other_filters_or_made_up_and_an_impossible_limit_are_refused(house):
    client = house.person("ada")
    house.launched(), house.launched()
    cursor = client.get("/api/v1/runs", params={"limit": 1}).json()["next"]
    refused = client.get("/api/v1/runs", params={"limit": 1, "cursor": cursor, "state": "QUEUED"})
    assert refused.status_code == 422
    assert "other filters" in refused.json()["detail"]
    wrong = [{"cursor": cursor} for cursor in ("x", "%%%", "bm90aGluZw", "-1.5", "MTIz")]
    for params in (*wrong, *({"limit": limit} for limit in ("0", "201", "many"))):
        assert client.get("/api/v1/runs", params=params).status_code == 422, params


@pytest.mark.parametrize("path", ["sensors", "users", "api-keys", "audit", "parameter-sets", "telemetry-sets"])
def test_other_lists_page_by_the_same_rule(house, path):
    house.ready_sensor(), house.ready_sensor(), house.key("adele"), house.key("adele")
    client = house.person("adele")
    paged = list(chain(*_all(client, f"/api/v1/{path}", limit=3 if path != "audit" else 100)))
    whole = list(chain(*_all(client, f"/api/v1/{path}", limit=200)))
    assert len(paged) == len(set(paged)) >= 2
    assert paged == whole


def test_a_damaged_summary_is_a_damaged_row_of_its_lists_and_keeps_no_run_waiting(site, results):
    whole = site.add_run(state="SUCCEEDED", result=results["batch"])
    damaged = site.add_run(state="SUCCEEDED", result=results["batch"], summary={"stars": "many"})
    ada = site.visitor("ada")
    for page in ("/runs", "/", "/sensors/1", "/telemetry/1", "/sensors/1/trend"):
        assert ada.send("GET", page).status_code == 200, page
    page = ada.get("/runs")
    assert f'href="/runs/{whole}"' in page
    row = page[page.index(f'href="/runs/{damaged}"') :]
    assert "damaged" in row[: row.index("</tr>")]
    assert "damaged" in ada.get("/runs.csv")
    assert ada.send("GET", f"/runs/{damaged}").status_code == 200
    with open_reading(site.engine) as session:
        assert len(list_timed_runs(session, "batch")) == 0  # none here told its time, and reading them refuses nothing


def test_a_damaged_progress_is_told_on_the_runs_page_and_refuses_no_list(site, read):
    running = site.add_run(state="RUNNING", progress={"fraction": "half"}, started_utc=NOW)
    ada = site.visitor("ada")
    assert f'href="/runs/{running}"' in ada.get("/runs")
    assert ada.send("GET", f"/api/v1/runs/{running}").status_code == 200
    assert "(fraction" in read(ada.get(f"/runs/{running}"))


@pytest.mark.parametrize(
    "quality", [{"time": 3}, {"verdict": "normal", "frames": "many"}, {"temperature_c": {"smallest": 1}}]
)
def test_a_damaged_quality_report_is_a_damaged_row_of_its_lists(site, read, quality):
    with site.engine.begin() as connection:
        connection.execute(sa.update(TelemetrySet).where(TelemetrySet.id == 1).values(quality=quality))
    ada = site.visitor("ada")
    for page in (
        "/telemetry",
        "/telemetry.csv",
        "/telemetry/1",
        "/sensors/1",
        "/sensors/1/trend",
        "/runs/new?sensor=1",
    ):
        assert ada.send("GET", page).status_code == 200, page
    assert "quality report" in read(ada.get("/telemetry/1"))
