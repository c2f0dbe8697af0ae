"""Measure, and write `docs/benchmarks.md` and `docs/capacity.md` with the chart they show: `python docs/measure.py`.

    python docs/measure.py                  every part at full size (an hour of an idle machine), then the pages
    python docs/measure.py --part queue     one part anew, the others as they are stored
    python docs/measure.py --take A B       take the parts that `boresight bench --part ... --json A` measured, then those of B
    python docs/measure.py --write          only the pages, from what is stored

What was measured is stored in `docs/benchmarks.json`, each part with the machine that measured it, rounded to five digits.
"""  # noqa: INP001 - a script, not a package

from __future__ import annotations

import argparse
import math
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import benchmark_page
import capacity_page
import growth_chart
import orjson

from boresight.measurements import PARTS

DOCS = Path(__file__).resolve().parent
STORED = DOCS / "benchmarks.json"
DIGITS = 5
#: Longer lists are series for a machine, not figures for a page.
LONGEST_LIST = 40
BESIDE = ("machine", "limits")


def stored() -> dict[str, Any]:
    """Parts measured so far: name -> {machine, found}."""
    found: dict[str, Any] = orjson.loads(STORED.read_bytes()) if STORED.exists() else {}
    return found


def slim(value: Any) -> Any:
    """Round numbers, and leave out what is too long for a page."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: slim(one) for key, one in value.items() if not (isinstance(one, list) and len(one) > LONGEST_LIST)}
    return [slim(one) for one in value] if isinstance(value, list) else value


def take(file: Path) -> None:
    """Keep the parts of a bench document in place of those that are stored; a part that failed replaces none."""
    document, kept = orjson.loads(file.read_bytes()), stored()
    for name, found in document.items():
        if name not in BESIDE and "failed" not in found:
            kept[name] = {"machine": document["machine"], "found": slim(found)}
    ordered = {name: kept[name] for name in PARTS if name in kept}
    STORED.write_bytes(orjson.dumps(ordered, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))


def measure(parts: list[str]) -> None:
    """Measure parts by the command, one after the other, and keep each as soon as it is there."""
    for part in parts:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "measured.json"
            words = [sys.executable, "-m", "boresight", "bench", "--part", part, "--json", str(file)]
            done = subprocess.run(words, stdout=subprocess.DEVNULL, check=False)  # noqa: S603 - words of our own
            if done.returncode == 0:
                take(file)
            else:
                sys.stderr.write(f"{part} was not measured: exit code {done.returncode}.\n")


def pages() -> dict[str, str]:
    """Everything that is written, by name."""
    document = stored()
    return {
        "benchmarks.md": benchmark_page.page(document),
        "capacity.md": capacity_page.page(document),
        "benchmarks-growth.svg": growth_chart.svg(document),
    }


def main(words: list[str] | None = None) -> None:
    """Measure what is asked for, and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", action="append", choices=PARTS, help="measure this part only; repeat it")
    parser.add_argument(
        "--take",
        action="extend",
        nargs="+",
        type=Path,
        default=[],
        metavar="FILE",
        help="files of `boresight bench --json`",
    )
    parser.add_argument("--write", action="store_true", help="write the pages from what is stored")
    options = parser.parse_args(words)
    for file in options.take:
        take(file)
    if not (options.write or options.take):
        measure(options.part or list(PARTS))
    for name, text in pages().items():
        (DOCS / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
