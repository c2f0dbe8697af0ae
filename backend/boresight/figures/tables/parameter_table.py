"""A calibration's parameters as pages, reports and terminals lay them out: old, new, delta, sigma, and what delta is worth.

`delta / sigma` says whether the change can be seen in the noise, `delta / typical` whether it is a change that such a
sensor is known to make (the typical sigmas are the unit-to-unit spread). Both are needed: a change of forty sigma that is
three typical sigmas large is a real and ordinary one; one of forty sigma and ninety typical sigmas is not.

The parameter table in words and digits, as the report and the terminal print it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from decimal import Decimal
from typing import Any

from boresight.cameras import CAMERA_MODELS
from boresight.figures.chart import Result
from boresight.verdicts.numbers import MINUS, MISSING, to_second_digit
from boresight.verdicts.quantities import Quantity, quantity

# The six sensors of E Table III moved by up to 9.8: more asks for a look at the matches.
UNEXPECTED_TYPICAL_SIGMAS = 10.0
FAR_SIGMAS = 4.0  # of the eight parameters of an honest run one in 2,000 is so far from the truth


@dataclass(frozen=True)
class ParameterRow:
    """One parameter of a result; values are SI, None where nothing was estimated.

    `old`, `new`, `delta`, `sigma`: In the parameter's SI unit.
    """

    name: str
    old: float | None
    new: float | None
    delta: float | None
    sigma: float | None
    typical_sigma: float | None
    truth: float | None

    @property
    def estimated(self) -> bool:
        """Tell whether this run estimated the parameter."""
        return self.sigma is not None

    @property
    def delta_over_sigma(self) -> float | None:
        """Return the change in sigmas."""
        return _ratio(self.delta, self.sigma)

    @property
    def delta_over_typical(self) -> float | None:
        """Return the change in unit-to-unit sigmas."""
        return _ratio(self.delta, self.typical_sigma)

    @property
    def error_over_sigma(self) -> float | None:
        """Return how many sigmas the estimate is off the truth."""
        return _ratio(_difference(self.new, self.truth), self.sigma)

    @property
    def off_truth(self) -> bool:
        """Tell whether the estimate is farther from the truth than its sigma allows."""
        off = self.error_over_sigma
        return off is not None and abs(off) > FAR_SIGMAS

    @property
    def unexpected(self) -> bool:
        """Tell whether the change is larger than such sensors are known to make."""
        worth = self.delta_over_typical
        return worth is not None and abs(worth) > UNEXPECTED_TYPICAL_SIGMAS


def _difference(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a - b


def _ratio(value: float | None, scale: float | None) -> float | None:
    return None if value is None or not scale else value / scale


def parameter_rows(result: Mapping[str, Any]) -> list[ParameterRow]:
    """Lay out every parameter of a calibration JSON, in model order."""
    old, new, sigma = (result.get(key) or {} for key in ("initial", "parameters", "sigma"))
    model = CAMERA_MODELS.get(str(result.get("camera_model")))
    typical, truth = (result.get(key) or {} for key in ("typical_sigma", "truth"))
    return [
        ParameterRow(
            name=name,
            old=old.get(name),
            new=new[name],
            delta=_difference(new[name], old.get(name)),
            sigma=sigma.get(name),
            typical_sigma=typical.get(name),
            truth=truth.get(name),
        )
        for name in (model.parameter_names if model else new)
        if name in new
    ]


def set_rows(
    document: Mapping[str, Any], incumbent: Mapping[str, Any] | None, sensor: Mapping[str, Any]
) -> list[ParameterRow]:
    """Lay out a parameter set's values against the set it replaces, on the scale of its sensor's typical sigmas."""
    old = (incumbent or {}).get("parameters") or {}
    return parameter_rows({**document, "initial": old, "typical_sigma": sensor.get("typical_sigma")})


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
