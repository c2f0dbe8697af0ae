"""The parameter table in words and digits, as the report and the terminal print it."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from decimal import Decimal

from boresight.figures.chart import Result
from boresight.figures.parameter_table import ParameterRow, parameter_rows
from boresight.verdicts.numbers import MINUS, MISSING, to_second_digit
from boresight.verdicts.quantities import Quantity, quantity

LARGE = 1e5  # the width of a terminal's column
HEADINGS = ("parameter", "unit", "initial", "final", "change", "sigma", "unit", "change / sigma", "typical sigmas")


@dataclass(frozen=True)
class PrintedRow:
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


def printed_rows(result: Result) -> list[PrintedRow]:
    """Print every parameter of a result, in model order."""
    return [_printed(row, quantity(row.name, result)) for row in parameter_rows(result)]


def _printed(row: ParameterRow, item: Quantity) -> PrintedRow:
    known, change_sigma = _scaled(row.sigma, item.factor), _scaled(row.sigma, item.change_factor)
    return PrintedRow(
        symbol=item.symbol,
        unit=item.unit,
        initial=digits(_scaled(row.old, item.factor), known),
        final=digits(_scaled(row.new, item.factor), known),
        change=_changed(_scaled(row.delta, item.change_factor), change_sigma),
        sigma=digits(change_sigma, change_sigma),
        change_unit=item.change_unit,
        worth=_signed(row.delta_over_sigma),
        typical=_signed(row.delta_over_typical) if row.estimated else MISSING,
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


def _signed(value: float | None) -> str:
    return MISSING if value is None else f"{value:+,.1f}".replace("-", MINUS)
