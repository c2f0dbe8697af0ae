"""What single frames can tell: the smallest singular value of H' = H W frame by frame (W Figures 3 and 4).

H has one row a measured singular value, W the typical sigmas, so that a parameter error of one typical sigma in the worst
direction moves the measurements of that frame by the value drawn. Above are the star-combination models with sigma_2 and
sigma_3, below each singular value alone under Model 4. The rows are not weighted by their noise, nor are rows that repeat others
left out: W's measure ranks, and what is known after all frames is drawn beside it, in `reference_information`.

What each reference holds of the information in the centroids: arcs, all pairs, and singular values of star combinations.

A bar is the variance of the Cramer-Rao bound over that which the reference leaves with its full covariance, the geometric mean over
the free parameters; one is everything. It may read a hundredth more, for the error of an arc's ends is taken as isotropic.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import Calibration, FrameObservability, ReferenceInformation
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, make_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import share_cursor
from boresight.verdicts.numbers import quantity

TITLE = "Observability per frame"
NOT_YET = "Not yet: single frames are assessed when the run ends."
NEVER = "This result has no assessment of single frames: clone its run and run it again to get one."
MODELS = {f"model_{model}": f"Model {model}" for model in (1, 2, 3, 4)}
VALUES = {f"sigma_{k}": f"σ{k} alone" for k in (1, 2, 3)}
#: What stands for each row of panels where several runs are compared.
COMPARED = ("model_4", "sigma_2")
#: The window reaches so many times below the median; a double click shows all.
FARTHEST_BELOW = 300.0


def read_frames(result: Calibration) -> FrameObservability | None:
    """Read how observable single frames are; None where that is of no frame."""
    return result.frame_observability if result.frame_observability and result.frame_observability.frame else None


def read_references(result: Calibration) -> FrameObservability | None:
    """Read the information of each reference; None where there is none."""
    view = result.frame_observability
    return view if view and view.information else None


def explain_absence(result: Calibration) -> str:
    """Say why a result tells nothing of single frames."""
    said = result.frame_observability.sentence if result.frame_observability else ""
    return said or (NOT_YET if result.status == "running" else NEVER)


def draw(found: Sequence[Part[FrameObservability]]) -> go.Figure:
    """Draw every model and value of one run, or Model 4 and one value of several."""
    drawn = [one for one in found if _measured(one[2])]
    if not drawn:
        return theme.missing(TITLE, explain_absence(found[0][0].result))
    figure = make_subplots(2, 1, shared_xaxes=True, vertical_spacing=0.09)
    for row, names in enumerate((MODELS, VALUES), start=1):
        for one in drawn:
            _draw_run(figure, one, names, row, alone=len(drawn) == 1)
    theme.dress(figure, title=_headline(drawn), height_px=520, hovermode="closest")
    figure.update_yaxes(type="log", exponentformat="power")
    for row, names in enumerate((MODELS, VALUES), start=1):
        figure.update_yaxes(
            range=_window(drawn, [name for name in names if len(drawn) == 1 or name in COMPARED]), row=row, col=1
        )
    figure.update_yaxes(title_text="min s, models" if len(drawn) == 1 else "min s, Model 4", row=1, col=1)
    figure.update_yaxes(title_text="min s, one value" if len(drawn) == 1 else "min s, σ2 alone", row=2, col=1)
    figure.update_xaxes(showticklabels=True)
    figure.update_xaxes(title_text=f"frame{_spacing(drawn)}", row=2, col=1)
    return share_cursor(figure, "frame")


def _window(drawn: Sequence[Part[FrameObservability]], names: Sequence[str]) -> list[float] | None:
    """Choose the decades of a log axis, so that a few frames that hardly determine anything do not flatten the others."""
    curves = [column(view.minimum_singular_value.get(name)) for _, _, view in drawn for name in names]
    known = np.concatenate(curves)
    known = known[np.isfinite(known) & (known > 0)]
    if not len(known):
        return None
    low = max(float(known.min()), float(np.median(known)) / FARTHEST_BELOW)
    return [float(np.log10(low)) - 0.15, float(np.log10(known.max())) + 0.15]


def _measured(view: FrameObservability) -> bool:
    """Tell whether any frame determines all parameters under any choice."""
    return any(value is not None for curve in view.minimum_singular_value.values() for value in curve)


def _draw_run(
    figure: go.Figure, one: Part[FrameObservability], names: dict[str, str], row: int, *, alone: bool
) -> None:
    """Add one run's curves to a panel: all of them in colours of their own, or one in the colour of the run."""
    _, style, view = one
    frame = column(view.frame)
    for place, (name, label) in enumerate(names.items()):
        if name not in view.minimum_singular_value or not (alone or name in COMPARED):
            continue
        colour = theme.RUN_COLOURS[(place + len(MODELS) * (row - 1)) % len(theme.RUN_COLOURS)]
        own = theme.RunStyle(label, colour, "solid") if alone else style
        hover = f"frame %{{x}}: %{{y:.3g}}<extra>{label}{'' if alone else ', ' + style.label}</extra>"
        options: dict[str, Any] = {"hovertemplate": hover, "showlegend": alone or row == 1, "connectgaps": False}
        curve = theme.line(own, frame, column(view.minimum_singular_value[name]), mode="lines+markers", **options)
        curve.update(line={"width": 1.1}, marker={"size": 3, "color": own.colour})
        figure.add_trace(curve, row=row, col=1)


def _headline(drawn: Sequence[Part[FrameObservability]]) -> str:
    """Say what is drawn, and of how many frames."""
    if len(drawn) > 1:
        return f"Minimum singular value by frame, {len(drawn)} runs"
    return f"Minimum singular value by frame{_spacing(drawn)}"


def _spacing(drawn: Sequence[Part[FrameObservability]]) -> str:
    """Say of how many frames the curves are, where it is not all of one run's."""
    view = drawn[0][2]
    used, frames = view.frames_used, view.frames
    return "" if len(drawn) > 1 or used == frames else f" ({used} spaced evenly over {frames})"


def table(view: FrameObservability) -> Table:
    """List one frame a row: the minimum singular value under each choice, per typical sigma."""
    columns: Table = {"frame": list(view.frame)}
    curves = view.minimum_singular_value.items()
    return columns | {name: list_known(column(values)) for name, values in curves}


FRAME_OBSERVABILITY = make_figure(
    draw,
    table,
    read_frames,
    explain_absence,
    name="frame-observability",
    title=TITLE,
    guide=(
        "Each line shows, frame by frame, the smallest singular value of the scaled Jacobian for one choice of star "
        "combinations (top) or singular values (bottom): the higher, the more a parameter error changes the "
        "measurements, and a gap is a frame that cannot determine all parameters alone. It ranks frames and choices "
        "but does not measure precision, because a duplicated row counts twice; for precision, see “Information of "
        "each reference”."
    ),
    wide=True,
    advanced=True,
)


LABELS = {
    "arcs": "arcs",
    "angular": "all<br>pairs",
    **{f"model_{model}": f"Model<br>{model}" for model in (1, 2, 3, 4)},
    "sigma_1": "σ1",
    "sigma_2": "σ2",
    "sigma_3": "σ3",
    "sigma_123": "σ1 σ2<br>σ3",
}
SENTENCE_WIDTH, NARROW_SENTENCE_WIDTH = 62, 48


def draw_reference_information(drawn: Sequence[Part[FrameObservability]], *, lying: bool = False) -> go.Figure:
    """Draw one bar a reference and run, and all there is as the level one; bars that lie have their names beside each other."""
    figure = go.Figure([_bars(one, labelled=len(drawn) == 1, lying=lying) for one in drawn])
    many = len(drawn) > 1
    title = "Information over the Cramér-Rao bound"
    theme.dress(figure, title=title, height_px=480, legend=many, hovermode="closest", barmode="group")
    level = {"line": {"color": theme.REFERENCE_COLOUR, "dash": "dot", "width": 1.4}}
    shares = {"title_text": "share of the information", "rangemode": "tozero"}
    if lying:
        figure.add_vline(x=1, **level)
        figure.update_xaxes(**shares)
        figure.update_yaxes(showgrid=False, autorange="reversed")
    else:
        figure.add_hline(y=1, **level)
        figure.update_yaxes(**shares)
        figure.update_xaxes(showgrid=False, tickangle=0)
    words = theme.escape(drawn[0][2].sentence)
    said = "<br>".join(textwrap.wrap(words, NARROW_SENTENCE_WIDTH if lying else SENTENCE_WIDTH))
    figure.update_layout(margin={"b": 66 + 18 * (1 + said.count("<br>"))})
    figure.add_annotation(
        text=said, x=0, y=0, xref="paper", yref="paper", xanchor="left", yanchor="top", yshift=-42, align="left",
        xshift=-52 if lying else 0, showarrow=False,
    )  # fmt: skip
    return figure


def _shares(view: FrameObservability) -> FloatArray:
    return column([entry.share for entry in view.information])


def _bars(one: Part[FrameObservability], *, labelled: bool, lying: bool) -> go.Bar:
    trace, style, view = one
    shares = _shares(view)
    names = [LABELS.get(entry.reference, theme.escape(entry.reference)) for entry in view.information]
    names = [name.replace("<br>", " ") for name in names] if lying else names
    text = [f"{share:.2f}" if np.isfinite(share) else "open" for share in shares] if labelled else None
    least = [_least(entry, trace.result) for entry in view.information]
    hover = f"%{{{'x' if lying else 'y'}:.3f}}, %{{customdata}}"
    drawn = theme.bars(style, names, shares, hover, text=text, customdata=least)
    return drawn.update(x=drawn.y, y=drawn.x, orientation="h") if lying else drawn


def _least(entry: ReferenceInformation, result: Calibration) -> str:
    if entry.least is None or entry.least_share is None:
        return "does not determine a parameter"
    return f"least for {quantity(entry.least, result).markup}, {entry.least_share:.3f}"


def table_reference_information(view: FrameObservability) -> Table:
    """List one reference a row: its share of the information, and the parameter it serves worst."""
    return {
        "reference": [entry.reference for entry in view.information],
        "share_of_information": list_known(_shares(view)),
        "sigma_over_bound": list_known(1 / np.sqrt(_shares(view))),
        "least_share": list_known(column([entry.least_share for entry in view.information])),
        "least_parameter": [entry.least for entry in view.information],
    }


REFERENCE_INFORMATION = make_figure(
    draw_reference_information,
    table_reference_information,
    read_references,
    explain_absence,
    name="reference-information",
    title="Information of each reference",
    guide=(
        "Each bar is the share of the information about the parameters in the centroids (dotted, 1) that each measurement "
        "type retains, "
        "weighted by its full covariance: arcs, all pairs of stars, the four models with σ2 and σ3, and single values under "
        "Model 4. A value of 0.8 is equivalent to losing a fifth of the frames; adding σ1 to the other two must not change "
        "nothing."
    ),
    advanced=True,
    forms={"narrow": partial(draw_reference_information, lying=True)},
)
