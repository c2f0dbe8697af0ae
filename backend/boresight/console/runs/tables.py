"""Runs, calibrations and choices of a camera; their log, and the settings that were given a name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column, relationship

from boresight.calibration.calibration import parse_part
from boresight.calibration.options import StatedSettings, get_method_title
from boresight.errors import RefusedInputError
from boresight.platform.db.declared import STRICT, Base, Journal, Sealing, allow_only
from boresight.platform.db.documents import JsonText, TypedText

RUN_STATES = ("QUEUED", "RUNNING", "CANCELLING", "SUCCEEDED", "FAILED", "CANCELLED", "LOST")
TERMINAL_RUN_STATES = ("SUCCEEDED", "FAILED", "CANCELLED", "LOST")
#: The method of a run that chooses a camera.
CHOICE = "choice"


def parse_settings(document: Mapping[str, Any]) -> StatedSettings:
    """Read the settings that a row keeps, whatever version wrote them."""
    return parse_part(StatedSettings, document, RefusedInputError)


class JointSet(Base):
    """A further telemetry set of a run, calibrated with its first as one; never edited."""

    __tablename__ = "joint_sets"
    __table_args__ = (sa.UniqueConstraint("run_id", "telemetry_set_id"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(sa.ForeignKey("runs.id"))
    telemetry_set_id: Mapped[int] = mapped_column(sa.ForeignKey("telemetry_sets.id"), index=True)


class Run(Base):
    """A calibration, or a choice of a camera. The row is the truth; workers only compute. Terminal states are written once."""

    __tablename__ = "runs"
    noun = "run"
    __table_args__ = (
        allow_only("state", RUN_STATES),
        sa.Index("ix_runs_state_id", "state", "id", "choice_of"),
        sa.Index("ix_runs_state_method_id", "state", "method", "id"),
        sa.Index("ix_runs_sensor_id", "sensor_id", "choice_of", "id"),
        sa.Index("ix_runs_sensor_state_id", "sensor_id", "state", "choice_of", "id", "ended_utc"),
        STRICT,
    )
    sealing = Sealing(  # two promises: what was launched, and once it has ended everything about it
        fleeting={
            "lease_until_utc": "is renewed while a run computes",
            "traceparent": "leads to where traces are kept, and says nothing of the run",
        },
        moving=frozenset(
            (
                "state",
                "reason",
                "attempt",
                "owner",
                "cancel_requested",
                "started_utc",
                "ended_utc",
                "progress",
                "result_sha256",
                "summary",
            )
        ),
        settled=TERMINAL_RUN_STATES,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    telemetry_set_id: Mapped[int] = mapped_column(sa.ForeignKey("telemetry_sets.id"))
    validation_set_id: Mapped[int | None] = mapped_column(sa.ForeignKey("telemetry_sets.id"))
    method: Mapped[str] = mapped_column(sa.Text)
    settings: Mapped[dict[str, Any]] = mapped_column(JsonText)
    sensor_document: Mapped[dict[str, Any]] = mapped_column(JsonText)  # the sensor as it was at launch
    label: Mapped[str] = mapped_column(TypedText, default="")
    state: Mapped[str] = mapped_column(sa.Text)
    reason: Mapped[str | None] = mapped_column(sa.Text)  # why it failed, was lost or was cancelled
    attempt: Mapped[int] = mapped_column(default=0)
    owner: Mapped[str | None] = mapped_column(sa.Text)
    lease_until_utc: Mapped[str | None] = mapped_column(sa.Text)
    cancel_requested: Mapped[int] = mapped_column(default=0)
    launched_utc: Mapped[str] = mapped_column(sa.Text)
    launched_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    started_utc: Mapped[str | None] = mapped_column(sa.Text)
    ended_utc: Mapped[str | None] = mapped_column(sa.Text)
    progress: Mapped[dict[str, Any] | None] = mapped_column(JsonText)  # fraction, message, partial history
    result_sha256: Mapped[str | None] = mapped_column(sa.ForeignKey("blobs.sha256"))
    summary: Mapped[dict[str, Any] | None] = mapped_column(JsonText)  # the figures a list shows
    choice_of: Mapped[int | None] = mapped_column(index=True)  # the run for whose data it chooses a camera
    prior_run_id: Mapped[int | None]  # the calibration that it starts from
    prior_set_id: Mapped[int | None]  # the parameter set that this was named by
    traceparent: Mapped[str | None] = mapped_column(sa.Text)  # the span of the request that launched it
    further: Mapped[list[JointSet]] = relationship(lazy="selectin", order_by=JointSet.id, viewonly=True)

    @property
    def joint_set_ids(self) -> list[int]:
        """The telemetry sets that it takes with its first."""
        return [one.telemetry_set_id for one in self.further]

    @property
    def own_label(self) -> str:
        """What people called it; nothing where that only repeats its method."""
        repeated = {self.method.casefold(), get_method_title(self.method).casefold()}
        return "" if self.label.strip().casefold() in repeated else self.label

    @property
    def stated_settings(self) -> StatedSettings:
        """Its settings, typed."""
        return parse_settings(self.settings)


class ArchivedRun(Base):
    """A run that lists do not show unless they are asked to; the run itself stays as it is."""

    __tablename__ = "archived_runs"
    __table_args__ = (STRICT,)
    sealing = Sealing(unsealed="says what lists leave out, and is taken back; the audit log has who did either")
    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(sa.ForeignKey("runs.id"), unique=True)
    archived_utc: Mapped[str] = mapped_column(sa.Text)


#: Keeps to the runs that calibrate: what a fleet, a trend and a list are made of.
CALIBRATIONS = Run.choice_of.is_(None)


@dataclass(frozen=True, kw_only=True)
class RecordedProgress:
    """How far a run is by its row: what its worker told last and when, and the calibration JSON so far (`partial`)."""

    fraction: float | None = None
    message: str | None = None
    elapsed_s: float | None = None
    at_utc: str | None = None
    partial: dict[str, Any] | None = None


def parse_progress(document: Mapping[str, Any] | None) -> RecordedProgress:
    """Read the progress in a run's row; one that tells nothing where the row has none, and that it is damaged where it is."""
    try:
        return parse_part(RecordedProgress, document or {}, RefusedInputError)
    except RefusedInputError as error:
        return RecordedProgress(message=f"The last report of its worker cannot be read ({error}).")


class RunEvent(Base):
    """One line of a run's log, in the order it happened; also what the event stream replays."""

    __tablename__ = "run_events"
    __table_args__ = (STRICT,)
    sealing = Sealing(
        unsealed="is a journal, with hashes of its own",
        journal=Journal(
            lasting=("id", "run_id", "attempt", "at_utc", "kind", "message"),
            others=("state", "cause", "level", "numbers"),
        ),
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(sa.ForeignKey("runs.id", ondelete="CASCADE"), index=True)
    attempt: Mapped[int]
    at_utc: Mapped[str] = mapped_column(sa.Text)
    kind: Mapped[str] = mapped_column(sa.Text)  # state | log | lost
    message: Mapped[str] = mapped_column(sa.Text)
    state: Mapped[str | None] = mapped_column(sa.Text)  # the new one
    cause: Mapped[str | None] = mapped_column(sa.Text)
    level: Mapped[str] = mapped_column(sa.Text, default="info", server_default="info")  # info | warning | error
    numbers: Mapped[dict[str, float] | None] = mapped_column(JsonText)
    hash: Mapped[str | None] = mapped_column(sa.Text)  # chains it to the line before
    outcome_hash: Mapped[str | None] = mapped_column(sa.Text)  # of the columns that the chain's hash leaves out


class Preset(Base):
    """Settings under a name, with a sentence on when to use them; each version is a row, and only archiving changes one."""

    __tablename__ = "presets"
    noun = "preset"
    __table_args__ = (sa.UniqueConstraint("name", "number"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(sa.Text)
    number: Mapped[int]
    sentence: Mapped[str] = mapped_column(TypedText)
    document: Mapped[dict[str, Any]] = mapped_column(JsonText)  # the settings
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    archived_utc: Mapped[str | None] = mapped_column(sa.Text)
