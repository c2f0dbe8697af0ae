"""API keys: make, list, revoke. The secret is shown once."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import MaybeSeenTag, Reading, Who, Writing, require_tag, tag_of
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.services import api_keys
from boresight.services.actors import SCOPES
from boresight.store.tables import ApiKey

router = APIRouter(prefix="/api-keys", tags=["API keys"])


class NewKey(BaseModel):
    """A key to be made for the person who asks."""

    model_config = ConfigDict(extra="forbid")
    label: str = Field(description="What uses it.", examples=["nightly downlink"])
    scopes: Annotated[
        list[Annotated[str, Field(json_schema_extra={"enum": list(SCOPES)})]],
        Field(description="What it may write. None: it only reads."),
    ] = []
    expires_days: int | None = Field(90, description="Null: never.")


@router.get("", name="list_api_keys", summary="List keys", response_model=Page[schemas.ApiKey])
def list_api_keys(actor: Who, session: Reading, page: Paged) -> Response:
    """List one's own keys, newest first; administrators see everyone's."""
    owner = None if "administrator" in actor.roles else actor.user_id
    found = api_keys.list_keys(session, owner)
    return json_response(page.cut_whole(found, lambda row: schemas.written(schemas.ApiKey, row)))


@router.post("", name="create_api_key", summary="Make a key", status_code=201, response_model=schemas.NewApiKey)
def create_api_key(wanted: NewKey, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Make a key. `secret` is in this answer and nowhere else."""

    def act() -> Answer:
        row, secret = api_keys.create_key(
            session, actor, label=wanted.label, scopes=wanted.scopes, expires_days=wanted.expires_days
        )
        key = schemas.written(schemas.ApiKey, row)
        headers = {"Cache-Control": "no-store", "ETag": _tag(row)}
        return Answer({**key, "secret": secret}, 201, headers, kept={**key, "secret": None})

    return once.answer(session, actor, act)


@router.post(
    "/{key_id}:revoke",
    name="revoke_api_key",
    summary="Revoke a key",
    response_model=schemas.ApiKey,
    responses=refusals(404, 412),
)
def revoke_api_key(key_id: Id, actor: Who, seen: MaybeSeenTag, once: Idempotent, session: Writing) -> Response:
    """End a key at once."""

    def act() -> Answer:
        if seen is not None:
            key = api_keys.get_key(session, key_id)
            require_tag(seen, _tag(key), f"The API key {key.label!r}")
        row = api_keys.revoke_key(session, actor, key_id)
        return Answer(schemas.written(schemas.ApiKey, row), headers={"ETag": _tag(row)})

    return once.answer(session, actor, act)


def _tag(key: ApiKey) -> str:
    return tag_of(key.id, key.revoked_utc)
