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
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import sqlalchemy as sa

from benchmarks import Report
from benchmarks.servers import Installation, PostgreSQL, make_environment, wait_until
from benchmarks.stores import analysts, make_key, uploaded
from boresight.console.fleet import service as sensors
from boresight.console.runs import service as runs
from boresight.console.runs.tables import TERMINAL_RUN_STATES
from boresight.console.telemetry import service as telemetry_sets
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.db.declared import Base
from boresight.platform.db.sessions import Engine, migrate, open_engine, open_reading, open_writing
from boresight.settings import read_settings
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.sensors import sensor_document

#: Shorter sets are a tenth of the longer ones.
SHORTER = 10
#: Launches in one transaction, to time rows and not transactions; and queued runs that one transaction cancels.
BULK, RUNS_AT_ONCE = 50, 500
METHODS = {"batch": {"method": "batch", "match": "given"}, "sqrf": {"method": "sqrf", "match": "given"}}
LEASE_S, LOOK_EVERY_S, STALLED_S = 10.0, 0.05, 300.0
SENSOR = 1
#: Rows from which on a table's bytes a row say something.
ENOUGH_ROWS = 40
#: Bytes of each table with its indexes, as the database itself counts its pages.
SIZES = {
    "sqlite": """SELECT coalesce(of.tbl_name, pages.name), sum(pages.pgsize) FROM dbstat AS pages
                 LEFT JOIN sqlite_schema AS of ON of.name = pages.name GROUP BY 1""",
    "postgresql": """SELECT relname, pg_total_relation_size(oid) FROM pg_class
                     WHERE relkind = 'r' AND relnamespace = 'public'::regnamespace""",
}


def measure(
    report: Report, *, frames: int = 2000, sensors: int = 24, runs: int = 6, launches: int = 300
) -> dict[str, Any]:
    """Fill a store on each database.

    `frames` are those of the longer sets, `runs` are of each method and length, `launches` are only queued, to time the writer.
    """
    found: dict[str, Any] = {"frames": frames, "sensors": sensors, "runs": runs, "databases": {}}
    sizes, with_postgresql = (frames, sensors, runs, launches), PostgreSQL.installed()

    with tempfile.TemporaryDirectory(prefix="boresight-footprint-") as folder:
        share = 0.5 if with_postgresql else 1.0
        filled = _filled(Path(folder), "", lambda done, said: report(share * done, f"sqlite: {said}"), sizes)
        found["databases"]["sqlite"] = filled
    if with_postgresql:
        with PostgreSQL() as server, tempfile.TemporaryDirectory(prefix="boresight-footprint-") as folder:
            server.execute("CREATE DATABASE boresight")
            address = server.url("boresight")
            filled = _filled(
                Path(folder), address, lambda done, said: report(0.5 + done / 2, f"postgresql: {said}"), sizes
            )
            found["databases"]["postgresql"] = filled
    return found | {"limits": {}}


def _filled(folder: Path, address: str, report: Report, sizes: tuple[int, int, int, int]) -> dict[str, Any]:
    """Fill one store; returns what each thing costs."""
    frames, sensors, runs, launches = sizes
    lengths = (max(10, frames // SHORTER), frames)
    with Ledger.opened(folder, address) as ledger:
        report(0.0, "registering sensors")
        found: dict[str, Any] = {"sensor": ledger.each(partial(ledger.register, sensors), sensors)}
        report(0.1, "storing sets")
        found["set"] = {str(length): ledger.each(partial(ledger.store, length), sensors) for length in lengths}
        report(0.3, "timing the writer")
        found["launch"] = ledger.each(partial(ledger.launch_only, launches), launches)
        found["launch_in_bulk"] = ledger.each(partial(ledger.launch_only, launches, BULK), launches)
        ledger.cancel_all()
        report(0.4, "starting a server")
        found["run"] = {}
        with ledger.served():
            for turn, method in enumerate(METHODS):
                report(0.5 + 0.2 * turn, f"{method} runs")
                ledger.run(method, lengths[0], 1)  # the worker's first run loads what it needs
                cost, longer = (ledger.each(partial(ledger.run, method, length, runs), runs) for length in lengths)
                lines = {}
                for key in ("worker_cpu_s", "blob_bytes"):
                    slope = (longer[key] - cost[key]) / (lengths[1] - lengths[0])
                    lines[key] = {"constant": cost[key] - slope * lengths[0], "per_frame": slope}
                found["run"][method] = {str(lengths[0]): cost, str(lengths[1]): longer, "line": lines}
        found["row_bytes"] = ledger.row_bytes()
    return found


def table_sizes(engine: Engine) -> dict[str, tuple[int, int]]:
    """Rows, and bytes with indexes, of every table."""
    with engine.connect() as connection:
        sizes: dict[str, int] = {row[0]: row[1] for row in connection.execute(sa.text(SIZES[engine.dialect.name]))}
        tables = Base.metadata.tables.items()
        counts = {name: connection.scalar(sa.select(sa.func.count()).select_from(table)) for name, table in tables}
    return {name: (count or 0, int(sizes.get(name, 0))) for name, count in counts.items()}


class Ledger:
    """A store that is filled step by step, and what each step adds to its rows, pages, files and processes' time."""

    def __init__(self, folder: Path, address: str) -> None:
        self._environment = make_environment(folder, 1, LEASE_S, external=False) | {"BORESIGHT_DATABASE_URL": address}
        self._settings = read_settings(self._environment)
        self.engine = open_engine(self._settings.database_url)
        self._blobs = open_blobs(self._settings.blob_location)
        self._catalogue = load_catalogue(self._settings.catalogue_folder)
        self._sensors: list[int] = []
        self._sets: dict[int, list[int]] = {}
        self._installation: Installation | None = None
        migrate(self.engine)
        self._analyst = analysts(self.engine, 1)[0]
        self._key = make_key(self.engine, self._analyst)

    @classmethod
    @contextmanager
    def opened(cls, folder: Path, address: str = "") -> Iterator[Ledger]:
        """Begin an empty data folder, with an empty database or, without an address, SQLite in the folder."""
        ledger = cls(folder, address)
        try:
            yield ledger
        finally:
            ledger.engine.dispose()

    def each(self, step: Callable[[], None], count: int) -> dict[str, Any]:
        """Take a step that makes `count` things; returns what one of them adds.

        `own_cpu_s` is of this process; while a server runs, `server_cpu_s` is of its own process and `worker_cpu_s` of its worker.
        """
        before, blobs, cpu = table_sizes(self.engine), self._blob_bytes(), self._cpu()
        began, own = time.perf_counter(), time.process_time()
        step()
        seconds, own = time.perf_counter() - began, time.process_time() - own
        after, used = table_sizes(self.engine), self._cpu()
        added = {name: after[name][0] - before[name][0] for name in after}
        return {
            "database_bytes": sum(after[name][1] - before[name][1] for name in after) / count,
            "blob_bytes": (self._blob_bytes() - blobs) / count,
            "rows": {name: number / count for name, number in added.items() if number > 0},
            "seconds": seconds / count,
            "own_cpu_s": own / count,
            **{key: (used[key] - start) / count for key, start in cpu.items()},
        }

    def row_bytes(self) -> dict[str, float]:
        """Bytes of a row with its indexes, of each table that has enough rows for its pages to be full."""
        return {name: size / rows for name, (rows, size) in table_sizes(self.engine).items() if rows >= ENOUGH_ROWS}

    def _blob_bytes(self) -> int:
        return sum(path.stat().st_size for path in self._blobs.folder.rglob("*") if path.is_file())

    def _cpu(self) -> dict[str, float]:
        if self._installation is None:
            return {}
        self._installation.look()
        server = self._installation.server
        return {"server_cpu_s": server.cpu_s(own=True), "worker_cpu_s": server.cpu_s(own=False)}

    def register(self, count: int) -> None:
        """Register sensors, one transaction each."""
        document = sensor_document(st16_sensor(SENSOR))
        for number in range(count):
            with open_writing(self.engine) as session:
                row = sensors.register_sensor(session, self._analyst, document | {"name": f"ST-{number:05d}"})
                self._sensors.append(row.id)

    def store(self, frames: int) -> None:
        """Store one set of so many frames for every sensor, each distinct by its noise."""
        self._sets[frames], rng = [], np.random.default_rng(frames)
        scenario = replace(calibration_scenario(SENSOR), frames=frames)
        first = simulate(scenario, np.random.default_rng(frames), self._catalogue)
        for sensor_id in self._sensors:
            shift = 1e-3 * rng.normal(size=(2, len(first)))  # other bytes, the same stars
            moved = replace(first, row_px=first.row_px + shift[0], col_px=first.col_px + shift[1])
            with uploaded(moved, self._catalogue, SENSOR) as upload, open_writing(self.engine) as session:
                row = telemetry_sets.store_prepared(session, self._analyst, self._blobs, sensor_id, upload)
                self._sets[frames].append(row.id)

    def launch_only(self, count: int, at_once: int = 1) -> None:
        """Queue runs, so many a transaction, with nobody there to compute them."""
        sets = self._sets[min(self._sets)]
        for first in range(0, count, at_once):
            with open_writing(self.engine) as session:
                for number in range(first, min(first + at_once, count)):
                    place, label = number % len(self._sensors), f"pass {number}"
                    runs.launch(
                        session, self._analyst, self._sensors[place], sets[place], METHODS["batch"], label=label
                    )

    def cancel_all(self) -> None:
        """Take what is queued away again."""
        queued = [0]
        while queued:
            with open_writing(self.engine) as session:
                queued = [row.id for row in runs.list_runs(session, state="QUEUED", limit=RUNS_AT_ONCE)]
                for number in queued:
                    runs.cancel(session, self._analyst, number)

    @contextmanager
    def served(self) -> Iterator[None]:
        """Serve the store, with one worker."""
        self._installation = Installation(self._settings, self._environment, 1)
        try:
            self._installation.wait_until_ready()
            yield
        finally:
            self._installation.stop()
            self._installation = None

    def run(self, method: str, frames: int, count: int) -> None:
        """Launch runs over REST, and wait until they have ended."""
        before, address = self._ended(), f"http://{self._settings.host}:{self._settings.port}"
        with httpx.Client(base_url=address, headers=self._key, timeout=60.0) as server:
            for number in range(count):
                place = number % len(self._sensors)
                order = {"sensor_id": self._sensors[place], "telemetry_set_id": self._sets[frames][place]}
                server.post("/api/v1/runs", json=order | {"settings": METHODS[method]}).raise_for_status()
        wait_until(lambda: self._ended() >= before + count, STALLED_S, LOOK_EVERY_S)

    def _ended(self) -> int:
        with open_reading(self.engine) as session:
            counts = runs.count_by_state(session)
        return sum(counts[state] for state in TERMINAL_RUN_STATES)
