"""A typed client, generated from the OpenAPI document, does a day's work against a real server with a worker of its own."""

import importlib
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from benchmarks.servers import wait_until
from boresight.simulation.scenes import simulate
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_csv
from tests.served import PASSWORD, SCENARIO, add_people, serving, settings_in

NAME = "boresight_typed_client"
CONFIG = {"post_hooks": [], "content_type_overrides": {"application/zip": "application/octet-stream"}}
LONGEST_S = 120
ENDED = {"SUCCEEDED", "FAILED", "CANCELLED", "LOST"}


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, dict[str, Any], Path]]:
    folder = tmp_path_factory.mktemp("typed")
    catalogue = load_catalogue(folder / "catalogue")
    write_csv(simulate(SCENARIO, np.random.default_rng(1), catalogue), folder / "telemetry.csv")
    settings = settings_in(folder / "data", workers="1")
    add_people(settings)
    with serving(settings, catalogue) as (address, app):
        yield address, app.openapi(), folder / "telemetry.csv"


@pytest.fixture(scope="module")
def generated(
    served: tuple[str, dict[str, Any], Path], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ModuleType]:
    folder = tmp_path_factory.mktemp("generated")
    (folder / "openapi.json").write_text(json.dumps(served[1]))
    (folder / "config.json").write_text(json.dumps(CONFIG))
    program = [str(Path(sys.executable).with_name("openapi-python-client")), "generate", "--meta", "none"]
    made = subprocess.run(
        [*program, "--path", "openapi.json", "--config", "config.json", "--output-path", NAME],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert made.returncode == 0, made.stdout + made.stderr
    said = made.stdout + made.stderr
    # The generator knows one of the two forms of the export, and no keys in PEM.
    assert said.count("WARNING") <= said.count("/audit/export") + said.count("application/x-pem-file"), said
    sys.path.insert(0, str(folder))
    yield importlib.import_module(NAME)
    sys.path.remove(str(folder))
    for name in [name for name in sys.modules if name.partition(".")[0] == NAME]:
        del sys.modules[name]


@pytest.mark.full
def test_a_generated_client_logs_in_uploads_launches_waits_and_reads_a_typed_result(
    served: tuple[str, dict[str, Any], Path], generated: ModuleType
) -> None:
    address, _, telemetry = served

    def ask(module: str, **given: Any) -> Any:
        return importlib.import_module(f"{NAME}.api.{module}").sync(client=client, **given)

    models, types = importlib.import_module(f"{NAME}.models"), importlib.import_module(f"{NAME}.types")
    client = generated.Client(base_url=address, raise_on_unexpected_status=True)
    with closing(client.get_httpx_client()):
        person = ask("sessions.log_in", body=models.Credentials(name="ada", password=PASSWORD))
        assert isinstance(person, models.Session)
        assert (person.name, person.roles) == ("ada", ["analyst"])
        client.get_httpx_client().headers["X-CSRF-Token"] = person.csrf_token  # the cookie is in its jar already

        document = {**sensor_document(SCENARIO.sensor), "name": "ST-typed"}
        sensor = ask("sensors.register_sensor", body=models.RegisterSensorDocument.from_dict(document))
        assert isinstance(sensor, models.Sensor)

        with telemetry.open("rb") as file:
            body = models.UploadTelemetrySetBody(
                sensor_id=sensor.id, file=types.File(file, "telemetry.csv", "text/csv")
            )
            uploaded = ask("telemetry_sets.upload_telemetry_set", body=body)
        assert isinstance(uploaded, models.TelemetrySet)
        assert uploaded.frames == SCENARIO.frames

        settings = models.LaunchSettings.from_dict({"method": "batch"})
        run = ask("runs.launch_run", body=models.Launch(sensor.id, uploaded.id, settings=settings, label="typed"))
        assert isinstance(run, models.Run)
        wait_until(lambda: ask("runs.get_run", run_id=run.id).state.value in ENDED, LONGEST_S)
        run = ask("runs.get_run", run_id=run.id)
        assert (run.state.value, run.reason) == ("SUCCEEDED", None)

        result = ask("runs.get_run_result", run_id=run.id)
        assert isinstance(result, models.Calibration)
        assert result.status is models.CalibrationStatus.CONVERGED
        found, known = result.parameters["f_m"], result.sigma["f_m"]
        assert abs(found - document["initial"]["f_m"]) < 100 * document["typical_sigma"]["f_m"]
        assert 0 < known < document["typical_sigma"]["f_m"]
        assert result.rms_arc_rad.final < result.rms_arc_rad.initial

        missing = ask("runs.get_run", run_id=987654)
        assert isinstance(missing, models.ProblemDocument)
        assert missing.status == 404
