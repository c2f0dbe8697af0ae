"""What a drawing looks like from afar: so few cells that another font makes little difference, and a lost line much.

An example is cut out of a screenshot and its pixels are averaged over CELLS; kept is how far each cell is from the
surface it stands on, (cells_y, cells_x, 3), in levels of 255. Two such looks a (seen) and b (kept before) differ by

    ink    = sum |a - b| / sum |b|,                  what is drawn, and where,
    colour = sum_c |sum A - sum B| / sum |B|,        how much of each channel c that is not grey, wherever it is,

A = a - mean of its three channels. Where nothing is drawn any more both are 1. A look that hardly has colour is not
judged by it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Page

CELLS_X, CELLS_Y = 8, 6
SCALE = 0.25  # of the screenshot: the cells are coarser yet
LEAST_COLOUR = 0.5  # levels of 255, the mean of a cell
Look = np.ndarray[Any, np.dtype[np.float16]]

BOXES = """() => [...document.querySelectorAll("[data-example]")].map(element => {
    const drawn = element.querySelector(":scope > .figure-canvas:not([hidden])") ?? element;
    const { x, y, width, height } = drawn.getBoundingClientRect();
    return [element.dataset.example, [x + scrollX, y + scrollY, width, height]];
})"""
MEANS = """async ({ image, boxes, across, down }) => {
    const picture = await createImageBitmap(await (await fetch(image)).blob());
    const pen = new OffscreenCanvas(picture.width, picture.height).getContext("2d", { willReadFrequently: true });
    pen.drawImage(picture, 0, 0);
    return boxes.map(([left, top, width, height]) => {
        const { data } = pen.getImageData(left, top, width, height);
        const sums = Array.from({ length: down * across }, () => [0, 0, 0, 0]);
        for (let y = 0, at = 0; y < height; y += 1) {
            for (let x = 0; x < width; x += 1, at += 4) {
                const cell = sums[Math.floor(y * down / height) * across + Math.floor(x * across / width)];
                for (let k = 0; k < 3; k += 1) cell[k] += data[at + k];
                cell[3] += 1;
            }
        }
        return sums.map(([red, green, blue, count]) => [red / count, green / count, blue / count]);
    });
}"""


@dataclass(frozen=True)
class Seen:
    width: int
    height: int
    look: Look


def looks(page: Page, canvas: Page, surface: str) -> dict[str, Seen]:
    """Look at every example of a page.

    Parameters
    ----------
    page
        The gallery.
    canvas
        An empty page, whose policy lets a screenshot be measured in it.
    surface
        `#rrggbb`, what the examples stand on.
    """
    boxes = dict(page.evaluate(BOXES))
    places = [[round(side * SCALE) for side in box] for box in boxes.values()]
    asked = {"image": _photograph(page), "boxes": places, "across": CELLS_X, "down": CELLS_Y}
    ground = np.array([int(surface[i : i + 2], 16) for i in (1, 3, 5)])
    means = np.array(canvas.evaluate(MEANS, asked)).reshape(len(boxes), CELLS_Y, CELLS_X, 3) - ground
    return {
        name: Seen(round(box[2]), round(box[3]), mean.astype(np.float16))
        for (name, box), mean in zip(boxes.items(), means, strict=True)
    }


def _photograph(page: Page) -> str:
    width, height = page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
    link = page.context.new_cdp_session(page)
    clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": SCALE}
    taken = link.send("Page.captureScreenshot", {"format": "png", "clip": clip, "captureBeyondViewport": True})
    link.detach()
    return f"data:image/png;base64,{taken['data']}"


def ink(seen: Look, kept: Look) -> float:
    return float(np.abs(seen - kept).sum(dtype=float) / np.abs(kept).sum(dtype=float))


def colour(seen: Look, kept: Look) -> float:
    here, there = (look - look.mean(axis=-1, keepdims=True, dtype=float) for look in (seen, kept))
    moved = np.abs((here - there).sum(axis=(0, 1))).sum()
    return float(moved / np.abs(there).sum()) if np.abs(there).mean() > LEAST_COLOUR else 0.0


def write_looks(path: Path, seen: Mapping[str, Mapping[str, Seen]]) -> None:
    arrays = {}
    for page, found in seen.items():
        arrays[f"{page}-names"] = np.array(list(found))
        arrays[f"{page}-sizes"] = np.array([(one.width, one.height) for one in found.values()])
        arrays[f"{page}-looks"] = np.array([one.look for one in found.values()])
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, **arrays)


def read_looks(path: Path, page: str) -> dict[str, Seen]:
    with np.load(path) as kept:
        names, sizes, found = (kept[f"{page}-{key}"] for key in ("names", "sizes", "looks"))
    return {str(name): Seen(int(w), int(h), look) for name, (w, h), look in zip(names, sizes, found, strict=True)}
