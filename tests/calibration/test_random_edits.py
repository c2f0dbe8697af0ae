"""Edited telemetry ends in a result or in a sentence: some and those that once did not, all two thousand with --full."""

import numpy as np
import pytest

from benchmarks import random_edits as edits
from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import METHODS, CalibrationSettings
from boresight.simulation.scenes import calibration_scenario, simulate
from tests.stores import environment_in

ALL, THROUGH_THE_DOOR = 2000, 4
ALWAYS = range(6)
#: Cases that once ended in neither.
ONCE_DEFECTS = (525, 700, 1182, 1312, 1688, 1791, 1883, 1886)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("edits")


@pytest.fixture(scope="module")
def bases(catalogue, folder):
    return edits.good_sets(catalogue, folder)


def defects(numbers, bases, catalogue, folder):
    found = []
    for number in numbers:
        case = edits.make_case(number, bases, folder)
        ended = edits.run(case, catalogue, folder / "catalogue")
        if ended.kind == "defect":
            found.append(f"{number} {case.names} {case.settings}\n{ended.words}")
    return found


@pytest.mark.full
def test_some_edits_end_in_a_result_or_a_sentence(bases, catalogue, folder):
    assert defects((*ALWAYS, *ONCE_DEFECTS), bases, catalogue, folder) == []


@pytest.mark.full
def test_two_thousand_edits_end_in_a_result_or_a_sentence(bases, catalogue, folder):
    assert defects(range(ALL), bases, catalogue, folder) == []


@pytest.mark.full
def test_edits_through_the_command_line_end_with_a_result_or_a_line(bases, folder, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(folder))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # the compiled loops stay where they are
    for name, value in environment_in(folder).items():
        monkeypatch.setenv(name, value)
    cases = [edits.make_case(number, bases, folder) for number in range(62, 62 + THROUGH_THE_DOOR)]
    assert [edits.through_the_door(case, folder / "sensor.json") for case in cases] == [None] * THROUGH_THE_DOOR


def test_a_case_is_the_same_whether_it_is_made_alone_or_among_others(bases, folder):
    first = edits.make_case(7, bases, folder)
    content = first.telemetry.read_bytes()
    edits.make_case(8, bases, folder)
    again = edits.make_case(7, bases, folder)
    assert (again.settings, again.sensor, again.names) == (first.settings, first.sensor, first.names)
    if again.telemetry.suffix == ".csv":
        assert again.telemetry.read_bytes() == content


@pytest.mark.parametrize("method", METHODS)
def test_an_identity_of_a_star_seen_nowhere_else_ends_in_a_result_with_advice(method, catalogue):
    scenario = calibration_scenario(4, 60)
    telemetry = simulate(scenario, np.random.default_rng(4), catalogue)
    telemetry.star_id[1000] = 32349
    found = calibrate(
        telemetry, scenario.sensor, catalogue, CalibrationSettings(method=method, match="given")
    ).to_dict()
    assert found["advice"]
    if found["status"] != "diverged":  # a filter that one star 90 degrees off carries away says so
        assert found["trust"]["stars"]
        assert 32349 in {one["star_id"] for one in found["removed"]}
