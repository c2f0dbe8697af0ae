"""Numbers, times and addresses as the pages print them. Each function is a template filter of the same name.

A value crosses the border here: inside it is SI and radians, on the page it has the unit an operator thinks in, of
`boresight.figures.quantities`. Numbers by themselves are those of `boresight.figures.numbers`.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from markupsafe import Markup, escape

from boresight.figures.numbers import (
    MISSING,
    NARROW_SPACE,
    count,
    fixed,
    grouped,
    is_number,
    number,
    percent,
    to_second_digit,
    urad,
    with_reach,
)
from boresight.figures.quantities import quantity


def unit(name: str) -> str:
    """Return the unit a parameter is shown in: `f_m` gives mm."""
    return quantity(name).unit or "1"


def symbol(name: str) -> Markup:
    """Return a parameter's letter in the papers, its index set low; a name without one stands for itself."""
    letter, index = quantity(name).letters
    return Markup("{}<sub>{}</sub>").format(letter, index) if index else Markup("{}").format(letter)


def parameter(value: Any, name: str, sigma: Any = None) -> str:
    """Print a parameter in its page unit, to the second significant digit of its sigma; as given where none is known."""
    if not is_number(value):
        return MISSING
    factor = quantity(name).factor
    if not is_number(sigma) or sigma <= 0:
        return grouped(f"{value * factor:.6g}")
    return grouped(to_second_digit(value * factor, sigma * factor))


def sigma(value: Any, name: str) -> str:
    """Print a sigma in its parameter's page unit, two significant digits; `fixed` where it was not estimated."""
    return parameter(value, name, value) if is_number(value) and value > 0 else "fixed"


def plus_minus(value: Any, name: str, sigma_si: Any = None, times: float = 1.0) -> str:
    """Print `value ± times sigma` in the page unit, without the unit (its column has it)."""
    if not is_number(sigma_si) or sigma_si <= 0:
        return parameter(value, name)
    if not is_number(value):
        return MISSING
    factor = quantity(name).factor
    return with_reach(value * factor, times * sigma_si * factor, sigma_si * factor)


def sigmas(value: Any) -> str:
    """Print a difference in units of its sigma, signed."""
    return f"{'+' if value >= 0.05 else ''}{fixed(value, 1)}{NARROW_SPACE}σ" if is_number(value) else MISSING


def size(value_bytes: Any) -> str:
    """Print a file's size in decimal units."""
    if not is_number(value_bytes):
        return MISSING
    for factor, name in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if value_bytes >= factor:
            return f"{value_bytes / factor:.1f}{NARROW_SPACE}{name}"
    return f"{int(value_bytes)}{NARROW_SPACE}B"


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


def duration(seconds: Any) -> str:
    """Print a span of time with its two largest units: `3 d 4 h`."""
    if not is_number(seconds):
        return MISSING
    if 0 < seconds < 0.1:
        return f"{fixed(1000 * seconds, 0 if seconds >= 0.01 else 1)}{NARROW_SPACE}ms"
    if seconds < 10:
        return f"{max(seconds, 0):.1f}{NARROW_SPACE}s"
    whole = round(seconds)
    parts = [
        (amount, name)
        for amount, name in (
            (whole // 86400, "d"),
            (whole // 3600 % 24, "h"),
            (whole // 60 % 60, "min"),
            (whole % 60, "s"),
        )
        if amount
    ]
    return " ".join(f"{amount}{NARROW_SPACE}{name}" for amount, name in parts[:2])


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
    """Print a machine's word as a person's: `rank_deficient` as `rank deficient`."""
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
