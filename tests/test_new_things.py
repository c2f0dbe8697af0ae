"""A new camera model, chart, gate, finding, route and page, each added as README says: in a copy of the tree made of links.

What README promises of each is then asked of the copy in a process of its own: the registry, the pages, the report, the commands,
the API's document, and who is let in. The quick form asks the registries alone, and compiles nothing.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from numba.core.caching import UserProvidedCacheLocator

from boresight.cameras import CAMERA_MODELS
from boresight.kernels import compilation

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
PACKAGE = "backend/boresight"

# What each new thing is: files of its own, and lines set before others that are there.
NEW = {
    f"{PACKAGE}/cameras/dummy_lens.py": """
from typing import Annotated, NamedTuple
from boresight.cameras.model import CameraModel, Equations, Parameter, Role

class DummyLens(NamedTuple):
    column: Annotated[float, Parameter(Role.COLUMN, "c", "px", 10.0, -1e5, 1e5)]
    shear: Annotated[float, Parameter(Role.TILT, "w", "1", 1e-3, -1.0, 1.0)]
    focal_px: Annotated[float, Parameter(Role.FOCAL, "F", "px", 10.0, 10.0, 1e6)]
    row: Annotated[float, Parameter(Role.ROW, "r", "px", 10.0, -1e5, 1e5)]
    division: Annotated[float, Parameter(Role.RADIAL, "d", "1", 1e-2, -100.0, 100.0)]

def star(x, pitch, row_px, col_px):
    c, w, F, r, d = x
    p, q = (row_px - r) / F, (col_px - c) / F
    R2 = p * p + q * q
    i = 1.0 / (1.0 + d * R2)
    a, b = i * p, i * q
    pp, pq, qq = i - 2.0 * d * a * a, -2.0 * d * a * b, i - 2.0 * d * b * b
    da = (-pq / F, 0.0, -(pp * p + pq * q) / F, -pp / F, -i * R2 * a)
    db = (-qq / F, 0.0, -(pq * p + qq * q) / F, -pq / F, -i * R2 * b)
    return a, b + w * a, da, (db[0] + w * da[0], a, db[2] + w * da[2], db[3] + w * da[3], db[4] + w * da[4])

DUMMY_LENS = CameraModel(
    "dummy_lens", DummyLens, star, Equations("from a position to a direction", "nowhere", ("t_x = p / (1 + d R^2)",), "solve")
)
""",
    f"{PACKAGE}/figures/charts/dummy_chart.py": """
import plotly.graph_objects as go
from boresight.figures.style import theme
from boresight.figures.factory import make_figure

def draw(drawn):
    figure = go.Figure([go.Bar(x=["frames"], y=[frames], name=style.label) for _, style, frames in drawn])
    return theme.dress(figure, title="How many frames", height_px=300)

DUMMY_CHART = make_figure(
    draw, lambda frames: {"frames": [frames]}, lambda result: result.frames or None, lambda _: "No frame is counted yet.",
    name="dummy-chart", title="Dummy chart", guide="One bar a run; a taller one has more frames.",
)
""",
    f"{PACKAGE}/telemetry/quality/findings/dummies.py": """
from boresight.telemetry.quality.inputs import Finding
from boresight.telemetry.quality.inputs import QualityInputs

def looked_at(inputs: QualityInputs) -> Finding | None:
    return Finding("DUMMY", "NORMAL", "Every row was looked at.", len(inputs.telemetry))
""",
    f"{PACKAGE}/console/dummies/__init__.py": "",
    f"{PACKAGE}/console/dummies/routes.py": """
from pydantic import BaseModel
from boresight.console.access.dependencies import Who, Writing
from boresight.console.operation import operations

router = operations("/dummies", tags=["dummies"])

class Dummy(BaseModel):
    id: int
    made_by: str

class NewDummy(BaseModel):
    id: int

@router.get("/{dummy_id}", summary="Read a dummy", response_model=Dummy)
def get_dummy(dummy_id: int, actor: Who) -> dict[str, object]:
    return {"id": dummy_id, "made_by": actor.name}

@router.post("", summary="Make a dummy", status_code=201, response_model=Dummy)
def make_dummy(new: NewDummy, actor: Who, session: Writing) -> dict[str, object]:
    return {"id": new.id, "made_by": actor.name}
""",
    f"{PACKAGE}/console/dummies/pages.py": """
from fastapi import Request
from fastapi.responses import HTMLResponse
from boresight.console.access.dependencies import Who
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import render
from boresight.errors import NotFoundError

router = PageRouter()

@router.get("/dummies/{dummy_id}", response_class=HTMLResponse)
def dummy_page(request: Request, actor: Who, dummy_id: int) -> HTMLResponse:
    if dummy_id != 1:
        raise NotFoundError(f"There is no dummy {dummy_id}.")
    return render(request, "dummies/dummy.html", dummy_id=dummy_id)
""",
    "frontend/templates/dummies/dummy.html": """{% extends "shared/frame.html" %}
{% block title %}Dummy{% endblock %}
{% block content %}<h1>Dummy {{ dummy_id }}</h1>{% endblock %}
""",
}
LINES = {
    f"{PACKAGE}/figures/charts/__init__.py": (
        ("\nCHAPTERS:", "from boresight.figures.charts.dummy_chart import DUMMY_CHART\n"),
        ("CONVERGENCE, SMOOTHED, METHODS)", "DUMMY_CHART, "),
    ),
    f"{PACKAGE}/verdicts/gates/measurements.py": (
        (
            "@dataclass(frozen=True)\nclass Gate:",
            """def dummy(inputs: GateInputs) -> Measurement:
    return Measurement(float(len(inputs.names)), "So many parameters.")


""",
        ),
        (
            '        Gate(\n            "coverage"',
            '        Gate("dummy-gate", "Dummy gate", "How many parameters are there?", "below", measure=dummy, limit=99.0),\n',
        ),
    ),
    f"{PACKAGE}/telemetry/quality/findings/__init__.py": (
        ("\nFINDINGS:", "from boresight.telemetry.quality.findings import dummies\n"),
        (")\n\n__all__", "    dummies.looked_at,\n"),
    ),
    f"{PACKAGE}/console/routes.py": (
        ("\nNOUNS = (", "from boresight.console.dummies import routes as dummies\n"),
        ("    fleet,\n", "    dummies,\n"),
    ),
    f"{PACKAGE}/console/pages/frame.py": (
        ('            NavigationLine("/audit"', '            NavigationLine("/dummies/1", "Dummies", "d"),\n'),
    ),
}


def copied(place: Path) -> Path:
    """Lay the package and the templates out again as links; what reads its own place, and what gets a line, is a file."""
    for top in (PACKAGE, "frontend/templates"):
        for path in (ROOT / top).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                link = place / path.relative_to(ROOT)
                link.parent.mkdir(parents=True, exist_ok=True)
                link.symlink_to(path)
    for path in (
        *(ROOT / "frontend").iterdir(),
        *(ROOT / top for top in ("migrations", "docs", "tests", "benchmarks")),
    ):
        if path.name != "templates":
            (place / path.relative_to(ROOT)).symlink_to(path)
    for name in (f"{PACKAGE}/resources.py", *LINES):
        text = (ROOT / name).read_text()
        for before, line in LINES.get(name, ()):
            assert text.count(before) == 1, (name, before)
            text = text.replace(before, line + before)
        (place / name).unlink()
        (place / name).write_text(text)
    for name, text in NEW.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(text)
    return place


def lend_compiled_loops(place: Path, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Keep the copy's loops in a folder of its own, with what the tree has: loops for other cameras are the same in both."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    ours = compiled_for(ROOT)
    monkeypatch.setattr(compilation, "__file__", str(place / PACKAGE / "kernels/compilation.py"))
    kept = Path(numba.config.CACHE_DIR) / ours
    if kept.is_dir():
        shutil.copytree(kept, folder / compilation.fingerprint() / compiled_for(place))


def compiled_for(place: Path) -> str:
    """Name the folder in which Numba keeps the loops of a tree."""
    return UserProvidedCacheLocator.get_suitable_cache_subpath(str(place / PACKAGE / "kernels/arclengths.py"))


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return copied(tmp_path_factory.mktemp("new-things"))


@pytest.fixture(scope="module")
def seen(place, tmp_path_factory):
    with pytest.MonkeyPatch.context() as monkeypatch:
        lend_compiled_loops(place, monkeypatch, tmp_path_factory.mktemp("loops"))
        return ask(place, tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def registered(place, tmp_path_factory):
    return ask(place, tmp_path_factory.mktemp("registries"), "--registries")


def ask(place, data, *only):
    path = os.pathsep.join((str(place / "backend"), str(place)))
    told = subprocess.run(
        [sys.executable, "-m", "tests.new_things", str(data), *only],
        cwd=place,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stderr[-3000:]
    return json.loads(told.stdout)


def row(thing):
    """Return what README says of a new thing: its files, and what comes with it."""
    (found,) = re.findall(rf"^\| {thing} \| (.*) \| (.*) \|$", README, re.MULTILINE)
    return found


def names_files(thing, *paths):
    files = row(thing)[0]
    return all(path in files for path in paths)


def test_each_new_thing_is_registered_by_the_files_that_readme_names_and_no_loop_is_compiled_for_it(registered):
    assert names_files("camera model", "`cameras/<name>.py`")
    assert names_files("chart", "`figures/charts/<name>.py`", "`CHAPTERS`")
    assert names_files("gate", "`verdicts/gates/measurements.py`", "`GATES`")
    assert names_files("finding on telemetry", "`telemetry/quality/findings/`", "`FINDINGS`")
    assert names_files("route", "`console/<noun>/routes.py`", "`NOUNS`")
    assert names_files("page", "`console/<noun>/pages.py`", "`frontend/templates/<noun>/`", "`NAVIGATION`")
    assert registered == dict.fromkeys(("camera", "chart", "gate", "finding", "route", "page", "navigation"), True)


#: Who may name a camera model: the simulated sensors, and the papers that each derive one.
PRESETS = {
    "simulation/sensors.py", "papers/enright/drawings.py", "papers/wu/drawings.py", "papers/wu/estimators.py", "papers/wu/grid.py",
    "papers/wu/tables.py",
}  # fmt: skip


@pytest.mark.full
def test_a_camera_model_is_one_file(seen):
    assert names_files("camera model", "`cameras/<name>.py`")
    names = "|".join(CAMERA_MODELS)
    pattern = re.compile(rf"""["'](?:{names})["']|\bcameras[.](?:{names})\b|\b(?:{names.upper()})\b""")
    naming = set()
    for path in (ROOT / PACKAGE).rglob("*.py"):
        name = str(path.relative_to(ROOT / PACKAGE))
        if pattern.search(path.read_text()) and not name.startswith("cameras/"):
            naming.add(name)
    assert naming == PRESETS
    assert "dummy_lens" in seen["camera"]["registered"]
    assert seen["camera"]["sensor_read"] == "dummy_lens"
    assert seen["camera"]["sensor_registered"] == 201
    assert seen["camera"]["offered"]


@pytest.mark.full
def test_a_camera_of_one_file_is_simulated_fitted_converted_and_drawn_without_another_change(seen):
    lens = seen["camera"]
    assert lens["exit_codes"] == {"simulate": 0, "calibrate": 0, "convert": 0, "report": 0}, lens["printed"]
    assert lens["status"] == "converged"
    assert lens["free"] == ["column", "shear", "focal_px", "row", "division"]
    assert max(abs(z) for z in lens["errors_in_sigma"]) < 5
    assert lens["nees"] < 25.7  # exceeded once in 10,000 of five degrees of freedom
    assert lens["misfit_px"] == pytest.approx(
        5e-4 * 976, rel=0.1
    )  # the shear, at the rows farthest out, which the other has not
    assert set(lens["figures"].values()) == {200}
    assert all(lens["on"].values()), lens["on"]


@pytest.mark.full
def test_a_chart_is_one_file_and_a_line_and_is_drawn_everywhere(seen):
    assert names_files("chart", "`figures/charts/<name>.py`", "`CHAPTERS`")
    chart = seen["chart"]
    assert chart["registered"]
    assert chart["listed"] == {"name": "dummy-chart", "title": "Dummy chart"}
    assert chart["drawn"]["data"][0]["type"] == "bar"
    assert chart["csv"].split() == ["frames", "59"]
    assert all(chart["on"][page] for page in ("run page", "compare", "gallery", "report", "guide", "document")), chart[
        "on"
    ]


@pytest.mark.full
def test_a_gate_is_a_function_and_a_row_and_is_measured_judged_and_edited(seen):
    assert names_files("gate", "`verdicts/gates/measurements.py`", "`GATES`")
    gate = seen["gate"]
    assert gate["answer"] == {"status": "PASS", "value": 8.0, "limit": 99.0}
    assert gate["limited"]["status"] == "FAIL"
    assert all(gate["on"][place] for place in ("editor", "panel", "command")), gate["on"]


@pytest.mark.full
def test_a_finding_is_a_function_and_a_line_and_is_reported(seen):
    assert names_files("finding on telemetry", "`telemetry/quality/findings/`", "`FINDINGS`")
    assert seen["finding"]["report"] == {"code": "DUMMY", "severity": "NORMAL", "sentence": "Every row was looked at."}
    assert all(seen["finding"]["on"][place] for place in ("command", "rest", "page")), seen["finding"]["on"]


@pytest.mark.full
def test_a_route_is_documented_and_lets_in_whom_it_should(seen):
    assert names_files("route", "`console/<noun>/routes.py`", "`NOUNS`")
    route = seen["route"]
    assert route["documented"] == ["get", "post"]
    assert {"401", "422"} <= set(route["refusals"])
    assert {"idempotency-key", "validate_only"} <= {name.lower() for name in route["parameters"]}
    assert route["statuses"] == {
        "read by nobody": 401, "read by ada": 200, "made by nobody": 401, "made without the token": 403, "made by ada": 201,
        "made again": 201, "only tried": 200,
    }  # fmt: skip
    assert route["replayed"] == "true"
    assert route["tried"] == "true"


@pytest.mark.full
def test_a_page_has_its_frame_its_line_of_the_navigation_and_errors_as_pages(seen):
    assert names_files("page", "`console/<noun>/pages.py`", "`frontend/templates/<noun>/`", "`NAVIGATION`")
    page = seen["page"]
    assert page["statuses"] == {"to ada": 200, "to nobody": 303, "not there": 404}
    assert page["nobody_is_led_to"].startswith("/login")
    assert all(page["on"][place] for place in ("content", "frame", "navigation", "error")), page["on"]
