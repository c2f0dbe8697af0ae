"""The tokens of the style sheet: one source of colour for pages, plots and reports.

`frontend/static/shared/style.css` declares every colour and letter size as a custom property, in one block a theme. A theme is
the block `:root`, which is the dark one, overlaid by its own; paper has the block inside `@media print`. The contrast of
two colours is that of WCAG 2.2: with the relative luminance L = 0.2126 R + 0.7152 G + 0.0722 B of linear sRGB channels,

    contrast = (L_high + 0.05) / (L_low + 0.05).
"""

from __future__ import annotations

import re

from boresight.resources import folder

Tokens = dict[str, str]

THEMES = ("dark", "light", "contrast", "print")
PANELS = ("surface-1", "surface-2")  # what a plot may stand on

_BLOCK = re.compile(r"^\s*(:root[^{]*?)\s*\{([^}]*)\}", re.MULTILINE)
_PROPERTY = re.compile(r"--([\w-]+):\s*([^;]+);")
_THEME_OF = {":root": "dark", ":root, :root[data-theme]": "print"}


def read_themes(css: str) -> dict[str, Tokens]:
    """Read the tokens of every theme, {theme: {name: value}}.

    Parameters
    ----------
    css
        The text of the style sheet.

    Raises
    ------
    ValueError
        When a theme of `THEMES` has no block.
    """
    blocks: dict[str, Tokens] = {}
    for selector, body in _BLOCK.findall(css):
        named = re.fullmatch(r':root\[data-theme="(\w+)"\]', selector)
        theme = named[1] if named else _THEME_OF.get(selector)
        if theme:
            blocks.setdefault(theme, {}).update(_PROPERTY.findall(body))
    if missing := [theme for theme in THEMES if theme not in blocks]:
        raise ValueError(f"Expected the themes {', '.join(THEMES)}; received a style sheet without {missing[0]}")
    return {theme: blocks["dark"] | blocks[theme] for theme in THEMES}


def luminance(colour: str) -> float:
    """Return the relative luminance of `#rrggbb`, 0 black to 1 white."""
    channels = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    """Return the contrast of two colours, 1 to 21, whichever is the letter and whichever the ground."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def declared(tokens: Tokens) -> str:
    """Write tokens as declarations, for the style element of a file that stands alone."""
    return " ".join(f"--{name}: {value};" for name, value in tokens.items())


TOKENS = read_themes((folder("frontend") / "static" / "shared" / "style.css").read_text(encoding="utf-8"))
