"""The parameter table in words and digits, as the report and the terminal print it."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from decimal import Decimal

from boresight.figures.chart import Result
from boresight.figures.numbers import MINUS, MISSING, to_second_digit
from boresight.figures.quantities import quantity

LARGE = 1e5  # the width of a terminal's column
HEADINGS = ("parameter", "unit", "initial", "final", "change", "sigma", "unit", "change / sigma", "typical sigmas")


@dataclass(frozen=True)
class ParameterRow:
    """One parameter, ready to print; the first unit is of the values, the second of change and sigma."""

    symbol: str
    unit: str
    initial: str
    final: str
    change: str
    sigma: str
    change_unit: str
    worth: str
    typical: str

    @property
    def cells(self) -> tuple[str, ...]:
        """The row under `HEADINGS`."""
        return astuple(self)


def parameter_rows(result: Result) -> list[ParameterRow]:
    """Lay out every parameter of a result, in model order."""
    return [_row(result, name) for name in result.get("parameters") or ()]


def _row(result: Result, name: str) -> ParameterRow:
    item = quantity(name, result)
    initial, final, sigma, typical = (
        (result.get(key) or {}).get(name) for key in ("initial", "parameters", "sigma", "typical_sigma")
    )
    change = None if initial is None or final is None else final - initial
    known = _scaled(sigma, item.factor)
    return ParameterRow(
        symbol=item.symbol,
        unit=item.unit,
        initial=digits(_scaled(initial, item.factor), known),
        final=digits(_scaled(final, item.factor), known),
        change=_changed(_scaled(change, item.change_factor), _scaled(sigma, item.change_factor)),
        sigma=digits(_scaled(sigma, item.change_factor), _scaled(sigma, item.change_factor)),
        change_unit=item.change_unit,
        worth=_ratio(change, sigma),
        typical=_ratio(change, typical) if sigma is not None else MISSING,
    )


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def digits(value: float | None, sigma: float | None) -> str:
    """Print a value to the second significant digit of its sigma; six significant digits where there is none."""
    if value is None:
        return MISSING
    if not sigma or not math.isfinite(sigma):
        return f"{value:.6g}".replace("-", MINUS)
    text = to_second_digit(value, sigma, LARGE)
    return (text if "e" in text else f"{Decimal(text):,}").replace("-", MINUS)


def _changed(change: float | None, sigma: float | None) -> str:
    text = digits(change, sigma)
    return text if change is None or change < 0 or sigma is None else f"+{text}"


def _ratio(value: float | None, scale: float | None) -> str:
    return MISSING if value is None or not scale else f"{value / scale:+,.1f}".replace("-", MINUS)
