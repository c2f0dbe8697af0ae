"""State words and their levels."""

from types import SimpleNamespace

import pytest

from boresight.console.approvals.tables import APPROVAL_STATES
from boresight.console.pages.formats import LEVEL_OF_STATE, LEVELS, get_level, worst
from boresight.console.pages.frame import find_worst_status
from boresight.console.parameter_sets.tables import GROUND_STATES, ONBOARD_STATES
from boresight.console.runs.tables import RUN_STATES
from boresight.verdicts.verdict import LEVEL_OF_STATUS


@pytest.mark.parametrize("state", sorted({*RUN_STATES, *GROUND_STATES, *ONBOARD_STATES, *APPROVAL_STATES}))
def test_every_state_of_the_store_has_a_level(state):
    assert LEVEL_OF_STATE[state] in LEVELS


@pytest.mark.parametrize("state", ["CANCELLED", "REJECTED", "WITHDRAWN", "SUPERSEDED"])
def test_what_a_person_decided_is_never_an_alarm(state):
    assert get_level(state) == "off"


def test_how_a_calibration_ended_has_the_level_of_its_verdict():
    assert {status: get_level(status) for status in LEVEL_OF_STATUS} == LEVEL_OF_STATUS


def test_red_is_for_a_read_back_that_does_not_match():
    assert [state for state, level in LEVEL_OF_STATE.items() if level == "critical"] == ["MISMATCH"]


def test_a_level_stands_for_itself_in_any_case_and_an_unknown_word_is_off():
    assert (get_level("caution"), get_level("CAUTION"), get_level("never heard")) == ("caution", "caution", "off")


def test_the_worst_of_several_is_shown():
    assert worst(["SUCCEEDED", "MISMATCH", "FAILED"]) == "critical"
    assert worst([]) == "off"


def tile(name: str, status: str) -> SimpleNamespace:
    return SimpleNamespace(name=name, status=status, sentence=f"{name} is {status}.")


def test_the_fleet_stands_as_its_worst_sensor_and_names_it():
    standing = find_worst_status([tile("A", "normal"), tile("B", "serious"), tile("C", "serious")])
    assert (standing.level, standing.word) == ("serious", "SERIOUS")
    assert standing.sentence == "B: B is serious. 1 more alike."


def test_a_fleet_without_sensors_says_so():
    assert find_worst_status([]).word == "NO SENSORS"
