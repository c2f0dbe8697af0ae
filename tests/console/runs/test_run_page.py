"""The run page."""

import re

import pytest

from boresight.console.runs.tables import RunEvent
from boresight.figures.tables import parameter_rows
from boresight.platform.db.sessions import open_writing, utc_now
from boresight.verdicts.verdict import make_verdict_marks


def test_the_head_says_the_verdict_and_the_weakest_direction_over_every_part(site, read, results):
    for part in ("summary", "log"):
        text = read(site.visitor("victor").get(f"/runs/2?part={part}"))
        assert "consistent" in text
        assert results["sqrf"]["observability"]["weakest"]["sentence"] in text


def test_the_provenance_has_the_command_the_settings_and_the_hashes(site, read):
    text = read(site.visitor("victor").get("/runs/2?part=provenance"))
    assert "boresight calibrate" in text
    assert "--method sqrf" in text
    assert '"method": "sqrf"' in text
    assert "telemetry SHA-256" in text


def test_a_simulated_sensor_shows_the_truth_and_how_many_sigmas_off_it_is(site, read):
    text = read(site.visitor("victor").get("/runs/1"))
    assert "(new − truth) / σ" in text
    assert "16.0267" in text


def test_a_parameter_that_was_not_free_is_said_to_be_not_estimated(site, results):
    result = {**results["batch"], "sigma": {**results["batch"]["sigma"], "a1_rad": None}}
    run_id = site.add_run("batch", state="SUCCEEDED", result=result)
    page = site.visitor("victor").get(f"/runs/{run_id}")
    row = page[page.index("a1_rad</code></th>") :].split("</tr>")[0]
    assert "not estimated" in row
    assert "—" in row


def test_advice_stands_above_the_parameters(site, results):
    result = {**results["batch"], "advice": ["Do not use this."]}
    page = site.visitor("victor").get(f"/runs/{site.add_run('batch', state='SUCCEEDED', result=result)}")
    assert page.index("Do not use this.") < page.index('id="parameters"')


def test_a_queued_run_says_its_position(site, read):
    site.add_run()
    second = site.add_run()
    assert "Position 2 in the queue." in read(site.visitor("victor").get(f"/runs/{second}"))


def test_a_running_run_shows_its_partial_estimate_marked_partial_and_follows_the_stream(site, read, results):
    progress = {"fraction": 0.4, "message": "frame 16 of 40", "partial": results["sqrf-partial"]}
    run_id = site.add_run("sqrf", state="RUNNING", progress=progress, started_utc=utc_now(), attempt=1)
    page = site.visitor("victor").get(f"/runs/{run_id}")
    assert "PARTIAL" in read(page)
    assert "frame 16 of 40" in read(page)
    assert re.search(r"as of frame \d+ \d+ of \d+ frames so far", " ".join(read(page).split()))
    assert "live-run.js" in page
    assert "data-follows" in page


@pytest.mark.parametrize(
    ("state", "columns", "said"),
    [
        (
            "FAILED",
            {"reason": "Every exposure has fewer than four stars."},
            "Every exposure has fewer than four stars.",
        ),
        (
            "LOST",
            {"lease_until_utc": "2026-11-21T03:04:05.000000Z"},
            "The worker stopped reporting at 2026-11-21 03:04:05Z",
        ),
        ("CANCELLED", {"reason": "Cancelled by Ada Analyst."}, "Cancelled by Ada Analyst."),
        ("CANCELLING", {"reason": "Cancelled by Ada Analyst."}, "Stopping: Cancelled by Ada Analyst."),
    ],
)
def test_a_run_without_a_result_says_what_happened_and_offers_no_parameter_set(site, read, state, columns, said):
    page = site.visitor("ada").get(f"/runs/{site.add_run(state=state, **columns)}")
    assert said in read(page)
    assert "No verdict" in read(page)
    assert "Create parameter set" not in page


def test_the_log_is_shown_in_order_with_later_attempts_named(site, read):
    with open_writing(site.engine) as session:
        session.add(RunEvent(run_id=1, attempt=1, at_utc=utc_now(), kind="log", message="first words"))
        session.add(RunEvent(run_id=1, attempt=2, at_utc=utc_now(), kind="log", message="second words"))
    text = read(site.visitor("victor").get("/runs/1?part=log"))
    assert text.index("first words") < text.index("attempt 2") < text.index("second words")


def test_an_analyst_cancels_a_queued_run_and_it_says_who_did(site, read):
    run_id = site.add_run()
    ada = site.visitor("ada")
    assert ada.post(f"/runs/{run_id}/cancel").headers["location"] == f"/runs/{run_id}"
    text = read(ada.get(f"/runs/{run_id}"))
    assert "Cancelled by Ada Analyst." in text
    assert "asked to stop" in text


def test_a_viewer_sees_the_cancel_button_disabled_with_the_reason_and_is_refused(site, read):
    run_id = site.add_run()
    victor = site.visitor("victor")
    assert 'class="button-danger" disabled' in victor.get(f"/runs/{run_id}")
    victor.post(f"/runs/{run_id}/cancel")
    assert "This needs the role analyst" in read(victor.get(f"/runs/{run_id}"))


def test_a_parameter_set_made_from_a_run_is_opened_instead_of_made_again(site):
    ada = site.visitor("ada")
    address = ada.post("/runs/1/parameter-set").headers["location"]
    assert f'href="{address}"' in ada.get("/runs/1")
    assert ada.post("/runs/1/parameter-set").headers["location"] == address


def test_a_form_without_the_token_changes_nothing(site):
    ada = site.visitor("ada")
    assert ada.send("POST", "/runs/1/parameter-set").status_code == 403


def test_a_run_that_does_not_exist_is_not_found(site):
    site.visitor("victor").get("/runs/999", status=404)


def test_a_filter_is_judged_by_its_innovations_and_a_batch_is_not(results):
    by_question = {mark.question: mark for mark in make_verdict_marks(results["sqrf"])}
    assert by_question["Innovations (NIS)"].word == "consistent"
    assert {mark.question: mark for mark in make_verdict_marks(results["batch"])}[
        "Innovations (NIS)"
    ].word == "not applicable"


def test_a_filter_on_its_way_counts_the_frames_so_far_and_no_star_that_is_still_to_come(results):
    partial = results["sqrf-partial"]
    fit = make_verdict_marks(
        {**partial, "frames": 200, "frames_done": 12, "history": {**partial["history"], "frame": [7, 11]}}
    )[0]
    assert (fit.word, fit.value, fit.detail) == ("running", "as of frame 11", "12 of 200 frames so far")
    batch = {**results["batch"], "status": "running", "frames_done": None, "frames": 200, "iterations": 3}
    assert (make_verdict_marks(batch)[0].value, make_verdict_marks(batch)[0].detail) == (
        "as of iteration 3",
        "200 frames in all",
    )
    assert "stars" in make_verdict_marks(results["sqrf"])[0].detail


def test_no_validation_is_no_data_and_never_passes(results):
    mark = next(
        mark
        for mark in make_verdict_marks({**results["batch"], "validation": None})
        if mark.question == "Validation RMS"
    )
    assert mark.word == "NO DATA"
    assert mark.level != "normal"


def test_noise_above_the_model_is_a_caution(results):
    result = {**results["batch"], "chi2_per_dof": 3.0, "chi2": {**results["batch"]["chi2"], "consistent": False}}
    mark = next(mark for mark in make_verdict_marks(result) if mark.question.startswith("χ²"))
    assert (mark.level, mark.word) == ("caution", "noise above model")


def test_delta_over_sigma_is_the_result_s_own(results):
    for row in parameter_rows(results["batch"]):
        assert row.delta_over_sigma == pytest.approx(results["batch"]["delta_over_sigma"][row.name])


def test_an_estimate_far_from_the_truth_is_marked(results):
    truth = {
        name: value + 10 * (results["batch"]["sigma"][name] or 0)
        for name, value in results["batch"]["parameters"].items()
    }
    rows = parameter_rows({**results["batch"], "truth": truth})
    assert all(row.off_truth for row in rows)
    assert [row.error_over_sigma for row in rows] == pytest.approx([-10.0] * len(rows))


def test_rows_stand_in_the_model_s_order_however_the_store_sorted_them(results):
    shuffled = dict(sorted(results["batch"]["parameters"].items()))
    rows = parameter_rows({**results["batch"], "parameters": shuffled})
    assert [row.name for row in rows] == list(results["batch"]["parameters"])
