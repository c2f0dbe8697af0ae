"""The parts of the run page: trust and matching, each in every state."""

import re

import pytest

from boresight.console.runs.pages.run import TITLES
from boresight.figures import CHAPTERS, FIGURES
from boresight.platform.db.sessions import utc_now
from tests.figures.examined import matching, shadow, trust


@pytest.fixture
def examined(site, results):
    made = examined_result(results["batch"])
    return made, site.add_run("batch", state="SUCCEEDED", result=made)


def examined_result(result, **changes):
    sigma = {name: value or 1.0 for name, value in result["sigma"].items()}
    return {
        **result,
        "trust": {**trust(sigma), **changes},
        "matching": matching(),
        "shadow": shadow(),
        "evaluation": None,
    }


def figures_of(page):
    return set(re.findall(r'<plot-figure src="/api/v1/runs/\d+/figures/([\w-]+)"', page))


@pytest.mark.parametrize("part", TITLES)
def test_a_part_draws_its_own_figures_and_no_others(site, examined, part):
    page = site.visitor("victor").get(f"/runs/{examined[1]}?part={part}")
    assert figures_of(page) == {figure.name for figure in CHAPTERS.get(part, ())}
    assert re.findall('data-tab="([a-z]+)" aria-current="page"', page) == [part]


def test_the_tabs_hold_every_figure_and_each_once():
    assert set(CHAPTERS) <= set(TITLES)
    assert sum(map(len, CHAPTERS.values())) == len(FIGURES)


def test_an_older_link_to_the_estimate_opens_the_summary(site, examined):
    page = site.visitor("victor").get(f"/runs/{examined[1]}?part=estimate")
    assert 'data-tab="summary" aria-current="page"' in page


def test_every_figure_has_its_guide_and_its_numbers(site, read, examined):
    victor = site.visitor("victor")
    for part, figures in CHAPTERS.items():
        page = victor.get(f"/runs/{examined[1]}?part={part}")
        for figure in figures:
            assert f'href="/api/v1/runs/{examined[1]}/figures/{figure.name}/data' in page
            assert figure.guide.split(".")[0][:40] in read(page)


def test_the_runs_before_and_after_are_one_step_away_in_the_same_part(site):
    last = site.add_run()
    page = site.visitor("victor").get("/runs/2?part=rms")
    assert 'rel="prev" href="/runs/1?part=rms"' in page
    assert f'rel="next" href="/runs/{last}?part=rms"' in page
    assert 'rel="next"' not in site.visitor("victor").get(f"/runs/{last}")


def test_the_tabs_say_how_trust_and_matching_stand(site, read, examined):
    text = read(site.visitor("victor").get(f"/runs/{examined[1]}"))
    assert "Trust 2 doubts" in text
    assert "Matching rested" in text
    assert "Convergence settled" in text
    assert "Observability seen" in text


def test_the_view_of_a_part_is_in_its_address_and_goes_to_its_figures(site, read):
    page = site.visitor("victor").get("/runs/2?part=rms&tail_from=20")
    assert "/figures/rms?tail_from=20" in page
    assert "frame 20 to 39" in read(page)
    assert 'scale="linear"' in site.visitor("victor").get("/runs/2?part=convergence&scale=linear")


def test_the_observability_part_says_which_data_would_help(site, read):
    text = read(site.visitor("victor").get("/runs/2?part=observability"))
    assert "Which data would help" in text
    assert "Weakest direction" in text


def test_a_note_is_counted_on_its_tab_and_read_in_its_part(site, read):
    ada = site.visitor("ada")
    ada.post("/notes/runs/2", text="The sun was near.")
    assert "Notes 1" in read(ada.get("/runs/2"))
    assert "The sun was near." in read(ada.get("/runs/2?part=notes"))


def test_every_sentence_of_the_examination_is_on_the_page(site, read, examined):
    result, run_id = examined
    text = read(site.visitor("victor").get(f"/runs/{run_id}?part=trust"))
    for name in ("two_halves", "efficiency", "more_data", "nis_over_time", "whiteness"):
        assert result["trust"][name]["sentence"] in text
    assert result["trust"]["drop_one_sentence"] in text
    assert result["trust"]["stars_sentence"] in text


def test_suspect_stars_are_marked_by_shape_and_word_and_can_be_copied(site, examined):
    page = site.visitor("victor").get(f"/runs/{examined[1]}?part=trust")
    assert 'data-copy="1000, 1017"' in page
    rows = {row.split("</th>")[0].rpartition(">")[2]: row for row in page.split("<tr>") if "data-value" in row}
    assert all("status-caution" in rows[star] and "suspect" in rows[star] for star in ("1000", "1017"))
    assert "suspect" not in rows["1034"]


def test_a_part_that_could_not_be_made_is_no_data_with_its_reason(site, read, results):
    why = {"two_halves": "Two halves of 3 frames are too few: use 20.", "stars": "No star has a number."}
    result = examined_result(results["batch"], two_halves=None, stars=None, suspects=[], unavailable=why)
    text = read(site.visitor("victor").get(f"/runs/{site.add_run(state='SUCCEEDED', result=result)}?part=trust"))
    assert re.search(f"Two halves NO DATA – {why['two_halves']}", text)
    assert text.count(why["stars"]) == 2
    assert "Copy the stars to flag" not in text


def test_matching_shows_both_counts_starts_reasons_flags_and_the_view_of_flight(site, read, examined):
    text = read(site.visitor("victor").get(f"/runs/{examined[1]}?part=matching"))
    for words in ("Kept 2 201", "Removed 32", "Added 2 265", "3: the matches rested", "41 doubles"):
        assert words in text
    assert shadow()["validation"]["summary"]["sentence"] in text
    for phrase in ("neighbouring frame 5", "no catalogue star is near 61", "fewer than three stars matched 2"):
        assert phrase in text
    assert "valid 398" not in text
    assert "Frames available 46.0 % 100.0 %" in text
    assert "420 µrad" in text


def test_a_result_from_before_the_examination_says_how_to_have_one(site, read, results):
    old = {**results["batch"], "trust": None, "matching": None, "shadow": None}
    run_id = site.add_run("batch", state="SUCCEEDED", result=old)
    victor = site.visitor("victor")
    assert "clone its run and start it again" in read(victor.get(f"/runs/{run_id}?part=trust"))
    assert "used the matches it was given" in read(victor.get(f"/runs/{run_id}?part=matching"))


def test_a_running_run_says_that_trust_comes_at_its_end_and_draws_nothing(site, read, results):
    progress = {"fraction": 0.4, "partial": {**results["sqrf-partial"], "trust": None, "matching": None}}
    run_id = site.add_run("sqrf", state="RUNNING", progress=progress, started_utc=utc_now(), attempt=1)
    page = site.visitor("victor").get(f"/runs/{run_id}?part=trust")
    assert "Trust is examined when the run ends" in read(page)
    assert not figures_of(page)


@pytest.mark.parametrize(("part", "said"), [("trust", "No examination: the run"), ("matching", "No matching: the run")])
def test_a_failed_run_has_neither(site, read, part, said):
    page = site.visitor("victor").get(f"/runs/{site.add_run(state='FAILED', reason='No stars.')}?part={part}")
    assert f"{said} ended as FAILED" in read(page)
    assert not figures_of(page)


def test_a_part_that_does_not_exist_is_not_found(site):
    assert "choose from" in site.visitor("victor").get("/runs/1?part=nonsense", status=404)
