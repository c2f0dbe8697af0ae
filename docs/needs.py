"""What a plan needs, each figure with the formula that gives it, and which resource of one machine ends first."""  # noqa: INP001 - beside the scripts that use it

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from costs import DAY_S, YEAR_D, Costs, Plan, amounts, asked_per_s, read_s, value, writes
from markdown import kilobytes, number


def needs(plan: Plan, costs: Costs) -> Iterator[tuple[str, str, str]]:
    """(what, formula, answer) of a plan."""
    trackers, busy, peak = value("trackers"), value("busy"), value("peak")
    sets, runs = amounts(plan)
    yield "runs a day", f"{trackers:,.0f} × {runs / trackers:g}", f"{runs:,.0f}"
    cpu = sum(times * costs.run(method, "worker_cpu_s", frames) for method, frames, times in plan.runs)
    yield (
        "worker cores",
        f"{trackers:,.0f} × {number(cpu)} CPU s / {DAY_S:,.0f} s / {busy:g}",
        f"{number(trackers * cpu / DAY_S / busy)} cores",
    )
    cores = value("cores")
    yield (
        f"machines of {cores:g} cores",
        f"{number(trackers * cpu / DAY_S / busy)} / {cores:g}, rounded up, and one for the server and its database",
        f"{math.ceil(trackers * cpu / DAY_S / busy / cores) + 1}",
    )
    a_run, a_set = costs.server_run_s, costs.mean_set("seconds")
    server = runs * a_run + sets * a_set
    yield (
        "server processor, runs and uploads",
        f"({runs:,.0f} × {number(a_run)} s + {sets:,.0f} × {number(a_set)} s) / {DAY_S:,.0f} s",
        f"{number(server / DAY_S)} cores",
    )
    per_set, per_runs = (
        costs.set_bytes(plan.sets[0][1]),
        sum(times * costs.run(method, "blob_bytes", frames) for method, frames, times in plan.runs),
    )
    yield (
        "files of sets, a year",
        f"{sets:,.0f} × {kilobytes(per_set)} kB × {YEAR_D:g}",
        f"{number(sets * per_set * YEAR_D / 1e12)} TB",
    )
    yield (
        "files of results, a year",
        f"{trackers:,.0f} × {kilobytes(per_runs)} kB × {YEAR_D:g}",
        f"{number(trackers * per_runs * YEAR_D / 1e12)} TB",
    )
    rows = sets * costs.rows_a_set + runs * costs.rows_a_run
    yield (
        "database rows, a year",
        f"({sets:,.0f} × {costs.rows_a_set:g} + {runs:,.0f} × {number(costs.rows_a_run)}) × {YEAR_D:g}",
        f"{number(rows * YEAR_D / 1e6)} million",
    )
    a_set, a_run = costs.mean_set("database_bytes"), costs.mean_run("database_bytes")
    yield (
        "database size, a year",
        f"({sets:,.0f} × {kilobytes(a_set)} kB + {runs:,.0f} × {kilobytes(a_run)} kB) × {YEAR_D:g}",
        f"{number((sets * a_set + runs * a_run) * YEAR_D / 1e9)} GB",
    )
    yield (
        "writes a second, busiest hour",
        f"({sets:,.0f} + {runs:,.0f} × {number(costs.rows_a_run)}) / {DAY_S:,.0f} s × {peak:g}",
        f"{number(writes(plan, costs))} of {number(costs.writes_per_s)} measured",
    )


def shares(plan: Plan, costs: Costs, document: dict[str, Any]) -> Iterator[tuple[str, float, str, str]]:
    """(resource, share, where it comes from, what to change)."""
    trackers = value("trackers")
    sets, runs = amounts(plan)
    cpu = sum(times * costs.run(method, "worker_cpu_s", frames) for method, frames, times in plan.runs) * trackers
    yield (
        "worker processors", cpu / DAY_S / value("busy") / value("cores"), "judging, pictures and metrics of each run, not the fit",
        "more machines with `boresight worker`; nothing else changes",
    )  # fmt: skip
    files = sets * costs.set_bytes(plan.sets[0][1]) + trackers * sum(
        times * costs.run(method, "blob_bytes", frames) for method, frames, times in plan.runs
    )
    yield (
        "disk for files, one year", files * YEAR_D / (value("disk") * 1e12), "every upload and every result is kept, for ever",
        "an object store (`BORESIGHT_BLOBS=s3://...`), or a rule that archives old sets",
    )  # fmt: skip
    yield (
        "the single writer", writes(plan, costs) / costs.writes_per_s, "one transaction at a time, each waits for the disk",
        "PostgreSQL on a disk with a battery or flash log; fewer lines of log a run",
    )  # fmt: skip
    read = read_s(document) or 0.0
    server = (runs * costs.server_run_s + sets * costs.mean_set("seconds")) / DAY_S + asked_per_s() * read
    yield (
        "the server's process", server * value("peak"), "one Python process answers, reads uploads and keeps the queue",
        "a server more for readers on the same PostgreSQL; upload Parquet, not CSV",
    )  # fmt: skip
