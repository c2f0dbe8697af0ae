"""The sensors that a page's chooser offers: those of a link and of a form stay among them, whatever is sought."""

from __future__ import annotations

from collections.abc import Iterable

from boresight.api.numbers import row_number
from boresight.pages.tables import View
from boresight.services import sensors
from boresight.services.sensors import Choices
from boresight.store.sessions import Session


def choices_of(session: Session, view: View, *, find: str = "", keep: Iterable[int] = ()) -> Choices:
    """Return what the filter by sensor of a list offers, the one that the view is narrowed to among it."""
    narrowed = row_number(view.where.get("sensor", ""))
    return sensors.choices(session, find=find, keep=[*keep, *([narrowed] if narrowed else [])])
