"""The choice of a camera for a run's data: who may ask, when, what it answers, over REST, on the page and in its figure."""

import json
import re
from concurrent.futures import ThreadPoolExecutor

import orjson
import pytest

from boresight.calibration.choice.result import Sufficiency, parse_choice
from boresight.console.runs import choices
from boresight.console.runs import queries as run_queries
from boresight.console.runs import service as runs
from boresight.console.runs.tables import RUN_STATES, TERMINAL_RUN_STATES
from boresight.console.telemetry import service as telemetry_sets
from boresight.errors import ConflictError, ForbiddenError, NotFoundError
from boresight.figures import held_out_error
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.telemetry.sensors import parse_sensor
from tests.choices import candidate, made_choice
from tests.refusals import has_code
from tests.sites import as_shown, codes, text_of


def ask(site, run_id, name="ada"):
    with open_writing(site.engine) as session:
        return choices.request_choice(session, site.actor(name), site.blobs, run_id).id


def answer(site, asked_id, document, state="SUCCEEDED", **columns):
    with open_writing(site.engine) as session:
        if document is not None:
            content = orjson.dumps(document)
            columns |= {"result_sha256": site.blobs.put(content), "result_bytes": len(content)}
        run_queries.claim(session, "a server", 60.0, 1, [asked_id])
        assert run_queries.finish(session, asked_id, 1, state, **columns) == state


@pytest.fixture
def chosen(site):
    asked_id = ask(site, 1)
    answer(site, asked_id, made_choice().to_dict())
    return asked_id


def test_a_choice_is_queued_with_the_data_of_its_run_and_is_the_same_when_asked_again(site):
    asked_id = ask(site, 2)
    assert ask(site, 2) == asked_id
    with open_reading(site.engine) as session:
        run, asked = runs.get_run(session, 2), runs.get_run(session, asked_id)
        assert (asked.choice_of, asked.method, asked.state) == (2, "choice", "QUEUED")
        assert (asked.telemetry_set_id, asked.validation_set_id) == (run.telemetry_set_id, run.validation_set_id)
        assert asked.sensor_document == run.sensor_document
        (claimed,) = run_queries.list_claimed_runs(session, [asked_id])
        assert claimed.choice_of == 2


@pytest.mark.parametrize("state", ["FAILED", "CANCELLED", "LOST"])
def test_a_choice_that_failed_is_made_anew(site, state):
    first = ask(site, 1)
    answer(site, first, None, state, reason="The disk is full.")
    with (
        open_reading(site.engine) as session,
        pytest.raises(ConflictError, match=rf"{state}.*disk", check=has_code("choice-failed")),
    ):
        choices.get_choice(session, site.blobs, 1)
    assert ask(site, 1) > first


def test_a_choice_that_cannot_be_read_is_refused_and_made_anew(site):
    first = ask(site, 1)
    answer(site, first, {"schema": "boresight.choice/1"})
    with open_reading(site.engine) as session, pytest.raises(ConflictError, check=has_code("unreadable-choice")):
        choices.get_choice(session, site.blobs, 1)
    assert "unreadable-choice" in codes(site.visitor("ada").get("/runs/1?part=distortion"))
    assert ask(site, 1) > first


DAMAGES = {
    "place": lambda document: document["chosen"].update(place=99),
    "place before the first": lambda document: document["chosen"].update(place=-1),
    "place of another": lambda document: document["other_cameras"][0].update(place=0),
    "no candidates": lambda document: document.update(models=[]),
    "interval": lambda document: document["models"][0].update(held_out_interval_rad=[1.0]),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_choice_that_contradicts_itself_is_refused_on_every_door_and_made_anew(site, damage):
    document = made_choice().to_dict()
    damage(document)
    first, ada = ask(site, 1), site.visitor("ada")
    answer(site, first, document)
    assert "unreadable-choice" in codes(ada.get("/runs/1?part=distortion"))
    for place in ("", "/figure", "/data"):
        assert ada.send("GET", f"/api/v1/runs/1/choice{place}").status_code == 409
    assert ask(site, 1) > first


@pytest.mark.parametrize(
    "chosen", [{"camera_model": "gone"}, {"parameters": {"f_m": 0.016}}, {"free": ["f_m", "gone"]}], ids=str
)
def test_of_a_camera_that_this_version_does_not_have_there_is_no_sensor_file(site, chosen):
    document = made_choice().to_dict()
    document["chosen"] |= chosen
    document["models"][1] |= {name: chosen[name] for name in chosen if name != "parameters"}
    answer(site, ask(site, 1), document)
    ada = site.visitor("ada")
    assert "CHOSEN" in ada.get("/runs/1?part=distortion")
    assert ada.send("GET", "/runs/1/choice/sensor.json").status_code == 422


def test_a_choice_whose_file_is_missing_is_made_anew(site):
    first, ada = ask(site, 1), site.visitor("ada")
    answer(site, first, made_choice().to_dict())
    with open_reading(site.engine) as session:
        site.blobs.path(runs.get_run(session, first).result_sha256).unlink()
    assert "Choose again" in ada.get("/runs/1?part=distortion")
    assert ask(site, 1) > first


def test_nothing_is_chosen_for_an_archived_set_but_what_is_on_its_way_can_be_stopped(site):
    first, ada = ask(site, 1), site.visitor("ada")
    with open_writing(site.engine) as session:
        telemetry_sets.archive_telemetry_set(session, site.actor("ada"), runs.get_run(session, 1).telemetry_set_id)
    assert ask(site, 1) == first
    stop = re.search(rf'action="/runs/{first}/cancel">.*?</form>', ada.get("/runs/1?part=distortion"))
    assert "disabled" not in stop[0]
    answer(site, first, None, "FAILED", reason="The disk is full.")
    assert "archived" in text_of(ada.get("/runs/1?part=distortion"), "why-no-choice")
    with pytest.raises(ConflictError, match="archived", check=has_code("no-choice-possible")):
        ask(site, 1)


def test_only_an_analyst_asks_and_only_for_a_calibration_that_has_ended(site, chosen):
    with pytest.raises(ForbiddenError):
        ask(site, 1, "victor")
    for state in set(RUN_STATES) - set(TERMINAL_RUN_STATES):
        with pytest.raises(ConflictError, match=state):
            ask(site, site.add_run(state=state))
    with pytest.raises(ConflictError, match="itself", check=has_code("no-choice-possible")):
        ask(site, chosen)
    with open_reading(site.engine) as session, pytest.raises(NotFoundError):
        choices.get_choice(session, site.blobs, 2)


def test_a_choice_is_no_calibration_to_lists_the_fleet_and_parameter_sets(site, chosen):
    with open_reading(site.engine) as session:
        assert chosen not in [run.id for run in runs.list_runs(session)]
        assert chosen not in [run.id for run in run_queries.iterate_newest_finished(session, 1)]
        assert run_queries.read_neighbours(session, 2) == (1, None)
        with pytest.raises(ConflictError, match="run 1", check=has_code("run-is-a-choice")):
            runs.find_result(session, site.blobs, chosen)
    ada = site.visitor("ada")
    assert f"/runs/{chosen}" not in ada.get("/runs")
    assert ada.send("GET", f"/runs/{chosen}").headers["location"] == "/runs/1?part=distortion#choice"
    ada.post(f"/runs/{chosen}/parameter-set")
    assert "run-is-a-choice" in codes(ada.get("/runs/1"))


def test_the_tab_offers_a_choice_and_says_why_it_may_not_be_asked_for(site):
    page = site.visitor("ada").get("/runs/1?part=distortion")
    assert "no-choice-yet" in codes(page)
    assert '<button class="button-primary" title="Fit every' in page
    page = site.visitor("victor").get("/runs/1?part=distortion")
    assert '<button class="button-primary" disabled' in page
    assert "analyst" in text_of(page, "why-no-choice")
    waiting = site.add_run()
    why = text_of(site.visitor("ada").get(f"/runs/{waiting}?part=distortion"), "why-no-choice")
    assert f"Run {waiting} is QUEUED" in why


def test_asked_on_the_page_it_is_followed_there_until_it_ends(site, read):
    ada = site.visitor("ada")
    assert ada.post("/runs/1/choice").headers["location"] == "/runs/1?part=distortion#choice"
    with open_reading(site.engine) as session:
        asked_id = choices.find_choice_run(session, 1).id
    page = ada.get("/runs/1?part=distortion")
    assert f'<live-run run="{asked_id}" state="QUEUED">' in page
    assert "live-run.js" in page
    assert "queue" in read(page)
    with open_writing(site.engine) as session:
        run_queries.claim(session, "a server", 60.0, 1, [asked_id])
    assert f'<live-run run="{asked_id}" state="RUNNING">' in ada.get("/runs/1?part=distortion")  # not heard of yet
    with open_writing(site.engine) as session:
        run_queries.record_progress(session, asked_id, 1, {"fraction": 0.3, "message": "fitting every camera"})
    page = ada.get("/runs/1?part=distortion")
    assert "fitting every camera" in read(page)
    assert f'action="/runs/{asked_id}/cancel"' in page
    with open_writing(site.engine) as session:
        run_queries.finish(session, asked_id, 1, "FAILED", "No exposure can be used.")
    page = ada.get("/runs/1?part=distortion")
    assert "No exposure can be used." in read(page)
    assert "Choose again" in page
    assert f'href="/runs/{asked_id}/log"' in page


def test_the_choice_stands_on_the_tab_sentence_first_with_every_number(site, read, chosen):
    page = site.visitor("victor").get("/runs/1?part=distortion")
    text, choice = " ".join(read(page).split()), made_choice()
    shown = as_shown(choice.sentence)
    assert shown in text
    assert text.index(shown) < text.index("Held-out RMS")
    assert page.count("CHOSEN") == 2  # in the table of cameras, and in that of candidates
    assert '<tr aria-current="true"><th scope="row">inverted_wang' in page
    for words in (
        "31.00 (27.90 to 34.10)",
        "812.4",
        "0.120 ± 0.010",
        as_shown("< 1e-6"),
        "undetermined",
        "not needed",
        "by cross-validation",
    ):
        assert words in text, words
    assert "/runs/new?clone=1&amp;free-1=f_m&amp;free-1=b2_per_m2" in page
    assert f'href="/runs/{chosen}/log"' in page
    form = site.visitor("ada").get("/runs/new?clone=1&free-1=f_m&free-1=b2_per_m2")
    ticked = re.findall(r'name="free-1" value="(\w+)" checked', form)
    assert ticked == ["f_m", "b2_per_m2"]


def test_another_camera_than_the_sensors_is_no_launch_but_a_sensor_file(site):
    found = made_choice(sentence="brown_conrady suffices.")
    document = found.to_dict()
    document["chosen"] |= {"camera_model": "brown_conrady", "place": 2, "parameters": BROWN}
    document["chosen"] |= {"free": ["f_m", "k1"], "sigma": {"f_m": 1e-6, "k1": 1e-3}}
    document["sufficiency"] = Sufficiency.SOMETHING_LEFT
    answer(site, ask(site, 1), document)
    page = site.visitor("victor").get("/runs/1?part=distortion")
    assert 'id="calibrate-with-choice"' not in page
    assert "inverted_wang" in text_of(page, "choice-facts")
    sent = site.visitor("victor").send("GET", "/runs/1/choice/sensor.json")
    sensor = parse_sensor(json.loads(sent.text))
    assert (sensor.camera_model, sensor.free) == ("brown_conrady", ("f_m", "k1"))


BROWN = {
    "s": 1.0,
    "f_m": 0.016,
    "u0_px": 1296.0,
    "v0_px": 972.0,
    "k1": 0.01,
    "k2": 0.0,
    "p1": 0.0,
    "p2": 0.0,
    "k3": 0.0,
}


def test_over_rest_it_is_asked_once_for_a_key_and_read_as_it_was_stored(house):
    run_id, ada, victor = house.finished(), house.person("ada"), house.person("victor")
    address = f"/api/v1/runs/{run_id}/choice"
    assert victor.get(address).status_code == 404
    assert victor.post(address).status_code == 403
    tried = ada.post(address, params={"validate_only": "true"})
    assert (tried.status_code, tried.headers["x-validate-only"]) == (200, "true")
    assert victor.get(address).status_code == 404
    asked = ada.post(address, headers={"Idempotency-Key": "k-1"})
    assert asked.status_code == 202
    assert asked.json()["choice_of"] == run_id
    assert asked.headers["location"] == f"/api/v1/runs/{asked.json()['id']}"
    again = ada.post(address, headers={"Idempotency-Key": "k-1"})
    assert (again.json(), again.headers["idempotent-replayed"]) == (asked.json(), "true")
    assert ada.post(address).json()["id"] == asked.json()["id"]
    assert victor.get(address).status_code == 409
    house.end(asked.json()["id"])
    read = victor.get(address)
    assert parse_choice(read.content) == made_choice()
    assert victor.get(f"{address}/data").text.splitlines()[0].startswith("camera_model,free,chosen")
    assert victor.get(f"/api/v1/runs/{asked.json()['id']}/result").status_code == 409
    assert asked.json()["id"] not in [one["id"] for one in victor.get("/api/v1/runs").json()["items"]]


def test_asked_by_many_at_once_it_is_one_run_and_a_key_without_the_scope_asks_for_none(house):
    run_id = house.finished()
    address = f"/api/v1/runs/{run_id}/choice"
    assert house.key("ada", "telemetry-sets").post(address).status_code == 403
    clients = [house.key("ada", "runs") for _ in range(8)]
    with ThreadPoolExecutor(len(clients)) as pool:
        answers = list(pool.map(lambda client: client.post(address), clients))
    assert {one.status_code for one in answers} == {202}
    assert len({one.json()["id"] for one in answers}) == 1


def test_a_launch_that_is_on_its_way_has_no_choice_over_rest(house):
    run = house.launched()
    refused = house.person("ada").post(f"/api/v1/runs/{run['id']}/choice")
    assert refused.status_code == 409
    assert "QUEUED" in refused.json()["detail"]


def test_the_figure_has_a_colour_a_camera_and_a_ring_about_the_chosen_one():
    figure = held_out_error.draw(made_choice())
    assert [trace.name for trace in figure.data] == ["inverted_wang", "brown_conrady", "kannala_brandt", "chosen"]
    assert list(figure.data[0].y) == [39.0, 31.0]
    assert (figure.data[-1].x[0], figure.data[-1].y[0]) == (2, pytest.approx(31.0))
    table = held_out_error.table(made_choice())
    assert table["chosen"] == ["no", "yes", "no", "no"]
    assert table["held_out_rms_arc_rad"][-1] is None


def test_without_anything_held_out_the_figure_says_so():
    made = made_choice()
    bare = parse_choice(
        {**made.to_dict(), "models": [candidate(rms_rad=None).__dict__] * 2, "other_cameras": [], "held_out_by": None}
    )
    assert "validation set" in held_out_error.draw(bare).layout.annotations[0].text
