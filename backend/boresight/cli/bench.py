"""`boresight bench`: how fast, how lean and how right this machine calibrates, beside peers in the same run.

Without `--part` the compiled loops are timed in this process. Several parts run each in a process of its own, so that none inherits
another's memory, threads or caches, and one that fails takes no other with it. A measurement is no test: a promise that is not kept
is marked, and the exit code is 0.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import orjson

from boresight.cli.output import aligned, check_writable, json_option, write_json
from boresight.cli.progress import progress
from boresight.measurements import PARTS
from boresight.settings import read_settings, use_kernel_folder

LEGEND = """
match_us_per_frame: real stars, half of them unnamed, matched from a ground calibration.
match_per_batch_evaluation: that, over one batch evaluation of the same frames; at most 20 is promised.
ratios: how many times longer each peer takes than the loop that does its work; the matching peer does less (one
exposure at a time, one fixed tolerance, no doubt between two stars).
svd_update: singular values of one exposure of so many stars taken in, from given rays on, on one thread. numpy decomposes
one combination at a time by numpy.linalg.svd; numpy_lean all at once, by eigh of prefix sums and LAPACK's pivoted Cholesky."""

#: What a key ends in, and the unit in words; the first that fits.
UNITS = {
    "_us_per_frame": "µs a frame", "_ms_per_frame": "ms a frame", "_over_ours": "", "_us": "µs", "_ms": "ms", "_mb": "MB",
    "_gb": "GB", "_bytes": "bytes", "_px": "px", "_m": "m", "_rad": "rad", "_per_s": "a second", "_s": "s",
}  # fmt: skip
#: Longer words stand in the JSON alone, and so do lists.
LONGEST_WORD = 40


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
@json_option
def bench(parts: tuple[str, ...], frames: int | None, sizes: dict[str, dict[str, Any]], json_file: str | None) -> None:
    """Measure speed, memory, growth and accuracy beside peers in the same run.

    Without --part the estimators and the matching are timed on synthetic frames of 12 stars in two exposures.
    """
    check_writable(json_file)
    use_kernel_folder(read_settings())
    with _ending_in_order():
        if not parts:
            measured = _measured("kernels", frames, sizes)
            shown = [_table(measured), LEGEND]
        else:
            measured = _all_parts(list(PARTS) if "all" in parts else list(dict.fromkeys(parts)), frames, sizes)
            shown = [_table(measured), *_promises(measured["limits"])]
    write_json(measured, json_file)
    if json_file != "-":
        click.echo("\n".join(shown))


def _measured(part: str, frames: int | None, sizes: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Measure one part in this process."""
    with progress("compiling") as report:
        from boresight.measurements import measure, sizes_of

        known = sizes_of(part)
        chosen = ({"frames": frames} if frames and "frames" in known else {}) | sizes.get(part, {})
        if unknown := chosen.keys() - known.keys():
            raise click.UsageError(
                f"{part} has no size {', '.join(sorted(unknown))}; it has {', '.join(sorted(known))}."
            )
        return measure(part, lambda fraction, message: report(f"{part}: {message}", fraction), chosen)


def _all_parts(names: list[str], frames: int | None, sizes: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Measure parts, each in a process of its own where there are several, and gather what they promise."""
    from boresight.measurements import limits_of
    from boresight.measurements.machine import machine

    here = machine()
    if len(names) == 1:
        found = {names[0]: _measured(names[0], frames, sizes)}
    else:
        found = {name: _in_its_own_process(name, frames, sizes.get(name, {})) for name in names}
    return {"machine": here, **found, "limits": limits_of(found)}


def _in_its_own_process(part: str, frames: int | None, sizes: dict[str, Any]) -> dict[str, Any]:
    """Measure one part by this command; one that fails says so in its place."""
    with tempfile.TemporaryDirectory(prefix="boresight-bench-") as folder:
        answer = Path(folder) / "measured.json"
        words = [sys.executable, "-m", "boresight", "bench", "--part", part, "--json", str(answer)]
        words += ["--frames", str(frames)] if frames else []
        words += [
            word for key, value in sizes.items() for word in ("--size", f"{part}.{key}={orjson.dumps(value).decode()}")
        ]
        exit_code = _run(words)
        if exit_code or not answer.exists():
            return {"failed": f"The measurement ended with exit code {exit_code}; run --part {part} alone to see why."}
        found: dict[str, Any] = orjson.loads(answer.read_bytes())[part]
        return found


def _run(words: list[str]) -> int:
    """Run a command; when this one is stopped, it is asked to stop too, so that it can take its servers away."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL)  # noqa: S603 - words of our own
    try:
        return process.wait()
    except BaseException:
        process.terminate()
        process.wait()
        raise


@contextmanager
def _ending_in_order() -> Iterator[None]:
    """End by unwinding when this process is told to, so that the servers and folders of a measurement go with it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(_signal: int, _frame: object) -> None:
        raise SystemExit(128 + signal.SIGTERM)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _table(measured: Mapping[str, Any]) -> str:
    """Lay out every figure with its unit; words and lists stand in the JSON alone."""
    rows = [("figure", "", "unit"), *_rows(measured)]
    return aligned(rows, left=(0, 2))


def _rows(measured: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Every number with its place in the document and its unit; limits stand apart."""
    for key, value in measured.items():
        if key == "limits":
            continue
        if isinstance(value, Mapping):
            yield from _rows(value, f"{prefix}{key}.")
        elif isinstance(value, list) and value and all(isinstance(row, Mapping) for row in value):
            for place, row in enumerate(value):
                yield from _rows(row, f"{prefix}{key}.{place}.")
        elif isinstance(value, (int, float)):
            yield f"{prefix}{key}", _number(value), _unit(key)
        elif isinstance(value, str) and len(value) <= LONGEST_WORD:
            yield f"{prefix}{key}", value, ""


def _unit(key: str) -> str:
    """Unit that a key ends in; a ratio has none."""
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), "")


def _promises(limits: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Lay out what is promised, what was measured, and in words whether it was kept."""
    if not limits:
        return
    heads = ("promise", "limit", "measured", "")
    rows = [(name, _bound(limit), _number(limit["measured"]), _verdict(limit)) for name, limit in limits.items()]
    yield ""
    yield aligned([heads, *rows])


def _bound(limit: Mapping[str, Any]) -> str:
    """Limit with its direction and unit."""
    return f"{'at least' if limit.get('at_least') else 'at most'} {_number(limit['limit'])} {limit.get('unit', '')}".strip()


def _number(value: Any) -> str:
    return f"{value:,.4g}" if isinstance(value, (int, float)) and not isinstance(value, bool) else str(value)


def _verdict(limit: Mapping[str, Any]) -> str:
    return {True: "kept", False: "NOT KEPT"}.get(limit["kept"], "not measured")
