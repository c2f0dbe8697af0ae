"""Presets: settings under a name, Boresight's own and the mission's."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from boresight.api import schemas
from boresight.api.dependencies import Reading, SeenTag, Who, Writing
from boresight.api.numbers import Id
from boresight.api.operation import Beside, operations
from boresight.api.paging import Listing, Page, Paged
from boresight.services import presets
from boresight.services.presets import BUILT_IN, Offer
from boresight.store.tables import Preset

router = operations("/presets", tags=["runs"])


class NewPreset(BaseModel):
    """Settings to keep under a name."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(examples=["Thermal season"])
    sentence: str = Field(description="When to use it.", examples=["While the radiator faces the Sun."])
    settings: schemas.Settings = Field(default_factory=dict)


def _own(offer: Offer) -> Beside:
    """Return one of Boresight's own."""
    return Beside(offer, **dict.fromkeys(("id", "number", "created_utc", "created_by", "archived_utc")))


def _saved(row: Preset) -> Beside:
    """Return a saved version."""
    return Beside(row, key=str(row.id), settings=row.document)


@router.get("", summary="List presets", response_model=Page[schemas.Preset])
def list_presets(session: Reading, page: Paged, archived: bool = False) -> Listing[Beside]:
    """List saved versions, newest first, with the archived ones where asked; the first page begins with Boresight's own."""
    found = presets.list_presets(session, archived=archived, before_id=page.last_id, limit=page.limit + 1)
    saved = page.cut(found, _saved)
    own = [_own(offer) for offer in BUILT_IN] if page.last_id is None else []
    return Listing([*own, *saved.items], saved.next)


@router.post("", summary="Save a preset", status_code=201, response_model=schemas.Preset)
def save_preset(preset: NewPreset, actor: Who, session: Writing) -> Beside:
    """Keep settings under a name; a name that is there gets its next version."""
    return _saved(presets.save_preset(session, actor, preset.name, preset.sentence, preset.settings))


@router.get("/{preset_id}", summary="Read a preset", response_model=schemas.Preset)
def get_preset(preset_id: Id, session: Reading) -> Beside:
    """Read a saved version, archived or not."""
    return _saved(presets.get_preset(session, preset_id))


@router.post("/{preset_id}:archive", summary="Archive a preset", response_model=schemas.Preset)
def archive_preset(preset_id: Id, actor: Who, seen: SeenTag, session: Writing) -> Beside:
    """Take a version out of the choice; nothing is deleted."""
    seen.require(schemas.Preset, presets.get_preset(session, preset_id), f"Preset {preset_id}")
    return _saved(presets.archive_preset(session, actor, preset_id))
