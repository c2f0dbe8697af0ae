"""The choice of a camera as the library returns it; by itself, because it loads the cameras, which no other answer needs."""

from __future__ import annotations

from dataclasses import dataclass, fields

from boresight.calibration.choice import result
from boresight.library.results import Summarised
from boresight.library.text import Summary, summarise_choice


@dataclass(frozen=True, kw_only=True, repr=False)
class Choice(Summarised, result.Choice):
    """The least camera model that suffices: `sentence`, `chosen`, every candidate in `models`, and the tests between them."""

    @classmethod
    def of(cls, found: result.Choice) -> Choice:
        """Give a choice its face."""
        return cls(**{item.name: getattr(found, item.name) for item in fields(found)})

    def _summarise(self) -> Summary:
        return summarise_choice(self)
