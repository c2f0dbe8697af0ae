"""Alignments of two sensors, and the figures of one that lists and later alignments read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.calibration.calibration import parse_part
from boresight.errors import RefusedInputError
from boresight.platform.db.declared import STRICT, Base, Sealing, allow_only, only_one
from boresight.platform.db.documents import JsonText, TypedText

ALIGNMENT_STATES = ("QUEUED", "RUNNING", "SUCCEEDED", "FAILED")
ENDED_STATES = ("SUCCEEDED", "FAILED")
REQUEST_STATES = ("OPEN", "APPROVED", "REJECTED", "WITHDRAWN")


class Alignment(Base):
    """The rotation from one sensor to another, from a run of each. What was asked never changes, and an end is written once."""

    __tablename__ = "alignments"
    noun = "alignment"
    __table_args__ = (
        allow_only("state", ALIGNMENT_STATES),
        sa.Index("ix_alignments_state_id", "state", "id"),
        sa.Index("ix_alignments_sensor_a_id_sensor_b_id", "sensor_a_id", "sensor_b_id", "id"),
        sa.Index("ix_alignments_sensor_b_id", "sensor_b_id", "id"),
        STRICT,
    )
    sealing = Sealing(
        fleeting={"lease_until_utc": "is renewed with each attempt"},
        moving=frozenset(
            ("state", "reason", "attempt", "started_utc", "ended_utc", "result_sha256", "verdict", "summary")
        ),
        settled=ENDED_STATES,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_a_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    sensor_b_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    run_a_id: Mapped[int] = mapped_column(sa.ForeignKey("runs.id"))
    run_b_id: Mapped[int] = mapped_column(sa.ForeignKey("runs.id"))
    options: Mapped[dict[str, Any]] = mapped_column(JsonText)  # those that were given
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    state: Mapped[str] = mapped_column(sa.Text)
    reason: Mapped[str | None] = mapped_column(sa.Text)  # why it failed
    attempt: Mapped[int] = mapped_column(default=0)
    lease_until_utc: Mapped[str | None] = mapped_column(sa.Text)
    started_utc: Mapped[str | None] = mapped_column(sa.Text)
    ended_utc: Mapped[str | None] = mapped_column(sa.Text)
    result_sha256: Mapped[str | None] = mapped_column(sa.ForeignKey("blobs.sha256"))
    verdict: Mapped[str | None] = mapped_column(sa.Text)  # of its gates
    summary: Mapped[dict[str, Any] | None] = mapped_column(JsonText)  # the figures a list shows


class AlignmentRequest(Base):
    """A request that an alignment goes on board with the parameters of its runs; binds the result that was shown."""

    __tablename__ = "alignment_requests"
    noun = "request for an alignment"
    __table_args__ = (
        allow_only("state", REQUEST_STATES),
        only_one("uq_alignment_requests_one_in_force", "alignment_id", "state IN ('OPEN', 'APPROVED')"),
        STRICT,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    alignment_id: Mapped[int] = mapped_column(sa.ForeignKey("alignments.id"), index=True)
    result_sha256: Mapped[str] = mapped_column(sa.Text)
    state: Mapped[str] = mapped_column(sa.Text)
    version: Mapped[int] = mapped_column(default=1)  # counts transitions; the ETag
    reason: Mapped[str] = mapped_column(TypedText)
    submitted_utc: Mapped[str] = mapped_column(sa.Text)
    submitted_by: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    closed_utc: Mapped[str | None] = mapped_column(sa.Text)
    signed_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    printed_name: Mapped[str | None] = mapped_column(sa.Text)
    meaning: Mapped[str | None] = mapped_column(TypedText)
    comment: Mapped[str | None] = mapped_column(TypedText)


@dataclass(frozen=True, kw_only=True)
class AlignmentSummary:
    """The figures of an alignment that lists show: its sentence, its pairs, and both rotations with one sigma about x, y, z of B.

    `quaternion`, `sigma_arcsec`: between the frames, with the cameras' error and the scatter of the pairs. `load_...`: the rotation
    to load with the parameters of both runs.
    """

    sentence: str
    pairs: int
    pairs_used: int
    reference_utc: str
    quaternion: list[float]
    sigma_arcsec: list[float]
    load_quaternion: list[float]
    load_sigma_arcsec: list[float]


def parse_summary(document: Mapping[str, Any]) -> AlignmentSummary:
    """Read the figures in an alignment's row."""
    return parse_part(AlignmentSummary, document, RefusedInputError)
