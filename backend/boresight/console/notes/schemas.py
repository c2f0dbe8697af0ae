"""Notes on runs, sensors and parameter sets."""

from __future__ import annotations

from typing import Literal

from boresight.console.schemas import Row


class NoteAttachment(Row):
    """A file that the author of a note added to it."""

    id: int
    note_id: int
    name: str
    sha256: str
    size_bytes: int
    made_utc: str


class Note(Row):
    """What a person wrote down about a run, a sensor or a parameter set; never edited."""

    id: int
    subject_kind: Literal["runs", "sensors", "parameter-sets"]
    subject_id: int
    user_id: int
    printed_name: str
    text: str
    made_utc: str
    attachments: list[NoteAttachment]


class Annotation(Row):
    """What a person says of a time of a sensor's mission, drawn on its trend; never edited."""

    id: int
    sensor_id: int
    at_utc: str
    user_id: int
    printed_name: str
    text: str
    made_utc: str
