"""Which backups are kept: of each of the newest days, weeks and months that have one the newest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime


@dataclass(frozen=True)
class Generations:
    """How many days, weeks and months keep a backup."""

    daily: int = 7
    weekly: int = 5
    monthly: int = 12


def choose_kept(taken_utc: Sequence[str], kept: Generations) -> set[str]:
    """Return the times of the backups to keep among those that were taken; the newest is always one."""
    newest_first = sorted(taken_utc, reverse=True)
    chosen = set(newest_first[:1])
    for spelling, count in (("%Y-%j", kept.daily), ("%G-%V", kept.weekly), ("%Y-%m", kept.monthly)):
        of_period: dict[str, str] = {}
        for one in newest_first:
            of_period.setdefault(datetime.fromisoformat(one).strftime(spelling), one)
        chosen |= set(list(of_period.values())[:count])
    return chosen
