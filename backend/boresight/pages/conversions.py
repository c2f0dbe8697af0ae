"""A parameter set in every other camera model, as its page shows it: values and misfit, or the reason why there are none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from boresight.errors import RefusedInputError
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.services.conversions import conversion_of
from boresight.store.sessions import Session
from boresight.store.tables import ParameterSet


@dataclass(frozen=True)
class Converted:
    """A set in another model: its document, or why there is none."""

    model: str
    document: dict[str, Any] | None
    refusal: str | None


def conversions_of(session: Session, row: ParameterSet) -> list[Converted]:
    """Try every other camera model on a set."""
    return [_tried(session, row.id, model) for model in sorted(CAMERA_MODELS) if model != row.document["camera_model"]]


def _tried(session: Session, set_id: int, model: str) -> Converted:
    try:
        return Converted(model, conversion_of(session, set_id, model), None)
    except RefusedInputError as error:
        return Converted(model, None, str(error))
