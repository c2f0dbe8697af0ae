"""Table definitions, uplink packages and on-board records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.calibration.calibration import parse_part
from boresight.console.fleet.tables import SensorDocument
from boresight.console.parameter_sets.tables import ONBOARD_STATES
from boresight.errors import RefusedInputError
from boresight.platform.db.declared import STRICT, Base, allow_only
from boresight.platform.db.documents import JsonText, TypedText

C_SD_ANSWERS = ("LOADED", "NOT YET", "NOT NEEDED")


@dataclass(frozen=True)
class SentPackage:
    """The package that a record names."""

    id: int
    sha256: str


@dataclass(frozen=True)
class StoredDump:
    """The dump that a record rests on."""

    sha256: str


@dataclass(frozen=True)
class UplinkEvidence:
    """What the console itself reads of a record's evidence; None where it does not say."""

    package: SentPackage | None = None
    dump: StoredDump | None = None
    sentence: str | None = None
    shown_sha256: str | None = None
    happened_utc: str | None = None


class Uplink(Base):
    """A record of an on-board state; never edited.

    `c_sd`: whether the update of C_SD was loaded that keeps the attitude with the set; null where it was not told. `c_sd_said`:
    when and how, or why not. `leaves_state`: 1 where it only tells of C_SD and the set stays in its state; null for a step.
    """

    __tablename__ = "uplinks"
    noun = "uplink record"
    __table_args__ = (allow_only("onboard_state", ONBOARD_STATES), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    parameter_set_id: Mapped[int] = mapped_column(sa.ForeignKey("parameter_sets.id"), index=True)
    onboard_state: Mapped[str] = mapped_column(sa.Text)
    source: Mapped[str] = mapped_column(TypedText)
    recorded_utc: Mapped[str] = mapped_column(sa.Text)
    recorded_by: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    method: Mapped[str | None] = mapped_column(sa.Text)  # how a read-back was compared: bytes | crc
    evidence: Mapped[dict[str, Any] | None] = mapped_column(JsonText)  # package, dump, CRC, differing fields
    printed_name: Mapped[str | None] = mapped_column(sa.Text)  # of the activation's signature
    meaning: Mapped[str | None] = mapped_column(TypedText)
    c_sd: Mapped[str | None] = mapped_column(sa.Text)
    c_sd_said: Mapped[str | None] = mapped_column(TypedText)
    leaves_state: Mapped[int | None]

    @property
    def is_step(self) -> bool:
        """Whether it records a state; else it records the update of C_SD beside the state that the set was in."""
        return self.leaves_state is None

    @property
    def typed_evidence(self) -> UplinkEvidence:
        """What it rests on, typed."""
        return parse_part(UplinkEvidence, self.evidence or {}, RefusedInputError)


class TableDefinition(SensorDocument, Base):
    """How a sensor's parameters lie in the table on board; each version is a row, the newest is in force."""

    __tablename__ = "table_definitions"
    __table_args__ = (sa.UniqueConstraint("sensor_id", "number"), STRICT)


class Package(Base):
    """An uplink package that was built: from what, and the SHA-256 of its bytes."""

    __tablename__ = "packages"
    noun = "package"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    parameter_set_id: Mapped[int] = mapped_column(sa.ForeignKey("parameter_sets.id"), index=True)
    table_definition_id: Mapped[int | None] = mapped_column(sa.ForeignKey("table_definitions.id"))
    inputs: Mapped[dict[str, Any]] = mapped_column(JsonText)  # everything the bytes follow from
    sha256: Mapped[str] = mapped_column(sa.ForeignKey("blobs.sha256"))
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    signature: Mapped[dict[str, str] | None] = mapped_column(
        JsonText
    )  # of SHA256SUMS in it: key, public_key, signature
