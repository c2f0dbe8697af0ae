"""API keys: make, list, revoke. The secret is shown once."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from boresight.api import schemas
from boresight.api.dependencies import MaybeSeenTag, Reading, Who, Writing
from boresight.api.numbers import Id
from boresight.api.operation import Answer, Beside, operations
from boresight.api.paging import Listing, Page, Paged
from boresight.services import api_keys
from boresight.services.actors import SCOPES
from boresight.store.tables import ApiKey

router = operations("/api-keys", tags=["API keys"])


class NewKey(BaseModel):
    """A key to be made for the person who asks."""

    model_config = ConfigDict(extra="forbid")
    label: str = Field(description="What uses it.", examples=["nightly downlink"])
    scopes: Annotated[
        list[Annotated[str, Field(json_schema_extra={"enum": list(SCOPES)})]],
        Field(description="What it may write. None: it only reads."),
    ] = []
    expires_days: int | None = Field(90, description="Null: never.")


@router.get("", summary="List keys", response_model=Page[schemas.ApiKey])
def list_api_keys(actor: Who, session: Reading, page: Paged) -> Listing[ApiKey]:
    """List one's own keys, newest first; administrators see everyone's."""
    owner = None if "administrator" in actor.roles else actor.user_id
    return page.cut_whole(api_keys.list_keys(session, owner))


@router.post("", summary="Make a key", status_code=201, response_model=schemas.NewApiKey)
def create_api_key(wanted: NewKey, actor: Who, session: Writing) -> Answer:
    """Make a key. `secret` is in this answer and nowhere else."""
    row, secret = api_keys.create_key(session, actor, **dict(wanted))
    return Answer(Beside(row, secret=secret), headers={"Cache-Control": "no-store"}, shown_once=("secret",))


@router.post("/{key_id}:revoke", summary="Revoke a key", response_model=schemas.ApiKey)
def revoke_api_key(key_id: Id, actor: Who, seen: MaybeSeenTag, session: Writing) -> ApiKey:
    """End a key at once."""
    key = api_keys.get_key(session, key_id)
    seen.require(schemas.ApiKey, key, f"The API key {key.label!r}")
    return api_keys.revoke_key(session, actor, key_id)
