"""`docs/benchmarks.md`, written from what was measured: promises, speed and accuracy beside peers, growth, and how to repeat it."""  # noqa: INP001 - beside the scripts that use it

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import part_tables
from markdown import NOT_MEASURED, figures, number, table

from boresight.measurements import PARTS
from boresight.measurements.accuracy import LEAST_GROWTH_FRAMES
from boresight.measurements.peers import PEERS

SCRIPTS = Path(__file__).resolve().parents[1] / "benchmarks"

HEAD = """# Benchmarks

Every figure here was measured by `boresight bench`, and this page was written from its JSON (`docs/benchmarks.json`) by
`docs/measure.py`; a test holds that it says what the JSON says. Times depend on the machine and on its hour; ratios to a
peer in the same run do not, so quote those. What they mean for a constellation is on the [capacity page](capacity.md).

```sh
make test                                # installs everything, peers included (the extra `bench`)
boresight bench --part all --json F      # measure; --part NAME for one, --size PART.SIZE=VALUE for another size
python docs/measure.py                   # measure everything and write this page anew
python docs/measure.py --part accuracy   # one part
```

A measurement is no test: the command exits with 0 and says in words which promise was not kept. Measure on an idle machine:
the load average beside each date is what else was running when it began.
"""

ACCURACY = """All start from the same ground calibration of a simulated ST-16 (E Table III, sensor 1) and get the same centroids of
the same named stars: at most {sets} sets of {frames} frames, fewer where a row says so because the peer is slow; two
exposures of twelve stars each, {sigma} px of noise, on one thread.

- **ours, over ours**: Boresight's batch on the same frames, taking turns with the peer set by set, the fastest of each; so the
  ratio is of two times of the same minutes.
- **error / bound**: root mean square error of the eight parameters over their Cramér-Rao bounds, geometric mean; 1 is perfect.
- **detector, corner**: how far the calibrated camera puts a star from where it falls, after the best rotation, root mean
  square over the detector and worst corner. Camera models differ between tools, this does not.
- **f error / claimed**: error of the focal length over the standard deviation that the tool claims for it; 1 is honest.
- **residual**: what the fit leaves, one axis. By it alone the right and the wrong cannot be told apart.
- **memory**: what the work adds to a process of its own that has loaded the library, and in brackets that process's peak.

"""

PROBLEMS = {
    "arcs": "Same problem: eight parameters from the arcs between stars",
    "attitudes": "Larger problem, same optimum: eight parameters, and three angles of attitude a view (bundle adjustment)",
    "poses": "Another problem: camera models of their own, and a whole pose or a plate solution a view",
}

AFTER_ACCURACY = """
General calibrators give every view a translation, and have no switch against it. Stars have no parallax, so a step towards
the sphere that they are put on looks like a longer focal length: the residual falls to the noise and below it, the claimed
deviation is small, and the answer is wrong by hundreds of it. The distance at which the stars are put changes nothing, as
everything scales with it. tetra3rs fits no translation, but leaves the principal point near the middle of the detector.
"""


def page(document: dict[str, Any]) -> str:
    """Write the page."""
    parts = [HEAD, _machines(document), _promises(document)]
    for name, part in PARTS.items():
        title = f"## {name.capitalize()}: {part.shows}\n\n`boresight bench --part {name}`\n"
        found = document.get(name, {}).get("found")
        parts.append(
            title + "\n" + (SECTIONS.get(name, _figures)(found) if found else f"{NOT_MEASURED.capitalize()} yet.\n")
        )
    return "\n".join([*parts, _scripts()])


def _machines(document: dict[str, Any]) -> str:
    """Who measured what, when, and how busy it was."""
    rows = []
    for name in PARTS:
        machine = document.get(name, {}).get("machine")
        if machine is None:
            rows.append([f"`{name}`", NOT_MEASURED, "", "", ""])
            continue
        load = " ".join(f"{one:g}" for one in machine["load_average"])
        here = f"{machine['processor']}, {machine['cores']} cores, {machine['memory_gb']:g} GB"
        versions = ", ".join(f"{key} {machine['versions'][key]}" for key in ("python", "numpy", "numba", "scipy"))
        rows.append([f"`{name}`", machine["measured_at"][:16].replace("T", " ") + " UTC", here, load, versions])
    return "## What measured\n\n" + table(
        ("part", "began", "machine", "load average 1, 5, 15 min", "versions"), rows, range(5)
    )


def _promises(document: dict[str, Any]) -> str:
    """Every promise, its limit, what was measured, and whether it was kept."""
    rows = []
    for name in PARTS:
        limits = document.get(name, {}).get("found", {}).get("limits")
        if limits is None:
            rows.append([f"`{name}`", "", "", NOT_MEASURED, ""])
        for key, limit in (limits or {}).items():
            side = "at least" if limit.get("at_least") else "at most"
            bound = f"{side} {number(limit['limit'])} {limit.get('unit', '')}".strip()
            kept = {True: "kept", False: "**not kept**"}.get(limit["kept"], NOT_MEASURED)
            kept += f": {limit['why']}" if "why" in limit else ""
            rows.append([f"`{name}`", key.replace("_", " "), bound, number(limit["measured"], 4), kept])
    return "## What is promised, and whether it was kept\n\n" + table(
        ("part", "promise", "limit", "measured", ""), rows, (0, 1, 4)
    )


def _figures(found: dict[str, Any]) -> str:
    """Any part: every number with its unit."""
    return table(("figure", "value", "unit"), list(figures(found)), (0, 2))


def _kernels(found: dict[str, Any]) -> str:
    """Our loops, and what each peer takes beside the one that does its work."""
    rows = []
    for name, ratio in found["ratios"].items():
        rows.append([f"`{name}`", number(found["peers"][f"{name}_us_per_frame"]), number(ratio)])
    peers = table(("peer", "µs a frame", "over ours"), rows)
    own = {key: value for key, value in found.items() if key not in {"peers", "ratios"}}
    unfair = (
        "\nNot the same: the plain NumPy and SciPy peers get R factored for them; `lean` and `ekf` linearise each frame once "
        "where ours does until it rests; the C peer gets the arcs in order and weighed; the matching peer takes one exposure at "
        "a time with one fixed tolerance and no doubt between two stars. `c_fast_math` may reorder sums as ours may; `c` may not.\n"
    )
    return f"{_figures(own)}\n{peers}{unfair}"


def _accuracy(found: dict[str, Any]) -> str:
    """A table a problem, the errors of each parameter, and what is not fair."""
    text = ACCURACY.format(sets=found["sets"], frames=found["frames"], sigma=found["centroid_sigma_px"])
    for problem, title in PROBLEMS.items():
        rows = [_accuracy_row(row) for row in found["estimators"].values() if row["problem"] == problem]
        if rows:
            text += f"### {title}\n\n" + table(ACCURACY_HEADS, rows) + "\n"
    text += "### How time and memory grow with the frames\n\n" + _peer_growth(found) + "\n"
    text += "### Root mean square error of each parameter, and over its bound\n\n" + _parameters(found)
    unfair = "".join(f"- {peer.title}: {peer.unfair}\n" for name, peer in PEERS.items() if name in found["estimators"])
    return text + AFTER_ACCURACY + "\nWhat is not the same:\n\n" + unfair


ACCURACY_HEADS = (
    "estimator", "sets × frames", "µs a frame", "ours on the same, µs", "over ours",
    "memory, MB (peak)", "error / bound", "NEES (8)", "detector, px",
    "corner, px", "over ours", "f error, µm", "f error / claimed", "residual, px",
)  # fmt: skip


def _accuracy_row(row: dict[str, Any]) -> list[str]:
    """One estimator."""
    if "missing" in row or "us_per_frame" not in row:
        why = row.get("missing") or f"failed: {'; '.join(sorted(set(row['failures'])))}"
        return [row["title"], why, *[""] * (len(ACCURACY_HEADS) - 2)]
    failed = f" ({len(row['failures'])} of {row['sets']} sets failed)" if row["failures"] else ""
    ours = row.get("ours_us_per_frame", NOT_MEASURED)
    ratio = (
        row.get("us_per_frame_over_ours") if "ours_us_per_frame" in row else None
    )  # a ratio needs its baseline beside it
    cells = [
        row["us_per_frame"], ours, ratio, row["work_rss_mb"], row.get("error_over_bound"), row.get("nees"),
        row.get("detector_px"), row.get("corner_px"), row.get("detector_px_over_ours"), row["focal_error_m"] * 1e6,
        row.get("focal_over_claimed"), row.get("rms_px"),
    ]  # fmt: skip
    shown = [*map(number, cells)]
    shown[3] += f" ({number(row['peak_rss_mb'])})"
    return [row["title"] + failed, f"{row['sets']} × {row['frames']}", *shown]


def _peer_growth(found: dict[str, Any]) -> str:
    """Exponent of time, and memory at the longer set."""
    rows = [
        [row["title"], f"{grown['from_frames']:,}", f"{grown['to_frames']:,}", number(grown["exponent"]),
         number(grown["us_per_frame"]), number(grown["work_rss_mb"])]
        for row in found["estimators"].values()
        if (grown := row.get("growth")) and grown["from_frames"] >= LEAST_GROWTH_FRAMES
    ]  # fmt: skip
    return (
        "Both lengths take turns, the fastest of each counts. Who bears too few frames for an exponent to mean something is left "
        "out.\n\n"
        + table(("estimator", "from frames", "to frames", "exponent", "µs a frame there", "memory there, MB"), rows)
    )


def _parameters(found: dict[str, Any]) -> str:
    """True units, and in brackets over the bound."""
    rows = [
        [
            row["title"],
            *(
                f"{number(error)} ({number(over)})"
                for error, over in zip(row["error"], row["each_over_bound"], strict=True)
            ),
        ]
        for row in found["estimators"].values()
        if "error" in row
    ]
    return table(("estimator", *(f"`{name}`" for name in found["parameters"])), rows)


def _growth(found: dict[str, Any]) -> str:
    """Time and memory by size, and the chart."""
    rows = [
        [method, f"{row['frames']:,}", number(row["seconds"]), number(row["seconds"] / row["frames"] * 1e6),
         number(row["processor_s"]), number(row["peak_mb"])]
        for method, of_method in found["runs"].items()
        for row in of_method
    ]  # fmt: skip
    slopes = [
        [method, number(one["exponent"]), ", ".join(number(slope) for slope in one["between_neighbours"]),
         part_tables.told(one, "exponent_beyond_start")]
        for method, one in found["growth"].items()
    ]  # fmt: skip
    matched = [
        [
            f"{row['frames']:,}",
            number(row["seconds"]),
            number(row["seconds"] / row["frames"] * 1e6),
            number(row["peak_mb"]),
        ]
        for row in found.get("rematch", [])
    ]
    return (
        "Each is `boresight calibrate FILE.parquet` in a fresh process, starting and reading included.\n\n"
        "![Time and memory of a calibration over its frames](benchmarks-growth.svg)\n\n"
        + table(("method", "frames", "wall, s", "µs a frame", "processor, s", "peak, MB"), rows)
        + "\n"
        + table(("method", "exponent over all sizes", "between neighbours", "beyond starting"), slopes)
        + f"\nBeyond starting: of the seconds less those of a process with next to nothing to compute, "
        f"{part_tables.told(found, 'empty_s')} s. These sets have given directions. With stars found anew "
        "(`rematch`, the command's "
        + (
            "default), sets of catalogue stars with times:\n\n"
            + table(("frames", "wall, s", "µs a frame", "peak, MB"), matched)
            if matched
            else f"default) growth was {NOT_MEASURED}.\n"
        )
    )


SECTIONS = {
    "kernels": _kernels, "accuracy": _accuracy, "growth": _growth, "whole": part_tables.whole, "spread": part_tables.spread,
    "queue": part_tables.queue, "clients": part_tables.clients, "fleet": part_tables.fleet,
}  # fmt: skip


def _scripts() -> str:
    """What the scripts in `benchmarks/` show, from their own first lines."""
    rows = [[f"`{name}`", claim, f"`{command}`"] for name, claim, command in _described()]
    return (
        "## Studies of their own\n\nThe scripts in `benchmarks/` take minutes to hours and print a table.\n\n"
        + table(("script", "shows", "command"), rows, range(3))
    )


def _described() -> Iterator[tuple[str, str, str]]:
    """Name, claim and command of each script that has a command."""
    for path in sorted(SCRIPTS.glob("*.py")):
        lines = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").splitlines()
        command = next((line.strip() for line in lines if line.strip().startswith("python benchmarks/")), None)
        if command is not None:
            yield path.name, lines[0].rstrip("."), command
