"""Operations on requests for approval and their discussion, on gate profiles, gate reports and waivers."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Annotated, Any, Literal

from fastapi import Depends, Query
from fastapi.concurrency import run_in_threadpool
from pydantic import Field, SecretStr
from starlette.requests import Request
from starlette.responses import Response

from boresight.calibration.calibration import to_plain
from boresight.console import list_queries as lists
from boresight.console.access.dependencies import (
    Blobs,
    Database,
    DryRunSources,
    IsDryRun,
    PasswordChecks,
    Reading,
    SeenVersion,
    ServerFigureCache,
    ServerPolicy,
    Who,
    Writing,
    factor_field,
    get_client,
    open_write_session,
    own_password,
    password_field,
)
from boresight.console.access.passwords import PasswordProof
from boresight.console.approvals import gate_profiles, gates, review, schemas, threads
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
from boresight.console.approvals.gates import read_gate_inputs
from boresight.console.approvals.review import Acknowledgement, Point
from boresight.console.approvals.service import Decision
from boresight.console.approvals.tables import Approval, GateProfile, GateReport, Opening, Remark, Thread, Waiver
from boresight.console.change_proposals import service as proposals
from boresight.console.change_proposals.routes import PROPOSED, in_force_or_proposed
from boresight.console.operation import OperationResponse, RowWithFields, operations
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.figure_routes import FigureName, Seen, get_figure
from boresight.console.runs.schemas import PlotlyFigure
from boresight.console.schemas import Shape
from boresight.console.uplinks.tables import TableDefinition
from boresight.errors import NotFoundError
from boresight.platform.actors import require_role, require_scope
from boresight.platform.db.sessions import Session, open_reading
from boresight.platform.web.openapi import refuses
from boresight.platform.web.paging import Id, Listing, Page, Paged

gate_profile_router = operations("/sensors", tags=["gates"])

GATES = Field(
    description="One object per gate that differs from the default; missing keys take the default.",
    examples=[[{"name": "validation-rms", "limit": 2.0, "marginal": 1.3, "must_have_data": True}]],
)


class Limits(Shape):
    """A profile to try."""

    gates: list[dict[str, Any]] = GATES


class NewProfile(Limits):
    """A profile to put into force, and why."""

    reason: str = Field(examples=["Two lost passes in October: validation is needed from now on."])


@gate_profile_router.get(
    "/{sensor_id}/gate-profiles",
    summary="List the gate profiles of a sensor",
    response_model=Page[schemas.GateProfile],
)
def list_gate_profiles(sensor_id: Id, session: Reading, page: Paged) -> OperationResponse:
    """List every version of a sensor's limits, newest first; the first is in force, and its ETag is needed to set another."""
    found = gate_profiles.list_profiles(session, sensor_id)
    return OperationResponse(page.cut_whole(found), headers={"ETag": schemas.GateProfile.etag(found[0])})


@gate_profile_router.post(
    "/{sensor_id}/gate-profiles",
    summary="Set the limits of a sensor",
    status_code=201,
    response_model=schemas.GateProfile,
    responses=PROPOSED,
)
def set_gate_profile(
    sensor_id: Id, profile: NewProfile, actor: Who, seen: SeenVersion, policy: ServerPolicy, session: Writing
) -> GateProfile | TableDefinition | OperationResponse:
    """Put other limits into force. The sensor's open requests become STALE, because their verdict may change.

    Where the setting `second_person` is on, the change is proposed, answered with 202, and changes nothing until another
    administrator confirms it.
    """
    document = {"gates": profile.gates}
    made = proposals.change(session, actor, "gate-profile", sensor_id, document, profile.reason, seen, policy=policy)
    return in_force_or_proposed(session, made)


@gate_profile_router.post(
    "/{sensor_id}/gate-profiles:dry-run", summary="Try limits on past runs", response_model=schemas.DryRunOfProfile
)
def try_gate_profile(
    sensor_id: Id, profile: Limits, asked: IsDryRun, session: Reading, blobs: Blobs
) -> OperationResponse:
    """Say of each of the sensor's newest runs what these limits would have blocked; nothing is stored in any case."""
    found = gate_profiles.dry_run(session, blobs, sensor_id, {"gates": profile.gates})
    return OperationResponse(Listing(found), headers={"X-Validate-Only": "true"} if asked else {})


gate_report_router = operations("/parameter-sets", tags=["gates"])

LAID_OVER = ("verdict", "words", "blocking", "waived", "gates", "held_out", "bound")

Hash = Annotated[
    str,
    Query(
        pattern="^[0-9a-f]{64}$",
        description="A request's `bound.gate_report_sha256`: that report, even if it is not the newest.",
    ),
]


class Waiving(Shape):
    """The gate to be waived, why, and until when."""

    gate: str = Field(examples=["coverage"])
    code: str = Field(description=f"One of {', '.join(gates.CODES)}.", examples=["data-limited"])
    reason: str = Field(
        description=f"In at least {gates.LEAST_LETTERS} letters.",
        examples=["One corner was in eclipse all month; the arcs there are known to be extrapolated."],
    )
    expires_utc: str = Field(
        description=f"ISO 8601, within {gates.LONGEST_DAYS} days; the gate then blocks again.",
        examples=["2026-12-01T00:00:00Z"],
    )
    password: SecretStr = password_field("Your own password again.")
    factor: SecretStr = factor_field()


ProvenWaiver = Annotated[PasswordProof, own_password(Waiving)]


def _examine(
    parameter_set_id: Id, actor: Who, forecast_sources: DryRunSources, engine: Database
) -> gates.GateAssessment:
    """Evaluate the validation frames before the writing transaction, because that takes seconds and there is one writer."""
    require_role(actor, *gates.ASSESSORS)
    require_scope(actor, "parameter-sets")
    with open_reading(engine) as session:
        case = read_gate_inputs(session, parameter_set_id)
    return gates.examine(case, forecast_sources.blobs, forecast_sources.catalogue(), forecast_sources.catalogue_folder)


Examined = Annotated[gates.GateAssessment, Depends(_examine)]


def make_row(session: Session, row: GateReport) -> RowWithFields:
    """Return a report with its waivers applied, and whether its inputs are unchanged."""
    document = to_plain(gates.lay_waivers(session, row)) | {"bound": row.document["bound"]}  # as it is stored
    laid_over = {name: document[name] for name in LAID_OVER}
    given = approval_queries.list_waivers(session, [row.parameter_set_id])
    return RowWithFields(row, **laid_over, holds=not gates.list_moved_since(session, row), waivers=given)


@gate_report_router.post(
    "/{parameter_set_id}:assess",
    summary="Assess its gates",
    status_code=201,
    response_model=schemas.GateReport,
)
@refuses(412)
def assess_parameter_set(
    actor: Who,
    examined: Examined,
    session: Writing,
) -> RowWithFields:
    """Match the validation frames with this set and with the incumbent, judge every gate, and store the report.

    The same evidence gives the same report, which is then not stored again. If the evidence changed while the frames
    were matched the answer is 412: assess it again. An open request that binds another report is STALE at its next signature.
    """
    return make_row(session, gates.record_report(session, actor, examined))


@gate_report_router.get(
    "/{parameter_set_id}/gate-report", summary="Read its gate report", response_model=schemas.GateReport
)
def get_gate_report(parameter_set_id: Id, session: Reading, sha256: Hash | None = None) -> RowWithFields:
    """Read the newest report, or the one that a request binds, with its waivers; `holds`: whether its evidence is unchanged."""
    return make_row(session, gates.get_report(session, parameter_set_id, sha256))


@gate_report_router.post(
    "/{parameter_set_id}:waive", summary="Waive a gate", status_code=201, response_model=schemas.Waiver
)
def waive_gate(
    parameter_set_id: Id, signed: Waiving, actor: Who, seen: SeenVersion, proof: ProvenWaiver, session: Writing
) -> Waiver:
    """Let this set pass despite a gate that blocks it, in person. The next request then needs two approvals."""
    return gates.waive(
        session, actor, parameter_set_id, signed.gate, signed.code, signed.reason, signed.expires_utc, proof, seen
    )


router = operations("/approvals", tags=["approvals"])


class Acknowledged(Shape):
    """A point that the signature accepts."""

    kind: Literal["gate", "warning", "evidence"]
    name: str = Field(max_length=200, examples=["coverage"])
    reason: str = Field(
        description="Why it is accepted; of a figure, why it was not opened.", examples=["The corner was in eclipse."]
    )


class PlainSigning(Shape):
    """A signature without points to answer: what it means, and the password again."""

    meaning: str = Field(examples=["I reviewed the evidence and approve this set for baseline."])
    password: SecretStr = password_field("The signer's own password again.")
    factor: SecretStr = factor_field()
    comment: str = Field("", description="Required to refuse.")

    def decided(self, decision: str) -> Decision:
        """Return the body as a decision."""
        return Decision(decision, self.meaning, self.comment)


class Signing(PlainSigning):
    """A signature: what it means, and the password again."""

    acknowledged: list[Acknowledged] | None = Field(
        None,
        max_length=200,
        description="For an approval: a reason for each point that was not answered by opening its figure. If given, or if "
        "BORESIGHT_REST_REVIEW is 1, an approval with open points is refused; otherwise the record lists the open points.",
    )

    def decided(self, decision: str) -> Decision:
        """Return the body as a decision."""
        points = (
            None if self.acknowledged is None else [Acknowledgement(**one.model_dump()) for one in self.acknowledged]
        )
        return Decision(decision, self.meaning, self.comment, points)


class SigningByName(Signing):
    """A second person's signature at another's console: who it is, and the decision, beside the rest."""

    name: str = Field(description="Log-in name of the signer.", examples=["alan"])
    decision: Literal["APPROVE", "REFUSE"]


Proven = Annotated[PasswordProof, own_password(Signing)]


@refuses(429)
async def proven_beside(
    approval_id: Id, signed: SigningByName, actor: Who, seen: SeenVersion, passwords: PasswordChecks, request: Request
) -> PasswordProof:
    """Check name and password of a second person before any transaction begins, where a password can help."""

    def refuse(session: Session) -> None:
        approvals.refuse_beside(session, actor, approval_id, signed.decided(signed.decision), seen)

    password = signed.password.get_secret_value()
    factor = signed.factor.get_secret_value()
    return await passwords.check_beside(actor, signed.name, password, get_client(request), refuse, factor)


@router.get("", summary="List requests", response_model=Page[schemas.Approval])
def list_approvals(
    session: Reading,
    page: Paged,
    state: Annotated[str | None, Query(examples=["OPEN"])] = None,
    parameter_set_id: Id | None = None,
) -> Listing[Approval]:
    """List requests for approval, newest first."""
    return page.cut(lists.list_newest(session, Approval, **page.rows, state=state, set=parameter_set_id))


@router.get("/{approval_id}", summary="Read a request", response_model=schemas.Approval)
def get_approval(approval_id: Id, session: Reading) -> Approval:
    """Read a request with its signatures; the ETag is needed to sign."""
    return session.get_known(Approval, approval_id)


@router.get("/{approval_id}/signers", summary="List who may sign", response_model=Page[schemas.Signer])
def list_signers(approval_id: Id, policy: ServerPolicy, session: Reading) -> Listing[RowWithFields]:
    """List every approver with whether they may sign this request, and if not, which action on the set excludes them."""
    found = approvals.list_request_signers(session, approval_id, policy=policy)
    return Listing(
        [
            RowWithFields(
                one.user, user_id=one.user.id, may_sign=one.refusal is None, excluded_as=one.roles, refusal=one.refusal
            )
            for one in found
        ]
    )


@router.post("/{approval_id}:approve", summary="Approve a request", response_model=schemas.Approval)
def approve(
    approval_id: Id,
    signed: Signing,
    actor: Who,
    seen: SeenVersion,
    proof: Proven,
    policy: ServerPolicy,
    session: Writing,
) -> Approval:
    """Approve as a second person, who did not submit or create the set or launch its run; not an administrator, not by API key."""
    return approvals.sign(session, actor, approval_id, signed.decided("APPROVE"), proof, seen, policy=policy).approval


@router.post("/{approval_id}:refuse", summary="Refuse a request", response_model=schemas.Approval)
def refuse(
    approval_id: Id,
    signed: Signing,
    actor: Who,
    seen: SeenVersion,
    proof: Proven,
    policy: ServerPolicy,
    session: Writing,
) -> Approval:
    """Refuse with a comment; one refusal blocks, also after an approval, until the set is promoted."""
    return approvals.sign(session, actor, approval_id, signed.decided("REFUSE"), proof, seen, policy=policy).approval


@router.post(
    "/{approval_id}:sign-over-the-shoulder", summary="Sign at another person's console", response_model=schemas.Approval
)
def sign_over_the_shoulder(
    approval_id: Id,
    signed: SigningByName,
    actor: Who,
    seen: SeenVersion,
    proof: Annotated[PasswordProof, Depends(proven_beside)],
    policy: ServerPolicy,
    session: Writing,
) -> Approval:
    """Approve or refuse as a second person, who gives name and password while another person is logged in."""
    decided = signed.decided(signed.decision)
    return approvals.sign_over_the_shoulder(session, actor, approval_id, decided, proof, seen, policy=policy).approval


discussion_router = operations("/approvals/{approval_id}", tags=["approvals"])


class Assignment(Shape):
    """Who is asked to decide."""

    user_id: Id | None = Field(description="Null: nobody.")


class NewRemark(Shape):
    """What is to be said."""

    text: str = Field(examples=["Was the focus heater on during this pass?"])


class ShownFigure(Shape):
    """Which figure was in sight."""

    evidence: Literal["convergence", "rms", "radial", "observability"]


class NewThread(NewRemark):
    """What a thread is about, and its first comment."""

    kind: Literal["gate", "parameter", "figure"]
    name: str = Field(max_length=200, examples=["coverage"])


@discussion_router.post(":assign", summary="Assign to a person", response_model=schemas.Approval)
def assign_approval(
    approval_id: Id, assignment: Assignment, actor: Who, seen: SeenVersion, policy: ServerPolicy, session: Writing
) -> Approval:
    """Assign an open request to a person who may sign it."""
    return approvals.assign(session, actor, approval_id, assignment.user_id, seen, policy=policy)


@discussion_router.get("/remarks", summary="Read the discussion", response_model=Page[schemas.Remark])
def list_remarks(approval_id: Id, session: Reading) -> Listing[Remark]:
    """Read what was said about a request, in order."""
    return Listing(approvals.list_remarks(session, approval_id))


@discussion_router.post("/remarks", summary="Add a comment", status_code=201, response_model=schemas.Remark)
def remark(approval_id: Id, new: NewRemark, actor: Who, session: Writing) -> Remark:
    """Add a remark to a request, open or decided; remarks cannot be edited."""
    return threads.add_remark(session, actor, approval_id, new.text)


@discussion_router.get("/openings", summary="Read who opened which evidence", response_model=Page[schemas.Opening])
def list_openings(approval_id: Id, session: Reading) -> Listing[Opening]:
    """Read who opened which evidence of a request, in order."""
    return Listing(approvals.list_openings(session, approval_id))


@discussion_router.post("/openings", summary="Report that a figure was visible", response_model=schemas.Opening)
def record_opening(approval_id: Id, shown: ShownFigure, actor: Who, session: Writing) -> Opening:
    """Report that a figure which you were given at least a second ago was visible; it then counts as opened by you."""
    return approvals.record_opening(session, actor, approval_id, shown.evidence)


@discussion_router.get("/points", summary="Read what a signature answers for", response_model=Page[schemas.Point])
def list_points(approval_id: Id, actor: Who, session: Reading) -> Listing[Point]:
    """Read the points of a request, gates first, with the figures that you opened."""
    return Listing(review.list_points(session, session.get_known(Approval, approval_id), actor.user_id))


async def keep_delivery(
    request: Request, actor: Who, approval_id: Id, name: FigureName, engine: Database
) -> AsyncIterator[None]:
    """Keep, once the figure was made, that the person who asked was given it."""
    yield
    with open_reading(engine) as session:
        is_first = name in review.VIEWS and approvals.must_record_delivery(session, actor, approval_id, name)
    if is_first:
        async with asynccontextmanager(open_write_session)(request) as session:
            await run_in_threadpool(approvals.record_delivery, session, actor, approval_id, name)


@discussion_router.get(
    "/figures/{name}",
    summary="Open a figure of the evidence",
    response_model=PlotlyFigure,
    dependencies=[Depends(keep_delivery, scope="function")],
)
def open_figure(
    approval_id: Id,
    name: FigureName,
    session: Reading,
    blobs: Blobs,
    figure_cache: ServerFigureCache,
    request: Request,
    seen: Seen,
) -> Response:
    """Read a figure of the run behind a request. While the request is open, the server records that you received it.

    It counts as opened by you once it was in your sight, which a page says by POST /approvals/{id}/openings.
    """
    approval = session.get_known(Approval, approval_id)
    row = session.get_one(ParameterSet, approval.parameter_set_id)
    if row.run_id is None:
        raise NotFoundError(f"{row.name} comes from no run, so there is no figure; read the set itself.")
    return get_figure(row.run_id, name, session, blobs, figure_cache, request, seen)


@discussion_router.get("/threads", summary="List the threads", response_model=Page[schemas.Thread])
def list_threads(approval_id: Id, session: Reading) -> Listing[Thread]:
    """List the threads about gates, parameters and figures of a request, each with its comments, in order."""
    return Listing(threads.list_threads(session, approval_id))


@discussion_router.post(
    "/threads", summary="Comment on a gate, parameter or figure", status_code=201, response_model=schemas.Thread
)
def open_thread(approval_id: Id, new: NewThread, actor: Who, session: Writing) -> Thread:
    """Open a thread with its first comment; `@name` mentions a person by log-in name."""
    return threads.open_thread(session, actor, approval_id, new.kind, new.name, new.text)


@discussion_router.get("/threads/{thread_id}", summary="Read a thread", response_model=schemas.Thread)
def get_thread(approval_id: Id, thread_id: Id, session: Reading) -> Thread:
    """Read a thread; the ETag is needed to resolve it."""
    return threads.get_thread(session, approval_id, thread_id)


@discussion_router.post(
    "/threads/{thread_id}/remarks", summary="Answer in a thread", status_code=201, response_model=schemas.Remark
)
def answer_thread(approval_id: Id, thread_id: Id, new: NewRemark, actor: Who, session: Writing) -> Remark:
    """Add a comment to a thread, open or resolved; comments cannot be edited."""
    return threads.add_remark(session, actor, approval_id, new.text, thread_id)


@discussion_router.post("/threads/{thread_id}:resolve", summary="Resolve a thread", response_model=schemas.Thread)
def resolve_thread(approval_id: Id, thread_id: Id, actor: Who, seen: SeenVersion, session: Writing) -> Thread:
    """Mark a thread as resolved, with your name and the time."""
    return threads.set_resolved(session, actor, approval_id, thread_id, "resolved", seen)


@discussion_router.post("/threads/{thread_id}:reopen", summary="Reopen a thread", response_model=schemas.Thread)
def reopen_thread(approval_id: Id, thread_id: Id, actor: Who, seen: SeenVersion, session: Writing) -> Thread:
    """Open a resolved thread again."""
    return threads.set_resolved(session, actor, approval_id, thread_id, "reopened", seen)
