"""The error on held-out frames of every candidate of a choice, by how many parameters it frees."""

from __future__ import annotations

import plotly.graph_objects as go

from boresight.calibration.choice.result import Candidate, Choice
from boresight.figures.chart import Table
from boresight.figures.style import theme

NAME = "held-out"
TITLE = "Error on held-out frames"
GUIDE = (
    "Each mark is a candidate model's RMS arc error on frames that it was not fitted to, with its 95 % interval, by its number of "
    "free parameters; the ring is the chosen one. Adding a term that the lens really has reduces the error; further "
    "terms leave it unchanged. All candidate models use the same frames, so a step is more significant than the intervals "
    "suggest. The choice is not based on this error."
)


def draw(choice: Choice) -> go.Figure:
    """Draw the held-out error of every candidate, a colour a camera."""
    title = f"RMS arc error on held-out frames; {choice.chosen.camera_model} is chosen"
    if not any(one.held_out_rms_arc_rad for one in choice.models):
        return theme.missing(TITLE, "With one frame alone nothing can be held out: give a validation set.")
    figure = go.Figure()
    names = list(dict.fromkeys(one.camera_model for one in (*choice.list_cameras(), *choice.models)))
    for style in theme.label_styles(names):
        _marks(figure, [one for one in choice.models if one.camera_model == style.label], style)
    chosen = choice.model
    if chosen.held_out_rms_arc_rad is not None:
        ring = {"symbol": "circle-open", "size": 16, "color": theme.REFERENCE_COLOUR, "line": {"width": 2}}
        figure.add_scatter(
            x=[len(chosen.free)], y=[1e6 * chosen.held_out_rms_arc_rad], mode="markers", marker=ring, name="chosen",
            hoverinfo="skip",
        )  # fmt: skip
    theme.dress(figure, title=title, height_px=380, hovermode="closest")
    figure.update_xaxes(title_text="free parameters", dtick=1)
    figure.update_yaxes(title_text="held-out RMS (µrad)", type="log")
    return figure


def _marks(figure: go.Figure, candidates: list[Candidate], style: theme.RunStyle) -> None:
    """Draw a camera's candidates that have a score, fewer parameters first."""
    scored = [
        (len(one.free), one.held_out_rms_arc_rad, one.held_out_interval_rad or [None, None], ", ".join(one.terms))
        for one in sorted(candidates, key=lambda one: len(one.free))
        if one.held_out_rms_arc_rad is not None
    ]
    above = [1e6 * ((high or value) - value) for _, value, (_, high), _ in scored]
    below = [1e6 * (value - (low or value)) for _, value, (low, _), _ in scored]
    figure.add_scatter(
        x=[free for free, *_ in scored],
        y=[1e6 * value for _, value, _, _ in scored],
        error_y={**theme.error_bars(above, style.colour), "arrayminus": below, "symmetric": False},
        text=[terms or "focal length alone" for *_, terms in scored],
        mode="markers",
        marker={"color": style.colour, "size": 7},
        name=style.label,
        hovertemplate="%{text}<br>%{y:.4g} µrad<extra>" + theme.escape(style.label) + "</extra>",
    )


def table(choice: Choice) -> Table:
    """List every candidate with its error on held-out frames, SI."""
    intervals = [one.held_out_interval_rad or [None, None] for one in choice.models]
    return {
        "camera_model": [one.camera_model for one in choice.models],
        "free": [" ".join(one.free) for one in choice.models],
        "chosen": ["yes" if one is choice.model else "no" for one in choice.models],
        "rms_arc_rad": [one.rms_arc_rad for one in choice.models],
        "held_out_rms_arc_rad": [one.held_out_rms_arc_rad for one in choice.models],
        "held_out_low_rad": [low for low, _ in intervals],
        "held_out_high_rad": [high for _, high in intervals],
    }
