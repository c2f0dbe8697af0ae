"""A process that reads telemetry files as uploads are read, each in a child: `python -m tests.telemetry.reading_process`.

For each path on a line of its input it writes a line of JSON: what came of the file, seconds, and the peak of memory, MB. A
child has what reading needs imported, and the star catalogue, as a server has; its peak counts all of that.
"""

import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

from boresight.console.telemetry.service import hold_prepared
from boresight.errors import RefusedInputError
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.sensors import sensor_document

#: No hostile file may keep a child longer.
MOST_S = 60


def main() -> None:
    sensor = sensor_document(st16_sensor(1))
    with tempfile.TemporaryDirectory() as folder:
        catalogue = load_catalogue(Path(folder))
    say("ready")
    for line in sys.stdin:
        say(json.dumps(read_in_child(Path(line.rstrip("\n")), sensor, catalogue)))


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def read_in_child(path: Path, sensor: dict[str, object], catalogue: Catalogue) -> dict[str, object]:
    receiving, sending = os.pipe()
    began = time.monotonic()
    child = os.fork()
    if not child:
        os.close(receiving)
        os.write(sending, json.dumps(outcome(path, sensor, catalogue)).encode())
        os._exit(0)
    os.close(sending)
    with os.fdopen(receiving, "rb") as pipe:
        said = pipe.read()
    _, status, usage = os.wait4(child, 0)
    return {
        "outcome": json.loads(said) if said else ["died", f"status {status}"],
        "seconds": time.monotonic() - began,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "peak_mb": usage.ru_maxrss / 1000,
    }


def outcome(path: Path, sensor: dict[str, object], catalogue: Catalogue) -> list[str]:
    signal.alarm(MOST_S)
    try:
        with hold_prepared(sensor, catalogue, path, path.name) as ready:
            return ["accepted", f"{ready.stars} stars"]
    except RefusedInputError as error:
        return ["refused", str(error)]
    except BaseException as error:  # noqa: BLE001 - what must not be is reported, not raised
        return ["failed", repr(error)]


if __name__ == "__main__":
    main()
