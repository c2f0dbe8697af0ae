"""How the site is built: `make docs` runs Sphinx on this folder, strictly, with the extensions beside it."""

from __future__ import annotations

import sys
from pathlib import Path

import boresight

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "Boresight"
author = copyright = "The Boresight authors"  # noqa: A001 - Sphinx calls it so
version = release = boresight.__version__
language = "en"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "declared",
    "finish",
    "formulas",
    "notebooks",
]
exclude_patterns = ["extensions", "static"]
nitpicky = False
suppress_warnings: list[str] = []

myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 4
myst_dmath_double_inline = False

default_role = "code"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False

html_theme = "furo"
html_title = "Boresight"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_favicon = "../frontend/static/shared/mark.svg"
html_math_renderer = "katex"
html_show_sourcelink = False
html_copy_source = False
html_last_updated_fmt = None
html_domain_indices = False
html_use_index = False
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
