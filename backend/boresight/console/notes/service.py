"""Notes on runs, sensors and parameter sets, and annotations of trends: what a person observed or decided; only ever added."""

from __future__ import annotations

from collections.abc import Sequence

from boresight.console.fleet.tables import Sensor
from boresight.console.notes import queries
from boresight.console.notes.tables import NOTE_SUBJECTS, Annotation, Note
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, require_person, require_role
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.db.times import read_time
from boresight.platform.web.text_validation import refuse_control_characters

LONGEST_NOTE = 4000
LONGEST_ANNOTATION, MOST_ANNOTATIONS = 200, 500  # of a sensor: more lines hide the trend
WRITERS = ("analyst", "operator", "approver", "administrator")
TABLES: dict[str, tuple[type[Run | Sensor | ParameterSet], str]] = {
    "runs": (Run, "run"),
    "sensors": (Sensor, "sensor"),
    "parameter-sets": (ParameterSet, "parameter set"),
}


def list_notes(session: Session, kind: str, subject_id: int) -> Sequence[Note]:
    """Return the notes on a thing, in order."""
    _require_subject(session, kind, subject_id)
    return queries.list_notes(session, kind, subject_id)


def add_note(session: Session, actor: Actor, kind: str, subject_id: int, text: str) -> Note:
    """Write a note; nobody can change it afterwards."""
    user_id = require_person(actor, "write a note")
    require_role(actor, *WRITERS)
    _require_subject(session, kind, subject_id)
    refuse_control_characters(note=text)
    said = text.strip()
    if not said or len(said) > LONGEST_NOTE:
        raise RefusedInputError(f"A note of {len(said)} characters cannot be kept; write 1 to {LONGEST_NOTE}.")
    row = Note(
        subject_kind=kind,
        subject_id=subject_id,
        user_id=user_id,
        printed_name=actor.printed_name,
        text=said,
        made_utc=utc_now(),
    )
    session.put(row)
    audit.append(session, actor, "noted", f"{kind}/{subject_id}/notes/{row.id}", None, {"text": said})
    return row


def annotate(session: Session, actor: Actor, sensor_id: int, at: str, text: str) -> Annotation:
    """Say something of a time of a sensor's mission; nobody can change it afterwards."""
    user_id = require_person(actor, "annotate a trend")
    require_role(actor, *WRITERS)
    session.get_known(Sensor, sensor_id)
    refuse_control_characters(annotation=text)
    said = " ".join(text.split())
    if not said or len(said) > LONGEST_ANNOTATION:
        raise RefusedInputError(
            f"An annotation of {len(said)} characters cannot be drawn; write 1 to {LONGEST_ANNOTATION}."
        )
    if queries.count_annotations(session, sensor_id) >= MOST_ANNOTATIONS:
        raise ConflictError(f"The trend has {MOST_ANNOTATIONS} annotations; write a note on the sensor instead.")
    row = Annotation(
        sensor_id=sensor_id,
        at_utc=read_time(at),
        text=said,
        user_id=user_id,
        printed_name=actor.printed_name,
        made_utc=utc_now(),
    )
    session.put(row)
    after = {"at_utc": row.at_utc, "text": said}
    audit.append(session, actor, "annotated", f"sensors/{sensor_id}/annotations/{row.id}", None, after)
    return row


def list_annotations(session: Session, sensor_id: int) -> Sequence[Annotation]:
    """Return what is said of times of a sensor's mission, by these times."""
    session.get_known(Sensor, sensor_id)
    return queries.list_annotations(session, sensor_id)


def _require_subject(session: Session, kind: str, subject_id: int) -> None:
    if kind not in NOTE_SUBJECTS:
        raise NotFoundError(f"There are no notes on {kind}; choose from {', '.join(NOTE_SUBJECTS)}.")
    table, word = TABLES[kind]
    if session.get(table, subject_id) is None:
        raise NotFoundError(f"There is no {word} {subject_id}; choose one of the list.")
