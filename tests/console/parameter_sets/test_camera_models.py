"""Parameters of every camera model go the whole way to the baseline."""

from collections.abc import Callable, Mapping

import pytest

from boresight.cameras import CAMERA_MODELS
from boresight.console.approvals import service as approvals
from boresight.console.fleet import service as sensors
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.runs.tables import Run
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, open_writing
from tests.console.conftest import SENSOR
from tests.passwords import approve

MIDDLE = {"m0_px": 971.5, "n0_px": 1295.5, "u0_px": 1295.5, "v0_px": 971.5, "f_m": 0.016, "g_y": 1.0, "s": 1.0}


@pytest.mark.parametrize("model", sorted(CAMERA_MODELS))
def test_a_set_of_every_model_is_approved_and_becomes_baseline(
    engine: Engine,
    blobs: BlobStore,
    people: Mapping[str, Actor],
    finished_run: Callable[..., Run],
    model: str,
) -> None:
    camera = CAMERA_MODELS[model]
    names = camera.parameter_names
    initial = {name: MIDDLE.get(name, 0.0) for name in names}
    typical = dict(zip(names, camera.default_typical_sigma, strict=True))
    estimate = initial | {"f_m": 0.0161}
    matrix = [[1e-12 if row == column else 0.0 for column in range(len(names))] for row in range(len(names))]
    with open_writing(engine) as session:
        document = SENSOR | {"name": "T-2", "camera_model": model, "initial": initial, "typical_sigma": typical}
        sensor = sensors.register_sensor(session, COMMAND_LINE, document)
        run = finished_run(
            session, people["ana"].user_id, camera_model=model, free=list(names), parameters=estimate,
            sigma=dict.fromkeys(names, 1e-6), covariance={"names": list(names), "matrix": matrix},
        )  # fmt: skip
        run.sensor_id, run.sensor_document = sensor.id, sensor.document
        row = parameter_sets.create_from_run(session, people["ana"], blobs, run.id)
        approvals.submit(session, people["ana"], blobs, row.id, "better", row.version)
        approval = approvals.list_approvals(session, parameter_set_id=row.id)[0]
        approve(session, people["cy"], approval)
        promoted = approvals.promote(session, people["dee"], row.id, row.version)

    assert promoted.ground_state == "BASELINE"
    assert promoted.document["parameters"] == estimate
    assert promoted.document["camera_model"] == model
