"""What the queue adds to the computing, and that it loses nothing: thousands of small runs through an installation (part `queue`).

Two passes over the same constellation, each in a data folder of its own:

- `calm`: a server with its own workers;
- `killed`: a server, a scheduler and workers as separate processes; on the way one worker, then the scheduler, then the
  server is killed with SIGKILL and started again by what stands for the service manager.

The runs are launched as campaigns over REST. With T threads, wall time w and the seconds s_i that the workers state for run i,
which hold reading, calibrating and making the JSON of its result, the overhead is told::

    per run             (w T - sum s_i) / n         what the queue makes the workers wait
    share               (w T - sum s_i) / sum s_i
    CPU per run         (C - sum c_i) / n           C processor time of all processes, c_i of run i as its worker states it
    CPU share           (C - sum c_i) / sum c_i
    over alone          w T / n - s, C / n - c      s, c the mean of the same work in T bare processes, before anything starts

Keeping a result on the disk goes on in a thread of its own while the next run computes; s_i and c_i hold nothing of it, and so it
is overhead. On a machine with no more cores than workers the server computes where a worker would, and s_i grows by that: the
first two figures then flatter. Processor time does not, but for caches and clocks that are shared; what a run costs beyond bare
processes of its kind flatters nobody, and is held to the same limit by either clock. What all processes use beyond what the workers
state has no limit: it holds what they use while they wait, and so grows with the time a run takes. All hold what the processes do
beside the runs, the maintenance's walks of the audit log too, and with kills the start of what was killed.
"""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from benchmarks import Report, held
from benchmarks.servers import Installation, make_environment
from benchmarks.stores import Constellation, compute_digest, furnish, wait_for_result
from boresight.console.campaigns.service import MOST_SENSORS
from boresight.console.runs import service as run_service
from boresight.console.runs.tables import TERMINAL_RUN_STATES, Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session, open_reading
from boresight.settings import Settings, read_settings
from boresight.simulation.sensors import SENSOR_NUMBERS
from boresight.sky.catalogue import load_catalogue

OVERHEAD_LIMIT_MS = 10.0
SHARE_LIMIT = 0.05
LEASE_S = 5.0
LOOK_EVERY_S = 0.25
STALLED_S = 600.0
SETTINGS = {"method": "batch"}
THREADS = 2
ALONE_RUNS = 50  # before the calm pass, which is what the limits are held against; with kills one is told
KILLS = {"worker 1": 0.2, "scheduler": 0.4, "server": 0.6}  # at which share of the runs ended


def measure(report: Report, *, runs: int = 5000, frames: int = 200, trackers: int = 1000) -> dict[str, Any]:
    """Send so many runs of so many frames, divided among the trackers, through the queue: undisturbed and with kills."""
    calm = one_pass(lambda share, said: report(share / 2, f"calm: {said}"), runs, frames, trackers, {})
    killed = one_pass(lambda share, said: report(0.5 + share / 2, f"with kills: {said}"), runs, frames, trackers, KILLS)
    lost = calm["not_as_promised"] + killed["not_as_promised"]
    beyond = ("overhead_ms_per_run", "overhead_over_alone_ms_per_run", "overhead_cpu_over_alone_ms_per_run")
    limits = {name: held(OVERHEAD_LIMIT_MS, calm[name], "ms") for name in beyond}
    limits["overhead_share"] = held(SHARE_LIMIT, calm["overhead_share"], "")
    limits["runs_lost_or_doubled"] = held(0, lost, "runs")
    return {"runs": runs, "frames": frames, "trackers": trackers, "calm": calm, "killed": killed, "limits": limits}


class Site:
    """An installation on a constellation, which runs are sent through."""

    def __init__(
        self, settings: Settings, environment: Mapping[str, str], constellation: Constellation, workers: int
    ) -> None:
        self.settings, self.constellation = settings, constellation
        self.installation = Installation(settings, environment, workers)
        self.rest = httpx.Client(
            base_url=f"http://{settings.host}:{settings.port}", headers=constellation.headers, timeout=STALLED_S
        )

    def launch(self, count: int) -> None:
        """Queue so many runs, as campaigns over the sensors in turn."""
        while count > 0:
            ids = self.constellation.sensor_ids[: min(count, MOST_SENSORS)]
            self.rest.post("/api/v1/campaigns", json=self.order("Measurement", ids)).raise_for_status()
            count -= len(ids)

    def order(self, label: str, sensor_ids: Sequence[int]) -> dict[str, Any]:
        """Return the order of a campaign."""
        sensors = [{"sensor_id": number} for number in sensor_ids]
        return {"label": label, "settings": dict(self.constellation.settings), "sensors": sensors}

    def ended(self) -> int:
        """Count the runs that have ended."""
        with open_reading(self.constellation.database) as session:
            counts = run_service.count_by_state(session)
        return sum(counts[state] for state in TERMINAL_RUN_STATES)

    def wait(self, report: Report, first: int, count: int, kills: Mapping[str, float]) -> None:
        """Wait until `count` runs have ended that were launched after the first ones, and kill at the given shares."""
        left, last, moved_s = sorted(kills.items(), key=lambda kill: kill[1]), -1, time.monotonic()
        while (done := self.ended() - first) < count:
            self.installation.look()
            if left and done >= count * left[0][1]:
                name = left.pop(0)[0]
                service = self.installation.services[name]
                computing = service.computing() if name.startswith("worker") else []
                (computing[-1] if computing else service.family()[0]).kill()
            if done != last:
                last, moved_s = done, time.monotonic()
                report(0.1 + 0.8 * done / count, f"{done} of {count} runs ended")
            if time.monotonic() - moved_s > STALLED_S:
                raise TimeoutError(f"No run ended for {STALLED_S:.0f} s; {done} of {count} have.")
            time.sleep(LOOK_EVERY_S)
        self.installation.look()

    def stop(self) -> None:
        """End everything."""
        self.installation.stop()
        self.rest.close()
        self.constellation.database.dispose()


def one_pass(report: Report, count: int, frames: int, trackers: int, kills: Mapping[str, float]) -> dict[str, Any]:
    """Send the runs through one installation; with kills it is one of a scheduler and workers."""
    report(0.0, "making the constellation")
    with _installed(report, min(trackers, count), frames, external=bool(kills)) as (site, by_itself):
        installation, constellation = site.installation, site.constellation
        warm = min(2 * THREADS, count)
        site.launch(warm)
        site.wait(report, 0, warm, {})
        first, before_cpu_s, before_server_s = site.ended(), installation.cpu_s(), installation.server_cpu_s()
        began_s = time.monotonic()
        site.launch(count)
        launched_s = time.monotonic()
        site.wait(report, first, count, kills)
        wall_s = time.monotonic() - began_s
        cpu_s, server_s = installation.cpu_s() - before_cpu_s, installation.server_cpu_s() - before_server_s
        report(0.92, "looking at every result")
        found = examined(constellation, first, count)
    thread_s = wall_s * THREADS
    waited_s, unstated_s = thread_s - found["computing_s"], cpu_s - found["computing_cpu_s"]
    return {
        "launch_ms_per_run": (launched_s - began_s) / count * 1e3,
        "wall_s": wall_s,
        "starts": {name: service.starts for name, service in installation.services.items()},
        "overhead_ms_per_run": waited_s / count * 1e3,
        "overhead_share": waited_s / found["computing_s"],
        "overhead_cpu_ms_per_run": unstated_s / count * 1e3,
        "overhead_cpu_share": unstated_s / found["computing_cpu_s"],
        "server_cpu_ms_per_run": server_s / count * 1e3,
        "computing_ms_per_run": found["computing_s"] / count * 1e3,
        "alone_ms_per_run": by_itself[0] * 1e3,
        "alone_cpu_ms_per_run": by_itself[1] * 1e3,
        "overhead_over_alone_ms_per_run": (thread_s / count - by_itself[0]) * 1e3,
        "overhead_cpu_over_alone_ms_per_run": (cpu_s / count - by_itself[1]) * 1e3,
        "computing_alone_ms_per_run": constellation.computing_s * 1e3,
        "stars_per_run": constellation.stars,
        **found,
    }


@contextmanager
def _installed(
    report: Report, trackers: int, frames: int, *, external: bool
) -> Iterator[tuple[Site, tuple[float, float]]]:
    """Install Boresight in a temporary folder, and take it away again; yields it with what a run costs alone."""
    with tempfile.TemporaryDirectory(prefix="boresight-queue-") as folder:
        environment = make_environment(Path(folder), THREADS, LEASE_S, external=external)
        settings = read_settings(environment)
        constellation = furnish(settings, trackers, frames, SETTINGS)
        report(0.03, "computing alone")
        by_itself = _alone(settings, constellation, 1 if external else min(ALONE_RUNS, trackers))
        report(0.05, "starting the installation")
        site = Site(settings, environment, constellation, THREADS)
        try:
            site.installation.wait_until_ready()
            yield site, by_itself
        finally:
            site.stop()


def _alone(settings: Settings, constellation: Constellation, runs: int) -> tuple[float, float]:
    """Compute so many runs in each of as many bare processes as there are workers: mean seconds and processor seconds of one.

    Processes that compute at the same time share caches, memory and often cores, and each is slower by that: no queue is to blame.
    """
    tables = [constellation.blobs.path(address) for address in constellation.expected]
    work = (settings.catalogue_folder, tables, constellation.settings, runs)
    with ProcessPoolExecutor(THREADS, mp_context=multiprocessing.get_context("spawn")) as pool:
        found = [future.result() for future in [pool.submit(_computed, *work) for _ in range(THREADS)]]
    seconds, cpu_seconds = (sum(one) / THREADS / runs for one in zip(*found, strict=True))
    return seconds, cpu_seconds


def _computed(folder: Path, tables: Sequence[Path], settings: Mapping[str, Any], runs: int) -> tuple[float, float]:
    """Compute so many runs on one thread, the tables in turn, after one that is not counted: seconds and processor seconds."""
    catalogue, began_s, began_cpu_s = load_catalogue(folder), 0.0, 0.0
    for turn in range(runs + 1):
        if turn == 1:
            began_s, began_cpu_s = time.perf_counter(), time.thread_time()
        place = turn % len(tables)
        wait_for_result(tables[place], SENSOR_NUMBERS[place], catalogue, settings, folder)
    return time.perf_counter() - began_s, time.thread_time() - began_cpu_s


def examined(constellation: Constellation, first: int, count: int) -> dict[str, Any]:
    """Look at `count` runs that were launched after the first ones.

    `computing_s` and `computing_cpu_s` are as the workers state them, summed; `not_as_promised` counts the runs that are missing,
    did not succeed exactly once, or have another result than the same work has in this process; `claims_per_run` and
    `settlements_per_run` are transactions, which the runs of a group share, and with them the moment that is written.
    """
    with open_reading(constellation.database) as session:
        rows = run_service.list_runs(session)[::-1][first:]
        good = sum(faults(session, constellation, row) == [] for row in rows)
        chain = audit.verify(session)
    summaries: list[Mapping[str, Any]] = [row.summary or {} for row in rows]
    return {
        "computing_s": sum(summary.get("seconds", 0.0) for summary in summaries),
        "computing_cpu_s": sum(summary.get("cpu_seconds", 0.0) for summary in summaries),
        "claims_per_run": len({row.started_utc for row in rows}) / count,
        "settlements_per_run": len({row.ended_utc for row in rows}) / count,
        "states": dict(Counter(row.state for row in rows)),
        "attempts": {str(attempt): number for attempt, number in sorted(Counter(row.attempt for row in rows).items())},
        "not_as_promised": abs(count - len(rows)) + len(rows) - good,
        "audit": {"ok": chain.ok, "records": chain.records, "sentence": chain.sentence},
    }


def faults(session: Session, constellation: Constellation, row: Run) -> list[str]:
    """What is wrong with a run: `stuck` without an end, `doubled` with more than one, `lost` without the result it must have."""
    if row.state not in TERMINAL_RUN_STATES:
        return ["stuck"]
    ends = [line for line in run_service.list_log_lines(session, row.id) if line.state in TERMINAL_RUN_STATES]
    found = ["doubled"] if len(ends) != 1 else []
    right = constellation.expected[session.get_known(TelemetrySet, row.telemetry_set_id).table_sha256]
    content = constellation.blobs.read(row.result_sha256) if row.state == "SUCCEEDED" and row.result_sha256 else b"{}"
    return found + (["lost"] if compute_digest(content) != right else [])
