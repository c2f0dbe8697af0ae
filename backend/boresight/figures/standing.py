"""Figures inside a page that stands alone: the library, the data and the colours go into the file itself.

Everything that came from outside is escaped: in a script element only `<` could end it, so it is written as its JSON
escape. `figures/drawn_figures.html` is the part of the page that draws them.
"""

from __future__ import annotations

from collections.abc import Mapping

import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from boresight.figures.chart import figure_json
from boresight.figures.theme import LIGHT_TEMPLATE
from boresight.figures.tokens import TOKENS, declared


def standing(figures: Mapping[str, go.Figure]) -> dict[str, Markup]:
    """Return what a page that draws these figures by name needs: `plotly`, `figures_json`, and `tokens` of white paper."""
    for figure in figures.values():
        figure.update_layout(template=LIGHT_TEMPLATE, meta=None)
    text = ",".join(f'"{name}":{figure_json(figure).decode()}' for name, figure in figures.items())
    escaped = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return {
        "plotly": Markup(get_plotlyjs()),  # noqa: S704 - the library's own file, as its writer inlines it
        "figures_json": Markup("{" + escaped + "}"),  # noqa: S704 - escaped here
        "tokens": Markup(declared(TOKENS["light"])),  # noqa: S704 - the style sheet's own text
    }
