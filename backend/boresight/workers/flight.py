"""A task in flight: which worker computes which attempts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from boresight.store.runs import Held


@dataclass
class Flight:
    """A task on one worker and the attempts it computes; the worker has as many flights at a time as threads."""

    future: Any
    worker: str
    members: set[Held]
    asked_s: dict[Held, float] = field(default_factory=dict)  # when each was asked to stop
    killed_s: float | None = None  # when its worker was ended by force
    gone_s: float | None = None  # when its worker was first missed
