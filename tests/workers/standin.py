"""Calculations that stand in for `calibrate` in worker processes.

A run's behaviour is chosen by its sensor's name, so that one engine can hold quick, endless, stubborn and deadly runs.
"""

import os
import signal
import time
from pathlib import Path

from distributed.diagnostics.plugin import WorkerPlugin

from boresight.calibration.calibrate import Progress
from boresight.errors import CancelledError, RefusedInputError

MARKS = "BORESIGHT_TEST_MARKS"


def calculate(telemetry, sensor, catalogue, settings, *, validation=None, report=None, cancelled=None, cache_folder):
    """Do what the sensor's name says."""
    assert len(telemetry) > 0
    assert len(catalogue.hip) > 0
    assert cache_folder.is_dir()
    attempt = mark(sensor.name)
    BEHAVIOURS[sensor.name.split("-")[0]](report, cancelled, attempt)
    return {
        "status": "converged",
        "sensor": sensor.name,
        "method": settings.method,
        "frames": 1,
        "stars": len(telemetry),
        "rms_arc_rad": {"initial": 2e-4, "final": float("nan")},
        "validation": None if validation is None else {"rms_arc_rad": {"initial": 2.0, "final": 1.0}},
        "process": os.getpid(),
    }


def mark(name):
    """Leave a trace that a computation began, and in which process; return how often it has begun."""
    folder = Path(os.environ[MARKS])
    (folder / f"{name}-{os.getpid()}-{time.monotonic_ns()}").touch()
    return len(list(folder.glob(f"{name}-*")))


class Unwarmed(WorkerPlugin):
    """In place of warming, a second of work in each new process: what the stand-in does needs no kernels."""

    name = "unwarmed"

    def __init__(self, _catalogue_folder, *, ours):
        self.ours = ours


def quick(_report, _cancelled, _attempt):
    """End at once."""


def brief(_report, _cancelled, _attempt):
    """Compute for a moment."""
    time.sleep(0.03)


def endless(report, cancelled, _attempt, seconds=1000.0):
    """Go on, telling of it, until asked to stop."""
    steps = int(seconds / 0.05)
    for step in range(steps):
        history = {"frame": list(range(1000)), "rms": [0.5] * 1000}
        report(Progress(step / steps, f"step {step}", {"status": "running", "history": history}))
        if cancelled():
            raise CancelledError("Stopped on request.")
        time.sleep(0.05)


def stuck(report, cancelled, attempt):
    """Be still computing whenever it is killed, however late; be quick the second time."""
    if attempt == 1:
        endless(report, cancelled, attempt, seconds=60.0)


def deaf(_report, _cancelled, _attempt):
    """Go on whatever is asked."""
    time.sleep(1000.0)


def poison(_report, _cancelled, _attempt):
    """Take the worker process along."""
    os.kill(os.getpid(), signal.SIGKILL)


def refuse(_report, _cancelled, _attempt):
    """Refuse the input."""
    raise RefusedInputError("Frame 3 has too few stars; use a longer set.")


def crash(_report, _cancelled, _attempt):
    """Have a defect."""
    raise ZeroDivisionError("a defect")


BEHAVIOURS = {work.__name__: work for work in (quick, brief, endless, stuck, deaf, poison, refuse, crash)}
