"""`import boresight` costs nothing: what a name needs is loaded when the name is asked for."""

import json
import subprocess
import sys
from importlib.resources import files

import pytest

import boresight as bs

SERVER = ("alembic", "dask", "distributed", "fastapi", "sqlalchemy", "starlette", "uvicorn")
HEAVY = (*SERVER, "httpx", "numba", "numpy", "pandas", "plotly", "polars", "pyarrow", "pydantic", "scipy")


def loaded_by(code):
    code = f"import json, sys\nbefore = set(sys.modules)\n{code}\nprint(json.dumps(sorted(set(sys.modules) - before)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def test_importing_the_library_loads_next_to_nothing():
    loaded = loaded_by("import boresight")
    assert len(loaded) < 40, loaded
    assert [name for name in HEAVY if name in loaded] == []


def test_every_function_and_class_comes_without_server_database_and_plotly():
    loaded = loaded_by("import boresight as bs\nfor name in bs.__all__: getattr(bs, name)")
    assert [name for name in (*SERVER, "plotly", "pandas", "polars") if name in loaded] == []


def test_a_calibration_is_read_from_json_without_compiled_loops_and_tables():
    loaded = loaded_by("from boresight.calibration.calibration import parse_calibration")
    assert [name for name in HEAVY if name in loaded] == []


def test_what_is_listed_is_there_and_nothing_else_is():
    assert set(bs.__all__) <= set(dir(bs))
    assert [name for name in bs.__all__ if not callable(getattr(bs, name))] == []
    with pytest.raises(AttributeError, match="calibrat"):
        _ = bs.calibrat


def test_the_types_are_shipped():
    assert (files(bs) / "py.typed").is_file()
