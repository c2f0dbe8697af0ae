"""A constellation for measurements: hundreds of simulated star trackers, each with telemetry of a few frames to calibrate.

The trackers share a few telemetry tables, for what is measured is not how they differ. A table is a real sky over an ST-16,
two exposures a frame, about twelve stars in each.
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.services import api_keys, sensors, telemetry_sets, users
from boresight.services.actors import COMMAND_LINE, Actor
from boresight.services.passwords import prepare_unjudged
from boresight.settings import Settings
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import SENSOR_NUMBERS, st16_sensor
from boresight.sky.catalogue import load_catalogue
from boresight.store.blobs import BlobStore, open_blobs
from boresight.store.sessions import Engine, migrate, open_engine, writing
from boresight.telemetry.readers import read_telemetry, write_parquet
from boresight.telemetry.sensors import sensor_document

FAINTEST = 4.9  # twelve stars an exposure
OWN = ("timing_s", "sensor")  # of a result: what two runs of the same work do not share
REPEATS = 3
NAME, PASSWORD = "analyst", "analyst-of-the-constellation"  # of a store that is removed with the measurement


@dataclass(frozen=True)
class Constellation:
    """A furnished store.

    Parameters
    ----------
    database, blobs
        The store.
    sensor_ids
        The trackers.
    key
        Secret of an API key that may launch runs.
    settings
        Of every run.
    expected
        Digest of the result that a run must have, by the address of its table, computed in this process.
    computing_s
        Seconds of such a run here, alone: the fastest of some repeats, mean over the tables.
    stars
        Of a table, on average.
    """

    database: Engine
    blobs: BlobStore
    sensor_ids: list[int]
    key: str
    settings: Mapping[str, Any]
    expected: Mapping[str, str]
    computing_s: float
    stars: float


def furnish(installed: Settings, trackers: int, frames: int, settings: Mapping[str, Any]) -> Constellation:
    """Fill an empty data folder."""
    database, blobs = open_engine(installed.database_url), open_blobs(installed.blob_place)
    migrate(database)
    analyst, key = _analyst(database)
    tables = min(trackers, len(SENSOR_NUMBERS))
    sensor_ids, addresses, stars = [], {}, 0
    catalogue = load_catalogue(installed.catalogue_folder)
    for number in SENSOR_NUMBERS[:tables]:
        scenario = replace(calibration_scenario(number, frames), magnitude_limit=FAINTEST)
        telemetry = simulate(scenario, np.random.default_rng(number), catalogue)
        stars += len(telemetry)
        with tempfile.TemporaryDirectory(dir=installed.data_folder) as folder:
            path = Path(folder) / f"table-{number}.parquet"
            write_parquet(telemetry, path)
            document = sensor_document(st16_sensor(number))
            with (
                telemetry_sets.prepared(document, catalogue, path, path.name) as upload,
                writing(database) as session,
            ):
                for tracker in range(number, trackers + 1, tables):
                    row = sensors.register_sensor(session, analyst, document | {"name": f"ST-{tracker:05d}"})
                    stored = telemetry_sets.store_prepared(session, analyst, blobs, row.id, upload)
                    sensor_ids.append(row.id)
                    addresses[stored.table_sha256] = number
    expected, computing_s = _expected(installed, blobs, addresses, settings)
    return Constellation(database, blobs, sorted(sensor_ids), key, settings, expected, computing_s, stars / tables)


def _analyst(database: Engine) -> tuple[Actor, str]:
    """Make the person whose key launches the runs."""
    password = prepare_unjudged(PASSWORD)
    with writing(database) as session:
        row = users.create_user(
            session, COMMAND_LINE, name=NAME, printed_name="Ada Analyst", password=password, roles=("analyst",)
        )
        analyst = users.actor_of(session, row.id)
        _, secret = api_keys.create_key(session, analyst, label="measurement", scopes=("runs",))
    return analyst, secret


def _expected(
    installed: Settings, blobs: BlobStore, addresses: Mapping[str, int], settings: Mapping[str, Any]
) -> tuple[dict[str, str], float]:
    """Compute here what each table must come to, and how long that takes."""
    catalogue, digests, taken_s = load_catalogue(installed.catalogue_folder), {}, []
    for address, number in addresses.items():
        times_s = []
        for _ in range(REPEATS):
            began_s = time.perf_counter()
            document = calibrate(
                read_telemetry(blobs.path(address)),
                st16_sensor(number),
                catalogue,
                CalibrationSettings.parse(settings),
                cache_folder=installed.catalogue_folder,
            )
            times_s.append(time.perf_counter() - began_s)
        content = orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS)
        digests[address] = digest_of(content)
        taken_s.append(min(times_s))
    return digests, sum(taken_s) / len(taken_s)


def digest_of(result: bytes) -> str:
    """Return the digest of what two runs of the same work share of their results."""
    document = {name: value for name, value in orjson.loads(result).items() if name not in OWN}
    return hashlib.sha256(orjson.dumps(document, option=orjson.OPT_SORT_KEYS)).hexdigest()
