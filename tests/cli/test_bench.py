"""`boresight bench`: parts by name, their sizes, one document of several, promises in words; a measurement is no test."""

import sys
import types

import orjson
import pytest

from boresight import measurements
from boresight.measurements import Part

LIMITS = {
    "fast enough": {"limit": 2.0, "measured": 1.5, "kept": True, "unit": "s"},
    "faster on two": {"limit": 1.6, "measured": 1.2, "kept": False, "at_least": True},
    "not tried": {"limit": 1.0, "measured": None, "kept": None},
}


@pytest.fixture
def plain_part(monkeypatch):
    """Put a part into the registry that costs nothing."""

    def measure(report, frames=7, seconds=1.0):
        report(0.5, "half way")
        return {"frames": frames, "seconds": seconds, "rows": [{"name": "first", "us": 3.25}], "limits": LIMITS}

    module = types.ModuleType("plain_part")
    module.measure = measure
    monkeypatch.setitem(sys.modules, "plain_part", module)
    # the choices of --part are those of the kernels part's name while the test runs
    monkeypatch.setitem(measurements.PARTS, "kernels", Part("plain_part", "nothing"))


@pytest.mark.usefixtures("plain_part")
def test_a_part_s_figures_stand_under_its_name_beside_the_machine_and_the_promises(boresight):
    done = boresight("bench", "--part", "kernels", "--json", "-")
    found = orjson.loads(done.stdout)

    assert set(found) == {"machine", "kernels", "limits"}
    assert found["kernels"]["frames"] == 7
    assert found["limits"]["kernels.fast enough"] == LIMITS["fast enough"]


@pytest.mark.usefixtures("plain_part")
def test_a_promise_that_is_not_kept_is_said_in_words_and_is_no_failure(boresight):
    done = boresight("bench", "--part", "kernels")

    assert done.exit_code == 0
    lines = {line.split("  ")[0]: line for line in done.stdout.splitlines()}
    assert lines["kernels.fast enough"].endswith("at most 2 s       1.5          kept")
    assert "at least 1.6" in lines["kernels.faster on two"]
    assert lines["kernels.faster on two"].endswith("NOT KEPT")
    assert lines["kernels.not tried"].endswith("not measured")


@pytest.mark.usefixtures("plain_part")
def test_without_a_part_the_document_is_that_of_the_loops_alone(boresight):
    found = orjson.loads(boresight("bench", "--frames", "20", "--json", "-").stdout)

    assert "machine" not in found
    assert found["frames"] == 20


@pytest.mark.usefixtures("plain_part")
def test_sizes_reach_their_part_and_an_unknown_one_is_refused_with_those_there_are(boresight):
    done = boresight("bench", "--part", "kernels", "--size", "kernels.seconds=0.25", "--json", "-")
    assert orjson.loads(done.stdout)["kernels"]["seconds"] == 0.25

    refused = boresight("bench", "--part", "kernels", "--size", "kernels.weight=3")
    assert refused.exit_code == 2
    assert "kernels has no size weight; it has frames, seconds." in refused.stderr


@pytest.mark.parametrize("word", ["frames=3", "nothing.frames=3", "kernels.frames", "kernels.frames=many"])
def test_a_size_that_cannot_be_read_is_refused(boresight, word):
    refused = boresight("bench", "--size", word)

    assert refused.exit_code == 2
    assert word.partition("=")[2] in refused.stderr


@pytest.fixture
def other_interpreter(tmp_path, monkeypatch):
    """Stand for the processes of several parts: one measures, the other ends with an error; returns what they were told."""
    told = tmp_path / "told"
    program = tmp_path / "python"
    program.write_text(
        f"""#!/bin/sh
echo "$*" >> {told}
while [ "$1" != --json ]; do test "$1" = --part && part=$2; shift; done
test $part = kernels && echo '{{"kernels": {{"frames": 50, "limits": {{}}}}}}' > $2
"""
    )
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    return told


def test_several_parts_run_each_in_a_process_of_its_own_and_one_that_fails_takes_no_other_with_it(
    boresight, other_interpreter
):
    words = ("--part", "kernels", "--part", "accuracy", "--frames", "50", "--size", "accuracy.sets=2")
    done = boresight("bench", *words, "--json", "-")
    found = orjson.loads(done.stdout)

    assert done.exit_code == 0
    assert found["kernels"] == {"frames": 50, "limits": {}}
    assert "exit code 1" in found["accuracy"]["failed"]
    first, second = other_interpreter.read_text().splitlines()
    assert first.startswith("-m boresight bench --part kernels ")
    assert second.endswith("--frames 50 --size accuracy.sets=2")
