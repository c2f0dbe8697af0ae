"""Images of the documentation: every figure of a specimen, and the chart of growth, drawn on white by Plotly in Chromium."""

from __future__ import annotations

import base64
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import plotly.graph_objects as go
from playwright.sync_api import sync_playwright
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from benchmarks import ROOT
from boresight.figures import FIGURES, WIDE, figure_json
from boresight.figures.example_calibration import PLACE, get_example_calibrations, make_example_calibration
from boresight.figures.guide import guide_page, name_image
from boresight.figures.notebook import draw
from boresight.sky.catalogue import load_catalogue

DOCS = ROOT / "docs"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
WIDTH_PX, WIDE_PX, GROWTH_PX = 640, 900, (860, 330)
DRAW = """([text, format, width]) => {
    const { data, layout } = JSON.parse(text);
    return Plotly.toImage({ data, layout }, { format, width, height: layout.height, scale: 1 });
}"""


def growth_figure(document: Mapping[str, Any]) -> go.Figure:
    """Draw time and memory of a whole calibration over its frames, on log axes: what the part `growth` found."""
    figure = make_subplots(1, 2, subplot_titles=("wall time, s", "peak resident memory, MB"))
    for method, rows in document.get("growth", {}).get("found", {"runs": {}})["runs"].items():
        frames, colour = [row["frames"] for row in rows], {"batch": "#1f5fa8"}.get(method, "#b4551d")
        for place, key in enumerate(("seconds", "peak_mb"), 1):
            line = go.Scatter(
                x=frames, y=[row[key] for row in rows], name=method, line_color=colour, showlegend=place == 1
            )
            figure.add_trace(line, 1, place)
    figure.update_xaxes(type="log", title_text="frames", dtick=1, showgrid=True)
    figure.update_yaxes(type="log", dtick=1, col=1)
    figure.update_yaxes(rangemode="tozero", col=2)
    margins = {"l": 50, "r": 20, "t": 40, "b": 50}
    figure.update_layout(template="plotly_white", width=GROWTH_PX[0], height=GROWTH_PX[1], margin=margins)
    return figure


def draw_growth(document: Mapping[str, Any]) -> None:
    """Write the chart of growth."""
    _write([(growth_figure(document).to_json(), "svg", GROWTH_PX[0], DOCS / "benchmarks-growth.svg")])


def write_figures(*, renew: bool) -> None:
    """Write the page of figures and its images, forgetting those of figures that are no more."""
    if renew:
        with tempfile.TemporaryDirectory() as folder:
            PLACE.write_bytes(make_example_calibration(load_catalogue(Path(folder))))
        get_example_calibrations.cache_clear()
    shutil.rmtree(DOCS / "figures", ignore_errors=True)
    (DOCS / "figures").mkdir()
    _write(
        (
            figure_json(draw(get_example_calibrations()["filter"], figure.name)).decode(),
            "webp",
            WIDE_PX if figure.name in WIDE else WIDTH_PX,
            DOCS / name_image(figure),
        )
        for figure in FIGURES.values()
    )
    (DOCS / "figures.md").write_text(guide_page(), encoding="utf-8")


def _write(drawings: Iterable[tuple[str, str, int, Path]]) -> None:
    """Draw figures, each given as JSON, in a format and a width, into files."""
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page()
        page.add_script_tag(content=get_plotlyjs())
        for text, form, width, path in drawings:
            head, _, content = page.evaluate(DRAW, [text, form, width]).partition(",")
            from_base64 = head.endswith("base64")
            path.write_bytes(base64.b64decode(content) if from_base64 else unquote_to_bytes(content))
        browser.close()
