"""What mutual TLS between a server and its own workers costs, against plain links in the same run.

Opens the server's cluster as it is and with plain links in turn, and tells the least of the rounds of each, for other work on the
machine only adds: the seconds, by the clock and of all processors, until its workers are there, of a task there and back, and
of a hundred megabytes from one worker to the other.

    python -m benchmarks.links [--rounds 5] [--tasks 300]
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
from distributed.diagnostics.plugin import WorkerPlugin

from boresight.settings import read_settings
from boresight.workers import cluster
from boresight.workers.cluster import Cluster
from boresight.workers.security import own_security

WORKERS = 2
LARGE_BYTES = 100_000_000
PLAIN = {"PROTOCOL": "tcp://", "own_security": lambda: None}
TLS = {"PROTOCOL": cluster.PROTOCOL, "own_security": own_security}


class Cold(WorkerPlugin):
    """In place of warming, which would compute while links are measured."""

    name = "cold"

    def __init__(self, *_arguments, **_options):
        """Take what the warm-up takes."""


def opened(links):
    """Open a cluster with one kind of links, and wait until its workers have joined."""
    vars(cluster).update(links, WarmUp=Cold)
    settings = read_settings({"BORESIGHT_DATA_FOLDER": tempfile.mkdtemp(), "BORESIGHT_WORKERS": str(WORKERS)})
    made = Cluster.open(settings, lambda _report: None)
    made._client.wait_for_workers(WORKERS, timeout=120)  # noqa: SLF001 - the links are what is measured
    return made


def spent_s():
    """Return wall time, and the processor time of this process and of all that it has started."""
    family = [psutil.Process(), *psutil.Process().children(recursive=True)]
    times = [process.cpu_times() for process in family]
    return np.array([time.perf_counter(), sum(each.user + each.system for each in times)])


def measure(links, tasks):
    """Say what one cluster took for everything."""
    before = spent_s()
    made = opened(links)
    told = {"open": spent_s() - before}
    try:
        client, (one, two) = made._client, sorted(made.workers())  # noqa: SLF001 - likewise
        client.submit(len, b"", workers=[one], pure=False).result(60)
        before = spent_s()
        for _ in range(tasks):
            client.submit(len, b"", workers=[one], pure=False).result(60)
        told["task"] = (spent_s() - before) / tasks
        held = client.submit(bytes, LARGE_BYTES, workers=[one], pure=False)
        client.submit(len, client.submit(bytes, 1, workers=[one], pure=False), workers=[two], pure=False).result(60)
        before = spent_s()
        client.submit(len, held, workers=[two], pure=False).result(60)
        told["100_mb"] = spent_s() - before
    finally:
        made.close(())
    return {f"{name}_{kind}": seconds[n] for name, seconds in told.items() for n, kind in enumerate(("s", "cpu_s"))}


def main():
    """Measure in turn, and print the least of each and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--tasks", type=int, default=300)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = {"plain": [], "tls": []}
    for _ in range(options.rounds):
        for name, links in (("plain", PLAIN), ("tls", TLS)):
            found[name].append(measure(links, options.tasks))
    least = {name: {key: min(each[key] for each in rounds) for key in rounds[0]} for name, rounds in found.items()}
    least["ratio"] = {key: least["tls"][key] / least["plain"][key] for key in least["tls"]}
    text = json.dumps(least, indent=2)
    print(text)
    if options.json:
        options.json.write_text(text)


if __name__ == "__main__":
    main()
