"""The study of Enright 2018: printed numbers, the rule that judges, and what the report of a small run holds."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.calibration.calibrate import calibrate
from boresight.errors import RefusedInputError
from boresight.papers import enright
from boresight.papers.documents import (
    CAUSES,
    VERDICTS,
    Cell,
    Conclusion,
    compute_typical_factor,
    count_within_two,
    judge,
)
from boresight.papers.enright import grid, printed
from boresight.papers.enright import study as report
from boresight.papers.enright.estimators import ESTIMATORS, Trial, _thinned, draw_trial, estimators_for
from boresight.papers.enright.pooled import Pooled
from boresight.simulation.sensors import CHANGES, NOMINAL, TYPICAL_SIGMA
from boresight.telemetry.schema import Telemetry

HOLDS, FAILS = Conclusion(True, "it does."), Conclusion(False, "it does not.", "erratum", "the text is wrong")


# The printed numbers.


def test_the_printed_numbers_are_what_the_papers_text_makes_of_them_or_not():
    excess = {name: round(100 * share) for name, share in printed.reduced_excess().items()}
    assert excess == {"batch": 72, "q": 23, "no-q": 15, "no-refit": 10}
    assert printed.no_refit_rank() == {"worst": [3, 4, 6], "best": [1, 2]}
    assert printed.same_sign("n0_px", "a1_rad") == list(printed.SENSORS)
    assert np.array_equal(np.array(list(printed.TABLE_III.values())).T, CHANGES)
    assert np.array_equal([nominal for nominal, _ in printed.TABLE_II.values()], NOMINAL)
    assert np.array_equal([sigma for _, sigma in printed.TABLE_II.values()], TYPICAL_SIGMA)
    falls = [1 - final / initial for *_, initial, final in printed.TABLE_IV.values()]
    assert sum(100 * fall > printed.MOST_FALL for fall in falls) == 4
    assert min(falls) > 0.2
    assert max(falls) > 0.8  # sensor 1 falls by 81 %, beyond the abstract's 80
    assert sum(30 <= 100 * fall <= 70 for fall in falls) == 1  # of “30–70 %, typically”


# The rule.


def cell(printed_value, ours, **extra):
    return Cell("column", "unit", printed_value, ours, **{"cause": "unstated setting"} | extra)


@pytest.mark.parametrize(
    ("given_cell", "verdict"),
    [
        (cell(100.0, 109.0), "reproduced"),
        (cell(100.0, 112.0), "in kind"),
        (cell(100.0, 112.0, low=99.0, high=125.0), "reproduced"),
        (cell(100.0, 112.0, low=100.04, high=125.0, resolution=0.1), "reproduced"),
        (cell(100.0, 112.0, low=100.06, high=125.0, resolution=0.1), "in kind"),
        (cell(100.0, 200.0), "in kind"),
        (cell(100.0, 201.0), "not reproduced"),
        (cell(100.0, 50.0), "in kind"),
        (cell(100.0, 49.0), "not reproduced"),
        (cell(100.0, 50.0, error=50.0), "in kind"),
        (cell(100.0, 49.0, error=49.0), "better"),
        (cell(100.0, 201.0, error=201.0), "not reproduced"),
        (cell(100.0, 200.0, error=49.0), "in kind"),
        (cell(-100.0, 30.0, error=40.0), "better"),
        (cell(-100.0, 30.0, low=-120.0, high=120.0, error=40.0), "reproduced"),
        (cell(100.0, 100.0, published=False), "data not published"),
        (cell(100.0, None, published=False), "data not published"),
        (cell(100.0, 201.0, cause="no orbital data"), "data not published"),
        (cell(100.0, 201.0, cause="no field data"), "data not published"),
        (cell(100.0, 201.0, cause="erratum"), "not reproduced"),
        (cell(100.0, 200.0, cause="no orbital data"), "in kind"),
        (cell(100.0, -100.0), "not reproduced"),
        (cell(-0.10, 0.02, low=-0.2, high=0.2), "reproduced"),
        (cell(16.031, 16.039), "reproduced"),
        (cell(16.031, 16.039, origin=16.095), "in kind"),
        (cell(1.0, None), "not reproduced"),
        (cell(0.0, 0.0), "reproduced"),
        (cell(0.0, 0.1), "not reproduced"),
    ],
)  # fmt: skip
def test_a_number_is_judged_by_its_interval_ten_percent_and_a_factor_of_two(given_cell, verdict):
    assert given_cell.verdict == verdict


@given(st.floats(-1e6, 1e6), st.floats(0, 1e6))
def test_a_better_error_is_less_than_half_of_the_printed_one_and_says_by_which_factor(printed_value, error):
    found = cell(printed_value, -printed_value, error=error)
    assert (found.verdict == "better") == (0 < 2 * error < abs(printed_value))
    if found.verdict == "better":
        assert found.factor == abs(printed_value) / error


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(0.01, 100))
def test_a_verdict_does_not_depend_on_the_unit(printed_value, ours, factor):
    one, other = cell(printed_value, ours), cell(printed_value * factor, ours * factor)
    edges = [0.9, 1.1, 0.5, 2.0]
    ratio = ours / printed_value if printed_value else 0.0
    assert (
        one.verdict == other.verdict
        or any(abs(ratio / edge - 1) < 1e-9 for edge in edges)
        or abs(printed_value) < 1e-300
    )


@pytest.mark.parametrize(
    ("values", "conclusion", "verdict"),
    [
        ([(1, 1), (1, 1.05)], HOLDS, "reproduced"),
        ([(1, 1), (1, 2)], HOLDS, "in kind"),
        ([(1, 1), (1, 9)], HOLDS, "not reproduced"),
        ([(1, 1), (1, 1)], FAILS, "not reproduced"),
        ([], HOLDS, "in kind"),
        ([], FAILS, "not reproduced"),
    ],
)
def test_a_row_is_as_good_as_its_worst_number_and_its_conclusion(values, conclusion, verdict):
    assert judge("row", [cell(*pair) for pair in values], conclusion).verdict == verdict


def test_a_reason_names_the_cause_of_every_number_that_is_not_reproduced():
    apart = Cell("RMS", "µrad", 100.0, 200.0, cause="erratum", because="a sign is wrong")
    row = judge("1", [cell(1.0, 1.0), apart], FAILS)
    assert row.reason == (
        "1 of 2 numbers agree. Erratum (RMS): a sign is wrong. Conclusion not confirmed: it does not. "
        "Erratum (conclusion): the text is wrong."
    )


# What is run.


def test_every_estimator_has_settings_that_a_calibration_accepts_and_the_batch_comes_first():
    assert all(
        estimators_for(sensor, further=further)[0].key == "batch" for sensor in (3, 4) for further in (False, True)
    )
    for estimator in ESTIMATORS.values():
        estimator.settings.check()


def test_thinning_keeps_each_nth_frame_whole():
    frame = np.repeat(np.arange(7), 3)
    zeros = np.zeros(21)
    thin = _thinned(Telemetry(frame, zeros.astype(int), np.arange(21.0), zeros, star_id=frame * 10), 3)
    assert thin.frame.tolist() == [0, 0, 0, 3, 3, 3, 6, 6, 6]
    assert thin.star_id.tolist() == (thin.frame * 10).tolist()
    assert thin.quaternion is None


# A small study.


@pytest.fixture(scope="module")
def study():
    plan = enright.StudySize(quick=True, sensors=(3, 4), frames=30, validation_frames=15, sets=1, processes=1)
    return enright.run(plan, None)


@pytest.mark.full
def test_the_document_follows_its_schema(study):
    assert study["schema"] == "boresight.reproduction/1"
    assert [table["number"] for table in study["tables"]] == ["III", "IV", "V", "VI", "VII", "text"]
    assert [figure["number"] for figure in study["figures"]] == ["3a", "3b", "4", "5"]
    assert len(study["questions"]) == 5
    rows = [row for table in study["tables"] for row in table["rows"]]
    assert all(row["verdict"] in VERDICTS and row["reason"] for row in rows)
    judged = [*rows, *study["figures"]]
    causes = [cause.capitalize() for cause in CAUSES]
    assert all(any(cause in row["reason"] for cause in causes) for row in judged if row["verdict"] == "not reproduced")
    assert {cell["cause"] for row in rows for cell in row["cells"]} <= set(CAUSES)


@pytest.mark.full
def test_the_head_counts_every_printed_number_once_and_nothing_circular(study):
    cells = [
        (table["number"], row["label"], cell)
        for table in study["tables"]
        for row in table["rows"]
        for cell in row["cells"]
    ]
    printed_here = len(study["plan"]["sensors"]) * (8 + 5 + 5 + 8) + 2 + 1 + 2 + 3 + 2  # Tables III to VI, and the text
    assert len(cells) == printed_here
    assert len({(number, label, found["column"]) for number, label, found in cells}) == len(cells)
    circular = {number for number, _, found in cells if found["left_out"] == "circular"}
    assert circular == {"III", "IV"}
    assert study["left_out"] == {"circular": 2 * (8 + 1), "repeated": 0, "variant": 0, "derived": 0}
    assert sum(study["verdicts"].values()) == printed_here - 2 * 9
    rows = [row for table in study["tables"] for row in table["rows"]]
    assert sum(study["statements"].values()) == len(rows) - 8 + 4  # without Table III's, and the figures'


def test_every_estimator_stands_in_the_document_with_nees_and_its_ratio_to_the_bound(study):
    found = {line["estimator"]: line for line in study["estimators"]}
    assert set(found) == set(ESTIMATORS)
    full = [line for key, line in found.items() if not ESTIMATORS[key].reduced and "flight" not in key]
    assert all(
        line["nees"]["expected"] == 8 and line["ratio_to_bound"]["lower"] < line["ratio_to_bound"]["upper"]
        for line in full
    )


def test_every_record_is_found_by_sensor_and_estimator_and_its_validation_has_bootstrap_intervals(study):
    for record in study["records"]:
        found = record["validation"]
        low, high = found["intervals"]["rms_arc_rad"]["final"]
        assert low <= found["rms_arc_rad"]["final"] <= high
    pooled = Pooled(study["records"])
    assert pooled.sensors == [3, 4]
    assert pooled.first(3, "batch")["estimator"] == "batch"
    assert pooled.first(1, "batch") is None


def test_the_report_holds_every_table_with_units_figure_finding_and_answer(study):
    html = report.render(study)
    assert re.findall(r'data-table="(\w+)"', html) == [
        "III",
        "IV",
        "V",
        "VI",
        "text",
    ]  # VII is sensor 2's, which was not run
    assert re.findall(r'data-figure="(\w+)"', html) == ["3a", "3b", "4", "5"]
    assert all(item["question"] in html for item in study["questions"])
    assert 'http-equiv="Content-Security-Policy" content="default-src \'none\'' in html
    assert not re.search(r'(src|href)="', html.partition("<script>")[0])
    for table in study["tables"]:
        for cell_ in table["rows"][0]["cells"] if table["rows"] else ():
            heading = cell_["column"] + (f" ({cell_['unit']})" if cell_["unit"] else "")
            assert f"<th>{heading}</th>" in html or f'<span class="muted">{heading.partition(" (%")[0]}</span>' in html
            assert cell_["unit"] or re.search("availability|star", cell_["column"]) or table["number"] == "text"


def test_the_cost_by_the_clock_stands_below_the_one_finding_that_asks_for_it(study):
    assert [finding["title"].startswith("UKF") for finding in study["findings"] if finding.get("is_timed")] == [True]
    assert report.render(study).count("By the clock of this run") == 1


def test_every_finding_quotes_the_text_and_holds_figures_against_it(study):
    assert len({finding["title"] for finding in study["findings"]}) == 11
    assert all(
        finding["text"] and any(re.search(r"\d", word) for word in finding["sentences"])
        for finding in study["findings"]
    )


def test_the_reduced_model_claims_far_more_than_it_knows_and_sensors_that_moved_fail_until_calibrated(study):
    nees = {line["estimator"]: line["nees"] for line in study["estimators"]}
    assert nees["reduced-batch"]["mean"] > 1000 * nees["reduced-batch"]["expected"]
    assert nees["batch"]["mean"] < 3 * nees["batch"]["expected"]
    assert nees["printed"]["mean"] > nees["no-q"]["mean"]
    batches = [record for record in study["records"] if record["estimator"] == "batch"]
    assert all(record["calibration"]["availability"]["initial"] < 0.6 for record in batches)
    assert all(record["calibration"]["availability"]["final"] > 0.95 for record in batches)


def test_the_text_says_of_falling_errors_what_the_records_make_of_them(study):
    rows = {row["label"]: row for table in study["tables"] if table["number"] == "text" for row in table["rows"]}
    batches = [record for record in study["records"] if record["estimator"] == "batch"]
    falls = [
        100 * (1 - one["final"] / one["initial"]) for one in (batch["calibration"]["rms_arc_rad"] for batch in batches)
    ]
    assert rows["III-A: reduction, most"]["cells"][0]["ours"] == pytest.approx(np.median(falls))
    assert rows["III-A: reduction, most"]["holds"] == (sum(fall > 70 for fall in falls) > len(falls) / 2)
    low, high = (one["ours"] for one in rows["abstract: reduction"]["cells"])
    assert low <= min(falls) <= max(falls) <= high
    assert rows["abstract: reduction"]["holds"] == (low >= 20 and high <= 80)


# The grids of unstated settings.


def test_a_typical_factor_is_the_root_mean_square_of_logarithms_and_bounds_what_is_missing_or_of_the_wrong_sign():
    assert compute_typical_factor(np.array([2.0, 0.5, 2.0, 0.5])) == pytest.approx(2)
    assert compute_typical_factor(np.array([1.0, 1.0])) == 1
    assert [compute_typical_factor(np.array([one])) for one in (np.nan, np.inf, -3.0, 0.0, 1e9)] == pytest.approx(
        [100] * 5
    )
    assert count_within_two(np.array([2.0, 0.5, 2.1, 0.4, -1.0, np.nan])) == 2


def test_settings_that_share_all_but_q_are_run_together_and_no_setting_twice():
    together = grid.split(Trial(2, 0, 20, 10), grid.SETTINGS)
    found = [setting for one in together for setting in one.settings]
    assert sorted(map(str, found)) == sorted(map(str, grid.SETTINGS))
    assert len(together) == 2 * 2 * 3
    assert set(grid.FEW) < set(grid.SETTINGS)


@pytest.mark.full
def test_a_setting_of_the_grid_gives_what_a_calibration_with_it_gives_and_the_first_is_ours():
    trial = Trial(2, 0, 30, 15)
    settings = (grid.SETTINGS[0], replace(grid.SETTINGS[0], q_sigma=0.2))
    (ours, free), seconds = grid.run_grid(grid.GridTrial(trial, settings), None)
    data = draw_trial(trial, None)
    x = calibrate(data.calibration, data.sensor, data.catalogue, ESTIMATORS["q"].settings).to_dict()["parameters"]
    changes = [(x["f_m"] * 1e3 - 16.095) / (16.035 - 16.095), x["b4_per_m4"] / 0.583e8, (x["b2_per_m2"] + 1e3) / -771]
    assert ours["ratios"]["q"][1:] == pytest.approx(changes, rel=1e-6)
    assert ours["ratios"]["no-q"] == free["ratios"]["no-q"]
    assert ours["ratios"]["q"] != free["ratios"]["q"]
    assert ours["numbers"] == 12
    assert seconds > 0


def test_the_nearest_tolerance_has_the_smallest_factor_and_ours_is_five_arc_sigmas(study):
    (found,) = study["grids"]
    factors = [one["factor"] for one in found["settings"]]
    assert factors == sorted(factors)
    assert len(factors) == 5
    assert found["ours"]["arc sigmas"] == 5
    assert all(one["numbers"] == 3 * 2 for one in found["settings"])


def test_a_sensor_that_the_paper_does_not_have_is_refused():
    with pytest.raises(RefusedInputError, match="no sensor 7"):
        enright.run(enright.StudySize(sensors=(7,)), None)
