"""`python -m benchmarks`: how fast, how lean and how right this machine calibrates, beside peers in the same run.

Without `--part` the compiled loops are timed in this process. Several parts run each in a process of its own, so that none inherits
another's memory, threads or caches, and one that fails takes no other with it. A measurement is no test: a promise that is not kept
is marked, and the exit code is 0.
"""

from __future__ import annotations

import os
import platform
import sqlite3
import subprocess
import sys
import tempfile
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import click
import orjson

from benchmarks import PARTS, ROOT, collect_limits
from benchmarks.pages.tables import figures, promise
from benchmarks.servers import end_in_order
from boresight.cli.output import check_writable, json_option, write_json
from boresight.errors import BoresightError
from boresight.library.progress import progress
from boresight.library.text import aligned
from boresight.settings import read_settings, use_kernel_folder

LEGEND = """
match_us_per_frame: real stars, half of them unnamed, matched from a ground calibration.
match_per_batch_evaluation: that, over one batch evaluation of the same frames; at most 20 is promised.
ratios: how many times longer each peer takes than the loop that does its work; the matching peer does less (one
exposure at a time, one fixed tolerance, no doubt between two stars).
svd_update: singular values of one exposure of so many stars taken in, from given rays on, on one thread. numpy decomposes
one combination at a time by numpy.linalg.svd; numpy_lean all at once, by eigh of prefix sums and LAPACK's pivoted Cholesky."""

#: Whose releases change the figures; those that are not installed are left out.
PACKAGES = (
    "boresight", "numpy", "scipy", "numba", "distributed", "pyarrow", "sqlalchemy", "fastapi", "uvicorn", "opencv-python-headless",
    "filterpy", "pyceres", "gtsam", "mrcal", "tetra3rs",
)  # fmt: skip


def machine() -> dict[str, Any]:
    """Describe the processor, its cores, memory, versions, the hour and the load averages of now."""
    cpu, versions = Path("/proc/cpuinfo"), {"python": platform.python_version(), "sqlite": sqlite3.sqlite_version}
    named = cpu.read_text(encoding="utf-8").splitlines() if cpu.exists() else []
    models = (line.partition(":")[2].strip() for line in named if line.startswith("model name"))
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return {
        "measured_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "processor": next(models, platform.machine()),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "load_average": [round(load, 2) for load in os.getloadavg()],
        "versions": versions,
    }


def _sizes(_context: click.Context, _option: click.Parameter, words: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """Read `part.size=value` words; values are JSON."""
    sizes: dict[str, dict[str, Any]] = {}
    for word in words:
        name, equals, value = word.partition("=")
        part, dot, key = name.partition(".")
        if not (equals and dot and key.isidentifier() and part in PARTS):
            raise click.BadParameter(f"{word!r} is not PART.SIZE=VALUE, as in kernels.frames=500.")
        try:
            sizes.setdefault(part, {})[key] = orjson.loads(value)
        except orjson.JSONDecodeError as error:
            raise click.BadParameter(f"{value!r} in {word!r} is no JSON value.") from error
    return sizes


@click.command()
@click.option(
    "--part",
    "parts",
    multiple=True,
    type=click.Choice([*PARTS, "all"]),
    help="What to measure; repeat it. [default: kernels]",
)
@click.option("--frames", type=click.IntRange(10), help="Frames of a synthetic set.  [default: each part's own; 2000]")
@click.option(
    "--size", "sizes", multiple=True, callback=_sizes, metavar="PART.SIZE=VALUE", help="Another size of a part."
)
@click.option(
    "--checkout",
    type=click.Path(exists=True, file_okay=False, resolve_path=True),
    help="Another checkout to measure beside this one, by the parts that can (start).",
)
@json_option
def bench(
    parts: tuple[str, ...],
    frames: int | None,
    sizes: dict[str, dict[str, Any]],
    checkout: str | None,
    json_file: str | None,
) -> None:
    """Measure speed, memory, growth and accuracy beside peers in the same run.

    Without --part the estimators and the matching are timed on synthetic frames of 12 stars in two exposures.
    """
    try:
        check_writable(json_file)
    except BoresightError as error:
        raise click.ClickException(str(error)) from error
    use_kernel_folder(read_settings())
    if checkout is not None:
        sizes.setdefault("start", {})["checkout"] = checkout
    if not parts:
        measured = _measured("kernels", frames, sizes)
        shown = [LEGEND]
    else:
        names = list(PARTS) if "all" in parts else list(dict.fromkeys(parts))
        found, here = {}, machine()
        for name in names:
            alone = len(names) == 1
            found[name] = (_measured if alone else _in_its_own_process)(name, frames, sizes)
        measured = {"machine": here, **found, "limits": collect_limits(found)}
        rows = [(name, *promise(limit)) for name, limit in measured["limits"].items()]
        shown = ["", aligned([("promise", "limit", "measured", ""), *rows])] if rows else []
    write_json(measured, json_file)
    if json_file != "-":
        click.echo("\n".join([aligned([("figure", "", "unit"), *figures(measured)], left=(0, 2)), *shown]))


def _measured(part: str, frames: int | None, sizes: dict[str, dict[str, Any]]) -> dict[str, Any]:
    with progress("compiling") as report:
        measure, known = PARTS[part].measurement(), PARTS[part].sizes
        chosen = ({"frames": frames} if frames and "frames" in known else {}) | sizes.get(part, {})
        if unknown := chosen.keys() - known.keys():
            has = ", ".join(sorted(known))
            raise click.UsageError(f"{part} has no size {', '.join(sorted(unknown))}; it has {has}.")
        return measure(lambda fraction, message: report(f"{part}: {message}", fraction), **chosen)


def _in_its_own_process(part: str, frames: int | None, sizes: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Measure one part by this command; one that fails says so in its place."""
    with tempfile.TemporaryDirectory(prefix="boresight-bench-") as folder:
        answer = Path(folder) / "measured.json"
        words = ["--part", part, "--json", str(answer), *(["--frames", str(frames)] if frames else [])]
        for key, value in sizes.get(part, {}).items():
            words += ["--size", f"{part}.{key}={orjson.dumps(value).decode()}"]
        exit_code = run(words)
        if exit_code or not answer.exists():
            return {"failed": f"The measurement ended with exit code {exit_code}; run --part {part} alone to see why."}
        found: dict[str, Any] = orjson.loads(answer.read_bytes())[part]
        return found


def run(words: list[str]) -> int:
    """Run this command; when this process is stopped, that one is asked to stop too, so that it can take its servers away."""
    process = subprocess.Popen([sys.executable, "-m", "benchmarks", *words], stdout=subprocess.DEVNULL, cwd=ROOT)
    try:
        return process.wait()
    except BaseException:
        process.terminate()
        process.wait()
        raise


if __name__ == "__main__":
    end_in_order()
    bench()
