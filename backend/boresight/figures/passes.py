"""What varies from pass to pass of a joint calibration: every value with its sigma, over the passes."""

from __future__ import annotations

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.calibration.calibration import Calibration, PassVariation
from boresight.figures.chart import Table
from boresight.figures.factory import column
from boresight.figures.style import theme
from boresight.verdicts.numbers import quantity

NAME = "passes"
TITLE = "Parameters from pass to pass"
GUIDE = (
    "Each mark is a parameter in one pass relative to its value in the last pass, with ±3σ bars. Passes are placed at their start "
    "time, or by number if any has no time. Parameters that move by many bars have changed; those that stay within their bars can "
    "share one value."
)
PANEL_HEIGHT_PX = 190


def draw(result: Calibration) -> go.Figure:
    """Draw a panel a varied parameter."""
    found = result.variation
    if found is None or not found.states:
        return theme.missing(TITLE, "No parameter varies from pass to pass: clone the run and name some to vary.")
    figure = make_subplots(len(found.vary), 1, shared_xaxes=True, vertical_spacing=0.3 / len(found.vary) ** 1.3)
    style = theme.label_styles([result.sensor])[0]
    where, title = _places(result, found)
    for row, name in enumerate(found.vary, 1):
        item = quantity(name, result)
        moved, sigma = (item.factor * column(each) for each in _departures(found, name))
        figure.add_scatter(
            x=where, y=theme.short(moved), mode="lines+markers", name=item.symbol,
            line={"color": theme.translucent(style.colour, 0.4), "width": 1}, marker={"color": style.colour, "size": 7},
            error_y=theme.error_bars(theme.short(3 * sigma), style.colour), text=[state.name for state in found.states],
            customdata=theme.short(sigma), row=row, col=1,
            hovertemplate=f"%{{text}}: %{{y:+.4g}} ±%{{customdata:.3g}} {item.unit} (σ)<extra></extra>",
        )  # fmt: skip
        unit = f" ({item.unit})" if item.unit else ""
        figure.update_yaxes(title_text=f"Δ{item.markup}{unit}", row=row, col=1)
    height = 110 + PANEL_HEIGHT_PX * len(found.vary)
    theme.dress(figure, title=_headline(found), height_px=height, legend=False, hovermode="closest")
    figure.update_xaxes(title_text=title, row=len(found.vary), col=1)
    return figure


def _places(result: Calibration, found: PassVariation) -> tuple[list[str | int], str]:
    """Return where the passes stand on the axis, and its title."""
    times = [one.start_utc for one in result.inputs.passes]
    if len(times) == len(found.states) and all(times):
        return [str(time).removesuffix("Z") for time in times], "start of the pass (UTC)"
    return list(range(1, len(found.states) + 1)), "pass"


def _departures(found: PassVariation, name: str) -> tuple[list[float], list[float]]:
    """Return a parameter in every pass less that in the last, and its sigma there, SI."""
    last = found.states[-1].parameters[name]
    return [state.parameters[name] - last for state in found.states], [state.sigma[name] for state in found.states]


def _headline(found: PassVariation) -> str:
    if found.test is None:
        return f"{len(found.states)} passes, a random walk from one to the next"
    return f"{len(found.states)} passes; test for no variation: p = {found.test.p_value:.2g}"


def table(result: Calibration) -> Table:
    """List every pass with its size and its chi-square, and the parameters that vary with their sigmas, SI."""
    passes, found = result.inputs.passes, result.variation
    told: Table = {
        "pass": [one.name for one in passes],
        "start_utc": [one.start_utc for one in passes],
        "frames": [one.frames for one in passes],
        "stars": [one.stars for one in passes],
        "pairs": [one.pairs for one in passes],
        "chi2": [one.chi2 for one in passes],
        "temperature_c": [one.temperature_c for one in passes],
    }
    for name in found.vary if found else ():
        told[name] = [state.parameters[name] for state in found.states] if found else []
        told[f"sigma_{name}"] = [state.sigma[name] for state in found.states] if found else []
    return told
