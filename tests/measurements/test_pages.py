"""The pages of figures say what was measured, what was not, and what follows from it by arithmetic that can be done again."""

import importlib
import re
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import orjson
import pytest

from boresight.measurements import PARTS

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
MOST_BYTES = 100_000

MACHINE = {
    "measured_at": "2026-01-02T03:04:05+00:00", "processor": "Some CPU", "cores": 4, "memory_gb": 8.0,
    "load_average": [0.5, 0.4, 0.3],
    "versions": {"python": "3.11", "numpy": "2.4", "numba": "0.68", "scipy": "1.17"},
}  # fmt: skip
RUN = {"database_bytes": 10_000.0, "rows": {"runs": 1.0, "audit": 2.0, "run_events": 5.0}, "server_cpu_s": 0.01}
LINE = {"worker_cpu_s": {"constant": 0.5, "per_frame": 1e-3}, "blob_bytes": {"constant": 5e4, "per_frame": 500.0}}
SQRF = {
    "200": RUN | {"worker_cpu_s": 0.7, "blob_bytes": 1.5e5},
    "2000": RUN | {"worker_cpu_s": 2.5, "blob_bytes": 1.05e6},
    "line": LINE,
}
SET = {"database_bytes": 5_000.0, "rows": {"blobs": 2.0, "telemetry_sets": 1.0, "audit": 1.0}, "seconds": 0.02}
DATABASE = {
    "sensor": {"database_bytes": 4_000.0, "blob_bytes": 0.0, "rows": {"sensors": 1.0}, "seconds": 0.01},
    "set": {"200": SET | {"blob_bytes": 3e5}, "2000": SET | {"blob_bytes": 3e6}},
    "launch": {"database_bytes": 3_000.0, "blob_bytes": 0.0, "rows": {"runs": 1.0}, "seconds": 0.005},
    "run": {"batch": SQRF, "sqrf": SQRF},
    "row_bytes": {"audit": 700.0},
}
GROWTH = {
    "runs": {"batch": [
        {"frames": 1000, "seconds": 2.0, "processor_s": 1.9, "peak_mb": 200.0},
        {"frames": 1_000_000, "seconds": 300.0, "processor_s": 290.0, "peak_mb": 900.0},
    ]},
    "growth": {"batch": {"exponent": 0.73, "between_neighbours": [0.73]}},
    "limits": {"batch_exponent": {"limit": 1.05, "measured": 0.73, "kept": True}},
}  # fmt: skip


@pytest.fixture(scope="module")
def pages():
    """Import the scripts of the documentation as they import one another."""
    sys.path.insert(0, str(DOCS))
    names = ("measure", "benchmark_page", "capacity_page", "growth_chart", "costs", "needs", "markdown")
    try:
        yield {name: importlib.import_module(name) for name in names}
    finally:
        sys.path.remove(str(DOCS))
        for name in names:
            sys.modules.pop(name, None)


def test_the_stored_pages_are_what_the_stored_figures_give(pages):
    for name, text in pages["measure"].pages().items():
        assert (DOCS / name).read_text() == text, f"write {name} again with `python docs/measure.py --write`"


def test_what_is_stored_is_small_and_names_no_unknown_part():
    stored = orjson.loads((DOCS / "benchmarks.json").read_bytes())

    assert set(stored) <= set(PARTS)
    assert (DOCS / "benchmarks.json").stat().st_size < MOST_BYTES


def test_a_part_that_was_not_measured_is_said_to_be_so(pages):
    page = pages["benchmark_page"].page({})

    for name, part in PARTS.items():
        assert f"## {name.capitalize()}: {part.shows}" in page
        assert f"| `{name}` | not measured |" in page
    assert page.count("Not measured yet.") == len(PARTS)
    assert "not measured" in pages["capacity_page"].page({})
    assert "not measured" in pages["growth_chart"].svg({})


def test_every_script_with_a_command_is_listed_with_it(pages):
    page = pages["benchmark_page"].page({})

    for path in (ROOT / "benchmarks").glob("*.py"):
        if "    python benchmarks/" in path.read_text():
            assert re.search(rf"\| `{path.name}` \| .+ \| `python benchmarks/{path.name}", page)


def test_promises_are_shown_with_their_limit_and_whether_they_were_kept(pages):
    broken = {"limit": 1.5, "measured": 1.2, "kept": False, "at_least": True, "unit": "times"}
    page = pages["benchmark_page"].page(
        {"growth": {"machine": MACHINE, "found": GROWTH | {"limits": {"two_threads": broken}}}}
    )

    assert "| `growth` | two threads | at least 1.50 times | 1.200 | **not kept** |" in page
    assert "| `growth` | 2026-01-02 03:04 UTC | Some CPU, 4 cores, 8 GB | 0.5 0.4 0.3 |" in page


def test_the_chart_is_a_picture_with_a_point_a_size_in_each_panel(pages):
    picture = ET.fromstring(  # noqa: S314 - our own drawing
        pages["growth_chart"].svg({"growth": {"found": GROWTH}})
    )

    points = picture.findall("{http://www.w3.org/2000/svg}circle")
    assert len(points) == 2 * 2
    assert float(points[0].get("cx")) < float(points[1].get("cx"))
    assert float(points[0].get("cy")) > float(points[1].get("cy"))


def test_what_a_constellation_needs_follows_from_what_a_run_costs(pages):
    """10,000 trackers, a batch and a filter of 2,000 frames a day each, 0.5 s + 1 ms a frame: 50,000 CPU s a day."""
    page = pages["capacity_page"].page(
        {"footprint": {"machine": MACHINE, "found": {"databases": {"sqlite": DATABASE}}}}
    )

    assert "| worker cores | 10,000 × 5.00 CPU s / 86,400 s / 0.5 | **1.16 cores** |" in page
    assert f"**{10_000 * 3e6 * 365.25 / 1e12:.1f} TB**" in page
    assert "| database rows, a year | (10,000 × 4 + 20,000 × 8.00) × 365.25 | **73.0 million** |" in page
    assert f"**{170_000 / 86_400 * 3:.2f} of 200 measured**" in page


def test_what_readers_cost_follows_from_what_a_read_costs(pages):
    """5 reads a second of programs and 100 people with 2 views a minute, 6 ms each: a twentieth of a core."""
    clients = {"list": {"server_us_per_request": 6000.0}, "feed": {"events_per_s": 60.0, "listeners": 500}}
    queue = {"calm": {"server_cpu_ms_per_run": 4.0}}
    found = {"footprint": {"databases": {"sqlite": DATABASE}}, "clients": clients, "queue": queue}
    page = pages["capacity_page"].page({name: {"machine": MACHINE, "found": one} for name, one in found.items()})

    assert "| server processor for them | 8.33 × 6.00 ms | **0.0500 cores** |" in page
    assert "| 60.0 events a second × 500 followers | **30,000** |" in page
    assert "(20,000 × 0.00400 s + 10,000 × 0.0200 s) / 86,400 s" in page


def test_the_first_row_of_a_plan_is_the_resource_that_ends_first(pages):
    page = pages["capacity_page"].page(
        {"footprint": {"machine": MACHINE, "found": {"databases": {"sqlite": DATABASE}}}}
    )
    shares = [float(line.split(" | ")[2]) for line in page.splitlines() if line.startswith("| daily |")]

    assert len(shares) == 4
    assert shares == sorted(shares, reverse=True)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1234.5, "1,230"),
        (0.012345, "0.0123"),
        (3, "3"),
        (None, "-"),
        (0.99999, "1.00"),
        (1e-7, "1.00e-07"),
        (12, "12"),
        (float("inf"), "-"),
    ],
)
def test_numbers_have_three_digits(pages, value, text):
    assert pages["markdown"].number(value) == text


def test_parts_that_are_taken_replace_those_stored_and_failed_ones_do_not(pages, tmp_path, monkeypatch):
    measure = pages["measure"]
    monkeypatch.setattr(measure, "STORED", tmp_path / "stored.json")
    file = tmp_path / "bench.json"
    long = list(range(1000))
    file.write_bytes(
        orjson.dumps({"machine": MACHINE, "growth": {"seconds": 1.23456789, "series": long}, "limits": {}})
    )
    measure.take(file)
    file.write_bytes(orjson.dumps({"machine": MACHINE, "growth": {"failed": "no disk"}, "limits": {}}))
    measure.take(file)

    assert measure.stored() == {"growth": {"machine": MACHINE, "found": {"seconds": 1.2346}}}
