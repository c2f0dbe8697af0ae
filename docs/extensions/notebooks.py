"""Jupyter notebooks as pages: each is executed while the site is built, and shows what its cells returned just then.

With `-D execute_notebooks=0` cells are shown as they stand, for a build that only looks for wrong links and warnings.

A cell shows what it printed and the value of its last line: a Plotly figure as a drawing, what has an HTML form by that, and
everything else by its `repr`. Nothing of Jupyter is needed, and a cell that fails stops the build.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import plotly
from docutils import nodes
from myst_parser.parsers.sphinx_ import MystParser
from sphinx.application import Sphinx

PLOTLY = Path(str(plotly.__file__)).parent / "package_data" / "plotly.min.js"


def run_cell(source: str, names: dict[str, Any]) -> tuple[str, object]:
    """Run a cell in a namespace; return what it printed and the value of its last line, None where that is no expression."""
    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(tree, "notebook", "exec"), names)  # noqa: S102 - the notebook is ours
        value = None if last is None else eval(compile(ast.Expression(last.value), "notebook", "eval"), names)  # noqa: S307 - the same
    return printed.getvalue(), value


def show(value: object) -> str:
    """Return the value of a cell as Markdown."""
    if value is None:
        return ""
    if hasattr(value, "to_plotly_json"):
        text = value.to_json().replace("</", r"<\/")  # type: ignore[attr-defined]  # every Plotly figure has it
        data = f'<script type="application/json">{text}</script>'
        drawing = f'<div class="drawing" role="group" aria-label="The figure that this cell returned">{data}</div>'
        return f"\n``````{{raw}} html\n{drawing}\n``````\n"
    if hasattr(value, "_repr_html_"):
        return f'\n``````{{raw}} html\n<div class="output" tabindex="0">{value._repr_html_()}</div>\n``````\n'
    return _text(repr(value))


def _text(printed: str) -> str:
    return f"\n``````text\n{printed.rstrip()}\n``````\n" if printed.strip() else ""


def to_markdown(notebook: Mapping[str, Any], *, execute: bool) -> str:
    """Return a notebook as Markdown; where it is executed, in an empty folder and with its outputs."""
    parts: list[str] = []
    names: dict[str, Any] = {"__name__": "__main__"}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for cell in notebook["cells"]:
            source = "".join(cell["source"])
            if cell["cell_type"] == "markdown":
                parts.append(source)
                continue
            printed, value = run_cell(source, names) if execute else ("", None)
            parts += [f"``````python\n{source}\n``````", _text(printed), show(value)]
    return "\n\n".join(parts)


class NotebookParser(MystParser):
    """Reads a notebook as the Markdown that it is with its outputs."""

    supported = ("notebook",)

    def parse(self, inputstring: str, document: nodes.document) -> None:
        """Execute the notebook and parse what came of it."""
        super().parse(
            to_markdown(json.loads(inputstring), execute=bool(document.settings.env.config.execute_notebooks)), document
        )


def _add_drawings(app: Sphinx, *of_page: Any) -> None:
    """Ask for Plotly on pages that draw."""
    doctree = of_page[-1]
    if doctree is not None and any('class="drawing"' in node.astext() for node in doctree.findall(nodes.raw)):
        app.add_js_file("plotly.min.js", loading_method="defer")
        app.add_js_file("drawings.js", loading_method="defer")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the kind of source."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    app.add_config_value("execute_notebooks", default=True, rebuild="env", types=(bool, str))
    app.add_source_suffix(".ipynb", "notebook")
    app.add_source_parser(NotebookParser)
    app.connect("html-page-context", _add_drawings)
    app.connect("builder-inited", lambda app: app.config.html_static_path.append(str(PLOTLY)))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
