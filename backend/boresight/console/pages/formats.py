"""Times, hashes and state words as the pages print them, each state with its level of the Astro UX status system.

Red is kept for what needs a person now, so a cancelled run or a refused request is never red.
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime

from markupsafe import Markup, escape

from boresight.verdicts.numbers import (
    MISSING,
    count,
    duration,
    fixed,
    number,
    parameter,
    percent,
    plus_minus,
    quantity,
    sigma,
    sigmas,
    size,
    unit,
    urad,
)
from boresight.verdicts.verdict import LEVEL_OF_STATUS, LEVELS


def symbol(name: str) -> Markup:
    """Return a parameter's letter in the papers, its index set low; a name without one stands for itself."""
    letter, index = quantity(name).letters
    return Markup("{}<sub>{}</sub>").format(letter, index) if index else Markup("{}").format(letter)


def instant(text: str) -> datetime:
    """Read a stored time, `2026-11-21T03:04:05.123456Z`."""
    return datetime.fromisoformat(text).astimezone(UTC)


def day_of_year(moment: datetime) -> str:
    """Print a time as an operator reads it, year and day of year: `2026-325 03:04:11Z`."""
    return f"{moment:%Y-%j %H:%M:%S}Z"


def utc(text: str | None) -> Markup | str:
    """Print a stored time with its day of year; the calendar date in its tooltip."""
    if not text:
        return MISSING
    moment = instant(text)
    calendar = f"{moment:%Y-%m-%d %H:%M:%S} UTC"
    return Markup('<time datetime="{}" title="{}">{}</time>').format(text, calendar, day_of_year(moment))


def seconds_since(text: str | None, now: datetime | None = None) -> float | None:
    """Return the seconds from a stored time to now, or None when there is no time."""
    return ((now or datetime.now(UTC)) - instant(text)).total_seconds() if text else None


def age(text: str | None) -> Markup | str:
    """Print how long ago a stored time was: `3 h 20 min ago`, the time itself in its tooltip."""
    seconds = seconds_since(text)
    if seconds is None or not text:
        return MISSING
    words = "just now" if seconds < 10 else f"{duration(seconds)} ago"
    return Markup('<time class="age" datetime="{}" title="{} UTC">{}</time>').format(text, text[:19], words)


def short_hash(text: str | None) -> Markup | str:
    """Print the first eight digits of a hash; the whole of it in the tooltip and for copying."""
    if not text:
        return MISSING
    return Markup('<code class="hash" title="{0}" data-copy="{0}">{1}</code>').format(text, text[:8])


def words(text: str) -> str:
    """Print an identifier as words: `rank_deficient` as `rank deficient`."""
    return str(escape(text)).replace("_", " ")


FILTERS = (
    unit,
    symbol,
    number,
    fixed,
    count,
    percent,
    parameter,
    sigma,
    plus_minus,
    urad,
    sigmas,
    size,
    utc,
    duration,
    seconds_since,
    age,
    short_hash,
    words,
)


__all__ = ["LEVELS", "LEVEL_OF_STATE", "get_level", "worst"]

LEVEL_OF_STATE = {
    # runs
    "QUEUED": "standby",
    "RUNNING": "standby",
    "CANCELLING": "caution",
    "SUCCEEDED": "normal",
    "FAILED": "serious",
    "CANCELLED": "off",
    "LOST": "serious",
    # parameter sets on the ground
    "CANDIDATE": "standby",
    "SUBMITTED": "standby",
    "APPROVED": "normal",
    "BASELINE": "normal",
    "SUPERSEDED": "off",
    "REJECTED": "off",
    "WITHDRAWN": "off",
    "CONFIRMED": "normal",
    "REFUSED": "serious",
    "EXPIRED": "serious",
    # parameter sets on board
    "NOT SENT": "off",
    "SENT": "standby",
    "LOADED": "standby",
    "VERIFIED": "normal",
    "ACTIVE": "normal",
    "MISMATCH": "critical",
    "UNKNOWN": "off",
    # approvals and signatures
    "OPEN": "standby",
    "STALE": "caution",
    "APPROVE": "normal",
    "REFUSE": "caution",
    # gates
    "PASS": "normal",
    "MARGINAL": "caution",
    "FAIL": "serious",
    "NO-DATA": "caution",
}


def get_level(state: str) -> str:
    """Return the level of a state word; a level is returned in lower case, and an unknown word is `off`."""
    return state.lower() if state.lower() in LEVELS else (LEVEL_OF_STATE | LEVEL_OF_STATUS).get(state, "off")


def worst(states: Iterable[str]) -> str:
    """Return the worst level of several state words; `off` when there are none."""
    return max((get_level(state) for state in states), key=LEVELS.index, default="off")
