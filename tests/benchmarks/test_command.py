"""`python -m benchmarks`: parts by name, their sizes, one document of several, promises in words; a measurement is no test."""

import subprocess
import sys
import types

import orjson
import pytest
from click.testing import CliRunner

import benchmarks.__main__ as command
from benchmarks import PARTS, ROOT, Part, held, limits_of

LIMITS = {
    "fast enough": held(2.0, 1.5, "s"),
    "faster on two": held(1.6, 1.2, at_least=True),
    "not tried": held(1.0, None),
}


@pytest.fixture
def run(monkeypatch):
    def measure(report, frames=7, seconds=1.0):
        report(0.5, "half way")
        return {"frames": frames, "seconds": seconds, "rows": [{"name": "first", "us": 3.25}], "limits": LIMITS}

    module = types.ModuleType("plain")
    module.measure = measure
    monkeypatch.setitem(sys.modules, "benchmarks.plain", module)
    monkeypatch.setitem(PARTS, "kernels", Part("plain:measure", "nothing"))
    return lambda *words: CliRunner().invoke(command.bench, words)


def test_a_part_s_figures_stand_under_its_name_beside_the_machine_and_the_promises(run):
    found = orjson.loads(run("--part", "kernels", "--size", "kernels.seconds=0.25", "--json", "-").stdout)
    assert set(found) == {"machine", "kernels", "limits"}
    assert (found["kernels"]["frames"], found["kernels"]["seconds"]) == (7, 0.25)
    assert found["limits"]["kernels.fast enough"] == LIMITS["fast enough"]
    assert found["machine"]["cores"] >= 1
    assert {"python", "numpy", "scipy", "numba", "sqlite"} <= set(found["machine"]["versions"])


def test_a_promise_that_is_not_kept_is_said_and_is_no_failure(run):
    done = run("--part", "kernels")
    assert done.exit_code == 0
    verdicts = {line.split("  ")[0]: line.split("  ")[-1].strip() for line in done.stdout.splitlines()}
    assert verdicts["kernels.fast enough"] == "kept"
    assert verdicts["kernels.faster on two"] == "**not kept**"
    assert verdicts["kernels.not tried"] == "not measured"


def test_without_a_part_the_document_is_that_of_the_loops_alone(run):
    assert orjson.loads(run("--frames", "20", "--json", "-").stdout)["frames"] == 20


@pytest.mark.parametrize(
    "word", ["frames=3", "nothing.frames=3", "kernels.frames", "kernels.frames=many", "kernels.weight=3"]
)
def test_a_size_that_there_is_not_or_that_cannot_be_read_is_refused(run, word):
    refused = run("--size", word)
    assert refused.exit_code == 2
    assert word.partition("=")[0].removeprefix("kernels.") in refused.stderr


def test_several_parts_run_each_in_a_process_of_its_own_and_one_that_fails_takes_no_other_with_it(run, monkeypatch):
    told = []

    def process(words):
        told.append(words)
        if "kernels" in words:
            answer = words[words.index("--json") + 1]
            command.write_json({"kernels": {"frames": 50, "limits": {}}}, answer)
        return "kernels" not in words

    monkeypatch.setattr(command, "run", process)
    done = run("--part", "kernels", "--part", "accuracy", "--frames", "50", "--size", "accuracy.sets=2", "--json", "-")
    found = orjson.loads(done.stdout)

    assert found["kernels"] == {"frames": 50, "limits": {}}
    assert "exit code True" in found["accuracy"]["failed"]
    assert told[1][-4:] == ["--frames", "50", "--size", "accuracy.sets=2"]


@pytest.mark.parametrize("name", PARTS)
def test_every_part_has_a_measurement_that_reports_and_whose_sizes_have_defaults(name):
    assert all(default is not None or key == "peers" for key, default in PARTS[name].sizes.items())
    assert limits_of({name: {"limits": LIMITS}}).keys() == {f"{name}.{limit}" for limit in LIMITS}


def test_the_command_is_there_in_a_checkout_and_gone_from_the_product():
    words = [sys.executable, "-m", "benchmarks", "--help"]
    helped = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    gone = subprocess.run([sys.executable, "-m", "boresight", "bench"], cwd=ROOT, capture_output=True, check=False)
    assert all(option in helped.stdout for option in ("--part", "--frames", "--size", "--json"))
    assert gone.returncode == 2
