"""The benchmarks: a command of parts, the pages of their figures, and a small version of each that starts servers and processes."""

import copy
import subprocess
import sys
import types
from functools import partial

import numpy as np
import orjson
import pytest
from click.testing import CliRunner

import benchmarks.__main__ as command
from benchmarks import PARTS, ROOT, Part, clients, collect_limits, footprint, growth, held, queue, start, whole
from benchmarks.pages import __main__ as program
from benchmarks.pages import benchmarks, capacity
from benchmarks.pages.drawings import DOCS, growth_figure
from benchmarks.pages.tables import number
from benchmarks.servers import PostgreSQL, serving
from benchmarks.stars import CHUNK, write_synthetic
from benchmarks.stores import add_sensors, fill, opened
from boresight.console.fleet import status as fleet
from boresight.console.runs import service as runs
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading
from boresight.telemetry.readers import read_telemetry
from tests.effort import effort

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
    assert collect_limits({name: {"limits": LIMITS}}).keys() == {f"{name}.{limit}" for limit in LIMITS}


def test_the_command_is_there_in_a_checkout_and_gone_from_the_product():
    words = [sys.executable, "-m", "benchmarks", "--help"]
    helped = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    gone = subprocess.run([sys.executable, "-m", "boresight", "bench"], cwd=ROOT, capture_output=True, check=False)
    assert all(option in helped.stdout for option in ("--part", "--frames", "--size", "--json"))
    assert gone.returncode == 2


STORED = program.stored()
MACHINE = STORED["kernels"]["machine"]
LINE = {"worker_cpu_s": {"constant": 0.5, "per_frame": 1e-3}, "blob_bytes": {"constant": 5e4, "per_frame": 500.0}}


def test_the_stored_pages_are_what_the_stored_figures_give():
    for name, text in program.pages().items():
        assert (DOCS / name).read_text() == text, f"write {name} again with `python -m benchmarks.pages --write`"
    assert (DOCS / "benchmarks.json").stat().st_size < 200_000


def test_a_part_that_was_not_measured_is_said_to_be_so():
    page = benchmarks.page({})
    assert page.count("Not measured yet.") == len(PARTS)
    assert "`footprint` was not measured" in capacity.page({})


def test_promises_are_shown_with_their_limit_and_whether_they_were_kept():
    broken = {"limit": 1.5, "measured": 1.2, "kept": False, "at_least": True, "unit": "times", "why": "It ended."}
    page = benchmarks.page({"fresh": {"machine": MACHINE, "found": {"limits": {"two_threads": broken}}}})
    assert "| `fresh` | two threads | at least 1.50 times | 1.200 | **not kept**: It ended. |" in page


def test_the_chart_has_a_point_a_size_in_each_panel():
    chart = growth_figure(STORED)
    runs = STORED["growth"]["found"]["runs"]
    assert [(trace.name, len(trace.x)) for trace in chart.data] == [(m, len(runs[m])) for m in runs for _ in range(2)]


@pytest.fixture
def page():
    document = copy.deepcopy({name: STORED[name] for name in capacity.NEEDED})
    for database in document["footprint"]["found"]["databases"].values():
        database["launch"]["seconds"] = 0.005
        for method in database["run"].values():
            method["line"] = LINE
    document["queue"]["found"]["calm"] |= {"claims_per_run": 0.1, "settlements_per_run": 0.15}
    for crowd in ("page_while_writing", "list_while_writing"):
        document["clients"]["found"][crowd]["server_us_per_request"] = 6000.0
    return capacity.page(document)


def test_what_a_constellation_needs_follows_from_what_a_run_and_a_read_cost(page):
    assert "| 10,000 × 5.00 CPU s / 86,400 s / 0.5 | **1.16 cores** | a machine of workers: 16 cores | 0.072 |" in page
    assert "| machines of workers | 1.16 / 16 cores, rounded up | **1** |" in page
    assert f"× 1.25) / 86,400 s × 3 | **{35_000 / 86_400 * 3:.2f} transactions/s** |" in page
    assert "one transaction each: 200 transactions/s |" in page
    assert "**8.33 reads/s** | one Python process, 6.00 CPU ms each: 167 reads/s | 0.05 |" in page


def test_the_first_row_of_a_plan_is_the_resource_that_ends_first(page):
    for plan in page.split("### ")[1:]:
        rows = [line.split(" | ") for line in plan.splitlines() if line.count(" | ") == 6 and "---" not in line][1:]
        shares = [float(row[4]) for row in rows]
        assert len(rows) == 8
        assert shares == sorted(shares, reverse=True)
        assert rows[0][0].startswith("| **")


@pytest.mark.parametrize(
    ("value", "text"),
    [(1234.5, "1,230"), (0.012345, "0.0123"), (3, "3"), (None, "-"), (0.99999, "1.00"), (1e-7, "1.00e-07"), (float("inf"), "-")],
)  # fmt: skip
def test_numbers_have_three_digits(value, text):
    assert number(value) == text


def test_parts_that_are_taken_replace_those_stored_and_failed_ones_do_not(tmp_path, monkeypatch):
    monkeypatch.setattr(program, "STORED", tmp_path / "stored.json")
    file, long = tmp_path / "bench.json", list(range(1000))
    for part in ({"seconds": 1.23456789, "series": long}, {"failed": "no disk"}):
        file.write_bytes(orjson.dumps({"machine": MACHINE, "growth": part, "limits": {}}))
        program.take(file)
    assert program.stored() == {"growth": {"machine": MACHINE, "found": {"seconds": 1.2346}}}


@pytest.mark.full
def test_everybody_in_a_crowd_is_answered_and_every_listener_hears_every_event_once_and_in_order():
    found = clients.measure(lambda *_: None, runs=60, clients=8, seconds=0.2, listeners=40, changes=8)
    for name in clients.CROWDS:
        assert found[name]["failures"] == 0, found[name]
        assert found[name]["asked"] > 0, name
    assert found["list_unchanged"]["statuses"].get("304", 0) > 0
    feed = found["feed"]
    assert (feed["listening"], feed["events"]) >= (40, 4 * 8)
    faults = ("lost", "twice", "out_of_order", "not_theirs", "ended_by_the_server")
    assert {name: feed[name] for name in faults} == dict.fromkeys(faults, 0)
    assert found["limits"]["events_lost"]["kept"]


@pytest.mark.full
def test_no_page_of_a_large_fleet_names_every_sensor(monkeypatch):
    monkeypatch.setattr(clients, "serving", partial(serving, workers=0))
    sensors = effort(60, 260)
    found = clients.measure_fleet(lambda *_: None, sensors=(sensors,), runs_each=1, looks=1)["fleets"][str(sensors)]
    assert set(found["pages"]) == set(clients.FLEET_PAGES)
    for path, page in found["pages"].items():
        assert 0 < page["kb"] < 300, path


@pytest.mark.full
def test_a_store_that_was_filled_fast_verifies_as_any_other(tmp_path):
    add_sensors(tmp_path, fill(tmp_path, 30, 2), 5, 2)
    with opened(tmp_path) as engine, open_reading(engine) as session:
        assert [one.name for one in fleet.list_sensor_statuses(session)][:-1] == [
            f"ST-{number:05d}" for number in range(1, 5)
        ]
        assert audit.verify(session).ok


@pytest.mark.full
def test_what_one_more_thing_costs_is_its_rows_exactly_and_a_line_through_both_lengths(monkeypatch):
    monkeypatch.setattr(PostgreSQL, "installed", lambda: False)
    one = {"batch": footprint.METHODS["batch"]}
    monkeypatch.setattr(footprint, "METHODS", effort(one, footprint.METHODS))
    found = footprint.measure(lambda *_: None, frames=60, sensors=2, runs=1, launches=5)["databases"]["sqlite"]
    assert found["sensor"]["rows"]["sensors"] == found["launch"]["rows"]["runs"] == 1
    assert found["launch_in_bulk"]["rows"] == found["launch"]["rows"]
    short, long = found["set"].values()
    assert short["rows"] == long["rows"]
    assert long["blob_bytes"] > 4 * short["blob_bytes"]
    for method, cost in found["run"].items():
        for frames in (10, 60):
            line = cost["line"]["blob_bytes"]
            assert cost[str(frames)]["rows"]["runs"] == 1, method
            assert line["constant"] + line["per_frame"] * frames == pytest.approx(cost[str(frames)]["blob_bytes"])


def test_all_that_was_queued_for_the_clock_is_taken_away_however_many_pages_it_fills(tmp_path, monkeypatch):
    monkeypatch.setattr(footprint, "RUNS_AT_ONCE", 2)
    with footprint.Ledger.opened(tmp_path) as ledger:
        ledger.register(1)
        ledger.store(10)
        ledger.launch_only(5)
        ledger.cancel_all()
        with open_reading(ledger.engine) as session:
            assert runs.count_by_state(session)["QUEUED"] == 0


@pytest.mark.full
def test_an_undisturbed_run_is_computed_once_and_its_time_is_known(monkeypatch):
    monkeypatch.setattr(queue, "ALONE_RUNS", effort(1, 50))
    monkeypatch.setattr(queue, "THREADS", effort(1, 2))
    calm = queue.one_pass(lambda *_: None, 6, 12, 3, {})
    assert calm["attempts"] == {"1": 6}
    assert calm["not_as_promised"] == 0
    assert 0 < calm["computing_cpu_s"] <= 1.1 * calm["computing_s"]
    assert calm["overhead_ms_per_run"] == pytest.approx(
        (calm["wall_s"] * queue.THREADS - calm["computing_s"]) / 6 * 1e3
    )
    assert 0 < calm["claims_per_run"] <= 1


@pytest.mark.full
def test_every_step_of_a_whole_calibration_is_told_and_its_limit_is_judged_at_full_size_only(monkeypatch):
    monkeypatch.setattr(whole, "REPEATS", effort(1, whole.REPEATS))
    heard = []
    found = whole.measure(lambda *told: heard.append(told), frames=60, small_frames=20)
    for name in ("given", "small", "rematch"):
        assert found[name]["status"] == "converged"
        assert sum(found[name]["steps_s"].values()) == pytest.approx(found[name]["total_s"], rel=0.2)
    given = found["given"]
    assert 2 <= given["evaluations_of_one_weighing"] < given["evaluations"] <= 40
    if "c_fit_s" in given:
        assert given["over_c_fit"] == pytest.approx(given["total_s"] / given["c_evaluation_s"] / given["evaluations"])
    assert found["limits"]["over_c_fit"]["kept"] is None
    assert heard[-1] == (1.0, "done")


@pytest.mark.full
def test_each_size_is_calibrated_in_a_process_of_its_own(monkeypatch):
    monkeypatch.setattr(growth, "EMPTY_RUNS", 1)
    found = growth.measure(lambda *_: None, sizes=(60,), methods=("batch",), rematch_sizes=effort((), (24,)))
    (row,) = found["runs"]["batch"]
    assert (row["frames"], row["status"]) == (60, "converged")
    assert [(one["frames"], one["status"]) for one in found["rematch"]] == effort([], [(24, "converged")])
    assert 50 < row["peak_mb"] < 2000
    assert found["limits"]["batch_exponent_of_the_two_largest"]["measured"] is None


@pytest.mark.full
def test_the_first_calibration_is_counted_from_before_the_interpreter_starts():
    found = growth.measure_fresh(lambda *_: None, frames=60, repeats=1, uncompiled=False)
    assert found["first_s"] > found["warm_s"] > 0
    assert found["limits"]["fresh_over_warm"]["measured"] == pytest.approx(found["first_s"] - found["warm_s"])


@pytest.mark.full
def test_starting_is_measured_beside_another_checkout_in_the_same_run():
    found = start.measure(lambda *_: None, repeats=1, cold=False, checkout=str(ROOT))
    for name in ("here", "checkout"):
        assert found[name]["help_processor_s"] < found[name]["calibration_processor_s"]
        assert found[name]["import_s"] > 0
    assert found["limits"]["calibration"]["measured"] == found["here"]["calibration_processor_s"]
    assert found["limits"]["cold"]["kept"] is None


def test_what_a_process_costs_to_start_hides_no_growth():
    rows = [{"frames": n, "seconds": 4.0 + 2e-5 * n**1.3, "peak_mb": 1.0} for n in (1000, 10_000, 100_000, 1_000_000)]
    limits = growth.limits_of_growth({"batch": rows}, {"batch": growth.growth(rows, 4.0)})
    assert limits["batch_exponent"]["kept"]
    assert not limits["batch_exponent_of_the_two_largest"]["kept"]
    assert limits["batch_exponent_beyond_start"]["measured"] == pytest.approx(1.3)


def test_a_longer_file_begins_with_the_rows_of_a_shorter_one(tmp_path):
    for name, frames in (("short", CHUNK), ("long", CHUNK + 10)):
        write_synthetic(tmp_path / f"{name}.parquet", frames)
    first, second = (read_telemetry(tmp_path / f"{name}.parquet") for name in ("short", "long"))
    assert len(np.unique(second.frame)) == CHUNK + 10
    np.testing.assert_array_equal(first.row_px, second.row_px[: len(first)])
