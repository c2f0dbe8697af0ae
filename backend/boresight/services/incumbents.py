"""The set that is in force for a run's sensor now, to be drawn beside what the run found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from boresight.services.parameter_sets import baseline_of
from boresight.store.sessions import Session
from boresight.store.tables import Run


def baseline_beside(session: Session, run: Run) -> dict[str, float | None]:
    """Return the baseline's parameters in SI; none where the run started from them or there is no baseline."""
    baseline = baseline_of(session, run.sensor_id)
    if baseline is None:
        return {}
    parameters: Mapping[str, float | None] = baseline.document.get("parameters") or {}
    initial: Mapping[str, Any] = (run.sensor_document or {}).get("initial") or {}
    return {} if all(parameters.get(name) == value for name, value in initial.items()) else dict(parameters)
