"""What one more frame, run, sensor, event and audit record costs: processor time, files, rows and pages (part `footprint`).

A store is filled in stages by the services and the real queue, on SQLite and, where it is installed, on PostgreSQL; what each
stage adds is divided by what it added. So a figure holds all that comes with a thing: its audit record, its log, its indexes.

    sensors    one transaction each
    sets       the same frames for every sensor: rows; distinct sets of two lengths: bytes of files
    runs       batch and filter, of two lengths, through a server and one worker of its own

With c_1, c_2 the processor time of a run's worker at n_1 and n_2 frames, a run costs a + b n:

    b = (c_2 - c_1) / (n_2 - n_1)     a = c_1 - b n_1

and likewise for the bytes of its result; the longer sets are as long as the capacity page assumes a day's set to be, the shorter
lie near those of one orbit. Launches alone, with nothing computing, give the writer's rate: one transaction each give transactions
a second, `BULK` to a transaction give rows a second. The processor time of what this process does (sensors, sets, launches) is told
by itself, as its seconds hold waiting for the disk.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

from boresight.measurements import Report
from boresight.measurements.ledger import METHODS, Ledger
from boresight.measurements.postgresql import installed, postgresql

#: Shorter sets are a tenth of the longer ones.
SHORTER = 10
#: Launches in one transaction, to time rows and not transactions.
BULK = 50


def measure(
    report: Report, frames: int = 2000, sensors: int = 24, runs: int = 6, launches: int = 300
) -> dict[str, Any]:
    """Fill a store on each database.

    Parameters
    ----------
    report
        Told the fraction done and what is measured next.
    frames
        Of the longer sets; the shorter have a tenth.
    sensors
        How many are registered; each gets a set.
    runs
        Of each method and length.
    launches
        Runs that are only queued, to time the writer.
    """
    places = ["sqlite", *(["postgresql"] if installed() else [])]
    found: dict[str, Any] = {"frames": frames, "sensors": sensors, "runs": runs, "databases": {}}
    for turn, place in enumerate(places):

        def told(fraction: float, message: str, turn: int = turn, place: str = place) -> None:
            report((turn + fraction) / len(places), f"{place}: {message}")

        server = postgresql() if place == "postgresql" else nullcontext("")
        with server as address, tempfile.TemporaryDirectory(prefix="boresight-footprint-") as folder:
            found["databases"][place] = _filled(Path(folder), address, told, (frames, sensors, runs, launches))
    return found | {"limits": {}}


def _filled(
    folder: Path, address: str, report: Callable[[float, str], None], sizes: tuple[int, int, int, int]
) -> dict[str, Any]:
    """Fill one store; returns what each thing costs."""
    frames, sensors, runs, launches = sizes
    lengths = (max(10, frames // SHORTER), frames)
    with Ledger(folder, address) as ledger:
        report(0.0, "registering sensors")
        found: dict[str, Any] = {"sensor": ledger.each(partial(ledger.register, sensors), sensors)}
        report(0.1, "storing sets")
        found["set"] = {str(length): ledger.each(partial(ledger.store, length), sensors) for length in lengths}
        report(0.3, "timing the writer")
        found["launch"] = ledger.each(partial(ledger.launch_only, launches), launches)
        found["launch_in_bulk"] = ledger.each(partial(ledger.launch_only, launches, BULK), launches)
        ledger.cancel_all()
        report(0.4, "starting a server")
        with ledger.served():
            found["run"] = {method: _runs(ledger, method, lengths, runs, report) for method in METHODS}
        found["row_bytes"] = ledger.row_bytes()
    return found


def _runs(
    ledger: Ledger, method: str, lengths: tuple[int, int], count: int, report: Callable[[float, str], None]
) -> dict[str, Any]:
    """Costs of a method's runs, of each length and as a line through both."""
    report(0.5 + 0.2 * list(METHODS).index(method), f"{method} runs")
    ledger.run(method, lengths[0], 1)  # the worker's first run loads what it needs
    by_length = {length: ledger.each(partial(ledger.run, method, length, count), count) for length in lengths}
    return {str(length): cost for length, cost in by_length.items()} | {"line": _line(by_length)}


def _line(by_length: dict[int, dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Constant and slope a frame of what grows with the frames of a run."""
    (short, cost), (long, longer) = by_length.items()
    lines = {}
    for key in ("worker_cpu_s", "blob_bytes"):
        slope = (longer[key] - cost[key]) / (long - short)
        lines[key] = {"constant": cost[key] - slope * short, "per_frame": slope}
    return lines
