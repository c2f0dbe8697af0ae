"""Figures over REST: drawn alone and over one another, and the numbers behind them."""

import csv
import io
import re
from types import SimpleNamespace

import pytest
from starlette.datastructures import QueryParams

from boresight.calibration.calibration import Change, parse_calibration
from boresight.calibration.options import METHODS
from boresight.console.runs.figure_routes import _stacked
from boresight.console.runs.pages.compare import method_panel
from boresight.console.runs.pages.run import list_history_facts, read_run_view, sight_facts, tail_facts
from boresight.console.runs.tables import Run
from boresight.figures import FIGURES
from boresight.figures.chart import Trace
from boresight.figures.charts.methods import method_scores
from boresight.verdicts.answers import make_headline
from boresight.verdicts.verdict import describe_rms, list_rms, make_verdict_marks
from tests.test_refusals import says_what_to_do


@pytest.mark.few(6)
@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_drawn_alone_compared_and_with_nothing_to_draw(house, name):
    client, waiting = house.person("victor"), house.launched()["id"]
    first, second = house.finished(), house.finished()
    assert [item["name"] for item in client.get(f"/api/v1/runs/{first}/figures").json()["items"]] == list(FIGURES)
    alone = client.get(f"/api/v1/runs/{first}/figures/{name}")
    assert alone.status_code == 200
    assert alone.json()["data"]
    both = client.get(f"/api/v1/runs/{first}/figures/{name}", params={"compare": f"{second},{first}"})
    assert f"Run {second}" in both.text
    assert f"Run {second}" not in alone.text
    nothing = client.get(f"/api/v1/runs/{waiting}/figures/{name}")
    assert nothing.status_code == 200
    assert "layout" in nothing.json()


@pytest.mark.few(6)
@pytest.mark.parametrize("name", FIGURES)
def test_the_numbers_behind_every_figure_come_as_csv_and_of_several_runs_below_one_another(house, name):
    run_id, second, waiting = house.finished(), house.finished(), house.launched()["id"]
    address, client = f"/api/v1/runs/{run_id}/figures/{name}/data", house.person("victor")
    answer = client.get(address)
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    assert f'filename="run-{run_id}-{name}.csv"' in answer.headers["content-disposition"]
    rows = list(csv.reader(io.StringIO(answer.text)))
    table = FIGURES[name].table(parse_calibration(house.result))
    assert rows[0] == list(table)
    assert len(rows) == 1 + max(len(column) for column in table.values())
    answer = client.get(address, params={"compare": f"{second},{waiting},{second},{run_id}"})
    both = list(csv.reader(io.StringIO(answer.text)))
    assert f'filename="run-{run_id}-{second}-{waiting}-{name}.csv"' in answer.headers["content-disposition"]
    assert both[0] == ["run", *rows[0]]
    assert both[1:] == [[str(number), *row] for number in (run_id, second) for row in rows[1:]]


def test_a_column_that_one_run_lacks_is_empty_in_its_rows():
    tables = {4: {"frame": [0, 1], "f_m": [0.1, 0.2]}, 7: {}, 9: {"iteration": [0], "f_m": [0.3]}}
    assert _stacked(tables) == {
        "run": [4, 4, 9],
        "frame": [0, 1, None],
        "f_m": [0.1, 0.2, 0.3],
        "iteration": [None, None, 0],
    }


def test_an_unknown_figure_names_the_ones_there_are(house):
    answer = house.person("victor").get(f"/api/v1/runs/{house.finished()}/figures/pie")
    assert answer.status_code == 404
    assert "convergence" in answer.json()["detail"]


@pytest.mark.parametrize("compare", ["a", "1;2", ",".join(["1"] * 30)])
def test_runs_to_compare_that_are_none_are_refused(house, compare):
    answer = house.person("victor").get(f"/api/v1/runs/{house.finished()}/figures/rms", params={"compare": compare})
    assert answer.status_code == 422


def view(text, result):
    return read_run_view(QueryParams(text), parse_calibration(result))


def test_a_view_is_what_the_address_asks_for_as_far_as_it_can_be_had(results):
    timed = {**results["sqrf"], "history": {**results["sqrf"]["history"], "time_utc": ["2026-01-01T00:00:00Z"] * 40}}
    asked = view("align=time&scale=linear&tail_from=20", timed)
    assert (asked.align, asked.scale, asked.tail_from) == ("time", "linear", 20.0)
    assert asked.query == "align=time&tail_from=20"
    untimed = {**timed, "history": {**timed["history"], "time_utc": None}}
    assert view("align=time", untimed).align == "frame"
    assert list(view("", untimed).aligns) == ["frame", "update"]


@pytest.mark.parametrize("text", ["", "align=moon&scale=cubic&tail_from=soon", "tail_from=nan", "tail_from=1e999"])
def test_what_cannot_be_had_falls_back_to_the_usual_view(text, results):
    usual = view(text, results["sqrf"])
    assert (usual.align, usual.scale, usual.tail_from, usual.query) == ("frame", "log", None, "")


def test_a_batch_has_no_axis_to_choose_and_no_tail_and_without_a_unseen_set_it_is_said_how_to_have_one(results):
    asked = view("align=update&tail_from=3", results["batch"])
    assert (dict(asked.aligns), asked.align, asked.tail_from) == ({}, "frame", None)
    tail, rows = tail_facts(parse_calibration({**results["batch"], "validation": None}), asked)
    assert tail is None
    assert not any(term.startswith("Tail") for term, _, _ in rows)
    assert says_what_to_do(rows[-1][2])


def read_interval(text):
    """Read `81.5 (79.7 to 83.3)`: the value and the ends of its interval."""
    return [float(found) for found in re.findall(r"[\d.]+", text.replace("\u202f", ""))]


def in_urad(scores, which):
    return [1e6 * one for one in (scores["rms_arc_rad"][which], *scores["intervals"]["rms_arc_rad"][which])]


def test_errors_stand_with_their_95_percent_interval_and_unseen_ones_by_themselves(results):
    result = results["sqrf"]
    tail, rows = tail_facts(parse_calibration(result), view("tail_from=30", result))
    numbers = {term: read_interval(number) for term, number, _ in rows}
    for whose, part in (("Fitted", "evaluation"), ("Validation", "validation")):
        for which, words in (("initial", "old"), ("final", "new")):
            expected = in_urad(result[part], which)
            assert numbers[f"{whose} data, {words} parameters"] == pytest.approx(expected, rel=5e-3)
    for term in ("Tail, mean over its window", "Aggregate, at the end"):
        value, low, high = numbers[term]
        assert [low / value, high / value] == pytest.approx(
            [end / in_urad(result["evaluation"], "final")[0] for end in in_urad(result["evaluation"], "final")[1:]],
            rel=5e-3,
        )
    assert (tail.start, tail.chosen) == (30.0, True)


@pytest.mark.parametrize("method", ["batch", "sqrf"])
def test_one_number_has_one_interval_wherever_it_stands(results, method):
    result = parse_calibration(results[method])
    fitted = describe_rms(result.evaluation, result.rms_arc_rad, result.pairs)
    unseen = describe_rms(result.validation, result.validation.rms_arc_rad, result.validation.common_pairs)
    assert len(read_interval(fitted)) == len(read_interval(unseen)) == 6  # two values, with two ends each
    headline = make_headline(result)
    assert headline.at_length == f"RMS {fitted} µrad; validation {unseen} µrad"
    assert all(told.partition(" → ")[2] in headline.numbers for told in (fitted, unseen))
    mark = next(mark for mark in make_verdict_marks(result) if mark.name == "validation_rms")
    assert (mark.value, "95 %" in mark.detail) == (f"{unseen} µrad", True)
    _, rows = tail_facts(result, view("", results[method]))
    listed = {term: number for term, number, _ in rows}
    for words, told in (("Fitted", fitted), ("Validation", unseen)):
        assert " → ".join(listed[f"{words} data, {one} parameters"] for one in ("old", "new")) == told
    title = FIGURES["rms"].draw([Trace("Run 1", result)]).layout.title.text
    assert (fitted in title, "95 %" in title) == (True, True)


@pytest.mark.parametrize("share", [0.5, 1.0, 2.0])
def test_the_interval_of_an_rms_contains_it_also_where_the_flight_code_accepts_other_pairs(results, share):
    result = parse_calibration(results["batch"])
    rms = Change(initial=share * result.rms_arc_rad.initial, final=share * result.rms_arc_rad.final)
    for told in list_rms(result.evaluation, rms, result.pairs):
        value, low, high = read_interval(told)
        assert low < value < high


def test_an_rms_without_resampled_frames_has_the_interval_of_as_many_independent_arcs(results):
    result = parse_calibration({**results["batch"], "evaluation": None})
    value, low, high = read_interval(describe_rms(None, result.rms_arc_rad, result.pairs).partition(" → ")[2])
    assert high - low == pytest.approx(2 * 1.96 * value / (2 * result.pairs) ** 0.5, rel=0.1)


def test_a_result_that_kept_no_number_of_unseen_arcs_shows_the_value_and_says_so(results):
    result = results["batch"]
    kept = {key: value for key, value in result["validation"].items() if key not in {"common_pairs", "intervals"}}
    judged = parse_calibration({**result, "validation": kept})
    _, value, _ = tail_facts(judged, view("", result))[1][-1]
    assert float(value) == pytest.approx(1e6 * kept["rms_arc_rad"]["final"], rel=5e-3)
    said = {mark.name: mark.detail for mark in make_verdict_marks(judged)}
    assert said["validation_rms"].endswith("no interval was stored")


def test_a_history_says_where_it_settled_or_that_it_has_not_yet(results):
    assert list_history_facts(parse_calibration(results["batch"]))[0][1].startswith("iteration ")
    assert list_history_facts(parse_calibration({**results["sqrf"], "status": "running"}))[0][1] == "not yet"
    assert list_history_facts(None) == []


def test_what_the_data_see_is_said_in_words(results):
    rows, helpful = sight_facts(parse_calibration(results["batch"]))
    assert [term for term, _, _ in rows] == ["Weakest direction", "Known to", "Condition number"]
    assert helpful
    assert sight_facts(parse_calibration({**results["batch"], "observability": None})) == ([], [])


def test_a_browser_that_has_a_figure_is_told_that_it_still_holds(house):
    client, address = house.person("victor"), f"/api/v1/runs/{house.finished()}/figures/rms"
    first = client.get(address)
    again = client.get(address, headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert client.get(address, headers={"If-None-Match": '"other"'}).content == first.content
    assert first.headers["cache-control"] == "private, no-cache"


def test_every_view_of_a_figure_has_a_tag_of_its_own(house):
    client, run, other = house.person("victor"), house.finished(), house.finished()
    address = f"/api/v1/runs/{run}/figures/rms"
    views = [{}, {"compare": str(other)}, {"align": "update"}, {"overlay": "band"}, {"x_from": 1, "x_to": 5}]
    tags = [client.get(address, params=view).headers["etag"] for view in views]
    assert len(set(tags)) == len(views)


def test_a_figure_of_a_run_that_may_still_change_is_kept_by_nobody(house):
    answer = house.person("victor").get(f"/api/v1/runs/{house.launched()['id']}/figures/rms")
    assert answer.headers["cache-control"] == "no-store"
    assert "etag" not in answer.headers


@pytest.mark.parametrize(
    ("view", "said"),
    [
        ({"x_from": 1}, "both ends"),
        ({"x_from": 5, "x_to": 1}, "x_from below x_to"),
        ({"align": "moon"}, "update"),
        ({"overlay": "pie"}, "band"),
    ],
)
def test_a_view_that_there_is_not_is_refused(house, view, said):
    answer = house.person("victor").get(f"/api/v1/runs/{house.finished()}/figures/convergence", params=view)
    assert answer.status_code == 422
    assert said in answer.text


def test_a_comparison_comes_with_its_assumption_its_table_and_its_curves(house):
    client, runs = house.person("victor"), [house.finished(), house.finished()]
    query = {"runs": ",".join(map(str, runs)), "reference": str(runs[1])}
    found = client.get("/api/v1/runs/compare", params=query).json()
    assert (found["reference"], [run["id"] for run in found["runs"]]) == (runs[1], runs)
    assert "share" in found["assumption"]
    table = list(csv.DictReader(io.StringIO(client.get("/api/v1/runs/compare/data", params=query).text)))
    assert [int(row["run"]) for row in table[:2]] == [runs[1], runs[0]]
    figure = client.get("/api/v1/runs/compare/figures/radial", params=query)
    assert f"Run {runs[0]}" in figure.text
    curves = list(
        csv.DictReader(io.StringIO(client.get("/api/v1/runs/compare/figures/radial/data", params=query).text))
    )
    assert {int(row["run"]) for row in curves} == {runs[0]}


@pytest.mark.parametrize(
    ("asked", "status"),
    [("1", 422), ("1,x", 422), ("999999,1", 404), ("9" * 5000, 404), (",".join(map(str, range(1, 25))), 422)],
)
def test_a_comparison_that_there_cannot_be_is_refused(house, asked, status):
    assert house.person("victor").get("/api/v1/runs/compare", params={"runs": asked}).status_code == status


def one(run_id=1, method="batch", set_id=1, result=None, **settings):
    run = Run(id=run_id, method=method, telemetry_set_id=set_id, settings={"method": method} | settings)
    calibration = parse_calibration(result or {"status": "running"})
    return SimpleNamespace(run=run, result=result or {}, calibration=calibration)


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
    scores = [method_scores(parse_calibration(results[name])) for name in ("batch", "sqrf")]
    assert line(panel, "Claimed error").values == [f"{score.claimed:.3f}" for score in scores]
    assert line(panel, "Converged after").values == [
        f"{scores[0].settled_iterations} iterations", f"{scores[1].settled_frames} frames"
    ]  # fmt: skip
    assert all(value.endswith("consistent") for value in line(panel, "χ² / dof").values)
    assert all(len(line.values) == 2 and line.reading.endswith(".") for line in panel.lines)


def test_one_method_twice_has_no_panel_and_runs_without_results_ask_for_patience(site, read):
    assert method_panel([one(1), one(2)]) is None
    assert "has a result" in method_panel([one(1), one(2, "svd")]).refusal
    other = site.add_run("batch")
    assert "When to use which" not in read(site.visitor("victor").get(f"/compare?runs=1,{other}"))


def test_methods_on_different_sets_are_refused_with_both_runs_named(site, read, results):
    other = site.add_run("sqrf", state="SUCCEEDED", result=results["sqrf"], telemetry_set_id=2)
    text = read(site.visitor("victor").get(f"/compare?runs=1,{other}"))
    assert f"Run #1 and run #{other} " in text
    assert "Claimed error" not in text


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
