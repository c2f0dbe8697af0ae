"""Images of the documentation: figures of the example calibration and the chart of growth, drawn on white in Chromium."""

from __future__ import annotations

import base64
import dataclasses
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
import orjson
import plotly.graph_objects as go
from playwright.sync_api import Browser, sync_playwright
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from benchmarks import ROOT
from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.figures import CHAPTERS, FIGURES, Figure, figure_json
from boresight.figures.example_calibration import PLACE, get_example_calibrations
from boresight.figures.notebook import draw
from boresight.simulation.scenes import calibration_scenario, simulate, validation_scenario
from boresight.sky.catalogue import Catalogue, load_catalogue

DOCS = ROOT / "docs"
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
WIDTH_PX, WIDE_PX, GROWTH_PX = 640, 900, (860, 330)
DRAW = """([text, format, width]) => {
    const { data, layout } = JSON.parse(text);
    return Plotly.toImage({ data, layout }, { format, width, height: layout.height, scale: 1 });
}"""

#: The example: frames that calibrate and that judge it, of two seeds, in numbers of so many digits; and too few, of a third.
FRAMES, VALIDATION_FRAMES, TOO_FEW_FRAMES = 60, 30, 8
SEEDS, SEED_OF_FEW = (1, 2), 3
DIGITS = 7
HEAD = """# The figures

Every figure of Boresight is a pure function of a calibration's JSON: the same drawing stands on the run page, in the
report and, by one call, in a notebook:

```python
from boresight.figures.notebook import draw, table

draw("result.json", "radial")  # white; theme="dark" for the console's surface
draw({"batch": "batch.json", "filter": "filter.json"}, "rms")  # several over one another
table("result.json", "radial")  # the numbers behind it, in SI, as columns
```

`result.json` is what `boresight calibrate --json` writes. The images show simulated frames of one sensor; the page
`/gallery` of every installation has the same figures to hover over, in every state and theme. This page and its images
are written by `python -m benchmarks.pages --figures`.
"""


#: Figures that are shown of another example too: which one, and what is to be seen in it.
ALSO_SHOWN = {
    "observability": (
        "weak",
        (
            "Of eight frames alone, directions are weak: their bars are amber, hatched and below the dotted line, and the words "
            "name the parameters to use together, to hold fixed, or to observe with more frames."
        ),
    )
}


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
    shown = [(figure, "filter", "") for figure in FIGURES.values()]
    shown += [(FIGURES[name], of, of) for name, (of, _) in ALSO_SHOWN.items()]
    _write(_image(figure, example, also) for figure, example, also in shown)
    (DOCS / "figures.md").write_text(guide_page(), encoding="utf-8")


def _image(figure: Figure, example: str, also: str = "") -> tuple[str, str, int, Path]:
    """Return a figure of an example as JSON, with the format, width and place of its image."""
    drawn = figure_json(draw(get_example_calibrations()[example], figure.name)).decode()
    return drawn, "webp", WIDE_PX if figure.wide else WIDTH_PX, DOCS / name_image(figure, also)


@contextmanager
def chromium() -> Iterator[Browser]:
    """Open the Chromium that this machine has, or Playwright's own."""
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


def _write(drawings: Iterable[tuple[str, str, int, Path]]) -> None:
    """Draw figures, each given as JSON, in a format and a width, into files."""
    with chromium() as browser:
        page = browser.new_page()
        page.add_script_tag(content=get_plotlyjs())
        for text, form, width, path in drawings:
            head, _, content = page.evaluate(DRAW, [text, form, width]).partition(",")
            from_base64 = head.endswith("base64")
            path.write_bytes(base64.b64decode(content) if from_base64 else unquote_to_bytes(content))


def guide_page() -> str:
    """Write `docs/figures.md`: each figure by chapter, with its name, how to read it, and its image."""
    chapters = (f"## {name.capitalize()}\n\n{''.join(map(_entry, figures))}" for name, figures in CHAPTERS.items())
    return HEAD + "\n" + "\n".join(chapters)


def name_image(figure: Figure, also: str = "") -> str:
    """Name the image of a figure, beside the page; `also`: of which other example."""
    return f"figures/{figure.name}{f'-{also}' if also else ''}.webp"


def _entry(figure: Figure) -> str:
    guide = figure.guide.replace("<", "&lt;").replace(">", "&gt;")
    entry = f"### {figure.title}\n\n`{figure.name}`. {guide}\n\n![{figure.title}]({name_image(figure)})\n\n"
    if figure.name not in ALSO_SHOWN:
        return entry
    of, sentence = ALSO_SHOWN[figure.name]
    return f"{entry}{sentence}\n\n![{figure.title}: {of}]({name_image(figure, of)})\n\n"


def make_example_calibration(catalogue: Catalogue) -> bytes:
    """Calibrate a simulated sensor again and return the text of `example_calibration.json`."""
    scenario = dataclasses.replace(calibration_scenario(1), frames=FRAMES)
    validation_set = dataclasses.replace(validation_scenario(1), frames=VALIDATION_FRAMES)
    sets = [
        simulate(s, np.random.default_rng(k), catalogue) for s, k in zip((scenario, validation_set), SEEDS, strict=True)
    ]
    made = {
        name: calibrate(sets[0], scenario.sensor, catalogue, settings, validation=sets[1]).to_dict()
        for name, settings in (
            ("batch", CalibrationSettings()),
            ("filter", CalibrationSettings(method="sqrf", smooth=True)),
        )
    }
    made["weak"] = make_weak_calibration(catalogue)
    return orjson.dumps(_shortened(made)) + b"\n"


def make_weak_calibration(catalogue: Catalogue) -> dict[str, Any]:
    """Calibrate the same sensor with too few frames, so that directions are weak; without what is examined of it, to be small."""
    scenario = dataclasses.replace(calibration_scenario(1), frames=TOO_FEW_FRAMES)
    telemetry = simulate(scenario, np.random.default_rng(SEED_OF_FEW), catalogue)
    found = calibrate(telemetry, scenario.sensor, catalogue, CalibrationSettings())
    return dataclasses.replace(found, trust=None).to_dict()


def _shortened(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, dict):
        return {key: _shortened(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_shortened(item) for item in value]
    return value
