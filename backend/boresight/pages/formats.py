"""Numbers, times and addresses as the pages print them. Each function is a template filter of the same name.

A value crosses the border here: inside it is SI and radians, on the page it has the unit an operator thinks in.
A parameter's unit is read from the end of its name, `f_m` to mm and `b2_per_m2` to m⁻², in one table. A value
printed with its sigma stops at the second significant digit of the sigma: no digit is shown that is not known.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

from markupsafe import Markup, escape

MISSING = "–"
NARROW_SPACE = "\u202f"  # narrow, and no line breaks in it
MINUS = "\u2212"  # as wide as a digit
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
LARGE = 1e7  # from here on a number is easier to read with a power of ten

UNIT_OF_SUFFIX = (  # suffix, unit on the page, factor from SI
    ("_per_m4", "m⁻⁴", 1.0),
    ("_per_m2", "m⁻²", 1.0),
    ("_arcsec", "″", 1.0),
    ("_px", "px", 1.0),
    ("_rad", "mrad", 1e3),
    ("_m", "mm", 1e3),
    ("k1", "m⁻²", 1.0),
    ("k2", "m⁻⁴", 1.0),
)

SYMBOL_OF_PARAMETER = {
    "f_m": "f",
    "m0_px": "m_0",
    "n0_px": "n_0",
    "b4_per_m4": "b_4",
    "b2_per_m2": "b_2",
    "a1_rad": "a_1",
    "a2_rad": "a_2",
    "g_y": "g_y",
    "u0_px": "u_0",
    "v0_px": "v_0",
    "k1": "k_1",
    "k2": "k_2",
}


def _scale(name: str) -> tuple[str, float]:
    """Return the page's unit and the factor from SI for a parameter's name."""
    return next(((unit, factor) for suffix, unit, factor in UNIT_OF_SUFFIX if name.endswith(suffix)), ("1", 1.0))


def unit(name: str) -> str:
    """Return the unit a parameter is shown in: `f_m` gives mm."""
    return _scale(name)[0]


def symbol(name: str) -> Markup:
    """Return a parameter's letter in the papers, its index set low; a name without one stands for itself."""
    letter, _, index = SYMBOL_OF_PARAMETER.get(name, name).partition("_")
    low = Markup("<sub>{}</sub>").format(index) if index and len(letter) == 1 else ""
    return Markup("{}{}").format(letter if low else SYMBOL_OF_PARAMETER.get(name, name), low)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _grouped(text: str) -> str:
    """Write the sign as a true minus, part the digits before the point in threes, and raise the exponent; 0 has no sign."""
    sign, digits = (MINUS, text[1:]) if text.startswith("-") else ("", text)
    mantissa, _, exponent = digits.partition("e")
    sign = sign if mantissa.strip("0.") else ""
    whole, point, rest = mantissa.partition(".")
    if whole.isdigit() and len(whole) > 4:
        whole = f"{int(whole):,}".replace(",", NARROW_SPACE)
    power = f"·10{str(int(exponent)).translate(RAISED)}" if exponent else ""
    return f"{sign}{whole}{point}{rest}{power}"


def number(value: Any, digits: int = 4) -> str:
    """Print a number to so many significant digits; a missing or non-finite one as a dash."""
    if not _is_number(value):
        return MISSING
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 7:
        return _grouped(f"{value:.{max(digits - 1 - exponent, 0)}f}")
    return _grouped(f"{value:.{digits - 1}e}")


def fixed(value: Any, decimals: int = 2) -> str:
    """Print a number to so many decimals, for columns that align on the point."""
    return _grouped(f"{value:.{decimals}f}") if _is_number(value) else MISSING


def count(value: Any) -> str:
    """Print a whole number with its digits parted in threes."""
    return f"{int(value):,}".replace(",", NARROW_SPACE) if _is_number(value) else MISSING


def percent(value: Any, decimals: int = 1) -> str:
    """Print a fraction as a percentage."""
    return f"{fixed(100.0 * value, decimals)}{NARROW_SPACE}%" if _is_number(value) else MISSING


def parameter(value: Any, name: str, sigma: Any = None) -> str:
    """Print a parameter in its page unit, to the second significant digit of its sigma; as given where none is known."""
    if not _is_number(value):
        return MISSING
    shown = value * _scale(name)[1]
    if not _is_number(sigma) or sigma <= 0:
        return _grouped(f"{shown:.6g}")
    decimals = 1 - math.floor(math.log10(sigma * _scale(name)[1]))
    shown = round(shown, decimals)
    if abs(shown) < LARGE:
        return _grouped(f"{shown:.{max(decimals, 0)}f}")
    return _grouped(f"{shown:.{max(math.floor(math.log10(abs(shown))) + decimals, 0)}e}")


def sigma(value: Any, name: str) -> str:
    """Print a sigma in its parameter's page unit, two significant digits; `fixed` where it was not estimated."""
    return parameter(value, name, value) if _is_number(value) and value > 0 else "fixed"


def plus_minus(value: Any, name: str, sigma_si: Any = None, times: float = 1.0) -> str:
    """Print `value ± times sigma` in the page unit, without the unit (its column has it)."""
    if not _is_number(sigma_si) or sigma_si <= 0:
        return parameter(value, name)
    return f"{parameter(value, name, sigma_si)} ± {parameter(times * sigma_si, name, sigma_si)}"


def urad(value_rad: Any, digits: int = 4) -> str:
    """Print an angle in radians as microradians, without the unit (its column has it)."""
    return number(value_rad * 1e6, digits) if _is_number(value_rad) else MISSING


def sigmas(value: Any) -> str:
    """Print a difference in units of its sigma, signed."""
    return f"{'+' if value > 0 else ''}{fixed(value, 1)}{NARROW_SPACE}σ" if _is_number(value) else MISSING


def size(value_bytes: Any) -> str:
    """Print a file's size in decimal units."""
    if not _is_number(value_bytes):
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
    if not _is_number(seconds):
        return MISSING
    if 0 < seconds < 0.1:
        return f"{1000 * seconds:.1f}{NARROW_SPACE}ms"
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
