"""Write `docs/figures.md` and the images it shows: `python docs/draw.py`, with `--renew` after making the specimen anew.

The images are drawn on white by the machine's Chromium from `boresight.figures.specimen`, as the gallery draws them.
"""  # noqa: INP001 - a script, not a package

from __future__ import annotations

import base64
import shutil
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright
from plotly.offline import get_plotlyjs

from boresight.figures import FIGURES, WIDE, figure_json
from boresight.figures.guide import guide_page, image_of
from boresight.figures.notebook import draw
from boresight.figures.specimen import PLACE, make_specimen, specimens
from boresight.sky.catalogue import load_catalogue

DOCS = Path(__file__).resolve().parent
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
WIDTH_PX, WIDE_PX = 640, 900
DRAW = """([text, width]) => {
    const { data, layout } = JSON.parse(text);
    return Plotly.toImage({ data, layout }, { format: "webp", width, height: layout.height, scale: 1 });
}"""


def renew() -> None:
    """Calibrate the specimen anew."""
    with tempfile.TemporaryDirectory() as folder:
        PLACE.write_bytes(make_specimen(load_catalogue(Path(folder))))
    specimens.cache_clear()


def write_images() -> None:
    """Draw every figure, and forget the images of those that are no more."""
    shutil.rmtree(DOCS / "figures", ignore_errors=True)
    (DOCS / "figures").mkdir()
    program = next(filter(None, map(shutil.which, BROWSERS)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page()
        page.add_script_tag(content=get_plotlyjs())
        for figure in FIGURES.values():
            text = figure_json(draw(specimens()["filter"], figure.name)).decode()
            address = page.evaluate(DRAW, [text, WIDE_PX if figure.name in WIDE else WIDTH_PX])
            (DOCS / image_of(figure)).write_bytes(base64.b64decode(address.partition(",")[2]))
        browser.close()


if __name__ == "__main__":
    if "--renew" in sys.argv[1:]:
        renew()
    write_images()
    (DOCS / "figures.md").write_text(guide_page(), encoding="utf-8")
