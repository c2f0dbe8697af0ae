"""A store that is filled step by step, and what each step adds to its rows, its pages, its files and its processes' time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx
import numpy as np

from boresight.measurements.installation import Installation, environment_of
from boresight.services import api_keys, runs, sensors, telemetry_sets, users
from boresight.services.actors import COMMAND_LINE, Actor
from boresight.services.passwords import prepare_unjudged
from boresight.settings import read_settings
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import load_catalogue
from boresight.store.blobs import open_blobs
from boresight.store.sessions import migrate, open_engine, reading, writing
from boresight.store.sizes import table_sizes
from boresight.store.tables import TERMINAL_RUN_STATES
from boresight.telemetry.readers import write_parquet
from boresight.telemetry.sensors import sensor_document

METHODS = {"batch": {"method": "batch", "match": "given"}, "sqrf": {"method": "sqrf", "match": "given"}}
LEASE_S, LOOK_EVERY_S, STALLED_S = 10.0, 0.05, 300.0
SENSOR = 1
#: Rows from which on a table's bytes a row say something.
ENOUGH_ROWS = 40
#: Queued runs that one transaction cancels.
RUNS_AT_ONCE = 500
NAME, PASSWORD = "analyst", "analyst-of-the-ledger"  # of a store that is removed with the measurement


class Ledger:
    """A data folder with a database of its own, and where its blobs, rows and time go.

    Parameters
    ----------
    folder
        Empty data folder.
    address
        Of an empty database; empty text for SQLite in the folder.
    """

    def __init__(self, folder: Path, address: str) -> None:
        self._environment = environment_of(folder, 1, LEASE_S, external=False) | {"BORESIGHT_DATABASE_URL": address}
        self._settings = read_settings(self._environment)
        self._engine = open_engine(self._settings.database_url)
        self._blobs = open_blobs(self._settings.blob_place)
        self._catalogue = load_catalogue(self._settings.catalogue_folder)
        self._sensors: list[int] = []
        self._sets: dict[int, list[int]] = {}
        self._installation: Installation | None = None
        migrate(self._engine)
        self._analyst, self._key = self._person()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._engine.dispose()

    def _person(self) -> tuple[Actor, str]:
        """Make who launches the runs."""
        password = prepare_unjudged(PASSWORD)
        with writing(self._engine) as session:
            row = users.create_user(
                session, COMMAND_LINE, name=NAME, printed_name="Analyst", password=password, roles=("analyst",)
            )
            analyst = users.actor_of(session, row.id)
            return analyst, api_keys.create_key(session, analyst, label="measurement", scopes=("runs",))[1]

    def each(self, step: Callable[[], None], count: int) -> dict[str, Any]:
        """Take a step that makes `count` things; returns what one of them adds.

        Returns
        -------
        `database_bytes`, `blob_bytes`, `rows` by table where there are any, `seconds`, `own_cpu_s` of processors in this process,
        and while a server runs the processor time of its own process, `server_cpu_s`, and of its worker, `worker_cpu_s`.
        """
        before, blobs, cpu = table_sizes(self._engine), self._blob_bytes(), self._cpu()
        began, own = time.perf_counter(), time.process_time()
        step()
        seconds, own = time.perf_counter() - began, time.process_time() - own
        after, used = table_sizes(self._engine), self._cpu()
        added = {name: after[name].rows - before[name].rows for name in after}
        found: dict[str, Any] = {
            "database_bytes": sum(after[name].size - before[name].size for name in after) / count,
            "blob_bytes": (self._blob_bytes() - blobs) / count,
            "rows": {name: number / count for name, number in added.items() if number > 0},
            "seconds": seconds / count,
            "own_cpu_s": own / count,
        }
        for key, start in cpu.items():
            found[key] = (used[key] - start) / count
        return found

    def row_bytes(self) -> dict[str, float]:
        """Bytes of a row with its indexes, of each table that has enough rows for its pages to be full."""
        sizes = table_sizes(self._engine)
        return {name: found.size / found.rows for name, found in sizes.items() if found.rows >= ENOUGH_ROWS}

    def _blob_bytes(self) -> int:
        return sum(path.stat().st_size for path in self._blobs.folder.rglob("*") if path.is_file())

    def _cpu(self) -> dict[str, float]:
        """Processor time so far, s; empty while nothing is served."""
        if self._installation is None:
            return {}
        self._installation.look()
        server = self._installation.services["server"]
        return {"server_cpu_s": server.cpu_s(own=True), "worker_cpu_s": server.cpu_s(own=False)}

    def register(self, count: int) -> None:
        """Register sensors, one transaction each."""
        document = sensor_document(st16_sensor(SENSOR))
        for number in range(count):
            with writing(self._engine) as session:
                row = sensors.register_sensor(session, self._analyst, document | {"name": f"ST-{number:05d}"})
                self._sensors.append(row.id)

    def store(self, frames: int) -> None:
        """Store one set of so many frames for every sensor, each distinct by its noise."""
        self._sets[frames] = []
        sensor = st16_sensor(SENSOR)
        first = simulate(
            replace(calibration_scenario(SENSOR), frames=frames), np.random.default_rng(frames), self._catalogue
        )
        path = self._settings.data_folder / "set.parquet"
        rng = np.random.default_rng(frames)
        for sensor_id in self._sensors:
            shift = 1e-3 * rng.normal(size=(2, len(first)))  # other bytes, the same stars
            write_parquet(replace(first, row_px=first.row_px + shift[0], col_px=first.col_px + shift[1]), path)
            with (
                telemetry_sets.prepared(sensor_document(sensor), self._catalogue, path, path.name) as upload,
                writing(self._engine) as session,
            ):
                self._sets[frames].append(
                    telemetry_sets.store_prepared(session, self._analyst, self._blobs, sensor_id, upload).id
                )
        path.unlink()

    def launch_only(self, count: int, at_once: int = 1) -> None:
        """Queue runs, so many a transaction, with nobody there to compute them."""
        shortest = min(self._sets)
        for first in range(0, count, at_once):
            with writing(self._engine) as session:
                for number in range(first, min(first + at_once, count)):
                    place = number % len(self._sensors)
                    sensor_id, set_id = self._sensors[place], self._sets[shortest][place]
                    runs.launch(session, self._analyst, sensor_id, set_id, METHODS["batch"], label=f"pass {number}")

    def cancel_all(self) -> None:
        """Take what is queued away again."""
        while True:
            with writing(self._engine) as session:
                queued = [row.id for row in runs.list_runs(session, state="QUEUED", limit=RUNS_AT_ONCE)]
                for number in queued:
                    runs.cancel(session, self._analyst, number)
            if not queued:
                return

    @contextmanager
    def served(self) -> Iterator[None]:
        """Serve the store, with one worker."""
        self._installation = Installation(self._settings, os.environ | self._environment, 1)
        try:
            self._installation.wait_until_ready()
            yield
        finally:
            self._installation.stop()
            self._installation = None

    def run(self, method: str, frames: int, count: int) -> None:
        """Launch runs over REST, and wait until they have ended."""
        before = self._ended()
        headers = {"Authorization": f"Bearer {self._key}"}
        address = f"http://{self._settings.host}:{self._settings.port}"
        with httpx.Client(base_url=address, headers=headers, timeout=60.0) as server:
            for number in range(count):
                place = number % len(self._sensors)
                order = {
                    "sensor_id": self._sensors[place],
                    "telemetry_set_id": self._sets[frames][place],
                    "settings": METHODS[method],
                }
                server.post("/api/v1/runs", json=order).raise_for_status()
        until_s = time.monotonic() + STALLED_S
        while self._ended() < before + count:
            if time.monotonic() > until_s:
                raise TimeoutError(f"The runs did not end within {STALLED_S:.0f} s.")
            time.sleep(LOOK_EVERY_S)

    def _ended(self) -> int:
        with reading(self._engine) as session:
            counts = runs.count_by_state(session)
        return sum(counts[state] for state in TERMINAL_RUN_STATES)
