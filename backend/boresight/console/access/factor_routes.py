"""Operations on one's own second factors, and an administrator's reset of another person's."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import Depends
from pydantic import Field, SecretStr

from boresight.console.access import confirmations, schemas, second_factors
from boresight.console.access.dependencies import (
    Reading,
    SeenTag,
    ServerFactorRules,
    Who,
    Writing,
    factor_field,
    get_site,
    own_password,
    password_field,
)
from boresight.console.access.passwords import PasswordProof
from boresight.console.access.routes import require_seen
from boresight.console.access.second_factors import FactorOffer
from boresight.console.access.tables import SecondFactor, User
from boresight.console.access.webauthn_ceremonies import RelyingParty
from boresight.console.operation import OperationResponse, RowWithFields, operations
from boresight.console.schemas import Shape
from boresight.platform.web.paging import Id, Listing, Page, Paged

router = operations("/second-factors", tags=["second factors"])
BrowserSite = Annotated[RelyingParty, Depends(get_site)]
ONCE = {"Cache-Control": "no-store"}


class Confirmation(Shape):
    """What confirms the person: the password again, and a second factor where one is enrolled."""

    password: SecretStr = password_field("Your own password again.")
    factor: SecretStr = factor_field()


class Beginning(Confirmation):
    """Which kind of second factor is to be enrolled."""

    kind: Literal["totp", "webauthn"] = Field("totp", description="An authenticator app, or a security key.")


class Enrolment(Shape):
    """What an enrolment ends with."""

    challenge_id: Id
    label: str = Field("", examples=["Phone"])
    factor: SecretStr = Field(description="A code of the new app, or the answer of the new security key as JSON.")


Confirmed = Annotated[PasswordProof, own_password(Confirmation)]
ConfirmedBeginning = Annotated[PasswordProof, own_password(Beginning)]


@router.get("", summary="List second factors", response_model=Page[schemas.SecondFactor])
def list_second_factors(actor: Who, session: Reading, page: Paged) -> Listing[SecondFactor]:
    """List one's own second factors, without their secrets."""
    return page.cut_whole(second_factors.list_factors(session, actor))


@router.post("", summary="Enrol a second factor", status_code=201, response_model=schemas.NewSecondFactor)
def enrol_second_factor(
    given: Enrolment, actor: Who, rules: ServerFactorRules, site: BrowserSite, session: Writing
) -> OperationResponse:
    """Enrol what `:begin` began, once it proves to work; the first one comes with recovery codes, which are in no other answer."""
    answer = given.factor.get_secret_value()
    row, codes = second_factors.enrol(session, actor, given.challenge_id, given.label, answer, rules, site)
    return OperationResponse(RowWithFields(row, recovery_codes=codes), headers=ONCE, shown_once=("recovery_codes",))


@router.post(":begin", summary="Begin an enrolment", response_model=schemas.FactorOffer)
def begin_second_factor(
    signed: Beginning,
    actor: Who,
    proof: ConfirmedBeginning,
    rules: ServerFactorRules,
    site: BrowserSite,
    session: Writing,
) -> OperationResponse:
    """Return the secret of an app, or the options for `navigator.credentials.create`, to be answered within 10 minutes."""
    confirmations.require(session, actor, proof)
    offer: FactorOffer = second_factors.offer(session, actor, signed.kind, rules, site)
    return OperationResponse(offer, headers=ONCE, shown_once=("secret", "uri"))


@router.post(":challenge", summary="Ask a security key", response_model=schemas.KeyChallenge)
def challenge_security_key(actor: Who, rules: ServerFactorRules, site: BrowserSite, session: Writing) -> dict[str, Any]:
    """Return the options for `navigator.credentials.get`, whose answer is the second factor of one signature."""
    return {"options": second_factors.make_signing_challenge(session, actor, rules, site)}


@router.post(":renew-recovery-codes", summary="Make recovery codes", response_model=schemas.RecoveryCodes)
def renew_recovery_codes(signed: Confirmation, actor: Who, proof: Confirmed, session: Writing) -> OperationResponse:  # noqa: ARG001 - read by `proof`
    """Make ten recovery codes in place of those that are left. They are in this answer and nowhere else."""
    confirmations.require(session, actor, proof)
    codes = second_factors.renew_recovery_codes(session, actor)
    return OperationResponse({"recovery_codes": codes}, headers=ONCE, shown_once=("recovery_codes",))


@router.post("/{factor_id}:remove", summary="Remove a second factor", response_model=schemas.SecondFactor)
def remove_second_factor(
    factor_id: Id,
    signed: Confirmation,  # noqa: ARG001 - read by `proof`
    actor: Who,
    proof: Confirmed,
    rules: ServerFactorRules,
    session: Writing,
) -> SecondFactor:
    """Remove one of one's own second factors; another person's is reset by an administrator."""
    confirmations.require(session, actor, proof)
    return second_factors.remove(session, actor, factor_id, rules)


person_router = operations("/users", tags=["users"])


@person_router.post("/{user_id}:reset-second-factor", summary="Reset a second factor", response_model=schemas.User)
def reset_second_factor(user_id: Id, actor: Who, seen: SeenTag, session: Writing) -> User:
    """Remove every second factor and recovery code of another person, and end their log-ins; administrators only."""
    require_seen(session, user_id, seen)
    return second_factors.reset(session, actor, user_id)
