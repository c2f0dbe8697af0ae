"""Figures in a notebook: one call from a calibration to the drawing that the pages show.

>>> from boresight.figures.notebook import draw
>>> draw("result.json", "radial")                                        # doctest: +SKIP
>>> draw({"batch": "batch.json", "filter": result}, "convergence", theme="dark")  # doctest: +SKIP

What comes back is a `plotly.graph_objects.Figure`: a notebook shows it by itself, `.write_html` keeps it as a file, and
`table` gives the numbers behind it, in SI and never thinned, as columns for `pandas.DataFrame` or NumPy.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from boresight.calibration.calibration import Calibration, parse_calibration, read_calibration
from boresight.errors import RefusedInputError
from boresight.figures import FIGURES
from boresight.figures.chart import Figure, Table, Trace
from boresight.figures.style.theme import CONTRAST_TEMPLATE, DARK_TEMPLATE, LIGHT_TEMPLATE, TOKENS

TEMPLATES = {"light": LIGHT_TEMPLATE, "dark": DARK_TEMPLATE, "contrast": CONTRAST_TEMPLATE}
Source = Calibration | Mapping[str, Any] | str | Path


def draw(source: Source | Mapping[str, Source], name: str, *, theme: str = "light") -> go.Figure:
    """Draw a figure of a calibration, or of several over one another.

    Parameters
    ----------
    source
        A calibration, as `boresight.calibration.calibrate` returns it or as the path of the file that
        `boresight calibrate --json` wrote; several as {label: calibration}.
    name
        One of `boresight.figures.FIGURES`.
    theme
        `light` is white paper, `dark` and `contrast` are the console's.

    Raises
    ------
    RefusedInputError
        When a file cannot be read, is no calibration, or there is no such figure or theme.
    """
    if theme not in TEMPLATES:
        raise RefusedInputError(f"There is no theme {theme}; choose from {', '.join(TEMPLATES)}.", code="unknown-theme")
    return on_paper(_figure(name).draw(_traces(source)), theme)


def on_paper(figure: go.Figure, theme: str) -> go.Figure:
    """Give a figure the look of a theme, to stand alone."""
    surface = TOKENS[theme]["surface-1"]
    figure.update_layout(template=TEMPLATES[theme], paper_bgcolor=surface, plot_bgcolor=surface, meta=None)
    return figure


def table(source: Source, name: str) -> Table:
    """Return the numbers behind a figure as columns of one length, {column: values}; arguments and refusals as `draw`."""
    return _figure(name).table(_read(source))


def _figure(name: str) -> Figure:
    if name not in FIGURES:
        raise RefusedInputError(f"There is no figure {name}; choose from {', '.join(FIGURES)}.")
    return FIGURES[name]


def _traces(source: Source | Mapping[str, Source]) -> list[Trace]:
    """Name each calibration; a single one by its method."""
    if isinstance(source, Mapping) and source and "schema" not in source:
        return [Trace(label, _read(one)) for label, one in source.items()]
    result = _read(source)
    return [Trace(result.method or "run", result)]


def _read(source: Source) -> Calibration:
    """Read a calibration from a file or from its JSON, or take the one that is given."""
    if isinstance(source, Calibration):
        return source
    return read_calibration(source) if isinstance(source, str | Path) else parse_calibration(source)
