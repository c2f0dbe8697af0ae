"""What the queue adds to the computing, and that it loses nothing: thousands of small runs through a real installation.

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
beside the runs, the upkeep's walks of the audit log too, and with kills the start of what was killed.
"""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from boresight.measurements import Report
from boresight.measurements.alone import alone
from boresight.measurements.constellation import Constellation, furnish
from boresight.measurements.examined_runs import examined
from boresight.measurements.installation import Installation, environment_of
from boresight.services import runs
from boresight.services.campaign_places import MOST_SENSORS
from boresight.settings import Settings, read_settings
from boresight.store.sessions import reading
from boresight.store.tables import TERMINAL_RUN_STATES

OVERHEAD_LIMIT_MS = 10.0
SHARE_LIMIT = 0.05
LEASE_S = 5.0
LOOK_EVERY_S = 0.25
STALLED_S = 600.0
SETTINGS = {"method": "batch"}
ALONE_RUNS = 50  # before the calm pass, which is what the limits are held against; with kills one is told
KILLS = (("worker 1", 0.2), ("scheduler", 0.4), ("server", 0.6))  # at which share of the runs ended


def measure(report: Report, *, runs: int = 5000, frames: int = 200, trackers: int = 1000) -> dict[str, Any]:
    """Send runs through the queue, undisturbed and with kills.

    Parameters
    ----------
    report
        Told the fraction done and what happens.
    runs, frames
        How many runs of each pass, and of how many frames each.
    trackers
        Among how many sensors they are divided.
    """
    calm = _pass(lambda share, said: report(share / 2, f"calm: {said}"), runs, frames, trackers, kills=False)
    killed = _pass(
        lambda share, said: report(0.5 + share / 2, f"with kills: {said}"), runs, frames, trackers, kills=True
    )
    return {"runs": runs, "frames": frames, "trackers": trackers, "calm": calm, "killed": killed} | {
        "limits": _limits(calm, killed)
    }


def _limits(calm: Mapping[str, Any], killed: Mapping[str, Any]) -> dict[str, Any]:
    """Hold what was measured against what is promised."""
    lost = sum(found["not_as_promised"] for found in (calm, killed))
    measured = {
        "overhead_ms_per_run": (OVERHEAD_LIMIT_MS, calm["overhead_ms_per_run"], "ms"),
        "overhead_over_alone_ms_per_run": (OVERHEAD_LIMIT_MS, calm["overhead_over_alone_ms_per_run"], "ms"),
        "overhead_cpu_over_alone_ms_per_run": (OVERHEAD_LIMIT_MS, calm["overhead_cpu_over_alone_ms_per_run"], "ms"),
        "overhead_share": (SHARE_LIMIT, calm["overhead_share"], ""),
        "runs_lost_or_doubled": (0, lost, "runs"),
    }
    return {
        name: {"limit": limit, "measured": found, "kept": found <= limit, "unit": unit}
        for name, (limit, found, unit) in measured.items()
    }


@dataclass
class _Pass:
    """One pass under way."""

    installation: Installation
    constellation: Constellation
    server: httpx.Client
    report: Report
    alone: Mapping[str, float]

    def launch(self, count: int) -> None:
        """Queue so many runs, as campaigns over the sensors in turn."""
        ids = self.constellation.sensor_ids
        while count > 0:
            some = [{"sensor_id": number} for number in ids[: min(count, MOST_SENSORS)]]
            order = {"label": "Measurement", "settings": dict(self.constellation.settings), "sensors": some}
            self.server.post("/api/v1/campaigns", json=order).raise_for_status()
            count -= len(some)

    def ended(self) -> int:
        """Count the runs that have ended."""
        with reading(self.constellation.database) as session:
            counts = runs.count_by_state(session)
        return sum(counts[state] for state in TERMINAL_RUN_STATES)

    def wait(self, first: int, count: int, kills: Mapping[str, float]) -> None:
        """Wait until `count` runs have ended that were launched after the first ones, and kill at the given shares."""
        left, last, moved_s = dict(kills), -1, time.monotonic()
        while (done := self.ended() - first) < count:
            self.installation.look()
            if left and done >= count * min(left.values()):
                name = min(left, key=lambda key: left[key])
                self.installation.services[name].kill(a_child=name.startswith("worker"))
                del left[name]
            if done != last:
                last, moved_s = done, time.monotonic()
                self.report(0.1 + 0.8 * done / count, f"{done} of {count} runs ended")
            if time.monotonic() - moved_s > STALLED_S:
                raise TimeoutError(f"No run ended for {STALLED_S:.0f} s; {done} of {count} have.")
            time.sleep(LOOK_EVERY_S)
        self.installation.look()


def _pass(report: Report, count: int, frames: int, trackers: int, *, kills: bool, threads: int = 2) -> dict[str, Any]:
    """Send the runs through one installation."""
    report(0.0, "making the constellation")
    with _installed(report, min(trackers, count), frames, threads, external=kills) as under_way:
        installation, constellation = under_way.installation, under_way.constellation
        under_way.launch(min(2 * threads, count))
        under_way.wait(0, min(2 * threads, count), {})
        first, before_cpu_s, before_server_s = under_way.ended(), installation.cpu_s(), installation.server_cpu_s()
        began_s = time.monotonic()
        under_way.launch(count)
        launched_s = time.monotonic()
        under_way.wait(first, count, dict(KILLS) if kills else {})
        wall_s = time.monotonic() - began_s
        used = installation.cpu_s() - before_cpu_s, installation.server_cpu_s() - before_server_s
        starts = {name: service.starts for name, service in installation.services.items()}
        report(0.92, "looking at every result")
        found = examined(constellation, first, count)
    return (
        {"launch_ms_per_run": (launched_s - began_s) / count * 1e3, "wall_s": wall_s, "starts": starts}
        | _overhead(found, wall_s, used, threads, count)
        | _over_alone(under_way.alone, wall_s * threads / count, used[0] / count)
        | {"computing_alone_ms_per_run": constellation.computing_s * 1e3, "stars_per_run": constellation.stars}
        | found
    )


@contextlib.contextmanager
def _installed(report: Report, trackers: int, frames: int, threads: int, *, external: bool) -> Iterator[_Pass]:
    """Install Boresight in a temporary folder, and take it away again."""
    with tempfile.TemporaryDirectory(prefix="boresight-queue-") as folder:
        environment = environment_of(Path(folder), threads, LEASE_S, external=external)
        settings: Settings = read_settings(environment)
        constellation = furnish(settings, trackers, frames, SETTINGS)
        report(0.03, "computing alone")
        by_itself = alone(settings, constellation, 1 if external else min(ALONE_RUNS, trackers), threads)
        report(0.05, "starting the installation")
        installation = Installation(settings, environment, threads)
        headers = {"Authorization": f"Bearer {constellation.key}"}
        address = f"http://{settings.host}:{settings.port}"
        try:
            installation.wait_until_ready()
            with httpx.Client(base_url=address, headers=headers, timeout=600.0) as server:
                yield _Pass(installation, constellation, server, report, by_itself)
        finally:
            installation.stop()
            constellation.database.dispose()


def _overhead(
    found: Mapping[str, Any], wall_s: float, used: tuple[float, float], threads: int, count: int
) -> dict[str, Any]:
    """Say what was spent beyond the computing."""
    waited_s = wall_s * threads - found["computing_s"]
    return {
        "overhead_ms_per_run": waited_s / count * 1e3,
        "overhead_share": waited_s / found["computing_s"],
        "overhead_cpu_ms_per_run": (used[0] - found["computing_cpu_s"]) / count * 1e3,
        "overhead_cpu_share": (used[0] - found["computing_cpu_s"]) / found["computing_cpu_s"],
        "server_cpu_ms_per_run": used[1] / count * 1e3,
        "computing_ms_per_run": found["computing_s"] / count * 1e3,
    }


def _over_alone(by_itself: Mapping[str, float], thread_s: float, cpu_s: float) -> dict[str, float]:
    """Say what a run took beyond what it takes alone: seconds of the threads and of all processors, in ms a run."""
    return {
        "alone_ms_per_run": by_itself["seconds"] * 1e3,
        "alone_cpu_ms_per_run": by_itself["cpu_seconds"] * 1e3,
        "overhead_over_alone_ms_per_run": (thread_s - by_itself["seconds"]) * 1e3,
        "overhead_cpu_over_alone_ms_per_run": (cpu_s - by_itself["cpu_seconds"]) * 1e3,
    }
