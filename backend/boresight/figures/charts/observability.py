"""What the data can tell apart: singular values over their directions (E Eqs. 22 to 24).

H' = U S V^T is the whitened Jacobian in typical sigmas. Each column of the chart is one direction: above, its singular
value s, so that 1/s is its sigma in typical sigmas; below, the parameters it is made of, the column of V. The result
holds V^T, one direction a row.

Which data would tell apart what these data cannot: read off the weakest directions, the coverage and the square-root law.

A direction is made of parameters that do alike to the stars at hand. Focal length and distortion do alike where stars fill a narrow
range of radii; principal point and tilts do alike unless stars stand far out on both sides; an aspect factor needs arcs along
rows and along columns. More frames like these divide the sigma of a direction by the square root of their number.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.advice import ENOUGH, MOST_TIMES
from boresight.calibration.calibration import Calibration, Observability
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import Role
from boresight.estimation.statistics.observability import NAMED, WEAK
from boresight.figures.chart import Table
from boresight.figures.factory import Part, make_figure
from boresight.figures.style import theme
from boresight.verdicts.answers import describe_weak
from boresight.verdicts.numbers import count, number, percent, quantity, set_symbols, typeset

THRESHOLD = 1.0 / WEAK
WEAK_COLOUR = theme.RUN_COLOURS[1]
HYPHEN_MINUS = re.compile(r"(?<![\w-])-(?=[\d.])")


def read_observability(result: Calibration) -> Observability | None:
    """Read what the data can tell apart; None where that was not computed."""
    return result.observability if result.observability and result.observability.singular_values else None


def draw(drawn: Sequence[Part[Observability]]) -> go.Figure:
    """Draw singular values as bars on a log axis, over the heat map of the first run's directions."""
    figure = make_subplots(2, 1, shared_xaxes=True, row_heights=[0.4, 0.6], vertical_spacing=0.07)
    for _, style, seen in drawn:
        figure.add_trace(_bars(seen, style), row=1, col=1)
    if len(drawn) == 1:
        seen = drawn[0][2]
        _write_over_bars(figure, seen, [number(value, 3) for value in seen.singular_values], row=1, col=1)
    figure.add_trace(_directions(drawn[0][0].result, drawn[0][2]), row=2, col=1)
    _dress(figure, drawn)
    return figure


def _modes(n_modes: int) -> list[str]:
    return [f"{i + 1}" for i in range(n_modes)]


def _bars(seen: Observability, style: theme.RunStyle) -> go.Bar:
    values = np.array(seen.singular_values, dtype=np.float64)
    with np.errstate(divide="ignore"):
        spread = 1.0 / values
    hover = "s = %{y:.4g}<br>σ = %{customdata:.3g} typical σ"
    shown = np.where(values > 0, values, np.nan)
    looks = {"marker": _looks(values, style.colour), "customdata": theme.short(spread)}
    return theme.bars(style, _modes(len(values)), shown, hover, **looks)


def _write_over_bars(figure: go.Figure, seen: Observability, texts: Sequence[str], **place: int) -> None:
    """Write over each bar; over one that does not reach the threshold above that, whose line would strike it out."""
    figure.add_scatter(
        x=_modes(len(texts)),
        y=np.fmax(np.array(seen.singular_values, dtype=np.float64), THRESHOLD),
        text=texts,
        mode="markers+text",
        marker={"size": 8, "color": theme.CLEAR},  # holds the text off the bar and the line
        textposition="top center",
        textfont={"family": theme.TABULAR, "size": 11},
        cliponaxis=False,
        hoverinfo="skip",
        showlegend=False,
        **place,
    )


def _looks(values: FloatArray, colour: str) -> dict[str, Any]:
    """Return the marker of the bars: a direction that is not seen is amber and hatched."""
    weak = values < THRESHOLD
    return {
        "color": [WEAK_COLOUR if one else colour for one in weak],
        "pattern": {"shape": ["/" if one else "" for one in weak], "fgcolor": WEAK_COLOUR, "bgcolor": theme.CLEAR},
        "line": {"color": [WEAK_COLOUR if one else colour for one in weak], "width": 1},
    }


def _directions(result: Calibration, seen: Observability) -> go.Heatmap:
    """Draw V: rows are parameters, columns are directions from the best known to the weakest."""
    names, n_modes = seen.parameter_names, len(seen.singular_values)
    V = _vectors(seen)
    if V is None:
        V = np.full((len(names), n_modes), np.nan)
    return theme.signed_map(
        _modes(n_modes), [quantity(name, result).markup for name in names], V, 0.1,
        colorbar={"title": {"text": "share", "side": "right"}, "len": 0.55, "y": 0, "yanchor": "bottom", "thickness": 10},
        hovertemplate="%{y}: %{z:+.3f} of direction %{x}<extra></extra>",
    )  # fmt: skip


def _vectors(seen: Observability) -> FloatArray | None:
    """Read V (n_parameters, n_modes), the largest share of each direction positive; None where the result has none."""
    V = np.array(seen.right_singular_vectors, dtype=np.float64).T
    if V.shape != (len(seen.parameter_names), len(seen.singular_values)):
        return None
    largest = np.argmax(np.abs(V), axis=0)
    return np.asarray(V * np.where(V[largest, np.arange(V.shape[1])] < 0, -1.0, 1.0))


def _dress(figure: go.Figure, drawn: Sequence[Part[Observability]]) -> None:
    """Say in the title how many directions are not seen, and the weakest one in words below."""
    condition = drawn[0][2].condition_number
    size = number(condition, 3) if condition is not None else "infinite"
    whose = f" ({drawn[0][1].label})" if len(drawn) > 1 else ""
    sentence = _sentence(drawn[0][2])
    layout: dict[str, Any] = {"hovermode": "closest", "barmode": "group", "legend": len(drawn) > 1}
    theme.dress(figure, title=f"{describe_weak(drawn[0][2])}{whose}; condition number {size}", height_px=520, **layout)
    figure.update_layout(margin={"b": 84 + 18 * sentence.count("<br>")})
    _scale(figure, drawn, row=1, col=1)
    figure.update_yaxes(title_text="times better than typical", row=1, col=1)
    _draw_threshold(figure, row=1, col=1)
    figure.update_yaxes(autorange="reversed", showgrid=False, row=2, col=1)
    figure.update_xaxes(showgrid=False, type="category")
    figure.update_xaxes(title_text="direction, best known to weakest", row=2, col=1)
    if sentence:
        figure.add_annotation(
            text=sentence, x=0, y=0, xref="paper", yref="paper", xanchor="left", yanchor="top", yshift=-42, align="left"
        )


def _scale(figure: go.Figure, drawn: Sequence[Part[Observability]], room: float = 0.5, **place: int) -> None:
    """Choose the decades of the log axis, each written as a table writes it."""
    low, high = _window(drawn, room)
    decades = [10.0**power for power in range(int(np.ceil(low)), int(np.floor(high - room)) + 1)]
    written = {"tickvals": decades, "ticktext": [number(decade, 1) for decade in decades]}
    figure.update_yaxes(type="log", range=[low, high], **written, **place)


def _draw_threshold(figure: go.Figure, **place: int) -> None:
    """Draw the value below which a direction is not seen, and say so."""
    figure.add_hline(y=THRESHOLD, line={**theme.LEVEL, "color": WEAK_COLOUR}, **place)
    beside = {"x": 1, "xref": "x domain", "xanchor": "left", "y": float(np.log10(THRESHOLD)), "yanchor": "middle"}
    words = f"below {THRESHOLD:g}:<br>weak<br>(over {WEAK:g}<br>typical σ)"
    figure.add_annotation(text=words, align="left", font={"color": WEAK_COLOUR}, showarrow=False, **beside, **place)


def draw_narrow(drawn: Sequence[Part[Observability]]) -> go.Figure:
    """Draw the same without numbers in the cells and words below, for which a phone has no room: the page's table has them."""
    figure = draw(drawn)
    figure.update_traces(texttemplate="", showscale=False, selector={"type": "heatmap"})
    figure.update_traces(text=None, selector={"type": "scatter"})
    figure.update_annotations(selector={"xref": "paper"}, text="")
    over_the_shortest = {"xanchor": "right", "y": 1, "yref": "y domain", "yanchor": "top"}
    words = f"dotted: below {THRESHOLD:g} (over {WEAK:g} typical σ), weak"
    figure.update_annotations(selector={"xref": "x domain"}, text=words, **over_the_shortest)
    return figure


def draw_small(drawn: Sequence[Part[Observability]]) -> go.Figure:
    """Draw the bars alone, each with the parameters that its direction is made of."""
    (trace, style, seen), figure = drawn[0], go.Figure()
    figure.add_trace(_bars(seen, style))
    _write_over_bars(figure, seen, _mixtures(trace.result, seen))
    theme.shrink(figure, l=50, t=4, r=54)
    _scale(figure, drawn[:1], room=1.1)
    figure.update_yaxes(title_text="typical σ / σ")
    figure.update_xaxes(title_text="direction, best known to weakest", type="category", showgrid=False, nticks=0)
    _draw_threshold(figure)
    figure.update_annotations(font={"size": 10, "color": WEAK_COLOUR})
    return figure


def _mixtures(result: Calibration, seen: Observability) -> list[str]:
    """Name the one or two parameters that each direction is mostly made of."""
    V = _vectors(seen)
    if V is None:
        return [""] * len(seen.singular_values)
    symbols = [quantity(name, result).markup for name in seen.parameter_names]
    told = []
    for shares in np.abs(V).T:
        largest = [place for place in np.argsort(-shares)[:2] if shares[place] >= NAMED]
        told.append("<br>+ ".join(symbols[place] for place in largest))
    return told


def _window(drawn: Sequence[Part[Observability]], room: float) -> list[float]:
    """Choose the decades of the log axis: every bar can be seen, the threshold too, and its label in the room above."""
    values = np.concatenate([seen.singular_values for _, _, seen in drawn])
    known = values[values > 0]
    low, high = float(np.min(known, initial=THRESHOLD)), float(np.max(known, initial=THRESHOLD))
    return [float(np.log10(low)) - 0.5, float(np.log10(high)) + room]


def _sentence(seen: Observability) -> str:
    words = theme.escape(typeset(seen.weakest.sentence))
    lines = textwrap.wrap(f"Weakest direction: {words}", 88) if words else []
    return set_symbols("<br>".join(lines), seen.parameter_names)


def table(seen: Observability) -> Table:
    """List one direction a row: singular value, sigma in typical sigmas, and the parameters' shares."""
    values = np.array(seen.singular_values, dtype=np.float64)
    with np.errstate(divide="ignore"):
        spread = np.where(values > 0, 1.0 / values, np.nan)
    columns: Table = {
        "direction": list(range(1, len(values) + 1)),
        "singular_value": list_known(values),
        "sigma_of_direction": list_known(spread),
    }
    V = _vectors(seen)
    if V is not None:
        columns |= {name: list_known(row) for name, row in zip(seen.parameter_names, V, strict=True)}
    return columns


OBSERVABILITY = make_figure(
    draw,
    table,
    read_observability,
    lambda _: "Not yet: observability is computed when the run ends.",
    name="observability",
    title="Observability",
    guide=(
        "Each column is one direction in parameter space: the bar (its singular value) shows by what factor the "
        "stars improve on the spread between sensors of this kind; the colours below are the parameters it mixes. "
        f"Below {THRESHOLD:g} (dotted), that is known to worse than {WEAK:g} typical σ, a direction is weak: amber and hatched."
    ),
    wide=True,
    forms={"small": draw_small, "narrow": draw_narrow},
)


_PARTS_THE_CENTRE = "stars far out on opposite sides of the detector: they separate the principal point from the tilts"
_PARTS_THE_FOCUS = "stars at all radii, near the centre and in the corners: they separate focal length from distortion"
ROLES = {
    name: one.role
    for camera in CAMERA_MODELS.values()
    for name, one in zip(camera.parameter_names, camera.parameters, strict=True)
}
#: Which data help, by what the parameters of the weakest direction do.
HELPFUL = {
    Role.FOCAL: _PARTS_THE_FOCUS,
    Role.RADIAL: _PARTS_THE_FOCUS,
    Role.ROW: _PARTS_THE_CENTRE,
    Role.COLUMN: _PARTS_THE_CENTRE,
    Role.TILT: _PARTS_THE_CENTRE,
    Role.DECENTRING: _PARTS_THE_CENTRE,
    Role.ASPECT: "pairs of stars along rows and along columns: they separate pixel aspect from focal length",
}


def weakest_words(result: Calibration) -> str:
    """Write the weakest direction as a sum of parameters, such as `0.82 m0 + 0.55 a2`; empty where it is not known."""
    shares = _shares(result)
    named = {name: share for name, share in shares.items() if abs(share) >= NAMED}
    terms = sorted(named.items(), key=lambda item: -abs(item[1]))
    text = " ".join(
        f"{'−' if share < 0 else '+'} {abs(share):.2f} {quantity(name, result).symbol}" for name, share in terms
    )
    return text.removeprefix("+ ")


def helpful_data(result: Calibration) -> list[str]:
    """Say in a sentence each which data would help the weakest direction most; none where observability is not known."""
    shares = _shares(result)
    if not shares:
        return []
    named = {name for name, share in shares.items() if abs(share) >= NAMED}
    roles = {ROLES[name] for name in named if name in ROLES}
    wanted = [f"Frames with {words}." for words in dict.fromkeys(HELPFUL[role] for role in HELPFUL if role in roles)]
    return [*wanted, *_reach(result), *_frames(result)]


def _shares(result: Calibration) -> Mapping[str, float]:
    direction = result.observability.weakest.direction if result.observability else {}
    return {name: share for name, share in direction.items() if share is not None}


def _reach(result: Calibration) -> list[str]:
    """Say where on the detector no star was."""
    said = []
    reached = result.radial.data_radius_px if result.radial else None
    corner = (result.radial.radius_px or [0.0])[-1] if result.radial else None
    if reached is not None and corner is not None and corner > 0 and reached < ENOUGH * corner:
        said.append(
            f"Stars reach only {percent(reached / corner, 0)} of the way to the farthest corner: add stars closer to the corner."
        )
    counts = np.array(result.coverage.counts if result.coverage else [], dtype=np.float64)
    empty = int((counts == 0).sum())
    if empty:
        said.append(
            f"{count(empty)} of {count(counts.size)} cells of the detector have no star: choose pointings that put stars there."
        )
    return said


def _frames(result: Calibration) -> list[str]:
    """Say how many frames like these would make the weakest direction known, by the square-root law."""
    spread, frames = result.observability.sigma_of_direction if result.observability else [], result.frames
    if not spread or not frames:
        return []
    if spread[-1] is None:
        return ["More frames like these would not determine the weakest direction either."]
    times = (spread[-1] / WEAK) ** 2
    if times <= 1:
        return ["Every direction is determined: more frames narrow all sigmas by the square root of their number."]
    if times > MOST_TIMES:
        return [f"More frames like these would not help enough: it would take {count(round(times))} times as many."]
    return [
        f"About {count(np.ceil(times * frames))} frames like these, instead of {count(frames)}, would also suffice."
    ]
