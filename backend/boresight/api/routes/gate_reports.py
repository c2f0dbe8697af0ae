"""Gate reports of a parameter set: assess it, read what was found, waive a gate."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Query
from pydantic import BaseModel, ConfigDict, Field, SecretStr

from boresight.api import schemas
from boresight.api.dependencies import Database, Reading, SeenVersion, Sighted, Who, Writing, own_password
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.operation import Beside, operations
from boresight.services import gates, waivers
from boresight.services.actors import require_role, require_scope
from boresight.services.gate_evidence import gather
from boresight.services.passwords import PasswordProof
from boresight.store.sessions import Session, reading
from boresight.store.tables import GateReport, Waiver

router = operations("/parameter-sets", tags=["gates"])

LAID_OVER = ("verdict", "words", "blocking", "waived", "gates", "held_out", "bound")

Hash = Annotated[
    str,
    Query(
        pattern="^[0-9a-f]{64}$",
        description="A request's `bound.gate_report_sha256`: that report, be it the newest or not.",
    ),
]


class Waiving(BaseModel):
    """Which gate a set passes in spite of, why, and until when."""

    model_config = ConfigDict(extra="forbid")
    gate: str = Field(examples=["coverage"])
    code: str = Field(description=f"One of {', '.join(waivers.CODES)}.", examples=["data-limited"])
    reason: str = Field(
        description=f"In at least {waivers.LEAST_LETTERS} letters.",
        examples=["One corner was in eclipse all month; the arcs there are extrapolated and we know it."],
    )
    expires_utc: str = Field(
        description=f"ISO 8601, within {waivers.LONGEST_DAYS} days; the gate then blocks again.",
        examples=["2026-12-01T00:00:00Z"],
    )
    password: SecretStr = Field(description="Your own, given again.")


Proven = Annotated[PasswordProof, own_password(Waiving)]


def _examine(parameter_set_id: Id, actor: Who, sight: Sighted, engine: Database) -> gates.Assessment:
    """See the held-out frames before the writing transaction: that takes seconds, and there is one writer."""
    require_role(actor, *gates.ASSESSORS)
    require_scope(actor, "parameter-sets")
    with reading(engine) as session:
        case = gather(session, parameter_set_id)
    return gates.examine(case, sight.blobs, sight.catalogue(), sight.catalogue_folder)


Examined = Annotated[gates.Assessment, Depends(_examine)]


def _shown(session: Session, row: GateReport) -> Beside:
    """Return a report with the waivers laid over it, and whether what it rests on is as it was."""
    document = gates.with_waivers(session, row)
    laid_over = {name: document[name] for name in LAID_OVER}
    given = waivers.all_waivers(session, row.parameter_set_id)
    return Beside(row, **laid_over, holds=not gates.moved_since(session, row), waivers=given)


@router.post(
    "/{parameter_set_id}:assess",
    summary="Hold it against its gates",
    status_code=201,
    response_model=schemas.GateReport,
    responses=refusals(412),
)
def assess_parameter_set(
    parameter_set_id: Id,  # noqa: ARG001 - of the dependency that examines it
    actor: Who,
    examined: Examined,
    session: Writing,
) -> Beside:
    """Match the held-out frames under this set and the incumbent, judge every gate, and keep the report.

    The same evidence gives the same report, which is then the one that is there. Where the evidence moved while the frames
    were matched the answer is 412: assess it again. An open request that binds another report is STALE at its next signature.
    """
    return _shown(session, gates.record_report(session, actor, examined))


@router.get("/{parameter_set_id}/gate-report", summary="Read what its gates found", response_model=schemas.GateReport)
def get_gate_report(parameter_set_id: Id, session: Reading, sha256: Hash | None = None) -> Beside:
    """Read the newest report, or the one that a request binds, with the waivers; `holds` says whether its evidence moved since."""
    return _shown(session, gates.get_report(session, parameter_set_id, sha256))


@router.post("/{parameter_set_id}:waive", summary="Waive a gate", status_code=201, response_model=schemas.Waiver)
def waive_gate(
    parameter_set_id: Id, signed: Waiving, actor: Who, seen: SeenVersion, proof: Proven, session: Writing
) -> Waiver:
    """Let this set pass in spite of a gate that blocks it, in person. The next request then needs two approvals."""
    return waivers.waive(
        session, actor, parameter_set_id, signed.gate, signed.code, signed.reason, signed.expires_utc, proof, seen
    )
