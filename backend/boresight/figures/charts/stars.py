"""Every star by itself: how far its mean residual is from zero in its own sigmas, over how often it was seen.

A wrong identity, an unresolved double or a bad catalogue position moves one star in every frame by the same amount: its
mean residual leaves zero while its neighbours' stay. z is that mean over its sigma, both directions together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from boresight.calibration.calibration import StarTrust, Trust
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.verdicts.numbers import count

LONGEST = 200


def draw(drawn: Sequence[Part[list[StarTrust]]]) -> go.Figure:
    """Draw one mark a star, a suspect as a diamond with its number."""
    figure = go.Figure([_points(one, labelled=len(drawn) == 1) for one in drawn])
    theme.dress(figure, title=_headline(drawn), height_px=400, legend=len(drawn) > 1, hovermode="closest")
    figure.update_xaxes(title_text="sightings", type="log", dtick="D2", tickformat="~s")
    figure.update_yaxes(title_text="mean residual (σ of the mean)", rangemode="tozero")
    return figure


def _points(one: Part[list[StarTrust]], *, labelled: bool) -> go.Scatter:
    _, style, part = one
    rows = part[:LONGEST]
    suspect = np.array([row.suspect for row in rows])
    residual = column([[row.mean_residual_px, row.rms_px] for row in rows])
    ids = [str(row.star_id) for row in rows]
    words = [name if out and labelled else "" for name, out in zip(ids, suspect, strict=True)]
    return go.Scatter(
        x=theme.short(column([row.sightings for row in rows])),
        y=theme.short(np.abs(column([row.z for row in rows]))),
        mode="markers+text" if any(words) else "markers",
        text=words,
        textposition="top center",
        textfont={"size": 10},
        name=style.label,
        customdata=[[name, *values] for name, values in zip(ids, theme.short(residual).tolist(), strict=True)],
        marker={
            "color": style.colour,
            "line": {"width": 1.2, "color": style.colour},
            "size": np.where(suspect, 10, 6).astype(np.int8),
            "symbol": ["diamond" if out else "circle-open" for out in suspect],
        },
        hovertemplate=(
            "HIP %{customdata[0]}: %{y:.3g} σ in %{x} sightings<br>mean %{customdata[1]:.3f} px, RMS %{customdata[2]:.3f}"
            f" px<extra>{style.label}</extra>"
        ),
    )


def _headline(drawn: Sequence[Part[list[StarTrust]]]) -> str:
    if len(drawn) > 1:
        return f"Mean residual of each star, {len(drawn)} runs; a diamond is a suspect"
    trace, _, part = drawn[0]
    trust = trace.result.trust or Trust()
    suspects, in_all = trust.suspects, trust.stars_in_all or len(part)
    word = (
        "no star is suspect"
        if not suspects
        else f"{count(len(suspects))} of {count(in_all)} stars are suspect (diamonds)"
    )
    return word[0].upper() + word[1:]


def table(part: list[StarTrust]) -> Table:
    """List one star a row, the worst first: sightings, mean residual and RMS in px, z, and what it is suspected of."""
    keys = ("star_id", "sightings", "mean_residual_px", "rms_px", "z", "suspect")
    columns: Table = {key: [getattr(row, key) for row in part] for key in keys}
    return columns | {"flags": [" ".join(row.flags) for row in part]}


STARS = part_figure(
    draw,
    table,
    "stars",
    name="stars",
    title="Star by star",
    guide=(
        "Each mark is one star: how often it was seen, and how many sigmas its mean residual is from zero; a diamond with "
        "its Hipparcos number is a suspect. One star far above the others is a wrong identity, a double or a wrong position: "
        "flag it; many such stars indicate a fault of the model."
    ),
    wide=True,
    advanced=True,
)
