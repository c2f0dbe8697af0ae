"""The wheel as a user gets it: built, installed where the checkout cannot be seen, and put to work.

The clean environment borrows the libraries of the one that runs the tests by a path file, so this does not prove that
the declared dependencies suffice; installing from `requirements.lock`, as `make demo` does, proves that.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import sysconfig
import venv
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest

import boresight
from benchmarks.servers import Server
from boresight.figures import FIGURES

ROOT = Path(__file__).resolve().parents[1]
START_S = 60


@dataclass(frozen=True)
class Installed:
    """An environment that holds the wheel, and an empty folder to work in."""

    bin: Path
    folder: Path

    @property
    def environment(self) -> dict[str, str]:
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("BORESIGHT_", "PYTHON"))}
        return {**kept, "BORESIGHT_DATA_FOLDER": str(self.folder / "data"), "BORESIGHT_WORKERS": "0"}

    def run(self, program: str, *arguments: str) -> str:
        done = subprocess.run(
            [self.bin / program, *arguments],
            cwd=self.folder, env=self.environment, check=False, capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


def _build(source: Path, folder: Path, *kinds: str, **more: Any) -> Path:
    environment = {**os.environ, "SOURCE_DATE_EPOCH": "1700000000"}
    build = [sys.executable, "-m", "build", *kinds, "--outdir", str(folder), str(source)]
    done = subprocess.run(build, env=environment, check=False, capture_output=True, text=True, **more)
    assert done.returncode == 0, done.stdout + done.stderr
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _build(ROOT, tmp_path_factory.mktemp("dist"), "--wheel")


@pytest.mark.full
def test_built_elsewhere_at_another_time_from_the_source_archive_it_is_the_same_wheel_byte_for_byte(wheel, tmp_path):
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False).stdout
    if not tracked:
        pytest.skip("only a checkout tells what belongs to the source: clone it with git")
    documentation = [path for path in (ROOT / "build" / "documentation").rglob("*") if path.is_file()]
    for name in (*filter(None, tracked.split("\0")), *(str(path.relative_to(ROOT)) for path in documentation)):
        target = tmp_path / "elsewhere" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes((ROOT / name).read_bytes())  # with the times of now, and the rights of another person
    built = _build(tmp_path / "elsewhere", tmp_path / "dist", umask=0o077)
    assert built.name == wheel.name
    assert hashlib.sha256(built.read_bytes()).digest() == hashlib.sha256(wheel.read_bytes()).digest()


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    place = tmp_path_factory.mktemp("clean")
    venv.create(place / "venv", with_pip=False, symlinks=True)
    python = place / "venv" / "bin" / "python"
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", "--no-index", str(wheel)]
    subprocess.run(install, check=True, capture_output=True)
    asked = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    # A path file inside a borrowed folder is not read, so an editable install there stays unseen.
    Path(asked.stdout.strip(), "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    (place / "work").mkdir()
    return Installed(place / "venv" / "bin", place / "work")


@pytest.fixture(scope="module")
def address(installed: Installed) -> Iterator[str]:
    server = Server(installed.folder, installed.environment, command=[str(installed.bin / "boresight")])
    try:
        server.wait_until_ready("/healthz")
        yield server.address
    finally:
        server.stop()


def _members(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def test_the_wheel_carries_every_file_of_the_pages_and_every_migration(wheel):
    expected = {"boresight/docs/glossary.md"} | {
        f"boresight/{path.relative_to(ROOT).as_posix()}"
        for folder in ("frontend/static", "frontend/templates", "migrations")
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and not path.name.startswith(".") and "__pycache__" not in path.parts
    }

    assert expected - _members(wheel) == set()


def test_the_wheel_carries_every_file_of_the_package(wheel):
    package = ROOT / "backend" / "boresight"
    expected = {
        path.relative_to(package.parent).as_posix()
        for path in package.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }

    assert expected - _members(wheel) == set()


def test_the_wheel_carries_the_licence_and_nothing_beside_the_package(wheel):
    information = f"boresight-{boresight.__version__}.dist-info"

    members = _members(wheel)

    assert f"{information}/licenses/LICENSE" in members
    assert {name.partition("/")[0] for name in members} == {"boresight", information}


def test_the_installed_package_is_the_wheel_and_not_the_checkout(installed):
    place = installed.run("python", "-c", "import boresight; print(boresight.__file__)")

    assert Path(place.strip()).is_relative_to(installed.bin.parent)


def test_the_installed_command_helps_and_tells_its_version(installed):
    assert "calibrate" in installed.run("boresight", "--help")
    assert boresight.__version__ in installed.run("boresight", "--version")


@pytest.mark.full
def test_migrations_run_from_the_wheel_up_and_down(installed):
    up = installed.run("boresight", "migrate")
    down = installed.run("boresight", "migrate", "--down", "base")

    assert re.fullmatch(r"schema empty -> \S+\n", up)
    assert down.endswith("-> empty\n")


def test_figures_come_from_the_wheel(installed):
    names = installed.run("python", "-c", "from boresight.figures import FIGURES; print(*FIGURES)")

    assert names.split() == list(FIGURES)


@pytest.mark.full
@pytest.mark.parametrize(
    ("path", "kind", "least_bytes"),
    [
        ("/login", "text/html", 500),
        ("/static/shared/style.css", "text/css", 500),
        ("/static/plotly.min.js", "text/javascript", 1_000_000),
        ("/healthz", "application/json", 2),
        ("/api/v1/openapi.json", "application/json", 10_000),
    ],
)
def test_the_server_of_the_wheel_answers(address, path, kind, least_bytes):
    answer = httpx.get(address + path, timeout=30, trust_env=False).raise_for_status()

    assert answer.headers["content-type"].partition(";")[0] == kind
    assert len(answer.content) >= least_bytes
