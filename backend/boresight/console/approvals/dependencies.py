"""Assessing a set's gates before its submission, outside the writing transaction because it takes seconds."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends

from boresight.console.access.dependencies import Database, DryRunSources, Who
from boresight.console.approvals import gates
from boresight.console.approvals import service as approvals
from boresight.console.approvals.gates import read_gate_inputs
from boresight.platform.db.sessions import open_reading
from boresight.platform.web.paging import Id
from boresight.verdicts.gates import parse_bound_report


def assess_before_submission(
    actor: Who, parameter_set_id: Id, forecast_sources: DryRunSources, engine: Database
) -> gates.GateAssessment | None:
    """Return a set's assessment; None where a valid report exists, or where the request will be refused anyhow."""
    with open_reading(engine) as session:
        if not approvals.is_submittable(session, actor, parameter_set_id):
            return None
        case = read_gate_inputs(session, parameter_set_id)
        report = gates.find_valid_report(session, parameter_set_id)
    if report is not None and (case.validation is None or parse_bound_report(report.document).held_out):
        return None
    return gates.examine(case, forecast_sources.blobs, forecast_sources.catalogue(), forecast_sources.catalogue_folder)


AssessedBefore = Annotated[gates.GateAssessment | None, Depends(assess_before_submission)]
