"""A server and commands on a small disk of their own that is filled; `test_moved_folders` runs it in a mount namespace."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.served import PASSWORD, House, add_people, serving, settings_in


def _fill(disk: Path) -> Path:
    ballast = disk / "ballast"
    with ballast.open("wb") as file:
        for size in (1 << 20, 4096, 1):
            try:
                while True:
                    os.write(file.fileno(), bytes(size))
            except OSError:
                continue
    return ballast


def _files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def main(disk: Path) -> None:
    data, told = disk / "data", {}
    tempfile.tempdir = str(disk.parent)
    settings = settings_in(data)
    add_people(settings)
    with serving(settings) as (address, app):
        house = House(address, app, b"frame,exposure,row_px,col_px\n" + b"1,0,1,1\n1,0,900,900\n" * 3, {})
        client = house.person("ada")
        sensor_id = house.new_sensor()["id"]
        blobs = data / "blobs"
        blobs.mkdir(exist_ok=True)
        before = _files(blobs)
        ballast = _fill(disk)
        answers = {
            "upload": house.upload(client, sensor_id),
            "sensor": client.post("/api/v1/sensors", json=house.sensor_file()),
            "log in": house.anybody().post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD}),
            "ready": client.get("/readyz"),
        }
        told["full"] = {name: [it.status_code, it.headers.get("retry-after"), it.text] for name, it in answers.items()}
        told["read"] = client.get("/api/v1/sensors").status_code
        told["left behind"] = [name for name in _files(blobs) if name not in before]
        words = ["user", "add", "zoe", "--role", "viewer", "--printed-name", "Zoe", "--password-stdin"]
        command = [sys.executable, "-m", "boresight", *words]
        environment = os.environ | {"BORESIGHT_DATA_FOLDER": str(data)}
        done = subprocess.run(
            command, input=f"{PASSWORD} x\n", env=environment, capture_output=True, text=True, check=False
        )
        told["command"] = [done.returncode, done.stderr]
        ballast.unlink()
        told["again"] = client.post("/api/v1/sensors", json=house.sensor_file()).status_code
        told["ready again"] = [client.get("/readyz").status_code for _ in range(1)]
        for opened in house.opened:
            opened.close()
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    done = subprocess.run(
        command, input=f"{PASSWORD} x\n", env=environment, capture_output=True, text=True, check=False
    )
    told["read only"] = [done.returncode, done.stderr]
    sys.stdout.write(f"{json.dumps(told)}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
