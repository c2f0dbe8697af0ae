"""Calculations that stand in for `calibrate` in worker processes.

A run's behaviour is chosen by its sensor's name, so that one engine can hold quick, slow, stubborn and deadly runs.
"""

import os
import signal
import time
from pathlib import Path

from boresight.calibration.calibrate import Progress
from boresight.errors import CancelledError, RefusedInputError

MARKS = "BORESIGHT_TEST_MARKS"


def calculate(telemetry, sensor, catalogue, settings, *, validation=None, report=None, cancelled=None, cache_folder):
    """Do what the sensor's name says."""
    assert len(telemetry) > 0
    assert len(catalogue.hip) > 0
    assert cache_folder.is_dir()
    mark(sensor.name)
    BEHAVIOURS[sensor.name.split("-")[0]](report, cancelled)
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
    """Leave a trace that a computation began, and in which process."""
    folder = Path(os.environ[MARKS])
    (folder / f"{name}-{os.getpid()}-{time.monotonic_ns()}").touch()


def quick(_report, _cancelled):
    """End at once."""


def brief(_report, _cancelled):
    """Compute for a moment."""
    time.sleep(0.03)


def slow(report, cancelled, seconds=1.5):
    """Take a while, telling of it, and stop when asked."""
    steps = int(seconds / 0.05)
    for step in range(steps):
        history = {"frame": list(range(1000)), "rms": [0.5] * 1000}
        report(Progress(step / steps, f"step {step}", {"status": "running", "history": history}))
        if cancelled():
            raise CancelledError("Stopped on request.")
        time.sleep(0.05)


def endless(report, cancelled):
    """Go on until asked to stop."""
    slow(report, cancelled, seconds=60.0)


def deaf(_report, _cancelled):
    """Go on whatever is asked."""
    time.sleep(60.0)


def poison(_report, _cancelled):
    """Take the worker process along."""
    os.kill(os.getpid(), signal.SIGKILL)


def refuse(_report, _cancelled):
    """Refuse the input."""
    raise RefusedInputError("Frame 3 has too few stars; use a longer set.")


def crash(_report, _cancelled):
    """Have a defect."""
    raise ZeroDivisionError("a defect")


BEHAVIOURS = {work.__name__: work for work in (quick, brief, slow, endless, deaf, poison, refuse, crash)}
