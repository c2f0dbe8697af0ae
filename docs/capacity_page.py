"""`docs/capacity.md`, written from what was measured: what a frame, a run and a sensor cost, and what ten thousand trackers need.

Everything follows from the parts `footprint` (cost of each thing) and `clients` of `docs/benchmarks.json` and from the assumptions
in `costs.ASSUMED`; each row shows its formula with the numbers in it.
"""  # noqa: INP001 - beside the scripts that use it

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from costs import ASSUMED, DAY_S, EVENTS_A_RUN, Costs, Plan, amounts, asked_per_s, plans, read_s, value
from markdown import NOT_MEASURED, kilobytes, number, table
from needs import needs, shares

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
        *(_plan(plan, name, costs) for plan in plans()),
        _readers(document),
        _ends(name, costs, document),
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
        "server, CPU s (sensors, sets, queued: wall s)",
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
    yield row("sensor", sensor, sensor["database_bytes"], "-", number(sensor["seconds"]))
    for frames, cost in costs.found["set"].items():
        yield row(f"set of {frames} frames", cost, costs.mean_set("database_bytes"), "-", number(cost["seconds"]))
    yield row("queued run", launch, launch["database_bytes"], "-", number(launch["seconds"]))
    for method, of_method in costs.found["run"].items():
        for frames, cost in of_method.items():
            if frames != "line":
                spent = number(cost["worker_cpu_s"]), number(cost["server_cpu_s"])
                yield row(f"{method} run of {frames} frames", cost, costs.mean_run("database_bytes"), *spent)


def _rows(cost: dict[str, Any]) -> str:
    """Rows that one thing writes."""
    return number(sum(cost["rows"].values()))


def _plan(plan: Plan, database: str, costs: Costs) -> str:
    """What one plan needs, each row with its formula."""
    rows = [[what, formula, f"**{answer}**"] for what, formula, answer in needs(plan, costs)]
    times, frames = plan.sets[0]
    does = " and ".join(f"{often:g} {method}" for method, _, often in plan.runs)
    return (
        f"## Ten thousand trackers, {plan.name}\n\nA tracker and day: {times:g} sets of {frames:,.0f} frames, {does} runs of as "
        f"many. Costs are those on {database}.\n\n" + table(("what", "formula", "answer"), rows, (0, 1))
    )


def _readers(document: dict[str, Any]) -> str:
    """Reads and followers."""
    asked, cost = asked_per_s(), read_s(document)
    reads = f"{value('people'):g} × {value('views'):g} / 60 + {value('polls'):g}"
    rows = [["reads a second", reads, f"**{number(asked)}**"]]
    if cost is None:
        rows.append(["server processor for them", "part `clients`", NOT_MEASURED])
    else:
        rows.append(
            [
                "server processor for them",
                f"{number(asked)} × {number(cost * 1e3)} ms",
                f"**{number(asked * cost)} cores**",
            ]
        )
        rows.append(
            [
                "reads that one server process can answer",
                f"1 / {number(cost * 1e3)} ms",
                f"**{number(1 / cost)} a second**",
            ]
        )
    events = max(amounts(plan)[1] for plan in plans()) * EVENTS_A_RUN / DAY_S * value("peak")
    rows.append(["events a second, busiest hour, most frequent plan",
                 f"{EVENTS_A_RUN} a run × {max(amounts(plan)[1] for plan in plans()):,.0f} / {DAY_S:,.0f} s × {value('peak'):g}",
                 f"**{number(events)}**"])  # fmt: skip
    rows.append(
        [
            "deliveries to followers a second",
            f"{number(events)} × {value('people'):g}",
            f"**{number(events * value('people'))}**",
        ]
    )
    feed = document.get("clients", {}).get("found", {}).get("feed")
    if feed is not None:
        known = f"{number(feed['events_per_s'])} events a second × {feed['listeners']} followers"
        rows.append(
            [
                "deliveries that one server process made",
                known,
                f"**{number(feed['events_per_s'] * feed['listeners'])}**",
            ]
        )
    return (
        "## Readers\n\nThe part `clients` measures 200 clients on the list and 500 followers of the feed.\n\n"
        + table(("what", "formula", "answer"), rows, (0, 1))
    )


def _ends(database: str, costs: Costs, document: dict[str, Any]) -> str:
    """Which resource ends first on one machine, and what to change then."""
    rows = []
    for plan in plans():
        for name, share, where, change in sorted(shares(plan, costs, document), key=lambda row: -row[1]):
            rows.append(
                [
                    plan.name,
                    name,
                    f"{share:.2g}",
                    f"{value('trackers') / share:,.0f}" if share > 0 else "-",
                    where,
                    change,
                ]
            )
    return (
        f"## Which limit comes first\n\nShares of one machine of {value('cores'):g} cores and {value('disk'):g} TB that holds the "
        f"server, its workers, {database} and a year of files; above one it does not carry ten thousand trackers, and the next "
        "column says how many it does. The first row of each plan is the limit.\n\n"
        + table(
            ("plan", "resource", "share", "trackers it carries", "where the limit comes from", "what to change then"),
            rows,
            (0, 1, 4, 5),
        )
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

- The server's processor a run is that of the part `queue` where it was measured; the part `footprint` charges its few runs with
  everything that the server does while they last.
- Costs were taken with one worker on a machine with the cores named above; a faster core divides the worker's and the
  server's seconds alike. Workers share nothing, so cores add up, until the scheduler or the writer is the limit; the part
  `queue` measures what the queue adds to each run.
- A write is counted for every row of a run; the queue writes several rows, and rows of several runs, in one transaction, so
  that the writer carries more than this says. Launches were timed one transaction each, one after the other.
- Sizes hold for sets with given matches and about eleven stars an exposure; bytes grow with stars. Trust pictures make up
  most of a result's constant.
- Nothing is deleted here. An archive rule (drop results of filters after a month, keep batches) divides the files of results.
- The audit log's chain is verified from its first record: with the rows above, verify from a stored head, not from the beginning.
"""
