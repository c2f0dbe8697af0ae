"""New telemetry: send a file to be judged by its sensor's policy, read the decisions, answer them; draft and enable policies."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from fastapi import Depends, Query
from pydantic import Field

from boresight.console.access.dependencies import (
    Blobs,
    Database,
    DryRunSources,
    IsDryRun,
    Reading,
    SeenVersion,
    ServerPolicy,
    ServerSettings,
    Who,
    Writing,
)
from boresight.console.ingest import policies, service, tables
from boresight.console.ingest.service import SentFile
from boresight.console.list_queries import list_newest
from boresight.console.operation import operations
from boresight.console.schemas import Document, Row, Shape, file_field, multipart
from boresight.console.telemetry.dependencies import Upload, Uploaded
from boresight.console.telemetry.service import ImageUpload, PreparedUpload
from boresight.disks import compute_digest
from boresight.errors import BoresightError, ConflictError, UnavailableError
from boresight.platform.actors import require_role, require_scope
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.platform.web.paging import Id, Listing, Page, Paged

PolicyState = Literal["DRAFT", "ACTIVE", "PAUSED", "OFF"]
DecisionState = Literal[
    "CALIBRATING", "WITHIN FORECAST", "UNCONFIRMED", "ASKED", "ANSWERED", "SUPERSEDED", "NOT JUDGED", "REFUSED"
]


class IngestPolicy(Row):
    """A version of a sensor's policy for new telemetry."""

    versioned_by = ("version",)
    location = "/ingest-policies/{row.id}"

    id: int
    sensor_id: int
    number: int
    document: Document = Field(description="Its rules.")
    sha256: str
    reason: str
    created_utc: str
    created_by: int | None
    state: PolicyState
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    rehearsal: Document | None = Field(
        description="The decisions it would have requested in the past; null until it is rehearsed."
    )
    rehearsed_utc: str | None
    enabled_utc: str | None
    pause_code: str | None = Field(description="Why it is paused, for programs.", examples=["BAD CLOCK"])
    pause_reason: str | None
    paused_utc: str | None
    resumed_utc: str | None = Field(description="Time from which the limits are counted.")


class IngestDecision(Row):
    """What was made of one file of new telemetry."""

    versioned_by = ("version",)
    location = "/ingest-decisions/{row.id}"

    id: int
    sensor_id: int
    policy_id: int
    source: Literal["FOLDER", "REST", "ARCHIVE", "BUCKET"]
    file_name: str
    file_sha256: str | None
    size_bytes: int
    received_utc: str
    received_by: int | None = Field(description="Who sent it; null for the watched folder and an archive.")
    telemetry_set_id: int | None
    run_id: int | None
    parameter_set_id: int | None = Field(description="The candidate that was prepared, if a decision is requested.")
    approval_id: int | None = Field(description="The request for approval that a person's answer opened.")
    state: DecisionState
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    sentence: str
    evidence: Document = Field(
        description="`reasons` with code and sentence; `holds` and `forecast`, the tests against baseline and line; `gates`; "
        "`alternatives` with the one that is `recommended`; `recalibrate`, what the sensor's trend advised then."
    )
    decided_utc: str | None
    answer: Literal["SUBMIT", "WAIT", "MORE DATA", "RECALIBRATE"] | None
    answer_reason: str | None
    answered_utc: str | None
    answered_by: int | None
    quiet_until_utc: str | None


router = operations("/ingest", tags=["ingest"])

FORM = multipart(
    ("sensor_id", "file"),
    sensor_id={"type": "integer", "description": "The sensor of the telemetry."},
    file=file_field("New telemetry, as the mapping profile of the sensor's policy reads it."),
)


@dataclass(frozen=True)
class Intake:
    """A file that was read and checked, and by which policy."""

    policy_id: int
    sent: SentFile
    prepared: PreparedUpload


def _sent(upload: Upload) -> SentFile:
    path = upload.file()
    return SentFile("REST", upload.file_name, compute_digest(path), path.stat().st_size)


def _take_in(
    actor: Who,
    upload: Uploaded,
    sources: DryRunSources,
    settings: ServerSettings,
    engine: Database,
    is_dry_run: IsDryRun,
) -> Iterator[Intake]:
    """Read and check the file before the writing transaction; a refusal is a decision on record too."""
    require_role(actor, "analyst")
    require_scope(actor, "telemetry-sets")
    with open_reading(engine) as session:
        intake = service.read_intake(session, upload.number("sensor_id"))
        policy = session.get_known(tables.IngestPolicy, intake.policy_id)
        flood = service.explain_flood(session, policy)
    if flood is not None:
        if not is_dry_run:
            with open_writing(engine) as session:
                policies.pause(session, session.get_known(tables.IngestPolicy, policy.id), "TOO MANY SETS", flood)
        raise ConflictError(f"{flood} The policy is paused; have a person resume it.")
    sent, images = _sent(upload), ImageUpload(upload.images, settings.image_limits, settings.image_seconds)
    with ExitStack() as stack:
        try:
            checking = service.hold_intake(
                intake, sources, upload.file(), upload.file_name, settings.telemetry_limits, images
            )
            prepared = stack.enter_context(checking)
        except UnavailableError:
            raise
        except BoresightError as error:
            if not is_dry_run:
                with open_writing(engine) as session:
                    service.refuse(session, actor, intake.policy_id, sent, str(error), service.find_code(error))
            raise
        yield Intake(intake.policy_id, sent, prepared)


TakenIn = Annotated[Intake, Depends(_take_in, scope="function")]


@router.post(
    "",
    summary="Send new telemetry",
    status_code=202,
    response_model=IngestDecision,
    openapi_extra=FORM,
)
def ingest(actor: Who, intake: TakenIn, session: Writing, blobs: Blobs) -> tables.IngestDecision:
    """Have new telemetry imported by the mapping profile of its sensor's policy, checked, calibrated and judged.

    The answer is the decision, whose `state` moves on by itself: within the forecast nothing is asked, else a request is
    prepared that a person opens. Needs an active policy (409). A file that is refused is a decision too, and pauses the policy
    where it is of another sensor, has times that cannot be, or is one too many. The same bytes again give the same decision.
    """
    return service.receive(session, actor, blobs, intake.policy_id, intake.prepared, intake.sent)


decision_router = operations("/ingest-decisions", tags=["ingest"])


class GivenAnswer(Shape):
    """A person's answer."""

    answer: Literal["SUBMIT", "WAIT", "MORE DATA", "RECALIBRATE"] = Field(
        description="SUBMIT opens the request for approval of the set that was prepared."
    )
    reason: str = Field(max_length=service.LONGEST_REASON, examples=["The focus moved after safe mode."])
    days: float = Field(
        service.QUIET_DAYS, description="For WAIT: how long no decision on the same change is requested."
    )


@decision_router.get("", summary="List ingest decisions", response_model=Page[IngestDecision])
def list_ingest_decisions(
    session: Reading,
    page: Paged,
    sensor_id: Id | None = None,
    state: Annotated[DecisionState | None, Query(examples=["ASKED"])] = None,
) -> Listing[tables.IngestDecision]:
    """List what was made of new telemetry, newest first."""
    return page.cut(list_newest(session, tables.IngestDecision, sensor=sensor_id, state=state, **page.rows))


@decision_router.get("/{decision_id}", summary="Read an ingest decision", response_model=IngestDecision)
def get_ingest_decision(decision_id: Id, session: Reading) -> tables.IngestDecision:
    """Read a decision with its reasons; the ETag is needed to answer it."""
    return session.get_known(tables.IngestDecision, decision_id)


@decision_router.post("/{decision_id}:answer", summary="Answer an ingest decision", response_model=IngestDecision)
def answer_ingest_decision(
    decision_id: Id,
    given: GivenAnswer,
    actor: Who,
    seen: SeenVersion,
    session: Writing,
    blobs: Blobs,
    policy: ServerPolicy,
) -> tables.IngestDecision:
    """Answer a decision that is ASKED, as a person who is logged in; an API key cannot."""
    said = service.DecisionAnswer(given.answer, given.reason, given.days)
    return service.answer(session, actor, blobs, decision_id, said, seen, policy=policy)


policy_router = operations("/ingest-policies", tags=["ingest"])


class NewPolicy(Shape):
    """The next version of a sensor's policy."""

    sensor_id: Id
    rules: Document = Field(default_factory=dict, description="Rules by name; omitted ones are at their defaults.")
    reason: str = Field(max_length=policies.LONGEST_REASON, examples=["Passes come twice a day."])


class PolicyReason(Shape):
    """Why a policy is changed."""

    reason: str = Field(max_length=policies.LONGEST_REASON)


@policy_router.get("", summary="List ingest policies", response_model=Page[IngestPolicy])
def list_ingest_policies(
    session: Reading, page: Paged, sensor_id: Id | None = None, state: PolicyState | None = None
) -> Listing[tables.IngestPolicy]:
    """List the versions of policies, newest first."""
    return page.cut(list_newest(session, tables.IngestPolicy, sensor=sensor_id, state=state, **page.rows))


@policy_router.post("", summary="Draft an ingest policy", status_code=201, response_model=IngestPolicy)
def draft_ingest_policy(given: NewPolicy, actor: Who, session: Writing) -> tables.IngestPolicy:
    """Write the next version of a sensor's policy; it takes nothing in until it was rehearsed and enabled."""
    return policies.draft(session, actor, given.sensor_id, given.rules, given.reason)


@policy_router.get("/{policy_id}", summary="Read an ingest policy", response_model=IngestPolicy)
def get_ingest_policy(policy_id: Id, session: Reading) -> tables.IngestPolicy:
    """Read a policy with its rehearsal; the ETag is needed to change its state."""
    return session.get_known(tables.IngestPolicy, policy_id)


def _rehearse(policy_id: Id, actor: Who, engine: Database) -> dict[str, Any]:
    """Walk over the past before the writing transaction."""
    require_role(actor, *policies.WRITERS)
    with open_reading(engine) as session:
        return policies.compute_rehearsal(session, policy_id)


Rehearsed = Annotated[dict[str, Any], Depends(_rehearse, scope="function")]


@policy_router.post("/{policy_id}:rehearse", summary="Rehearse a policy", response_model=IngestPolicy)
def rehearse_ingest_policy(
    policy_id: Id, actor: Who, seen: SeenVersion, found: Rehearsed, session: Writing
) -> tables.IngestPolicy:
    """Apply a policy to the sensor's past calibrations and keep what it would have asked; nothing else happens."""
    return policies.record_rehearsal(session, actor, policy_id, found, seen)


@policy_router.post("/{policy_id}:enable", summary="Enable a policy", response_model=IngestPolicy)
def enable_ingest_policy(policy_id: Id, actor: Who, seen: SeenVersion, session: Writing) -> tables.IngestPolicy:
    """Put a rehearsed draft into force in place of the sensor's policy, as an administrator in person."""
    return policies.enable(session, actor, policy_id, seen)


@policy_router.post("/{policy_id}:pause", summary="Pause a policy", response_model=IngestPolicy)
def pause_ingest_policy(
    policy_id: Id, given: PolicyReason, actor: Who, seen: SeenVersion, session: Writing
) -> tables.IngestPolicy:
    """Stop taking files in until a person resumes it."""
    return policies.pause_by_person(session, actor, policy_id, given.reason, seen)


@policy_router.post("/{policy_id}:resume", summary="Resume a policy", response_model=IngestPolicy)
def resume_ingest_policy(
    policy_id: Id, given: PolicyReason, actor: Who, seen: SeenVersion, session: Writing
) -> tables.IngestPolicy:
    """Let a paused policy go on, as a person who is logged in; its limits count again."""
    return policies.resume(session, actor, policy_id, given.reason, seen)


@policy_router.post("/{policy_id}:switch-off", summary="Switch a policy off", response_model=IngestPolicy)
def switch_off_ingest_policy(
    policy_id: Id, given: PolicyReason, actor: Who, seen: SeenVersion, session: Writing
) -> tables.IngestPolicy:
    """Take a policy out of force for good, or give a draft up."""
    return policies.switch_off(session, actor, policy_id, given.reason, seen)
