"""What the runs of a constellation cost alone: the work of a worker in bare processes, as many at once as there are workers.

Processes that compute at the same time share caches, memory and often cores, and each is slower by that: no queue is to blame.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import orjson

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.measurements.constellation import Constellation
from boresight.settings import Settings
from boresight.simulation.sensors import SENSOR_NUMBERS, st16_sensor
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.readers import read_telemetry


def alone(settings: Settings, constellation: Constellation, runs: int, processes: int) -> dict[str, float]:
    """Compute so many runs in each of some processes; returns the mean `seconds` and `cpu_seconds` of one.

    What is timed is what a worker times: reading, calibrating and making the JSON. One run before is not counted.
    """
    tables = [constellation.blobs.path(address) for address in constellation.expected]
    work = (settings.catalogue_folder, tables, constellation.settings, runs)
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        found = [future.result() for future in [pool.submit(computed, *work) for _ in range(processes)]]
    return {
        "seconds": sum(seconds for seconds, _ in found) / processes / runs,
        "cpu_seconds": sum(cpu_seconds for _, cpu_seconds in found) / processes / runs,
    }


def computed(
    catalogue_folder: Path, tables: Sequence[Path], settings: Mapping[str, Any], runs: int
) -> tuple[float, float]:
    """Compute so many runs on one thread, the tables in turn; returns the seconds and the processor seconds of all."""
    catalogue = load_catalogue(catalogue_folder)
    began_s, began_cpu_s = 0.0, 0.0
    for turn in range(runs + 1):
        if turn == 1:
            began_s, began_cpu_s = time.perf_counter(), time.thread_time()
        place = turn % len(tables)
        document = calibrate(
            read_telemetry(tables[place]),
            st16_sensor(SENSOR_NUMBERS[place]),
            catalogue,
            CalibrationSettings.parse(settings),
            cache_folder=catalogue_folder,
        )
        orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS)
    return time.perf_counter() - began_s, time.thread_time() - began_cpu_s
