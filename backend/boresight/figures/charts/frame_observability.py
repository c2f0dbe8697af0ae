"""What single frames can tell: the smallest singular value of H' = H W frame by frame (W Figures 3 and 4).

H has one row a measured singular value, W the typical sigmas, so that a parameter error of one typical sigma in the worst
direction moves the measurements of that frame by the value drawn. Above are the star-combination models with sigma_2 and
sigma_3, below each singular value alone under Model 4. The rows are not weighed by their noise, nor are rows that repeat others
left out: W's measure ranks, and what is known after all frames is drawn beside it, in `reference_information`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.style import theme
from boresight.figures.style.axes import share_cursor
from boresight.figures.trust_parts import Part, column

TITLE = "Observability per frame"
KEY = "frame_observability"
NOT_YET = "Single frames are judged when the run ends; that is not there yet."
NEVER = "This result has no judgement of single frames: clone its run and start it again to have one."
MODELS = {f"model_{model}": f"Model {model}" for model in (1, 2, 3, 4)}
VALUES = {f"sigma_{k}": f"σ{k} alone" for k in (1, 2, 3)}
#: What stands for each row of panels where several runs are compared.
COMPARED = ("model_4", "sigma_2")
#: The window reaches so many times below the median; a double click shows all.
FARTHEST_BELOW = 300.0


def read_frame_judgement(result: Result) -> Result:
    """Read the judgement of single frames; empty where there is none."""
    return result.get(KEY) or {}


def absent(title: str, traces: Sequence[Trace]) -> go.Figure:
    """Draw nothing, and say why the first run has nothing."""
    result = traces[0].result
    sentence = read_frame_judgement(result).get("sentence") or (
        NOT_YET if result.get("status") in {None, "running"} else NEVER
    )
    return theme.missing(title, str(sentence))


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw every model and value of one run, or Model 4 and one value of several."""
    styled = zip(traces, theme.run_styles(traces), strict=True)
    drawn = [(trace, style, read_frame_judgement(trace.result)) for trace, style in styled if _measured(trace.result)]
    if not drawn:
        return absent(TITLE, traces)
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


def _window(drawn: Sequence[Part], names: Sequence[str]) -> list[float] | None:
    """Choose the decades of a log axis, so that a few frames that hardly determine anything do not flatten the others."""
    curves = [column(view["minimum_singular_value"].get(name)) for _, _, view in drawn for name in names]
    known = np.concatenate(curves)
    known = known[np.isfinite(known) & (known > 0)]
    if not len(known):
        return None
    low = max(float(known.min()), float(np.median(known)) / FARTHEST_BELOW)
    return [float(np.log10(low)) - 0.15, float(np.log10(known.max())) + 0.15]


def _measured(result: Result) -> bool:
    """Tell whether any frame determines all parameters under any choice."""
    curves = read_frame_judgement(result).get("minimum_singular_value") or {}
    return any(value is not None for curve in curves.values() for value in curve)


def _draw_run(figure: go.Figure, one: Part, names: dict[str, str], row: int, *, alone: bool) -> None:
    """Add one run's curves to a panel: all of them in colours of their own, or one in the colour of the run."""
    _, style, view = one
    frame = column(view["frame"])
    for place, (name, label) in enumerate(names.items()):
        if name not in view["minimum_singular_value"] or not (alone or name in COMPARED):
            continue
        own = style
        if alone:
            own = theme.RunStyle(
                label, theme.RUN_COLOURS[(place + len(MODELS) * (row - 1)) % len(theme.RUN_COLOURS)], "solid"
            )
        hover = f"frame %{{x}}: %{{y:.3g}}<extra>{label}{'' if alone else ', ' + style.label}</extra>"
        options = {
            "hovertemplate": hover,
            "showlegend": alone or row == 1,
            "connectgaps": False,
            "mode": "lines+markers",
        }
        curve = theme.line(own, frame, column(view["minimum_singular_value"][name]), **options)
        curve.update(line={"width": 1.1}, marker={"size": 3, "color": own.colour})
        figure.add_trace(curve, row=row, col=1)


def _headline(drawn: Sequence[Part]) -> str:
    """Say what is drawn, and of how many frames."""
    if len(drawn) > 1:
        return f"Minimum singular value by frame, {len(drawn)} runs"
    return f"Minimum singular value by frame{_spacing(drawn)}"


def _spacing(drawn: Sequence[Part]) -> str:
    """Say of how many frames the curves are, where it is not all of one run's."""
    view = drawn[0][2]
    used, frames = view.get("frames_used"), view.get("frames")
    return "" if len(drawn) > 1 or used == frames else f" ({used} spaced evenly over {frames})"


def table(result: Result) -> Table:
    """List one frame a row: the minimum singular value under each choice, per typical sigma."""
    view = read_frame_judgement(result)
    if not view.get("frame"):
        return {}
    curves: dict[str, FloatArray] = {name: column(values) for name, values in view["minimum_singular_value"].items()}
    columns: Table = {"frame": np.asarray(view["frame"]).tolist()}
    return columns | {name: theme.plain(values) for name, values in curves.items()}


FRAME_OBSERVABILITY = Figure(
    name="frame-observability",
    title=TITLE,
    guide=(
        "Each line is the smallest singular value of one frame's scaled Jacobian for one choice of star combinations (above) "
        "or of singular values (below): the higher, the further a parameter error moves what is measured, and a gap is a "
        "frame that cannot determine all parameters alone. It ranks frames and choices and is no measure of precision, for "
        "a row given twice counts twice; for that read the information of each reference."
    ),
    draw=draw,
    table=table,
)
