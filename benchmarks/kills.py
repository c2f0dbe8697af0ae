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

import argparse
import contextlib
import json
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

import httpx
import numpy as np
import psutil

from boresight.measurements.constellation import digest_of, furnish
from boresight.measurements.installation import CHILD, Installation, environment_of
from boresight.services import audit, runs
from boresight.services.telemetry_sets import get_telemetry_set
from boresight.settings import read_settings
from boresight.store.sessions import reading
from boresight.store.tables import TERMINAL_RUN_STATES

WORKERS = 2
FRAMES = 150
TRACKERS = 4
SETTINGS = {"method": "sqrf"}
LEASE_S = 3.0
MAX_ATTEMPTS = 100
MEAN_S = 5.0  # between two kills
LOOK_EVERY_S = 0.1
PAGE = 100
AHEAD = 2  # kills for which runs are launched beforehand, so that there is always something to lose
STALLED_S = 240.0
TARGETS = {
    "services": {"worker": "worker", "nanny": "worker", "scheduler": "scheduler", "server": "server"},
    "own workers": {"worker": "server", "server": "server"},
}  # of each installation, and the service it is part of


class Pass:
    """One installation, its runs and its kills."""

    def __init__(self, kind, folder, counts, rng):
        self.kind, self.rng = kind, rng
        self.kills, self.runs = counts
        environment = environment_of(folder, WORKERS, LEASE_S, external=kind == "services")
        environment["BORESIGHT_MAX_ATTEMPTS"] = str(MAX_ATTEMPTS)
        self.folder, self.settings = folder, read_settings(environment)
        self.constellation = furnish(self.settings, TRACKERS, FRAMES, SETTINGS)
        self.installation = Installation(self.settings, environment, WORKERS)
        self.killed, self.launched, self.resent = Counter(), 0, 0
        self.over = threading.Event()

    def drawn(self):
        """Draw whom to kill and how long to wait before, every kind as often."""
        kinds = list(TARGETS[self.kind])
        order = [kinds[number % len(kinds)] for number in range(self.kills)]
        return list(zip(self.rng.permutation(order), self.rng.exponential(MEAN_S, self.kills), strict=True))

    def victim(self, target):
        """Find a process of a kind, or None while there is none."""
        service = TARGETS[self.kind][target]
        names = [name for name in self.installation.services if name.partition(" ")[0] == service]
        family = self.installation.services[self.rng.choice(names)].family()
        if target == "worker":
            family = [one for one in family[1:] if CHILD in " ".join(one.cmdline())]
        return family[self.rng.integers(len(family)) if target == "worker" else 0] if family else None

    def kill(self, target):
        """Kill one; says whether there was one."""
        with contextlib.suppress(psutil.Error):
            if (victim := self.victim(target)) is not None:
                victim.kill()
                self.killed[target] += 1
                return True
        return False

    def launch(self):
        """Launch all runs, as many at a time as belong to a kill, each time until it is answered."""
        headers = {"Authorization": f"Bearer {self.constellation.key}"}
        address = f"http://{self.settings.host}:{self.settings.port}"
        with httpx.Client(base_url=address, headers=headers, timeout=20.0) as server:
            while self.launched < self.runs and not self.over.is_set():
                upto = min(self.runs, round((sum(self.killed.values()) + AHEAD) / self.kills * self.runs))
                some = min(upto - self.launched, len(self.constellation.sensor_ids))
                if some < 1 or not self.campaign(server, some):
                    time.sleep(LOOK_EVERY_S)

    def campaign(self, server, count):
        """Send one order of runs; says whether it was taken."""
        chosen = [{"sensor_id": number} for number in self.constellation.sensor_ids[:count]]
        order = {"label": f"from {self.launched}", "settings": SETTINGS, "sensors": chosen}
        try:
            answer = server.post(
                "/api/v1/campaigns", json=order, headers={"Idempotency-Key": f"from-{self.launched}-{count}"}
            )
        except httpx.HTTPError:
            self.resent += 1
            return False
        if answer.status_code in {503, 409, 429}:
            self.resent += 1
            return False
        answer.raise_for_status()
        self.launched += count
        return True

    def ended(self):
        """Count the runs that have ended."""
        with reading(self.constellation.database) as session:
            counts = runs.count_by_state(session)
        return sum(counts[state] for state in TERMINAL_RUN_STATES)

    def rest(self, seconds):
        """Let time pass, starting again what has ended."""
        until_s = time.monotonic() + seconds
        while True:
            self.installation.look()
            if time.monotonic() >= until_s:
                return
            time.sleep(min(LOOK_EVERY_S, max(0.0, until_s - time.monotonic())))

    def go(self):
        """Launch and kill, wait for the ends, and say what became of everything."""
        began_s = time.monotonic()
        say(f"{self.kind}: one run takes {self.constellation.computing_s:.2f} s alone, starting,", began_s)
        launching = threading.Thread(target=self.launch, daemon=True)
        try:
            self.installation.wait_until_ready()
            launching.start()
            self.strike(began_s)
            self.await_ends()
        finally:
            self.over.set()
            if launching.ident is not None:
                launching.join(60)
            took_s = time.monotonic() - began_s
            self.installation.stop()
        return {"seconds": round(took_s), "kills": dict(self.killed), "launches_sent_again": self.resent} | self.found()

    def strike(self, began_s):
        """Kill as drawn."""
        for number, (target, pause_s) in enumerate(self.drawn(), 1):
            self.rest(pause_s)
            while not self.kill(target):
                self.rest(LOOK_EVERY_S)
            if number % 10 == 0 or number == self.kills:
                say(f"{self.kind}: {number} kills, {self.launched} runs launched, {self.ended()} ended,", began_s)

    def await_ends(self):
        """Wait until every run has ended, or none has for long."""
        last, moved_s = -1, time.monotonic()
        while (done := self.ended()) < self.runs and time.monotonic() - moved_s < STALLED_S:
            last, moved_s = done, moved_s if done == last else time.monotonic()
            self.rest(LOOK_EVERY_S)

    def found(self):
        """Look at every run, its log and its result, at the audit log, and at what was left behind."""
        faults, attempts = Counter(lost=0, doubled=0, stuck=0), Counter()
        with reading(self.constellation.database) as session:
            rows, before = [], None
            while page := runs.list_runs(session, before_id=before, limit=PAGE):
                rows, before = rows + page, page[-1].id
            for row in rows:
                attempts[row.attempt] += 1
                faults.update(self.faults(session, row))
            chain = audit.verify(session)
        faults["lost"] += max(0, self.runs - len(rows))
        faults["doubled"] += max(0, len(rows) - self.launched)
        return {
            "runs": len(rows),
            **faults,
            "attempts": {str(number): attempts[number] for number in sorted(attempts)},
            "audit_log": chain.sentence,
            "processes_left": len(left_behind(self.folder)),
        }

    def faults(self, session, row):
        """Say what is wrong with one run."""
        if row.state not in TERMINAL_RUN_STATES:
            yield "stuck"
            return
        words = [line.message.partition(":")[0] for line in runs.log_lines(session, row.id) if line.kind == "state"]
        if sum(word in TERMINAL_RUN_STATES for word in words) != 1:
            yield "doubled"
        table = get_telemetry_set(session, row.telemetry_set_id).table_sha256
        right = self.constellation.expected[table]
        if row.state != "SUCCEEDED" or digest_of(self.constellation.blobs.read(row.result_sha256)) != right:
            print(f"run {row.id} {row.state}: {row.reason}", file=sys.stderr)
            yield "lost"


def left_behind(folder):
    """Find the processes of an installation that are still there."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.environ().get("BORESIGHT_DATA_FOLDER") == str(folder):
                found.append(process)
    return found


def say(text, began_s):
    """Tell how it goes."""
    print(f"{text} {time.monotonic() - began_s:.0f} s", file=sys.stderr, flush=True)


def measured(kind, counts, rng):
    """Go through one installation in a folder that is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="boresight-kills-") as folder:
        under_way = Pass(kind, Path(folder), counts, rng)
        try:
            return under_way.go()
        finally:
            under_way.constellation.database.dispose()


def measure(total_runs, total_kills, seed):
    """Divide kills and runs over the two installations, by the number of their targets."""
    rng, share = np.random.default_rng(seed), 0.6
    counts = {"services": (round(share * total_kills), round(share * total_runs))}
    counts["own workers"] = (total_kills - counts["services"][0], total_runs - counts["services"][1])
    found = {kind: measured(kind, count, rng) for kind, count in counts.items()}
    keys = ("runs", "lost", "doubled", "stuck", "processes_left")
    totals = {key: sum(each[key] for each in found.values()) for key in keys}
    return {"seed": seed, "kills": sum(sum(each["kills"].values()) for each in found.values()), **totals, **found}


def stop(*_):
    """End in order on SIGTERM, so that nothing is left."""
    sys.exit(143)


def main():
    """Measure, print, and fail where anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, stop)
    found = measure(options.runs, options.kills, options.seed)
    text = json.dumps(found, indent=2)
    print(text)
    if options.json:
        options.json.write_text(f"{text}\n")
    return int(any(found[key] for key in ("lost", "doubled", "stuck", "processes_left")))


if __name__ == "__main__":
    sys.exit(main())
