"""What a plan needs of each resource, what one of it carries, and which ends first; both sides of every share have one unit."""  # noqa: INP001 - beside the scripts that use it

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from costs import DAY_S, EVENTS_A_RUN, YEAR_D, Costs, Plan, amounts, asked_per_s, events_per_s, read_s, value
from markdown import NOT_MEASURED, kilobytes, number


@dataclass(frozen=True)
class Need:
    """One resource.

    Parameters
    ----------
    name, formula
        In words and numbers.
    amount
        How much is needed, or None where a cost was not measured.
    unit
        Of the amount and of the limit.
    limit
        What one of the resource carries, or None where that was not measured.
    one
        What one is, and where its limit comes from.
    change
        What to do when it ends.
    """

    name: str
    formula: str
    amount: float | None
    unit: str
    limit: float | None
    one: str
    change: str

    @property
    def share(self) -> float | None:
        """Of one of the resource."""
        return None if self.amount is None or self.limit is None else self.amount / self.limit

    @property
    def carries(self) -> str:
        """Trackers that one of it carries."""
        return f"{value('trackers') / self.share:,.0f}" if self.share else "-"

    def cells(self, *, first: bool) -> list[str]:
        """A row of the table, the name of what ends first in bold."""
        needed = NOT_MEASURED if self.amount is None else f"{number(self.amount)} {self.unit}"
        limit = NOT_MEASURED if self.limit is None else f"{number(self.limit)} {self.unit}"
        share = "-" if self.share is None else f"{self.share:.2g}"
        name = f"**{self.name}**" if first else self.name
        return [name, self.formula, f"**{needed}**", f"{self.one}: {limit}", share, self.carries, self.change]


def needs(plan: Plan, costs: Costs, document: dict[str, Any]) -> list[Need]:
    """All resources of a plan, the one that ends first at the head, those that nothing is known of at the end."""
    found = [_workers(plan, costs), _server(plan, costs), *_database(plan, costs), _files(plan, costs)]
    found += _readers(plan, document)
    return sorted(found, key=lambda need: -(need.share or 0.0))


def _workers(plan: Plan, costs: Costs) -> Need:
    cpu, trackers, busy = _worker_cpu_s(plan, costs), value("trackers"), value("busy")
    return Need(
        "worker cores",
        f"{trackers:,.0f} × {number(cpu)} CPU s / {DAY_S:,.0f} s / {busy:g}",
        trackers * cpu / DAY_S / busy, "cores", value("cores"), "a machine of workers",
        "more machines with `boresight worker`; nothing else changes",
    )  # fmt: skip


def _worker_cpu_s(plan: Plan, costs: Costs) -> float:
    """Processor seconds of workers a tracker and day."""
    return sum(times * costs.run(method, "worker_cpu_s", frames) for method, frames, times in plan.runs)


def _server(plan: Plan, costs: Costs) -> Need:
    """The server's process: runs, and uploads where their processor time was measured."""
    (sets, runs), a_run, a_set, peak = amounts(plan), costs.server_run_s, costs.set_cpu_s, value("peak")
    spent, formula = runs * a_run, f"{runs:,.0f} × {number(a_run)} CPU s"
    if a_set is not None:
        spent, formula = spent + sets * a_set, f"({formula} + {sets:,.0f} × {number(a_set)} CPU s)"
    words = "" if a_set is not None else f" (uploads {NOT_MEASURED} in CPU s)"
    return Need(
        "server's process, runs and uploads", f"{formula} / {DAY_S:,.0f} s × {peak:g}{words}",
        spent / DAY_S * peak, "cores", 1.0, "one Python process",
        "a server more on the same PostgreSQL; upload Parquet, not CSV",
    )  # fmt: skip


def _database(plan: Plan, costs: Costs) -> Iterator[Need]:
    """The one writer, by transactions and by rows, and the disk of its machine."""
    sets, runs = amounts(plan)
    a_run, peak = costs.transactions_a_run, value("peak")
    yield Need(
        "database, transactions", f"({sets:,.0f} + {runs:,.0f} × {number(a_run)}) / {DAY_S:,.0f} s × {peak:g}",
        (sets + runs * a_run) / DAY_S * peak, "transactions/s", costs.transactions_per_s,
        "the writer, launches one transaction each",
        "a disk with a battery or flash log; launch as campaigns",
    )  # fmt: skip
    rows = sets * costs.rows_a_set + runs * costs.rows_a_run
    formula = (
        f"({sets:,.0f} × {costs.rows_a_set:g} + {runs:,.0f} × {number(costs.rows_a_run)}) / {DAY_S:,.0f} s × {peak:g}"
    )
    yield Need(
        "database, rows", formula, rows / DAY_S * peak, "rows/s", costs.rows_per_s, "the writer, launches in bulk",
        "fewer lines of log a run; a faster core for the database",
    )  # fmt: skip
    a_set, a_run = costs.mean_set("database_bytes"), costs.mean_run("database_bytes")
    yield Need(
        "database, size of a year",
        f"({sets:,.0f} × {kilobytes(a_set)} kB + {runs:,.0f} × {kilobytes(a_run)} kB) × {YEAR_D:g}",
        (sets * a_set + runs * a_run) * YEAR_D / 1e12, "TB", value("disk"), "a disk",
        "a larger disk; drop the log lines of old runs",
    )  # fmt: skip


def _files(plan: Plan, costs: Costs) -> Need:
    """Sets and results of a year."""
    sets, _ = amounts(plan)
    a_set, trackers = costs.set_bytes(plan.sets[0][1]), value("trackers")
    results = sum(times * costs.run(method, "blob_bytes", frames) for method, frames, times in plan.runs)
    return Need(
        "files of sets and results, a year",
        f"({sets:,.0f} × {kilobytes(a_set)} kB + {trackers:,.0f} × {kilobytes(results)} kB) × {YEAR_D:g}",
        (sets * a_set + trackers * results) * YEAR_D / 1e12, "TB", value("disk"), "a disk",
        "an object store (`BORESIGHT_BLOBS=s3://...`), or a rule that archives old sets",
    )  # fmt: skip


def _readers(plan: Plan, document: dict[str, Any]) -> Iterator[Need]:
    """Reads of people and programs, and deliveries to those that follow the feed."""
    read = read_s(document)
    yield Need(
        "API reads", f"{value('people'):g} × {value('views'):g} / 60 + {value('polls'):g}",
        asked_per_s(), "reads/s", None if read is None else 1 / read,
        "one Python process" + ("" if read is None else f", {number(read * 1e3)} CPU ms each"),
        "a server more for readers on the same PostgreSQL",
    )  # fmt: skip
    feed, people = document.get("clients", {}).get("found", {}).get("feed"), value("people")
    made = None if feed is None else feed["events_per_s"] * feed["listeners"]
    yield Need(
        "listeners of the feed",
        f"{EVENTS_A_RUN} events × {amounts(plan)[1]:,.0f} / {DAY_S:,.0f} s × {value('peak'):g} × {people:g}",
        events_per_s(plan) * people, "deliveries/s", made,
        "one Python process, measured at least" if feed is None else f"one Python process, {feed['listeners']} measured, at least",
        "follow one run (`?run=`) instead of all; a server more for followers",
    )  # fmt: skip


def machines(found: list[Need]) -> Iterator[tuple[str, str, str]]:
    """(what, formula, how many) of machines, processes and disks."""
    by_name, cores, disk = {need.name: need for need in found}, value("cores"), value("disk")
    workers = by_name["worker cores"].amount or 0.0
    yield "machines of workers", f"{number(workers)} / {cores:g} cores, rounded up", str(math.ceil(workers / cores))
    names = ("server's process, runs and uploads", "API reads", "listeners of the feed")
    known = [by_name[name].share for name in names if by_name[name].share is not None]
    total = sum(share for share in known if share is not None)
    lacking = "" if len(known) == len(names) else f" ({len(names) - len(known)} of {len(names)} {NOT_MEASURED})"
    formula = " + ".join(number(share) for share in known)
    processes = max(1, math.ceil(total))
    yield "server processes", f"{formula} of one, rounded up{lacking}", str(processes)
    yield "machines of servers", f"{processes} / {cores:g} cores, rounded up", str(math.ceil(processes / cores))
    size, files = by_name["database, size of a year"], by_name["files of sets and results, a year"]
    writing = [by_name[name].share or 0.0 for name in ("database, transactions", "database, rows")]
    fits = "one writes enough" if max(writing) <= 1 else f"one writes 1 / {max(writing):.2g} of what is needed"
    yield "database machine", f"there is one writer; {fits}", "1" if max(writing) <= 1 else "1, too slow"
    yield (
        f"disks of {disk:g} TB for the database, a year",
        f"{number(size.amount)} / {disk:g}, rounded up",
        _up(size.share),
    )
    yield f"disks of {disk:g} TB for files, a year", f"{number(files.amount)} / {disk:g}, rounded up", _up(files.share)


def _up(share: float | None) -> str:
    """Round a number of disks up."""
    return f"{math.ceil(share or 0.0):,}"
