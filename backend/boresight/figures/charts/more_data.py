"""What more frames of the same kind would buy: the predicted sigma of each parameter, both axes logarithmic.

Information adds: with A = J^T R^-1 J of F frames, F + n frames of the same kind have A (1 + n / F), and what was known
before stays. A parameter that the stars determine falls as 1/sqrt(frames); one that lives on its a-priori spread does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import Calibration, MoreData
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import frame_grid, grid_place, name_panel, space_panels
from boresight.verdicts.numbers import grouped, quantity

MOST_COLUMNS = 4
PANEL_HEIGHT_PX = 170
STEPS = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0))
FEWEST_TICKS = 2


def draw(drawn: Sequence[Part[MoreData]], columns: int = MOST_COLUMNS) -> go.Figure:
    """Draw one panel a parameter: the predicted sigma over the frames there would be in all."""
    names = list(dict.fromkeys(name for _, _, part in drawn for name in part.sigma))
    n_rows = -(-len(names) // columns)
    figure = make_subplots(n_rows, columns, **space_panels(columns, n_rows))
    for i, name in enumerate(names):
        _panel(figure, drawn, name, grid_place(i, columns), named=i == 0)
    _dress(figure, drawn, n_rows, columns, len(names))
    return figure


def _panel(
    figure: go.Figure, drawn: Sequence[Part[MoreData]], name: str, where: dict[str, int], *, named: bool
) -> None:
    """Add one parameter's curve of every run, and a mark at the frames that the run has."""
    item = quantity(name, drawn[0][0].result)
    seen: list[list[FloatArray]] = []
    for trace, style, part in drawn:
        if name not in part.sigma:
            continue
        frames, sigma = _curve(trace.result, part, name)
        hover = f"%{{x:.0f}} frames: %{{y:.3g}} {item.unit}<extra>{style.label}</extra>"
        options: dict[str, Any] = {"hovertemplate": hover, "showlegend": named, "mode": "lines+markers"}
        curve = theme.line(style, frames, sigma * item.factor, **options)
        curve.update(marker={"size": [8] + [4] * (len(frames) - 1), "color": style.colour, "line": {"width": 0}})
        figure.add_trace(curve, **where)
        seen.append([frames, sigma * item.factor])
    for update, values in zip((figure.update_xaxes, figure.update_yaxes), np.concatenate(seen, axis=1), strict=True):
        ticks = round_ticks(values)
        update(tickvals=ticks, ticktext=[grouped(f"{tick:g}") for tick in ticks], **where)
    unit = f" ({item.unit})" if item.unit else ""
    name_panel(figure, f"σ of {item.markup}{unit}", **where)


def _curve(result: Calibration, part: MoreData, name: str) -> tuple[FloatArray, FloatArray]:
    """Return frames in all (n,) and sigma (n,) in SI, beginning with what the run has now."""
    further, sigma = column(part.further_frames), column(part.sigma[name])
    now, frames_now = result.sigma.get(name), part.frames or result.frames
    if now is not None and 0 not in further:
        further, sigma = np.append(0.0, further), np.append(now, sigma)
    frames = further + frames_now
    shown = frames > 0
    return frames[shown], sigma[shown]


def round_ticks(values: FloatArray) -> list[float]:
    """Return round numbers within the values, for a log axis: as few to the decade as give two."""
    known = values[np.isfinite(values) & (values > 0)]
    low, high = float(np.min(known, initial=np.inf)), float(np.max(known, initial=0.0))
    if not low <= high:
        return []
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    found: list[float] = []
    for steps in STEPS:
        found = [step * 10.0**power for power in powers for step in steps if low <= step * 10.0**power <= high]
        if len(found) >= FEWEST_TICKS:
            break
    return found


def _dress(figure: go.Figure, drawn: Sequence[Part[MoreData]], n_rows: int, columns: int, n_panels: int) -> None:
    many = len(drawn) > 1
    title = "Predicted sigma over frames in all, the mark at the left is now"
    theme.dress(figure, title=title, height_px=90 + n_rows * PANEL_HEIGHT_PX, legend=many, hovermode="closest")
    if not many:
        figure.update_traces(showlegend=False)
    figure.update_xaxes(type="log", tickangle=0)
    figure.update_yaxes(type="log")
    frame_grid(figure, n_panels, columns, "frames")


def table(part: MoreData) -> Table:
    """List further frames and the predicted sigma of each parameter in SI."""
    further: Table = {"further_frames": list(part.further_frames)}
    return further | {f"sigma_{name}": list_known(column(values)) for name, values in part.sigma.items()}


MORE_DATA = part_figure(
    draw,
    table,
    "more_data",
    name="more-data",
    title="What more data would buy",
    guide=(
        "Each panel shows the sigma that a parameter would have with more frames of the same kind; the large mark is this "
        "run. A curve that halves with four times the frames makes more frames worth waiting for; a flat curve needs other "
        "frames, not more of them."
    ),
    wide=True,
    advanced=True,
    forms={"medium": partial(draw, columns=2), "narrow": partial(draw, columns=1)},
)
