"""The comparison of methods on one data set."""

from types import SimpleNamespace

import pytest

from boresight.calibration.options import METHODS
from boresight.console.runs.pages.compare import method_panel
from boresight.figures.charts.methods import method_scores


def one(run_id=1, method="batch", set_id=1, result=None, **settings):
    run = SimpleNamespace(id=run_id, method=method, telemetry_set_id=set_id, settings={"method": method} | settings)
    return SimpleNamespace(run=run, result=result or {})


def line(panel, name):
    return next(line for line in panel.lines if line.name == name)


def test_two_methods_on_one_set_are_set_beside_each_other_with_when_to_use_which(site, read):
    text = read(site.visitor("victor").get("/compare?runs=1,2"))
    for said in ("Methods", "Claimed error", "ms / frame", "Converged after", "Condition number", "When to use which"):
        assert said in text
    for method in METHODS.values():
        assert (method.when[:40] in text) == (method.name in {"batch", "sqrf"})


def test_a_simulated_sensor_adds_true_error_and_nees_and_a_real_one_has_neither(results):
    truth = dict(results["batch"]["parameters"])
    known = [one(1, "batch", result=results["batch"] | {"truth": truth}), one(2, "sqrf", result=results["sqrf"])]
    assert line(method_panel(known), "True error").values[0] == "0.000"
    assert line(method_panel(known), "NEES / n").values == ["0 not consistent", "–"]
    unknown = [one(1, "batch", result=results["batch"]), one(2, "sqrf", result=results["sqrf"])]
    assert {"True error", "NEES / n"}.isdisjoint(line.name for line in method_panel(unknown).lines)


def test_the_numbers_are_those_of_the_results(results):
    panel = method_panel([one(1, "batch", result=results["batch"]), one(2, "sqrf", result=results["sqrf"])])
    scores = [method_scores(results[name]) for name in ("batch", "sqrf")]
    assert line(panel, "Claimed error").values == [f"{score.claimed:.3f}" for score in scores]
    assert line(panel, "Converged after").values == [
        f"{scores[0].settled_iterations} iterations", f"{scores[1].settled_frames} frames"
    ]  # fmt: skip
    assert all(value.endswith("consistent") for value in line(panel, "χ² / dof").values)


def test_every_line_has_a_text_for_each_run_and_one_sentence_on_how_to_read_it(results):
    panel = method_panel([one(1, "batch", result=results["batch"]), one(2, "sqrf")])
    assert all(len(line.values) == 2 and line.reading.endswith(".") for line in panel.lines)


def test_one_method_twice_has_no_panel(site, read):
    assert method_panel([one(1), one(2)]) is None
    other = site.add_run("batch")
    assert "When to use which" not in read(site.visitor("victor").get(f"/compare?runs=1,{other}"))


def test_methods_on_different_sets_are_refused_with_both_runs_named(site, read, results):
    other = site.add_run("sqrf", state="SUCCEEDED", result=results["sqrf"], telemetry_set_id=2)
    text = read(site.visitor("victor").get(f"/compare?runs=1,{other}"))
    assert f"Run #1 and run #{other} are of different telemetry sets" in text
    assert "Claimed error" not in text


def test_runs_without_results_ask_for_patience():
    assert "have ended" in method_panel([one(1), one(2, "svd")]).refusal


def test_a_run_on_its_way_stands_as_dashes_beside_one_that_ended(results):
    panel = method_panel([one(1, "batch", result=results["batch"]), one(2, "sqrf", result=results["sqrf-partial"])])
    assert panel.refusal is None
    assert line(panel, "Claimed error").values[1] == "–"
    assert line(panel, "Converged after").values[1] == "–"


@pytest.mark.parametrize(
    ("changes", "named"),
    [({"match": "given"}, "match"), ({"minimum_stars": 6}, "minimum stars"), ({"leave_out_doubles": True}, "leave out doubles")],
)  # fmt: skip
def test_what_differs_beside_the_method_is_named(results, changes, named):
    alike = {"match": "rematch", "minimum_stars": 4, "leave_out_doubles": False}
    compared = [
        one(1, "batch", result=results["batch"], **alike),
        one(2, "sqrf", result=results["sqrf"], **alike | changes),
    ]
    assert method_panel(compared).unlike == named


def test_a_method_s_own_settings_and_the_same_free_list_are_no_difference(results):
    compared = [
        one(1, "batch", result=results["batch"], robust="none", free=None),
        one(2, "sqrf", result=results["sqrf"], variant="no-q", free=list(results["sqrf"]["free"])),
    ]
    assert method_panel(compared).unlike == ""


def test_other_free_parameters_and_other_frames_are_a_difference(results):
    fewer = results["sqrf"] | {"free": ["f_m"], "frames": 12}
    compared = [one(1, "batch", result=results["batch"]), one(2, "sqrf", result=fewer)]
    assert method_panel(compared).unlike == "free parameters, number of frames used"
