"""Requests for approval: read, sign, refuse. Only people sign, each with the password given again."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query
from pydantic import BaseModel, ConfigDict, Field, SecretStr
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Held, Reading, SeenVersion, Who, Writing, check_own, client_of, etag
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.api.passwords import Passwords
from boresight.services import approvals
from boresight.services.actors import Actor, Policy
from boresight.services.passwords import PasswordProof
from boresight.store.sessions import Session

router = APIRouter(prefix="/approvals", tags=["approvals"])

TRANSITION = refusals(404, 409, 412, 428, 429)


class Signing(BaseModel):
    """A signature: what it means, and the password again."""

    model_config = ConfigDict(extra="forbid")
    meaning: str = Field(examples=["I reviewed the evidence and approve this set for baseline."])
    password: SecretStr = Field(description="The signer's own, given again.")
    comment: str = Field("", description="Needed to refuse.")


class SigningByName(Signing):
    """A second person's signature at another's console: who it is, and the decision, beside the rest."""

    name: str = Field(description="Log-in name of who signs.", examples=["alan"])
    decision: Literal["APPROVE", "REFUSE"]


def _shown(session: Session, row: Any) -> schemas.Document:
    """Write a request with its signatures."""
    signatures = [
        schemas.written(schemas.Signature, signature) for signature in approvals.signatures_of(session, row.id)
    ]
    return {**schemas.written(schemas.Approval, row), "signatures": signatures}


def _answer(session: Session, row: Any) -> Answer:
    return Answer(_shown(session, row), headers={"ETag": etag(row.version)})


async def proven_own(signing: Signing, actor: Who, request: Request) -> tuple[Signing, PasswordProof]:
    """Check the password of who acts before any transaction begins."""
    return signing, await check_own(request, actor, signing.password.get_secret_value())


Proven = Annotated[tuple[Signing, PasswordProof], Depends(proven_own)]


async def proven_beside(
    approval_id: Id, signing: SigningByName, actor: Who, seen: SeenVersion, request: Request
) -> tuple[SigningByName, PasswordProof]:
    """Check name and password of a second person before any transaction begins, where a password can help."""
    checks: Passwords = request.app.state.passwords
    password = signing.password.get_secret_value()
    words = (signing.decision, signing.meaning, signing.comment)

    def refuse(session: Session) -> None:
        approvals.refuse_beside(session, actor, approval_id, *words, seen)

    return signing, await checks.check_beside(actor, signing.name, password, client_of(request), refuse)


@router.get("", name="list_approvals", summary="List requests", response_model=Page[schemas.Approval])
def list_approvals(
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    page: Paged,
    state: Annotated[str | None, Query(examples=["OPEN"])] = None,
    parameter_set_id: Id | None = None,
) -> Response:
    """List requests for approval, newest first."""
    found = approvals.list_approvals(
        session, state=state, parameter_set_id=parameter_set_id, before_id=page.last_id, limit=page.limit + 1
    )
    return json_response(page.cut(found, lambda row: _shown(session, row)))


@router.get(
    "/{approval_id}",
    name="get_approval",
    summary="Read a request",
    response_model=schemas.Approval,
    responses=refusals(404),
)
def get_approval(approval_id: Id, actor: Who, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """Read a request with its signatures; the ETag is for signing."""
    return _answer(session, approvals.get_approval(session, approval_id)).response()


@router.get(
    "/{approval_id}/signers",
    name="list_signers",
    summary="List who may sign",
    response_model=Page[schemas.Signer],
    responses=refusals(404),
)
def list_signers(approval_id: Id, actor: Who, policy: Held, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """List every approver with whether they may sign this request, and if not, which part in the set excludes them."""
    found = approvals.who_may_sign(session, approval_id, policy=policy)
    items = [
        {
            "user_id": one.user.id,
            "printed_name": one.user.printed_name,
            "may_sign": one.refusal is None,
            "excluded_as": list(dict.fromkeys(one.roles)),
            "refusal": one.refusal,
        }
        for one in found
    ]
    return json_response({"items": items, "next": None})


@router.post(
    "/{approval_id}:approve",
    name="approve",
    summary="Sign for it",
    response_model=schemas.Approval,
    responses=TRANSITION,
)
def approve(
    approval_id: Id, actor: Who, seen: SeenVersion, proven: Proven, once: Idempotent, policy: Held, session: Writing
) -> Response:
    """Approve, as a second person: neither who submitted or created the set nor who launched its run; no administrator, no key."""
    return once.answer(session, actor, lambda: _signed(session, actor, approval_id, "APPROVE", proven, seen, policy))


@router.post(
    "/{approval_id}:refuse",
    name="refuse",
    summary="Sign against it",
    response_model=schemas.Approval,
    responses=TRANSITION,
)
def refuse(
    approval_id: Id, actor: Who, seen: SeenVersion, proven: Proven, once: Idempotent, policy: Held, session: Writing
) -> Response:
    """Refuse with a comment; one refusal blocks, also after an approval, until the set is promoted."""
    return once.answer(session, actor, lambda: _signed(session, actor, approval_id, "REFUSE", proven, seen, policy))


def _signed(
    session: Session,
    actor: Actor,
    approval_id: Id,
    decision: str,
    proven: tuple[Signing, PasswordProof],
    seen: int,
    policy: Policy,
) -> Answer:
    """Sign, and tell how the request now stands."""
    signing, proof = proven
    words = (decision, signing.meaning, signing.comment)
    approvals.sign(session, actor, approval_id, *words, proof, seen, policy=policy)
    return _answer(session, approvals.get_approval(session, approval_id))


@router.post(
    "/{approval_id}:sign-over-the-shoulder",
    name="sign_over_the_shoulder",
    summary="Sign at another's console",
    response_model=schemas.Approval,
    responses=TRANSITION,
)
def sign_over_the_shoulder(
    approval_id: Id,
    actor: Who,
    seen: SeenVersion,
    proven: Annotated[tuple[SigningByName, PasswordProof], Depends(proven_beside)],
    once: Idempotent,
    policy: Held,
    session: Writing,
) -> Response:
    """Approve or refuse as a second person who gives name and password where another is logged in."""

    def act() -> Answer:
        signing, proof = proven
        words = (signing.decision, signing.meaning, signing.comment)
        approvals.sign_over_the_shoulder(session, actor, approval_id, *words, proof, seen, policy=policy)
        return _answer(session, approvals.get_approval(session, approval_id))

    return once.answer(session, actor, act)
