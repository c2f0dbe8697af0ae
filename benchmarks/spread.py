"""One batch over two worker processes: how much sooner than over one, and is it the same answer with one killed (part `spread`).

A scheduler and workers are started by their commands; a client hands them the very task that a server's dispatcher would, and
times it from there to its result in the folder of blobs. Every worker has computed a small set before, so nothing waits for a
compiler or an import. In the third run the worker that is lent pieces is killed with SIGKILL when half of the fit may be done, as
the run before tells, and its nanny brings another, which takes part again. `kill` says which worker that was and when, how many
groups of pieces it had computed for this run and how many it had in its hands: these had to be computed by somebody else, and as
the run ended with all of its pieces they were. A run that ended before the kill, or whose worker had nothing in its hands, shows
nothing, and its promises are not kept.

On two cores there is no room for anybody else: the scheduler and this process take a few per cent of a core, and so does reading
pieces from the disk. What the workers used is told beside the times, and the load of the machine before each run: what it was above
the two of the run before was somebody else's, and the ratio says less than it could.
"""

from __future__ import annotations

import os
import signal
import tempfile
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import psutil

from benchmarks import ROOT, Report, held
from benchmarks.servers import Service, certified, free_port, variables
from benchmarks.stars import write_synthetic
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.settings import read_settings
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document
from boresight.workers.cluster import SchedulerClient
from boresight.workers.security import make_security
from boresight.workers.tasks import Inputs, execute_group

RATIO_LIMIT = 1.6
ANSWER_LIMIT_SIGMA = 1e-9
JOIN_S = 120.0
WARM_FRAMES = 25_000  # enough to be spread
ESTIMATE = ("parameters", "sigma", "covariance", "chi2_per_dof", "rms_arc_rad", "frames", "stars", "pairs")
RUN_ID = 1


def measure(report: Report, *, frames: int = 1_000_000, method: str = "batch", seed: int = 1) -> dict[str, Any]:
    """Calibrate one set on one worker, on two, and on two of which one is killed; from about 21,000 frames on it is spread."""
    with tempfile.TemporaryDirectory(prefix="boresight-spread-") as folder:
        site = Site(Path(folder), method)
        report(0.0, f"writing {frames:,} frames")
        small, large = (site.table(count, seed) for count in (min(WARM_FRAMES, frames), frames))
        with site.cluster(workers=1) as client:
            report(0.1, "warming one worker")
            site.warm(client, small)
            report(0.15, f"{frames:,} frames on one worker")
            one = site.run(client, large)
        with site.cluster(workers=2) as client:
            report(0.55, "warming two workers")
            site.warm(client, small)
            report(0.6, f"{frames:,} frames on two workers")
            two = site.run(client, large)
            report(0.8, f"{frames:,} frames on two workers, one of them killed")
            middle_s = two["timing_s"]["arcs"] + two["timing_s"]["fit"] / 2
            killed = site.run(client, large, kill_after_s=middle_s)
    return _found(frames, {"one_worker": one, "two_workers": two, "one_of_two_killed": killed})


class Site:
    """A data folder with sets, and the services that compute on it."""

    def __init__(self, folder: Path, method: str) -> None:
        self.folder = folder
        self._method = method
        self._blobs = FolderBlobStore(folder / "blobs")
        self._environment = os.environ | variables(data_folder=folder, blobs="")
        self._environment["PYTHONPATH"] = (
            f"{ROOT / 'backend'}{os.pathsep}{ROOT}"  # the workers are asked by a function of this module
        )
        self._environment.setdefault("NUMBA_CACHE_DIR", str(folder / "kernels"))
        self._environment |= certified(folder)
        self._runs = 0

    def table(self, frames: int, seed: int) -> str:
        """Make a set; returns its address."""
        path = self.folder / "set.parquet"
        write_synthetic(path, frames, seed)
        return self.keep(path)

    def keep(self, path: Path) -> str:
        """Take a set in, and return its address."""
        sha256 = self._blobs.put(path)
        path.unlink()
        return sha256

    @contextmanager
    def cluster(self, workers: int) -> Iterator[SchedulerClient]:
        """Start a scheduler and workers, and connect to them."""
        address = f"tls://127.0.0.1:{free_port()}"
        security = make_security(read_settings({**self._environment, "BORESIGHT_SCHEDULER": address}))
        services = [Service(["scheduler", "--port", address.rpartition(":")[2]], self.folder, self._environment)]
        try:
            words = ["worker", "--scheduler", address]
            services += [Service(words, self.folder, self._environment) for _ in range(workers)]
            with SchedulerClient(address, security=security, timeout=JOIN_S, set_as_default=False) as client:
                client.wait_for_workers(workers, timeout=JOIN_S)
                yield client
        finally:
            for service in reversed(services):
                service.stop()

    def warm(self, client: SchedulerClient, table: str) -> None:
        """Let every worker in turn compute a small set, of which it lends pieces to the others."""
        for worker in sorted(client.nthreads()):
            self._submit(client, [table], worker).result()

    def run(self, client: SchedulerClient, *tables: str, kill_after_s: float | None = None) -> dict[str, Any]:
        """Compute a set, or several as one, and say what it took and what was found."""
        own, *others = sorted(client.nthreads())
        pids = client.run(os.getpid)
        load, before_s = os.getloadavg()[0], _cpu_s(pids.values())
        began_s = time.perf_counter()
        future = self._submit(client, tables, own)
        kill = None if kill_after_s is None else Kill(client, others[0], pids[others[0]], began_s + kill_after_s)
        after_s = _cpu_until(future, pids, kill)
        (end,) = future.result()
        took_s = time.perf_counter() - began_s
        if end.result_sha256 is None:
            raise RuntimeError(f"The run ended {end.state}: {end.reason}")
        order = [pids[worker] for worker in (own, *others)]
        cpu_s = {f"worker_{n}": round(after_s[pid] - before_s[pid], 3) for n, pid in enumerate(order, 1)}
        document = orjson.loads(self._blobs.read(end.result_sha256))
        told: dict[str, Any] = {} if kill is None else {"kill": kill.told(began_s)}
        return told | {
            "seconds": took_s,
            "load_before": load,
            "cpu_s": cpu_s,
            "timing_s": document["timing_s"],
            "document": document,
        }

    def _submit(self, client: SchedulerClient, tables: Sequence[str], worker: str) -> Any:
        self._runs += 1
        inputs = Inputs(
            blob_address=str(self.folder / "blobs"),
            catalogue_folder=str(self.folder / "catalogue"),
            sets=[
                {"name": f"stars {k}", "original_sha256": table, "table_sha256": table}
                for k, table in enumerate(tables, 1)
            ],
            validation=None,
            prior=None,
            sensor_document=sensor_document(st16_sensor(1)),
            settings={"method": self._method, "match": "given"},
            chooses=False,
            trace=None,
        )
        key = f"run-{RUN_ID}-{self._runs}"
        work = [(RUN_ID, self._runs, inputs)]
        return client.submit(execute_group, work, workers=[worker], key=key, pure=False)


def _cpu_s(pids: Collection[int]) -> dict[int, float]:
    """Processor time of processes so far; of one that is gone nothing."""
    found = {}
    for pid in pids:
        with suppress(psutil.Error):
            times = psutil.Process(pid).cpu_times()
            found[pid] = times.user + times.system
    return found


class Kill:
    """A worker of a cluster that is to be killed at a moment, and what it had done for the run until then."""

    def __init__(self, client: SchedulerClient, worker: str, pid: int, at_s: float) -> None:
        self._client, self._worker, self._pid, self._at_s = client, worker, pid, at_s
        self._before = self._groups()["groups_done"]
        self._killed_s: float | None = None
        self._found = {"groups_done": 0, "groups_in_hand": 0}

    def look(self) -> None:
        """Kill it if it is time, once."""
        if self._killed_s is None and time.perf_counter() > self._at_s:
            found = self._groups()
            os.kill(self._pid, signal.SIGKILL)
            self._killed_s = time.perf_counter()
            self._found = found | {"groups_done": found["groups_done"] - self._before}

    def told(self, began_s: float) -> dict[str, Any]:
        """What happened, in a run that began then and has ended."""
        after_s = None if self._killed_s is None else self._killed_s - began_s
        return {"worker": self._worker, "happened": after_s is not None, "after_s": after_s} | self._found

    def _groups(self) -> dict[str, int]:
        """Groups that the worker has computed since it started, and those that it has now."""
        found: dict[str, int] = self._client.run(_count_groups, workers=[self._worker])[self._worker]
        return found


def _count_groups(dask_worker: Any) -> dict[str, int]:
    """Count in the worker's process; what it has in hand computes, or waits for that."""
    state = dask_worker.state
    return {"groups_done": state.executed_count, "groups_in_hand": len(state.executing) + len(state.ready)}


def _cpu_until(future: Any, pids: Mapping[str, int], kill: Kill | None) -> dict[int, float]:
    """Wait for a run's end, killing a process on the way; returns the processor times that were seen last."""
    seen = _cpu_s(pids.values())
    while not future.done():
        time.sleep(0.05)
        seen |= _cpu_s(pids.values())
        if kill is not None:
            kill.look()
    return seen


def _found(frames: int, runs: dict[str, dict[str, Any]]) -> dict[str, Any]:
    documents = {name: run.pop("document") for name, run in runs.items()}
    first = documents["one_worker"]
    differences = {name: _difference_sigma(first, document) for name, document in documents.items()}
    bits = {name: all(document[key] == first[key] for key in ESTIMATE) for name, document in documents.items()}
    ratio = runs["one_worker"]["seconds"] / runs["two_workers"]["seconds"]
    limits = {"two_workers_over_one": held(RATIO_LIMIT, ratio, at_least=True)}
    for name in ("two_workers", "one_of_two_killed"):
        limits[f"answer_of_{name}"] = held(ANSWER_LIMIT_SIGMA, differences[name], "sigma")
    if why := _shows_nothing(runs["one_of_two_killed"]["kill"]):
        limits["answer_of_one_of_two_killed"] |= {"kept": False, "why": why}
    return {
        "frames": frames,
        "cores": os.cpu_count(),
        "runs": runs,
        "ratio": ratio,
        "largest_difference_sigma": differences,
        "same_bits": bits,
        "limits": limits,
    }


def _shows_nothing(kill: Mapping[str, Any]) -> str:
    """Why a kill shows nothing; empty when it does."""
    if not kill["happened"]:
        return (
            "The run had ended before its worker was to be killed, so nothing is known of a kill; measure a larger set."
        )
    if kill["groups_in_hand"] == 0:
        return "The worker had no pieces when it was killed, so nothing had to be taken over; measure a larger set."
    return ""


def _difference_sigma(first: Mapping[str, Any], second: Mapping[str, Any]) -> float:
    free = first["free"]
    x, y = (np.array([document["parameters"][name] for name in free]) for document in (first, second))
    return float(np.max(np.abs(x - y) / np.array([first["sigma"][name] for name in free])))
