"""Holding a set against its gates before it is submitted: outside the writing transaction, for it takes seconds."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends

from boresight.console.access.dependencies import Database, Sighted, Who
from boresight.console.approvals import gates, submissions
from boresight.console.approvals.gates import gather
from boresight.platform.db.sessions import reading
from boresight.platform.web.paging import Id


def measured(actor: Who, parameter_set_id: Id, sight: Sighted, engine: Database) -> gates.Assessment | None:
    """Return a set's assessment for its submission; None where a report holds, or the request will be refused anyhow.

    A report that holds but was made without looking at held-out frames does not count where there are some.
    """
    with reading(engine) as session:
        if not submissions.is_submittable(session, actor, parameter_set_id):
            return None
        case = gather(session, parameter_set_id)
        report = gates.latest_report(session, parameter_set_id)
    if report is not None and (case.held_out is None or report.document.get("held_out")):
        return None
    return gates.examine(case, sight.blobs, sight.catalogue(), sight.catalogue_folder)


Measured = Annotated[gates.Assessment | None, Depends(measured)]
