"""What a fresh process pays is measured in fresh processes; and a calibration loads no library that it does not use."""

import subprocess
import sys

import orjson
import pytest

from boresight.measurements import fresh_process
from boresight.measurements.synthetic_file import write_synthetic
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document

#: Of the server, the workers, the charts, and of parts of the standard library that are slow to load.
UNUSED = (
    "plotly",
    "distributed",
    "dask",
    "fastapi",
    "starlette",
    "jinja2",
    "alembic",
    "pandas",
    "scipy.optimize",
    "scipy.stats",
)

CALIBRATION = """
import sys
from boresight.cli import main
main(sys.argv[1:], standalone_mode=False)
print("|".join(sorted(sys.modules)))
"""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """Modules that a calibration from a Parquet file has loaded when it ends."""
    place = tmp_path_factory.mktemp("fresh")
    (place / "sensor.json").write_bytes(orjson.dumps(sensor_document(st16_sensor(1))))
    write_synthetic(place / "set.parquet", 60)
    words = ("calibrate", "set.parquet", "--sensor", "sensor.json", "--match", "given", "--json", "out.json")
    done = subprocess.run(
        [sys.executable, "-c", CALIBRATION, *words], cwd=place, check=True, capture_output=True, text=True
    )
    return set(done.stdout.splitlines()[-1].split("|"))


@pytest.mark.parametrize("library", UNUSED)
def test_a_calibration_loads_nothing_of(loaded, library):
    assert library not in loaded


def test_the_first_calibration_is_counted_from_before_the_interpreter_starts():
    found = fresh_process.measure(lambda *_: None, frames=60, repeats=1, uncompiled=False)

    assert found["first_s"] > found["warm_s"] > 0
    assert found["fresh_over_warm_s"] == pytest.approx(found["first_s"] - found["warm_s"])
    assert found["limits"]["fresh_over_warm"]["measured"] == found["fresh_over_warm_s"]
    assert found["uncompiled_first_s"] is None
