"""Measure, and write `docs/benchmarks.md` and `docs/capacity.md` with the chart they show: `make bench`.

    python -m benchmarks.pages                  every part at full size (an hour of an idle machine), then the pages
    python -m benchmarks.pages --part queue     one part again, the others as they are stored
    python -m benchmarks.pages --take A B       take the parts that `python -m benchmarks --json A` measured, then those of B
    python -m benchmarks.pages --write          only the pages, from what is stored, and no chart
    python -m benchmarks.pages --figures        `docs/figures.md` and its images; with --renew after making the examplen again

What was measured is stored in `docs/benchmarks.json`, each part with the machine that measured it, rounded to five digits.
"""

from __future__ import annotations

import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import click
import orjson

from benchmarks import PARTS
from benchmarks.__main__ import run
from benchmarks.pages import benchmarks, capacity
from benchmarks.pages.drawings import DOCS, draw_growth, write_figures

STORED = DOCS / "benchmarks.json"
DIGITS = 5
#: Longer lists are series for a machine, not figures for a page.
LONGEST_LIST = 48


def stored() -> dict[str, Any]:
    """Parts measured so far: name -> {machine, found}."""
    found: dict[str, Any] = orjson.loads(STORED.read_bytes()) if STORED.exists() else {}
    return found


def _slim(value: Any) -> Any:
    """Round numbers, and leave out what is too long for a page."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {
            key: _slim(one) for key, one in value.items() if not (isinstance(one, list) and len(one) > LONGEST_LIST)
        }
    return [_slim(one) for one in value] if isinstance(value, list) else value


def take(file: Path) -> None:
    """Keep the parts of a measured document in place of those that are stored; a part that failed replaces none."""
    document, kept = orjson.loads(file.read_bytes()), stored()
    for name in PARTS:
        if "failed" not in document.get(name, {"failed": "not there"}):
            kept[name] = {"machine": document["machine"], "found": _slim(document[name])}
    ordered = {name: kept[name] for name in PARTS if name in kept}
    STORED.write_bytes(orjson.dumps(ordered, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))


def pages() -> dict[str, str]:
    """The pages, by name."""
    document = stored()
    return {"benchmarks.md": benchmarks.page(document), "capacity.md": capacity.page(document)}


@click.command(help=__doc__)
@click.option(
    "--part", "parts", multiple=True, type=click.Choice(list(PARTS)), help="Measure this part only; repeat it."
)
@click.option("--take", "taking", is_flag=True, help="Take measured FILES instead of measuring.")
@click.option("--write", is_flag=True, help="Write the pages from what is stored.")
@click.option("--figures", is_flag=True, help="Write the page of figures and its images.")
@click.option("--renew", is_flag=True, help="Make the example calibration again that the figures show.")
@click.argument("files", nargs=-1, type=click.Path(exists=True, path_type=Path))
def main(
    *, parts: tuple[str, ...], taking: bool, write: bool, figures: bool, renew: bool, files: tuple[Path, ...]
) -> None:
    """Measure what is asked for, and write."""
    if taking != bool(files):
        raise click.UsageError("--take and files belong together.")
    if figures:
        write_figures(renew=renew)
        return
    for file in files:
        take(file)
    if not (write or taking):
        for part in parts or PARTS:
            with tempfile.TemporaryDirectory() as folder:
                answer = Path(folder) / "measured.json"
                if code := run(["--part", part, "--json", str(answer)]):
                    sys.stderr.write(f"{part} was not measured: exit code {code}.\n")
                else:
                    take(answer)
    for name, text in pages().items():
        (DOCS / name).write_text(text, encoding="utf-8")
    if not write:
        draw_growth(stored())


if __name__ == "__main__":
    main()
