"""Numbers and camera parameters as people read them, on pages, in reports and in terminals."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from boresight.calibration.calibration import Calibration
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import Parameter


@dataclass(frozen=True)
class Quantity:
    """One parameter for display; display value = SI value x factor."""

    symbol: str
    unit: str
    factor: float

    @property
    def letters(self) -> tuple[str, str]:
        """The letter and its index; a symbol that is a word has no index."""
        found = re.fullmatch(r"(\w)(\d+|_\w+)", self.symbol)
        return (found[1], found[2].lstrip("_")) if found else (self.symbol, "")

    @property
    def markup(self) -> str:
        """The symbol with its index set low, in the few tags Plotly knows."""
        letter, index = self.letters
        return f"<i>{letter}</i><sub>{index}</sub>" if index else f"<i>{letter}</i>"


def _make_quantity(parameter: Parameter) -> Quantity:
    own = (parameter.written_unit, 1.0)
    return Quantity(parameter.symbol, *(parameter.shown or own))


QUANTITIES = {
    name: _make_quantity(one)
    for camera in CAMERA_MODELS.values()
    for name, one in zip(camera.parameter_names, camera.parameters, strict=True)
}


def quantity(name: str, result: Calibration | None = None) -> Quantity:
    """Look a parameter up by its name, one that is not in the table in its result."""
    if name in QUANTITIES:
        return QUANTITIES[name]
    symbols, units = (result.symbols, result.units) if result else ({}, {})
    symbol = re.sub(r"[^\w]", "", symbols.get(name) or name)
    unit = re.sub(r"[<>&]|^1$", "", units.get(name) or "")
    return Quantity(symbol, unit, 1.0)


def scale_to(item: Quantity, *values: float | None) -> Quantity:
    """Put the power of ten of SI values into the unit, where they are large, so that axis and labels need none."""
    power = find_power(*(value * item.factor for value in values if value is not None))
    if not power:
        return item
    return replace(item, factor=item.factor / 10.0**power, unit=f"10{str(power).translate(RAISED)} {item.unit}".strip())


def change_label(item: Quantity) -> str:
    """Axis label of a change, such as `Δf (mm)`."""
    return f"Δ{item.markup} ({item.unit})" if item.unit else f"Δ{item.markup}"


MISSING = "–"
NARROW_SPACE = "\u202f"  # narrow, and no line breaks in it
MINUS = "\u2212"  # as wide as a digit
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
LARGE, SMALL = 1e7, 1e-4  # beyond these a number is easier to read with a power of ten


def is_number(value: Any) -> bool:
    """Tell whether a value is a finite number; a truth value is none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def grouped(text: str) -> str:
    """Write the sign as a true minus, part the digits before the point in threes, and raise the exponent; 0 has neither."""
    sign, digits = (MINUS, text[1:]) if text.startswith("-") else ("", text)
    mantissa, _, exponent = digits.partition("e")
    whole, point, rest = mantissa.partition(".")
    if whole.isdigit() and len(whole) > 3:
        whole = f"{int(whole):,}".replace(",", NARROW_SPACE)
    is_zero = not mantissa.strip("0.")
    power = f"·10{str(int(exponent)).translate(RAISED)}" if exponent and not is_zero else ""
    return f"{'' if is_zero else sign}{whole}{point}{rest}{power}"


def number(value: Any, digits: int = 4) -> str:
    """Print a number to so many significant digits; a missing or non-finite one as a dash."""
    if not is_number(value):
        return MISSING
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 7:
        return grouped(f"{value:.{max(digits - 1 - exponent, 0)}f}")
    return grouped(f"{value:.{digits - 1}e}")


def signed(value: Any, digits: int = 3) -> str:
    """Print a change: its sign always, to so many significant digits."""
    return f"{'+' if is_number(value) and value > 0 else ''}{number(value, digits)}"


def fixed(value: Any, decimals: int = 2) -> str:
    """Print a number to so many decimals, for columns that align on the point."""
    return grouped(f"{value:.{decimals}f}") if is_number(value) else MISSING


def count(value: Any) -> str:
    """Print a whole number with its digits parted in threes."""
    return grouped(str(int(value))) if is_number(value) else MISSING


def percent(value: Any, decimals: int = 1) -> str:
    """Print a fraction as a percentage."""
    return f"{fixed(100.0 * value, decimals)}{NARROW_SPACE}%" if is_number(value) else MISSING


def urad(value_rad: Any, digits: int = 4) -> str:
    """Print an angle in radians as microradians, without the unit (its column has it)."""
    return number(value_rad * 1e6, digits) if is_number(value_rad) else MISSING


def urad_between(value_rad: Any, ends_rad: Sequence[float] | None, digits: int = 3) -> str:
    """Print an angle in microradians with its 95 % interval in brackets, without the unit."""
    return f"{urad(value_rad, digits)} {urad_interval(ends_rad, digits)}".rstrip()


def urad_interval(ends_rad: Sequence[float] | None, digits: int = 3) -> str:
    """Print an interval in microradians in brackets, without the unit; nothing where it is not known."""
    return "" if ends_rad is None else f"({' to '.join(urad(end, digits) for end in ends_rad)})"


def to_second_digit(value: float, sigma: float, large: float = LARGE, power: int | None = None) -> str:
    """Write a number to the second significant digit of its sigma, in Python's own form; from `large` on with a power.

    `power`: that of the row, see `find_power`; the number's own where None.
    """
    decimals = 1 - math.floor(math.log10(sigma))
    rounded = round(value, decimals) + 0.0  # a zero without a sign
    if power is None:
        power = find_power(rounded, large=large)
    if not power:
        return f"{rounded:.{max(decimals, 0)}f}"
    return f"{rounded / 10**power:.{max(power + decimals, 0)}f}e{power}"


def find_power(*values: float | None, large: float = LARGE) -> int:
    """Return the power of ten that numbers of one row share: that of the greatest, 0 where it is below `large`."""
    greatest = max((abs(value) for value in values if value is not None and math.isfinite(value)), default=0.0)
    return math.floor(math.log10(greatest)) if greatest >= large else 0


def _small_power(*values: float) -> int:
    """Return the power of ten of the greatest of numbers that are all too small to be read with their zeros; else 0."""
    greatest = max(map(abs, values))
    return math.floor(math.log10(greatest)) if 0 < greatest < SMALL else 0


def with_reach(value: float, reach: float, sigma: float, large: float = LARGE, power: int | None = None) -> str:
    """Print `value ± reach`, both to the second digit of a sigma; with one power of ten where either is large or both are small.

    `power`: that of the row; their own where None.
    """
    if power is None:
        power = find_power(value, reach, large=large) or _small_power(value, reach)
    if not power:
        return " ± ".join(grouped(to_second_digit(one, sigma, power=0)) for one in (value, reach))
    decimals = max(power + 1 - math.floor(math.log10(sigma)), 0)
    texts = (grouped(f"{one / 10**power:.{decimals}f}") for one in (value, reach))
    return f"({' ± '.join(texts)})·10{str(power).translate(RAISED)}"


def unit(name: str) -> str:
    """Return the unit a parameter is shown in: `f_m` gives mm, a pure number none."""
    return quantity(name).unit


def power(name: str, *values: float | None) -> int:
    """Return the power of ten that a parameter's numbers share in a row, in its page unit."""
    factor = quantity(name).factor
    return find_power(*(value * factor for value in values if value is not None))


def parameter(value: Any, name: str, sigma: Any = None, power: int | None = None) -> str:
    """Print a parameter in its page unit, to the second significant digit of its sigma; as given where none is known.

    `power`: that of the row; the number's own where None.
    """
    if not is_number(value):
        return MISSING
    factor = quantity(name).factor
    if is_number(sigma) and sigma > 0:
        return grouped(to_second_digit(value * factor, sigma * factor, power=power))
    if power:
        mantissa = f"{float(f'{value * factor:.6g}') / 10**power:.{power + 5}f}".rstrip("0").rstrip(".")
        return grouped(f"{mantissa}e{power}")
    return grouped(f"{value * factor:.6g}")


def sigma(value: Any, name: str, power: int | None = None) -> str:
    """Print a sigma in its parameter's page unit, two significant digits; `fixed` where it was not estimated."""
    return parameter(value, name, value, power) if is_number(value) and value > 0 else "fixed"


def plus_minus(value: Any, name: str, sigma_si: Any = None, times: float = 1.0, power: int | None = None) -> str:
    """Print `value ± times sigma` in the page unit, without the unit (its column has it); `power`: that of the row."""
    if not is_number(sigma_si) or sigma_si <= 0:
        return parameter(value, name, power=power)
    if not is_number(value):
        return MISSING
    factor = quantity(name).factor
    return with_reach(value * factor, times * sigma_si * factor, sigma_si * factor, power=power)


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


AS_WRITTEN = ("<pre", "<textarea", "<script", "<code")  # what people copy, or send back
QUOTED = ("<q", "<bdi", "<blockquote", "<title")  # what people wrote
TOLD = (" title", " aria-label")  # attributes that are read out
#: A number as a terminal or a log has it: a hyphen for the sign, commas, a power of ten with an e, a % without a space, urad. Each
#: begins with one of few letters, which a page of many is searched for quickly.
PLAIN_NUMBER = re.compile(
    r"[-,%eu](?:(?<![\w.,/#‐-]-)(?<=-)(?=\.?\d)|(?<=\d,)(?=\d{3}(?:,\d{3})*(?![\d,]))|(?<=\d%)|(?<=\de)[+-]?\d{1,3}(?![\w-])"
    r"|(?<!\wu)(?<=u)rad(?!\w))"
)
#: What stands before a comma that parts thousands.
THOUSANDS = re.compile(r"(?:^|[^\w.,-])\d{1,3}(?:,\d{3})*$")
#: What stands before the e of a power of ten, and not before an e among the digits of a checksum.
MANTISSA = re.compile(r"(?:^|[^\w.,-]|(?<!\w)-)\d(?:\.\d+)?$")
MOST_DIGITS = 40
SCRIPT = re.compile(r"(<script\b.*?</script>)", re.DOTALL)


#: Stands within a page beside what would begin or part a number, where it is kept; no character of any text (Unicode says so).
KEEP = "\ufdd0"


class Typed(str):
    """A text that a person typed, whose numbers stay as they are on every page."""

    __slots__ = ()


def keep_typed(value: Any) -> Any:
    """Mark the numbers of a value that a template prints where a person typed it."""
    if not isinstance(value, Typed):
        return value
    return PLAIN_NUMBER.sub(lambda found: KEEP.join(("", *found[0], "")), value)


def find_tag_before(page: str, found: re.Match[str]) -> str:
    """Return what stands before a place in a page, from its last tag on: without a > the place is inside that tag."""
    return page[max(page.rfind("<", 0, found.start()), 0) : found.start()]


def is_told(tag: str, kept: tuple[str, ...] = AS_WRITTEN) -> bool:
    """Whether what follows a tag is read by people: text outside the elements that are kept, or a tooltip or label."""
    return not tag.startswith(kept) if ">" in tag else tag.rpartition('="')[0].endswith(TOLD)


def show_numbers(page: str) -> str:
    """Write the numbers in sentences, tooltips and labels of a page as its tables do; fields and what people wrote keep theirs.

    What is kept stands in an element of those that are, or was marked by `keep_typed`.
    """

    def show(found: re.Match[str]) -> str:
        return _typeset(page, found) if is_told(find_tag_before(page, found), (*AS_WRITTEN, *QUOTED)) else found[0]

    return PLAIN_NUMBER.sub(show, page).replace(KEEP, "")


def show_numbers_of_report(document: str) -> str:
    """Do the same in a document that has its scripts in itself, whose text may look like tags."""
    parts = SCRIPT.split(document)
    return "".join(part if place % 2 else show_numbers(part) for place, part in enumerate(parts))


def typeset(sentence: str) -> str:
    """Write the numbers in a sentence without tags as a table does."""
    return PLAIN_NUMBER.sub(partial(_typeset, sentence), sentence)


def _typeset(text: str, found: re.Match[str]) -> str:
    """Write what begins or parts a number as people read it."""
    sign = found[0]
    before = max(found.start() - MOST_DIGITS, 0), found.start()
    if sign == ",":
        return NARROW_SPACE if THOUSANDS.search(text, *before) else sign
    if sign == "-":
        return MINUS
    if sign == "%":
        return f"{NARROW_SPACE}%"
    if sign == "urad":
        return "µrad"
    return f"·10{str(int(sign[1:])).translate(RAISED)}" if MANTISSA.search(text, *before) else sign


def set_symbols(sentence: str, names: Iterable[str]) -> str:
    """Set the symbols of parameters in a sentence of a figure as its axes have them."""
    markup = {quantity(name).symbol: quantity(name).markup for name in names}
    words = "|".join(re.escape(symbol) for symbol in markup)
    return re.sub(rf"(?<![\w'])(?:{words})(?!\w)", lambda found: markup[found[0]], sentence) if markup else sentence
