"""Databases to act on: that of the engine the tests run on, and a SQLite file for what is said of both engines."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from boresight.platform.db.sessions import Engine
from tests.served import house
from tests.stores import open_migrated, url_in

__all__ = ["house"]


@pytest.fixture
def url(tmp_path: Path) -> str:
    return url_in(tmp_path)


@pytest.fixture
def engine(url: str) -> Iterator[Engine]:
    engine = open_migrated(url)
    yield engine
    engine.dispose()
