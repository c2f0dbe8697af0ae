"""Passwords over HTTP: hashed outside the write lock, slowed down without locking anybody out, failures in the audit log."""

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from boresight.console.access import password_checks as checks
from boresight.console.access import passwords
from boresight.console.access.log_in_attempts import MOST_RECORDS, REFUSED
from boresight.console.access.passwords import PasswordProof
from boresight.console.access.sessions import ClientAddress
from boresight.console.access.tables import User
from boresight.console.approvals import service as approvals
from boresight.errors import OverloadedError, TooManyAttemptsError
from boresight.platform.actors import SYSTEM, Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from tests.effort import effort
from tests.passwords import new_password
from tests.served import PASSWORD, PEOPLE, PLAIN, add_people, serving, settings_in

HERE, THERE = "127.0.0.1", "127.0.0.2"


@pytest.fixture(scope="module")
def served(tmp_path_factory) -> Iterator[tuple[str, Any]]:
    settings = settings_in(tmp_path_factory.mktemp("passwords"))
    add_people(settings)
    with serving(settings) as place:
        yield place


@pytest.fixture
def skipped(served, monkeypatch) -> list[float]:
    """The waits of a test, which pass at once: a clock stands in that they move on."""
    state, waits = served[1].state.passwords, list[float]()

    async def skip(wait_s: float) -> None:
        if wait_s > 0:
            waits.append(wait_s)

    monkeypatch.setattr(state._limiter, "_now_s", lambda: time.monotonic() + sum(waits))
    monkeypatch.setattr(state, "_wait", skip)
    return waits


def _client(address: str, source: str = HERE) -> httpx.Client:
    return httpx.Client(base_url=address, transport=httpx.HTTPTransport(local_address=source, verify=PLAIN), timeout=30)


def _log_in(client: httpx.Client, name: str, password: str = PASSWORD) -> httpx.Response:
    answer = client.post("/api/v1/sessions", json={"name": name, "password": password})
    if answer.status_code == 201:
        client.headers["X-CSRF-Token"] = answer.json()["csrf_token"]
    return answer


@pytest.fixture
def held(monkeypatch) -> Iterator[tuple[list[str], threading.Event]]:
    threads, release = list[str](), threading.Event()
    for name in ("check", "prepare"):
        monkeypatch.setattr(passwords, name, _holding(getattr(passwords, name), threads, release))
    yield threads, release
    release.set()


def _holding(work: Callable[..., Any], threads: list[str], release: threading.Event) -> Callable[..., Any]:
    def wait(*given: Any) -> Any:
        threads.append(threading.current_thread().name)
        assert release.wait(30)
        return work(*given)

    return wait


def _api(path: str, **body: Any) -> Callable[[httpx.Client], httpx.Response]:
    sent = {"json": {"password": PASSWORD, **body}, "headers": {"If-Match": '"v1"'}}
    return lambda client: client.post(f"/api/v1/{path}", **sent)


def _page(path: str, **form: Any) -> Callable[[httpx.Client], httpx.Response]:
    form = {"password": PASSWORD, **form}
    return lambda client: client.post(path, data={**form, "csrf_token": client.headers["X-CSRF-Token"]})


FRESH = dict.fromkeys(("password", "repeated"), "known to nobody else")
WAIVER = {"gate": "coverage", "code": "other", "reason": "x" * 30, "expires_utc": "2026-01-01"}
SLOW = {
    "log in": _api("sessions", name="victor"),
    "log in by the page": _page("/login", name="victor"),
    "add a person": _api("users", name="new", printed_name="N", roles=[]),
    "add a person by the page": _page("/users", name="new"),
    "reset a password": lambda client: client.post("/api/v1/users/3:change-password", json={"password": PASSWORD}),
    "change a password by the page": _page("/password", current=PASSWORD, **FRESH),
    "sign": _api("approvals/1:approve", meaning="x"),
    "sign by the page": _page("/approvals/1/sign", decision="APPROVE"),
    "sign over the shoulder": _api("approvals/1:sign-over-the-shoulder", meaning="x", name="alan", decision="APPROVE"),
    "waive": _api("parameter-sets/1:waive", **WAIVER),
    "activate": _api("parameter-sets/1:activate", source="x", meaning="x"),
}


@pytest.mark.parametrize("what", SLOW)
def test_no_password_is_worked_on_while_the_write_lock_is_held(served, held, what, monkeypatch):
    monkeypatch.setattr(approvals, "refuse_beside", lambda *_: None)  # of a request that is not there nothing is hashed
    address, app = served
    threads, release = held
    release.set()
    with _client(address) as root, _client(address) as ada:
        assert _log_in(root, "adele").status_code == 201
        assert _log_in(ada, "ada").status_code == 201
        threads.clear()
        release.clear()
        slow = threading.Thread(target=SLOW[what], args=(root,))
        slow.start()
        for _ in range(500):
            if threads:
                break
            time.sleep(0.01)
        assert threads, "nothing was hashed"
        assert not app.state.write_lock.locked()
        made = ada.post("/api/v1/api-keys", json={"label": what})
        assert made.status_code == 201, made.text  # written while the hash was under way
        assert slow.is_alive()
        release.set()
        slow.join(20)
    assert all(name.startswith("boresight-") for name in threads)
    _restore(app)


def _restore(app: Any) -> None:
    with open_writing(app.state.engine) as session:
        row = session.get_one(User, list(PEOPLE).index("adele") + 1)
        row.password_hash = new_password(PASSWORD).hash()
        audit.append(session, SYSTEM, "restored", "users")


@pytest.fixture
def hashed(monkeypatch) -> list[str]:
    made, check = list[str](), passwords.check

    def noting(stored: Any, password: str) -> Any:
        made.append(password)
        return check(stored, password)

    monkeypatch.setattr(passwords, "check", noting)
    return made


@pytest.mark.usefixtures("skipped")
def test_a_flood_of_one_name_locks_nobody_out_elsewhere_and_no_signature(served):
    address, _ = served
    with _client(address) as alan, _client(address, THERE) as flood, _client(address, "127.0.0.3") as fresh:
        assert _log_in(alan, "alan").status_code == 201
        statuses = [_log_in(flood, "alan", "wrong").status_code for _ in range(7)]
        assert statuses[:5] == [401] * 5
        body = {"meaning": "x", "password": PASSWORD}
        answer = alan.post("/api/v1/approvals/77:approve", json=body, headers={"If-Match": '"v1"'})
        assert answer.status_code == 404  # there is no such request, and nothing made the signer wait
        assert _log_in(fresh, "alan").status_code == 201


@pytest.mark.usefixtures("skipped")
def test_a_new_log_in_gives_no_new_guesses_over_the_shoulder(served, monkeypatch, hashed):
    address, _ = served
    beside = _api("approvals/77:sign-over-the-shoulder", meaning="x", password="wrong", name="bo", decision="APPROVE")
    with _client(address, "127.0.0.9") as victor:
        assert _log_in(victor, "victor").status_code == 201
        assert beside(victor).status_code == 404
    assert "wrong" not in hashed  # nothing is tried for a request that does not exist
    monkeypatch.setattr(approvals, "refuse_beside", lambda *_: None)  # as if the request could be signed
    for _ in range(5):
        with _client(address, "127.0.0.8") as victor:
            assert _log_in(victor, "victor").status_code == 201
            for _ in range(4):
                answer = beside(victor)
                if answer.status_code == 429:
                    break
    assert answer.status_code == 429
    assert hashed.count("wrong") == 8


def test_attempts_are_slowed_down_and_then_told_to_wait(served, skipped):
    address, _ = served
    with _client(address, "127.0.0.4") as flood:
        for name in ("ada", "nobody-of-that-name"):
            answers = [_log_in(flood, name, "wrong") for _ in range(9)]
            assert [answer.status_code for answer in answers] == [401] * 8 + [429]
            assert 4 < int(answers[-1].headers["retry-after"]) <= 8
            assert {answer.json()["detail"] for answer in answers[:8]} == {answers[0].json()["detail"]}
            assert [round(wait_s) for wait_s in skipped[-3:]] == [1, 2, 4]


def test_a_wait_is_waited_out_before_the_password_is_looked_at(served):
    address, _ = served
    with _client(address, "127.0.0.12") as flood:
        for _ in range(6):
            assert _log_in(flood, "nobody-who-waits", "wrong").status_code == 401
        began_s = time.monotonic()
        assert _log_in(flood, "nobody-who-waits", "wrong").status_code == 401
        assert time.monotonic() - began_s >= 1.5


def _failures(engine: Engine, address: str) -> list[dict[str, Any]]:
    with open_reading(engine) as session:
        found = [one.after or {} for one in audit.list_records(session, limit=200) if one.action == REFUSED]
    return [one for one in found if str(one.get("address", address)).startswith(address)]


def test_failed_log_ins_are_audited_soon_and_then_by_the_minute(served):
    address, app = served
    app.state.passwords.record_failures(whole=True)
    with _client(address, "127.0.0.5") as stranger:
        for _ in range(4):
            assert _log_in(stranger, "ADA\u202e", "wrong horse battery").status_code == 401
    for _ in range(100):
        if _failures(app.state.engine, "127.0.0.5"):
            break
        time.sleep(0.05)
    assert _failures(app.state.engine, "127.0.0.5"), "the first failure is told soon"
    app.state.passwords.record_failures(whole=True)
    found = _failures(app.state.engine, "127.0.0.5")
    assert len(found) <= 2
    assert sum(one["count"] for one in found) == 4
    assert {(one["name"], one["address"], one["log_in"]) for one in found} == {("ADA", "127.0.0.5", None)}
    assert "wrong horse battery" not in str(found)


def test_a_flood_of_names_makes_few_records(sqlite):
    state = checks.PasswordWorker(sqlite, 5)
    state.start()
    for number in range(1000):
        state._note(checks.FailedAttempt.of(f"name-{number}", f"10.0.0.{number % 200}"))
    state.close()
    found = _failures(sqlite, "")
    assert len(found) <= checks.PROMPT + MOST_RECORDS + 1
    assert sum(one["count"] for one in found) == 1000


def test_only_so_many_passwords_are_worked_on_or_wait_at_once(served, monkeypatch):
    state = checks.PasswordWorker(served[1].state.engine, 5)
    monkeypatch.setattr(passwords, "check", lambda stored, _: time.sleep(0.05) or PasswordProof(stored, fits=False))

    async def flood() -> list[object]:
        one_each = [state.check_log_in(f"n{number}", "x", ClientAddress(f"10.0.0.{number}")) for number in range(60)]
        return await asyncio.gather(*one_each, return_exceptions=True)

    found = asyncio.run(flood())
    refused = [one for one in found if isinstance(one, OverloadedError)]
    assert len(found) - len(refused) <= checks.MOST_QUEUED + 4  # some were done before the last came
    assert {one.wait_s for one in refused} == {2}

    async def wait() -> list[object]:
        monkeypatch.setattr(checks, "MOST_HELD", 3)
        monkeypatch.setattr(state._limiter, "admit", lambda _: 0.5)
        attempts = [state.check_log_in("ada", "x", ClientAddress("10.0.0.1")) for _ in range(6)]
        return await asyncio.gather(*attempts, return_exceptions=True)

    assert sum(isinstance(one, OverloadedError) for one in asyncio.run(wait())) == 3


def test_a_signer_is_slowed_down_by_their_own_failures_alone(served):
    state = checks.PasswordWorker(served[1].state.engine, 5)
    alan = Actor(2, "alan", "Alan", frozenset({"approver"}), "session", session_id=1)

    async def fail(session_id: int) -> None:
        actor = Actor(2, "alan", "Alan", frozenset({"approver"}), "session", session_id=session_id)
        await state.check_own(actor, "wrong", ClientAddress(HERE))

    async def all_of_it() -> bool:
        for _ in range(5):
            await fail(7)
            await state.check_log_in("alan", "wrong", ClientAddress(THERE))
        with pytest.raises(TooManyAttemptsError):
            await asyncio.gather(*(fail(7) for _ in range(4)))
        return (await state.check_own(alan, PASSWORD, ClientAddress(HERE))).fits

    assert asyncio.run(all_of_it())


def test_a_lone_surrogate_in_a_password_is_refused_in_words(served):
    address, _ = served
    with _client(address) as root:
        assert _log_in(root, "adele").status_code == 201
        for path in ("users", "users/1:change-password", "sessions"):
            body = b'{"name":"x","printed_name":"x","roles":[],"password":"\\ud800 and some more of it"}'
            sent = root.post(f"/api/v1/{path}", content=body, headers={"Content-Type": "application/json"})
            assert sent.status_code in {400, 401, 422}, sent.text


def test_many_names_tried_from_an_address_shut_out_nobody_who_logged_in_from_there(served, hashed):
    address, _ = served
    source = "127.0.0.10"
    with _client(address, source) as alan:
        assert _log_in(alan, "alan").status_code == 201
    hashed.clear()
    end_s = time.monotonic() + effort(3, 6)  # what is bounded is bounded over time

    def attack(thread: int) -> None:
        with _client(address, source) as attacker:
            for number in range(1000):
                if time.monotonic() > end_s:
                    return
                _log_in(attacker, f"name-{thread}-{number}", "wrong")
                time.sleep(0.05)

    attackers = [threading.Thread(target=attack, args=(thread,)) for thread in range(2)]
    for one in attackers:
        one.start()
    took_s = []
    while time.monotonic() < end_s - 0.5:
        began_s = time.monotonic()
        with _client(address, source) as alan:
            assert _log_in(alan, "alan").status_code == 201
        took_s.append(time.monotonic() - began_s)
        time.sleep(0.3)
    for one in attackers:
        one.join(30)
    assert len(took_s) >= 3
    assert max(took_s) < 5.0
    assert hashed.count("wrong") <= 34


def test_strangers_everywhere_share_their_tries_at_a_name_and_its_owner_gets_in(served):
    state = checks.PasswordWorker(served[1].state.engine, 1)
    with _client(served[0], "127.0.0.11") as olga:
        assert _log_in(olga, "olga").status_code == 201

    async def all_of_it() -> bool:
        for number in range(3):
            await state.check_log_in("olga", "wrong", ClientAddress(f"10.1.0.{number}"))
        with pytest.raises(TooManyAttemptsError):
            await asyncio.gather(*(state.check_log_in("olga", "wrong", ClientAddress(f"10.2.0.{n}")) for n in range(5)))
        return (await state.check_log_in("olga", PASSWORD, ClientAddress("::ffff:127.0.0.11"))).fits

    assert asyncio.run(all_of_it())
