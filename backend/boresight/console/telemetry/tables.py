"""Telemetry sets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.calibration.calibration import parse_part
from boresight.calibration.diagnosis.result import Diagnosis, parse_diagnosis
from boresight.errors import RefusedInputError
from boresight.platform.db.declared import STRICT, Base
from boresight.platform.db.documents import JsonText, TypedText
from boresight.telemetry.quality.findings import SEVERITIES, Finding
from boresight.telemetry.quality.report import QualityReport


def parse_quality(document: Mapping[str, Any]) -> QualityReport:
    """Read the quality report in a set's row, whatever version wrote it."""
    return parse_part(
        QualityReport,
        document,
        lambda fault: RefusedInputError(
            f"A quality report is damaged ({fault}): restore the store from a backup.", code="damaged-document"
        ),
    )


def find_quality(document: Mapping[str, Any]) -> QualityReport:
    """Read a quality report for lists and pages, where a damaged one says that it is: one row must not refuse them."""
    try:
        return parse_quality(document)
    except RefusedInputError as error:
        said = f"{error} Restore the database from a backup, or upload the file again under another sensor to have it checked."
        found = Finding("DAMAGED_REPORT", SEVERITIES[-1], said, 1)
        return QualityReport(verdict=found.severity, warnings=[said], findings=[found])


def find_diagnosis(document: Mapping[str, Any]) -> Diagnosis | None:
    """Read the diagnosis in a quality report; None where there is none, or one that nobody can read."""
    try:
        found = parse_quality(document).diagnosis
        return None if found is None else parse_diagnosis(found)
    except RefusedInputError:
        return None


class TelemetrySet(Base):
    """An uploaded file of one sensor: the original bytes, the Parquet form that is worked on, the quality report."""

    __tablename__ = "telemetry_sets"
    noun = "telemetry set"
    __table_args__ = (sa.UniqueConstraint("sensor_id", "original_sha256"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"), index=True)
    name: Mapped[str] = mapped_column(TypedText)
    purpose: Mapped[str] = mapped_column(sa.Text)  # calibration | validation
    original_sha256: Mapped[str] = mapped_column(sa.ForeignKey("blobs.sha256"))
    table_sha256: Mapped[str] = mapped_column(sa.ForeignKey("blobs.sha256"))
    frames: Mapped[int]
    stars: Mapped[int]
    quality: Mapped[dict[str, Any]] = mapped_column(JsonText)
    uploaded_utc: Mapped[str] = mapped_column(sa.Text)
    uploaded_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    archived_utc: Mapped[str | None] = mapped_column(sa.Text)
    import_record: Mapped[dict[str, Any] | None] = mapped_column(JsonText)  # of what another program wrote
    source_sha256: Mapped[str | None] = mapped_column(sa.Text)  # the file that it was made of
    removed_utc: Mapped[str | None] = mapped_column(sa.Text)  # its files were removed; what was made of them stays

    @property
    def diagnosed(self) -> str | None:
        """The sentence of its diagnosis."""
        found = find_diagnosis(self.quality)
        return None if found is None else found.sentence


class ImportProfile(Base):
    """A mapping profile; each version is a row, and only archiving changes one."""

    __tablename__ = "import_profiles"
    noun = "mapping profile"
    __table_args__ = (sa.UniqueConstraint("name", "number"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(sa.Text)
    number: Mapped[int]
    document: Mapped[dict[str, Any]] = mapped_column(JsonText)
    sha256: Mapped[str] = mapped_column(sa.Text)  # of what it says but its version
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    archived_utc: Mapped[str | None] = mapped_column(sa.Text)
