"""What holds for every test: which engine the store is on, how much is tried, cheap hashes, no stopwatch on properties."""

import gc
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from xdist.scheduler import LoadScopeScheduling

from boresight.platform.db.sessions import Engine
from boresight.sky.catalogue import Catalogue, load_catalogue
from tests import effort, stores
from tests import postgresql as postgresql_programs
from tests.passwords import PRODUCT, use_hasher

# What a test writes need not survive it, and so waits for no disk where the memory has room for it.
MEMORY, ROOM_BYTES = "/dev/shm", 8 * 2**30  # noqa: S108 - pytest makes a folder of its own in it
if os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > ROOM_BYTES:
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", MEMORY)

gc.disable()  # until the tests are collected: what is collected stays, and looking through it takes a third of the time

# The first example of a property may compile kernels; how long one takes says nothing about it. The suite tries the same
# examples every time, so that a failure always is somebody's change; `make search` looks for new ones.
hypothesis.settings.register_profile("house", hypothesis.settings(), deadline=None, derandomize=True, max_examples=25)
hypothesis.settings.register_profile("full", hypothesis.settings(), deadline=None, derandomize=True)
hypothesis.settings.register_profile("search", hypothesis.settings(), deadline=None, max_examples=2000)
_numbers = count(1)
TESTS = Path(__file__).parent
OF_RUNS = (  # need a set that was promoted, or a filter that was watched, which takes a minute to come to
    "test_every_page.py", "test_figures.py", "test_first_start.py", "test_operators_checklist.py", "test_paper.py",
    "test_refused_approval.py", "test_run_page.py", "test_same_numbers.py",
)  # fmt: skip
OF_THE_SITE = ("tests/browser/test_documentation_pages.py", "tests/test_documentation_site.py")
# So that the helpers of tests say what differs, as the tests do.
pytest.register_assert_rewrite(*(f"tests.{folder.name}" for folder in TESTS.iterdir() if folder.is_dir()))
FIRST = ("browser", "workers", "test_new_things.py", "benchmarks", "transitions", "test_wheel.py")  # takes longest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full", action="store_true", help="run the tests marked `full` too, and all with many examples")
    words = "the engine that stores are on; PostgreSQL is started for the tests"
    parser.addoption("--store", choices=("sqlite", "postgresql"), default="sqlite", help=words)


def pytest_configure(config: pytest.Config) -> None:
    stores.choose(config.getoption("--store"))
    effort.choose(full=config.getoption("--full"))
    hypothesis.settings.load_profile("full" if config.getoption("--full") else "house")


@pytest.fixture(autouse=True, scope="session")
def cheap_hashes() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        use_hasher(patch)
        yield


@pytest.fixture
def product_hashes(monkeypatch: pytest.MonkeyPatch) -> None:
    use_hasher(monkeypatch, PRODUCT)


class ByFile(LoadScopeScheduling):
    """A file in one process; those of the browser in two, each with one installation, and those that need the built site."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        if file in OF_THE_SITE:
            return "the documentation's site"
        if file.startswith("tests/browser/"):
            return "tests/browser: of runs" if Path(file).name in OF_RUNS else "tests/browser"
        return file


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByFile:
    config.option.loadscopereorder = False
    return ByFile(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    place = {name: number for number, name in enumerate(FIRST)}
    items.sort(key=lambda item: place.get(item.path.relative_to(TESTS).parts[0], len(FIRST)))
    if not config.getoption("--full"):
        slow = pytest.mark.skip(reason="takes its time; run it with --full")
        for item in (*(item for item in items if "full" in item.keywords), *effort.beyond_few(items)):
            item.add_marker(slow)
    for item in items:
        about = item.get_closest_marker("sqlite")
        if about is not None and stores.on_postgresql():
            item.add_marker(pytest.mark.skip(reason=f"about SQLite itself: {about.args[0]}"))


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Iterator[None]:
    folder: Path | None = getattr(item, "funcargs", {}).get("tmp_path")
    yield
    if folder is not None:
        stores.drop_under(folder)


def pytest_sessionfinish() -> None:
    postgresql_programs.remove_server()


@pytest.fixture(scope="session")
def catalogue_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sky") / "catalogue"


@pytest.fixture(scope="session")
def catalogue(catalogue_folder: Path) -> Catalogue:
    return load_catalogue(catalogue_folder)


@pytest.fixture(scope="session")
def deep_catalogue() -> Catalogue:
    return load_catalogue(None, magnitude_limit=12.0)


@pytest.fixture(scope="session")
def built_site(tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config) -> Path:
    """The site; its notebooks are executed under --full, and by `tests/library/test_documentation.py` always."""
    place = tmp_path_factory.mktemp("documentation")
    options = () if pytestconfig.getoption("--full") else ("-D", "execute_notebooks=0")
    words = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", "--keep-going", *options]
    done = subprocess.run(
        [*words, "-d", str(place / "doctrees"), str(TESTS.parent / "docs"), str(place / "site")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return place / "site"


@pytest.fixture(scope="session")
def real_sky() -> Path:
    beside = TESTS.parents[1] / "shared/data/real-sky"
    folder = Path(os.environ.get("BORESIGHT_REAL_SKY", beside))
    if not folder.is_dir():
        pytest.skip("the real star fields are not here; BORESIGHT_REAL_SKY says where they are")
    return folder


@pytest.fixture
def postgresql() -> Iterator[Engine]:
    with stores.own("postgresql", Path(f"of-a-test-{next(_numbers)}")) as engine:
        yield engine


@pytest.fixture
def sqlite(tmp_path: Path) -> Iterator[Engine]:
    with stores.own("sqlite", tmp_path) as engine:
        yield engine
