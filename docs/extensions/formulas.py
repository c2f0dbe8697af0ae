"""Formulas set by KaTeX while the site is built: the pages hold finished HTML and MathML, and need no script and no network.

All formulas of all pages go through one process of Node, each once. A formula that KaTeX refuses stops the build.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.errors import ExtensionError
from sphinx.util.math import get_node_equation_number
from sphinx.writers.html5 import HTML5Translator

FRONTEND = Path(__file__).resolve().parents[2] / "frontend"
KATEX = FRONTEND / "node_modules" / "katex" / "dist"
SET = """
const katex = require(process.argv[1]);
const formulas = JSON.parse(require("fs").readFileSync(0, "utf8"));
const set = ([tex, displayMode]) => {
  try {
    return { html: katex.renderToString(tex, { displayMode, strict: "error", trust: false }) };
  } catch (error) {
    return { error: String(error.message) };
  }
};
console.log(JSON.stringify(formulas.map(set)));
"""

Formula = tuple[str, bool]


def find_node() -> str:
    """Return the program that runs KaTeX: the one of this environment, else the machine's."""
    beside = shutil.which("node", path=str(Path(sys.executable).parent))
    found = beside or shutil.which("node")
    if found is None:
        raise ExtensionError("There is no node here to set formulas with: install requirements-docs.lock.")
    return found


def render(formulas: Iterable[Formula]) -> dict[Formula, str]:
    """Set formulas (TeX, whether on lines of their own) as HTML."""
    wanted = sorted(set(formulas))
    if not wanted:
        return {}
    if not KATEX.is_dir():
        raise ExtensionError("KaTeX is not installed: run make docs, or npm ci in the folder frontend.")
    done = subprocess.run(  # noqa: S603 - our own script
        [find_node(), "-e", SET, str(KATEX / "katex.js")],
        input=json.dumps(wanted), capture_output=True, text=True, check=True,
    )  # fmt: skip
    answers = json.loads(done.stdout)
    refused = [f"{tex}: {one['error']}" for (tex, _), one in zip(wanted, answers, strict=True) if "error" in one]
    if refused:
        raise ExtensionError("Correct these formulas:\n" + "\n".join(refused))
    return {formula: one["html"] for formula, one in zip(wanted, answers, strict=True)}


def _formula(node: nodes.math | nodes.math_block) -> Formula:
    text = node.astext().strip()
    if isinstance(node, nodes.math):
        return text, False
    return (rf"\begin{{aligned}}{text}\end{{aligned}}" if "&" in text and r"\begin" not in text else text), True


def _set_all(app: Sphinx, env: BuildEnvironment) -> None:
    """Set the formulas of every page, before the pages are written."""
    found = (
        _formula(node)
        for name in env.found_docs
        for node in env.get_doctree(name).findall(lambda node: isinstance(node, nodes.math | nodes.math_block))
    )
    app.builder.formulas = render(found)  # type: ignore[attr-defined]  # read by the two below


def _inline(self: HTML5Translator, node: nodes.math) -> None:
    self.body.append(self.builder.formulas[_formula(node)])  # type: ignore[attr-defined]  # set above
    raise nodes.SkipNode


def _block(self: HTML5Translator, node: nodes.math_block) -> None:
    number = ""
    if node.get("number"):
        number = f'<span class="eqno">({get_node_equation_number(self, node)})</span>'
    name = f' id="{node["ids"][0]}"' if node["ids"] else ""
    html = self.builder.formulas[_formula(node)]  # type: ignore[attr-defined]  # set above
    self.body.append(f'<div class="formula" tabindex="0" role="math"{name}>{html}{number}</div>\n')
    raise nodes.SkipNode


def _copy_style(app: Sphinx, error: Exception | None) -> None:
    """Put KaTeX's style and fonts beside the pages."""
    if error is None and app.builder.format == "html":
        place = Path(app.outdir) / "_static" / "katex"
        shutil.copytree(
            KATEX / "fonts",
            place / "fonts",
            dirs_exist_ok=True,
            ignore=lambda _, names: [name for name in names if not name.endswith(".woff2")],
        )
        shutil.copy(KATEX / "katex.min.css", place)


def _add_style(app: Sphinx, *of_page: Any) -> None:
    """Ask for the style on pages that have formulas."""
    doctree = of_page[-1]
    if doctree is not None and any(doctree.findall(lambda node: isinstance(node, nodes.math | nodes.math_block))):
        app.add_css_file("katex/katex.min.css")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer."""
    app.add_html_math_renderer("katex", inline_renderers=(_inline, None), block_renderers=(_block, None))
    app.connect("env-check-consistency", _set_all)
    app.connect("html-page-context", _add_style)
    app.connect("build-finished", _copy_style)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
