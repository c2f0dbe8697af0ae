"""Figures, promises and tables as the pages and the command write them: three digits, no number without its unit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

#: What a key ends in, the factor that makes it readable, and the unit.
UNITS = (
    ("_us_per_frame", 1.0, "µs a frame"), ("_over_ours", 1.0, "times ours"), ("_ms_per_run", 1.0, "ms a run"),
    ("_us_per_request", 1.0, "µs a request"), ("_per_s", 1.0, "a second"), ("_us", 1.0, "µs"), ("_ms", 1.0, "ms"),
    ("_mb", 1.0, "MB"), ("_gb", 1.0, "GB"), ("_bytes", 1e-3, "kB"), ("_px", 1.0, "px"), ("_s", 1.0, "s"),
    ("seconds", 1.0, "s"),
)  # fmt: skip
NOT_MEASURED = "not measured"


def number(value: Any, digits: int = 3) -> str:
    """A number with so many digits, thousands parted; words as they are."""
    if value is None:
        return "-"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if not math.isfinite(value):
        return "-"
    if value == 0 or (isinstance(value, int) and abs(value) < 10**6):
        return f"{value:,}" if isinstance(value, int) else "0"
    power = math.floor(math.log10(abs(value)))
    if power < -4 or power >= 9:
        return f"{value:.{digits - 1}e}"
    rounded = round(value, digits - 1 - power)
    power = math.floor(math.log10(abs(rounded)))
    return f"{rounded:,.{max(0, digits - 1 - power)}f}"


def told(found: Mapping[str, Any], key: str) -> str:
    """A figure, or that it was not measured."""
    return NOT_MEASURED if found.get(key) is None else number(found[key])


def kilobytes(size: float) -> str:
    """Bytes as kB."""
    return number(size / 1e3)


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> str:
    """A table in Markdown; columns but those of `left` to the right."""
    rule = ["---" if place in left else "---:" for place in range(len(heads))]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in [heads, rule, *rows])


def figures(found: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Every number of a part with its place in words and its unit; limits stand elsewhere."""
    for key, value in found.items():
        words = f"{prefix}{key.replace('_', ' ')}"
        if key == "limits":
            continue
        if isinstance(value, Mapping):
            yield from figures(value, f"{words}, ")
        elif isinstance(value, list) and value and all(isinstance(one, Mapping) for one in value):
            for place, one in enumerate(value, 1):
                yield from figures(one, f"{words} {place}, ")
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            factor, unit = next(((factor, unit) for end, factor, unit in UNITS if key.endswith(end)), (1.0, ""))
            yield words, number(value * factor if factor != 1.0 else value), unit


def all_figures(found: Mapping[str, Any], but: Sequence[str] = ()) -> str:
    """A table of every figure but those that others show."""
    kept = {key: one for key, one in found.items() if key not in but}
    return table(("figure", "value", "unit"), list(figures(kept)), (0, 2))


def promise(limit: Mapping[str, Any]) -> tuple[str, str, str]:
    """What is promised, what was measured, and whether it was kept."""
    bound = f"{'at least' if limit.get('at_least') else 'at most'} {number(limit['limit'])} {limit.get('unit', '')}"
    kept = {True: "kept", False: "**not kept**"}.get(limit["kept"], NOT_MEASURED)
    return bound.strip(), number(limit["measured"], 4), kept + (f": {limit['why']}" if "why" in limit else "")
