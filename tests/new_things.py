"""What a tree with a dummy of each new thing shows of them; `tests/test_new_things.py` runs it in a copy, and reads the JSON."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import orjson
import pytest
from click.testing import CliRunner, Result
from fastapi import FastAPI
from sqlalchemy.orm import Session
from starlette.routing import Match

from benchmarks.pages.drawings import guide_page
from boresight.cameras import CAMERA_MODELS
from boresight.cli import main
from boresight.console.fleet import service as sensors
from boresight.console.fleet.tables import Sensor
from boresight.console.pages.frame import NAVIGATION
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.figures import FIGURES
from boresight.figures.example_calibration import get_example_calibrations
from boresight.figures.report import render_report
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.engines import open_engine
from boresight.platform.db.sessions import open_writing, utc_now
from boresight.server import create_app
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.quality.findings import FINDINGS
from boresight.telemetry.sensors import parse_sensor, sensor_document
from boresight.telemetry.writing import write_csv
from boresight.verdicts.gates import judge, parse_profile
from boresight.verdicts.gates.assessed_set import ground_set
from boresight.verdicts.gates.assessment import assess
from boresight.verdicts.gates.judgement import gate_rows
from boresight.verdicts.gates.measurements import GATES
from tests.passwords import add_person, use_hasher
from tests.served import PASSWORD, serving, settings_in
from tests.stores import open_migrated, url_in

SCENARIO = replace(calibration_scenario(1), frames=10)
SENSOR = SCENARIO.sensor


def furnished(folder: Path) -> int:
    """Fill a store: people, a sensor, and two runs that ended with the example's calibration; returns the sensor's number."""
    settings = settings_in(folder)
    blobs = open_blobs(settings.blob_location)
    engine = open_migrated(url_in(folder))
    with open_writing(engine) as session:
        person = add_person(session, "ada", "analyst")
        sensor = sensors.register_sensor(session, COMMAND_LINE, sensor_document(SENSOR))
        add_runs(session, blobs, person.id, sensor.id, get_example_calibrations()["filter"].to_dict(), count=2)
        found = sensor.id
    engine.dispose()
    return found


def add_runs(session: Session, blobs: BlobStore, person: int, sensor_id: int, result: Any, count: int) -> list[Run]:
    """Add runs that ended with a result, and the set that they took."""
    now, address = utc_now(), blobs.put(orjson.dumps(result))
    register_blob(session, blobs, address, "application/json")
    telemetry = TelemetrySet(
        sensor_id=sensor_id, name=f"TS-{sensor_id}", purpose="calibration", original_sha256=address, table_sha256=address,
        frames=60, stars=result["stars"], quality={"exposures": 120, "warnings": []}, uploaded_utc=now,
    )  # fmt: skip
    session.add(telemetry)
    session.flush()
    made = [
        Run(
            sensor_id=sensor_id, telemetry_set_id=telemetry.id, method=result["method"], settings={},
            sensor_document=session.get_one(Sensor, sensor_id).document, state="SUCCEEDED", launched_utc=now, started_utc=now,
            ended_utc=now, launched_by=person, result_sha256=address, summary={"status": "converged"},
        )
        for _ in range(count)
    ]  # fmt: skip
    session.add_all(made)
    audit.append(session, COMMAND_LINE, "run.succeeded", f"telemetry_sets/{telemetry.id}")
    return made


def command(*words: str | Path) -> Result:
    return CliRunner().invoke(main, list(map(str, words)))


def camera(ada: httpx.Client, folder: Path) -> dict[str, Any]:
    """Take a sensor of a new model all the way: simulated, calibrated, converted, registered, shown."""
    model = CAMERA_MODELS["dummy_lens"]
    x = model.plain(2250.0, 972.0, 1296.0, 2.2e-6)
    names = model.parameter_names
    true = dict(zip(names, (x + 0.5 * np.array(model.default_typical_sigma)).tolist(), strict=True))
    document = sensor_document(SENSOR) | {
        "name": "lens-1", "camera_model": "dummy_lens", "initial": dict(zip(names, x.tolist(), strict=True)),
        "centroid_sigma_px": 0.2, "typical_sigma": dict(zip(names, model.default_typical_sigma, strict=True)), "free": list(names),
    }  # fmt: skip
    sensor, scenario, result = (folder / name for name in ("lens.json", "lens-scenario.json", "lens-result.json"))
    sensor.write_bytes(orjson.dumps(document))
    scenario.write_bytes(orjson.dumps({"sensor": document, "truth": true, "frames": 20, "seed": 3}))
    telemetry = folder / "lens" / "calibration.csv"
    done = {
        "simulate": command("simulate", scenario, "--out", folder / "lens"),
        "calibrate": command("calibrate", telemetry, "--sensor", sensor, "--match", "given", "--json", result),
        "convert": command(
            "convert",
            result,
            "--sensor",
            sensor,
            "--to",
            "brown_conrady",
            "--out",
            folder / "brown.json",
            "--allow-px",
            "1",
        ),
        "report": command("report", result, "--out", folder / "lens.html"),
    }
    printed = {name: one.output for name, one in done.items()}
    found = json.loads(result.read_bytes())
    error = np.array([found["parameters"][name] - true[name] for name in names])
    registered = ada.post("/api/v1/sensors", json=document)
    engine = open_engine(url_in(folder))
    with open_writing(engine) as session:
        sensor_id = registered.json()["id"]
        run_id = add_runs(session, open_blobs(settings_in(folder).blob_location), 1, sensor_id, found, count=1)[0].id
    engine.dispose()
    pages = {
        "form": ada.get(f"/runs/new?sensor={sensor_id}").text,
        "sensor": ada.get(f"/sensors/{sensor_id}").text,
        "run": ada.get(f"/runs/{run_id}").text,
        "report": (folder / "lens.html").read_text(),
        "rest": ada.get(f"/api/v1/runs/{run_id}/result").text,
    }
    return {
        "registered": list(CAMERA_MODELS),
        "sensor_read": parse_sensor(document).camera_model,
        "sensor_registered": registered.status_code,
        "offered": "dummy_lens" in ada.post("/api/v1/sensors", json=document | {"camera_model": "nothing"}).text,
        "exit_codes": {name: one.exit_code for name, one in done.items()},
        "printed": printed,
        "status": found["status"],
        "free": found["free"],
        "errors_in_sigma": [e / found["sigma"][name] for e, name in zip(error, names, strict=True)],
        "nees": error @ np.linalg.solve(np.array(found["covariance"]["matrix"]), error),
        "misfit_px": json.loads((folder / "brown.json").read_text())["conversion"]["misfit_px"]["max"],
        "figures": {name: ada.get(f"/api/v1/runs/{run_id}/figures/{name}").status_code for name in FIGURES},
        "on": {place: "division" in text or "focal_px" in text for place, text in pages.items()},
    }


def chart(ada: httpx.Client) -> dict[str, Any]:
    (listed,) = (one for one in ada.get("/api/v1/runs/1/figures").json()["items"] if one["name"] == "dummy-chart")
    described = json.dumps(ada.get("/api/v1/openapi.json").json()["paths"]["/api/v1/runs/{run_id}/figures/{name}"])
    places = {
        "run page": ada.get("/runs/1?part=convergence").text,
        "compare": ada.get("/compare?runs=1,2").text,
        "gallery": ada.get("/gallery").text,
        "report": render_report(get_example_calibrations()["filter"]),
        "guide": guide_page(),
        "document": described,
    }
    return {
        "registered": "dummy-chart" in FIGURES,
        "listed": {key: listed[key] for key in ("name", "title")},
        "drawn": ada.get("/api/v1/runs/1/figures/dummy-chart").json(),
        "csv": ada.get("/api/v1/runs/1/figures/dummy-chart/data").text,
        "on": {place: "dummy-chart" in text for place, text in places.items()},
    }


def gate(ada: httpx.Client, sensor_id: int, folder: Path) -> dict[str, Any]:
    result = get_example_calibrations()["batch"]
    limited = parse_profile({"gates": [{"name": "dummy-gate", "limit": 2.0, "marginal": 1.0}]})
    (found, strict) = (assess(result, SENSOR, ground_set(SENSOR), profile) for profile in (parse_profile({}), limited))
    answer, refused = ({one.name: one for one in report.gates}["dummy-gate"] for report in (found, strict))
    (folder / "result.json").write_bytes(orjson.dumps(result.to_dict()))
    (folder / "sensor.json").write_bytes(orjson.dumps(sensor_document(SENSOR)))
    printed = command("assess", folder / "result.json", "--sensor", folder / "sensor.json").output
    return {
        "answer": {"status": answer.status, "value": answer.value, "limit": answer.limit},
        "limited": {"status": refused.status},
        "nothing": judge(parse_profile({}), {}).verdict,
        "on": {
            "editor": "dummy-gate" in ada.get(f"/sensors/{sensor_id}/gates").text,
            "panel": "Dummy gate" in {one.title for one in gate_rows(found.gates, found.blocking)},
            "command": "Dummy gate" in printed,
        },
    }


def finding(ada: httpx.Client, sensor_id: int, folder: Path) -> dict[str, Any]:
    telemetry, sensor = folder / "telemetry.csv", folder / "sensor.json"
    write_csv(simulate(SCENARIO, np.random.default_rng(1), load_catalogue(folder)), telemetry)
    printed = command("check", telemetry, "--sensor", sensor, "--json", folder / "report.json")
    assert printed.exit_code == 0, printed.output
    (found,) = (one for one in json.loads((folder / "report.json").read_text())["findings"] if one["code"] == "DUMMY")
    files = {"file": ("telemetry.csv", telemetry.read_bytes())}
    answer = ada.post("/api/v1/telemetry-sets", data={"sensor_id": str(sensor_id)}, files=files)
    set_id = answer.raise_for_status().json()["id"]
    return {
        "report": {key: found[key] for key in ("code", "severity", "sentence")},
        "on": {
            "command": "Every row was looked at." in printed.output,
            "rest": "DUMMY" in ada.get(f"/api/v1/telemetry-sets/{set_id}").text,
            "page": "Every row was looked at." in ada.get(f"/telemetry/{set_id}").text,
        },
    }


def route(ada: httpx.Client, nobody: httpx.Client) -> dict[str, Any]:
    paths = ada.get("/api/v1/openapi.json").json()["paths"]
    made = paths["/api/v1/dummies"]["post"]
    token, key = ada.headers.pop("X-CSRF-Token"), {"Idempotency-Key": "one"}
    without = ada.post("/api/v1/dummies", json={"id": 2})
    ada.headers["X-CSRF-Token"] = token
    answers = {
        "read by nobody": nobody.get("/api/v1/dummies/1"),
        "read by ada": ada.get("/api/v1/dummies/1"),
        "made by nobody": nobody.post("/api/v1/dummies", json={"id": 2}),
        "made without the token": without,
        "made by ada": ada.post("/api/v1/dummies", json={"id": 2}, headers=key),
        "made again": ada.post("/api/v1/dummies", json={"id": 2}, headers=key),
        "only tried": ada.post("/api/v1/dummies", json={"id": 3}, params={"validate_only": "true"}),
    }
    return {
        "documented": sorted([*paths["/api/v1/dummies/{dummy_id}"], *paths["/api/v1/dummies"]]),
        "refusals": list(made["responses"]),
        "parameters": [one["name"] for one in made["parameters"]],
        "statuses": {name: answer.status_code for name, answer in answers.items()},
        "replayed": answers["made again"].headers.get("Idempotent-Replayed"),
        "tried": answers["only tried"].headers.get("X-Validate-Only"),
    }


def page(ada: httpx.Client, nobody: httpx.Client) -> dict[str, Any]:
    html = {"Accept": "text/html"}
    shown, led, missing = (
        ada.get("/dummies/1", headers=html),
        nobody.get("/dummies/1", headers=html),
        ada.get("/dummies/2", headers=html),
    )
    return {
        "statuses": {"to ada": shown.status_code, "to nobody": led.status_code, "not there": missing.status_code},
        "nobody_is_led_to": led.headers.get("location", ""),
        "on": {
            "content": "<h1>Dummy 1</h1>" in shown.text,
            "frame": 'aria-label="Main"' in shown.text,
            "navigation": 'href="/dummies/1"' in ada.get("/sensors", headers=html).text,
            "error": "There is no dummy 2." in missing.text and 'aria-label="Main"' in missing.text,
        },
    }


def run(folder: Path) -> dict[str, Any]:
    """Serve the store and look at everything."""
    with pytest.MonkeyPatch.context() as patch:
        use_hasher(patch)
        sensor_id = furnished(folder)
        with serving(settings_in(folder)) as (address, _), httpx.Client(base_url=address, timeout=60) as ada:
            answer = ada.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD})
            ada.headers["X-CSRF-Token"] = answer.raise_for_status().json()["csrf_token"]
            with httpx.Client(base_url=address, timeout=60) as nobody:
                return {
                    "camera": camera(ada, folder),
                    "chart": chart(ada),
                    "gate": gate(ada, sensor_id, folder),
                    "finding": finding(ada, sensor_id, folder),
                    "route": route(ada, nobody),
                    "page": page(ada, nobody),
                }


def leads_somewhere(app: FastAPI, path: str) -> bool:
    scope = {"type": "http", "method": "GET", "path": path, "root_path": "", "headers": [], "app": app}
    return any(one.matches(dict(scope))[0] is Match.FULL for one in app.routes)


def ask_registries(folder: Path) -> dict[str, bool]:
    """Ask what each new thing is registered in, without a server, a store or a compiled loop."""
    app = create_app(settings_in(folder))
    return {
        "camera": "dummy_lens" in CAMERA_MODELS,
        "chart": "dummy-chart" in FIGURES,
        "gate": "dummy-gate" in GATES,
        "finding": "looked_at" in {one.__name__ for one in FINDINGS},
        "route": "post" in app.openapi()["paths"].get("/api/v1/dummies", ()),
        "page": leads_somewhere(app, "/dummies/1") and not leads_somewhere(app, "/others/1"),
        "navigation": "/dummies/1" in {line.path for part in NAVIGATION for line in part.lines},
    }


if __name__ == "__main__":
    found = ask_registries if "--registries" in sys.argv else run
    sys.stdout.write(json.dumps(found(Path(sys.argv[1]))))
