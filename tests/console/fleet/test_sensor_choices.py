"""Choosing a sensor: a small fleet whole, of a large one what is sought and what is kept."""

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.console.fleet import queries as sensor_queries
from boresight.console.fleet import service as sensors
from boresight.console.fleet.service import MOST_CHOICES
from boresight.console.fleet.tables import Sensor
from boresight.errors import RefusedInputError
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_now
from tests.stores import open_migrated, url_in

FLEET = [f"{orbit}_{plane}.{number:03d}" for orbit in ("GEO", "leo") for plane in "ab" for number in range(130)]
SOUGHT = st.one_of(
    st.text(alphabet="GEOgeolLab_.0123456789%*[]\\/'\" -", max_size=6), st.sampled_from(FLEET), st.just("x" * 400)
)


def _add(session: Session, names: list[str]) -> None:
    session.add_all(Sensor(name=name, document={"name": name}, created_utc=utc_now()) for name in names)
    audit.append(session, COMMAND_LINE, "brought in", "sensors")


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Engine]:
    engine = open_migrated(url_in(tmp_path_factory.mktemp("large")))
    with open_writing(engine) as session:
        _add(session, FLEET)
    yield engine
    engine.dispose()


def _fitting(find: str) -> list[str]:
    return sorted(name for name in FLEET if find.strip()[:64].lower() in name.lower())


def test_a_fleet_that_can_be_looked_over_is_offered_whole_whatever_is_sought(session: Session) -> None:
    _add(session, [f"A{number}" for number in range(MOST_CHOICES - 1)])
    found = sensors.choices(session, find="no such", keep=[1])
    assert found.is_all
    assert list(found.names.values()) == sorted(found.names.values())
    assert len(found.names) == found.found == found.fitting == found.fleet == MOST_CHOICES


def test_one_sensor_more_makes_a_fleet_large(session: Session) -> None:
    _add(session, [f"A{number}" for number in range(MOST_CHOICES)])
    found = sensors.choices(session)
    assert not found.is_all
    assert (len(found.names), found.fitting) == (MOST_CHOICES, MOST_CHOICES + 1)


@given(find=SOUGHT, keep=st.sets(st.one_of(st.integers(1, 3 * len(FLEET)), st.integers()), max_size=8))
def test_of_a_large_fleet_the_first_that_hold_the_text_are_offered_and_what_is_kept(
    large: Engine, find: str, keep: set[int]
) -> None:
    with open_reading(large) as session:
        found = sensors.choices(session, find=find, keep=keep)
        every = sensor_queries.names(session)
    fitting = _fitting(find)
    kept = sorted({every[number] for number in keep if number in every} - set(fitting[:MOST_CHOICES]))
    assert not found.is_all
    assert (found.fitting, found.fleet) == (len(fitting), len(FLEET))
    assert found.found == min(len(fitting), MOST_CHOICES)
    assert list(found.names.values()) == kept + fitting[:MOST_CHOICES]
    assert all(every[number] == name for number, name in found.names.items())


@given(ids=st.sets(st.one_of(st.integers(1, 3 * len(FLEET)), st.integers()), max_size=12))
def test_names_are_those_of_the_numbers_that_there_are(large: Engine, ids: set[int]) -> None:
    with open_reading(large) as session:
        every = sensor_queries.names(session)
        assert sensor_queries.names(session, ids) == {number: every[number] for number in ids if number in every}
    assert sorted(every.values()) == sorted(FLEET)


def test_a_control_character_in_what_is_sought_is_refused_with_its_place(large: Engine) -> None:
    with (
        open_reading(large) as session,
        pytest.raises(RefusedInputError, match=r"find has the control character U\+0000"),
    ):
        sensors.choices(session, find="GE\x00O")
