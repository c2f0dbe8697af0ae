"""The one look of every chart: the page's own colours, one colour a run, one style of uncertainty.

Everything that depends on the surface (ink, grid, hover) sits in a Plotly template and nowhere else, and every colour is
a token of the style sheet (`boresight.figures.style.theme`). The dark template's paper is transparent, so the page's surface
shows. A page in another theme replaces `layout.template` by `layout.meta.light` or `layout.meta.contrast`, a white image
by the light one, and needs to touch nothing more, because the run colours were chosen for at least 3:1 contrast against
the panels of every theme and stay apart for the common colour-vision deficiencies; a dash style says the same again.
"""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from boresight.figures.chart import Trace
from boresight.resources import folder
from boresight.verdicts.numbers import MINUS, NARROW_SPACE

Tokens = dict[str, str]

THEMES = ("dark", "light", "contrast", "print")

_BLOCK = re.compile(r"^\s*(:root[^{]*?)\s*\{([^}]*)\}", re.MULTILINE)
_PROPERTY = re.compile(r"--([\w-]+):\s*([^;]+);")
_THEME_OF = {":root": "dark", ":root, :root[data-theme]": "print"}


def read_themes(css: str) -> dict[str, Tokens]:
    """Read the tokens of every theme, {theme: {name: value}}."""
    blocks: dict[str, Tokens] = {}
    for selector, body in _BLOCK.findall(css):
        named = re.fullmatch(r':root\[data-theme="(\w+)"\]', selector)
        theme = named[1] if named else _THEME_OF.get(selector)
        if theme:
            blocks.setdefault(theme, {}).update(_PROPERTY.findall(body))
    if missing := [theme for theme in THEMES if theme not in blocks]:
        raise ValueError(f"Expected the themes {', '.join(THEMES)}; received a style sheet without {missing[0]}")
    return {theme: blocks["dark"] | blocks[theme] for theme in THEMES}


def declared(tokens: Tokens) -> str:
    """Write tokens as declarations, for the style element of a file that stands alone."""
    return " ".join(f"--{name}: {value};" for name, value in tokens.items())


TOKENS = read_themes((folder("frontend") / "static" / "shared" / "style.css").read_text(encoding="utf-8"))


_EVERYWHERE = TOKENS["dark"]
SANS, TABULAR = _EVERYWHERE["sans"], _EVERYWHERE["mono"]
RUN_COLOURS = tuple(_EVERYWHERE[f"run-{place}"] for place in range(1, 9))
RUN_DASHES = ("solid", "dash", "dashdot", "longdash", "solid", "dash", "dashdot", "longdash")
REFERENCE_COLOUR = _EVERYWHERE["reference"]
TRUTH_COLOUR = _EVERYWHERE["truth"]
CLEAR = "rgba(0,0,0,0)"
LEVEL = {"color": REFERENCE_COLOUR, "dash": "dot", "width": 1.2}  # of a line to compare with
UI_REVISION = "boresight"
BAND_SIGMAS = 3
SHORT_LENGTH = 14


def translucent(colour: str, opacity: float) -> str:
    """Turn `#rrggbb` into the same colour with an opacity."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:g})"


DIVERGING = ((0.0, RUN_COLOURS[1]), (0.5, translucent(REFERENCE_COLOUR, 0.06)), (1.0, RUN_COLOURS[0]))


@dataclass(frozen=True)
class RunStyle:
    """How one run is drawn in every figure; `short` stands over its map where the label is too long."""

    label: str
    colour: str
    dash: str
    short: str = ""


def _template(tokens: Tokens, paper: str) -> go.layout.Template:
    ink, muted, line = tokens["ink"], tokens["ink-2"], tokens["edge"]
    ticks = {"family": TABULAR, "size": 11, "color": muted}
    axis = {
        "gridcolor": translucent(tokens["ink-3"], 0.16),
        "linecolor": line,
        "zerolinecolor": line,
        "zerolinewidth": 1,
        "showline": True,
        "ticks": "outside",
        "ticklen": 4,
        "exponentformat": "power",  # with the scale of exponents that tables have
        "minexponent": 6,
        "separatethousands": True,
        "tickcolor": line,
        "tickfont": ticks,
        "title": {"font": {"size": 12, "color": muted}, "standoff": 8},
    }
    bar = {"tickfont": ticks, "outlinewidth": 0, "title": {"font": {"size": 12, "color": muted}, "side": "right"}}
    return go.layout.Template(
        layout={
            "paper_bgcolor": paper,
            "plot_bgcolor": paper,
            "font": {"family": SANS, "size": 13, "color": ink},
            "title": {"font": {"size": 14, "color": ink}, "x": 0, "xref": "paper", "xanchor": "left"},
            # room across the axis only: along it every panel's labels push the others, for seconds, until nothing moves
            "xaxis": axis | {"automargin": "height"},
            "yaxis": axis | {"automargin": "width"},
            "separators": f".{NARROW_SPACE}",
            "colorway": RUN_COLOURS,
            "legend": {"font": {"size": 12, "color": ink}, "bgcolor": CLEAR},
            "hoverlabel": {
                "bgcolor": tokens["surface-2"],
                "bordercolor": line,
                "font": {"family": TABULAR, "size": 12, "color": ink},
            },
            "annotationdefaults": {"font": {"color": muted, "size": 12}, "showarrow": False},
            "modebar": {"bgcolor": CLEAR, "color": muted, "activecolor": ink},
        },
        data={
            "heatmap": [{"colorbar": bar, "textfont": {"family": TABULAR, "size": 11, "color": ink}}],
            "bar": [{"textfont": {"family": TABULAR, "size": 11, "color": ink}}],
        },
    )


DARK_TEMPLATE = _template(TOKENS["dark"], CLEAR)
LIGHT_TEMPLATE = _template(TOKENS["light"], TOKENS["light"]["surface-1"])
CONTRAST_TEMPLATE = _template(TOKENS["contrast"], CLEAR)
_OTHERS = {"light": LIGHT_TEMPLATE.to_plotly_json(), "contrast": CONTRAST_TEMPLATE.to_plotly_json()}


def dress(figure: go.Figure, *, title: str, height_px: int, legend: bool = True, **layout: Any) -> go.Figure:
    """Give a figure the house layout, with the templates of the other themes on board."""
    settings: dict[str, Any] = {
        "template": DARK_TEMPLATE,
        "meta": _OTHERS,
        "title": {"text": title, "y": 1, "yref": "container", "yanchor": "top", "pad": {"t": 8}},
        "height": height_px,
        "autosize": True,
        "uirevision": UI_REVISION,
        "hovermode": "x unified",
        "margin": {"l": 64, "r": 24, "t": 66 if legend else 42, "b": 48},
        "showlegend": legend,
        "legend": {
            "orientation": "h",
            "x": 0,
            "xanchor": "left",
            "y": 1 - 30 / height_px,
            "yref": "container",
            "yanchor": "top",
        },
    }
    figure.update_layout(settings | layout)
    figure.update_annotations(font={"size": 12})
    return figure


def shrink(figure: go.Figure, **margin: int) -> go.Figure:
    """Give a figure the layout of a small view: no title, no legend, and letters and margins as small as can be read."""
    dress(figure, title="", height_px=190, legend=False, margin={"l": 44, "r": 10, "t": 8, "b": 34} | margin)
    figure.update_layout(font={"size": 11}, meta={**figure.layout.meta, "small": True})
    figure.update_xaxes(tickfont={"size": 10}, title={"font": {"size": 11}, "standoff": 2}, nticks=5, automargin=False)
    figure.update_yaxes(tickfont={"size": 10}, title={"font": {"size": 11}, "standoff": 2}, nticks=5, automargin=False)
    figure.update_annotations(font={"size": 10})
    return figure


def missing(title: str, sentence: str) -> go.Figure:
    """Draw nothing, and say why."""
    figure = go.Figure()
    figure.add_annotation(text=escape(sentence), x=0.5, y=0.5, xref="paper", yref="paper")
    dress(figure, title=title, height_px=220)
    figure.update_xaxes(visible=False)
    figure.update_yaxes(visible=False)
    return figure


def escape(text: str) -> str:
    """Make foreign text safe inside Plotly's markup."""
    return html.escape(text, quote=False)


def run_styles(traces: Sequence[Trace]) -> list[RunStyle]:
    """Give each run its colour and dash, by its place in the comparison."""
    styles = label_styles([trace.label for trace in traces])
    shorts = [escape(shorten(trace.short or trace.label)) for trace in traces]
    return [replace(style, short=short) for style, short in zip(styles, shorts, strict=True)]


def label_styles(labels: Sequence[str]) -> list[RunStyle]:
    """Give each label its colour and dash, by its place; colours that come again have another dash."""
    colours, dashes = len(RUN_COLOURS), len(RUN_DASHES)
    return [
        RunStyle(
            escape(label), RUN_COLOURS[i % colours], RUN_DASHES[(i + i // colours) % dashes], escape(shorten(label))
        )
        for i, label in enumerate(labels)
    ]


def shorten(label: str) -> str:
    """Keep of a label what fits over a narrow map; the hover has the whole."""
    return label if len(label) <= SHORT_LENGTH else f"{label[: SHORT_LENGTH - 1]}…"


def styled(traces: Sequence[Trace]) -> list[tuple[Trace, RunStyle]]:
    """Pair each run with how it is drawn."""
    return list(zip(traces, run_styles(traces), strict=True))


def short(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Keep seven significant digits, more than a screen can show: travels as bytes, a quarter of the text's size."""
    return np.where(np.isfinite(values), values, np.nan).astype(np.float32)


def tag_run(run: str, part: str = "", sigmas: int | None = None) -> dict[str, Any]:
    """Say in a trace's `meta` whose it is, which of that run's curves, and of a band how many sigmas it reaches."""
    return {"run": run, "part": part} | ({} if sigmas is None else {"sigmas": sigmas})


def line(style: RunStyle, x: NDArray[np.float64], y: NDArray[np.float64], **options: Any) -> go.Scatter:
    """Draw a run's estimate."""
    settings = {"mode": "lines", "name": style.label, "legendgroup": style.label, "connectgaps": True}
    settings |= {"meta": tag_run(style.label)} | options
    return go.Scatter(
        x=short(x), y=short(y), line={"color": style.colour, "dash": style.dash, "width": 1.8}, **settings
    )


def error_bars(reach: Any, colour: str) -> dict[str, Any]:
    """Draw what a mark may be off by."""
    return {"type": "data", "array": reach, "color": colour, "thickness": 1.4, "width": 4}


def bars(style: RunStyle, x: Sequence[Any], y: NDArray[np.float64], hover: str, **options: Any) -> go.Bar:
    """Draw a run's bars; their labels, where there are any, stand outside."""
    labelled = {"textposition": "outside", "cliponaxis": False} if "text" in options else {}
    settings: dict[str, Any] = {"name": style.label, "marker": {"color": style.colour}} | labelled | options
    return go.Bar(x=x, y=short(y), hovertemplate=f"{hover}<extra>{style.label}</extra>", **settings)


def signed_map(x: Sequence[str], y: Sequence[str], z: NDArray[np.float64], least: float, **options: Any) -> go.Heatmap:
    """Draw shares between -1 and 1, (n_y, n_x), written where they are no smaller than `least`."""
    text = [["" if abs(v) < least or not np.isfinite(v) else f"{v:+.2f}".replace("-", MINUS) for v in row] for row in z]
    settings: dict[str, Any] = {"zmin": -1, "zmax": 1, "colorscale": DIVERGING, "xgap": 2, "ygap": 2} | options
    return go.Heatmap(x=x, y=y, z=short(z), text=text, texttemplate="%{text}", **settings)


def band(
    style: RunStyle, x: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], **options: Any
) -> go.Scatter:
    """Draw +-3 sigma around a run's estimate: the one style of uncertainty, filled and edged faintly."""
    known = np.isfinite(low) & np.isfinite(high)
    outline_x = np.concatenate([x[known], x[known][::-1]])
    outline_y = np.concatenate([high[known], low[known][::-1]])
    settings = {"legendgroup": style.label, "showlegend": False, "hoverinfo": "skip"} | options
    return go.Scatter(
        x=short(outline_x),
        y=short(outline_y),
        mode="lines",
        line={"color": translucent(style.colour, 0.4), "width": 0.7, "dash": "dot"},
        fill="toself",
        fillcolor=translucent(style.colour, 0.16),
        name=f"{style.label} ±3σ",
        meta=tag_run(style.label, sigmas=BAND_SIGMAS),
        **settings,
    )


def reference(x: Sequence[float], value: float, name: str, colour: str, dash: str, **options: Any) -> go.Scatter:
    """Draw a level to compare with, in a style no run has."""
    settings = {"legendgroup": name, "hovertemplate": f"{name} %{{y:.5g}}<extra></extra>"} | options
    return go.Scatter(
        x=list(x),
        y=[value] * len(x),
        mode="lines",
        name=name,
        line={"color": colour, "dash": dash, "width": 1.2},
        **settings,
    )
