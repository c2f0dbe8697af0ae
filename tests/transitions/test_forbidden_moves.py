"""Forbidden moves, generated from one list: the server refuses each and changes nothing; the allowed few it would make."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Iterator
from functools import cache, cached_property
from typing import Any

import httpx
import pytest

from boresight.console import list_queries as lists
from boresight.console.access import users
from boresight.console.access.tables import ROLES, User
from boresight.console.approvals import service as approvals
from boresight.console.approvals import staleness
from boresight.console.approvals.staleness import make_stale_of_set
from boresight.console.approvals.tables import Approval
from boresight.console.parameter_sets.tables import GROUND_STATES, ParameterSet
from boresight.console.uplinks.tables import TableDefinition
from boresight.platform.actors import COMMAND_LINE, POLICY, Actor, Policy
from boresight.platform.audit import log as audit
from boresight.platform.db.declared import Base
from boresight.platform.db.sessions import open_reading, open_writing, utc_now
from boresight.sky.catalogue import Catalogue
from tests.console.operations import OPENAPI
from tests.passwords import new_password, proved
from tests.served import serving, settings_in
from tests.stores import on_postgresql
from tests.transitions.installation import CHEAP_HASH, PASSWORD, WORDS, ExampleRun, Installation, tag
from tests.transitions.moves import ACTORS, ALLOWED, FORBIDDEN, MOVES, OF_REQUEST, PLACES, TRANSITIONS, Move

PEOPLE = {
    **{role: (role,) for role in ROLES},
    "submitter": ("analyst", "approver"),
    "launcher": ("analyst", "approver"),
    "creator": ("analyst", "approver"),
    "signer": ("approver",),
    "newcomer": ("approver",),
    "console": ("viewer",),
    "promoter": ("operator",),
}
NO_REQUEST = ("/api/v1/approvals/999999", 1)
BESIDE = {
    "assess",
    "waive",
    "export",
    "hand-over",
    "read-back",
    "activate",
    "resolve",
    "reopen",
}  # of a set, and move no request and no ground state
BETWEEN = {"api_keys": ("last_used_utc",)}  # columns that no transition writes


class Board:
    def __init__(self, installation: Installation) -> None:
        self.installation = installation
        self.sets: dict[str, int] = {}
        self.clients: dict[str, httpx.Client] = {}
        self.connection = installation.engine.connect()
        self.known: tuple[object, str] = (None, "")

    def close(self) -> None:
        self.connection.close()
        for client in self.clients.values():
            client.close()
        self.installation.engine.dispose()

    def actor(self, name: str) -> Actor:
        return self.installation.actor(name)

    def client(self, name: str) -> httpx.Client:
        if name not in self.clients:
            owner = name.removeprefix("key of the ")
            self.clients[name] = self.installation.client(name) if owner == name else self.installation.key(owner)
        return self.clients[name]

    def find_request(self, place: str) -> Approval | None:
        with open_reading(self.installation.engine) as session:
            return next(iter(lists.list_newest(session, Approval, set=self.sets[place])), None)

    @cache  # noqa: B019 - no move of this file is made, and one board is made
    def seen(self, place: str, kind: str) -> tuple[str, int]:
        if kind == "set":
            row = self.installation.find_set(self.sets[place])
            return f"/api/v1/parameter-sets/{row.id}", row.version
        request = self.find_request(place)
        return (f"/api/v1/approvals/{request.id}", request.version) if request else NO_REQUEST

    @cached_property
    def asked(self) -> int:
        return self.actor("approver").user_id or 0

    def try_move(self, move: Move, headers: dict[str, str] | None = None, **params: str) -> httpx.Response:
        address, version = self.seen(move.place, "request" if move.transition in OF_REQUEST else "set")
        name, over_the_shoulder, _ = move.transition.partition("-over-the-shoulder")
        body: dict[str, Any] | None = {"reason": "It moved."}
        client = self.client(move.actor)
        if move.transition in OF_REQUEST:
            body = {"user_id": self.asked} if name == "assign" else dict(WORDS)
        if over_the_shoulder:
            body = {**WORDS, "name": move.actor.removeprefix("key of the "), "decision": name.upper()}
            name = "sign-over-the-shoulder"
            client = client if move.actor.startswith("key") else self.client("console")
        headers = tag(version) if headers is None else headers
        body = None if name == "promote" else body
        return client.post(f"{address}:{name}", json=body, headers=headers, params=params)

    def digest(self) -> str:
        """The digest of every row; SQLite tells by a number whether anything was committed since the last."""
        with self.connection.begin():
            at = str(self.connection.exec_driver_sql("PRAGMA data_version").scalar()) if not on_postgresql() else None
            if at is None or at != self.known[0]:
                digest = hashlib.sha256()
                for query in _everything():
                    digest.update(repr(self.connection.exec_driver_sql(query).fetchall()).encode())
                self.known = (at, digest.hexdigest())
        return self.known[1]


@cache
def _everything() -> list[str]:
    queries = []
    for table in Base.metadata.sorted_tables:
        named = ", ".join(column.name for column in table.columns if column.name not in BETWEEN.get(table.name, ()))
        order = ", ".join(column.name for column in table.primary_key)
        queries.append(f'SELECT {named} FROM "{table.name}" ORDER BY {order}')  # noqa: S608 - names of our own columns
    return queries


def _open(board: Board, place: str, policy: Policy = POLICY, sensor_id: int | None = None) -> ParameterSet:
    house = board.installation
    row = house.candidate(sensor_id or house.sensor(), board.actor("launcher"), board.actor("creator"))
    board.sets[place] = row.id
    with open_writing(house.engine) as session:
        asked = (house.blobs, row.id, "It moved.", row.version)
        approvals.submit(session, board.actor("submitter"), *asked, policy=policy)
    return house.find_set(row.id)


def _sign(board: Board, place: str, decision: str = "APPROVE") -> None:
    request = board.find_request(place)
    assert request is not None
    with open_writing(board.installation.engine) as session:
        proof = proved(session, board.actor("signer"), PASSWORD)
        words = (approvals.Decision(decision, WORDS["meaning"], WORDS["comment"]), proof, request.version)
        approvals.sign(session, board.actor("signer"), request.id, *words)


def _promote(board: Board, place: str) -> None:
    _sign(board, place)
    row = board.installation.find_set(board.sets[place])
    with open_writing(board.installation.engine) as session:
        approvals.promote(session, board.actor("promoter"), row.id, row.version)


POLICIES = {"EXPIRED": Policy(approval_days=0.0), "HALF": Policy(approvals=2)}


def _place(board: Board, place: str) -> None:
    house = board.installation
    if place == "CANDIDATE":
        board.sets[place] = house.candidate(house.sensor(), board.actor("launcher"), board.actor("creator")).id
        return
    row = _open(board, place, POLICIES.get(place, POLICY))
    if place in {"APPROVED", "HALF", "REJECTED"}:
        _sign(board, place, "REFUSE" if place == "REJECTED" else "APPROVE")
    if place in {"BASELINE", "SUPERSEDED"}:
        _promote(board, place)
    if place == "SUPERSEDED":
        _open(board, "successor", sensor_id=row.sensor_id)
        _promote(board, "successor")
    with open_writing(house.engine) as session:
        if place == "WITHDRAWN":
            approvals.withdraw(session, board.actor("submitter"), row.id, row.version)
        if place == "EXPIRED":
            staleness.expire_due_requests(session)
        if place == "STALE":
            make_stale_of_set(session, COMMAND_LINE, row.id, "the gate profile became version 1")


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory, example_run: ExampleRun, catalogue: Catalogue) -> Iterator[Board]:
    settings = settings_in(tmp_path_factory.mktemp("moves"), login_attempts="1000")
    made = Board(Installation(settings, example_run, PEOPLE))
    for place in PLACES:
        _place(made, place)
    root, newcomer = made.actor("administrator"), made.actor("newcomer")
    with open_writing(made.installation.engine) as session:
        users.change_password(session, root, newcomer.user_id or 0, new_password(PASSWORD))
        given = session.get_one(User, newcomer.user_id)
        given.must_change_password, given.password_hash = 1, CHEAP_HASH
    with serving(settings, catalogue) as (address, _):
        made.installation.address = address
        for name in (*ACTORS, "console"):
            made.client(name)
        yield made
    made.close()


def test_the_list_has_every_actor_with_every_transition_in_every_place() -> None:
    assert len(MOVES) == len(set(MOVES)) == len(ACTORS) * len(TRANSITIONS) * len(PLACES)
    assert set(MOVES) == {Move(*parts) for parts in itertools.product(ACTORS, TRANSITIONS, PLACES)}
    assert set(FORBIDDEN) | ALLOWED == set(MOVES)
    assert set(FORBIDDEN).isdisjoint(ALLOWED)
    assert {*ROLES} < {*ACTORS}


def test_the_list_has_every_transition_that_the_document_has() -> None:
    named = {name.rpartition(":")[2] for name in _transitions_of_the_document()}
    assert named - BESIDE == {name for name in TRANSITIONS if "shoulder" not in name} | {"sign-over-the-shoulder"}


def _transitions_of_the_document() -> list[str]:
    paths = [path for path, methods in OPENAPI["paths"].items() if "post" in methods and ":" in path]
    return [path for path in paths if path.startswith(("/api/v1/parameter-sets", "/api/v1/approvals"))]


def test_every_place_holds_what_its_name_says(board: Board) -> None:
    states = {place: board.installation.find_set(board.sets[place]).ground_state for place in PLACES}
    requests = {place: board.find_request(place) for place in PLACES}
    assert states == {place: place for place in GROUND_STATES} | {"STALE": "CANDIDATE", "HALF": "SUBMITTED"}
    assert {place: request.state for place, request in requests.items() if request} == {
        "SUBMITTED": "OPEN",
        "HALF": "OPEN",
        "APPROVED": "APPROVED",
        "BASELINE": "APPROVED",
        "SUPERSEDED": "APPROVED",
        "REJECTED": "REJECTED",
        "WITHDRAWN": "WITHDRAWN",
        "EXPIRED": "EXPIRED",
        "STALE": "STALE",
    }


@pytest.mark.parametrize("aim", sorted({(move.transition, move.place) for move in FORBIDDEN}), ids=", ".join)
def test_a_forbidden_move_is_refused_and_changes_nothing(board: Board, aim: tuple[str, str]) -> None:
    before = board.digest()
    for move in [move for move in FORBIDDEN if (move.transition, move.place) == aim]:
        answer = board.try_move(move)
        absent = move.place == "CANDIDATE" and move.transition in OF_REQUEST  # it never had a request
        assert answer.status_code in ({403, 404} if absent else {403, 409, 412}), (move, answer.text)
        assert answer.json()["detail"], move
        assert board.digest() == before, move


@pytest.mark.parametrize("move", sorted(ALLOWED, key=str), ids=str)
def test_an_allowed_move_would_be_made(board: Board, move: Move) -> None:
    before = board.digest()
    answer = board.try_move(move, validate_only="true")
    assert answer.status_code == 200, answer.text
    assert answer.headers["x-validate-only"] == "true"
    assert board.digest() == before


@pytest.mark.parametrize("move", sorted(ALLOWED, key=str), ids=str)
def test_what_is_allowed_is_not_without_the_version_that_was_seen(board: Board, move: Move) -> None:
    before = board.digest()
    unsaid, older = board.try_move(move, {}), board.try_move(move, tag(0))
    assert (unsaid.status_code, older.status_code) == (428, 412)
    assert "If-Match" in unsaid.json()["detail"]
    assert re.search(r"v0, .* v\d+\): .+ 20\d\d-", older.json()["detail"])  # who, what and when
    assert board.digest() == before


@pytest.mark.parametrize("move", [Move("approver", "approve", "MOVED"), Move("operator", "promote", "MOVED")], ids=str)
def test_what_was_bound_and_moved_is_refused_and_only_its_request_becomes_stale(board: Board, move: Move) -> None:
    row = _open(board, "MOVED")
    if move.transition == "promote":
        _sign(board, "MOVED")
    with open_writing(board.installation.engine) as session:  # past the services, which would make it stale at once
        session.add(
            TableDefinition(
                sensor_id=row.sensor_id, number=1, document={}, sha256="0" * 64, reason="x", created_utc=utc_now()
            )
        )
        audit.append(session, COMMAND_LINE, "brought in", f"sensors/{row.sensor_id}")
    board.seen.cache_clear()
    before = board.digest()
    assert board.try_move(move, validate_only="true").status_code == 412
    assert board.digest() == before
    answer = board.try_move(move)
    request = board.find_request("MOVED")
    assert answer.status_code == 412
    assert "The table definition changed since" in answer.json()["detail"]
    assert request is not None
    assert (request.state, board.installation.find_set(row.id).ground_state) == ("STALE", "CANDIDATE")


def test_a_signature_that_comes_too_late_is_refused_whoever_lets_the_request_expire(board: Board) -> None:
    _open(board, "LATE", Policy(approval_days=0.0))
    board.seen.cache_clear()
    answer = board.try_move(Move("approver", "approve", "LATE"))
    request = board.find_request("LATE")
    assert answer.status_code in {409, 412}
    assert "expire" in answer.json()["detail"]
    assert request is not None
    assert request.state == "EXPIRED"
