"""Sensors: registering one makes its baseline; what it is for life does not change."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import pytest

from boresight.console.fleet import queries as sensor_queries
from boresight.console.fleet import service as sensors
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets import service as parameter_sets
from boresight.errors import (
    ConflictError,
    ForbiddenError,
    NotFoundError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
)
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Engine, Session, open_writing

People = Mapping[str, Actor]


@pytest.fixture
def document(session: Session) -> dict[str, Any]:
    return deepcopy(sensors.get_sensor(session, 1).document)


def test_a_new_sensor_has_its_ground_calibration_as_baseline(session: Session, document: dict[str, Any]) -> None:
    ground = set_queries.baseline(session, 1)
    assert ground is not None
    assert (ground.name, ground.number, ground.run_id) == ("PS-ST16-1-0", 0, None)
    assert ground.document["parameters"] == document["initial"]
    assert ground.document["sigma"] == document["typical_sigma"]
    assert ground.document["status"] == "ground calibration"
    assert "Declared, not measured" in ground.document["advice"][0]
    assert compute_sha256(ground.document) == ground.sha256


def test_its_declared_covariance_is_the_typical_spread_squared(session: Session, document: dict[str, Any]) -> None:
    ground = set_queries.baseline(session, 1)
    assert ground is not None
    names, matrix = ground.document["covariance"]["names"], ground.document["covariance"]["matrix"]
    for row, name in enumerate(names):
        for column in range(len(names)):
            expected = document["typical_sigma"][name] ** 2 if row == column else 0.0
            assert matrix[row][column] == pytest.approx(expected)


def test_a_second_sensor_of_the_name_is_refused(session: Session, people: People, document: dict[str, Any]) -> None:
    with pytest.raises(ConflictError, match="is a sensor ST16-1 already"):
        sensors.register_sensor(session, people["ana"], document)


@pytest.mark.parametrize("name", ["bo", "cy", "dee", "eve", "root"])
def test_analysts_and_administrators_register(
    session: Session, people: People, document: dict[str, Any], name: str
) -> None:
    document["name"] = "ST16-2"
    if people[name].roles & {"analyst", "administrator"}:
        assert sensors.register_sensor(session, people[name], document).name == "ST16-2"
    else:
        with pytest.raises(ForbiddenError, match="analyst or administrator"):
            sensors.register_sensor(session, people[name], document)


def test_a_bad_document_leaves_no_sensor_and_no_set(engine: Engine, people: People) -> None:
    with open_writing(engine) as session:
        bad = deepcopy(sensors.get_sensor(session, 1).document) | {"name": "ST16-2", "parity": 0}
    with pytest.raises(RefusedInputError), open_writing(engine) as session:
        sensors.register_sensor(session, people["ana"], bad)
    with open_writing(engine) as session:
        assert [row.name for row in sensor_queries.sensors(session)] == ["ST16-1"]
        assert len(parameter_sets.list_parameter_sets(session)) == 1


@pytest.mark.parametrize("name", ["../../etc", "a/b", "<b>", "x" * 65, "-x"])
def test_a_name_that_makes_no_file_name_is_refused(
    session: Session, people: People, document: dict[str, Any], name: str
) -> None:
    with pytest.raises(RefusedInputError, match="name"):
        sensors.register_sensor(session, people["ana"], document | {"name": name})


def test_an_edit_changes_what_runs_start_from_and_leaves_the_sets(
    session: Session, people: People, document: dict[str, Any]
) -> None:
    before = set_queries.baseline(session, 1)
    assert before is not None
    sha256 = before.sha256
    document["initial"]["f_m"] = 0.0161
    row = sensors.edit_sensor(session, people["ana"], 1, document, 1)
    assert (row.version, row.document["initial"]["f_m"]) == (2, 0.0161)
    assert set_queries.baseline(session, 1).sha256 == sha256  # type: ignore[union-attr]
    record = audit.last_change(session, "sensors/1")
    assert record is not None
    assert (record.before["initial"]["f_m"], record.after["initial"]["f_m"]) == (0.016, 0.0161)  # type: ignore[index]


@pytest.mark.parametrize("change", [{"name": "ST16-9"}, {"parity": -1}])
def test_what_a_sensor_keeps_for_life_is_not_edited(
    session: Session, people: People, document: dict[str, Any], change: dict[str, Any]
) -> None:
    with pytest.raises(RefusedInputError, match=f"The {next(iter(change))} of ST16-1 cannot change"):
        sensors.edit_sensor(session, people["ana"], 1, document | change, 1)


def test_two_editors_do_not_overwrite_one_another(session: Session, people: People, document: dict[str, Any]) -> None:
    with pytest.raises(PreconditionRequiredError):
        sensors.edit_sensor(session, people["ana"], 1, document, None)
    sensors.edit_sensor(session, people["ana"], 1, document, 1)
    with pytest.raises(StaleError, match="Ana edited it at"):
        sensors.edit_sensor(session, people["bo"], 1, document, 1)


def test_the_truth_of_a_simulated_sensor_is_kept(session: Session, people: People, document: dict[str, Any]) -> None:
    truth = {"f_m": 0.0161}
    row = sensors.register_sensor(session, people["ana"], document | {"name": "SIM"}, simulated=True, truth=truth)
    assert (row.simulated, row.truth) == (1, truth)


def test_a_sensor_that_is_not_there_is_not_found(session: Session) -> None:
    with pytest.raises(NotFoundError, match="no sensor 99"):
        sensors.get_sensor(session, 99)
