"""Every chart of the product, each a pure function of a calibration; `charts` lists them.

The list is loaded when it is first asked for: the tables of this package are printed by commands that draw nothing, and Plotly with
its templates takes a quarter of a second.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from boresight.figures.chart import Figure, Table, Trace, figure_json

if TYPE_CHECKING:
    from boresight.figures.charts import CHAPTERS, FIGURES, WIDE

__all__ = ["CHAPTERS", "FIGURES", "WIDE", "Figure", "Table", "Trace", "figure_json"]

_LISTED = ("CHAPTERS", "FIGURES", "WIDE")


def __getattr__(name: str) -> Any:
    """Load the charts when one of their lists is asked for."""
    if name not in _LISTED:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from boresight.figures import charts  # noqa: PLC0415 - only when a list is asked for

    return getattr(charts, name)
