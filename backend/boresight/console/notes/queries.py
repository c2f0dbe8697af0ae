"""Queries on notes and annotations."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.console.notes.tables import Annotation, Note
from boresight.platform.db.sessions import Session


def list_notes(session: Session, subject_kind: str, subject_id: int) -> Sequence[Note]:
    """Return the notes on a thing, in order."""
    query = sa.select(Note).where(Note.subject_kind == subject_kind, Note.subject_id == subject_id)
    return session.scalars(query.order_by(Note.id)).all()


def count_notes(session: Session, subject_kind: str, subject_id: int) -> int:
    """Count the notes on a thing."""
    of_it = (Note.subject_kind == subject_kind, Note.subject_id == subject_id)
    return session.scalar(sa.select(sa.func.count()).select_from(Note).where(*of_it)) or 0


def list_annotations(session: Session, sensor_id: int) -> Sequence[Annotation]:
    """Return what is said of times of a sensor's mission, by these times."""
    query = sa.select(Annotation).where(Annotation.sensor_id == sensor_id)
    return session.scalars(query.order_by(Annotation.at_utc, Annotation.id)).all()


def count_annotations(session: Session, sensor_id: int) -> int:
    """Count the annotations of a sensor's trend."""
    of_it = sa.select(sa.func.count()).select_from(Annotation).where(Annotation.sensor_id == sensor_id)
    return session.scalar(of_it) or 0
