"""What kills at random times lose: worker, nanny, scheduler and server, with SIGKILL, while runs are launched and computed.

    python -m benchmarks.kills [--runs 400] [--kills 100] [--seed 1] [--json FILE]

Two installations in turn, each on an empty data folder of its own: a server with a scheduler and two workers as services, of
which the computing process, its nanny, the scheduler or the server is killed; and a server with its own workers, of which a worker
process or the server is killed, which is also the nanny of its workers. What was killed is started again as a service manager
would. Who and when is drawn from the seed: kills come by themselves, whatever is going on, be it a start. Runs are launched over
REST all the while, some for each kill; a launch that is not answered is sent again with the same `Idempotency-Key`. At the end

    lost      launched and not SUCCEEDED, or with another result than the same work has in this process
    doubled   with more than one end in its log, or there without having been launched
    stuck     without an end when nothing has ended for STALLED_S

A run may be lost `MAX_ATTEMPTS` times before it counts as poison, for here no run is to blame for a death.
"""

from __future__ import annotations

import contextlib
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import click
import httpx
import numpy as np
import psutil

from benchmarks.queue import Site, faults
from benchmarks.servers import end_in_order, make_environment
from benchmarks.stores import furnish
from boresight.cli.output import json_option, write_json
from boresight.console.runs import service as runs
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading
from boresight.settings import read_settings

WORKERS, FRAMES, TRACKERS = 2, 150, 4
SETTINGS = {"method": "sqrf"}
LEASE_S, MAX_ATTEMPTS = 3.0, 100
MEAN_S = 5.0  # between two kills
LOOK_EVERY_S = 0.1
AHEAD = 2  # kills for which runs are launched beforehand, so that there is always something to lose
STALLED_S = 240.0
TARGETS = {
    "services": {"worker": "worker", "nanny": "worker", "scheduler": "scheduler", "server": "server"},
    "own workers": {"worker": "server", "server": "server"},
}  # of each installation, and the service it is part of
FAULTS = ("lost", "doubled", "stuck")


class Pass:
    """One installation, its runs and its kills."""

    def __init__(self, kind: str, folder: Path, counts: tuple[int, int], rng: np.random.Generator) -> None:
        self.kind, self.folder, self.rng = kind, folder, rng
        self.kills, self.runs = counts
        environment = make_environment(folder, WORKERS, LEASE_S, external=kind == "services")
        environment["BORESIGHT_MAX_ATTEMPTS"] = str(MAX_ATTEMPTS)
        settings = read_settings(environment)
        self.site = Site(settings, environment, furnish(settings, TRACKERS, FRAMES, SETTINGS), WORKERS)
        self.site.rest.timeout = httpx.Timeout(20.0)
        self.killed: Counter[str] = Counter()
        self.launched, self.resent = 0, 0
        self.over = threading.Event()

    def kill(self, target: str) -> bool:
        """Kill one process of a kind; says whether there was one."""
        services = self.site.installation.services
        names = [name for name in services if name.partition(" ")[0] == TARGETS[self.kind][target]]
        service = services[str(self.rng.choice(names))]
        with contextlib.suppress(psutil.Error):
            family = service.computing() if target == "worker" else service.family()[:1]
            if family:
                family[int(self.rng.integers(len(family)))].kill()
                self.killed[target] += 1
                return True
        return False

    def launch(self) -> None:
        """Launch all runs, as many at a time as belong to a kill, each time until it is answered."""
        while self.launched < self.runs and not self.over.is_set():
            upto = min(self.runs, round((sum(self.killed.values()) + AHEAD) / self.kills * self.runs))
            ids = self.site.constellation.sensor_ids[: max(0, upto - self.launched)]
            if not ids or not self.campaign(ids):
                time.sleep(LOOK_EVERY_S)

    def campaign(self, sensor_ids: list[int]) -> bool:
        """Send one order of runs; says whether it was taken."""
        order = self.site.order(f"from {self.launched}", sensor_ids)
        key = {"Idempotency-Key": f"from-{self.launched}-{len(sensor_ids)}"}
        try:
            answer = self.site.rest.post("/api/v1/campaigns", json=order, headers=key)
            if answer.status_code not in {503, 409, 429}:
                answer.raise_for_status()
                self.launched += len(sensor_ids)
                return True
        except httpx.TransportError:
            pass
        self.resent += 1
        return False

    def rest(self, seconds: float) -> None:
        """Let time pass, starting again what has ended."""
        until_s = time.monotonic() + seconds
        while True:
            self.site.installation.look()
            if time.monotonic() >= until_s:
                return
            time.sleep(min(LOOK_EVERY_S, max(0.0, until_s - time.monotonic())))

    def go(self) -> dict[str, Any]:
        """Launch and kill, wait for the ends, and say what became of everything."""
        began_s, launching = time.monotonic(), threading.Thread(target=self.launch, daemon=True)
        try:
            self.site.installation.wait_until_ready()
            launching.start()
            self.strike(began_s)
            last, moved_s = -1, time.monotonic()
            while (done := self.site.ended()) < self.runs and time.monotonic() - moved_s < STALLED_S:
                last, moved_s = done, moved_s if done == last else time.monotonic()
                self.rest(LOOK_EVERY_S)
        finally:
            self.over.set()
            if launching.ident is not None:
                launching.join(60)
            took_s = time.monotonic() - began_s
            self.site.installation.stop()
        return {"seconds": round(took_s), "kills": dict(self.killed), "launches_sent_again": self.resent} | self.found()

    def strike(self, began_s: float) -> None:
        """Kill as drawn: every kind as often, at random times."""
        kinds = list(TARGETS[self.kind])
        order = self.rng.permutation([kinds[number % len(kinds)] for number in range(self.kills)])
        pauses_s = self.rng.exponential(MEAN_S, self.kills)
        for number, (target, pause_s) in enumerate(zip(order, pauses_s, strict=True), 1):
            self.rest(pause_s)
            while not self.kill(str(target)):
                self.rest(LOOK_EVERY_S)
            if number % 10 == 0 or number == self.kills:
                told = f"{self.kind}: {number} kills, {self.launched} runs launched, {self.site.ended()} ended"
                print(f"{told}, {time.monotonic() - began_s:.0f} s", file=sys.stderr, flush=True)

    def found(self) -> dict[str, Any]:
        """Look at every run, its log and its result, at the audit log, and at what was left behind."""
        wrong, attempts = Counter(dict.fromkeys(FAULTS, 0)), Counter[int]()
        with open_reading(self.site.constellation.database) as session:
            rows = runs.list_runs(session)
            for row in rows:
                attempts[row.attempt] += 1
                wrong.update(faults(session, self.site.constellation, row))
            chain = audit.verify(session)
        wrong["lost"] += max(0, self.runs - len(rows))
        wrong["doubled"] += max(0, len(rows) - self.launched)
        return {
            "runs": len(rows),
            **wrong,
            "attempts": {str(number): attempts[number] for number in sorted(attempts)},
            "audit_log": chain.sentence,
            "processes_left": len(left_behind(self.folder)),
        }


def left_behind(folder: Path) -> list[psutil.Process]:
    """Find the processes of an installation that are still there."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.environ().get("BORESIGHT_DATA_FOLDER") == str(folder):
                found.append(process)
    return found


def measured(kind: str, counts: tuple[int, int], rng: np.random.Generator) -> dict[str, Any]:
    """Go through one installation, with so many kills and runs, in a folder that is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="boresight-kills-") as folder:
        under_way = Pass(kind, Path(folder), counts, rng)
        try:
            return under_way.go()
        finally:
            under_way.site.stop()


def measure(total_runs: int, total_kills: int, seed: int) -> dict[str, Any]:
    """Divide kills and runs over the two installations, by the number of their targets."""
    rng, share = np.random.default_rng(seed), 0.6
    of_services = (round(share * total_kills), round(share * total_runs))
    counts = {"services": of_services, "own workers": (total_kills - of_services[0], total_runs - of_services[1])}
    found = {kind: measured(kind, count, rng) for kind, count in counts.items()}
    totals = {key: sum(each[key] for each in found.values()) for key in ("runs", *FAULTS, "processes_left")}
    return {"seed": seed, "kills": sum(sum(each["kills"].values()) for each in found.values()), **totals, **found}


@click.command(help=__doc__)
@click.option("--runs", default=400)
@click.option("--kills", default=100)
@click.option("--seed", default=1)
@json_option
def main(*, runs: int, kills: int, seed: int, json_file: str | None) -> None:
    """Measure, print, and fail where anything was lost."""
    end_in_order()
    found = measure(runs, kills, seed)
    write_json(found, json_file or "-")
    sys.exit(any(found[key] for key in (*FAULTS, "processes_left")))


if __name__ == "__main__":
    main()
