"""What a run of a constellation costs alone: the work of a worker in this process, with nobody else at work."""

from __future__ import annotations

import time

import orjson

from boresight.calibration.calibrate import calibrate
from boresight.calibration.settings import CalibrationSettings
from boresight.measurements.constellation import Constellation
from boresight.settings import Settings
from boresight.simulation.sensors import SENSOR_NUMBERS, st16_sensor
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.readers import read_telemetry


def alone(settings: Settings, constellation: Constellation, runs: int) -> dict[str, float]:
    """Compute so many runs, the tables in turn, on one thread; returns the mean `seconds` and `cpu_seconds` of one.

    What is timed is what a worker times: reading, calibrating and making the JSON. One run before is not counted.
    """
    catalogue, tables = load_catalogue(settings.catalogue_folder), list(constellation.expected)
    began_s, began_cpu_s = 0.0, 0.0
    for turn in range(runs + 1):
        if turn == 1:
            began_s, began_cpu_s = time.perf_counter(), time.thread_time()
        place = turn % len(tables)
        document = calibrate(
            read_telemetry(constellation.blobs.path(tables[place])),
            st16_sensor(SENSOR_NUMBERS[place]),
            catalogue,
            CalibrationSettings.parse(constellation.settings),
            cache_folder=settings.catalogue_folder,
        )
        orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS)
    return {
        "seconds": (time.perf_counter() - began_s) / runs,
        "cpu_seconds": (time.thread_time() - began_cpu_s) / runs,
    }
