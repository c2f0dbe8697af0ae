"""`docs/capacity.md`, written from what was measured: what a frame, a run and a sensor cost, and what ten thousand trackers need.

Everything follows from the parts `footprint` (cost of each thing), `queue` (the server's cost of a run, and how many share a
transaction) and `clients` (cost of a read) of `docs/benchmarks.json`, and from `ASSUMED`; each row shows its formula with the
numbers in it. Both sides of every share have one unit, and seconds of processors and of the wall are never added.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from benchmarks.pages.tables import NOT_MEASURED, kilobytes, number, table

Found = Mapping[str, Any]

DAY_S, YEAR_D = 86_400.0, 365.25
NEEDED = ("footprint", "queue", "clients")
#: Queued, running, ended, and as many lines of progress.
EVENTS_A_RUN = 6

#: name -> (value, unit, why)
ASSUMED: dict[str, tuple[float, str, str]] = {
    "trackers": (10_000, "", "the constellation"),
    "frames": (2_000, "a tracker and day", "one downlinked set a day, two exposures of about twelve stars each"),
    "passes": (15, "a day", "orbits of 96 minutes; the second plan sends a set at each"),
    "busy": (0.5, "", "share of a core that may be used on average: the rest is for peaks, repeats and upgrades"),
    "peak": (3, "", "writes and uploads of the busiest hour over the mean: downlinks come in bunches"),
    "people": (100, "", "consoles open at once, each following the feed"),
    "views": (2, "a minute and console", "pages or figures looked at"),
    "polls": (5, "a second", "reads of programs: telemetry chains, dashboards, monitoring"),
    "disk": (4, "TB", "of one disk"),
    "cores": (16, "", "of one machine"),
}
TRACKERS, FRAMES, PASSES, BUSY, PEAK, PEOPLE, VIEWS, POLLS, DISK, CORES = (value for value, _, _ in ASSUMED.values())
READS_PER_S = PEOPLE * VIEWS / 60 + POLLS

HEAD = """# Capacity: from one tracker to ten thousand

What Boresight costs was measured on a small machine (part `footprint`, on SQLite and on PostgreSQL); what a constellation needs is
those figures carried on by arithmetic that is shown. No constellation of this size was run. The page is written by
`python -m benchmarks.pages` from `docs/benchmarks.json`; a test holds that it says what the JSON says.

```sh
python -m benchmarks --part footprint    # what each thing costs: seconds of processors, bytes of files, rows and pages
python -m benchmarks --part queue        # what the queue adds, and its rate
python -m benchmarks --part clients      # what a read and a follower cost the server
python -m benchmarks.pages --part footprint --part queue --part clients
```
"""

AFTER = """## What this does not say

- Costs were taken with one worker on a machine with the cores named above; a faster core divides the worker's and the
  server's seconds alike. Workers share nothing, so cores add up, until the scheduler or the writer is the limit; the part
  `queue` measures what the queue adds to each run.
- Launches stand for all transactions: those that claim and settle groups write more rows each, which the share by rows tells.
  Renewals of leases and lines of progress are a few transactions a second for a server, however many runs there are.
- Sizes hold for sets with given matches and about eleven stars an exposure; bytes grow with stars. Trust pictures make up
  most of a result's constant.
- Nothing is deleted here. An archive rule (drop results of filters after a month, keep batches) divides the files of results.
- Reads were measured on a store of one sensor, every page made again after a commit. What pages of ten thousand sensors take is
  the part `fleet`: lists come page by page, and the overview draws the 120 sensors that stand worst. It, the top bar, the uplink
  page and the sensors of one status look at how every sensor stands, and an open console reads its page again after each event.
- The audit log's chain is verified from its first record: with the rows above, verify from a stored head, not from the beginning.
"""


@dataclass(frozen=True)
class Plan:
    """How often what is calibrated: sets of so many frames a tracker and day, and of each so many runs of a method."""

    name: str
    sets: float
    frames: float
    runs: Mapping[str, float]

    @property
    def sets_a_day(self) -> float:
        """Of all trackers."""
        return TRACKERS * self.sets

    @property
    def runs_a_day(self) -> float:
        """Of all trackers."""
        return TRACKERS * sum(self.runs.values())


PLANS = (
    Plan("Daily", 1, FRAMES, {"batch": 1, "sqrf": 1}),
    Plan("Every orbit", PASSES, FRAMES / PASSES, {"sqrf": PASSES, "batch": PASSES}),
)


@dataclass(frozen=True)
class Costs:
    """What one thing costs on one database, by the part `footprint`, and what the server does for a run, by `queue`."""

    found: Found
    calm: Found

    @cached_property
    def _runs(self) -> list[Found]:
        return [cost for method in self.found["run"].values() for name, cost in method.items() if name != "line"]

    @property
    def server_run_s(self) -> float:
        """Processor seconds of the server's process a run."""
        return float(self.calm["server_cpu_ms_per_run"]) / 1e3

    @property
    def transactions_a_run(self) -> float:
        """One to launch it, and its share of those that claim and settle groups."""
        return 1.0 + float(self.calm["claims_per_run"]) + float(self.calm["settlements_per_run"])

    def run(self, method: str, key: str, frames: float) -> float:
        """`worker_cpu_s` or `blob_bytes` of a run of so many frames: constant and slope."""
        line = self.found["run"][method]["line"][key]
        return float(max(0.0, line["constant"]) + line["per_frame"] * frames)

    def mean_run(self, key: str) -> float:
        """What does not depend on frames, averaged over the runs of all methods and lengths."""
        return float(sum(cost[key] for cost in self._runs) / len(self._runs))

    @property
    def rows_a_run(self) -> float:
        """Rows that a run writes, its audit records and log lines among them."""
        return float(sum(sum(cost["rows"].values()) for cost in self._runs) / len(self._runs))

    def set_bytes(self, frames: float) -> float:
        """Bytes of files of a set: the upload and the table made of it."""
        (short, cost), (long, longer) = ((int(name), cost) for name, cost in self.found["set"].items())
        slope = (longer["blob_bytes"] - cost["blob_bytes"]) / (long - short)
        return float(max(0.0, cost["blob_bytes"] - slope * short) + slope * frames)

    def mean_set(self, key: str) -> float:
        """Of a set, averaged over both lengths."""
        return float(sum(cost[key] for cost in self.found["set"].values()) / len(self.found["set"]))

    @property
    def rows_a_set(self) -> float:
        """Rows that a set writes."""
        return float(sum(next(iter(self.found["set"].values()))["rows"].values()))


def page(document: Mapping[str, Found]) -> str:
    """Write the page."""
    if missing := [name for name in NEEDED if name not in document]:
        return HEAD + f"\nThe part `{missing[0]}` was {NOT_MEASURED} yet.\n"
    calm, clients = document["queue"]["found"]["calm"], document["clients"]["found"]
    by_database = {name: Costs(one, calm) for name, one in document["footprint"]["found"]["databases"].items()}
    name, costs = list(by_database.items())[-1]
    machine = document["footprint"]["machine"]
    assumed = [
        [f"`{key}`", number(worth if worth % 1 else int(worth)), unit, why]
        for key, (worth, unit, why) in ASSUMED.items()
    ]
    at, load = (
        machine["measured_at"][:16].replace("T", " "),
        f"load average {machine['load_average'][0]:g} when it began",
    )
    return "\n".join([
        HEAD,
        f"Measured on {machine['processor']}, {machine['cores']} cores, at {at} UTC, {load}.\n",
        "## What is assumed\n\n" + table(("name", "value", "unit", "meaning"), assumed, (0, 2, 3)),
        _measured(by_database),
        "## What ten thousand trackers need\n",
        _sources(name, costs),
        *(_plan(plan, costs, clients) for plan in PLANS),
        _burst(costs),
        AFTER,
    ])  # fmt: skip


def _measured(by_database: Mapping[str, Costs]) -> str:
    rows = [[name, *row] for name, costs in by_database.items() for row in _list_costs(costs)]
    lines = [
        [name, method, number(line["worker_cpu_s"]["constant"]), number(line["worker_cpu_s"]["per_frame"] * 1e3),
         kilobytes(line["blob_bytes"]["constant"]), kilobytes(line["blob_bytes"]["per_frame"])]
        for name, costs in by_database.items()
        for method, line in ((method, found["line"]) for method, found in costs.found["run"].items())
    ]  # fmt: skip
    heads = ("database", "one more", "rows", "database, kB", "files, kB", "worker, CPU s", "server, CPU s", "wall, s")
    line_heads = ("database", "method", "CPU s a run", "CPU ms a frame", "result, kB a run", "result, kB a frame")
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
        + table(line_heads, lines, (0, 1))
        + "\nA row of a table with its indexes (`audit` is a record of the audit log, `run_events` a line of a run's log, which is "
        "also an event of the feed):\n\n" + table(("database", "table", "bytes a row"), of_row, (0, 1))
    )


def _list_costs(costs: Costs) -> Iterator[list[str]]:
    def row(thing: str, cost: Found, size: float, *spent: float | str) -> list[str]:
        return [
            thing,
            number(sum(cost["rows"].values())),
            kilobytes(size),
            kilobytes(cost["blob_bytes"]),
            *map(number, spent),
        ]

    sensor, launch = costs.found["sensor"], costs.found["launch"]
    yield row("sensor", sensor, sensor["database_bytes"], "-", sensor["own_cpu_s"], sensor["seconds"])
    for frames, cost in costs.found["set"].items():
        size = costs.mean_set("database_bytes")
        yield row(f"set of {frames} frames", cost, size, "-", cost["own_cpu_s"], cost["seconds"])
    yield row("queued run", launch, launch["database_bytes"], "-", launch["own_cpu_s"], launch["seconds"])
    for method, of_method in costs.found["run"].items():
        for frames, cost in of_method.items():
            if frames != "line":
                size = costs.mean_run("database_bytes")
                yield row(
                    f"{method} run of {frames} frames", cost, size, cost["worker_cpu_s"], cost["server_cpu_s"], "-"
                )


def _sources(database: str, costs: Costs) -> str:
    short, long = sorted(int(name) for name in costs.found["set"])
    lengths = f"Costs were measured with sets of {short:,} and {long:,} frames"
    frames = (
        f"{lengths}, the longer as long as assumed."
        if long == FRAMES
        else f"{lengths} and carried on to {FRAMES:,.0f} by the line through both, further than was measured."
    )
    return (
        f"Costs are those on {database}. {frames} The server's cost a run is that of the part `queue`. Transactions a run are one "
        "to launch it and, by the part `queue`, its share of those that claim and settle groups. Sizes are of a year; rates are "
        f"those of the busiest hour, {PEAK:g} times the mean. A share is what is needed over what one carries, in the same unit; "
        "above one, one is not enough. The first row of each table, in bold, ends first, and the last column says what is changed "
        "then.\n"
    )


def _plan(plan: Plan, costs: Costs, clients: Found) -> str:
    """What one plan needs of everything, and how many of each that is."""
    does = " and ".join(f"{often:g} {method}" for method, often in plan.runs.items())
    found = sorted(_needs(plan, costs, clients), key=lambda need: -need.share)
    rows = [need.cells(first=place == 0) for place, need in enumerate(found)]
    heads = (
        "resource", "formula", "needed", "one carries", "share of one", "trackers that one carries", "changed when it ends",
    )  # fmt: skip
    together = [[what, formula, f"**{many}**"] for what, formula, many in _machines(found)]
    return (
        f"### {plan.name}\n\nA tracker and day: {plan.sets:g} sets of {plan.frames:,.0f} frames, {does} runs of as many.\n\n"
        + table(heads, rows, (0, 1, 3, 6))
        + "\nThat is:\n\n"
        + table(("what", "formula", "how many"), together, (0, 1))
    )


@dataclass(frozen=True)
class Need:
    """One resource: how much of it is needed and by which formula, what one carries, what one is, and what to do when it ends."""

    name: str
    formula: str
    amount: float
    unit: str
    limit: float
    one: str
    change: str

    @property
    def share(self) -> float:
        """Of one of the resource."""
        return self.amount / self.limit

    def cells(self, *, first: bool) -> list[str]:
        """A row of the table, the name of what ends first in bold."""
        return [
            f"**{self.name}**" if first else self.name, self.formula, f"**{number(self.amount)} {self.unit}**",
            f"{self.one}: {number(self.limit)} {self.unit}", f"{self.share:.2g}", f"{TRACKERS / self.share:,.0f}", self.change,
        ]  # fmt: skip


WORKERS, SERVER, READS, LISTENERS = (
    "worker cores",
    "server's process, runs and uploads",
    "API reads",
    "listeners of the feed",
)
TRANSACTIONS, ROWS = "database, transactions", "database, rows"
DATABASE_SIZE, FILES = "database, size of a year", "files of sets and results, a year"


def _needs(plan: Plan, costs: Costs, clients: Found) -> Iterator[Need]:
    sets, runs, launch, bulk = plan.sets_a_day, plan.runs_a_day, costs.found["launch"], costs.found["launch_in_bulk"]
    worker, results = (
        sum(times * costs.run(method, key, plan.frames) for method, times in plan.runs.items())
        for key in ("worker_cpu_s", "blob_bytes")
    )
    yield Need(
        WORKERS, f"{TRACKERS:,.0f} × {number(worker)} CPU s / {DAY_S:,.0f} s / {BUSY:g}", TRACKERS * worker / DAY_S / BUSY, "cores",
        CORES, "a machine of workers", "more machines with `boresight worker`; nothing else changes",
    )  # fmt: skip
    a_run, a_set = costs.server_run_s, costs.mean_set("own_cpu_s")
    yield Need(
        SERVER, f"({runs:,.0f} × {number(a_run)} CPU s + {sets:,.0f} × {number(a_set)} CPU s) / {DAY_S:,.0f} s × {PEAK:g}",
        (runs * a_run + sets * a_set) / DAY_S * PEAK, "cores", 1.0, "one Python process",
        "a server more on the same PostgreSQL; upload Parquet, not CSV",
    )  # fmt: skip
    a_run = costs.transactions_a_run
    yield Need(
        TRANSACTIONS, f"({sets:,.0f} + {runs:,.0f} × {number(a_run)}) / {DAY_S:,.0f} s × {PEAK:g}",
        (sets + runs * a_run) / DAY_S * PEAK, "transactions/s", 1 / launch["seconds"],
        "the writer, launches one transaction each", "a disk with a battery or flash log; launch as campaigns",
    )  # fmt: skip
    a_run, a_set = costs.rows_a_run, costs.rows_a_set
    yield Need(
        ROWS, f"({sets:,.0f} × {a_set:g} + {runs:,.0f} × {number(a_run)}) / {DAY_S:,.0f} s × {PEAK:g}",
        (sets * a_set + runs * a_run) / DAY_S * PEAK, "rows/s", sum(bulk["rows"].values()) / bulk["seconds"],
        "the writer, launches in bulk", "fewer lines of log a run; a faster core for the database",
    )  # fmt: skip
    a_set, a_run = costs.mean_set("database_bytes"), costs.mean_run("database_bytes")
    yield Need(
        DATABASE_SIZE, f"({sets:,.0f} × {kilobytes(a_set)} kB + {runs:,.0f} × {kilobytes(a_run)} kB) × {YEAR_D:g}",
        (sets * a_set + runs * a_run) * YEAR_D / 1e12, "TB", DISK, "a disk", "a larger disk; drop the log lines of old runs",
    )  # fmt: skip
    a_set = costs.set_bytes(plan.frames)
    yield Need(
        FILES, f"({sets:,.0f} × {kilobytes(a_set)} kB + {TRACKERS:,.0f} × {kilobytes(results)} kB) × {YEAR_D:g}",
        (sets * a_set + TRACKERS * results) * YEAR_D / 1e12, "TB", DISK, "a disk",
        "an object store (`BORESIGHT_BLOBS=s3://...`), or a rule that archives old sets",
    )  # fmt: skip
    page_s, list_s = (
        clients[name]["server_us_per_request"] * 1e-6 for name in ("page_while_writing", "list_while_writing")
    )
    read_s = (PEOPLE * VIEWS / 60 * page_s + POLLS * list_s) / READS_PER_S
    yield Need(
        READS, f"{PEOPLE:g} × {VIEWS:g} / 60 + {POLLS:g}", READS_PER_S, "reads/s", 1 / read_s,
        f"one Python process, {number(read_s * 1e3)} CPU ms each", "a server more for readers on the same PostgreSQL",
    )  # fmt: skip
    feed = clients["feed"]
    yield Need(
        LISTENERS, f"{EVENTS_A_RUN} events × {runs:,.0f} / {DAY_S:,.0f} s × {PEAK:g} × {PEOPLE:g}",
        EVENTS_A_RUN * runs / DAY_S * PEAK * PEOPLE, "deliveries/s", feed["events_per_s"] * feed["listeners"],
        f"one Python process, {feed['listeners']} measured, at least",
        "follow one run (`?run=`) instead of all; a server more for followers",
    )  # fmt: skip


def _machines(found: list[Need]) -> Iterator[tuple[str, str, str]]:
    """(what, formula, how many) of machines, processes and disks."""
    by_name = {need.name: need for need in found}
    workers = by_name[WORKERS].amount
    yield "machines of workers", f"{number(workers)} / {CORES:g} cores, rounded up", str(math.ceil(workers / CORES))
    shares = [by_name[name].share for name in (SERVER, READS, LISTENERS)]
    processes = max(1, math.ceil(sum(shares)))
    yield "server processes", f"{' + '.join(map(number, shares))} of one, rounded up", str(processes)
    yield "machines of servers", f"{processes} / {CORES:g} cores, rounded up", str(math.ceil(processes / CORES))
    writing = max(by_name[TRANSACTIONS].share, by_name[ROWS].share)
    fits = "one writes enough" if writing <= 1 else f"one writes 1 / {writing:.2g} of what is needed"
    yield "database machine", f"there is one writer; {fits}", "1" if writing <= 1 else "1, too slow"
    for what, need in (("the database", by_name[DATABASE_SIZE]), ("files", by_name[FILES])):
        disks = f"disks of {DISK:g} TB for {what}, a year"
        yield disks, f"{number(need.amount)} / {DISK:g}, rounded up", f"{math.ceil(need.share):,}"


def _burst(costs: Costs) -> str:
    cpu = sum(costs.run(method, "worker_cpu_s", FRAMES) for method in ("batch", "sqrf")) * TRACKERS
    rows = [
        [f"{cores:,}", f"{number(cpu)} CPU s / {cores:,} / 3600", f"**{number(cpu / cores / 3600)} h**"]
        for cores in (16, 64, 256)
    ]
    return (
        "## Everything again at once\n\nAfter a change of the catalogue or of a model all trackers are recalibrated, one set of "
        f"{FRAMES:,.0f} frames each, batch and filter:\n\n" + table(("worker cores", "formula", "takes"), rows)
    )
