"""Pages of a small fleet and of a larger one: every page is asked for, and one of the larger fleet is not so much longer."""

from __future__ import annotations

from typing import Any

import pytest

from boresight.measurements.fleet_pages import PAGES, measure
from boresight.measurements.full_store import add_sensors, fill, settings_in
from boresight.services import audit, fleet
from boresight.store.sessions import open_engine, reading

SMALL, LARGE = 3, 260
LONGEST_KB = 300.0


@pytest.fixture(scope="module")
def found() -> dict[str, Any]:
    """Measure two fleets."""
    return measure(lambda *_: None, sensors=(SMALL, LARGE), runs_each=1, looks=1)


def test_every_page_of_every_fleet_is_measured(found: dict[str, Any]) -> None:
    for size in (SMALL, LARGE):
        pages = found["fleets"][str(size)]["pages"]
        assert set(pages) == set(PAGES)
        assert all(0 < page["median_ms"] <= page["longest_ms"] for page in pages.values())
        assert found["fleets"][str(size)]["first_page_s"] > 0


def test_no_page_of_a_large_fleet_names_every_sensor(found: dict[str, Any]) -> None:
    for path, page in found["fleets"][str(LARGE)]["pages"].items():
        assert page["kb"] < LONGEST_KB, path


def test_a_filled_fleet_verifies_as_any_other_store_does(tmp_path: Any) -> None:
    filled = fill(tmp_path, 2, 1)
    add_sensors(tmp_path, filled, 5, 2)
    engine = open_engine(settings_in(tmp_path).database_url)
    with reading(engine) as session:
        assert [one.name for one in fleet.standings(session)][:-1] == [f"ST-{number:05d}" for number in range(1, 5)]
        assert audit.verify(session).ok
    engine.dispose()
