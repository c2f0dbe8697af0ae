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
    names = ("measure", "benchmark_page", "capacity_page", "growth_chart", "costs", "needs", "markdown", "part_tables")
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


def capacity(pages, footprint=DATABASE, **parts):
    """The capacity page of a footprint on SQLite, and of other parts."""
    found = {"footprint": {"databases": {"sqlite": footprint}}} | parts
    return pages["capacity_page"].page({name: {"machine": MACHINE, "found": one} for name, one in found.items()})


def test_what_a_constellation_needs_follows_from_what_a_run_costs(pages):
    """10,000 trackers, a batch and a filter of 2,000 frames a day each, 0.5 s + 1 ms a frame: 50,000 CPU s a day."""
    page = capacity(pages)

    assert "| 10,000 × 5.00 CPU s / 86,400 s / 0.5 | **1.16 cores** | a machine of workers: 16 cores | 0.072 |" in page
    assert f"**{10_000 * (3e6 + 2.1e6) * 365.25 / 1e12:.1f} TB**" in page
    assert "| machines of workers | 1.16 / 16 cores, rounded up | **1** |" in page
    assert "| disks of 4 TB for files, a year | 18.6 / 4, rounded up | **5** |" in page
    assert "the longer as long as assumed" in page


def test_a_share_of_the_writer_is_transactions_over_transactions_and_rows_over_rows(pages):
    bulk = {"rows": {"runs": 1.0, "audit": 1.0}, "seconds": 0.001}
    measured = {"calm": {"server_cpu_ms_per_run": 4.0, "claims_per_run": 0.1, "settlements_per_run": 0.15}}
    few = capacity(pages, DATABASE | {"launch_in_bulk": bulk}, queue=measured)
    most = capacity(pages)

    assert f"× 1.25) / 86,400 s × 3 | **{35_000 / 86_400 * 3:.2f} transactions/s** |" in few
    assert f"× 3.00) / 86,400 s × 3 | **{70_000 / 86_400 * 3:.2f} transactions/s** |" in most
    assert "one transaction each: 200 transactions/s |" in most
    assert f"**{200_000 / 86_400 * 3:.2f} rows/s** | the writer, launches in bulk: 2,000 rows/s |" in few
    assert "launches in bulk: not measured | - |" in most
    assert "the most that there can be" in most


def test_the_server_costs_what_the_queue_says_and_no_wall_second_is_added(pages):
    """Uploads count where their processor time is known; their 0.02 s of wall time never do."""
    cpu = {name: cost | {"own_cpu_s": 0.008} for name, cost in DATABASE["set"].items()}
    queue = {"calm": {"server_cpu_ms_per_run": 4.0}}

    assert "| (20,000 × 0.00400 CPU s + 10,000 × 0.00800 CPU s) / 86,400 s × 3 |" in capacity(
        pages, DATABASE | {"set": cpu}, queue=queue
    )
    fallen_back = capacity(pages)
    assert "| 20,000 × 0.0100 CPU s / 86,400 s × 3 (uploads not measured in CPU s) |" in fallen_back
    assert "a fall-back" in fallen_back
    assert "a fall-back" not in capacity(pages, queue=queue)


def test_what_readers_cost_follows_from_what_a_read_costs(pages):
    """5 reads a second of programs and 100 people with 2 views a minute, 6 ms each: a twentieth of a core."""
    each = {name: {"server_us_per_request": 6000.0} for name in ("page_while_writing", "list_while_writing")}
    clients = each | {"feed": {"events_per_s": 60.0, "listeners": 500}}
    page = capacity(pages, clients=clients)

    assert "**8.33 reads/s** | one Python process, 6.00 CPU ms each: 167 reads/s | 0.05 |" in page
    assert "one Python process, 500 measured, at least: 30,000 deliveries/s |" in page


def test_sets_shorter_than_assumed_are_said_to_be_carried_on(pages):
    shorter = {name: DATABASE["set"][key] for name, key in (("30", "200"), ("300", "2000"))}
    run = {name: SQRF[key] for name, key in (("30", "200"), ("300", "2000"), ("line", "line"))}

    page = capacity(pages, DATABASE | {"set": shorter, "run": {"batch": run, "sqrf": run}})

    assert "sets of 30 and 300 frames and carried on to 2,000" in page


def test_the_first_row_of_a_plan_is_the_resource_that_ends_first(pages):
    tables = capacity(pages).split("### ")[1:]
    for plan in tables:
        rows = [line.split(" | ") for line in plan.splitlines() if line.count(" | ") == 6 and "---" not in line][1:]
        shares = [float(row[4]) for row in rows if row[4] != "-"]
        assert len(rows) == 8
        assert shares == sorted(shares, reverse=True)
        assert rows[0][0].startswith("| **")
    assert [plan.partition("\n")[0] for plan in tables] == ["Daily", "Every orbit"]


def test_a_ratio_to_ours_stands_beside_ours_on_the_same_frames(pages):
    row = {"title": "Other", "problem": "arcs", "unfair": "", "frames": 50, "sets": 3, "failures": [], "us_per_frame": 600.0,
           "us_per_frame_over_ours": 10.0, "work_rss_mb": 1.0, "peak_rss_mb": 2.0, "focal_error_m": 1e-6}  # fmt: skip
    head = pages["benchmark_page"].ACCURACY_HEADS

    with_ours = pages["benchmark_page"]._accuracy_row(row | {"ours_us_per_frame": 60.0})
    without = pages["benchmark_page"]._accuracy_row(row)

    assert dict(zip(head[:5], with_ours[:5], strict=True)) == {
        "estimator": "Other", "sets × frames": "3 × 50", "µs a frame": "600", "ours on the same, µs": "60.0", "over ours": "10.0",
    }  # fmt: skip
    assert without[3:5] == ["not measured", "-"]


def test_parts_without_the_newer_figures_say_not_measured(pages):
    tables = pages["part_tables"]
    found = {"total_s": 15.0, "evaluations": 7, "c_fit_s": 3.0, "frames": 20_000}

    whole = tables.whole({"frames": 20_000, "given": found, "rematch": {"total_s": 48.0}})
    assert "| 20,000 | not measured | 15.0 | not measured | 7 | 3.00 | 5.00 | not measured | not measured |" in whole
    assert "the command's default" in whole
    assert "| 48.0 | not measured | 7 | 3.00 | 16.0 |" in whole
    assert "was not measured" in tables.spread({"runs": {"one_of_two_killed": {"seconds": 1.0}}})
    assert tables.queue({"calm": {"overhead_ms_per_run": 3.0}}).count("not measured") == 3
    crowds = tables.clients({"list": {"median_ms": 40.0, "all_answered_once_after_s": 0.7},
                             "limits": {"list_median": {"limit": 60.0}}})  # fmt: skip
    assert "| REST API, asking again at once | 0.700 | 40.0 | 60.0 |" in crowds
    assert "while runs are launched | not measured |" in crowds


def test_what_was_killed_is_said_and_why_a_promise_was_not_kept(pages):
    kill = {"worker": "tcp://one", "happened": True, "after_s": 3.0, "groups_done": 4, "groups_in_hand": 2}
    tables = pages["part_tables"]
    why = {"limit": 1.0, "measured": 0.0, "kept": False, "why": "The run had ended before."}
    page = pages["benchmark_page"].page({"growth": {"machine": MACHINE, "found": GROWTH | {"limits": {"one": why}}}})

    assert "killed 3.00 s after" in tables.spread({"runs": {"one_of_two_killed": {"kill": kill}}})
    assert "No worker was killed" in tables.spread({"runs": {"one_of_two_killed": {"kill": {"happened": False}}}})
    assert "| **not kept**: The run had ended before. |" in page


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


def test_several_files_are_taken_at_once(pages, tmp_path, monkeypatch):
    measure = pages["measure"]
    monkeypatch.setattr(measure, "STORED", tmp_path / "stored.json")
    monkeypatch.setattr(measure, "pages", dict)
    files = [tmp_path / f"{name}.json" for name in ("growth", "queue", "spread")]
    for file in files:
        file.write_bytes(orjson.dumps({"machine": MACHINE, file.stem: {"seconds": 1.0}, "limits": {}}))

    measure.main(["--take", *map(str, files[:2]), "--take", str(files[2])])

    assert set(measure.stored()) == {"growth", "queue", "spread"}
