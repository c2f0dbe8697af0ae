"""Answers as a notebook shows them: verdict, table, of a calibration two drawings, advice. HTML and SVG: no script, no network."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from boresight.library.text import Summary, headline, verdict

if TYPE_CHECKING:
    from boresight.calibration.calibration import Calibration, Numbers

WIDTH, ROW, LABELS, MARGIN = 340, 18, 90, 12
HEIGHT = 150
#: Half-widths of a bar and of a band, in sigmas.
SIGMAS = 3.0


def summary_html(summary: Summary) -> str:
    """Write a summary as a piece of HTML."""
    head, *rows = summary.rows
    names = "".join(f"<th>{escape(name)}</th>" for name in head)
    cells = "".join(_row(row, summary.left) for row in rows)
    sentences = "".join(f"<li>{escape(sentence)}</li>" for sentence in summary.sentences)
    return (
        f'<div class="boresight-answer"><p><strong>{escape(summary.headline).replace(chr(10), "<br>")}</strong></p>'
        f"<table><thead><tr>{names}</tr></thead><tbody>{cells}</tbody></table>{f'<ul>{sentences}</ul>' if sentences else ''}</div>"
    )


def page_html(found: Calibration) -> str:
    """Write a calibration as a piece of HTML."""
    from boresight.figures.tables import HEADINGS, printed_rows

    head = "".join(f"<th>{escape(name)}</th>" for name in HEADINGS)
    rows = "".join(_row(row.cells) for row in printed_rows(found))
    advice = "".join(f"<li>{escape(sentence)}</li>" for sentence in found.advice)
    drawings = "".join(
        f'<figure style="margin:0"><figcaption>{escape(caption)}</figcaption>{drawing}</figure>'
        for caption, drawing in (
            (f"Change in typical sigmas, ± {SIGMAS:g}σ", _draw_changes(found)),
            ("RMS arc error, µrad", _draw_rms(found)),
        )
        if drawing
    )
    return (
        f'<div class="boresight-calibration"><p><strong>{escape(headline(found))}</strong><br>{escape(verdict(found))}</p>'
        f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
        f'<div style="display:flex;gap:2em;flex-wrap:wrap">{drawings}</div>'
        f"{f'<ul>{advice}</ul>' if advice else ''}</div>"
    )


def _row(cells: Sequence[str], left: Sequence[int] = ()) -> str:
    sides = [' style="text-align:left"' if place in left else "" for place in range(len(cells))]
    written = "".join(f"<td{side}>{escape(cell)}</td>" for side, cell in zip(sides, cells, strict=True))
    return f'<tr style="text-align:right">{written}</tr>'


def _draw_changes(found: Calibration) -> str:
    """Draw each estimated parameter's change with its sigmas, on the scale of its typical spread."""
    changes: list[tuple[str, float, float]] = []
    for name in found.free:
        new, old, sigma, typical = (
            values.get(name) for values in (found.parameters, found.initial, found.sigma, found.typical_sigma)
        )
        if new is not None and old is not None and sigma is not None and typical:
            changes.append((name, (new - old) / typical, SIGMAS * sigma / typical))
    if not changes:
        return ""
    reach = max(abs(change) + bar for _, change, bar in changes) or 1.0
    middle = LABELS + (WIDTH - LABELS) / 2
    scale = ((WIDTH - LABELS) / 2 - MARGIN) / reach
    height = ROW * len(changes) + MARGIN
    parts = [f'<line x1="{middle:.1f}" y1="0" x2="{middle:.1f}" y2="{height}" stroke="currentColor" opacity="0.4"/>']
    for place, (name, change, bar) in enumerate(changes):
        y = ROW * place + ROW / 2 + MARGIN / 2
        left, right = middle + scale * (change - bar), middle + scale * (change + bar)
        parts.append(
            f'<text x="0" y="{y + 4:.1f}" font-size="12">{escape(name)}</text>'
            f'<line x1="{left:.1f}" y1="{y:.1f}" x2="{right:.1f}" y2="{y:.1f}" stroke="currentColor" stroke-width="2"/>'
            f'<circle cx="{middle + scale * change:.1f}" cy="{y:.1f}" r="4"/>'
        )
    return _svg("Change of each parameter, with its sigmas", height, parts)


def _draw_rms(found: Calibration) -> str:
    """Draw the RMS arc error over the iterations of a batch or the frames of a filter."""
    series: Numbers = (
        found.trace.rms_arc_rad if found.trace else found.history.aggregate_rms_rad if found.history else []
    )
    values = [1e6 * value for value in series if value is not None]
    if len(values) < 2:
        return ""
    top = max(values)
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in _places(values, top))
    return _svg(
        "RMS arc error over the iterations or frames",
        HEIGHT,
        [
            f'<polyline points="{points}" fill="none" stroke="currentColor" stroke-width="2"/>',
            f'<text x="0" y="{MARGIN + 4}" font-size="12">{top:.4g}</text>',
            f'<text x="{WIDTH}" y="{_places(values, top)[-1][1] - 6:.1f}" font-size="12" text-anchor="end">{values[-1]:.4g}</text>',
        ],
    )


def _places(values: Sequence[float], top: float) -> list[tuple[float, float]]:
    """Return the coordinates of values over the width, from 0 at the bottom to the largest at the top."""
    step = (WIDTH - LABELS / 2) / (len(values) - 1)
    room = HEIGHT - 2 * MARGIN
    return [
        (LABELS / 2 + step * place, MARGIN + room * (1.0 - value / top if top else 1.0))
        for place, value in enumerate(values)
    ]


def _svg(label: str, height: float, parts: Sequence[str]) -> str:
    size = f'width="{WIDTH}" height="{height:.0f}" viewBox="0 0 {WIDTH} {height:.0f}"'
    return f'<svg {size} fill="currentColor" role="img" aria-label="{label}">{"".join(parts)}</svg>'
