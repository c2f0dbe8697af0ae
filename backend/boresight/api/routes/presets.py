"""Presets: settings under a name, Boresight's own and the mission's."""

from __future__ import annotations

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Reading, SeenTag, Who, Writing, require_tag, tag_of
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.services import presets
from boresight.services.presets import BUILT_IN, Offer
from boresight.store.sessions import Session
from boresight.store.tables import Preset

router = APIRouter(prefix="/presets", tags=["runs"])


class NewPreset(BaseModel):
    """Settings to keep under a name."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(examples=["Thermal season"])
    sentence: str = Field(description="When to use it.", examples=["While the radiator faces the Sun."])
    settings: schemas.Document = Field(default_factory=dict)


def _own(offer: Offer) -> schemas.Document:
    """Write one of Boresight's own."""
    absent = dict.fromkeys(("id", "number", "created_utc", "created_by", "archived_utc"))
    told = {"key": offer.key, "name": offer.name, "sentence": offer.sentence, "settings": dict(offer.settings)}
    return schemas.Preset.model_validate({**absent, **told}).model_dump(mode="json")


def _saved(row: Preset) -> schemas.Document:
    """Write a saved version."""
    columns = {name: getattr(row, name) for name in schemas.Preset.model_fields if hasattr(row, name)}
    return schemas.Preset(**columns, key=str(row.id), settings=row.document).model_dump(mode="json")


def _tagged(row: Preset, status: int = 200, **headers: str) -> Answer:
    """Answer with a saved version."""
    return Answer(_saved(row), status, {"ETag": _tag(row), **headers})


def _tag(row: Preset) -> str:
    return tag_of(row.id, row.archived_utc)


@router.get("", name="list_presets", summary="List presets", response_model=Page[schemas.Preset])
def list_presets(
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    page: Paged,
    archived: bool = False,
) -> Response:
    """List saved versions, newest first, with the archived ones where asked; the first page begins with Boresight's own."""
    found = presets.list_presets(session, archived=archived, before_id=page.last_id, limit=page.limit + 1)
    body = page.cut(found, _saved)
    own = [_own(offer) for offer in BUILT_IN] if page.last_id is None else []
    return json_response({**body, "items": [*own, *body["items"]]})


@router.post(
    "",
    name="save_preset",
    summary="Save a preset",
    status_code=201,
    response_model=schemas.Preset,
    responses=refusals(409),
)
def save_preset(preset: NewPreset, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Keep settings under a name; a name that is there gets its next version."""

    def act() -> Answer:
        row = presets.save_preset(session, actor, preset.name, preset.sentence, preset.settings)
        return _tagged(row, 201, Location=f"/api/v1/presets/{row.id}")

    return once.answer(session, actor, act)


@router.get(
    "/{preset_id}", name="get_preset", summary="Read a preset", response_model=schemas.Preset, responses=refusals(404)
)
def get_preset(preset_id: Id, actor: Who, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """Read a saved version, archived or not."""
    return _tagged(presets.get_preset(session, preset_id)).response()


@router.post(
    "/{preset_id}:archive",
    name="archive_preset",
    summary="Archive a preset",
    response_model=schemas.Preset,
    responses=refusals(404, 412, 428),
)
def archive_preset(preset_id: Id, actor: Who, seen: SeenTag, once: Idempotent, session: Writing) -> Response:
    """Take a version out of the choice; nothing is deleted."""
    return once.answer(session, actor, lambda: _archived(session, actor, preset_id, seen))


def _archived(session: Session, actor: Who, preset_id: int, seen: str) -> Answer:
    """Archive and answer with the version."""
    require_tag(seen, _tag(presets.get_preset(session, preset_id)), f"Preset {preset_id}")
    return _tagged(presets.archive_preset(session, actor, preset_id))
