"""Every move on board, by everybody, from every state: what is not allowed by the list is refused and leaves nothing."""

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import pytest

from boresight.console.parameter_sets.tables import ONBOARD_STATES, ParameterSet
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.read_backs import READABLE, read_back
from boresight.console.uplinks.tables import Uplink
from boresight.errors import BoresightError, ConflictError, ForbiddenError
from boresight.platform.actors import COMMAND_LINE, SYSTEM, Actor
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, Session, mark_dry_run, open_reading, open_writing, utc_now
from tests.console.conftest import PASSWORD
from tests.console.uplinks.services import define, sent_table
from tests.passwords import proved

OPERATOR = frozenset({"operator"})
STATEMENTS = tuple(f"record {state}" for state in ONBOARD_STATES)
MOVES = (*STATEMENTS, "read back well", "read back badly", "sign active")


@dataclass(frozen=True)
class Person:
    make: Callable[[Mapping[str, Actor]], Actor]
    moves: tuple[str, ...] = ()


def _key(actor: Actor, *scopes: str) -> Actor:
    return replace(actor, credential="key:abcd", scopes=frozenset(scopes))


BUT_SIGNING = tuple(move for move in MOVES if move not in {"record ACTIVE", "sign active"})
PERSONS = {
    "viewer": Person(lambda people: people["eve"]),
    "analyst": Person(lambda people: people["ana"]),
    "approver": Person(lambda people: people["cy"]),
    "analyst and approver": Person(lambda people: people["bo"]),
    "administrator": Person(lambda people: people["root"]),
    "operator": Person(lambda people: people["dee"], MOVES),
    "operator and administrator": Person(
        lambda people: replace(people["dee"], roles=OPERATOR | {"administrator"}), BUT_SIGNING
    ),
    "operator's key": Person(lambda people: _key(people["dee"], "uplinks"), BUT_SIGNING),
    "operator's key for runs": Person(lambda people: _key(people["dee"], "runs", "parameter-sets")),
    "command line": Person(lambda _: COMMAND_LINE),
    "system": Person(lambda _: SYSTEM),
}


def _leads_to(move: str, state: str) -> str | None:
    if move in STATEMENTS:
        wanted = move.removeprefix("record ")
        return wanted if wanted in uplinks.STATED and wanted in uplinks.NEXT[state] else None
    if move == "sign active":
        return "ACTIVE" if state == "VERIFIED" else None
    if state not in READABLE:
        return None
    return "MISMATCH" if move == "read back badly" else "ACTIVE" if state == "ACTIVE" else "VERIFIED"


def _make(session: Session, actor: Actor, blobs: BlobStore, move: str, table: bytes) -> Uplink:
    seen = session.get_one(ParameterSet, 1).version
    if move in STATEMENTS:
        return uplinks.record(session, actor, 1, move.removeprefix("record "), "pass 1", seen)
    if move == "sign active":
        return uplinks.activate(session, actor, 1, "pass 1", "I saw it.", proved(session, actor, PASSWORD), seen)
    dump = table if move == "read back well" else bytes([table[0] ^ 1]) + table[1:]
    return read_back(session, actor, blobs, 1, dump, "pass 1", seen)


def _put(session: Session, state: str) -> None:
    mark_dry_run(session)
    session.get_one(ParameterSet, 1).onboard_state = state
    if state != "NOT SENT":
        columns = {"source": "pass 1", "recorded_utc": utc_now(), "recorded_by": 1, "method": "crc"}
        session.add(Uplink(parameter_set_id=1, onboard_state=state, **columns))
    session.flush()
    audit.append(session, COMMAND_LINE, "put", "parameter-sets/1")


def _table() -> Iterator[tuple[str, str]]:
    yield from itertools.product(ONBOARD_STATES, MOVES)


@pytest.mark.parametrize("name", PERSONS)
def test_a_move_succeeds_where_person_and_state_allow_it_and_nowhere_else(
    engine: Engine, people: Mapping[str, Actor], blobs: BlobStore, name: str
) -> None:
    define(engine, people["ana"])
    table, person = sent_table(engine).content, PERSONS[name]
    actor = person.make(people)
    for state, move in _table():
        end = _leads_to(move, state) if move in person.moves else None
        if end is not None:
            with open_writing(engine) as session:
                _put(session, state)
                assert _make(session, actor, blobs, move, table).onboard_state == end, (state, move)
            continue
        refusals: tuple[type[BoresightError], ...] = (ForbiddenError,)
        if move in person.moves:
            refusals = (ConflictError,)
        elif move in {"record ACTIVE", "sign active"} and person.moves:
            refusals = (ForbiddenError, ConflictError)
        with open_writing(engine) as session:
            _put(session, state)
            with pytest.raises(refusals):
                _make(session, actor, blobs, move, table)
            assert session.get_one(ParameterSet, 1).onboard_state == state, (state, move)
    with open_reading(engine) as session:
        assert not uplinks.list_uplinks(session)


def test_the_list_of_moves_leaves_no_state_and_no_service_out() -> None:
    assert {state for state, _ in _table()} == set(uplinks.NEXT) == set(ONBOARD_STATES)
    assert len(list(_table())) * len(PERSONS) == 7 * 10 * 11
    assert all(_leads_to(move, "NOT SENT") is None for move in MOVES if move != "record SENT")
