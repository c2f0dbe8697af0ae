"""Single stars far from their places, and why detections took no part: where to look with the frame browser.

On the left the detector with every sighting beyond so many sigmas, the larger the farther off; on the right how many
detections or exposures were left out for each reason. A detection that was rejected has no residual here: its frame shows it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import list_known
from boresight.calibration.calibration import Calibration, ResidualOutliers
from boresight.calibration.problem import UNMATCHED_REASON
from boresight.figures.chart import Table
from boresight.figures.charts.residual_against import folded
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import BETWEEN_PANELS, grid_place, stacked_px
from boresight.verdicts.numbers import count

MOST_REASONS = 8
REASON_LETTERS, NARROW_REASON_LETTERS = 34, 20


def draw(drawn: Sequence[Part[ResidualOutliers]], beside: int = 2) -> go.Figure:
    """Draw every run's outliers on the detector, and its reasons as bars beside or below."""
    n_rows, detector, bars = 2 // beside, grid_place(0, beside), grid_place(1, beside)
    figure = make_subplots(
        n_rows, beside, horizontal_spacing=0.3, vertical_spacing=BETWEEN_PANELS / n_rows,
        column_widths=[0.6, 0.4][:beside],
    )  # fmt: skip
    for one in drawn:
        figure.add_trace(_places(one), **detector)
        figure.add_trace(_reasons(one, REASON_LETTERS if beside > 1 else NARROW_REASON_LETTERS), **bars)
    layout: dict[str, Any] = {"legend": len(drawn) > 1, "hovermode": "closest", "barmode": "group"}
    theme.dress(figure, title=_headline(drawn), height_px=stacked_px(440, n_rows, beside), **layout)
    rows, columns = (max(sizes) for sizes in zip(*map(_detector_size, drawn), strict=True))
    quiet = {"showgrid": False, "zeroline": False}
    across = {"title_text": "column (px)", "range": [-0.5, columns - 0.5], "constrain": "domain", **quiet}
    down = {"title_text": "row (px)", "range": [rows - 0.5, -0.5], "constrain": "domain", **quiet}
    figure.update_xaxes(tickangle=0, nticks=3 * beside, **across, **detector)
    figure.update_yaxes(scaleanchor="x", scaleratio=1, **down, **detector)
    figure.update_xaxes(title_text="left out", rangemode="tozero", **bars)
    figure.update_yaxes(autorange="reversed", showgrid=False, **bars)
    return figure


def reasons(result: Calibration) -> dict[str, int]:
    """Count what took no part by reason, the most frequent first: detections that matching gave no star, and what followed."""
    counts = dict(result.matching.row_reasons) if result.matching else {}
    for item in result.left_out:
        phrase = f"{item.what}: {item.reason}"
        if not (counts and item.reason == UNMATCHED_REASON):  # counted by matching's own reasons
            counts[phrase] = counts.get(phrase, 0) + item.count
    return dict(sorted(counts.items(), key=lambda pair: -pair[1])[:MOST_REASONS])


def _detector_size(one: Part[ResidualOutliers]) -> tuple[float, float]:
    """Rows and columns of the detector; a calibration from before they stood here has them as edges of its residual field."""
    trace, _, part = one
    field = trace.result.trust.residual_field if trace.result.trust else None
    edges = (field.row_edges_px, field.col_edges_px) if field else (part.row_px, part.col_px)
    rows, columns = (float(np.max(column(places), initial=0.0)) + 0.5 for places in edges)
    return part.rows or rows, part.columns or columns


def _places(one: Part[ResidualOutliers]) -> go.Scatter:
    _, style, part = one
    size = column(part.normalised)
    stars: Sequence[int | None] = part.star_id or [None] * len(size)
    said = [f"HIP {star}" if star else "no number" for star in stars]
    return go.Scatter(
        x=theme.short(column(part.col_px)),
        y=theme.short(column(part.row_px)),
        mode="markers",
        name=style.label,
        legendgroup=style.label,
        marker={
            "color": theme.translucent(style.colour, 0.7),
            "size": np.clip(4 + 1.5 * size, 6, 22).astype(np.float32),
            "symbol": "x-thin-open",
            "line": {"width": 1.8, "color": style.colour},
        },
        text=[f"{name}, frame {frame}" for name, frame in zip(said, part.frame, strict=True)],
        customdata=theme.short(np.stack([column(part.d_row_px), column(part.d_col_px), size], axis=1)),
        hovertemplate=(
            "%{text}<br>rows %{customdata[0]:+.2f} px, columns %{customdata[1]:+.2f} px: %{customdata[2]:.1f} σ"
            f"<extra>{style.label}</extra>"
        ),
    )


def _reasons(one: Part[ResidualOutliers], letters: int) -> go.Bar:
    trace, style, _ = one
    found = reasons(trace.result) or {"nothing was left out": 0}
    return go.Bar(
        y=["<br>".join(folded(theme.escape(reason), letters)) for reason in found],
        x=list(found.values()),
        orientation="h",
        name=style.label,
        legendgroup=style.label,
        showlegend=False,
        marker={"color": style.colour},
        text=[count(times) for times in found.values()],
        textposition="auto",
        hovertemplate=f"%{{y}}: %{{x}}<extra>{style.label}</extra>",
    )


def _headline(drawn: Sequence[Part[ResidualOutliers]]) -> str:
    part = drawn[0][2]
    if len(drawn) > 1:
        return f"Sightings beyond {part.limit:g} σ, {len(drawn)} runs"
    return (
        f"{part.in_all} of {count(part.stars_in_all)} sightings beyond {part.limit:g} σ, {part.expected:.1f} expected"
    )


def table(part: ResidualOutliers) -> Table:
    """List one outlier a row: frame, exposure, star, place and residual in px, and how many sigmas that is."""
    columns: Table = {"frame": list(part.frame), "exposure": list(part.exposure)}
    columns |= {} if part.star_id is None else {"star_id": list(part.star_id)}
    names = ("row_px", "col_px", "d_row_px", "d_col_px", "normalised")
    return columns | {name: list_known(column(getattr(part, name))) for name in names}


RESIDUAL_OUTLIERS = part_figure(
    draw,
    table,
    "residual_outliers",
    name="residual-outliers",
    title="Outliers and what was left out",
    guide=(
        "On the left is every sighting whose residual is beyond four of its sigmas, larger marks are further off; on "
        "the right are data not used in the fit, by reason. A number close to the expected one is good; many in one "
        "place or of one star mean a wrong match or a wrong catalogue place: open their frames."
    ),
    wide=True,
    advanced=True,
    forms={"narrow": partial(draw, beside=1)},
)
