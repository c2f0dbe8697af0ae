"""What each reference holds of the information in the centroids: arcs, all pairs, and singular values of star combinations.

A bar is the variance of the Cramer-Rao bound over that which the reference leaves with its full covariance, the geometric mean over
the free parameters; one is everything. It may read a hundredth more, for the error of an arc's ends is taken as isotropic.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.charts.frame_observability import absent, read_frame_judgement
from boresight.figures.style import theme
from boresight.figures.trust_parts import Part, column
from boresight.verdicts.quantities import quantity

TITLE = "Information of each reference"
LABELS = {
    "arcs": "arcs",
    "angular": "all<br>pairs",
    **{f"model_{model}": f"Model<br>{model}" for model in (1, 2, 3, 4)},
    "sigma_1": "σ1",
    "sigma_2": "σ2",
    "sigma_3": "σ3",
    "sigma_123": "σ1 σ2<br>σ3",
}
SENTENCE_WIDTH = 62


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw one bar a reference and run, and all there is as the level one."""
    styled = zip(traces, theme.run_styles(traces), strict=True)
    drawn = [(trace, style, read_frame_judgement(trace.result)) for trace, style in styled]
    drawn = [one for one in drawn if one[2].get("information")]
    if not drawn:
        return absent(TITLE, traces)
    figure = go.Figure([_bars(one, labelled=len(drawn) == 1) for one in drawn])
    many = len(drawn) > 1
    title = "Information over the Cramér-Rao bound"
    theme.dress(figure, title=title, height_px=480, legend=many, hovermode="closest", barmode="group")
    figure.add_hline(y=1, line={"color": theme.REFERENCE_COLOUR, "dash": "dot", "width": 1.4})
    figure.update_yaxes(title_text="share of the information", rangemode="tozero")
    figure.update_xaxes(showgrid=False, tickangle=0)
    words = theme.escape(str(drawn[0][2].get("sentence") or ""))
    said = "<br>".join(textwrap.wrap(words, SENTENCE_WIDTH))
    figure.update_layout(margin={"b": 66 + 18 * (1 + said.count("<br>"))})
    figure.add_annotation(
        text=said, x=0, y=0, xref="paper", yref="paper", xanchor="left", yanchor="top", yshift=-42, align="left",
        showarrow=False,
    )  # fmt: skip
    return figure


def _shares(view: Result, key: str = "share") -> FloatArray:
    return column([entry.get(key) for entry in view["information"]])


def _label(reference: str) -> str:
    return LABELS.get(reference, theme.escape(reference))


def _bars(one: Part, *, labelled: bool) -> go.Bar:
    trace, style, view = one
    shares = _shares(view)
    return go.Bar(
        x=[_label(entry["reference"]) for entry in view["information"]],
        y=theme.short(shares),
        name=style.label,
        marker={"color": style.colour},
        text=[f"{share:.2f}" if np.isfinite(share) else "open" for share in shares] if labelled else None,
        textposition="outside",
        cliponaxis=False,
        customdata=[_least(entry, trace.result) for entry in view["information"]],
        hovertemplate=f"%{{y:.3f}}, %{{customdata}}<extra>{style.label}</extra>",
    )


def _least(entry: Result, result: Result) -> str:
    """Say which parameter a reference serves worst."""
    if entry.get("least") is None or entry.get("least_share") is None:
        return "leaves a parameter open"
    return f"least for {quantity(entry['least'], result).markup}, {entry['least_share']:.3f}"


def table(result: Result) -> Table:
    """List one reference a row: its share of the information, and the parameter it serves worst."""
    information = read_frame_judgement(result).get("information")
    if not information:
        return {}
    return {
        "reference": [entry["reference"] for entry in information],
        "share_of_information": theme.plain(_shares(read_frame_judgement(result))),
        "sigma_over_bound": theme.plain(1 / np.sqrt(_shares(read_frame_judgement(result)))),
        "least_share": theme.plain(_shares(read_frame_judgement(result), "least_share")),
        "least_parameter": [entry.get("least") for entry in information],
    }


REFERENCE_INFORMATION = Figure(
    name="reference-information",
    title=TITLE,
    guide=(
        "Each bar is what a reference, weighed by its full covariance, keeps of the information that the centroids hold about "
        "the parameters (dotted, one): arcs, all pairs of stars, the four models with σ2 and σ3, and single values under "
        "Model 4. A bar of 0.8 is a fifth of the frames thrown away; σ1 beside the other two must add nothing."
    ),
    draw=draw,
    table=table,
)
