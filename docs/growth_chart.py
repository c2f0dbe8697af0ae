"""The chart of growth as an SVG: time and memory of a whole calibration over its frames, on log axes, drawn without a library."""  # noqa: INP001 - beside the scripts that use it

from __future__ import annotations

import math
from typing import Any

WIDTH, HEIGHT, PANEL, EDGE = 860, 330, 350, 62
COLOURS = {"batch": "#1f5fa8", "sqrf": "#b4551d"}
PANELS = (("seconds", "wall time, s"), ("peak_mb", "peak resident memory, MB"))
STYLE = "text{font:12px sans-serif;fill:#222}.axis{stroke:#222;fill:none}.grid{stroke:#ddd}.limit{stroke:#777;stroke-dasharray:5 4}"


def svg(document: dict[str, Any]) -> str:
    """Draw what the part `growth` found; a sentence where it found nothing yet."""
    runs = document.get("growth", {}).get("found", {}).get("runs", {})
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img">',
        "<title>Time and memory of a calibration over its frames</title>",
        f'<style>{STYLE}</style><rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
    ]
    if not runs:
        parts.append(f'<text x="{WIDTH / 2}" y="{HEIGHT / 2}" text-anchor="middle">not measured</text>')
    else:
        for place, (key, title) in enumerate(PANELS):
            parts += _panel(EDGE + place * (PANEL + EDGE), key, title, runs)
    return "\n".join([*parts, "</svg>"]) + "\n"


def _panel(left: float, key: str, title: str, runs: dict[str, list[dict[str, Any]]]) -> list[str]:
    """One panel with its axes and a line a method."""
    points = [(row["frames"], row[key]) for rows in runs.values() for row in rows]
    x_low, x_high = _decades([frames for frames, _ in points])
    y_low, y_high = _decades([value for _, value in points])
    top, bottom = 36.0, HEIGHT - 46.0

    def x(frames: float) -> float:
        return left + (math.log10(frames) - x_low) / (x_high - x_low) * PANEL

    def y(value: float) -> float:
        return bottom - (math.log10(value) - y_low) / (y_high - y_low) * (bottom - top)

    parts = [f'<text x="{left}" y="22">{title}</text>']
    for power in range(x_low, x_high + 1):
        at = x(10.0**power)
        parts.append(f'<line class="grid" x1="{at:.1f}" y1="{top}" x2="{at:.1f}" y2="{bottom}"/>')
        parts.append(f'<text x="{at:.1f}" y="{bottom + 18}" text-anchor="middle">{_power(power)}</text>')
    for power in range(y_low, y_high + 1):
        at = y(10.0**power)
        parts.append(f'<line class="grid" x1="{left}" y1="{at:.1f}" x2="{left + PANEL}" y2="{at:.1f}"/>')
        parts.append(f'<text x="{left - 6}" y="{at + 4:.1f}" text-anchor="end">{_power(power)}</text>')
    parts.append(f'<rect class="axis" x="{left}" y="{top}" width="{PANEL}" height="{bottom - top}"/>')
    parts.append(f'<text x="{left + PANEL / 2}" y="{bottom + 36}" text-anchor="middle">frames</text>')
    for turn, (method, rows) in enumerate(runs.items()):
        colour = COLOURS.get(method, "#222")
        line = " ".join(f"{x(row['frames']):.1f},{y(row[key]):.1f}" for row in rows)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [
            f'<circle cx="{x(row["frames"]):.1f}" cy="{y(row[key]):.1f}" r="3.5" fill="{colour}"/>' for row in rows
        ]
        parts.append(f'<text x="{left + 12}" y="{top + 20 + 16 * turn}" style="fill:{colour}">{method}</text>')
    return parts


def _decades(values: list[float]) -> tuple[int, int]:
    """Powers of ten that enclose the values, at least one apart."""
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    return low, max(high, low + 1)


def _power(power: int) -> str:
    return f"{10**power:,}" if 0 <= power < 4 else f"10<tspan dy='-5' font-size='9'>{power}</tspan>"
