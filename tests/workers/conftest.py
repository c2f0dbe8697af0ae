"""A real store with a telemetry set, and dispatchers with real worker processes on it."""

import contextlib
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.servers import wait_until
from boresight.console.fleet.tables import Sensor
from boresight.console.runs import queries as runs
from boresight.console.runs.queries import list_events
from boresight.console.runs.tables import TERMINAL_RUN_STATES, Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.audit import chain
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import migrate, open_engine, open_reading, open_writing, utc_now
from boresight.settings import Settings, read_settings
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_parquet
from boresight.workers import cluster
from boresight.workers.dispatcher import RunDispatcher
from tests.stores import environment_in

sys.path.insert(0, str(Path(__file__).parent))  # where worker processes, which inherit the path, find the stand-in
from standin import Unwarmed

CALCULATION = "standin:calculate"
PATIENCE_S = 300.0  # how quick a machine is, is no claim here


class Store:
    def __init__(self, folder: Path, catalogue: Path, **settings: str) -> None:
        shutil.copytree(catalogue, folder / "catalogue")
        environment = {"workers": "2", "lease_s": "3", "max_attempts": "3", "data_folder": str(folder)} | settings
        self.environment = {f"BORESIGHT_{name.upper()}": value for name, value in environment.items()}
        self.environment |= environment_in(folder)
        self.settings: Settings = read_settings(self.environment)
        self.database = open_engine(self.settings.database_url)
        self.blobs = open_blobs(self.settings.blob_location)
        self.marks = folder / "marks"
        self.marks.mkdir()
        migrate(self.database)
        self.sensor_id, self.set_id = self._furnish(folder)

    def _furnish(self, folder: Path) -> tuple[int, int]:
        table = folder / "table.parquet"
        write_parquet(four_stars(), table)
        sha256 = self.blobs.put(table)
        with open_writing(self.database) as session:
            register_blob(session, self.blobs, sha256, "application/vnd.apache.parquet")
            document = sensor_document(st16_sensor(1))
            sensor = Sensor(name="ST-1", document=document, created_utc=utc_now(), version=1, simulated=1)
            session.add(sensor)
            session.flush()
            telemetry = TelemetrySet(
                sensor_id=sensor.id,
                name="set",
                purpose="calibration",
                original_sha256=sha256,
                table_sha256=sha256,
                frames=1,
                stars=4,
                quality={},
                uploaded_utc=utc_now(),
            )
            session.add(telemetry)
            session.flush()
            chain.append_own(session, "furnished", "sensors/1")
            return sensor.id, telemetry.id

    def launch(self, behaviour: str, count: int = 1) -> list[int]:
        with open_writing(self.database) as session:
            return [self._add(session, behaviour) for _ in range(count)]

    def _add(self, session, behaviour: str) -> int:
        document = sensor_document(st16_sensor(1))
        run = runs.add_run(
            session,
            sensor_id=self.sensor_id,
            telemetry_set_id=self.set_id,
            method="batch",
            settings={"method": "batch"},
            sensor_document=document,
            label=behaviour,
        )
        run.sensor_document = document | {"name": f"{behaviour}-{run.id}"}
        session.flush()
        chain.append_own(session, "launched", f"runs/{run.id}")
        return run.id

    def cancel(self, run_id: int) -> str:
        with open_writing(self.database) as session:
            chain.append_own(session, "cancelled", f"runs/{run_id}")
            return runs.request_cancel(session, run_id, "Cancelled in a test.").state

    def run(self, run_id: int) -> Run:
        with open_reading(self.database) as session:
            return runs.find_run(session, run_id)

    def states(self, run_ids) -> list[str]:
        with open_reading(self.database) as session:
            found = runs.read_states(session, run_ids)
        by_id = {run_id: state for (run_id, _), state in found.items()}
        return [by_id[run_id] for run_id in run_ids]

    def log(self, run_id: int, kind: str) -> list[str]:
        with open_reading(self.database) as session:
            return [event.message for event in list_events(session, run_id, 0, None) if event.kind == kind]

    def ends(self, run_id: int) -> list[str]:
        with open_reading(self.database) as session:
            words = [event.state for event in list_events(session, run_id, 0, None) if event.state]
        return [word for word in words if word in TERMINAL_RUN_STATES]

    def processes(self) -> list[int]:
        names = sorted((path.name for path in self.marks.iterdir()), key=lambda name: int(name.split("-")[-1]))
        return [int(name.split("-")[2]) for name in names]

    def alive(self) -> set[int]:
        return {pid for pid in self.processes() if is_alive(pid)}

    def begun(self, run_id: int) -> list[int]:
        paths = sorted(self.marks.glob(f"*-{run_id}-*-*"), key=lambda path: int(path.name.split("-")[-1]))
        return [int(path.name.split("-")[2]) for path in paths]

    def wait_for(self, condition) -> None:
        wait_until(condition, PATIENCE_S, 0.05)

    def wait_until_ended(self, run_ids) -> list[str]:
        self.wait_for(lambda: all(state in TERMINAL_RUN_STATES for state in self.states(run_ids)))
        return self.states(run_ids)


def is_alive(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    return False


def four_stars() -> Telemetry:
    return Telemetry(
        frame=np.zeros(4, np.int64),
        exposure=np.zeros(4, np.int64),
        row_px=np.array([100.0, 200.0, 900.0, 1500.0]),
        col_px=np.array([100.0, 2000.0, 300.0, 1500.0]),
        star_id=np.array([1, 2, 3, 4]),
    )


@pytest.fixture(scope="module")
def make_store(tmp_path_factory, catalogue_folder, catalogue):  # noqa: ARG001 - it fills the folder
    made = []
    with pytest.MonkeyPatch.context() as environment:
        environment.setattr(cluster, "WarmUp", Unwarmed)

        def make(**settings):
            made.append(Store(tmp_path_factory.mktemp("data"), catalogue_folder, **settings))
            environment.setenv("BORESIGHT_TEST_MARKS", str(made[-1].marks))
            return made[-1]

        yield make
    for store in made:
        store.database.dispose()


@pytest.fixture(scope="module")
def start_dispatcher():
    started = []

    def start(store, broadcast=None, **options):
        dispatcher = RunDispatcher(store.database, store.settings, broadcast, calculation=CALCULATION, **options)
        dispatcher.start()
        started.append(dispatcher)
        return dispatcher

    yield start
    for dispatcher in started:
        dispatcher.stop()
