"""That a set is active is signed: an operator in person, the password again, a meaning, a source."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from boresight.console.access import users
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.service import add_entry
from boresight.console.uplinks.tables import Package, Uplink
from boresight.errors import (
    BoresightError,
    ConflictError,
    ForbiddenError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
    UnauthenticatedError,
)
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, open_reading, open_writing, utc_now
from tests.console.conftest import PASSWORD
from tests.console.uplinks.services import climb, define, newest, onboard
from tests.passwords import new_password, proved

People = Mapping[str, Actor]
MEANING = "I saw this table active in telemetry."


def activate(engine: Engine, actor: Actor, **given: Any) -> Uplink:
    entry = {"source": "TM page STR-2", "meaning": MEANING, "password": PASSWORD} | given
    with open_writing(engine) as session:
        entry["proof"] = proved(session, actor, entry.pop("password"))
        seen = entry.pop("seen", session.get_one(ParameterSet, 1).version)
        return uplinks.activate(session, actor, 1, seen_version=seen, **entry)


@pytest.fixture
def verified(engine: Engine, people: People) -> None:
    climb(engine, people["dee"], "SENT", "LOADED", "VERIFIED")


@pytest.mark.usefixtures("verified")
def test_a_signed_entry_keeps_name_meaning_source_and_the_hash_of_what_was_shown(
    engine: Engine, people: People
) -> None:
    with open_reading(engine) as session:
        shown = uplinks.shown_sha256(session, session.get_one(ParameterSet, 1))
    row = activate(engine, people["dee"])
    assert (row.onboard_state, onboard(engine)) == ("ACTIVE", "ACTIVE")
    assert (row.printed_name, row.meaning, row.source, row.method) == ("Dee", MEANING, "TM page STR-2", None)
    assert (row.evidence or {})["shown_sha256"] == shown
    with open_reading(engine) as session:
        change = audit.last_change(session, "parameter-sets/1")
    assert change is not None
    assert (change.action, (change.after or {})["meaning"]) == ("recorded ACTIVE for", MEANING)


REFUSED: list[tuple[str, dict[str, Any], type[BoresightError], str]] = [
    ("dee", {"password": "wrong"}, UnauthenticatedError, "password"),
    ("dee", {"meaning": "  "}, RefusedInputError, "Say what your signature means"),
    ("dee", {"source": ""}, RefusedInputError, "Say where this is known from"),
    ("dee", {"seen": None}, PreconditionRequiredError, "which version"),
    ("dee", {"seen": 1}, StaleError, "changed since you looked"),
    ("dee", {"happened": "soon"}, RefusedInputError, "is no time"),
    ("ana", {}, ForbiddenError, "role operator"),
    ("cy", {}, ForbiddenError, "role operator"),
    ("root", {}, ForbiddenError, "An administrator cannot sign"),
]


@pytest.mark.usefixtures("verified")
@pytest.mark.parametrize(("name", "given", "error", "says"), REFUSED)
def test_an_entry_that_is_not_signed_as_it_must_be_leaves_no_record(
    engine: Engine, people: People, name: str, given: dict[str, Any], error: type[BoresightError], says: str
) -> None:
    with pytest.raises(error, match=says):
        activate(engine, people[name], **given)
    assert newest(engine).onboard_state == "VERIFIED"


@pytest.mark.usefixtures("verified")
def test_neither_a_key_nor_an_administrator_who_is_also_operator_signs(engine: Engine, people: People) -> None:
    key = replace(people["dee"], credential="key:abc", scopes=frozenset({"uplinks"}))
    with pytest.raises(ForbiddenError, match="Only a person who is logged in"):
        activate(engine, key)
    both = replace(people["dee"], roles=frozenset({"operator", "administrator"}))
    with pytest.raises(ForbiddenError, match="An administrator cannot sign"):
        activate(engine, both)


@pytest.mark.usefixtures("verified")
def test_whose_password_somebody_else_set_does_not_sign(engine: Engine, people: People) -> None:
    dee = people["dee"]
    with open_writing(engine) as session:
        users.change_password(session, people["root"], dee.user_id or 0, new_password("given by root"))
    with pytest.raises(ForbiddenError, match="Somebody else set your password"):
        activate(engine, dee, password="given by root")


def test_only_what_is_verified_is_signed_as_active(engine: Engine, people: People) -> None:
    climb(engine, people["dee"], "SENT", "LOADED")
    with pytest.raises(ConflictError, match="is LOADED on board; next can be VERIFIED"):
        activate(engine, people["dee"])


def test_what_an_earlier_version_took_for_verified_on_somebodys_word_is_read_back_before_it_is_signed(
    engine: Engine, people: People
) -> None:
    climb(engine, people["dee"], "SENT", "LOADED")
    with open_writing(engine) as session:
        add_entry(session, people["dee"], session.get_one(ParameterSet, 1), "VERIFIED", "pass 4711")
    with pytest.raises(ConflictError, match="is VERIFIED by statement alone; read it back by dump or CRC"):
        activate(engine, people["dee"])
    climb(engine, people["dee"], "VERIFIED")
    assert activate(engine, people["dee"]).onboard_state == "ACTIVE"


def test_a_record_names_the_package_that_was_sent_and_no_other_sets(
    engine: Engine, people: People, candidate: Any
) -> None:
    other = candidate()
    with open_writing(engine) as session:
        sha256 = session.get_one(ParameterSet, other.id).document["result_sha256"]
        for set_id in (1, other.id):
            session.add(Package(parameter_set_id=set_id, inputs={}, sha256=sha256, created_utc=utc_now()))
        session.flush()
        audit.append(session, people["dee"], "built", "packages/1")
    with open_writing(engine) as session:
        row = uplinks.record(session, people["dee"], 1, "SENT", "pass 1", package_id=1)
    assert (row.evidence or {})["package"] == {"id": 1, "sha256": sha256}
    with pytest.raises(RefusedInputError, match="no package 2 of PS-ST16-1-0"), open_writing(engine) as session:
        uplinks.record(session, people["dee"], 1, "LOADED", "pass 1", package_id=2)


def test_a_package_for_a_table_that_is_no_longer_in_force_is_not_sent(
    engine: Engine, people: People, candidate: Any
) -> None:
    sha256 = candidate().document["result_sha256"]
    old = define(engine, people["ana"])
    with open_writing(engine) as session:
        columns = {"inputs": {}, "sha256": sha256, "created_utc": utc_now(), "table_definition_id": old.id}
        session.add(Package(parameter_set_id=1, **columns))
        session.flush()
        audit.append(session, people["dee"], "built", "packages/1")
    define(engine, people["ana"], flight_software_version="4.3")
    with pytest.raises(ConflictError, match="built for another table definition"), open_writing(engine) as session:
        uplinks.record(session, people["dee"], 1, "SENT", "pass 1", package_id=1)
