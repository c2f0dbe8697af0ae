"""Every part of the bench can be found, sized and described; the machine says what it is."""

import inspect
import pkgutil

import pytest

import boresight.measurements
from boresight.measurements import PARTS, limits_of, sizes_of
from boresight.measurements.machine import machine


@pytest.mark.parametrize("name", PARTS)
def test_every_part_has_a_measurement_that_reports_and_whose_sizes_have_defaults(name):
    parameters = inspect.signature(PARTS[name].measurement()).parameters

    assert "report" in parameters
    assert all(default is not inspect.Parameter.empty for default in sizes_of(name).values())
    assert PARTS[name].shows


def test_no_module_with_a_measurement_is_left_out_of_the_registry():
    listed = {part.module for part in PARTS.values()}
    modules = (
        f"boresight.measurements.{found.name}" for found in pkgutil.iter_modules(boresight.measurements.__path__)
    )
    measuring = {name for name in modules if _measures(name)}

    assert measuring <= listed


def _measures(name):
    source = inspect.getsource(__import__(name, fromlist=["measure"]))
    return "\ndef measure(" in source


def test_limits_of_several_parts_are_gathered_under_the_part_s_name():
    kept = {"limit": 2, "measured": 1, "kept": True}

    assert limits_of({"one": {"limits": {"time": kept}}, "other": {"failed": "why"}}) == {"one.time": kept}


def test_the_machine_names_its_processor_cores_versions_and_load():
    found = machine()

    assert found["processor"]
    assert found["cores"] >= 1
    assert len(found["load_average"]) == 3
    assert {"python", "numpy", "scipy", "numba", "sqlite"} <= set(found["versions"])
