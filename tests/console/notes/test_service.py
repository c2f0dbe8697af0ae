"""Notes are written by people, kept as they are, and on record."""

import pytest

from boresight.console.fleet.trend_document import make_trend_document
from boresight.console.notes import service as notes
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError
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


def test_annotations_stand_by_their_times_on_record_and_on_the_trend(session, people):
    notes.annotate(session, people["ana"], 1, "2026-11-22", "Heaters on again.")
    row = notes.annotate(session, people["dee"], 1, "2026-11-21T03:04:05+01:00", " Safe \n mode. ")
    assert [(said.at_utc[:19], said.text, said.printed_name) for said in notes.list_annotations(session, 1)] == [
        ("2026-11-21T02:04:05", "Safe mode.", "Dee"),
        ("2026-11-22T00:00:00", "Heaters on again.", "Ana"),
    ]
    record = audit.find_last_change(session, f"sensors/1/annotations/{row.id}")
    assert (record.action, record.after) == ("annotated", {"at_utc": row.at_utc, "text": "Safe mode."})
    drawn = make_trend_document(session, 1).annotations
    assert [said.text for said in drawn] == ["Safe mode.", "Heaters on again."]


@pytest.mark.parametrize(
    ("who", "at", "text", "error"),
    [
        *((who, "2026-11-21", "x", ForbiddenError) for who in ("eve", "command line")),
        *(("ana", "2026-11-21", text, RefusedInputError) for text in ("", " \n ", "x" * 201, "a\x00b")),
        *(("ana", at, "x", RefusedInputError) for at in ("", "yesterday", "2026-13-01")),
    ],
)
def test_only_people_with_a_part_in_the_work_annotate_a_time_with_something_to_read(
    session, people, who, at, text, error
):
    with pytest.raises(error):
        notes.annotate(session, people.get(who, COMMAND_LINE), 1, at, text)


def test_a_trend_has_an_end_of_annotations_and_only_a_sensor_has_one(session, people, monkeypatch):
    monkeypatch.setattr(notes, "MOST_ANNOTATIONS", 1)
    notes.annotate(session, people["ana"], 1, "2026-11-21", "x")
    with pytest.raises(ConflictError):
        notes.annotate(session, people["ana"], 1, "2026-11-21", "x")
    with pytest.raises(NotFoundError):
        notes.annotate(session, people["ana"], 7, "2026-11-21", "x")


def test_a_refused_annotation_keeps_what_was_typed(site):
    ada = site.visitor("ada")
    answer = ada.post("/sensors/1/annotations", at="then", text="Safe mode.")
    assert answer.status_code == 422
    assert 'value="then"' in answer.text
    assert 'value="Safe mode."' in answer.text
    assert (
        ada.post("/sensors/1/annotations", at="2026-11-21", text="Safe mode.")
        .headers["location"]
        .endswith("#annotations")
    )
    assert "Safe mode." in ada.get("/sensors/1/trend")
