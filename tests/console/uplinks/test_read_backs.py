"""Read-backs: verified by bytes or by CRC, said which; a mismatch keeps what differs; a signed entry makes a set active."""

import zipfile
from collections.abc import Callable, Mapping
from typing import Any

import pytest

from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks import packages
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.read_backs import MOST_DUMP_BYTES, choose_dump_or_crc, get_sent_table, read_back
from boresight.console.uplinks.tables import Uplink
from boresight.errors import (
    BoresightError,
    ConflictError,
    CorruptFileError,
    ForbiddenError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
)
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing, utc_after
from tests.console.uplinks.services import DOCUMENT, advance, define, newest, onboard, promote_by_hand, sent_table
from tests.refusals import has_code

People = Mapping[str, Actor]
Read = Callable[..., Uplink]


@pytest.fixture
def read(engine, people, blobs) -> Read:
    def make(what: bytes | str, set_id: int = 1, name: str = "dee", source: str = "TM 4711", **given: Any) -> Uplink:
        if isinstance(what, bytes):
            blobs.put(what)
        with open_writing(engine) as session:
            seen = given.pop("seen", session.get_one(ParameterSet, set_id).version)
            return read_back(session, people[name], blobs, set_id, what, source, seen, **given)

    return make


@pytest.fixture
def loaded(engine, people) -> bytes:
    define(engine, people["ana"])
    advance(engine, people["dee"], "SENT", "LOADED")
    return sent_table(engine).content


def flip(content: bytes, offset: int, mask: int) -> bytes:
    return content[:offset] + bytes([content[offset] ^ mask]) + content[offset + 1 :]


def test_the_same_bytes_verify_a_set_and_say_that_it_was_by_bytes(engine, people, read, loaded, blobs):
    row = read(loaded)
    assert (row.onboard_state, row.method, onboard(engine)) == ("VERIFIED", "bytes", "VERIFIED")
    evidence = row.evidence or {}
    assert (evidence["length_bytes"], evidence["differing_bytes"]) == (68, 0)
    assert evidence["definition"]["number"] == 1
    assert blobs.read(evidence["dump"]["sha256"]) == loaded
    assert (row.recorded_by, row.source) == (people["dee"].user_id, "TM 4711")


def test_the_same_crc_verifies_a_set_and_says_that_it_was_by_crc(engine, read, loaded):
    told = sent_table(engine).crc or ""
    assert told == f"0x{int.from_bytes(loaded[64:66], 'big'):04X}"
    row = read(f" {told.lower()} ")
    assert (row.onboard_state, row.method) == ("VERIFIED", "crc")
    assert row.evidence["crc"] == {"name": "CRC-16/CCITT-FALSE", "expected": told, "found": told}


def test_a_flipped_bit_is_a_mismatch_that_names_it_in_record_and_audit(engine, read, loaded):
    row = read(flip(loaded, 17, 0x10))
    assert (row.onboard_state, onboard(engine)) == ("MISMATCH", "MISMATCH")
    evidence = row.evidence or {}
    assert [(one["offset"], one["bits"], one["fields"]) for one in evidence["bytes"]] == [(17, [3], ["N0_PX"])]
    assert [field["parameter"] for field in evidence["fields"]] == ["n0_px"]
    with open_reading(engine) as session:
        change = audit.find_last_change(session, "parameter-sets/1")
    assert change.after["found"] == evidence["sentence"]


def test_another_crc_is_a_mismatch_whose_record_has_both_and_whose_sentence_does_not_tell_the_right_one(
    engine, read, loaded
):
    row = read("0x0000")
    assert row.onboard_state == "MISMATCH"
    assert row.evidence["crc"]["found"] == "0x0000"
    right = f"{int.from_bytes(loaded[64:66], 'big'):04X}"
    assert right in row.evidence["crc"]["expected"]
    assert right not in row.evidence["sentence"]  # whoever types the next one has to read it on board
    assert read(sent_table(engine).crc).onboard_state == "VERIFIED"


def test_a_dump_that_is_another_sets_table_is_told_by_name(engine, people, read, candidate):
    define(engine, people["ana"])
    row = candidate()
    with open_writing(engine) as session:
        promote_by_hand(session, session.get_one(ParameterSet, row.id), utc_after(0.0))
    advance(engine, people["dee"], "SENT", "LOADED", set_id=row.id)
    found = read(sent_table(engine, 1).content, set_id=row.id)
    assert found.evidence["same_as"] == "PS-ST16-1-0"
    assert "PS-ST16-1-0" in found.evidence["sentence"]


def test_what_bytes_have_shown_only_bytes_take_back(engine, read, loaded):
    read(flip(loaded, 0, 1))
    with pytest.raises(ConflictError, match="PS-ST16-1-0", check=has_code("dump-mismatched")):
        read(sent_table(engine).crc or "")
    assert read(loaded).onboard_state == "VERIFIED"


def test_an_active_set_that_reads_back_well_stays_active_and_else_is_a_mismatch(engine, people, read, loaded):
    advance(engine, people["dee"], "VERIFIED", "ACTIVE")
    assert (read(loaded).onboard_state, onboard(engine)) == ("ACTIVE", "ACTIVE")
    assert read(flip(loaded, 3, 2)).onboard_state == "MISMATCH"


def test_the_table_is_the_one_in_force_when_it_was_sent(engine, people, read, loaded):
    fields = [{**field, "byte_order": "little"} for field in DOCUMENT["fields"]]
    define(engine, people["ana"], fields=fields)
    row = read(loaded)
    assert (row.onboard_state, row.evidence["definition"]["number"]) == ("VERIFIED", 1)


def test_what_a_package_carried_is_what_a_dump_is_held_against(engine, people, read, blobs):
    define(engine, people["ana"])
    with open_writing(engine) as session:
        package = packages.build(session, people["dee"], blobs, 1, packages.prepare(session, people["dee"], blobs, 1))
        uplinks.record(session, people["dee"], 1, "SENT", "pass 1", package_id=package.id)
    advance(engine, people["dee"], "LOADED")
    with open_reading(engine) as session:
        reference = get_sent_table(session, blobs, session.get_one(ParameterSet, 1))
    with zipfile.ZipFile(blobs.path(package.sha256)) as packed:
        assert packed.read("table.bin") == reference.content
    row = read(reference.content)
    assert row.evidence["package"] == {"id": package.id, "sha256": package.sha256}
    blobs.path(package.sha256).write_bytes(b"altered")
    with pytest.raises(CorruptFileError):
        read(reference.content)


REFUSED: list[tuple[Any, dict[str, Any], type[BoresightError], str]] = [
    (b"short", {}, RefusedInputError, "5 bytes"),
    ("0x12345", {}, RefusedInputError, "'0x12345' is not a CRC-16/CCITT-FALSE; write it in hexadecimal"),
    ("xyz", {}, RefusedInputError, "'xyz' is not a CRC"),
    ("0x1", {"source": " "}, RefusedInputError, "Give the source"),
    ("0x1", {"name": "ana"}, ForbiddenError, "role operator"),
    ("0x1", {"name": "cy"}, ForbiddenError, "role operator"),
    ("0x1", {"name": "root"}, ForbiddenError, "role operator"),
    ("0x1", {"seen": None}, PreconditionRequiredError, "which version"),
    ("0x1", {"seen": 1}, StaleError, "changed since you read it"),
    ("0x1", {"happened": "2100-01-01"}, RefusedInputError, "in the future"),
]


@pytest.mark.parametrize(("what", "given", "error", "says"), REFUSED)
def test_a_refused_read_back_leaves_no_record(engine, read, loaded, what, given, error, says):
    assert loaded
    with pytest.raises(error, match=says):
        read(what, **given)
    assert (onboard(engine), newest(engine).onboard_state) == ("LOADED", "LOADED")


def test_only_what_is_loaded_and_defined_with_a_crc_is_read_back_by_crc(engine, people, read):
    define(engine, people["ana"], crc=None)
    with pytest.raises(ConflictError, match="NOT SENT", check=has_code("not-loaded")):
        read("0x1")
    advance(engine, people["dee"], "SENT", "LOADED")
    with pytest.raises(RefusedInputError, check=has_code("no-crc")):
        read("0x1")


def test_without_a_table_definition_nothing_can_be_compared(engine, people, read):
    advance(engine, people["dee"], "SENT", "LOADED")
    with pytest.raises(RefusedInputError, check=has_code("no-table-definition")):
        read("0x1")


@pytest.mark.parametrize(
    ("dump", "crc", "says"),
    [
        (None, " ", "either the dump or the CRC"),
        (b"x", "1", "either the dump or the CRC"),
        (bytes(MOST_DUMP_BYTES + 1), "", "over 200,000"),
    ],
)
def test_a_read_back_is_one_dump_or_one_crc(dump, crc, says):
    with pytest.raises(RefusedInputError, match=says):
        choose_dump_or_crc(dump, crc)
