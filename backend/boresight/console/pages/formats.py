"""Times, hashes and state words as the pages print them, each state with its level of the Astro UX status system.

Red is kept for what needs a person now, so a cancelled run or a refused request is never red.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import UTC, datetime

from jinja2 import pass_context
from jinja2.runtime import Context
from markupsafe import Markup, escape

from boresight.platform.db.times import STYLE, TimeStyle
from boresight.verdicts.numbers import (
    MISSING,
    QUANTITIES,
    count,
    duration,
    find_tag_before,
    fixed,
    is_told,
    number,
    parameter,
    percent,
    plus_minus,
    power,
    quantity,
    set_symbols,
    sigma,
    sigmas,
    size,
    unit,
    urad,
    urad_interval,
)
from boresight.verdicts.trend import SHOWN_AS
from boresight.verdicts.verdict import LEVEL_OF_STATUS, LEVELS


def symbol(name: str) -> Markup:
    """Return a parameter's letter in the papers with its index as a subscript; its name where it has none."""
    letter, index = quantity(name).letters
    return Markup("{}<sub>{}</sub>").format(letter, index) if index else Markup("{}").format(letter)


#: Those that are no word of a sentence: the skew's s also stands for seconds.
IN_SENTENCES = [name for name in QUANTITIES if quantity(name).letters[1] or quantity(name).symbol == "f"]


def symbols(sentence: str) -> Markup:
    """Set the parameters' symbols in a sentence as the figure beside it has them."""
    return Markup(set_symbols(str(escape(sentence)), IN_SENTENCES))  # noqa: S704 - escaped here


def instant(text: str) -> datetime:
    """Read a stored time, `2026-11-21T03:04:05.123456Z`."""
    return datetime.fromisoformat(text).astimezone(UTC)


def _style(context: Context) -> TimeStyle:
    """Return how the person whom a page is for has times shown."""
    frame = context.get("frame")
    return STYLE if frame is None else frame.times


def time_element(text: str | None, style: TimeStyle) -> Markup | str:
    """Print a stored time in a person's form; in the tooltip the calendar date, or the day of year where the calendar is shown."""
    if not text:
        return MISSING
    moment, other = instant(text), TimeStyle("iso") if style.form == "day_of_year" else STYLE
    return Markup('<time datetime="{}" title="{}">{}</time>').format(text, other.show(moment), style.show(moment))


@pass_context
def utc(context: Context, text: str | None) -> Markup | str:
    """Print a stored time in the form that the reader chose."""
    return time_element(text, _style(context))


STORED_TIME = re.compile(r"\d(?<!\w\d)\d{3}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d+)?Z")


def show_times(page: str, style: TimeStyle) -> str:
    """Print every stored time in texts, tooltips and labels of a page in a person's form; fields and quoted documents keep it."""

    def show(found: re.Match[str]) -> str:
        return _show(found[0], style) if is_told(find_tag_before(page, found)) else found[0]

    return STORED_TIME.sub(show, page)


@pass_context
def as_typed(context: Context, text: str) -> str:
    """Print a stored time as the reader would type it, for the field of a form."""
    return STORED_TIME.sub(lambda one: _show(one[0], _style(context)), text)


def _show(text: str, style: TimeStyle) -> str:
    """Print a time in a form; what only looks like one, as people may write it, stays as it is."""
    try:
        return style.show(instant(text))
    except (ValueError, OverflowError):
        return text


def seconds_since(text: str | None, now: datetime | None = None) -> float | None:
    """Return the seconds from a stored time to now, or None when there is no time."""
    return ((now or datetime.now(UTC)) - instant(text)).total_seconds() if text else None


@pass_context
def age(context: Context, text: str | None) -> Markup | str:
    """Print how long ago a stored time was: `3 h 20 min ago`, the time itself in its tooltip."""
    seconds = seconds_since(text)
    if seconds is None or not text:
        return MISSING
    words = "just now" if seconds < 10 else f"{duration(seconds)} ago"
    shown = _style(context).show(instant(text))
    return Markup('<time class="age" datetime="{}" title="{}">{}</time>').format(text, shown, words)


def short_hash(text: str | None) -> Markup | str:
    """Print the first eight digits of a hash; the whole of it in the tooltip and for copying."""
    if not text:
        return MISSING
    return Markup('<code class="hash" title="{0}" data-copy="{0}">{1}</code>').format(text, text[:8])


def sensor_word(level: str) -> str:
    """Print the level of a sensor as a word; `off` is a sensor that no telemetry has come of."""
    return "NO TELEMETRY" if level == "off" else level.upper()


def words(text: str) -> str:
    """Print an identifier as words: `rank_deficient` as `rank deficient`."""
    return str(escape(SHOWN_AS.get(text, text))).replace("_", " ")


FILTERS = (
    unit,
    symbol,
    symbols,
    number,
    fixed,
    count,
    percent,
    parameter,
    power,
    sigma,
    plus_minus,
    urad,
    urad_interval,
    sigmas,
    size,
    utc,
    as_typed,
    duration,
    seconds_since,
    age,
    short_hash,
    sensor_word,
    words,
)


__all__ = ["LEVELS", "LEVEL_OF_STATE", "get_level", "worst"]

LEVEL_OF_STATE = {
    # runs
    "QUEUED": "standby",
    "RUNNING": "standby",
    "TESTING": "standby",
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
    # ingest policies and decisions
    "DRAFT": "standby",
    "PAUSED": "serious",
    "OFF": "off",
    "CALIBRATING": "standby",
    "WITHIN FORECAST": "normal",
    "UNCONFIRMED": "standby",
    "ASKED": "caution",
    "ANSWERED": "normal",
    "NOT JUDGED": "serious",
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
