"""Notes are written by people, kept as they are, and on record."""

from collections.abc import Callable, Mapping

import pytest

from boresight.console.notes import service as notes
from boresight.console.runs.tables import Run
from boresight.errors import ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session


@pytest.mark.parametrize("kind", notes.TABLES)
def test_notes_are_kept_in_order_and_on_record(
    session: Session, people: Mapping[str, Actor], finished_run: Callable[..., Run], kind: str
) -> None:
    finished_run(session)
    notes.add_note(session, people["ana"], kind, 1, " Taken through the anomaly. ")
    row = notes.add_note(session, people["dee"], kind, 1, "Heater was off.")
    found = notes.list_notes(session, people["eve"], kind, 1)
    assert [(note.printed_name, note.text) for note in found] == [
        ("Ana", "Taken through the anomaly."),
        ("Dee", "Heater was off."),
    ]
    record = audit.last_change(session, f"{kind}/1/notes/{row.id}")
    assert record is not None
    assert (record.action, record.after) == ("noted", {"text": "Heater was off."})


@pytest.mark.parametrize("who", ["eve", "command line"])
def test_only_people_with_a_part_in_the_work_write(session: Session, people: Mapping[str, Actor], who: str) -> None:
    with pytest.raises(ForbiddenError):
        notes.add_note(session, people.get(who, COMMAND_LINE), "sensors", 1, "x")


@pytest.mark.parametrize("text", ["", "  \n ", "x" * 4001, "a\x00b"])
def test_nothing_too_much_or_what_nobody_sees_is_no_note(
    session: Session, people: Mapping[str, Actor], text: str
) -> None:
    with pytest.raises(RefusedInputError):
        notes.add_note(session, people["ana"], "sensors", 1, text)


@pytest.mark.parametrize(("kind", "number"), [("runs", 7), ("sensors", 7), ("parameter-sets", 7), ("users", 1)])
def test_a_note_is_on_something_that_is_there(
    session: Session, people: Mapping[str, Actor], kind: str, number: int
) -> None:
    with pytest.raises(NotFoundError):
        notes.add_note(session, people["ana"], kind, number, "x")
    with pytest.raises(NotFoundError):
        notes.list_notes(session, people["ana"], kind, number)
