"""A campaign as one thing: how many of its runs are where, how far it is, and what its sensors came to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.store.campaigns import Counted, Standing
from boresight.store.tables import RUN_STATES, TERMINAL_RUN_STATES, Campaign

NOT_LAUNCHED = "NOT LAUNCHED"
FAILED = ("FAILED", "LOST", NOT_LAUNCHED)


@dataclass(frozen=True)
class CampaignView:
    """A campaign with its counts.

    Parameters
    ----------
    row
        What it is.
    counts
        Sensors by the state of their runs, or `NOT LAUNCHED`; every word, zero where there are none.
    newest_id
        Of its newest launch, which grows when what failed is launched again.
    """

    row: Campaign
    counts: Mapping[str, int]
    newest_id: int

    @property
    def id(self) -> int:
        """Its number, which cursors name."""
        return self.row.id

    @property
    def sensors(self) -> int:
        """How many sensors it has."""
        return sum(self.counts.values())

    @property
    def ended(self) -> int:
        """How many of them need no more waiting for."""
        return sum(self.counts[state] for state in (*TERMINAL_RUN_STATES, NOT_LAUNCHED))

    @property
    def failed(self) -> int:
        """How many could be launched again."""
        return sum(self.counts[state] for state in FAILED)

    @property
    def fraction(self) -> float:
        """How far it is, 0 to 1."""
        return self.ended / self.sensors if self.sensors else 1.0

    @property
    def state(self) -> str:
        """One word: UNDER WAY, CANCELLING, CANCELLED, SUCCEEDED, or ENDED where some run did not succeed."""
        cancelled = self.row.cancelled_utc is not None and self.counts["CANCELLED"] + self.counts["CANCELLING"] > 0
        if self.ended < self.sensors:
            return "CANCELLING" if cancelled and not self.counts["QUEUED"] + self.counts["RUNNING"] else "UNDER WAY"
        if cancelled:
            return "CANCELLED"
        return "SUCCEEDED" if self.counts["SUCCEEDED"] == self.sensors else "ENDED"


def view_of(row: Campaign, counted: Counted) -> CampaignView:
    """Put a campaign beside its counts by state, where None has no run."""
    counts = {state: counted.by_state.get(state, 0) for state in RUN_STATES}
    return CampaignView(row, {**counts, NOT_LAUNCHED: counted.by_state.get(None, 0)}, counted.newest_id)


def result_of(standing: Standing) -> dict[str, Any]:
    """Return one line of the results over sensors; what a run has not is None.

    Arcs in rad: `rms_initial_arc_rad` and `rms_final_arc_rad` of the fit, `validation_...` of the frames held out.
    """
    summary = standing.summary or {}
    names = (
        "rms_initial_arc_rad", "rms_final_arc_rad", "validation_rms_initial_arc_rad", "validation_rms_final_arc_rad",
        "status", "level", "weak_directions", "weakest", "advice",
    )  # fmt: skip
    return {
        "id": standing.id,
        "sensor_id": standing.sensor_id,
        "sensor": standing.sensor,
        "run_id": standing.run_id,
        "state": standing.state or NOT_LAUNCHED,
        "reason": standing.refusal or standing.reason,
        **{name: summary.get(name) for name in names},
    }
