"""How a camera parameter is written for people: symbol, unit of its value, unit of its changes.

Results are in SI. A focal length is read in millimetres, but its recalibration moves it by micrometres; an aspect
factor is one, and moves by parts per million. Names that are not in the table fall back to the result's own symbols
and units.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Quantity:
    """One parameter for display; display value = SI value x factor."""

    symbol: str
    unit: str
    factor: float
    change_unit: str
    change_factor: float

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


QUANTITIES = {
    "f_m": Quantity("f", "mm", 1e3, "µm", 1e6),
    "m0_px": Quantity("m0", "px", 1.0, "px", 1.0),
    "n0_px": Quantity("n0", "px", 1.0, "px", 1.0),
    "u0_px": Quantity("u0", "px", 1.0, "px", 1.0),
    "v0_px": Quantity("v0", "px", 1.0, "px", 1.0),
    "b4_per_m4": Quantity("b4", "m⁻⁴", 1.0, "m⁻⁴", 1.0),
    "b2_per_m2": Quantity("b2", "m⁻²", 1.0, "m⁻²", 1.0),
    "a1_rad": Quantity("a1", "mrad", 1e3, "mrad", 1e3),
    "a2_rad": Quantity("a2", "mrad", 1e3, "mrad", 1e3),
    "g_y": Quantity("g_y", "", 1.0, "ppm", 1e6),
    "k1": Quantity("k1", "", 1.0, "", 1.0),
    "k2": Quantity("k2", "", 1.0, "", 1.0),
    "s": Quantity("s", "", 1.0, "ppm", 1e6),
}


def quantity(name: str, result: Mapping[str, Any] | None = None) -> Quantity:
    """Look a parameter up by its name, one that is not in the table in its result."""
    if name in QUANTITIES:
        return QUANTITIES[name]
    symbols, units = ((result or {}).get(key) or {} for key in ("symbols", "units"))
    symbol = re.sub(r"[^\w]", "", str(symbols.get(name) or name))
    unit = re.sub(r"[<>&]", "", str(units.get(name) or ""))
    return Quantity(symbol, unit, 1.0, unit, 1.0)


def change_label(item: Quantity) -> str:
    """Axis label of a change, such as `Δf (µm)`."""
    return f"Δ{item.markup} ({item.change_unit})" if item.change_unit else f"Δ{item.markup}"
