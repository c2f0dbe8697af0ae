"""A choice of a camera is computed by a real worker, and is what the library chooses here."""

import dataclasses

import numpy as np
import pytest

from boresight.calibration.choice.choose import choose
from boresight.calibration.choice.result import parse_choice
from boresight.calibration.options import CalibrationSettings
from boresight.console.runs import queries as runs
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.audit import chain
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import open_writing, utc_now
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.sensors import parse_sensor, sensor_document
from boresight.telemetry.writing import write_parquet

SCENARIO = dataclasses.replace(calibration_scenario(1), frames=12)


@pytest.fixture(scope="module")
def store(make_store, start_dispatcher):
    made = make_store(workers="1")
    start_dispatcher(made)
    return made


@pytest.mark.full
def test_a_worker_chooses_as_the_library_does(store, catalogue, tmp_path):
    table = tmp_path / "table.parquet"
    write_parquet(simulate(SCENARIO, np.random.default_rng(1), catalogue), table)
    with open_writing(store.database) as session:
        sha256 = store.blobs.put(table)
        register_blob(session, store.blobs, sha256, "application/vnd.apache.parquet")
        telemetry = TelemetrySet(
            sensor_id=store.sensor_id, name="stars", purpose="calibration", original_sha256=sha256, table_sha256=sha256,
            frames=SCENARIO.frames, stars=200, quality={}, uploaded_utc=utc_now(),
        )  # fmt: skip
        session.put(telemetry)
        common = {"sensor_id": store.sensor_id, "telemetry_set_id": telemetry.id}
        common |= {"sensor_document": sensor_document(SCENARIO.sensor), "settings": {"match": "given"}}
        of = runs.add_run(session, method="batch", **common).id
        asked = runs.add_run(session, method="choice", choice_of=of, **common).id
        chain.append_own(session, "launched", f"runs/{asked}")
    assert store.wait_until_ended([asked]) == ["SUCCEEDED"], store.run(asked).reason
    run = store.run(asked)
    found = parse_choice(store.blobs.read(run.result_sha256))
    sensor = parse_sensor(sensor_document(SCENARIO.sensor))
    here = choose(read_telemetry(table), sensor, catalogue, CalibrationSettings(match="given"))
    assert dataclasses.replace(found, leftover=None) == dataclasses.replace(here, leftover=None)
    assert found.leftover.p == pytest.approx(here.leftover.p)  # another number of threads sums in another order
    assert run.summary["sentence"] == found.sentence
    assert run.summary["camera_model"] == found.chosen.camera_model
    assert run.summary["seconds"] > 0
    assert any("was chosen" in line for line in store.log(asked, "log"))
