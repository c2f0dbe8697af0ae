"""Cached answers: fresh after every commit, nobody's but their own, and only for credentials that hold now."""

import asyncio
import re
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, TypeVar

import httpx
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from starlette.types import Scope

from boresight.console.access.tables import ApiKey, User
from boresight.console.fleet.pages import sensors as pages_of_sensors
from boresight.console.runs import service as runs
from boresight.console.runs.tables import Run
from boresight.platform.actors import SYSTEM, SessionLimits
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_engine, open_writing, utc_after
from boresight.platform.web import response_cache as standing
from boresight.platform.web.response_cache import NAME_GAP, TOKEN_GAP, CompressedPage
from tests.effort import effort
from tests.platform.web.test_concurrency_limit import get_limit
from tests.served import PASSWORD, House, serving

T = TypeVar("T")
RUNS = "/api/v1/runs"
LISTS = (RUNS, "/api/v1/sensors", "/api/v1/telemetry-sets", "/api/v1/parameter-sets")


def served(house: House) -> int:
    return len(house.app.state.response_cache._cached)


def fresh(client: httpx.Client, path: str) -> dict[str, Any]:
    mark = "&" if "?" in path else "?"
    return shown(client.get(f"{path}{mark}unheard={time.perf_counter_ns()}"))


def shown(answer: httpx.Response) -> dict[str, Any]:
    page: dict[str, Any] = answer.json()
    return {**page, "next": bool(page["next"])}


def undisturbed(house: House, ask: Callable[[], T], before_each: Callable[[], object] = lambda: None) -> T:
    reader = house.app.state.response_cache.data_version_poller._reader
    for _ in range(20):
        before_each()
        before, found = reader.look(), ask()
        if before is not None and reader.look() == before:
            return found
    pytest.fail("something was committed all the time")


def test_the_second_of_two_questions_is_answered_without_the_endpoint(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    original = runs.list_runs
    monkeypatch.setattr(
        "boresight.console.runs.service.list_runs", lambda *g, **w: (asked.append(g), original(*g, **w))[1]
    )

    def twice() -> tuple[httpx.Response, httpx.Response, int]:
        first, before = house.person("ada").get(RUNS), len(asked)
        return first, house.person("ada").get(RUNS), len(asked) - before

    first, second, made = undisturbed(house, twice)
    assert made == 0
    assert second.status_code == 200
    assert second.content == first.content
    assert second.headers["etag"] == first.headers["etag"]


@pytest.mark.parametrize("path", LISTS)
def test_who_commits_reads_their_own_writes(house: House, path: str) -> None:
    client = house.person("ada")
    for _ in range(3):
        before = client.get(path).json()
        run = house.launched()
        after = shown(client.get(path))
        assert after == fresh(client, path)
        if path == RUNS:
            assert after["items"][0]["id"] == run["id"]
            assert run["id"] not in [row["id"] for row in before["items"]]


def test_what_another_process_commits_is_seen_by_the_next_question(house: House) -> None:
    run = house.launched()
    client = house.person("victor")
    assert client.get(f"{RUNS}/{run['id']}").json()["label"] != "renamed"
    other = open_engine(house.app.state.settings.database_url)
    with open_writing(other) as session:
        session.get_one(Run, run["id"]).label = "renamed"
        audit.append(session, SYSTEM, "renamed", f"runs/{run['id']}")
    other.dispose()
    assert client.get(f"{RUNS}/{run['id']}").json()["label"] == "renamed"


def test_a_page_names_the_person_it_was_made_for(house: House) -> None:
    people = ("ada", "alan", "olga", "victor", "adele")
    for _ in range(2):
        for name in people:
            page = house.person(name).get("/runs").text
            assert f"<b>{name.title()}</b>" in page
            assert house.person(name).headers["X-CSRF-Token"] in page
            assert not any(f"<b>{other.title()}</b>" in page for other in people if other != name)


def test_two_log_ins_of_one_person_never_share_a_token(house: House) -> None:
    one, other = house.log_in("victor"), house.log_in("victor")
    for client, stranger in ((one, other), (other, one), (one, other)):
        page = client.get("/runs").text
        assert client.headers["X-CSRF-Token"] in page
        assert stranger.headers["X-CSRF-Token"] not in page


def test_log_ins_of_one_person_share_the_making_of_a_page_and_each_has_its_own_token(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other, stranger = house.log_in("victor"), house.log_in("victor"), house.log_in("olga")
    for client in (one, other, stranger):
        client.get("/sensors")
    made: list[str] = []
    original = pages_of_sensors.show_sensors
    monkeypatch.setattr(pages_of_sensors, "show_sensors", lambda *given: (made.append(""), original(*given))[1])

    def asked() -> tuple[list[str], int]:
        before = len(made)
        return [client.get("/sensors").text for client in (one, other, one, other, stranger)], len(made) - before

    texts, count = undisturbed(house, asked, house.launched)
    assert count == 2  # one for Victor, one for Olga
    for client, text in zip((one, other, one, other, stranger), texts, strict=True):
        tokens = {each.headers["X-CSRF-Token"] for each in (one, other, stranger)}
        assert {token for token in tokens if token in text} == {client.headers["X-CSRF-Token"]}
    other.delete("/api/v1/sessions/current")
    assert other.get("/sensors", headers={"Accept": "text/html"}).status_code == 303
    assert one.get("/sensors").status_code == 200


def test_who_asks_while_an_answer_waits_for_its_turn_shares_it_whatever_is_committed_meanwhile(house: House) -> None:
    client = house.person("ada")
    client.get(RUNS)
    limit = get_limit(house.app)
    others = [house.key("ada") for _ in range(4)]
    free, limit.readers._free = limit.readers._free, 0
    with ThreadPoolExecutor(8) as pool:
        asked = [pool.submit(one.get, RUNS) for one in others]
        time.sleep(0.5)
        waiting = list(limit.readers._waiting)
        run = house.launched()
        asked.append(pool.submit(house.person("victor").get, RUNS))
        time.sleep(0.5)
        assert list(limit.readers._waiting) == waiting
        for _ in range(free):
            waiting[0].get_loop().call_soon_threadsafe(limit.readers._next)
        answers = [one.result(20) for one in asked]
    assert len(waiting) == 1
    assert {answer.json()["items"][0]["id"] for answer in answers} == {run["id"]}


def test_nobody_reads_what_is_cached_for_the_known(house: House) -> None:
    house.person("ada").get(RUNS)
    house.person("ada").get("/runs")
    assert house.anybody().get(RUNS).status_code == 401
    assert house.anybody(Authorization="Bearer bs_00000000_nonsense").get(RUNS).status_code == 401
    assert house.anybody(Cookie="boresight_session=nonsense").get(RUNS).status_code == 401
    assert house.anybody().get("/runs", headers={"Accept": "text/html"}).status_code == 303


def test_a_wrong_key_beside_a_good_log_in_is_refused_as_without_the_response_cache(house: House) -> None:
    client = house.log_in("ada")
    assert client.get(RUNS).status_code == 200
    assert client.get(RUNS, headers={"Authorization": "Bearer bs_00000000_nonsense"}).status_code == 401


def test_a_revoked_key_is_refused_at_once(house: House) -> None:
    key = house.key("ada", "runs")
    assert [key.get(RUNS).status_code for _ in range(3)] == [200] * 3
    owner = house.person("ada")
    row = owner.get("/api/v1/api-keys").json()["items"][0]
    revoked = owner.post(f"/api/v1/api-keys/{row['id']}:revoke")
    assert revoked.status_code in {200, 204}, revoked.text
    assert owner.get(RUNS).status_code == 200
    assert key.get(RUNS).status_code == 401


def test_ended_log_ins_and_disabled_people_are_refused_at_once(house: House) -> None:
    administrator = house.person("adele")
    made = administrator.post(
        "/api/v1/users",
        json={"name": f"guest-{time.time_ns()}", "printed_name": "Guest", "password": PASSWORD, "roles": ["viewer"]},
    ).json()
    client = house.anybody()
    logged_in = client.post("/api/v1/sessions", json={"name": made["name"], "password": PASSWORD})
    assert logged_in.status_code == 201, logged_in.text
    assert [client.get(RUNS).status_code for _ in range(2)] == [200] * 2
    person = f"/api/v1/users/{made['id']}"
    tag = administrator.get(person).headers["etag"]
    assert administrator.post(f"{person}:disable", headers={"If-Match": tag}).status_code == 200
    assert administrator.get(RUNS).status_code == 200
    assert client.get(RUNS).status_code == 401


def test_who_must_set_a_password_gets_nothing_that_is_cached(house: House) -> None:
    name = f"new-{time.time_ns()}"
    house.person("adele").post(
        "/api/v1/users",
        json={
            "name": name,
            "printed_name": "New",
            "password": PASSWORD,
            "roles": ["viewer"],
            "must_change_password": True,
        },
    )
    client = house.anybody()
    client.post("/api/v1/sessions", json={"name": name, "password": PASSWORD})
    house.person("ada").get(RUNS)
    assert client.get("/api/v1/sessions/current").status_code == 200
    assert client.get(RUNS).status_code == 403


def test_a_key_that_expires_by_the_clock_is_refused_without_any_commit(house: House) -> None:
    key = house.key("ada")
    prefix = key.headers["Authorization"].split("_")[1]
    with open_writing(house.app.state.engine) as session:
        row = session.query(ApiKey).filter_by(prefix=prefix).one()
        row.expires_utc = utc_after(1.0)
        audit.append(session, SYSTEM, "shortened", f"api-keys/{row.id}")
    assert key.get(RUNS).status_code == 200
    assert key.get(RUNS).status_code == 200
    time.sleep(1.05)
    assert key.get(RUNS).status_code == 401


def test_a_log_in_that_expires_by_the_clock_is_refused_without_any_commit(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = house.log_in("victor")
    assert client.get(RUNS).status_code == 200
    now_s = time.time()
    monkeypatch.setattr("boresight.platform.web.response_cache.time.time", lambda: now_s + 12 * 3600 + 5)
    monkeypatch.setattr("itsdangerous.timed.time.time", lambda: now_s + 12 * 3600 + 5)
    assert client.get(RUNS).status_code == 401


def test_a_cached_answer_counts_as_a_use_of_the_log_in(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(house.app.state.maintenance, "_limits", SessionLimits(age_s=3600.0, idle_s=0.6))
    client = house.log_in("victor")
    for _ in range(4):
        assert client.get(RUNS).status_code == 200
        time.sleep(0.25)
    time.sleep(0.7)
    assert client.get(RUNS).status_code == 401


def test_a_copy_that_still_holds_is_not_sent_again(house: House) -> None:
    client = house.person("ada")
    run = house.launched()
    for path in (*LISTS, "/api/v1/audit", "/api/v1/users", f"{RUNS}/{run['id']}/log", f"{RUNS}/{run['id']}/result"):
        answer = client.get(path)
        assert answer.headers["etag"].startswith('W/"'), path
        assert "Accept-Encoding" in answer.headers["vary"]
        again = client.get(path, headers={"If-None-Match": answer.headers["etag"]})
        assert (again.status_code, again.content) == (304, b""), path
        assert again.headers["etag"] == answer.headers["etag"]
        assert client.get(path, headers={"If-None-Match": '"another"'}).status_code == 200
    house.launched()
    listed = client.get(RUNS)
    assert client.get(RUNS, headers={"If-None-Match": f'"x", {listed.headers["etag"]}'}).status_code == 304


def test_a_copy_that_holds_no_more_is_sent_anew(house: House) -> None:
    client = house.person("ada")
    old = client.get(RUNS).headers["etag"]
    house.launched()
    assert client.get(RUNS, headers={"If-None-Match": old}).status_code == 200


def test_the_tag_is_the_same_compressed_or_not(house: House) -> None:
    house.launched()
    client = house.person("ada")
    plain = client.get(RUNS, headers={"Accept-Encoding": "identity"})
    zipped = client.get(RUNS, headers={"Accept-Encoding": "gzip"})
    assert plain.headers["etag"] == zipped.headers["etag"]
    assert plain.content == zipped.content
    assert "content-encoding" not in plain.headers


def test_a_row_whose_tag_says_all_is_not_sent_again_and_one_that_moves_is(house: House) -> None:
    client = house.person("ada")
    run = house.launched()
    sensor = f"/api/v1/sensors/{run['sensor_id']}"
    tag = client.get(sensor).headers["etag"]
    assert client.get(sensor, headers={"If-None-Match": tag}).status_code == 304
    at_work = client.get(f"{RUNS}/{run['id']}").headers["etag"]
    assert client.get(f"{RUNS}/{run['id']}", headers={"If-None-Match": at_work}).status_code == 200
    house.end(run["id"])
    ended = client.get(f"{RUNS}/{run['id']}").headers["etag"]
    assert client.get(f"{RUNS}/{run['id']}", headers={"If-None-Match": ended}).status_code == 304


def test_a_page_is_stored_by_no_browser(house: House) -> None:
    page = house.person("ada").get("/runs")
    assert page.headers["cache-control"] == "no-store"
    assert "etag" not in page.headers


def test_an_old_answer_is_made_anew(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    client = house.person("ada")
    client.get("/runs")
    monkeypatch.setattr(standing, "HELD_S", 0.0)
    asked: list[Any] = []
    original = house.app.state.response_cache.keep
    monkeypatch.setattr(house.app.state.response_cache, "keep", lambda *a, **k: (asked.append(a), original(*a, **k))[1])
    client.get("/runs")
    assert asked


def test_the_cache_is_bounded(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    client = house.person("ada")
    house.launched()
    client.get(RUNS)
    size = house.app.state.response_cache.held_bytes
    monkeypatch.setattr(house.app.state.response_cache, "_limit_bytes", max(20_000, 2 * size))
    for limit in range(1, 60):
        client.get(f"{RUNS}?limit={limit}")
    assert house.app.state.response_cache.held_bytes <= max(20_000, 2 * size)
    assert served(house) > 0


def test_people_of_the_same_roles_share_the_making_of_a_page_and_each_has_their_own_name_and_token(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [house.new_person("viewer")[0] for _ in range(3)]
    clients = [house.log_in(name) for name in names]
    analyst = house.log_in("ada")
    for path in ("/sensors", "/telemetry", "/runs", "/parameter-sets"):
        clients[0].get(path)
        made: list[str] = []
        original = house.app.state.response_cache.keep
        monkeypatch.setattr(
            house.app.state.response_cache, "keep", lambda *g, made=made, o=original: (made.append(""), o(*g))[1]
        )

        def asked(path: str = path, made: list[str] = made) -> tuple[list[tuple[httpx.Client, str]], int]:
            before = len(made)
            return [(client, client.get(path).text) for client in (*clients, *clients, analyst)], len(made) - before

        pages, count = undisturbed(house, asked, house.launched)
        monkeypatch.undo()
        assert count == 2, path  # one for viewers, one for analysts
        for name, (client, page) in zip((*names, *names, "ada"), pages, strict=True):
            assert f"<b>{name.title()}</b>" in page
            assert {one.headers["X-CSRF-Token"] in page for one in (client,)} == {True}
            assert not any(one.headers["X-CSRF-Token"] in page for one in (*clients, analyst) if one is not client)
            assert sum(f"<b>{other.title()}</b>" in page for other in (*names, "ada")) == 1
            assert "gap-" not in page


def test_who_gets_another_role_gets_another_page_at_once(house: House) -> None:
    name, number = house.new_person("viewer")
    client, other = house.log_in(name), house.person("victor")
    for one in (client, other, client):
        assert "<small>viewer</small>" in one.get("/sensors").text
    act_on_store(house, "new role", [], number)
    assert "<small>analyst</small>" in client.get("/sensors").text
    assert "<small>viewer</small>" in other.get("/sensors").text


def test_a_refusal_and_a_page_with_a_flash_line_hold_no_gap(house: House) -> None:
    client = house.log_in("ada")
    client.get("/sensors")
    client.cookies.set("boresight_flash", "%5B%22normal%22%2C%20%22Done.%22%5D", domain="127.0.0.1")
    for page in (client.get("/sensors"), client.get("/runs/999999", headers={"Accept": "text/html"}), client.get("/")):
        assert "gap-" not in page.text
        assert "<b>Ada</b>" in page.text


def test_a_look_at_the_fleet_of_before_a_commit_is_given_to_nobody_who_asks_after_it(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = get_limit(house.app)
    begin, held, go = limit._begin, threading.Event(), threading.Event()

    async def hold(scope: Scope) -> None:
        if (b"x-hold", b"1") in scope["headers"]:
            held.set()
            await asyncio.to_thread(go.wait, 10)
        await begin(scope)

    monkeypatch.setattr(limit, "_begin", hold)
    early, late, ada = house.log_in("victor"), house.log_in("victor"), house.person("ada")
    for client in (early, late, ada):
        client.get("/")
    assert ada.post(f"{RUNS}/{house.launched()['id']}/notes", json={"text": "Seen."}).status_code == 201
    with ThreadPoolExecutor(1) as thread:
        waits = thread.submit(early.get, "/", headers={"X-Hold": "1"})
        assert held.wait(10)
        ada.get("/")  # a look at the fleet, begun after the other page was asked for
        name = house.new_sensor()["name"]
        go.set()
        assert waits.result().status_code == 200
    assert name in late.get("/").text
    assert name in early.get("/").text


class NothingKept(dict[Any, Any]):
    def __setitem__(self, key: Any, value: Any) -> None:
        """Keep nothing."""


@contextmanager
def beside(house: House) -> Iterator[str]:
    with serving(house.app.state.settings, house.app.state.catalogue()) as (address, app):
        app.state.response_cache._limit_bytes = 0
        app.state.overview = SimpleNamespace(answer_to=lambda _question, read, _asked_s: (read(), False))
        app.state.rendered = NothingKept()
        app.state.workers.stop()
        app.state.workers = house.app.state.workers
        app.state.maintenance.light = house.app.state.maintenance.light
        yield address


def without_times(page: str) -> str:
    return re.sub(r"<time.*?</time>|[\d.]+\s(ms|s|min)\b[^<]*|#\d+ \d\d:\d\dZ", "", page)


PAGES = ("/", "/runs", "/sensors", "/telemetry", "/parameter-sets")
PEOPLE = ("ada", "victor", "olga", "bo", "alan", "adele")
PAGE_ACTS = st.lists(
    st.tuples(
        st.sampled_from(("launch", "end", "sensor", "note", "new role", "new name", "nothing")),
        st.sampled_from(PAGES),
        st.lists(st.sampled_from(PEOPLE), min_size=2, max_size=3),
    ),
    min_size=2,
    max_size=4,
)


@settings(
    max_examples=effort(2, 4), suppress_health_check=[HealthCheck.function_scoped_fixture], phases=[Phase.generate]
)
@given(acts=PAGE_ACTS)
def test_after_any_acts_of_anybody_each_gets_the_page_that_a_server_would_make_that_keeps_nothing(
    house: House, acts: list[tuple[str, str, list[str]]]
) -> None:
    runs: list[dict[str, Any]] = []
    changing = house.new_person("viewer")
    with beside(house) as address:
        people = {name: house.person(name) for name in PEOPLE} | {changing[0]: house.log_in(changing[0])}
        for act, path, names in acts:
            act_on_store(house, act, runs, changing[1])
            for name in (*names, changing[0], *names):
                client = people[name]
                kept = client.get(path)
                made = client.get(f"{address}{path}")
                assert kept.status_code == made.status_code == 200
                differing = set(without_times(kept.text).splitlines()) ^ set(without_times(made.text).splitlines())
                assert not differing, (act, path, name)


def act_on_store(house: House, act: str, runs: list[dict[str, Any]], person: int) -> None:
    if act == "launch":
        runs.append(house.launched())
    elif act == "end" and runs:
        house.end(runs.pop()["id"])
    elif act == "sensor":
        house.new_sensor()
    elif act == "note":
        noted = house.person("ada").post(f"{RUNS}/{house.launched()['id']}/notes", json={"text": "Seen."})
        assert noted.status_code == 201
    elif act in {"new role", "new name"}:
        with open_writing(house.app.state.engine) as session:
            user = session.get_one(User, person)
            if act == "new role":
                user.roles = ["analyst"] if user.roles == ["viewer"] else ["viewer"]
            else:
                user.printed_name += " II"
            audit.append(session, SYSTEM, "changed", f"users/{person}")


ACTS = st.lists(st.sampled_from(("launch", "cancel", "end", "sensor", "read")), min_size=1, max_size=8)


@pytest.mark.full
@settings(max_examples=effort(4, 12), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(acts=ACTS)
def test_after_any_acts_what_is_cached_equals_what_would_be_answered(house: House, acts: list[str]) -> None:
    people = [house.person(name) for name in ("ada", "victor", "olga")]
    runs: list[dict[str, Any]] = []
    for act in acts:
        if act == "launch":
            runs.append(house.launched())
        elif act == "cancel" and runs:
            run = runs.pop()
            tag = people[0].get(f"{RUNS}/{run['id']}").headers["etag"]
            assert people[0].post(f"{RUNS}/{run['id']}:cancel", headers={"If-Match": tag}).status_code == 200
        elif act == "end" and runs:
            house.end(runs.pop()["id"])
        elif act == "sensor":
            house.new_sensor()
        for client in people:
            for path in LISTS:
                assert shown(client.get(path)) == fresh(client, path), (act, path)


GAPS = (TOKEN_GAP.encode(), NAME_GAP.encode())
PIECES = st.lists(st.one_of(st.sampled_from(GAPS), st.binary(max_size=300)), max_size=12)
VALUES = st.tuples(st.binary(max_size=200), st.one_of(st.binary(max_size=20), st.just(b"n" * 70_000)))


@given(pieces=PIECES, values=VALUES)
def test_a_filled_sheet_is_the_page_with_the_values_in_its_gaps(
    pieces: list[bytes], values: tuple[bytes, bytes]
) -> None:
    page = b"".join(pieces)
    wanted = b"".join(values[GAPS.index(piece)] if piece in GAPS else piece for piece in pieces)
    assert CompressedPage(page, GAPS, compressed=False).filled(values) == wanted
    reader = zlib.decompressobj(16 + zlib.MAX_WBITS)
    assert reader.decompress(CompressedPage(page, GAPS, compressed=True).filled(values)) + reader.flush() == wanted
    assert reader.eof
    assert not reader.unused_data


def test_a_page_is_compressed_as_well_as_without_gaps() -> None:
    page = b"<tr><td>run</td></tr>" * 2000 + GAPS[0] + b"<tr><td>run</td></tr>" * 2000
    assert len(CompressedPage(page, GAPS, compressed=True).filled((b"t", b"n"))) < 2 * len(zlib.compress(page, 5))
