"""Parameter sets: immutable, identified by the SHA-256 of their canonical JSON, one of them a sensor's baseline.

Ground states and who moves them::

    CANDIDATE, WITHDRAWN, EXPIRED, SUPERSEDED --submit--> SUBMITTED --sign--> APPROVED --promote--> BASELINE --> SUPERSEDED
    SUBMITTED, APPROVED --withdraw--> WITHDRAWN     SUBMITTED, APPROVED --one refusal--> REJECTED
    SUBMITTED, APPROVED --time is over--> EXPIRED   SUBMITTED, APPROVED --what is bound moved--> CANDIDATE

A set that was baseline once goes back to SUPERSEDED instead of WITHDRAWN, REJECTED, EXPIRED or CANDIDATE. Rolling back is
a new request for such a set, signed and promoted like any other. What is on board is another state, in `uplinks`. Sets are
made in `candidates`; requests for them are opened and taken back in `submissions`, and met in `promotions`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from boresight.services.candidates import USABLE_STATUSES, create_from_run, create_ground_calibration
from boresight.services.promotions import promote
from boresight.services.submissions import SUBMITTABLE, roll_back, submit, withdraw
from boresight.services.transitions import get_parameter_set
from boresight.store import parameter_sets as rows
from boresight.store.sessions import Session
from boresight.store.tables import ParameterSet

__all__ = [
    "SUBMITTABLE",
    "USABLE_STATUSES",
    "baseline_of",
    "create_from_run",
    "create_ground_calibration",
    "get_parameter_set",
    "list_parameter_sets",
    "promote",
    "roll_back",
    "submit",
    "withdraw",
]


def list_parameter_sets(
    session: Session,
    *,
    sensor_id: int | None = None,
    ground_state: str | None = None,
    before_id: int | None = None,
    limit: int | None = None,
) -> Sequence[ParameterSet]:
    """Return a page of sets, newest first; the next page starts before the last one's id."""
    return rows.sets(session, sensor_id=sensor_id, ground_state=ground_state, before_id=before_id, limit=limit)


def set_of_run(session: Session, run_id: int) -> ParameterSet | None:
    """Return the set that was made from a run; None where none was."""
    return rows.set_of_run(session, run_id)


def other_with_document(session: Session, row: ParameterSet, sha256: str) -> ParameterSet | None:
    """Return the newest other set of a set's sensor whose document has this hash."""
    return rows.other_with_document(session, row, sha256)


def heads_of(session: Session, set_ids: Collection[int]) -> dict[int, Any]:
    """Return name and sensor_id of some sets, by id."""
    return rows.heads(session, set_ids)


def runs_with_sets(session: Session, run_ids: Collection[int]) -> set[int]:
    """Return those of some runs that a set was made of."""
    return rows.runs_with_sets(session, run_ids)


def baseline_of(session: Session, sensor_id: int) -> ParameterSet | None:
    """Return the sensor's baseline."""
    return rows.baseline(session, sensor_id)
