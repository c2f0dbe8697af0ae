"""W Figures 3, 4, 6 and 8 as curves, judged by the conclusions that their text draws.

All show the first set of group 2 at 0.2 px. Figures 3 and 4: the smallest singular value of H W of single frames at the truth.
Figure 6: both criteria along the run. Figure 8, the paper's field experiment: the six parameters along the run, here simulated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.figures.style import theme
from boresight.papers.documents import Conclusion, Drawing, drawing, padded, styled_curves
from boresight.papers.wu.estimators import Record
from boresight.papers.wu.tables import NO_Q, Pooled
from boresight.simulation.sensors import WU_TRUTH

FIELD = ("no field data", "the night-sky images are not public; the run is simulated")
ORDER = ("f", "k2", "k1", "u0", "v0", "s")
#: Factor by which two histories may differ and still be called similar.
SIMILAR = 2.0
DRAWN_ONLY = (
    "unstated setting",
    "which stars make up the combinations of Models 1 to 3, and in what order, is drawn and not said",
)
LABELS = {
    ("svd-4-23", "full"): "SVD, full R",
    ("angular", "full"): "AD, full R",
    ("svd-4-23", "diagonal"): "SVD, diagonal R",
    ("angular", "diagonal"): "AD, diagonal R",
}


def drawings(pooled: Pooled) -> list[Drawing]:
    """Return every figure with its verdict."""
    seen = pooled.list_records("truth")[0]["observability"]
    return [_figure_3(seen), _figure_4(seen), *_figures_6(pooled), _figure_8(pooled)]


def _observed(seen: Record, key: str, labels: Sequence[str]) -> list[Drawing]:
    return [
        {"label": label, "frame": seen["frame"], "minimum_singular_value": values}
        for label, values in zip(labels, seen[key], strict=True)
    ]


def _figure_3(seen: Record) -> Drawing:
    curves = _observed(seen, "models", [f"Model {model}" for model in (1, 2, 3, 4)])
    values = _numbers(seen["models"])
    largest = np.bincount(np.argmax(values, axis=0), minlength=4) / values.shape[1]
    said = ", ".join(f"Model {model} in {100 * share:.0f} %" for model, share in enumerate(largest, 1))
    return drawing(
        "3", "Observability analysis of the models", "Model 4 has the largest minimum singular value in most frames.",
        Conclusion(bool(largest[3] > 0.5), f"largest: {said} of the frames.", *DRAWN_ONLY), curves,
    )  # fmt: skip


def _figure_4(seen: Record) -> Drawing:
    curves = _observed(seen, "values", ["σ1", "σ2", "σ3"])
    values = _numbers(seen["values"])
    worst = float(np.mean((values[0] < values[1]) & (values[0] < values[2])))
    return drawing(
        "4", "Observability analysis of the three singular values", "σ1 alone is observed worse than σ2 and σ3.",
        Conclusion(worst > 0.5, f"σ1 is the least in {100 * worst:.0f} % of the frames.", *NO_Q), curves,
    )  # fmt: skip


def _numbers(columns: Sequence[Sequence[float | None]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Curves as rows, none as zero, without the frames that no curve has."""
    values = np.array([[one or 0.0 for one in column] for column in columns])
    return np.asarray(values[:, values.any(axis=0)])


def _figures_6(pooled: Pooled) -> list[Drawing]:
    histories = {place: pooled.list_records(*place)[0]["history"] for place in LABELS}
    svd, angular = (np.array(histories[key, "full"]["A"]) for key in ("svd-4-23", "angular"))
    ratio = svd / angular
    ended = {place: history["B"][-1] for place, history in histories.items()}
    apart = max(ended.values()) / min(ended.values()) - 1
    similar = Conclusion(
        bool(ratio.max() <= SIMILAR and ratio.min() >= 1 / SIMILAR),
        f"with the full R criterion A of SVD is {ratio.min():.2f} to {ratio.max():.2f} times that of AD along the run.",
        *NO_Q,
    )
    same = Conclusion(apart <= 0.01, f"the ends of criterion B differ by {100 * apart:.2f} %.", *NO_Q)
    curves = {
        which: [
            {"label": LABELS[place], "frame": history["frame"], "criterion_arcsec": history[which]}
            for place, history in histories.items()
        ]
        for which in "AB"
    }
    return [
        drawing("6a", "Residual errors by criterion A, group 2", "Both methods converge at similar rates.", similar, curves["A"]),
        drawing("6b", "Residual errors by criterion B, group 2", "Both methods end at the same residual.", same, curves["B"]),
    ]  # fmt: skip


def _figure_8(pooled: Pooled) -> Drawing:
    history = pooled.list_records("svd-4-23")[0]["history"]
    states, sigmas = np.array(history["states"]), np.array(history["sigmas"], dtype=np.float64)
    curves = [
        {
            "label": symbol,
            "unit": unit,
            "truth": float(truth),
            "frame": history["frame"],
            "value": states[:, p].tolist(),
            "three_sigma": (3 * sigmas[:, p]).tolist(),
        }
        for p, (symbol, unit, truth) in enumerate(
            zip(PINHOLE_RADIAL.symbols, PINHOLE_RADIAL.units, WU_TRUTH, strict=True)
        )
    ]
    settled = dict(zip(PINHOLE_RADIAL.symbols, history["settled"], strict=True))
    ours = sorted(settled, key=lambda symbol: settled[symbol])
    said = ", ".join(f"{symbol} {settled[symbol]}" for symbol in ours)
    return drawing(
        "8", "Estimation results of the parameters", f"They converge in the order {', '.join(ORDER)} (printed: u0 twice).",
        Conclusion(tuple(ours) == ORDER, f"each stays within three of Table 1's precisions from frame: {said}.", *FIELD), curves,
    )  # fmt: skip


DECADE = 10


def draw_criteria(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw a reproduced Figure 6a or 6b: a criterion on the judging images along the run of each method.

    Frames run in decades, and so does a criterion that spans at least one: criterion B does not, and decades would leave its axis
    without a number.
    """
    figure = go.Figure()
    for style, x, y in styled_curves(drawing, "frame", "criterion_arcsec"):
        figure.add_trace(theme.line(style, x, y, hovertemplate=f"%{{y:.3f}}″<extra>{style.label}</extra>"))
    theme.dress(figure, title=f"Figure {drawing['number']}: mean RMS angle error of the judging images", height_px=380)
    values = [value for curve in drawing["curves"] for value in curve["criterion_arcsec"]]
    decades = {"type": "log", "dtick": 1} if max(values) >= DECADE * min(values) else {"type": "linear"}
    figure.update_yaxes(title_text="arcseconds", **decades)
    figure.update_xaxes(title_text="frame", type="log", dtick=1)
    return figure


def draw_observability(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw a reproduced Figure 3 or 4: the minimum singular value of single frames, by model or by singular value."""
    figure = go.Figure()
    for style, x, y in styled_curves(drawing, "frame", "minimum_singular_value"):
        hover = f"%{{y:.3g}}<extra>{style.label}</extra>"
        figure.add_trace(theme.line(style, x, y, connectgaps=False, hovertemplate=hover))
    theme.dress(figure, title=f"Figure {drawing['number']}: minimum singular value of H W", height_px=360)
    figure.update_yaxes(title_text="minimum singular value (rad)", type="log", exponentformat="power")
    figure.update_xaxes(title_text="frame")
    return figure


COLUMNS = 3
#: An axis holds the bounds from this frame on; before it they come from far away.
FIRST_FRAME = 5


def draw_parameters(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw the panels of a reproduced Figure 8: the six parameters along a run, with three-sigma bounds and the truth."""
    curves = drawing["curves"]
    names = [f"{curve['label']} ({curve['unit']})" for curve in curves]
    figure = make_subplots(rows=-(-len(curves) // COLUMNS), cols=COLUMNS, subplot_titles=names, horizontal_spacing=0.09)
    style = theme.label_styles(["SVD"])[0]
    for place, curve in enumerate(curves):
        row, column = place // COLUMNS + 1, place % COLUMNS + 1
        x, y, reach = (np.array(curve[key], dtype=np.float64) for key in ("frame", "value", "three_sigma"))
        figure.add_trace(theme.band(style, x, y - reach, y + reach), row=row, col=column)
        hover = f"%{{y:.7g}}<extra>{theme.escape(curve['label'])}</extra>"
        figure.add_trace(theme.line(style, x, y, hovertemplate=hover, showlegend=False), row=row, col=column)
        figure.add_hline(y=curve["truth"], line={"color": theme.TRUTH_COLOUR, "dash": "dot"}, row=row, col=column)
        shown = x >= min(FIRST_FRAME, x[-1])
        window = padded([*(y - reach)[shown], *(y + reach)[shown], curve["truth"]])
        figure.update_yaxes(range=window, row=row, col=column)
    theme.dress(figure, title="Figure 8: parameters along the run, ±3σ, and the truth", height_px=520, legend=False)
    figure.update_layout(hovermode="closest", margin={"t": 76})
    figure.update_xaxes(title_text="frame", type="log", dtick=1)
    return figure
