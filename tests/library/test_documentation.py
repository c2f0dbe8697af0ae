"""The reference of the library, its notebook and its REST script are run as they stand, and their types are checked."""

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import boresight as bs
from boresight.cli.remote import API_KEY

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
REFERENCE = (DOCS / "library.md").read_text()
ADDRESS = "https://boresight.example"
BLOCKS = re.findall(r"```python\n(.*?)```", REFERENCE, re.DOTALL)
TYPES = """
from typing import assert_type

import polars

assert_type(cal, bs.Calibration)
assert_type(cal.parameters.f_m * 1e3, float)
assert_type(cal.sigma.f_m, float | None)
assert_type(cal.advice, list[str])
assert_type(scores, bs.Evaluation)
assert_type(found, list[bs.Calibration])
assert_type(cal.to_frame("polars"), polars.DataFrame)
bs.calibrate("esa-5-frames.csv", "esa.sensor.json", fre="f_m")  # type: ignore[call-arg]
bs.calibrate("esa-5-frames.csv", "esa.sensor.json", minimum_stars="few")  # type: ignore[arg-type]
bs.choose("esa-5-frames.csv", "esa.sensor.json", mach="given")  # type: ignore[call-arg]
bs.Client("https://boresight.example").launch(1, metod="sqrf")  # type: ignore[call-arg]
bs.Client("https://boresight.example").choose("esa-5-frames.csv", "esa", mach="given")  # type: ignore[call-arg]
cal.sigma.f_m * 2  # type: ignore[operator]
assert_type(bs.export_camera("cal.json", "esa.sensor.json", "opencv"), bs.CameraFile)
bs.bogus  # type: ignore[attr-defined]
"""


def _sections():
    for title, text in re.findall(r"^### (.*?)\n(.*?)(?=^##|\Z)", REFERENCE, re.MULTILINE | re.DOTALL):
        yield re.findall(r"`bs\.(\w+)`", title), "".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))


@pytest.fixture
def place(tmp_path, monkeypatch, house, key):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(API_KEY, key)
    return house.address


@pytest.fixture
def source():
    """The lines of the notebook, cell by cell."""
    cells = json.loads((DOCS / "notebook.ipynb").read_text())["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def test_every_name_of_the_library_has_a_heading_and_an_example_and_nothing_else_has():
    told = [(name, example) for names, example in _sections() for name in names]
    assert sorted(name for name, _ in told) == sorted(bs.__all__)
    assert [name for name, example in told if f"bs.{name}" not in example] == []


def test_type_checkers_are_told_every_name_of_the_library_and_no_other():
    tree = ast.parse(Path(bs.__file__).read_text())
    blocks = [one for one in tree.body if isinstance(one, ast.If) and ast.unparse(one.test) == "TYPE_CHECKING"]
    told = [name.name for block in blocks for line in block.body for name in line.names]
    assert sorted(told) == sorted(bs.__all__)


def test_every_method_of_the_client_is_in_the_reference():
    public = {name for name in dir(bs.Client) if name[0] != "_"} - {"close", "url"}
    assert [name for name in public if f"`{name}(" not in REFERENCE] == []
    assert [name for name in public if not any(f".{name}(" in block for block in BLOCKS)] == []


@pytest.mark.full
@pytest.mark.usefixtures("computing")
def test_the_examples_of_the_reference_run(place):
    names = {"__name__": "reference"}
    for number, block in enumerate(BLOCKS):
        exec(compile(block.replace(ADDRESS, place), f"library.md, example {number}", "exec"), names)  # noqa: S102 - they are ours
    assert Path("report.html").is_file()
    assert [cal.status for cal in names["found"]] == 2 * ["converged"]


@pytest.mark.usefixtures("place")
def test_the_notebook_runs_and_each_cell_shows_something(source):
    assert sum(len([line for line in cell.splitlines() if line]) for cell in source) == 10
    names = {}
    for cell in source:
        *body, last = ast.parse(cell).body
        exec(compile(ast.Module(body, []), "notebook", "exec"), names)  # noqa: S102 - it is ours
        shown = eval(compile(ast.Expression(last.value), "notebook", "eval"), names)  # noqa: S307 - it is ours
        assert repr(shown)
    assert bs.load("cal.json") == names["cal"]


@pytest.mark.usefixtures("computing")
def test_the_script_over_rest_runs(place, house):
    sensor = house.new_sensor()["id"]
    Path("calibration.csv").write_bytes(house.telemetry_csv)
    text = (DOCS / "rest.py").read_text()
    assert len(text[text.index("HEADERS") :].splitlines()) == 10
    text = text.replace(ADDRESS, place).replace('"sensor_id": "1"', f'"sensor_id": "{sensor}"')
    text = text.replace('"sensor_id": 1', f'"sensor_id": {sensor}')
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[0] == "SUCCEEDED"


@pytest.mark.full
def test_the_examples_are_of_the_types_that_the_library_promises(tmp_path):
    (tmp_path / "program.py").write_text("\n".join(BLOCKS) + TYPES)
    words = (
        "--strict",
        "--follow-imports=silent",
        "--cache-dir",
        str(tmp_path),
        "--config-file",
        os.devnull,
        "program.py",
    )
    environment = os.environ | {"MYPYPATH": str(ROOT / "backend")}
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *words],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
