"""Every script and style in a file of its own, so that the site runs under the console's policy, which allows no inline ones."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)
STYLE = re.compile(r"<style[^>]*>(.*?)</style>", re.DOTALL)


def externalise(page: str, place: Path, root: str) -> str:
    """Return a page whose inline scripts and styles are written to a folder, which the page reaches by `root`."""

    def write(text: str, ending: str) -> str:
        name = f"{hashlib.sha256(text.encode()).hexdigest()[:12]}{ending}"
        place.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(text, encoding="utf-8")
        return f"{root}_static/inline/{name}"

    page = SCRIPT.sub(lambda found: f'<script src="{write(found[1], ".js")}"></script>', page)
    return STYLE.sub(lambda found: f'<link rel="stylesheet" href="{write(found[1], ".css")}">', page)


def _externalise_all(app: Sphinx, error: Exception | None) -> None:
    if error is not None or app.builder.format != "html":
        return
    top = Path(app.outdir)
    for path in top.rglob("*.html"):
        root = "../" * (len(path.relative_to(top).parts) - 1)
        text = path.read_text(encoding="utf-8")
        path.write_text(externalise(text, top / "_static" / "inline", root), encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Move them when everything is written."""
    app.connect("build-finished", _externalise_all)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
