"""A calibration over REST in ten lines, without the library: upload, launch, wait, read. Sensor 1 is the server's."""

import os
import time
from pathlib import Path

import httpx

HEADERS = {"Authorization": f"Bearer {os.environ['BORESIGHT_API_KEY']}"}
with httpx.Client(base_url="https://boresight.example/api/v1", headers=HEADERS, timeout=60) as server:
    file = ("calibration.csv", Path("calibration.csv").read_bytes())
    stars = server.post("/telemetry-sets", data={"sensor_id": "1"}, files={"file": file}).raise_for_status().json()
    order = {"sensor_id": 1, "telemetry_set_id": stars["id"], "settings": {"method": "batch"}}
    run = server.post("/runs", json=order).raise_for_status().json()
    while (run := server.get(f"/runs/{run['id']}").json())["state"] in ("QUEUED", "RUNNING", "CANCELLING"):
        time.sleep(0.2)
    calibration = server.get(f"/runs/{run['id']}/result").raise_for_status().json()
print(run["state"], calibration["parameters"]["f_m"], "±", calibration["sigma"]["f_m"])
