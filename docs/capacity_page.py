"""`docs/capacity.md`, written from what was measured: what a frame, a run and a sensor cost, and what ten thousand trackers need.

Everything follows from the parts `footprint` (cost of each thing) and `clients` of `docs/benchmarks.json` and from the assumptions
in `costs.ASSUMED`; each row shows its formula with the numbers in it. Seconds of processors and of the wall are never added.
"""  # noqa: INP001 - beside the scripts that use it

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from costs import ASSUMED, Costs, Plan, plans, value
from markdown import NOT_MEASURED, kilobytes, number, table
from needs import machines, needs

HEAD = """# Capacity: from one tracker to ten thousand

What Boresight costs was measured on a small machine (part `footprint`, on SQLite and on PostgreSQL); what a constellation needs is
those figures carried on by arithmetic that is shown. No constellation of this size was run. The page is written by
`python docs/measure.py` from `docs/benchmarks.json`; a test holds that it says what the JSON says.

```sh
boresight bench --part footprint    # what each thing costs: seconds of processors, bytes of files, rows and pages
boresight bench --part queue        # what the queue adds, and its rate
boresight bench --part clients      # what a read and a follower cost the server
python docs/measure.py --part footprint --part queue --part clients
```
"""


def page(document: dict[str, Any]) -> str:
    """Write the page."""
    footprint = document.get("footprint", {}).get("found")
    if footprint is None:
        return HEAD + f"\nThe part `footprint` was {NOT_MEASURED} yet.\n"
    queue = document.get("queue", {}).get("found", {})
    by_database = {name: Costs(found, queue) for name, found in footprint["databases"].items()}
    name, costs = list(by_database.items())[-1]
    machine = document["footprint"]["machine"]
    parts = [
        HEAD,
        _where(machine),
        _assumptions(),
        _measured(by_database),
        "## What ten thousand trackers need\n",
        _sources(name, costs),
        *(_plan(plan, costs, document) for plan in plans()),
        _burst(costs),
        AFTER,
    ]
    return "\n".join(parts)


def _where(machine: dict[str, Any]) -> str:
    """Say what measured, and when."""
    at = machine["measured_at"][:16].replace("T", " ")
    load = machine["load_average"][0]
    return f"Measured on {machine['processor']}, {machine['cores']} cores, at {at} UTC, load average {load:g} when it began.\n"


def _assumptions() -> str:
    rows = [
        [f"`{name}`", number(worth if worth % 1 else int(worth)), unit, why]
        for name, (worth, unit, why) in ASSUMED.items()
    ]
    return "## What is assumed\n\n" + table(("name", "value", "unit", "meaning"), rows, (0, 2, 3))


def _measured(by_database: dict[str, Costs]) -> str:
    """What each thing costs, on each database."""
    rows = [row for name, costs in by_database.items() for row in _costs_of(name, costs)]
    lines = [
        [name, method, number(line["worker_cpu_s"]["constant"]), number(line["worker_cpu_s"]["per_frame"] * 1e3),
         kilobytes(line["blob_bytes"]["constant"]), kilobytes(line["blob_bytes"]["per_frame"])]
        for name, costs in by_database.items()
        for method, line in ((method, found["line"]) for method, found in costs.found["run"].items())
    ]  # fmt: skip
    heads = (
        "database",
        "one more",
        "rows",
        "database, kB",
        "files, kB",
        "worker, CPU s",
        "server, CPU s",
        "wall, s",
    )
    of_row = [
        [name, f"`{place}`", number(size)]
        for name, costs in by_database.items()
        for place, size in costs.found["row_bytes"].items()
    ]
    return (
        "## What one more costs\n\n"
        "Rows are exact: a run is its row, its result's address, audit records and its log; a set is its row, two addresses and "
        "an audit record; a sensor is its row, its ground calibration, a promotion and audit records. Database bytes are pages "
        "with their indexes, averaged over the lengths (and, of runs, the methods).\n\n"
        + table(heads, rows, (0, 1))
        + "\nA run's cost is a line through its two lengths, constant + slope × frames:\n\n"
        + table(
            ("database", "method", "CPU s a run", "CPU ms a frame", "result, kB a run", "result, kB a frame"),
            lines,
            (0, 1),
        )
        + "\nA row of a table with its indexes (`audit` is a record of the audit log, `run_events` a line of a run's log, which is "
        "also an event of the feed):\n\n" + table(("database", "table", "bytes a row"), of_row, (0, 1))
    )


def _costs_of(name: str, costs: Costs) -> Iterator[list[str]]:
    """One row a thing."""

    def row(thing: str, cost: dict[str, Any], size: float, *spent: str) -> list[str]:
        return [name, thing, _rows(cost), kilobytes(size), kilobytes(cost["blob_bytes"]), *spent]

    sensor, launch = costs.found["sensor"], costs.found["launch"]
    yield row("sensor", sensor, sensor["database_bytes"], "-", *_in_process(sensor))
    for frames, cost in costs.found["set"].items():
        yield row(f"set of {frames} frames", cost, costs.mean_set("database_bytes"), "-", *_in_process(cost))
    yield row("queued run", launch, launch["database_bytes"], "-", *_in_process(launch))
    for method, of_method in costs.found["run"].items():
        for frames, cost in of_method.items():
            if frames != "line":
                spent = number(cost["worker_cpu_s"]), number(cost["server_cpu_s"]), "-"
                yield row(f"{method} run of {frames} frames", cost, costs.mean_run("database_bytes"), *spent)


def _in_process(cost: dict[str, Any]) -> tuple[str, str]:
    """Processor and wall seconds of what the services do by themselves."""
    return number(cost["own_cpu_s"]) if "own_cpu_s" in cost else NOT_MEASURED, number(cost["seconds"])


def _rows(cost: dict[str, Any]) -> str:
    """Rows that one thing writes."""
    return number(sum(cost["rows"].values()))


def _sources(database: str, costs: Costs) -> str:
    """Where the figures of the tables come from."""
    server = (
        "The server's cost a run is that of the part `queue`."
        if costs.server_by_queue
        else "**The part `queue` was not measured yet: the server's cost a run is that of the part `footprint`, a fall-back that "
        "charges few runs with everything that the server does while they last.**"
    )
    groups = (
        "Transactions a run are one to launch it and, by the part `queue`, its share of those that claim and settle groups."
        if costs.groups_measured
        else f"Transactions a run are the most that there can be, launch, claim and settlement each by itself; how many runs share "
        f"one was {NOT_MEASURED} yet."
    )
    short, long = costs.lengths
    assumed = value("frames")
    frames = (
        f"Costs were measured with sets of {short:,} and {long:,} frames, the longer as long as assumed."
        if long == assumed
        else f"Costs were measured with sets of {short:,} and {long:,} frames and carried on to {assumed:,.0f} by the line through "
        "both, further than was measured."
    )
    return (
        f"Costs are those on {database}. {frames} {server} {groups} Sizes are of a year; rates are those of the busiest hour, "
        f"{value('peak'):g} times the mean. A share is what is needed over what one carries, in the same unit; above one, one is "
        "not enough. The first row of each table, in bold, ends first, and the last column says what is changed then.\n"
    )


def _plan(plan: Plan, costs: Costs, document: dict[str, Any]) -> str:
    """What one plan needs of everything, and how many of each that is."""
    times, frames = plan.sets[0]
    does = " and ".join(f"{often:g} {method}" for method, _, often in plan.runs)
    found = needs(plan, costs, document)
    rows = [need.cells(first=place == 0) for place, need in enumerate(found)]
    heads = (
        "resource",
        "formula",
        "needed",
        "one carries",
        "share of one",
        "trackers that one carries",
        "changed when it ends",
    )
    together = [[what, formula, f"**{many}**"] for what, formula, many in machines(found)]
    return (
        f"### {plan.name.capitalize()}\n\nA tracker and day: {times:g} sets of {frames:,.0f} frames, {does} runs of as many.\n\n"
        + table(heads, rows, (0, 1, 3, 6))
        + "\nThat is:\n\n"
        + table(("what", "formula", "how many"), together, (0, 1))
    )


def _burst(costs: Costs) -> str:
    """Recalibrating all at once."""
    cpu = sum(costs.run(method, "worker_cpu_s", value("frames")) for method in ("batch", "sqrf")) * value("trackers")
    rows = [
        [f"{cores:,}", f"{number(cpu)} CPU s / {cores:,} / 3600", f"**{number(cpu / cores / 3600)} h**"]
        for cores in (16, 64, 256)
    ]
    return (
        "## Everything again at once\n\nAfter a change of the catalogue or of a model all trackers are recalibrated, one set of "
        f"{value('frames'):,.0f} frames each, batch and filter:\n\n" + table(("worker cores", "formula", "takes"), rows)
    )


AFTER = """## What this does not say

- Costs were taken with one worker on a machine with the cores named above; a faster core divides the worker's and the
  server's seconds alike. Workers share nothing, so cores add up, until the scheduler or the writer is the limit; the part
  `queue` measures what the queue adds to each run.
- Launches stand for all transactions: those that claim and settle groups write more rows each, which the share by rows tells.
  Renewals of leases and lines of progress are a few transactions a second for a server, however many runs there are.
- Sizes hold for sets with given matches and about eleven stars an exposure; bytes grow with stars. Trust pictures make up
  most of a result's constant.
- Nothing is deleted here. An archive rule (drop results of filters after a month, keep batches) divides the files of results.
- Reads were measured on a store of one sensor, every page made anew after a commit. What pages of ten thousand sensors take is
  the part `fleet`: lists come page by page, and the overview draws the 120 sensors that stand worst. It, the top bar, the uplink
  page and the sensors of one status look at how every sensor stands, and an open console reads its page again after each event.
- The audit log's chain is verified from its first record: with the rows above, verify from a stored head, not from the beginning.
"""
