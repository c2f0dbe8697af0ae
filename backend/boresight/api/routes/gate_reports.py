"""Gate reports of a parameter set: assess it, read what was found, waive a gate."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query
from pydantic import BaseModel, ConfigDict, Field, SecretStr
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Reading, SeenVersion, Who, Writing, check_own
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.errors import NotFoundError
from boresight.services import gates, waivers
from boresight.services.actors import require_role, require_scope
from boresight.services.gate_evidence import gather
from boresight.services.parameter_sets import get_parameter_set
from boresight.services.passwords import PasswordProof
from boresight.store.sessions import Session, reading

router = APIRouter(prefix="/parameter-sets", tags=["gates"])

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


async def proven_own(waiving: Waiving, actor: Who, request: Request) -> tuple[Waiving, PasswordProof]:
    """Check the password of who acts before any transaction begins."""
    return waiving, await check_own(request, actor, waiving.password.get_secret_value())


Proven = Annotated[tuple[Waiving, PasswordProof], Depends(proven_own)]


def _examine(request: Request, actor: Who, parameter_set_id: Id) -> gates.Assessment:
    """See the held-out frames before the writing transaction: that takes seconds, and there is one writer."""
    require_role(actor, *gates.ASSESSORS)
    require_scope(actor, "parameter-sets")
    state = request.app.state
    with reading(state.engine) as session:
        case = gather(session, parameter_set_id)
    return gates.examine(case, state.blobs, state.catalogue(), state.settings.catalogue_folder)


Examined = Annotated[gates.Assessment, Depends(_examine)]


def _shown(session: Session, row: Any) -> schemas.Document:
    """Write a report with the waivers laid over it, and whether what it rests on is as it was."""
    document = gates.with_waivers(session, row)
    given = waivers.all_waivers(session, row.parameter_set_id)
    columns = {name: getattr(row, name) for name in schemas.GateReport.model_fields if hasattr(row, name)}
    return {
        **columns,
        **{name: document[name] for name in LAID_OVER},
        "holds": not gates.moved_since(session, row),
        "waivers": [schemas.written(schemas.Waiver, waiver) for waiver in given],
    }


@router.post(
    "/{parameter_set_id}:assess",
    name="assess_parameter_set",
    summary="Hold it against its gates",
    status_code=201,
    response_model=schemas.GateReport,
    responses=refusals(404, 409, 412),
)
def assess_parameter_set(
    parameter_set_id: Id, actor: Who, once: Idempotent, examined: Examined, session: Writing
) -> Response:
    """Match the held-out frames under this set and the incumbent, judge every gate, and keep the report.

    The same evidence gives the same report, which is then the one that is there. Where the evidence moved while the frames
    were matched the answer is 412: assess it again. An open request that binds another report is STALE at its next signature.
    """

    def act() -> Answer:
        row = gates.record_report(session, actor, examined)
        location = {"Location": f"/api/v1/parameter-sets/{parameter_set_id}/gate-report"}
        return Answer(_shown(session, row), 201, location)

    return once.answer(session, actor, act)


@router.get(
    "/{parameter_set_id}/gate-report",
    name="get_gate_report",
    summary="Read what its gates found",
    response_model=schemas.GateReport,
    responses=refusals(404),
)
def get_gate_report(
    parameter_set_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    sha256: Hash | None = None,
) -> Response:
    """Read the newest report, or the one that a request binds, with the waivers; `holds` says whether its evidence moved since."""
    row = get_parameter_set(session, parameter_set_id)
    report = gates.newest_report(session, parameter_set_id, sha256)
    if report is None and sha256 is not None:
        raise NotFoundError(
            f"{row.name} (parameter set {row.id}) has no gate report {sha256}; leave sha256 out for the newest."
        )
    if report is None:
        raise NotFoundError(f"{row.name} (parameter set {row.id}) has no gate report; POST :assess.")
    return json_response(_shown(session, report))


@router.post(
    "/{parameter_set_id}:waive",
    name="waive_gate",
    summary="Waive a gate",
    status_code=201,
    response_model=schemas.Waiver,
    responses=refusals(404, 409, 412, 428, 429),
)
def waive_gate(
    parameter_set_id: Id, actor: Who, seen: SeenVersion, proven: Proven, once: Idempotent, session: Writing
) -> Response:
    """Let this set pass in spite of a gate that blocks it, in person. The next request then needs two approvals."""

    def act() -> Answer:
        waiving, proof = proven
        asked = (waiving.gate, waiving.code, waiving.reason, waiving.expires_utc, proof)
        row = waivers.waive(session, actor, parameter_set_id, *asked, seen)
        return Answer(schemas.written(schemas.Waiver, row), 201)

    return once.answer(session, actor, act)
