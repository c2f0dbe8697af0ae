"""Calculations that stand in for `calibrate` in worker processes.

A run's behaviour is chosen by its sensor's name, so that one dispatcher can hold quick, endless, stubborn and deadly runs.
"""

import os
import signal
import time
from pathlib import Path

from distributed.diagnostics.plugin import WorkerPlugin

from boresight.calibration.calibrate import Progress
from boresight.calibration.calibration import Calibration, Change, Evaluation, History, Values
from boresight.errors import CancelledError, RefusedInputError

MARKS = "BORESIGHT_TEST_MARKS"
VALIDATION = Evaluation(
    frames=1, availability=Change(), matched_star_ratio=None, rms_arc_rad=Change(initial=2.0, final=1.0)
)


def calculate(
    telemetry, sensor, catalogue, settings, *, validation=None, report=None, cancelled=None, cache_folder, **_told
):
    assert len(telemetry) > 0
    assert len(catalogue.hip) > 0
    assert cache_folder.is_dir()
    attempt = mark(sensor.name)
    BEHAVIOURS[sensor.name.split("-")[0]](report, cancelled, attempt)
    return Calibration(
        status="converged",
        sensor=sensor.name,
        method=settings.method,
        camera_model=sensor.camera_model,
        parameters=Values({"f_m": 0.016}),
        sigma=Values({"f_m": 1e-6}),
        frames=1,
        stars=len(telemetry),
        rms_arc_rad=Change(initial=2e-4, final=float("nan")),
        validation=None if validation is None else VALIDATION,
    )


def mark(name):
    folder = Path(os.environ[MARKS])
    (folder / f"{name}-{os.getpid()}-{time.monotonic_ns()}").touch()
    return len(list(folder.glob(f"{name}-*")))


class Unwarmed(WorkerPlugin):
    name = "unwarmed"

    def __init__(self, _catalogue_folder, *, ours, cameras=(), log_format=""):  # noqa: ARG002 - the real one has them
        self.ours = ours


def quick(_report, _cancelled, _attempt):
    """End at once."""


def brief(_report, _cancelled, _attempt):
    time.sleep(0.03)


def endless(report, cancelled, _attempt, seconds=1000.0):
    steps = int(seconds / 0.05)
    frames, states = [*range(1000)], [[0.5]] * 1000
    history = History(
        frame=frames, parameters=states, sigma=states, tail_rms_rad=[0.5] * 1000, aggregate_rms_rad=[0.5] * 1000
    )
    for step in range(steps):
        report(Progress(step / steps, f"step {step}", Calibration(status="running", history=history)))
        if cancelled():
            raise CancelledError("Cancelled.")
        time.sleep(0.05)


def stuck(report, cancelled, attempt):
    if attempt == 1:
        endless(report, cancelled, attempt, seconds=60.0)


def deaf(_report, _cancelled, _attempt):
    time.sleep(1000.0)


def poison(_report, _cancelled, _attempt):
    os.kill(os.getpid(), signal.SIGKILL)


def refuse(_report, _cancelled, _attempt):
    raise RefusedInputError("Frame 3 has too few stars; use a longer set.")


def crash(_report, _cancelled, _attempt):
    raise ZeroDivisionError("a defect")


BEHAVIOURS = {work.__name__: work for work in (quick, brief, endless, stuck, deaf, poison, refuse, crash)}
