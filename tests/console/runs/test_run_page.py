"""The run page."""

import csv
import io
import re
from dataclasses import asdict, replace
from itertools import pairwise

import pytest

from boresight.calibration.calibration import LeftOut, ProcessNoise, parse_calibration
from boresight.calibration.options import METHODS
from boresight.console.fleet.tables import Sensor
from boresight.console.pages.formats import symbols
from boresight.console.runs.pages.run import FORMER, PARTS, list_left_out, put_cause_first
from boresight.console.runs.queries import Line, write_event
from boresight.console.runs.tables import RUN_STATES, Run, RunEvent
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.telemetry.validation_age import explain_old_validation
from boresight.figures import CHAPTERS, FIGURES
from boresight.figures.charts.matching import GIVEN
from boresight.figures.example_calibration import get_example_calibrations
from boresight.figures.report import render_report
from boresight.figures.tables import parameter_rows, unseen_rows
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing, utc_after, utc_now
from boresight.platform.jobs.worker_news import WorkerState
from boresight.platform.web import static_files
from boresight.verdicts.answers import make_four_views, make_headline
from boresight.verdicts.numbers import duration
from boresight.verdicts.verdict import (
    NEVER,
    NOT_YET,
    PART_JUDGES,
    WORD_OF_LEVEL,
    PartVerdict,
    judge_parts,
    list_rms,
    make_verdict_marks,
    trust_marks,
)
from tests.figures.examined import matching, shadow, trust
from tests.sites import as_shown, codes, strip_tags

EXAMPLES = get_example_calibrations()


def test_the_head_says_the_verdict_and_the_weakest_direction_over_every_part(site, read, results):
    for part in ("result", "record"):
        text = read(site.visitor("victor").get(f"/runs/2?part={part}"))
        assert "consistent" in text
        assert results["sqrf"]["observability"]["weakest"]["sentence"] in text


def test_a_filter_that_lets_parameters_change_says_its_process_noise_and_where_that_is_from(site, read):
    noise = ProcessNoise(per="frame", source="usual", sentence="Drift: the usual one.")
    result = replace(EXAMPLES["batch"], process_noise=noise)
    run_id = site.add_run("batch", state="SUCCEEDED", result=result.to_dict())
    pages = (read(site.visitor("victor").get(f"/runs/{run_id}?part={part}")) for part in PARTS)
    assert any("Drift: the usual one." in page for page in pages)
    assert "Drift: the usual one." in render_report(result)


def test_the_parts_say_provenance_notes_and_the_set_that_was_made(site, read):
    ada = site.visitor("ada")
    text = read(ada.get("/runs/2?part=record"))
    for words in ("boresight calibrate", "--method sqrf", '"method": "sqrf"', "telemetry SHA-256"):
        assert words in text
    ada.post("/notes/runs/2", text="The sun was near.")
    assert "Record 1 note" in read(ada.get("/runs/2"))
    assert "The sun was near." in read(ada.get("/runs/2?part=record"))
    address = ada.post("/runs/1/parameter-set").headers["location"]
    assert f'href="{address}"' in ada.get("/runs/1")
    assert ada.post("/runs/1/parameter-set").headers["location"] == address  # opened instead of made again


def test_a_simulated_sensor_shows_the_truth_and_how_many_sigmas_off_it_is(site, read):
    text = read(site.visitor("victor").get("/runs/1"))
    assert "(new − truth) / σ" in text
    assert "16.0267" in text


def test_a_run_lists_what_it_assumed_and_what_the_data_say_of_the_noise(site, read):
    example = EXAMPLES["batch"]
    undeclared = replace(example.assumptions[0], declared=False, sentence="Nobody declared the readout.")
    applied = replace(example.noise.terms[0], needed=True, applied=True, sentence="Noise level: 1.2 times: applied.")
    noise = replace(example.noise, terms=[applied, *example.noise.terms[1:]], unavailable={"rate": "There is no rate."})
    result = replace(example, assumptions=[undeclared, *example.assumptions[1:]], noise=noise)
    run_id = site.add_run("batch", state="SUCCEEDED", result=result.to_dict())
    victor = site.visitor("victor")
    summary = read(victor.get(f"/runs/{run_id}"))
    assert "Nobody declared the readout." in summary
    assert all(one.sentence in summary for one in example.assumptions[1:])
    trust_part = read(victor.get(f"/runs/{run_id}?part=evidence"))
    assert "Noise level: 1.2 times: applied." in trust_part
    assert "There is no rate." in trust_part


def test_a_parameter_that_was_not_free_is_said_to_be_not_estimated_below_the_advice(site, results):
    result = {
        **results["batch"],
        "sigma": {**results["batch"]["sigma"], "a1_rad": None},
        "advice": ["Do not use this."],
    }
    run_id = site.add_run("batch", state="SUCCEEDED", result=result)
    page = site.visitor("victor").get(f"/runs/{run_id}")
    row = page[page.index("a1_rad</code></th>") :].split("</tr>")[0]
    assert "not estimated" in row
    assert row.count("–") >= 2
    assert page.index("Do not use this.") < page.index('id="parameters"')


def test_a_running_run_shows_its_partial_estimate_marked_partial_and_follows_the_stream(site, read, results):
    progress = {"fraction": 0.4, "message": "frame 16 of 40", "partial": results["sqrf-partial"]}
    run_id = site.add_run("sqrf", state="RUNNING", progress=progress, started_utc=utc_now(), attempt=1)
    page = site.visitor("victor").get(f"/runs/{run_id}")
    assert "PARTIAL" in read(page)
    assert "frame 16 of 40" in read(page)
    assert re.search(r"frame \d+ \d+ of \d+ ", " ".join(read(page).split()))
    assert "live-run.js" in page
    assert "data-follows" in page
    page = site.visitor("victor").get(f"/runs/{run_id}?part=evidence")
    assert NOT_YET in read(page)
    assert not list_figures(page) & {figure.name for figure in CHAPTERS["trust"] + CHAPTERS["matching"]}


@pytest.mark.parametrize(
    ("state", "columns", "said"),
    [
        ("FAILED", {"reason": "Every exposure has too few stars."}, "Every exposure has too few stars."),
        ("LOST", {"lease_until_utc": "2026-11-21T03:04:05.000000Z"}, "stopped reporting at 2026-325 03:04:05Z"),
        ("CANCELLED", {"reason": "Cancelled by Ada Analyst."}, "Cancelled by Ada Analyst."),
        ("CANCELLING", {"reason": "Cancelled by Ada Analyst."}, "Stopping: Cancelled by Ada Analyst."),
    ],
)
def test_a_run_without_a_result_says_what_happened_and_offers_no_parameter_set(site, read, state, columns, said):
    run_id = site.add_run(state=state, **columns)
    page = site.visitor("ada").get(f"/runs/{run_id}")
    assert said in read(page)
    assert "No verdict" in read(page)
    assert f'action="/runs/{run_id}/parameter-set"' not in page
    page = site.visitor("victor").get(f"/runs/{run_id}?part=evidence")
    for words in ("No examination: the run", "No matching: the run"):
        assert state == "CANCELLING" or f"{words} ended as {state}" in read(page)
    assert state == "CANCELLING" or not list_figures(page)


def test_the_log_is_shown_in_order_with_later_attempts_named(site, read):
    with open_writing(site.engine) as session:
        session.add(RunEvent(run_id=1, attempt=1, at_utc=utc_now(), kind="log", message="first words"))
        session.add(RunEvent(run_id=1, attempt=2, at_utc=utc_now(), kind="log", message="second words"))
    text = read(site.visitor("victor").get("/runs/1?part=record"))
    assert text.index("first words") < text.index("attempt 2") < text.index("second words")


def test_an_analyst_cancels_a_queued_run_and_it_says_who_did_and_why(site, read):
    run_id = site.add_run()
    ada = site.visitor("ada")
    assert 'name="reason" form="cancel-run"' in ada.get(f"/runs/{run_id}")
    assert ada.post(f"/runs/{run_id}/cancel", reason="Wrong set.").headers["location"] == f"/runs/{run_id}"
    text = read(ada.get(f"/runs/{run_id}"))
    assert re.search("Ada Analyst: Wrong set.", text)
    assert "was requested" in text


def test_a_viewer_sees_the_cancel_button_disabled_with_the_reason_and_is_refused(site):
    run_id = site.add_run()
    victor = site.visitor("victor")
    assert 'class="button-danger" disabled' in victor.get(f"/runs/{run_id}")
    victor.post(f"/runs/{run_id}/cancel")
    assert "role-missing" in codes(victor.get(f"/runs/{run_id}"))


def find_mark(result, name):
    return next(mark for mark in make_verdict_marks(parse_calibration(result)) if mark.name == name)


def test_a_filter_is_judged_by_its_innovations_and_a_batch_is_not(results):
    said = [find_mark(results[method], "nis").word for method in ("sqrf", "batch")]
    assert said == ["consistent", "not applicable"]


def test_a_filter_on_its_way_counts_the_frames_so_far_and_no_star_that_is_still_to_come(results):
    partial = results["sqrf-partial"]
    history = {**partial["history"], "frame": [7, 11]}
    on_its_way = parse_calibration({**partial, "frames": 200, "frames_done": 12, "history": history})
    fit = make_verdict_marks(on_its_way)[0]
    assert (fit.word, *re.findall(r"\d+", f"{fit.value} {fit.detail}")) == ("running", "11", "12", "200")
    batch = {**results["batch"], "status": "running", "frames_done": None, "frames": 200, "iterations": 3}
    fit = make_verdict_marks(parse_calibration(batch))[0]
    assert re.findall(r"\d+", f"{fit.value} {fit.detail}") == ["3", "200"]
    assert "stars" in make_verdict_marks(parse_calibration(results["sqrf"]))[0].detail


def test_no_validation_is_no_data_and_never_passes_and_noise_above_the_model_is_a_caution(results):
    mark = find_mark({**results["batch"], "validation": None}, "validation_rms")
    assert (mark.word, mark.level == "normal") == ("NOT TESTED", False)
    result = {**results["batch"], "chi2_per_dof": 3.0, "chi2": {**results["batch"]["chi2"], "consistent": False}}
    assert find_mark(result, "chi_square").level == "normal"  # its test is one of the family, which noticed nothing
    noticed = [{**test, "noticed": test["name"] == "chi_square"} for test in result["tests"]]
    for tests in (noticed, []):  # a result of an earlier version has its bounds alone
        mark = find_mark({**result, "tests": tests}, "chi_square")
        assert (mark.level, mark.word) == ("caution", "noise above model")


def test_an_estimate_far_from_the_truth_is_marked(results):
    sigma, found = results["batch"]["sigma"], results["batch"]["parameters"]
    truth = {name: value + 10 * (sigma[name] or 0) for name, value in found.items()}
    rows = parameter_rows(parse_calibration({**results["batch"], "truth": truth}))
    assert all(row.off_truth for row in rows)
    assert [row.error_over_sigma for row in rows] == pytest.approx([-10.0] * len(rows))


def test_rows_have_the_result_s_own_delta_in_the_model_s_order_however_the_store_sorted_them(results):
    batch = results["batch"]
    shuffled = {**batch, "parameters": dict(sorted(batch["parameters"].items()))}
    rows = parameter_rows(parse_calibration(shuffled))
    assert [row.name for row in rows] == list(batch["parameters"])
    assert [row.delta_over_sigma for row in rows] == pytest.approx(
        [batch["delta_over_sigma"][row.name] for row in rows]
    )


@pytest.fixture
def examined(site, results):
    made = examined_result(results["batch"])
    return made, site.add_run("batch", state="SUCCEEDED", result=made)


def examined_result(result, **changes):
    made = {"trust": {**trust(), **changes}, "matching": matching(), "shadow": shadow(), "evaluation": None}
    return {**result, **made}


def list_figures(page):
    return set(re.findall(r'<plot-figure src="/api/v1/runs/\d+/figures/([\w-]+)"', page))


def list_small_figures(page):
    return re.findall(r'<plot-figure small src="/api/v1/runs/\d+/figures/([\w-]+)\?size=small"', page)


@pytest.mark.parametrize("part", PARTS)
def test_a_part_draws_the_figures_of_its_chapters_and_folds_away_those_for_research(site, read, examined, part):
    page = site.visitor("victor").get(f"/runs/{examined[1]}?part={part}")
    own = [figure for chapter in PARTS[part].chapters for figure in CHAPTERS[chapter] if figure.name != "smoothed"]
    assert list_figures(page) == {figure.name for figure in own}
    folded = list_figures("".join(re.findall(r'<details class="advanced">.*?</details>\n', page, re.DOTALL)))
    assert folded <= {figure.name for figure in own if figure.advanced}
    for figure in own:
        assert f'href="/api/v1/runs/{examined[1]}/figures/{figure.name}/data' in page
        assert figure.guide.split(".")[0][:40] in read(page)
        before = page[: page.index(f'id="figure-{figure.name}"')]
        is_folded = before.rfind('<details class="advanced">') > before.rfind('<section class="panel" aria')
        assert is_folded or not figure.advanced
    assert re.findall('data-tab="([a-z]+)" aria-current="page"', page) == [part]


def test_of_the_evidence_the_answers_stand_open_and_the_research_is_folded_under_a_sentence_each(site, examined):
    page = site.visitor("victor").get(f"/runs/{examined[1]}?part=evidence")
    folds = re.findall(
        r'<details class="advanced"><summary>(.*?)<span class="quiet">(.*?)</span></summary>', page, re.DOTALL
    )
    assert len(folds) >= 5
    assert all(sentence.endswith(".") for _, sentence in folds)
    first = page.index('<details class="advanced">')
    assert page.index('id="figure-two-halves"') < page.index('id="examination-title"') < first
    shown = list_figures(re.sub(r'<details class="advanced">.*?</details>\n(?=<|$)', "", page, flags=re.DOTALL))
    assert {"two-halves", "residual-quiver"} <= shown


def test_every_chapter_of_figures_is_in_one_part():
    assert sorted(chapter for part in PARTS.values() for chapter in part.chapters) == sorted(CHAPTERS)
    assert sum(map(len, CHAPTERS.values())) == len(FIGURES)


@pytest.mark.parametrize("former", FORMER)
def test_an_older_address_leads_to_the_part_that_shows_the_same_with_its_view(site, former):
    answer = site.visitor("victor").send("GET", f"/runs/2?part={former}&tail_from=20")
    address, _, place = answer.headers["location"].partition("#")
    assert (answer.status_code, "tail_from=20" in address) == (303, True)
    page = site.visitor("victor").get(address)
    assert re.findall('data-tab="([a-z]+)" aria-current="page"', page) == [FORMER[former][0]]
    assert not place or f'id="{place}"' in page


def test_the_result_opens_on_four_views_each_with_its_answer_and_the_way_to_its_large_figure(site, read, results):
    page = site.visitor("victor").get("/runs/2")
    views = make_four_views(parse_calibration(results["sqrf"]))
    assert (
        list_small_figures(page) == [view.figure for view in views] == ["convergence", "rms", "radial", "observability"]
    )
    for view in views:
        assert read(f"<main>{symbols(view.answer.sentence)}</main>").strip() in read(page)
        assert f'href="/runs/2?part={view.part}#figure-{view.figure}"' in page
        assert f'id="figure-{view.figure}"' in site.visitor("victor").get(f"/runs/2?part={view.part}")


def test_the_line_of_the_verdict_has_the_worst_warning_and_how_many_more_there_are(site, results):
    run_id = site.add_run(state="SUCCEEDED", result={**results["batch"], "advice": ["One.", "Two.", "Three."]})
    page = site.visitor("victor").get(f"/runs/{run_id}")
    line, rest = page.split("<summary>")[1].split('id="parts"')[0].split("</summary>")
    warnings = make_headline(parse_calibration({**results["batch"], "advice": ["One.", "Two.", "Three."]})).warnings
    assert warnings[0] in line
    assert f"{len(warnings) - 1} more" in line
    assert all(warning in rest for warning in warnings)


def test_each_sentence_of_advice_leads_to_its_section_of_the_guide(site, results, monkeypatch, tmp_path):
    kept = static_files.folder
    monkeypatch.setattr(static_files, "folder", lambda name: tmp_path if name == "documentation" else kept(name))
    (tmp_path / "index.html").touch()
    said = {"advice": ["One.", "Two.", "Of before."], "advice_codes": ["few_frames", "cause_flaw", ""]}
    run_id = site.add_run(state="SUCCEEDED", result={**results["batch"], **said})
    page = site.visitor("victor").get(f"/runs/{run_id}")
    for sentence, anchor in (("One.", "advice-few-frames"), ("Two.", "advice-cause-flaw")):
        assert f'<span>{sentence} <a href="/docs/how-to/respond-to-advice.html#{anchor}">' in page
    assert "<span>Of before.</span>" in page


def test_the_next_step_of_a_run_is_to_make_a_set_then_to_open_it(site):
    ada = site.visitor("ada")
    assert re.search(r'class="next-act".*?action="/runs/1/parameter-set"', ada.get("/runs/1"), re.DOTALL)
    address = ada.post("/runs/1/parameter-set").headers["location"]
    assert re.search(rf'class="next-act".*?href="{address}#reason"', ada.get("/runs/1"), re.DOTALL)


def test_the_runs_before_and_after_are_one_step_away_in_the_same_part(site):
    last = site.add_run()
    page = site.visitor("victor").get("/runs/2?part=convergence")
    assert 'rel="prev" href="/runs/1?part=convergence"' in page
    assert f'rel="next" href="/runs/{last}?part=convergence"' in page
    assert 'rel="next"' not in site.visitor("victor").get(f"/runs/{last}")
    site.visitor("victor").get("/runs/999", status=404)


def test_the_view_of_a_part_is_in_its_address_and_goes_to_its_figures(site, read):
    victor = site.visitor("victor")
    page = victor.get("/runs/2?part=convergence&tail_from=20")
    assert "/figures/rms?tail_from=20" in page
    assert re.search("20 to 39", read(page))
    assert 'scale="linear"' in victor.get("/runs/2?part=convergence&scale=linear")
    assert "choose from" in victor.get("/runs/1?part=nonsense", status=404)


def test_the_tabs_say_how_their_parts_stand(site, examined):
    page = site.visitor("victor").get(f"/runs/{examined[1]}")
    told = {part: strip_tags(tab) for part, tab in re.findall(r'data-tab="(\w+)"[^>]*>(.*?)</a>', page, re.DOTALL)}
    ends = {"evidence": "2 warnings", "convergence": "converged", "observability": "known"}
    assert all(told[part].strip().endswith(end) for part, end in ends.items())


def test_a_tab_is_no_better_than_its_validation_set_however_much_better_the_fit_is(results):
    def judged(validation):
        return judge_parts(parse_calibration({**results["batch"], "validation": validation}))["convergence"]

    validation = results["sqrf"]["validation"]
    assert results["batch"]["rms_arc_rad"]["final"] < results["batch"]["rms_arc_rad"]["initial"]
    better, worse = ({"initial": 5e-5, "final": 3e-5}, {"initial": 3e-5, "final": 5e-5})
    assert judged(None) == judged({**validation, "rms_arc_rad": better}) == PartVerdict("normal", "converged")
    assert judged({**validation, "rms_arc_rad": worse}) == PartVerdict("serious", "validation worse")


def taken(name, begin, end):
    time = None if end is None else {"start_utc": begin, "end_utc": end}
    return TelemetrySet(name=name, quality={"time": time})


@pytest.mark.parametrize(
    ("ends", "explained"),
    [
        ("2026-03-01T07:00:00Z", True),
        ("2026-03-01T09:00:00Z", False),  # no longer before the run's begin than the run lasts
        (None, False),
    ],
)
def test_validation_frames_taken_long_before_the_data_are_said_to_be_older_by_how_much(ends, explained):
    fitted = [taken("A", f"2026-03-01T{hour}:00:00Z", f"2026-03-01T{hour + 1}:00:00Z") for hour in (10, 11)]
    said = explain_old_validation(fitted, taken("V", "2026-03-01T06:00:00Z", ends))
    assert ("V" in said, duration(3 * 3600) in said) == (explained, explained)
    assert not explain_old_validation(fitted, None)
    assert not explain_old_validation([*fitted, taken("B", "", None)], taken("V", "2026-03-01T06:00:00Z", ends))


@pytest.mark.parametrize(("final", "worse"), [(5e-5, True), (2e-5, False)])
def test_an_older_validation_set_stands_directly_before_the_warning_that_it_explains(results, final, worse):
    validation = {**results["sqrf"]["validation"], "rms_arc_rad": {"initial": 3e-5, "final": final}}
    told = make_headline(parse_calibration({**results["batch"], "validation": validation})).warnings
    said = put_cause_first(told, "OLD")
    assert [one for one in said if one != "OLD"] == list(told)
    assert [following.code for one, following in pairwise(said) if one == "OLD"] == ["validation_rms"] * worse
    assert put_cause_first(told, "") == told


def test_what_is_judged_of_a_run_is_a_part_of_its_page():
    assert set(PART_JUDGES) <= set(PARTS)


def test_every_sentence_of_the_examination_is_on_the_page(site, read, examined):
    result, run_id = examined
    text = read(site.visitor("victor").get(f"/runs/{run_id}?part=evidence"))
    for name in ("two_halves", "efficiency", "more_data", "nis_over_time", "whiteness"):
        assert as_shown(result["trust"][name]["sentence"]) in text
    assert as_shown(result["trust"]["drop_one_sentence"]) in text
    assert as_shown(result["trust"]["stars_sentence"]) in text


def test_every_test_of_the_model_and_every_cause_is_on_the_page_with_its_gate_and_remedy(site, read, results):
    noticed = {
        "name": "phase", "probability": 1e-9, "adjusted": 2e-8, "noticed": True, "effect": 1.25, "unit": "σ",
        "sentence": "Centroids depend on where in its pixel a star lies (p < 0.0001).",
    }  # fmt: skip
    sound = {**noticed, "name": "time", "probability": 0.4, "adjusted": 1.0, "noticed": False, "sentence": "No change."}
    cause = {"name": "phase", "likelihood": 0.97, "sentence": "Drawn.", "remedy": "Defocus.", "tests": ["phase"]}
    unseen = [
        {"name": "seam", "size_px": 0.25, "parameter": "g_y", "sigmas": 18.8},
        {"name": "tangential", "size_px": 1.6, "parameter": "m0_px", "sigmas": None},
        {"name": "lens", "size_px": 0.22, "parameter": "f_m", "sigmas": 33.4},
    ]
    made = {**examined_result(results["batch"], unseen=unseen), "tests": [sound, noticed], "causes": [cause]}
    page = site.visitor("victor").get(f"/runs/{site.add_run(state='SUCCEEDED', result=made)}?part=evidence")
    text = read(page)
    assert "phase 97" in text
    row = strip_tags(page.split('data-cause="phase"')[1].split("</tr>")[0])
    assert row.index("Drawn.") < row.index("Defocus.") < row.index("Pixel phase")
    assert text.index(noticed["sentence"]) < text.index(sound["sentence"])
    assert re.search(r"Pixel phase \S* ?deviation .*centroid-noise", text)
    assert re.search("deviates 1 of 2", text)
    assert 'data-tests="2"' in page
    rows = re.findall(r'data-unseen="(\w+)">(.*?)</tr>', page, re.DOTALL)
    assert [name for name, _ in rows] == ["tangential", "lens", "seam"]
    cells = [strip_tags(row).split()[-3:] for _, row in rows]
    assert cells == [["1.6", "m0_px", "–"], ["0.22", "f_m", "33"], ["0.25", "g_y", "19"]]


def test_suspect_stars_are_marked_by_shape_and_word_and_can_be_copied(site, examined):
    page = site.visitor("victor").get(f"/runs/{examined[1]}?part=evidence")
    assert 'data-copy="1000, 1017"' in page
    rows = {row.split("</th>")[0].rpartition(">")[2]: row for row in page.split("<tr>") if "data-value" in row}
    assert all("status-caution" in rows[star] and "suspect" in rows[star] for star in ("1000", "1017"))
    assert "suspect" not in rows["1034"]


def test_a_part_that_could_not_be_made_is_no_data_with_its_reason(site, read, results):
    why = {"two_halves": "Two halves of 3 frames are too few: use 20.", "stars": "No star has a number."}
    result = examined_result(results["batch"], two_halves=None, stars=None, suspects=[], unavailable=why)
    page = site.visitor("victor").get(f"/runs/{site.add_run(state='SUCCEEDED', result=result)}?part=evidence")
    text = read(page)
    assert re.search(f" NOT TESTED – {why['two_halves']}", text)
    assert text.count(why["stars"]) == 2
    assert "to-flag" not in page


def test_matching_shows_both_counts_starts_reasons_flags_and_the_view_of_flight(site, read, examined):
    text = read(site.visitor("victor").get(f"/runs/{examined[1]}?part=evidence"))
    for words in ("Kept 2 201", "Removed 32", "Added 2 265", "3: the matches settled", "41 doubles"):
        assert words in text
    assert shadow()["validation"]["summary"]["sentence"] in text
    for phrase in ("neighbouring frame 5", "no catalogue star is near 61", "fewer than three stars matched 2"):
        assert phrase in text
    assert "valid 398" not in text
    assert "Frames available 46.0 % 100.0 %" in text
    assert "420 µrad" in text


def test_removed_stars_are_a_table_with_reason_and_probability_and_a_file(site, read, results):
    one = {"frame": 12, "exposure": 1, "row": 345, "star_id": 4567, "reason": "it lies too far", "probability": 1e-30}
    removed = [one, {**one, "row": 346, "star_id": None, "probability": None}]
    result = {**results["batch"], "removed": removed, "removed_of": {"proposed": 5000, "removed": 2}}
    run_id, victor = site.add_run("batch", state="SUCCEEDED", result=result), site.visitor("victor")
    text = read(victor.get(f"/runs/{run_id}?part=evidence"))
    assert re.search(r"2 of 5\W?000 ", text)
    assert re.search(f"345 12 1 4567 {one['reason']} (<|&lt;) 1·10⁻¹²", text)
    assert f"346 12 1 – {one['reason']} –" in text
    lines = victor.get(f"/api/v1/runs/{run_id}/removed/data").splitlines()
    assert lines[0] == "row,frame,exposure,star_id,reason,probability"
    assert lines[1].startswith(f"345,12,1,4567,{one['reason']},1e-30")
    assert len(lines) == 3


def test_a_result_from_before_the_examination_says_how_to_have_one(site, read, results):
    old = {name: said for name, said in results["batch"].items() if name not in ("trust", "matching", "shadow")}
    run_id = site.add_run("batch", state="SUCCEEDED", result=old)
    victor = site.visitor("victor")
    assert NEVER in read(victor.get(f"/runs/{run_id}?part=evidence"))
    assert GIVEN in read(victor.get(f"/runs/{run_id}?part=evidence"))


FREE = WorkerState(turns=True, connected=True, threads=2, tasks=1)
HALF = {"fraction": 0.43, "message": "frame 17: 17 of 40 frames", "elapsed_s": 8.6}


def said_by(page, code):
    """Return the text of the notice with a code."""
    return strip_tags(page.split(f'data-code="{code}"', 1)[1].partition(">")[2].split("</div>")[0])


@pytest.fixture
def tell(site):
    def write(run_id, line, *, at_utc=None):
        with open_writing(site.engine) as session:
            session.add(RunEvent(run_id=run_id, attempt=1, at_utc=at_utc or utc_now(), **asdict(line)))

    return write


@pytest.mark.parametrize(
    ("workers", "code", "numbers"),
    [
        (WorkerState(), "no-workers", []),
        (replace(FREE, turns=False), "no-workers", []),
        (replace(FREE, connected=False), "no-worker-connected", []),
        (replace(FREE, threads=0), "no-worker-connected", []),
        (FREE, "worker-free", []),
        (replace(FREE, tasks=2), "workers-busy", ["2", "{busy}"]),
        (replace(FREE, tasks=1, threads=1), "workers-busy", ["{busy}"]),
    ],
)
def test_a_queued_run_says_its_position_and_what_it_waits_for(site, workers, code, numbers):
    busy = site.add_run(state="RUNNING", started_utc=utc_now())
    first, second = site.add_run(), site.add_run()
    site.app.state.workers.state = lambda: workers
    shown = [said_by(site.visitor("victor").get(f"/runs/{run_id}"), code) for run_id in (first, second)]
    waits = [number.format(busy=busy) for number in numbers]
    assert [re.findall(r"\d+", sentence) for sentence in shown] == [waits, ["2", *waits]]


def test_a_run_that_is_computed_again_says_why(site, read, tell):
    run_id = site.add_run(state="RUNNING", attempt=2, started_utc=utc_now())
    tell(run_id, replace(Line.queued_again("its server host/1 stopped reporting"), message="in other words"))
    text = read(site.visitor("victor").get(f"/runs/{run_id}"))
    assert re.search("Attempt 1 .*: its server host/1 stopped", text)
    assert "attempt 2" in text


def test_a_filter_says_its_pace_and_what_is_left_and_a_batch_only_its_time(site, read):
    columns = {"state": "RUNNING", "progress": HALF | {"at_utc": utc_now()}, "attempt": 1, "started_utc": utc_now()}
    filtered, batch = (site.add_run(method, **columns) for method in ("sqrf", "batch"))
    victor = site.visitor("victor")
    pace = re.search("data-run-pace>([^<]*)", victor.get(f"/runs/{filtered}"))[1]
    assert re.findall(r"[\d.]+ ?\S+", pace.replace("\u202f", " ")) == ["2.0 frames/s,", "11 s"]
    text = read(victor.get(f"/runs/{batch}"))
    assert "8.6 s" in text
    assert "frames/s" not in text


def test_a_page_says_how_long_ago_a_run_was_heard_of_and_asked_to_stop(site, tell):
    silent, heard = (HALF | {"at_utc": utc_after(-ago_s)} for ago_s in (45.0, 7.0))
    columns = {"state": "RUNNING", "started_utc": utc_after(-90.0), "attempt": 1}
    victor = site.visitor("victor")
    page = victor.get(f"/runs/{site.add_run('sqrf', progress=silent, **columns)}")
    assert re.search(r" (4[5-9]|5\d) s\.", said_by(page, "silent"))
    page = victor.get(f"/runs/{site.add_run(progress=heard, **columns)}")
    assert 7.0 <= float(page.partition('data-heard="')[2].partition('"')[0]) < 17.0
    run_id = site.add_run(state="CANCELLING", reason="Cancelled by Ada Analyst: wrong set.", started_utc=utc_now())
    tell(run_id, Line.moved("CANCELLING", "Cancelled by Ada Analyst: wrong set."), at_utc=utc_after(-12.0))
    stopping = said_by(victor.get(f"/runs/{run_id}"), "stopping")
    assert re.search(r"Ada Analyst: wrong set\..* 1[2-9] s ago", stopping)


def test_a_lost_run_says_when_it_was_last_heard_of_and_offers_to_run_it_again(site):
    progress = HALF | {"at_utc": "2026-11-21T03:04:05.000000Z"}
    run_id = site.add_run("sqrf", state="LOST", progress=progress, reason="Ended after 3 lost attempts.")
    page = site.visitor("ada").get(f"/runs/{run_id}")
    assert re.search("2026-325 03:04:05Z; .*Ended after 3 lost attempts", said_by(page, "lost"))
    assert re.search(r"PARTIAL: .* 43 % \(frame 17: 17 of 40 frames\)", said_by(page, "partial"))
    assert f'href="/runs/new?clone={run_id}">' in page


def test_a_failed_run_shows_its_cause_the_end_of_its_log_and_the_next_step(site, read, tell):
    run_id = site.add_run(state="FAILED", reason="Its telemetry is gone.")
    for k in range(9):
        tell(run_id, Line.log(f"step {k}"))
    tell(run_id, Line.moved("FAILED", "Its telemetry is gone."))
    page = site.visitor("ada").get(f"/runs/{run_id}")
    text = read(page)
    assert said_by(page, "failed").startswith("Its telemetry is gone.")
    assert text.count("Its telemetry is gone.") == 1
    assert "<summary" not in page.split('id="verdict"')[1].split('id="parts"')[0], "a fold with nothing in it"
    assert [f"step {k}" in text for k in range(9)] == [False] * 4 + [True] * 5
    assert f'href="/runs/{run_id}?part=record#log"' in page
    assert 'href="/telemetry/1">Quality report' in page


@pytest.mark.parametrize("declared", [{}, {"declared": {"directions": "j2000"}}])
def test_a_run_that_failed_for_want_of_times_offers_an_upload_and_never_the_same_set_again(site, declared):
    missing = {
        "code": "TIME_MISSING",
        "severity": "SERIOUS",
        "sentence": "760 matched stars are not used.",
        "count": 760,
    }
    with open_writing(site.engine) as session:
        row = session.get_known(TelemetrySet, 1)
        row.quality = row.quality | {"time": None, "findings": [] if declared else [missing]}
        audit.append(session, COMMAND_LINE, "checked", "telemetry-sets/1")
        document = session.get_known(Sensor, 1).document | declared
    run_id = site.add_run(state="FAILED", reason="No star has a direction.", sensor_document=document)
    page = site.visitor("ada").get(f"/runs/{run_id}")
    assert page.count('href="/telemetry?sensor=1#upload-title"') >= 2  # as the remedy, and as the next step
    assert f"clone={run_id}" not in page
    assert "upload-with-times" in codes(page)
    lost = site.add_run(state="LOST", sensor_document=document)
    assert f"clone={lost}" in site.visitor("ada").get(f"/runs/{lost}")  # it may have been the worker


def test_a_row_says_how_much_the_rms_fell_in_microradians(site, read, results):
    house_page = read(site.visitor("victor").get("/runs"))
    rms = results["batch"]["rms_arc_rad"]
    assert f"{rms['initial'] * 1e6:.1f} → {rms['final'] * 1e6:.2f}" in house_page
    assert f"{100 * (rms['final'] / rms['initial'] - 1):.1f}".lstrip("-") in house_page
    assert "SUCCEEDED" in house_page
    assert "converged" in house_page


def test_lists_print_the_rms_with_the_interval_of_the_run_s_page_and_an_older_row_without(site, results):
    result = parse_calibration(results["batch"])
    before, after = list_rms(result.evaluation, result.rms_arc_rad, result.pairs)
    interval = after[after.index("(") :]
    assert f"{before} → {after} µrad" in strip_tags(site.visitor("victor").get("/runs/1"))

    def rows() -> list[str]:
        pages = [site.visitor("victor").get(path) for path in ("/runs", "/sensors/1", "/telemetry/1")]
        return [re.search(r'<tr>(?:(?!</tr>).)*"/runs/1".*?</tr>', page, re.DOTALL)[0] for page in pages]

    for row in rows():
        assert f'title="{before} → {after} µrad"' in row
        assert f">{interval}</small>" in row
    with open_writing(site.engine) as session:
        run = session.get_one(Run, 1)
        run.summary = {name: value for name, value in run.summary.items() if not name.endswith("_interval_rad")}
        audit.append(session, COMMAND_LINE, "made older", "runs/1")
    for row in rows():
        assert f'title="{before.split()[0]} → {after.split()[0]} µrad"' in row
        assert interval not in row


def test_a_fit_with_advice_is_a_caution_in_the_list_with_the_advice_at_hand(site, results):
    doubted = results["batch"] | {"advice": ["Too few frames took part."]}
    site.add_run(state="SUCCEEDED", result=doubted)
    page = site.visitor("victor").get("/runs")
    cell = page[page.index('title="Too few frames took part."') :][:400].split("</td>")[0]
    assert WORD_OF_LEVEL["caution"] in cell
    assert "status-caution" in cell
    page = site.visitor("victor").get("/sensors/1")
    assert WORD_OF_LEVEL["caution"] in page
    assert WORD_OF_LEVEL["caution"] not in site.visitor("victor").send("GET", "/runs.csv").text


def test_filters_leave_out_the_runs_that_do_not_fit(site, read):
    site.add_run("sqrf", state="FAILED", reason="No stars.", label="the poor one")
    page = site.visitor("victor").get("/runs?state=FAILED&method=sqrf")
    assert "the poor one" in read(page)
    assert "reference" not in read(page)
    assert "<option selected>FAILED" in page
    assert 'class="empty"' in site.visitor("victor").get("/runs?state=LOST")


@pytest.mark.parametrize("query", ["sensor=abc", "state=NONSENSE", "method=", "before=x"])
def test_an_address_with_nonsense_shows_the_whole_list(site, query, read):
    assert "#1" in read(site.visitor("victor").get(f"/runs?{query}"))


def test_a_second_page_begins_where_the_first_ended(site):
    for number in range(55):
        site.add_run(label=f"many-{number}")
    page = site.visitor("victor").get("/runs")
    assert "many-54" in page
    assert "many-0<" not in page
    address = page.split('rel="next"')[0].rsplit('href="', 1)[1].split('"')[0].replace("&amp;", "&")
    older = site.visitor("victor").get(address)
    assert "many-0<" in older
    assert "many-54" not in older


def test_the_csv_has_every_run_in_si_and_no_formula(site, results):
    site.add_run(label="=cmd()")
    answer = site.visitor("victor").send("GET", "/runs.csv")
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert answer.headers["content-type"].startswith("text/csv")
    assert [row["run"] for row in rows] == ["3", "2", "1"]
    assert rows[0]["label"] == "'=cmd()"
    assert float(rows[2]["rms_final_arc_rad"]) == results["batch"]["rms_arc_rad"]["final"]


LINES = [
    (Line.moved("QUEUED"), "QUEUED", "info"),
    (Line.begun(1, "host/1"), "RUNNING: attempt 1 on host/1", "info"),
    (Line.log("10 %: frame 4: 4 of 40 frames", {"fraction": 0.1}), "10 %: frame 4: 4 of 40 frames", "info"),
    (Line.attempt_ended(1, "its server was stopped", is_lost=False), "Attempt 1: its server was stopped", "warning"),
    (Line.queued_again("its server was stopped"), "QUEUED again: its server was stopped", "warning"),
    (Line.attempt_ended(2, "its worker process died", is_lost=True), "Attempt 2: its worker process died", "error"),
    (Line.log("Traceback:\n  <b>1</b> / 0", level="error"), "Traceback:\n  <b>1</b> / 0", "error"),
    (Line.moved("CANCELLING", "Cancelled by Ada."), "CANCELLING: Cancelled by Ada.", "warning"),
    (Line.moved("FAILED", "given up"), "FAILED: given up", "error"),
]


@pytest.fixture
def run_id(site):
    made = site.add_run(state="FAILED", reason="given up")
    with open_writing(site.engine) as session:
        for line, *_ in LINES:
            write_event(session, made, 1, line)
    return made


def shown(page):
    return re.findall(r'<li data-line="\d+" data-level="(\w+)"', page)


@pytest.mark.parametrize(("line", "message", "level"), LINES)
def test_a_line_has_its_sentence_and_how_grave_it_is(line, message, level):
    assert (line.message, line.level) == (message, level)


def test_the_api_gives_what_a_line_says_as_fields_too(site, run_id):
    lines = site.visitor("victor").send("GET", f"/api/v1/runs/{run_id}/log").json()["items"]
    told = [(line["state"], line["cause"], line["level"], line["numbers"]) for line in lines]
    assert told == [(line.state, line.cause, line.level, line.numbers) for line, *_ in LINES]


@pytest.mark.parametrize("state", RUN_STATES)
def test_every_end_without_a_result_is_more_than_information(state):
    grave = Line.moved(state).level != "info"
    assert grave is (state in {"FAILED", "LOST", "CANCELLED", "CANCELLING"})


def test_the_filter_is_in_the_address_and_each_choice_says_how_many_lines_it_has(site, run_id):
    victor = site.visitor("victor")
    assert shown(victor.get(f"/runs/{run_id}?part=record")) == [level for *_, level in LINES]
    page = victor.get(f"/runs/{run_id}?part=record&level=error")
    assert shown(page) == ["error"] * 3
    assert re.findall(r'data-lines="(\d+)"', page) == ["9", "6", "3"]
    assert f'href="/runs/{run_id}/log" download' in page


def test_a_level_that_is_none_is_refused_and_one_without_lines_is_empty(site, run_id):
    site.visitor("victor").get(f"/runs/{run_id}?part=record&level=loud", status=422)
    site.visitor("victor").get(f"/runs/{run_id}/log/lines?level=loud", status=422)
    page = site.visitor("victor").get("/runs/1?part=record&level=error")  # which nothing in this log is
    assert "<li" not in page.split('<ol class="log"')[1].split("</ol>")[0]


def test_a_page_that_follows_gets_only_the_lines_after_its_last(site, run_id):
    victor = site.visitor("victor")
    page = victor.get(f"/runs/{run_id}/log/lines")
    assert "&lt;b&gt;1&lt;/b&gt; / 0" in page  # what a log says is text
    numbers = re.findall(r'data-line="(\d+)"', page)
    later = victor.get(f"/runs/{run_id}/log/lines?after={numbers[5]}&level=warning")
    assert re.findall(r'data-line="(\d+)"', later) == numbers[6:]
    assert victor.get(f"/runs/{run_id}/log/lines?after={numbers[-1]}").strip() == ""


def test_a_label_that_is_only_the_method_is_not_said_twice_and_compare_names_the_sensor(site, results):
    title = METHODS["sqrf"].title
    repeated, own = (
        site.add_run("sqrf", state="SUCCEEDED", result=results["sqrf"], label=label)
        for label in (title, "After refocusing")
    )
    victor = site.visitor("victor")
    head = victor.get(f"/runs/{repeated}").partition('class="page-head"')[2].partition('class="actions"')[0]
    assert head.count(title) == 1
    assert "After refocusing" in victor.get(f"/runs/{own}").partition("</h1>")[0]
    assert f'title="{title}">{title}' not in victor.get("/runs")
    with open_reading(site.engine) as session:
        sensor = session.get_one(Sensor, session.get_one(Run, own).sensor_id).name
    page = victor.get(f"/compare?runs={repeated},{own}")
    heads = re.findall(r'<th scope="row"[^>]*><a href="/runs/\d+">#\d+</a> ([^<]*)</th>', page)
    assert heads == [sensor, f"{sensor}: After refocusing"]
    legend = victor.send("GET", f"/api/v1/runs/{repeated}/figures/rms").text
    assert sensor in legend
    assert title not in legend


def test_the_evidence_tab_claims_no_more_than_its_tests(results):
    result = parse_calibration(results["batch"])
    marks = trust_marks(result)
    assert not any(mark.reason for mark in marks)
    assert judge_parts(result)["evidence"].word == marks[0].word
    assert any(row.numbers[1] is None or row.numbers[1] > 0 for row in unseen_rows(result))


def test_counts_say_what_they_count(results):
    result = parse_calibration(results["sqrf"])
    fit = make_verdict_marks(result)[0]
    assert {str(result.iterations), str(result.frames)} <= set(re.findall(r"\d+", fit.value))
    lost = replace(result, left_out=[LeftOut(what="exposures", count=3, reason="too few stars")], exposures=397)
    assert [re.findall(r"\d+", one) for one in list_left_out(lost)] == [["3", "400"]]
    some = LeftOut(what="exposures", count=2, reason="on one line")
    assert [re.findall(r"\d+", one) for one in list_left_out(replace(lost, left_out=[*lost.left_out, some]))] == [
        ["3", "402"],
        ["2", "402"],
    ]
