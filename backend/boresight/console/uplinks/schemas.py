"""Uplink records, the state of a sensor at a time, table definitions and uplink packages."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field, model_validator

from boresight.console.approvals.schemas import Approval
from boresight.console.parameter_sets.schemas import ParameterSet
from boresight.console.schemas import Document, Row, Shape


class Uplink(Row):
    """What was recorded about a set on board."""

    location = "/uplinks/{row.id}"

    id: int
    parameter_set_id: int
    onboard_state: str
    source: str
    recorded_utc: str
    recorded_by: int
    method: Literal["bytes", "crc"] | None = Field(description="How a read-back was compared; null for a statement.")
    evidence: Document | None = Field(description="Package, dump, CRC, differing bytes and fields, when it happened.")
    printed_name: str | None = Field(description="The person who signed that the set is active.")
    meaning: str | None = Field(description="What the signature means.")
    c_sd: Literal["LOADED", "NOT YET", "NOT NEEDED"] | None = Field(
        description="Whether the update of C_SD was loaded that keeps the attitude with the set; null where it was not told."
    )
    c_sd_said: str | None = Field(description="When and how the update was loaded, or why not.")
    is_step: bool = Field(
        description="Whether it records a state; false where it only tells of C_SD and the state stays."
    )


class HandOver(BaseModel):
    """A table that was handed over to a mission control system; nothing was commanded."""

    package_id: int
    package_sha256: str
    to: str = Field(description="The system and its store, for people.")
    places: list[str] = Field(description="Where each file lies there; empty in a dry run.")


class Version(Row):
    """A gate profile or table definition that was in force."""

    number: int
    sha256: str
    reason: str
    created_utc: str
    created_by: int | None


class Promotion(Row):
    """How a set became the baseline."""

    id: int
    parameter_set_id: int
    approval_id: int | None = Field(description="Null for a ground calibration.")
    at_utc: str
    promoted_by: int | None
    reason: str | None = Field(description="Why it was promoted; null where no reason was given.")


class OnBoard(BaseModel):
    """A set with what was recorded of it."""

    parameter_set: str
    sha256: str
    record: Uplink


class AsOf(BaseModel):
    """What held for a sensor at a time, and who said so."""

    sensor_id: int
    time_utc: str
    sentence: str = Field(description="Ground and board in one line.")
    differs: bool = Field(description="Whether the active set on board differed from the baseline.")
    baseline: ParameterSet | None
    promotion: Promotion | None
    approval: Approval | None = Field(description="The request behind it, with its signatures.")
    on_board: list[OnBoard] = Field(description="The latest record of each set at that time.")
    learned_later: list[OnBoard] = Field(description="Recorded after the time, about what had happened by then.")
    gate_profile: Version | None
    table_definition: Version | None


class Event(Row):
    """One line of a sensor's timeline."""

    id: int
    at_utc: str = Field(description="When it was recorded.")
    kind: str = Field(
        description="`ground calibration`, `request`, `signature`, `waiver`, `promotion`, `roll-back`, `package`, "
        "`uplink`, `read-back`, `gate profile` or `table definition`."
    )
    state: str | None
    parameter_set_id: int | None
    parameter_set: str | None
    who: str | None
    sentence: str
    said: str | None = Field(description="Reason, meaning, comment or source, as the person wrote it.")
    sha256: str | None
    happened_utc: str | None = Field(description="When it happened, if earlier than recorded.")
    subject: str | None = Field(description="Its address: `approvals/3`.")


class TableDefinition(Row):
    """How a sensor's camera lies in the table on board; every version is kept."""

    versioned_by = ("number",)
    location = "/sensors/{row.sensor_id}/table-definitions"

    id: int
    sensor_id: int
    number: int = Field(description='Counts the sensor\'s definitions; the ETag is `"v<number>"`.')
    document: Document
    sha256: str = Field(description="SHA-256 of the canonical JSON of `document`.")
    reason: str
    created_utc: str
    created_by: int | None


class Package(Row):
    """An uplink package: the ZIP is at `/content`, and everything that its bytes follow from is in its manifest."""

    location = "/packages/{row.id}"

    id: int
    parameter_set_id: int
    table_definition_id: int | None = Field(description="Null where none was in force: the package contains no table.")
    flight_software_version: str | None
    table_id: str | None
    sha256: str = Field(description="SHA-256 of the ZIP.")
    backout: str = Field(description="The set that it goes back to, in the folder `backout/`.")
    four_eyes: str = Field(description="Whether a second person approved the set.")
    audit_head: str = Field(description="Head of the audit log when the package was first built.")
    signed_by: str | None = Field(description="Id of the key that signed its SHA256SUMS; the key is at `/audit/keys`.")
    created_utc: str
    created_by: int | None

    @model_validator(mode="before")
    @classmethod
    def _from_row(cls, row: Any) -> Any:
        """Read the members from the inputs of a stored package."""
        if not hasattr(row, "inputs"):
            return row
        columns = ("id", "parameter_set_id", "table_definition_id", "sha256", "created_utc", "created_by")
        document = (row.inputs["definition"] or {}).get("document", {})
        return {name: getattr(row, name) for name in columns} | {
            "flight_software_version": document.get("flight_software_version"),
            "table_id": document.get("table_id"),
            "backout": row.inputs["backout"]["name"],
            "four_eyes": row.inputs["four_eyes"]["sentence"],
            "audit_head": row.inputs["first_built"]["audit_head"],
            "signed_by": None if row.signature is None else row.signature["key"],
        }


class Station(Shape):
    """One station between a run and the spacecraft, and how the set stands there."""

    title: str = Field(examples=["Promoted"])
    level: str = Field(
        description="Severity: `normal` is done, `standby` is next, `off` means still to come or not needed."
    )
    word: str = Field(description="`done`, `next`, `to come`, or what came of it: a verdict, REFUSED, MISMATCH.")
    at_utc: str | None
    who: str = Field(description="The printed name; empty if no person did it.")
    source: str


class NextStep(Shape):
    """What is next, and who may do it."""

    sentence: str
    label: str = Field(description="The button of the page; empty where nothing is left to do.")
    href: str = Field(description="The page where it is done.")
    is_mine: bool = Field(description="Whether the reader may do it.")
    who: list[str] = Field(description="The printed names of those who may.")
    role: str


class Workflow(Shape):
    """The ten stations of a set, from the run to the spacecraft, and the step that is next."""

    name: str
    stations: list[Station]
    next_step: NextStep
