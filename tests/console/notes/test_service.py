"""Notes are written by people, kept as they are, and on record."""

import pytest

from boresight.console.notes import service as notes
from boresight.errors import ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit


@pytest.mark.parametrize("kind", notes.TABLES)
def test_notes_are_kept_in_order_and_on_record(session, people, finished_run, kind):
    finished_run(session)
    notes.add_note(session, people["ana"], kind, 1, " Taken through the anomaly. ")
    row = notes.add_note(session, people["dee"], kind, 1, "Heater was off.")
    found = notes.list_notes(session, kind, 1)
    assert [(note.printed_name, note.text) for note in found] == [
        ("Ana", "Taken through the anomaly."),
        ("Dee", "Heater was off."),
    ]
    record = audit.find_last_change(session, f"{kind}/1/notes/{row.id}")
    assert (record.action, record.after) == ("noted", {"text": "Heater was off."})


@pytest.mark.parametrize(
    ("who", "text", "error"),
    [
        *((who, "x", ForbiddenError) for who in ("eve", "command line")),
        *(("ana", text, RefusedInputError) for text in ("", "  \n ", "x" * 4001, "a\x00b")),
    ],
)
def test_only_people_with_a_part_in_the_work_write_and_something_to_read(session, people, who, text, error):
    with pytest.raises(error):
        notes.add_note(session, people.get(who, COMMAND_LINE), "sensors", 1, text)


@pytest.mark.parametrize(("kind", "number"), [("runs", 7), ("sensors", 7), ("parameter-sets", 7), ("users", 1)])
def test_a_note_is_on_something_that_is_there(session, people, kind, number):
    with pytest.raises(NotFoundError):
        notes.add_note(session, people["ana"], kind, number, "x")
    with pytest.raises(NotFoundError):
        notes.list_notes(session, kind, number)
