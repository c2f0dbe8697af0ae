"""Shadow mode drawn: the stars that baseline and candidate each match in every frame, and the frames that one alone solves.

The validation set is shown where the run has one, for it took no part in the estimate; else the calibration set. A frame that the
simulated check of the flight code does not accept counts no stars.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray
from boresight.calibration.calibration import ShadowAnswer, ShadowFrame, ShadowOfSet
from boresight.figures.chart import Table
from boresight.figures.factory import Part, make_figure
from boresight.figures.style import theme
from boresight.figures.style.thinning import keep_extremes
from boresight.figures.tables import find_shown_set
from boresight.verdicts.numbers import count

POINT_BUDGET = 6000  # of all runs and curves together
SIDES = ("baseline", "candidate")
ALONE = {
    "candidate": ("only the new parameters solve it", "triangle-up-open"),
    "baseline": ("only the old parameters solve it: lost", "x-thin-open"),
}


def draw(drawn: Sequence[Part[tuple[str, ShadowOfSet]]]) -> go.Figure:
    """Draw matched stars by frame, baseline in the reference's grey, each run's candidate in its colour."""
    figure = go.Figure()
    limit = POINT_BUDGET // (2 * len(drawn))
    for _, style, (_, view) in drawn:
        frame, stars = _frames(view), {side: _stars(view, side) for side in SIDES}
        kept = keep_extremes([stars["candidate"]], limit)
        if len(drawn) == 1:
            figure.add_trace(_baseline(frame[kept], stars["baseline"][kept]))
        hover = f"frame %{{x}}: %{{y}} stars<extra>{style.label}</extra>"
        named = {"name": "new parameters" if len(drawn) == 1 else style.label, "hovertemplate": hover}
        figure.add_trace(theme.line(style, frame[kept], stars["candidate"][kept], **named))
        for side in ALONE:
            figure.add_trace(_alone(style, view, side, limit // 4, single=len(drawn) == 1))
    theme.dress(figure, title=_headline(drawn), height_px=380, hovermode="closest")
    figure.update_xaxes(title_text="frame")
    figure.update_yaxes(title_text="matched stars", rangemode="tozero")
    return figure


def _answer(frame: ShadowFrame, side: str) -> ShadowAnswer:
    return frame.baseline if side == "baseline" else frame.candidate


def _frames(view: ShadowOfSet) -> FloatArray:
    return np.array([frame.frame for frame in view.frames], dtype=np.float64)


def _stars(view: ShadowOfSet, side: str) -> FloatArray:
    return np.array([_answer(frame, side).matched for frame in view.frames], dtype=np.float64)


def _baseline(frame: FloatArray, stars: FloatArray) -> go.Scatter:
    """Draw the old parameters as a reference that no run looks like."""
    return go.Scatter(
        x=theme.short(frame),
        y=theme.short(stars),
        mode="lines",
        name="old parameters",
        line={"color": theme.REFERENCE_COLOUR, "width": 1.2, "dash": "dot"},
        hovertemplate="frame %{x}: %{y} stars<extra>old parameters</extra>",
    )


def _alone(style: theme.RunStyle, view: ShadowOfSet, side: str, limit: int, *, single: bool) -> go.Scatter:
    """Mark the frames that one side alone solves, by a shape at its number of stars."""
    words, symbol = ALONE[side]
    other = SIDES[1 - SIDES.index(side)]
    places = [
        k for k, frame in enumerate(view.frames) if _answer(frame, side).valid and not _answer(frame, other).valid
    ]
    places = places[:: max(1, -(-len(places) // limit))]
    lost = side == "baseline"
    return go.Scatter(
        x=theme.short(_frames(view)[places]),
        y=theme.short(_stars(view, side)[places]),
        mode="markers",
        name=f"{words} ({len(places)})" if single else f"{style.label}: lost" if lost else style.label,
        legendgroup=None if single else style.label,
        showlegend=bool(places) and (single or lost),
        marker={
            "color": style.colour,
            "symbol": symbol,
            "size": 11 if lost else 6,
            "line": {"width": 2 if lost else 1, "color": style.colour},
        },
        hovertemplate=f"frame %{{x}}: {words}<extra>{style.label}</extra>",
    )


def _headline(drawn: Sequence[Part[tuple[str, ShadowOfSet]]]) -> str:
    if len(drawn) > 1:
        return f"Stars matched by frame, {len(drawn)} runs"
    name, view = drawn[0][2]
    summary = view.summary
    return (
        f"{name.capitalize()} set: {count(summary.candidate_only)} frames gained, {count(summary.baseline_only)} lost"
    )


def table(found: tuple[str, ShadowOfSet]) -> Table:
    """List one kept frame a row: valid or not and stars of both sides, why not, and the stars lost and gained."""
    frames = found[1].frames
    columns: Table = {"frame": [frame.frame for frame in frames], "time_utc": [frame.time_utc for frame in frames]}
    for side in SIDES:
        answers = [_answer(frame, side) for frame in frames]
        columns[f"{side}_valid"] = [answer.valid for answer in answers]
        columns[f"{side}_matched"] = [answer.matched for answer in answers]
        columns[f"{side}_reason"] = [answer.reason for answer in answers]
    columns["lost"] = [" ".join(map(str, frame.lost)) for frame in frames]
    columns["gained"] = [" ".join(map(str, frame.gained)) for frame in frames]
    return columns


SHADOW = make_figure(
    draw,
    table,
    find_shown_set,
    lambda _: "Not yet: old and new parameters are compared when the run ends.",
    name="shadow",
    title="Old and new parameters side by side",
    guide=(
        "Each frame is matched with the old and with the new parameters, and the lines count the stars that the simulated "
        "check of the flight code accepts; triangles are frames that only the new parameters solve, crosses frames that they "
        "would lose. New parameters worth flying are above the old ones everywhere and have no cross."
    ),
    wide=True,
    advanced=True,
)
