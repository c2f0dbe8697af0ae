"""What is known to be on board."""

from __future__ import annotations

from boresight.api.schemas.row import Row


class Uplink(Row):
    """What was recorded about a set on board."""

    id: int
    parameter_set_id: int
    onboard_state: str
    source: str
    recorded_utc: str
    recorded_by: int
