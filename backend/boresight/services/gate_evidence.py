"""What the gates of a stored set look at, gathered in one reading transaction; nothing is computed here.

Held-out frames are the run's validation set, else the sensor's newest validation set that neither the set nor the incumbent was
calibrated on: whoever was fitted to the frames would be flattered by them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.services.gate_profiles import profile_in_force
from boresight.services.transitions import get_parameter_set
from boresight.store import parameter_sets as set_rows
from boresight.store import table_definitions, telemetry_sets
from boresight.store.documents import sha256_of
from boresight.store.sessions import Session
from boresight.store.tables import ParameterSet, Run, Sensor, TelemetrySet


@dataclass(frozen=True)
class Case:
    """A set with everything that its verdict rests on, as it stands in the store.

    Parameters
    ----------
    parameter_set_id, name
        The set.
    sensor_document, candidate, incumbent
        Documents of the sensor, the set, and the baseline that it would replace; None where it would replace none.
    result_sha256, made_with, settings
        Of the run behind it: address of its result, the sensor at its launch, its settings; None for a ground calibration.
    held_out
        Name and table address of the frames to look at; None where there are none.
    profile, definition
        Documents of the gate profile and the table definition in force; None where there is no definition.
    bound
        Hashes of all of these: what the report will hold for.
    """

    parameter_set_id: int
    name: str
    sensor_document: Mapping[str, Any]
    candidate: Mapping[str, Any]
    incumbent: Mapping[str, Any] | None
    result_sha256: str | None
    made_with: Mapping[str, Any] | None
    settings: Mapping[str, Any] | None
    held_out: tuple[str, str] | None
    profile: Mapping[str, Any]
    definition: Mapping[str, Any] | None
    bound: dict[str, str | None]


def gather(session: Session, parameter_set_id: int) -> Case:
    """Read a set's case.

    Raises
    ------
    NotFoundError
        When there is no such set.
    """
    row = get_parameter_set(session, parameter_set_id)
    run = None if row.run_id is None else session.get_one(Run, row.run_id)
    incumbent = _incumbent(session, row)
    definition = table_definitions.definition_in_force(session, row.sensor_id)
    held_out = _held_out(session, row, run, incumbent)
    return Case(
        parameter_set_id=row.id,
        name=row.name,
        sensor_document=session.get_one(Sensor, row.sensor_id).document,
        candidate=row.document,
        incumbent=None if incumbent is None else incumbent.document,
        result_sha256=None if run is None else run.result_sha256,
        made_with=None if run is None else run.sensor_document,
        settings=None if run is None else run.settings,
        held_out=None if held_out is None else (held_out.name, held_out.table_sha256),
        profile=profile_in_force(session, row.sensor_id).document,
        definition=None if definition is None else definition.document,
        bound=bound_now(session, row),
    )


def bound_now(session: Session, row: ParameterSet) -> dict[str, str | None]:
    """Return the hashes of everything that a report on a set rests on, as they are now."""
    run = None if row.run_id is None else session.get_one(Run, row.run_id)
    incumbent = set_rows.baseline(session, row.sensor_id)
    definition = table_definitions.definition_in_force(session, row.sensor_id)
    return {
        "set_sha256": sha256_of(row.document),
        "run_result_sha256": None if run is None else run.result_sha256,
        "profile_sha256": profile_in_force(session, row.sensor_id).sha256,
        "incumbent_sha256": None if incumbent is None else incumbent.sha256,
        "table_definition_sha256": None if definition is None else definition.sha256,
    }


def _incumbent(session: Session, row: ParameterSet) -> ParameterSet | None:
    """Return the baseline that a set would replace; None where it is the baseline itself."""
    baseline = set_rows.baseline(session, row.sensor_id)
    return None if baseline is None or baseline.id == row.id else baseline


def _held_out(
    session: Session, row: ParameterSet, run: Run | None, incumbent: ParameterSet | None
) -> TelemetrySet | None:
    """Choose the frames to look at."""
    behind = [run, None if incumbent is None or incumbent.run_id is None else session.get_one(Run, incumbent.run_id)]
    fitted = {known.telemetry_set_id for known in behind if known is not None}
    own = None if run is None or run.validation_set_id is None else session.get(TelemetrySet, run.validation_set_id)
    others = telemetry_sets.sets(  # of so many, one at least was not fitted
        session,
        sensor_id=row.sensor_id,
        purpose="validation",
        archived=False,
        before_id=None,
        limit=len(fitted) + 1,
    )
    candidates = [*([] if own is None else [own]), *others]
    return next((known for known in candidates if known.id not in fitted), None)
