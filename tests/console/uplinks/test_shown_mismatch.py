"""A mismatch that a dump showed stands until a dump agrees or the table is sent again, whatever is recorded in between."""

from collections.abc import Mapping, Sequence
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from boresight.console import list_queries as lists
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.read_backs import read_back
from boresight.console.uplinks.service import has_shown_mismatch
from boresight.console.uplinks.tables import Uplink
from boresight.errors import ConflictError
from boresight.platform.actors import Actor
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, Session, mark_dry_run, open_writing
from tests.console.conftest import PASSWORD
from tests.console.uplinks.services import define, sent_table
from tests.effort import effort
from tests.passwords import proved

People = Mapping[str, Actor]
READ = ("good dump", "bad dump", "good crc", "bad crc")
MOVES = st.sampled_from((*uplinks.NEXT, *READ, "sign"))
CLAIMS = ("LOADED", "VERIFIED", "ACTIVE")  # what would say that the right table is there


class Board:
    def __init__(self, session: Session, dee: Actor, blobs: BlobStore, table: bytes, crc: str) -> None:
        self.session, self.dee, self.blobs = session, dee, blobs
        self.read = {"good dump": table, "bad dump": bytes([table[0] ^ 1]) + table[1:], "good crc": crc, "bad crc": "0"}
        self.stands = False

    @property
    def row(self) -> ParameterSet:
        return self.session.get_one(ParameterSet, 1)

    def make(self, move: str) -> None:
        seen = self.row.version
        if move == "sign":
            uplinks.activate(
                self.session, self.dee, 1, "pass 1", "I saw it.", proved(self.session, self.dee, PASSWORD), seen
            )
        elif move in READ:
            if isinstance(self.read[move], bytes):
                self.blobs.put(self.read[move])
            read_back(self.session, self.dee, self.blobs, 1, self.read[move], "pass 1", seen)
        else:
            uplinks.record(self.session, self.dee, 1, move, "pass 1", seen)
        self.stands = move == "bad dump" or (self.stands and move not in {"good dump", "SENT"})

    def try_all(self, moves: Sequence[str]) -> None:
        for move in moves:
            with suppress(ConflictError):
                self.make(move)
            assert has_shown_mismatch(self.session, self.row) == self.stands
            assert not (self.stands and self.row.onboard_state in CLAIMS), moves
        self.hold_each_claim_to_its_basis()

    def hold_each_claim_to_its_basis(self) -> None:
        for record in lists.list_newest(self.session, Uplink, set=1):
            assert record.onboard_state != "VERIFIED" or record.method is not None
            assert record.onboard_state != "ACTIVE" or record.method is not None or record.printed_name == "Dee"


def _board(session: Session, engine: Engine, people: People, blobs: BlobStore) -> Board:
    sent = sent_table(engine)
    mark_dry_run(session)
    return Board(session, people["dee"], blobs, sent.content, sent.crc or "")


@settings(max_examples=effort(12, 60), suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(moves=st.lists(MOVES, max_size=12), shown=st.booleans())
def test_no_sequence_of_records_takes_back_what_a_dump_showed(engine, people, blobs, moves, shown) -> None:
    with open_writing(engine) as session:
        board = _board(session, engine, people, blobs)
        board.try_all(["SENT", "LOADED", *(["bad dump"] if shown else []), *moves])


@pytest.fixture(autouse=True)
def defined(engine, people) -> None:
    define(engine, people["ana"])


@pytest.mark.few(6)
@pytest.mark.parametrize("between", [("UNKNOWN",), ("UNKNOWN", "MISMATCH"), ("UNKNOWN", "MISMATCH", "UNKNOWN")])
@pytest.mark.parametrize("attempt", ["good crc", "bad crc", "LOADED", "VERIFIED", "ACTIVE", "sign"])
def test_what_is_said_in_between_does_not_open_the_way_round_the_bytes(engine, people, blobs, between, attempt):
    with open_writing(engine) as session:
        board = _board(session, engine, people, blobs)
        for move in ("SENT", "LOADED", "bad dump", *between):
            board.make(move)
        with pytest.raises(ConflictError):
            board.make(attempt)
        board.make("good dump")
        assert board.row.onboard_state == "VERIFIED"


def test_sent_again_a_table_is_verified_by_its_crc(engine, people, blobs):
    with open_writing(engine) as session:
        board = _board(session, engine, people, blobs)
        for move in ("SENT", "LOADED", "bad dump", "UNKNOWN", "SENT", "LOADED", "good crc", "sign"):
            board.make(move)
        assert board.row.onboard_state == "ACTIVE"
        board.hold_each_claim_to_its_basis()
