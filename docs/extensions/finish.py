"""The last touch to each page: scripts and styles in files of their own, and what people without a mouse or a screen need.

The console's policy allows no inline script and no inline style, so those of the theme become files. What scrolls by itself can be
reached by keyboard, headings have a level, and regions of one kind have names of their own.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)
#: What the theme writes, and what stands in its place.
CORRECTED = (
    ('class="caption" role="heading"', 'class="caption" role="heading" aria-level="2"'),
    ('<aside class="sidebar-drawer">', '<aside class="sidebar-drawer" aria-label="Site">'),
    ('<aside class="toc-drawer">', '<aside class="toc-drawer" aria-label="On this page">'),
    ('<aside class="toc-drawer no-toc">', '<aside class="toc-drawer no-toc" aria-label="On this page">'),
    ("<pre>", '<pre tabindex="0">'),
    ('<div class="table-wrapper ', '<div tabindex="0" class="table-wrapper '),
)
STYLE = re.compile(r"<style[^>]*>(.*?)</style>", re.DOTALL)


def finish(page: str, place: Path, root: str) -> str:
    """Return a page as it is served; its inline scripts and styles are written to a folder that it reaches by `root`."""

    def write(text: str, ending: str) -> str:
        name = f"{hashlib.sha256(text.encode()).hexdigest()[:12]}{ending}"
        place.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(text, encoding="utf-8")
        return f"{root}_static/inline/{name}"

    for written, corrected in CORRECTED:
        page = page.replace(written, corrected)
    page = SCRIPT.sub(lambda found: f'<script src="{write(found[1], ".js")}"></script>', page)
    return STYLE.sub(lambda found: f'<link rel="stylesheet" href="{write(found[1], ".css")}">', page)


def _finish_all(app: Sphinx, error: Exception | None) -> None:
    if error is not None or app.builder.format != "html":
        return
    top = Path(app.outdir)
    for path in top.rglob("*.html"):
        root = "../" * (len(path.relative_to(top).parts) - 1)
        text = path.read_text(encoding="utf-8")
        path.write_text(finish(text, top / "_static" / "inline", root), encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Do so when everything is written."""
    app.connect("build-finished", _finish_all)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
