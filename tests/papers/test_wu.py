"""The study of Wu 2019: printed numbers, what is run, the criteria, and what the report of a small run holds."""

import re

import numpy as np
import pytest

from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.errors import RefusedInputError
from boresight.estimation.filters.history import start
from boresight.estimation.singular_values import Selection
from boresight.papers import wu
from boresight.papers.documents import CAUSES, VERDICTS, number, printed_digits
from boresight.papers.wu import printed, timing
from boresight.papers.wu import study as report
from boresight.papers.wu.drawings import draw_criteria
from boresight.papers.wu.estimators import (
    ARCSEC_PER_RAD,
    FREE,
    START_SIGMA,
    Estimator,
    Judges,
    Trial,
    draw_fields,
    estimators,
    gain_filter,
    noisy,
    run_trial,
)
from boresight.papers.wu.timing import Ratio
from boresight.simulation.sensors import WU_PIXEL_PITCH_M, WU_START, WU_TRUTH
from tests.effort import effort

# The printed numbers.


def test_the_printed_numbers_are_what_the_papers_text_makes_of_them_or_not():
    assert [round(ratio, 1) for ratio in printed.time_ratios()] == [18.1, 4.5, 1.7]
    assert round(100 * (1 - 1 / printed.time_ratios()[0]), 2) == 94.48
    assert printed.TABLE_2_A["mean"][3] == printed.TABLE_3_A["mean"][1] == printed.TABLE_4["A", "mean"][3] == 0.465
    assert printed.stated_angle_deg(1920, 2.9e-6, 16e-3) == pytest.approx(19.74, abs=0.005)
    assert printed.stated_angle_deg(1080, 2.9e-6, 16e-3) == pytest.approx(11.18, abs=0.005)


# What is run.


@pytest.fixture(scope="module")
def star_fields():
    return draw_fields(5.5, 150, np.random.default_rng(3), None)


@pytest.fixture(scope="module")
def arcs(star_fields):
    return noisy(star_fields, 0.2, np.random.default_rng(4))


def test_group_2_runs_four_models_seven_subsets_and_the_baseline_in_both_weights():
    keys = {(one.key, one.weights) for one in estimators(5.5)}
    assert len(keys) == len(estimators(5.5)) == 2 * (4 + 6 + 1)
    assert {(one.key) for one in estimators(6.0)} == {"svd-4-23", "angular"}


@pytest.mark.parametrize("method", ["svd", "angular"])
def test_the_printed_gain_form_gives_what_the_information_form_gives(arcs, method):
    estimator = Estimator(method, "diagonal")
    part = arcs.frames(0, 30)
    by_gain = gain_filter(estimator, part, start(WU_START, len(FREE), 1.0))
    assert np.abs((by_gain - estimator.run(part).states[-1]) / START_SIGMA).max() < 1e-4


@pytest.mark.parametrize("method", ["svd", "angular"])
def test_a_full_r_claims_what_it_knows_and_a_diagonal_one_far_more(arcs, method):
    claimed = {}
    for weights in ("full", "diagonal"):
        run = Estimator(method, weights).run(arcs)
        error = (run.states[-1] - WU_TRUTH) / START_SIGMA
        claimed[weights] = error @ np.linalg.solve(run.P, error)
    assert claimed["full"] < 20
    assert claimed["diagonal"] > claimed["full"]


def test_the_first_value_changes_nothing_with_the_full_r(arcs):
    ends = [Estimator("svd", "full", Selection(4, values)).run(arcs).states[-1] for values in ((1, 2, 3), (2, 3))]
    assert np.abs((ends[0] - ends[1]) / START_SIGMA).max() < 5e-3


# The criteria.


def test_criterion_a_is_the_mean_over_images_of_the_rms_over_all_pairs_and_b_the_noise_of_two_ends(star_fields):
    judges = Judges.of(star_fields, 0.2, np.random.default_rng(5))
    noise = np.sqrt(2) * 0.2 * WU_PIXEL_PITCH_M / 16e-3 * ARCSEC_PER_RAD
    assert judges.criterion_a(WU_TRUTH)[0] < 1e-4
    assert judges.criterion_b(WU_TRUTH)[0] == pytest.approx(noise, rel=0.03)
    s = PINHOLE_RADIAL.directions(WU_START, star_fields.row_px, star_fields.col_px, WU_PIXEL_PITCH_M)
    found = []
    for first, last in zip(star_fields.star_start[:-1], star_fields.star_start[1:], strict=True):
        errors = [
            np.arccos(s[i] @ s[j]) - np.arccos(star_fields.s_i[i] @ star_fields.s_i[j])
            for i in range(first, last)
            for j in range(i + 1, last)
        ]
        found.append(np.sqrt(np.mean(np.square(errors))) * ARCSEC_PER_RAD)
    assert judges.criterion_a(WU_START) == pytest.approx((np.mean(found), np.std(found)), rel=1e-6)


def test_images_near_the_milky_way_hold_about_as_many_stars_as_the_papers():
    for limit, stars in printed.GROUPS.items():
        assert draw_fields(limit, 600, np.random.default_rng(1), None).stars_per_field == pytest.approx(stars, rel=0.1)


# A small study.


@pytest.fixture(scope="module")
def study():
    """Times are taken in this process and in few rounds; `boresight reproduce` takes them as a study does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "run_on_one_thread", lambda run, folder: run(folder))
        for name, number in (("DRAWN", 300), ("FRAMES", 20), ("SLOW_FRAMES", 4), ("ROUNDS", 3)):
            patch.setattr(timing, name, number)
        return wu.run(wu.Plan(quick=True, frames=effort(60, 120), judges=effort(15, 30), sets=2, processes=1), None)


def test_the_document_follows_its_schema(study):
    assert study["schema"] == "boresight.reproduction/1"
    assert [table["number"] for table in study["tables"]] == ["2", "3", "4"]
    assert [figure["number"] for figure in study["figures"]] == ["3", "4", "6a", "6b", "8"]
    assert [table["number"] for table in study["timing"]["tables"]] == ["4 (time)", "3 (time)"]
    rows = [row for table in (*study["tables"], *study["timing"]["tables"]) for row in table["rows"]]
    causes = [cause.capitalize() for cause in CAUSES]
    judged = [*rows, *study["figures"]]
    assert all(row["verdict"] in VERDICTS and row["reason"] for row in judged)
    assert all(any(cause in row["reason"] for cause in causes) for row in judged if row["verdict"] == "not reproduced")


def test_criterion_b_tells_the_noise_that_the_text_does_not(study):
    rows = {row["label"]: row for row in study["tables"][2]["rows"]}
    for noise, agrees in (("0.2", True), ("0.5", False)):
        cells = rows[f"B mean, full R, {noise} px"]["cells"]
        assert all((cell["verdict"] == "reproduced") is agrees for cell in cells)


#: Places of the paper that are known to be wrong.
WRONG = (
    "Eq 6", "Eq 24", "3.3", "Eq 31", "Eq 32", "Eq 33", "Eq 35", "3.3.3, Table 3", "4.1", "4.1, 4.2", "4.2, Figure 8",
    "4.1, Table 4",
)  # fmt: skip


def test_every_known_erratum_is_cited_with_what_was_done_and_beside_what_it_concerns(study):
    html = report.render(study)
    cited = {erratum["place"].removesuffix(", text"): erratum for erratum in study["errata"]}
    judged = {f"Table {one['number']}": one for one in (*study["tables"], *study["timing"]["tables"])}
    judged |= {f"Figure {one['number']}": one for one in study["figures"]}
    assert set(cited) == set(WRONG)
    for erratum in cited.values():
        assert erratum["printed"]
        assert erratum["right"]
        assert erratum["done"] in html
        assert all(erratum["place"] in judged[name]["errata"] for name in erratum["concerns"])
    assert {name for name, one in judged.items() if one["errata"]} == set(judged)


def test_the_saving_is_judged_by_the_information_that_both_hold_in_this_run(study):
    (done,) = (erratum["done"] for erratum in study["errata"] if erratum["place"] == "4.1, Table 4")
    low, high, full_low, full_high = map(float, re.findall(r"\d+\.\d+", done))
    assert 0.99 < full_low < full_high < 1.15
    assert 1.5 < low < high


def test_a_ratio_is_the_median_of_rounds_and_its_reason_tells_of_a_busy_machine_only_when_the_quartiles_do():
    under = np.array([1.0, 2.0, 1.0, 4.0, 1.0])
    steady, shaken = Ratio.of(18 * under, under), Ratio.of(under * [10, 14, 18, 22, 26], under)
    assert (steady.median, steady.low, steady.high) == (18, 18, 18)
    assert (shaken.median, shaken.low, shaken.high) == (18, 14, 22)
    cells = [ratio.cell("31 stars", 18.1, 0.1, ("unstated setting", "why")) for ratio in (steady, shaken)]
    assert ["busy" in cell.because for cell in cells] == [False, True]
    assert (cells[1].low, cells[1].high) == (14, 22)


def test_every_estimator_is_judged_on_every_set_at_both_noises_and_every_time_has_its_quartiles(study):
    cells = [cell for table in study["timing"]["tables"] for row in table["rows"] for cell in row["cells"]]
    assert all(cell["low"] <= cell["ours"] <= cell["high"] for cell in cells)
    assert any(cell["low"] < cell["high"] for cell in cells)
    places = {(r["set"], r["magnitude_limit"], r["noise_px"], r["estimator"], r["weights"]) for r in study["records"]}
    assert len(places) == len(study["records"]) == 2 * 2 * (22 + 4 + 4 + 3)
    assert {line["expected"] for line in study["consistency"]} == {6}


def test_the_report_holds_every_table_figure_and_finding_and_every_row_fills_its_columns(study):
    html = report.render(study)
    assert re.findall(r'data-table="([^"]+)"', html) == ["2", "3", "4", "4 (time)", "3 (time)"]
    assert re.findall(r'data-figure="(\w+)"', html) == ["3", "4", "6a", "6b", "8"]
    assert html.count("<blockquote>") == len(study["findings"]) == 8
    assert "A quick run" in html
    assert not re.search(r'(src|href)="', html.partition("<script>")[0])
    for table in re.findall(r"<table data-table.*?</table>", html, re.DOTALL):
        columns = len(re.findall("<th[ >]", table))
        widths = [
            sum(
                int(re.search(r'colspan="(\d+)"', cell)[1]) if "colspan" in cell else 1
                for cell in re.findall("<td[^>]*>", row)
            )
            for row in re.findall("<tr class=.*?</tr>", table, re.DOTALL)
        ]
        assert set(widths) == {columns}, table[:60]


@pytest.mark.parametrize(("values", "axis"), [([15.0, 0.1], "log"), ([17.8, 10.6], "linear")])
def test_a_criterion_within_one_decade_has_an_even_axis_whose_numbers_show(values, axis):
    curve = {"label": "SVD, full R", "frame": [1, 2], "criterion_arcsec": values}
    assert draw_criteria({"number": "6b", "curves": [curve]}).layout.yaxis.type == axis


def test_nought_is_printed_without_a_sign_and_powers_of_ten_are_raised():
    assert [printed_digits(value, 1e-3) for value in (-0.0002, 0.0, -0.0006)] == ["0.000", "0.000", "−0.001"]
    assert [number(value) for value in (1e-5, -2.5e-12, 1e8, 0.016, None)] == [
        "1·10⁻⁵", "−2.5·10⁻¹²", "1·10⁸", "0.016", "–",
    ]  # fmt: skip


def test_a_set_is_the_same_whenever_it_is_run_and_too_few_images_are_refused():
    once, again = (run_trial(Trial(7, 40, 10), None) for _ in range(2))
    assert once == again
    with pytest.raises(RefusedInputError, match="more than 20"):
        wu.run(wu.Plan(frames=20, sets=1, processes=1), None)


@pytest.mark.full
def test_the_paper_is_bettered_at_the_noise_that_its_tables_imply():
    records = [record for index in range(20) for record in run_trial(Trial(index, 2400, 100), None)]
    found = [
        record
        for record in records
        if (record["estimator"], record["weights"], record["noise_px"], record["magnitude_limit"])
        == ("svd-4-23", "full", 0.2, 5.5)
    ]
    assert len(found) == 20
    assert np.mean([record["A"][0] for record in found]) <= 0.15
    assert np.mean([record["B"][0] for record in found]) == pytest.approx(10.6, rel=0.02)
    assert 6 * 0.77 < np.mean([record["nees"] for record in found]) < 6 * 1.27  # chi-square of 120, 95 %
