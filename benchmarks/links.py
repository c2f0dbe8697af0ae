"""What mutual TLS between a server and its own workers costs, against plain links in the same run.

    python -m benchmarks.links [--rounds 5] [--tasks 300]

Opens the server's cluster as it is and with plain links in turn, and tells the least of the rounds of each, for other work on the
machine only adds: the seconds, by the clock and of all processors, until its workers are there, of a task there and back, and
of a hundred megabytes from one worker to the other.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from typing import Any

import click
import numpy as np
import psutil
from distributed.diagnostics.plugin import WorkerPlugin

from boresight.arrays import FloatArray
from boresight.cli.output import json_option, write_json
from boresight.settings import read_settings
from boresight.workers import cluster
from boresight.workers.cluster import Cluster
from boresight.workers.security import PROTOCOL, own_security

WORKERS, LARGE_BYTES = 2, 100_000_000
LINKS: dict[str, dict[str, Any]] = {
    "plain": {"PROTOCOL": "tcp://", "own_security": lambda: None},
    "tls": {"PROTOCOL": PROTOCOL, "own_security": own_security},
}


class Cold(WorkerPlugin):  # type: ignore[misc] # a class of an untyped library
    """In place of warming, which would compute while links are measured."""

    name = "cold"

    def __init__(self, *_arguments: object, **_options: object) -> None:
        """Take what the warm-up takes."""


def spent_s() -> FloatArray:
    """Return wall time, and the processor time of this process and of all that it has started."""
    family = [psutil.Process(), *psutil.Process().children(recursive=True)]
    times = [process.cpu_times() for process in family]
    return np.array([time.perf_counter(), sum(each.user + each.system for each in times)])


def measure(links: dict[str, Any], tasks: int) -> dict[str, float]:
    """Say what one cluster took for everything."""
    vars(cluster).update(links, WarmUp=Cold)
    settings = read_settings({"BORESIGHT_DATA_FOLDER": tempfile.mkdtemp(), "BORESIGHT_WORKERS": str(WORKERS)})
    before = spent_s()
    made = Cluster.open(settings, lambda _report: None)
    client = made._client  # noqa: SLF001 - the links are what is measured

    def run(function: Callable[..., Any], argument: object, worker: str) -> Any:
        return client.submit(function, argument, workers=[worker], pure=False)

    try:
        client.wait_for_workers(WORKERS, timeout=120)
        told = {"open": spent_s() - before}
        one, two = sorted(made.workers())
        run(len, b"", one).result(60)
        before = spent_s()
        for _ in range(tasks):
            run(len, b"", one).result(60)
        told["task"] = (spent_s() - before) / tasks
        held = run(bytes, LARGE_BYTES, one)
        run(len, run(bytes, 1, one), two).result(60)
        before = spent_s()
        run(len, held, two).result(60)
        told["100_mb"] = spent_s() - before
    finally:
        made.close(())
    return {f"{name}_{kind}": seconds[n] for name, seconds in told.items() for n, kind in enumerate(("s", "cpu_s"))}


@click.command(help=__doc__)
@click.option("--rounds", default=5)
@click.option("--tasks", default=300)
@json_option
def main(*, rounds: int, tasks: int, json_file: str | None) -> None:
    """Measure in turn, and print the least of each and their ratio."""
    found: dict[str, list[dict[str, float]]] = {name: [] for name in LINKS}
    for _ in range(rounds):
        for name, links in LINKS.items():
            found[name].append(measure(links, tasks))
    least = {name: {key: float(min(each[key] for each in of)) for key in of[0]} for name, of in found.items()}
    least["ratio"] = {key: least["tls"][key] / least["plain"][key] for key in least["tls"]}
    write_json(least, json_file or "-")


if __name__ == "__main__":
    main()
