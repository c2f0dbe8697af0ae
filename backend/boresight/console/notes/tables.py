"""Notes that people leave on runs, sensors and parameter sets, and annotations at a time of a sensor's mission."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column, relationship

from boresight.platform.db.declared import STRICT, Base, allow_only
from boresight.platform.db.documents import TypedText

NOTE_SUBJECTS = ("runs", "sensors", "parameter-sets")


class NoteAttachment(Base):
    """A file that the author of a note added to it; never edited."""

    __tablename__ = "note_attachments"
    noun = "attachment"
    __table_args__ = (sa.Index("ix_note_attachments_note_id", "note_id"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    note_id: Mapped[int] = mapped_column(sa.ForeignKey("notes.id"))
    name: Mapped[str] = mapped_column(TypedText)
    sha256: Mapped[str] = mapped_column(sa.ForeignKey("blobs.sha256"))
    size_bytes: Mapped[int]
    made_utc: Mapped[str] = mapped_column(sa.Text)


class Note(Base):
    """What a person wrote down about a run, a sensor or a parameter set; never edited."""

    __tablename__ = "notes"
    noun = "note"
    __table_args__ = (
        allow_only("subject_kind", NOTE_SUBJECTS),
        sa.Index("ix_notes_subject", "subject_kind", "subject_id"),
        STRICT,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    subject_kind: Mapped[str] = mapped_column(sa.Text)
    subject_id: Mapped[int]
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    printed_name: Mapped[str] = mapped_column(sa.Text)
    text: Mapped[str] = mapped_column(TypedText)
    made_utc: Mapped[str] = mapped_column(sa.Text)
    attachments: Mapped[list[NoteAttachment]] = relationship(lazy="selectin", order_by=NoteAttachment.id, viewonly=True)


class Annotation(Base):
    """What a person says of a time of a sensor's mission, drawn on its trend; never edited."""

    __tablename__ = "annotations"
    __table_args__ = (sa.Index("ix_annotations_sensor_id", "sensor_id"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    at_utc: Mapped[str] = mapped_column(sa.Text)
    text: Mapped[str] = mapped_column(TypedText)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    printed_name: Mapped[str] = mapped_column(sa.Text)
    made_utc: Mapped[str] = mapped_column(sa.Text)
