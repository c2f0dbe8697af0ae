"""Pieces for worker processes to compute, and calculations that spread them."""

import os
import signal
import time
from pathlib import Path

from boresight.calibration.calibration import Calibration, Change
from boresight.errors import RefusedInputError
from boresight.workers.cluster_executor import ClusterExecutor

COUNT = 24


def square(number, folder, seconds=0.2):
    (Path(folder) / f"piece-{number}-{os.getpid()}-{time.monotonic_ns()}").touch()
    time.sleep(seconds)
    return number * number


def refuse(number, folder):
    if number in {5, 9}:
        raise RefusedInputError(f"piece {number} is refused")
    return square(number, folder, 0.01)


def die(number, folder):
    if number == 5:
        (Path(folder) / f"died-{os.getpid()}-{time.monotonic_ns()}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return square(number, folder, 0.05)


def spread(folder, function=square, count=COUNT, stop_after_s=None, seconds=None):
    begun_s = time.monotonic()
    asked = lambda: stop_after_s is not None and time.monotonic() - begun_s > stop_after_s  # noqa: E731 - a question
    told = []
    more = () if seconds is None else (seconds,)
    results = ClusterExecutor("1-1", Path(folder), asked).map(
        function,
        [(number, str(folder), *more) for number in range(count)],
        done=lambda done, of: told.append((done, of)),
    )
    return {"results": results, "told": told, "process": os.getpid(), "seconds": time.monotonic() - begun_s}


def spread_unseen(folder):
    seen = ClusterExecutor("1-1", Path(folder), lambda: False)
    seen._sign.unlink()
    results = seen.map(square, [(number, str(folder), 0.05) for number in range(COUNT)])
    return {"results": results, "process": os.getpid()}


def occupy(folder, seconds):
    (Path(folder) / f"occupied-{os.getpid()}").touch()
    time.sleep(seconds)


def calculate(telemetry, sensor, catalogue, settings, **_):  # noqa: ARG001 - as `calibrate` is called
    behaviour, _, run_id = sensor.name.partition("-")
    marks = Path(os.environ["BORESIGHT_TEST_MARKS"]) / "pieces" / run_id
    marks.mkdir(parents=True, exist_ok=True)
    if behaviour != "quick":
        spread(marks, {"deadly": die, "spreading": square}[behaviour])
    return Calibration(
        status="converged", sensor=sensor.name, method="batch", frames=1, stars=len(telemetry),
        rms_arc_rad=Change(initial=1.0, final=1.0),
    )  # fmt: skip
