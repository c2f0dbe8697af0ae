"""A calibration by the command loads no library that it does not use: that is what a fresh process waits for."""

import subprocess
import sys

import orjson
import pytest

from benchmarks.stars import write_synthetic
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document

#: Of the server, the workers, the charts, and of parts of libraries that are slow to load.
UNUSED = {
    "plotly", "distributed", "dask", "fastapi", "starlette", "jinja2", "alembic", "pandas", "scipy.optimize", "scipy.stats",
}  # fmt: skip
CALIBRATION = """
import sys
from boresight.cli import main
main(sys.argv[1:], standalone_mode=False)
print("|".join(sorted(sys.modules)))
"""


@pytest.fixture
def loaded(tmp_path):
    (tmp_path / "sensor.json").write_bytes(orjson.dumps(sensor_document(st16_sensor(1))))
    write_synthetic(tmp_path / "set.parquet", 60)
    words = ("calibrate", "set.parquet", "--sensor", "sensor.json", "--match", "given", "--json", "out.json")
    done = subprocess.run(
        [sys.executable, "-c", CALIBRATION, *words], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    return set(done.stdout.splitlines()[-1].split("|"))


def test_a_calibration_loads_neither_server_nor_workers_nor_charts(loaded):
    assert loaded & UNUSED == set()
