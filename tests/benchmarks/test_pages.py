"""The pages of figures say what was measured, what was not, and what follows from it by arithmetic that can be done again."""

import copy

import orjson
import pytest

from benchmarks import PARTS
from benchmarks.pages import __main__ as program
from benchmarks.pages import benchmarks, capacity
from benchmarks.pages.drawings import DOCS, growth_figure
from benchmarks.pages.tables import number

STORED = program.stored()
MACHINE = STORED["kernels"]["machine"]
LINE = {"worker_cpu_s": {"constant": 0.5, "per_frame": 1e-3}, "blob_bytes": {"constant": 5e4, "per_frame": 500.0}}


def test_the_stored_pages_are_what_the_stored_figures_give():
    for name, text in program.pages().items():
        assert (DOCS / name).read_text() == text, f"write {name} again with `python -m benchmarks.pages --write`"
    assert (DOCS / "benchmarks.json").stat().st_size < 100_000


def test_a_part_that_was_not_measured_is_said_to_be_so():
    page = benchmarks.page({})
    assert page.count("Not measured yet.") == len(PARTS)
    assert "`footprint` was not measured" in capacity.page({})


def test_promises_are_shown_with_their_limit_and_whether_they_were_kept():
    broken = {"limit": 1.5, "measured": 1.2, "kept": False, "at_least": True, "unit": "times", "why": "It ended."}
    page = benchmarks.page({"fresh": {"machine": MACHINE, "found": {"limits": {"two_threads": broken}}}})
    assert "| `fresh` | two threads | at least 1.50 times | 1.200 | **not kept**: It ended. |" in page


def test_the_chart_has_a_point_a_size_in_each_panel():
    chart = growth_figure(STORED)
    runs = STORED["growth"]["found"]["runs"]
    assert [(trace.name, len(trace.x)) for trace in chart.data] == [(m, len(runs[m])) for m in runs for _ in range(2)]


@pytest.fixture
def page():
    document = copy.deepcopy({name: STORED[name] for name in capacity.NEEDED})
    for database in document["footprint"]["found"]["databases"].values():
        database["launch"]["seconds"] = 0.005
        for method in database["run"].values():
            method["line"] = LINE
    document["queue"]["found"]["calm"] |= {"claims_per_run": 0.1, "settlements_per_run": 0.15}
    for crowd in ("page_while_writing", "list_while_writing"):
        document["clients"]["found"][crowd]["server_us_per_request"] = 6000.0
    return capacity.page(document)


def test_what_a_constellation_needs_follows_from_what_a_run_and_a_read_cost(page):
    assert "| 10,000 × 5.00 CPU s / 86,400 s / 0.5 | **1.16 cores** | a machine of workers: 16 cores | 0.072 |" in page
    assert "| machines of workers | 1.16 / 16 cores, rounded up | **1** |" in page
    assert f"× 1.25) / 86,400 s × 3 | **{35_000 / 86_400 * 3:.2f} transactions/s** |" in page
    assert "one transaction each: 200 transactions/s |" in page
    assert "**8.33 reads/s** | one Python process, 6.00 CPU ms each: 167 reads/s | 0.05 |" in page


def test_the_first_row_of_a_plan_is_the_resource_that_ends_first(page):
    for plan in page.split("### ")[1:]:
        rows = [line.split(" | ") for line in plan.splitlines() if line.count(" | ") == 6 and "---" not in line][1:]
        shares = [float(row[4]) for row in rows]
        assert len(rows) == 8
        assert shares == sorted(shares, reverse=True)
        assert rows[0][0].startswith("| **")


@pytest.mark.parametrize(
    ("value", "text"),
    [(1234.5, "1,230"), (0.012345, "0.0123"), (3, "3"), (None, "-"), (0.99999, "1.00"), (1e-7, "1.00e-07"), (float("inf"), "-")],
)  # fmt: skip
def test_numbers_have_three_digits(value, text):
    assert number(value) == text


def test_parts_that_are_taken_replace_those_stored_and_failed_ones_do_not(tmp_path, monkeypatch):
    monkeypatch.setattr(program, "STORED", tmp_path / "stored.json")
    file, long = tmp_path / "bench.json", list(range(1000))
    for growth in ({"seconds": 1.23456789, "series": long}, {"failed": "no disk"}):
        file.write_bytes(orjson.dumps({"machine": MACHINE, "growth": growth, "limits": {}}))
        program.take(file)
    assert program.stored() == {"growth": {"machine": MACHINE, "found": {"seconds": 1.2346}}}
