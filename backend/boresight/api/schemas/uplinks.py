"""What is known to be on board, and what held for a sensor at a time."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from boresight.api.schemas.approvals import Approval
from boresight.api.schemas.parameter_sets import ParameterSet
from boresight.api.schemas.row import Document, Row


class Uplink(Row):
    """What was recorded about a set on board."""

    location = "/uplinks/{row.id}"

    id: int
    parameter_set_id: int
    onboard_state: str
    source: str
    recorded_utc: str
    recorded_by: int
    method: Literal["bytes", "crc"] | None = Field(description="How a read-back was compared; null of a statement.")
    evidence: Document | None = Field(description="Package, dump, CRC, differing bytes and fields, when it happened.")
    printed_name: str | None = Field(description="Of who signed that the set is active.")
    meaning: str | None = Field(description="What the signature means.")


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
    approval_id: int | None = Field(description="Null of a ground calibration.")
    at_utc: str
    promoted_by: int | None


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
    differs: bool = Field(description="Whether another set was active on board than was baseline.")
    baseline: ParameterSet | None
    promotion: Promotion | None
    approval: Approval | None = Field(description="The request that was carried out, with its signatures.")
    on_board: list[OnBoard] = Field(description="Of every set the newest record by then.")
    learned_later: list[OnBoard] = Field(description="Recorded after the time, of what had happened by then.")
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
    said: str | None = Field(description="Reason, meaning, comment or source, in the person's words.")
    sha256: str | None
    happened_utc: str | None = Field(description="When it happened, where its source puts that earlier.")
    subject: str | None = Field(description="Its address: `approvals/3`.")
