"""A store of long runs for benchmarks: one real calibration of a simulated set, and as many runs like it as are asked for."""

from __future__ import annotations

import copy

import numpy as np
import orjson

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.services import parameter_sets, users
from boresight.services.actors import COMMAND_LINE
from boresight.services.passwords import prepare_unjudged
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky.catalogue import load_catalogue
from boresight.store.blobs import BlobStore, register_blob
from boresight.store.sessions import migrate, open_engine, utc_now, writing
from boresight.store.tables import Run, Sensor, TelemetrySet
from boresight.telemetry.sensors import sensor_document
from boresight.verdicts.summary import summary_of

PASSWORD = "a password of the benchmark"  # noqa: S105 - of a store that lives as long as this program


def with_noise(result, rng):
    """The result of another run: parameters and their history moved by one sigma's noise."""
    moved = copy.deepcopy(result)
    step = {name: rng.normal() * (sigma or 0.0) for name, sigma in result["sigma"].items()}
    moved["parameters"] = {name: value + step[name] for name, value in result["parameters"].items()}
    steps = np.array(list(step.values()))
    moved["history"]["parameters"] = (np.array(result["history"]["parameters"]) + steps).tolist()
    for key in ("tail_rms_rad", "aggregate_rms_rad"):
        values = np.array(result["history"][key], dtype=float)
        moved["history"][key] = (values * (1 + 1e-3 * rng.normal(size=len(values)))).tolist()
    return moved


def drawn_out(result, updates, rng):
    """The result with a history of so many updates, between its own points."""
    whole, history = dict(result), result["history"]
    place = np.linspace(0, len(history["frame"]) - 1, updates)
    near = place.astype(int)
    long = {key: np.array(values, dtype=float)[near] for key, values in history.items() if key != "time_utc" and values}
    long["frame"] = np.interp(place, np.arange(len(history["frame"])), history["frame"])
    long["nis"] = rng.chisquare(long["nis_dof"])
    whole["history"] = {key: values.tolist() for key, values in long.items()} | {"time_utc": None}
    series = result["trust"]["nis_over_time"]
    bounds = {key: [series[key][0]] * updates for key in ("lower", "upper")}
    values = {"frame": long["frame"].tolist(), "nis_per_dof": (long["nis"] / long["nis_dof"]).tolist(), **bounds}
    whole["trust"] = {**result["trust"], "nis_over_time": {**series, **values}}
    return whole


def calibrated(scenario, settings, folder, options):
    """The calibration of a simulated set, or the one that was given."""
    if options.calibration:
        return orjson.loads(options.calibration.read_bytes())
    catalogue, frames = load_catalogue(folder / "catalogue"), {**vars(scenario), "frames": options.frames}
    telemetry = simulate(type(scenario)(**frames), np.random.default_rng(1), catalogue)
    document = calibrate(telemetry, scenario.sensor, catalogue, settings)
    return orjson.loads(orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY))


def furnish(folder, options):
    """Make the store; returns the result that all runs come from."""
    scenario, settings = calibration_scenario(1), CalibrationSettings(method="sqrf", match="given")
    result = calibrated(scenario, settings, folder, options)
    engine, blobs, rng = (
        open_engine(f"sqlite:///{folder / 'data' / 'boresight.sqlite3'}"),
        BlobStore(folder / "data" / "blobs"),
        np.random.default_rng(2),
    )
    migrate(engine)
    results = [with_noise(result, rng) for _ in range(options.overlaid)]
    password = prepare_unjudged(PASSWORD)
    with writing(engine) as session:
        users.create_user(session, COMMAND_LINE, name="ada", printed_name="Ada", password=password, roles=("analyst",))
        sensor = Sensor(
            name=scenario.sensor.name, document=sensor_document(scenario.sensor), created_utc=utc_now(), simulated=1
        )
        session.add(sensor)
        session.flush()
        parameter_sets.create_ground_calibration(session, COMMAND_LINE, sensor, scenario.sensor)
        table = blobs.put(b"the table itself is not needed")
        register_blob(session, blobs, table, "application/octet-stream")
        made = TelemetrySet(
            sensor_id=sensor.id, name="TS-1", purpose="calibration", original_sha256=table, table_sha256=table,
            frames=options.frames, stars=result["stars"], quality={"exposures": result["exposures"], "warnings": []},
            uploaded_utc=utc_now(),
        )  # fmt: skip
        session.add(made)
        session.flush()
        addresses = [blobs.put(orjson.dumps(one)) for one in results]
        for sha256 in addresses:
            register_blob(session, blobs, sha256, "application/json")
        for number in range(options.runs):
            place = number % options.overlaid
            session.add(
                Run(
                    sensor_id=sensor.id,
                    telemetry_set_id=made.id,
                    method="sqrf",
                    settings=settings.document(),
                    sensor_document=sensor.document,
                    label=f"run {number + 1}",
                    state="SUCCEEDED",
                    launched_utc=utc_now(),
                    started_utc=utc_now(),
                    ended_utc=utc_now(),
                    launched_by=1,
                    result_sha256=addresses[place],
                    summary=summary_of(results[place]),
                )
            )
    engine.dispose()
    return result
