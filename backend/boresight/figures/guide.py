"""The guide to the figures as a page of the documentation: written from the registry, so it cannot tell of others."""

from __future__ import annotations

from boresight.figures import CHAPTERS
from boresight.figures.chart import Figure

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


def guide_page() -> str:
    """Write `docs/figures.md`: each figure by chapter, with its name, how to read it, and its image."""
    chapters = (f"## {name.capitalize()}\n\n{''.join(map(_entry, figures))}" for name, figures in CHAPTERS.items())
    return HEAD + "\n" + "\n".join(chapters)


def name_image(figure: Figure) -> str:
    """Name the image of a figure, beside the page."""
    return f"figures/{figure.name}.webp"


def _entry(figure: Figure) -> str:
    guide = figure.guide.replace("<", "&lt;").replace(">", "&gt;")
    return f"### {figure.title}\n\n`{figure.name}`. {guide}\n\n![{figure.title}]({name_image(figure)})\n\n"
