"""How long log-ins last; without the store, for the settings are read by commands that need none."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from boresight.store.times import utc_after, utc_text


@dataclass(frozen=True)
class SessionLimits:
    """How long log-ins last.

    Parameters
    ----------
    age_s
        After which one ends, however much it is used.
    idle_s
        After which one ends that is not used; 0 = it does not.
    """

    age_s: float
    idle_s: float

    def is_idle(self, last_used_utc: str) -> bool:
        """Whether a log-in that was last used then has ended."""
        return bool(self.idle_s) and last_used_utc < utc_after(-self.idle_s)

    def ends_utc(self, created_utc: str) -> str:
        """Return when a log-in that was made then ends at the latest."""
        return utc_text(datetime.fromisoformat(created_utc) + timedelta(seconds=self.age_s))
