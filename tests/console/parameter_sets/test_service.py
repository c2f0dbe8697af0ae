"""Parameter sets: what they are made of, and who submits and withdraws them."""

import re
from html import unescape

import pytest

from boresight.calibration.parameter_set import parse_parameter_set
from boresight.cameras import CAMERA_MODELS
from boresight.console import list_queries as lists
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval
from boresight.console.fleet import service as sensors
from boresight.console.parameter_sets import pages as conversions
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.errors import (
    ConflictError,
    ForbiddenError,
    NotFoundError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
)
from boresight.figures.example_calibration import get_example_calibrations
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import open_reading, open_writing
from tests.console.conftest import SENSOR
from tests.passwords import approve
from tests.refusals import has_code
from tests.sites import codes, text_of


def test_a_candidate_says_all_that_it_is_and_is_named_by_its_hash(engine, candidate):
    row = candidate()
    with open_reading(engine) as session:
        run = session.get_one(Run, row.run_id)
        document = session.get_known(ParameterSet, row.id).document
    assert (row.name, row.ground_state, row.onboard_state) == ("PS-ST16-1-1", "CANDIDATE", "NOT SENT")
    assert compute_sha256(document) == row.sha256
    assert document["parameters"]["f_m"] == 0.016001
    assert (document["run_id"], document["result_sha256"]) == (run.id, run.result_sha256)
    assert document["units"]["f_m"] == "m"
    assert {"sensor", "camera_model", "sigma", "covariance", "inputs", "status", "advice", "name"} <= set(document)


def test_a_document_is_read_whoever_wrote_it_and_a_damaged_one_is_refused_by_member(engine, candidate):
    numbers = (1, candidate().id)
    with open_reading(engine) as session:
        ground, made = (session.get_known(ParameterSet, number).document for number in numbers)
    for document in (ground, made):
        found = parse_parameter_set(document)
        assert found.parameters.to_dict() == document["parameters"]
        assert found.sigma.to_dict() == document["sigma"]
        for name in ("covariance", "method", "status", "advice", "inputs"):
            assert getattr(found, name) == document[name]
    old = parse_parameter_set({"camera_model": "inverted_wang", "parameters": made["parameters"]})
    assert (old.sigma, old.alignment, old.residual_spline) == (None, None, None)
    with pytest.raises(RefusedInputError, match=r"parameters\.f_m", check=has_code("damaged-document")):
        parse_parameter_set(made | {"parameters": {"f_m": "long"}})


def test_what_the_camera_leaves_goes_with_its_parameters_where_it_is_more_than_noise(
    session, people, blobs, finished_run
):
    spline = get_example_calibrations()["batch"].to_dict()["trust"]["residual_spline"]
    for structure in (False, True):
        run = finished_run(session, trust={"residual_spline": spline | {"structure": structure}})
        document = parameter_sets.create_from_run(session, people["ana"], blobs, run.id).document
        assert ("residual_spline" in document) is structure
    assert document["residual_spline"]["coefficients"] == spline["coefficients"]


def test_the_same_run_makes_one_set_and_numbers_follow_one_another(engine, people, blobs, candidate):
    row = candidate()
    with open_writing(engine) as session:
        assert parameter_sets.create_from_run(session, people["bo"], blobs, row.run_id).id == row.id
    assert [candidate().number for _ in range(2)] == [2, 3]


@pytest.mark.parametrize(
    ("made", "error", "says"),
    [
        ({"state": "FAILED"}, ConflictError, r"is FAILED"),
        ({"state": "RUNNING"}, ConflictError, r"is RUNNING"),
        (
            {"status": "diverged", "advice": ["Use more stars."]},
            RefusedInputError,
            r"ended diverged.* Use more stars\.",
        ),
        ({"status": "rank_deficient"}, RefusedInputError, r"ended rank_deficient"),
        ({"status": "too_few_stars"}, RefusedInputError, r"ended too_few_stars"),
        ({"parameters": {"f_m": 0.016, "m0_px": None}}, RefusedInputError, r"no number for m0_px, n0_px"),
    ],
)
def test_a_run_that_is_no_calibration_makes_no_set(session, people, blobs, finished_run, made, error, says):
    run = finished_run(session, **made)
    with pytest.raises(error, match=says):
        parameter_sets.create_from_run(session, people["ana"], blobs, run.id)
    assert len(lists.list_newest(session, ParameterSet)) == 1


def test_max_iterations_makes_a_set_that_says_so_and_a_result_altered_on_the_disk_none(
    session, people, blobs, finished_run
):
    run = finished_run(session, status="max_iterations", advice=["It had not come to rest."])
    document = parameter_sets.create_from_run(session, people["ana"], blobs, run.id).document
    assert (document["status"], document["advice"]) == ("max_iterations", ["It had not come to rest."])
    run = finished_run(session)
    blobs.path(str(run.result_sha256)).write_bytes(b"{}")
    with pytest.raises(ConflictError, match="altered"):
        parameter_sets.create_from_run(session, people["ana"], blobs, run.id)


def test_what_does_not_exist_is_not_found(session, people, blobs):
    with pytest.raises(NotFoundError, match="no run 99"):
        parameter_sets.create_from_run(session, people["ana"], blobs, 99)
    with pytest.raises(NotFoundError, match="parameter set 99"):
        session.get_known(ParameterSet, 99)


@pytest.mark.parametrize("name", ["cy", "dee", "eve", "root"])
def test_only_an_analyst_makes_and_submits(session, people, blobs, finished_run, name):
    run = finished_run(session)
    with pytest.raises(ForbiddenError, match="role analyst"):
        parameter_sets.create_from_run(session, people[name], blobs, run.id)
    row = parameter_sets.create_from_run(session, people["ana"], blobs, run.id)
    with pytest.raises(ForbiddenError, match="role analyst"):
        approvals.submit(session, people[name], blobs, row.id, "better", row.version)
    assert row.ground_state == "CANDIDATE"


def test_a_request_binds_set_run_and_incumbent(engine, submitted):
    row = submitted()
    with open_reading(engine) as session:
        approval = lists.list_newest(session, Approval)[0]
        incumbent = set_queries.find_baseline(session, row.sensor_id)
        run = session.get_one(Run, row.run_id)
    hashes = {"set_sha256": row.sha256, "run_result_sha256": run.result_sha256, "incumbent_sha256": incumbent.sha256}
    assert hashes.items() <= approval.bound.items()
    others = {"gate_report_sha256", "profile_sha256", "table_definition_sha256", "waivers"}
    assert set(approval.bound) - set(hashes) == others


@pytest.mark.parametrize(
    ("who", "given", "error", "says"),
    [
        ("command line", {}, ForbiddenError, "needs a person"),
        ("ana", {"seen": None}, PreconditionRequiredError, "If-Match"),
        ("ana", {"reason": "  "}, RefusedInputError, "Give the reason"),
    ],
)
def test_a_submission_needs_a_person_a_reason_and_the_version_that_was_seen(
    engine, people, candidate, blobs, who, given, error, says
):
    row = candidate()
    reason, seen = given.get("reason", "better"), given.get("seen", row.version)
    with open_writing(engine) as session, pytest.raises(error, match=says):
        approvals.submit(session, people.get(who, COMMAND_LINE), blobs, row.id, reason, seen)


def test_what_is_submitted_is_not_submitted_again_nor_withdrawn_by_another_or_from_an_old_version(
    engine, people, submitted, blobs
):
    row = submitted()
    with (
        open_writing(engine) as session,
        pytest.raises(ConflictError, match="SUBMITTED: Ana", check=has_code("wrong-state")),
    ):
        approvals.submit(session, people["bo"], blobs, row.id, "better", row.version)
    with open_writing(engine) as session, pytest.raises(ForbiddenError, match="administrator"):
        approvals.withdraw(session, people["bo"], row.id, row.version)
    stale = pytest.raises(StaleError, match=r"v1, .*v2.* Ana submitted .* 20", check=has_code("changed-since-read"))
    with open_writing(engine) as session, stale:
        approvals.withdraw(session, people["ana"], row.id, 1)


def test_the_submitter_withdraws_and_may_submit_again(engine, people, approved, blobs):
    row = approved()
    with open_writing(engine) as session:
        withdrawn = approvals.withdraw(session, people["ana"], row.id, row.version, "found a mistake")
        assert withdrawn.ground_state == "WITHDRAWN"
        assert lists.list_newest(session, Approval)[0].state == "WITHDRAWN"
        assert approvals.submit(session, people["ana"], blobs, row.id, "no mistake", withdrawn.version).state == "OPEN"


def test_a_candidate_has_nothing_to_withdraw_or_promote(engine, people, candidate):
    row = candidate()
    with open_writing(engine) as session, pytest.raises(ConflictError, match="not submitted"):
        approvals.withdraw(session, people["ana"], row.id, row.version)
    with (
        open_writing(engine) as session,
        pytest.raises(ConflictError, match="CANDIDATE", check=has_code("wrong-state")),
    ):
        approvals.promote(session, people["dee"], row.id, row.version)


WORDS = 'Words of a tired operator, "quoted" & <kept>.'
ODD = '{"name": "half of a document'
STALE = "99"
FORMS = {  # who sends what to which address, and what of it must be there again
    "log in": ("victor", "/login", {"name": "viktor", "password": "wrong"}, ["viktor"]),
    "register a sensor": ("ada", "/sensors", {"document": ODD}, [ODD]),
    "edit a sensor": ("ada", "/sensors/1", {"document": ODD, "version": "1"}, [ODD]),
    "limits": ("adele", "/sensors/1/gates", {"action": "set", "reason": WORDS, "coverage.limit": "x7"}, [WORDS, "x7"]),
    "table": ("ada", "/sensors/1/table-definition", {"action": "set", "document": ODD, "reason": WORDS}, [ODD, WORDS]),
    "launch": (
        "ada",
        "/runs/new",
        {"sensor_id": "1", "set_id": "1", "label": WORDS * 9, "intent": "queue"},
        [WORDS * 9],
    ),
    "submit": ("ada", "/parameter-sets/2/submit", {"reason": WORDS, "version": STALE}, [WORDS]),
    "roll back": ("ada", "/parameter-sets/2/roll-back", {"reason": WORDS, "version": STALE}, [WORDS]),
    "sign": ("alan", "/approvals/1/sign", {"decision": "REFUSE", "comment": WORDS, "version": STALE}, [WORDS]),
    "remark": ("ada", "/approvals/1/remarks", {"text": WORDS * 99}, [WORDS * 99]),
    "record": (
        "olga",
        "/parameter-sets/1/uplink/record",
        {"onboard_state": "SENT", "source": WORDS, "version": STALE},
        [WORDS],
    ),
    "person": (
        "adele",
        "/users",
        {"name": "new", "printed_name": WORDS, "password": "x", "roles": "viewer"},
        [WORDS, "new"],
    ),
    "key": ("ada", "/users/keys", {"label": WORDS, "days": "many"}, [WORDS, "many"]),
    "webhook": (
        "adele",
        "/webhooks",
        {"label": WORDS, "url": "gopher://x", "actions": "signed"},
        [WORDS, "gopher://x"],
    ),
    "note": ("ada", "/notes/runs/1", {"text": WORDS * 999}, [WORDS * 99]),
}


@pytest.fixture
def office(site, results):
    run_id = site.add_run(state="SUCCEEDED", result=results["batch"] | {"iterations": 77})
    with open_writing(site.engine) as session:
        parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, 1)
        parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, run_id)
    ada = site.visitor("ada")
    asked = ada.post("/parameter-sets/3/submit", reason="Lower validation RMS.", version="1")
    assert asked.headers["location"] == "/approvals/1"
    return site


@pytest.mark.few(5)
@pytest.mark.parametrize("name", FORMS)
def test_a_refused_form_comes_back_with_what_was_typed(office, name):
    who, address, form, kept = FORMS[name]
    visitor = office.visitor(who)
    filled = {"csrf_token": visitor.csrf_token, **form}
    answer = visitor.send("POST", address, data=filled, headers={"Accept": "text/html"})
    assert 400 <= answer.status_code < 500, answer.headers
    page = unescape(answer.text)
    assert "notice-" in page or "fault" in page or "problem" in page, "the page does not say why"
    for words in kept:
        assert words in page, f"{words[:60]} is lost"


STRAIGHT = "/parameter-sets/1"  # the ground calibration: no decentring


def test_a_set_that_the_other_model_can_say_shows_values_sigmas_and_misfit_and_another_why_not(site, read):
    page = site.visitor("victor").get(STRAIGHT)
    assert re.search(r"limit \d\S* px, 1 % ", text_of(page, "conversion-misfit"))
    assert re.search(r"\d px \(1 σ\)", text_of(page, "conversion-lost"))
    assert "/api/v1/parameter-sets/1/conversion?to=pinhole_radial" in page
    ada = site.visitor("ada")
    page = ada.get(ada.post("/runs/1/parameter-set").headers["location"])
    assert "not-expressible" in codes(page)
    assert re.search("pinhole_radial .*tilt", read(page))


def test_the_page_and_the_api_give_the_same_numbers(site):
    with open_reading(site.engine) as session:
        offered = conversions.list_conversions(session, session.get_known(ParameterSet, 1))
    (shown,) = (one for one in offered if one.model == "pinhole_radial")
    answer = site.visitor("victor").send("GET", "/api/v1/parameter-sets/1/conversion", params={"to": "pinhole_radial"})
    assert answer.status_code == 200
    assert answer.json() == shown.document


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ({"to": "fisheye"}, "There is no camera model"),
        ({"to": "inverted_wang"}, "or pinhole_radial to convert"),
        ({"to": "pinhole_radial", "allow_px": "-1"}, "allow_px"),
        ({"to": "pinhole_radial", "allow_px": "nan"}, "allow_px"),
    ],
)
def test_what_cannot_be_converted_is_refused_with_422(site, query, said):
    answer = site.visitor("victor").send("GET", "/api/v1/parameter-sets/1/conversion", params=query)
    assert answer.status_code == 422
    assert said in answer.text


def test_a_set_and_a_run_are_downloaded_as_another_program_s_file_or_refused_above_the_limit(site):
    victor = site.visitor("victor")
    for address in ("/api/v1/parameter-sets/1", "/api/v1/runs/1"):
        answer = victor.send("GET", f"{address}/camera-file", params={"to": "opencv", "allow_px": "1000"})
        assert answer.status_code == 200
        assert answer.content.startswith(b"%YAML:1.0")
        assert "-opencv.yaml" in answer.headers["content-disposition"]
        for query in ({"to": "fits-sip"}, {"to": "none"}, {"to": "cedar", "allow_px": "0"}):
            assert victor.send("GET", f"{address}/camera-file", params=query).status_code == 422


def test_a_run_s_page_downloads_a_camera_or_says_above_its_own_content_why_it_cannot(site):
    victor = site.visitor("victor")
    page = victor.get("/runs/1")
    assert "/runs/1/camera-file?to=giant-owen" in page
    assert "camera-file?to=fits-sip" not in page
    written = victor.send("GET", "/runs/1/camera-file", params={"to": "opencv"})
    assert written.status_code == 200
    assert written.content == victor.send("GET", "/api/v1/runs/1/camera-file", params={"to": "opencv"}).content
    for refused in ("cedar", "fits-sip", "none"):
        answer = victor.send("GET", "/runs/1/camera-file", params={"to": refused})
        assert (answer.status_code, answer.headers["location"].split("?")[0]) == (303, "/runs/1")
        detail = victor.send("GET", "/api/v1/runs/1/camera-file", params={"to": refused}).json()["detail"]
        assert detail in unescape(victor.get(answer.headers["location"]))


@pytest.mark.parametrize("model", sorted(CAMERA_MODELS))
def test_a_set_of_every_model_is_approved_and_becomes_baseline(engine, blobs, people, finished_run, model):
    camera = CAMERA_MODELS[model]
    names = camera.parameter_names
    initial, estimate = (
        dict(zip(names, camera.plain(focal_px, 971.5, 1295.5, 2.2e-6).tolist(), strict=True))
        for focal_px in (7270.0, 7310.0)
    )
    typical = dict(zip(names, camera.default_typical_sigma, strict=True))
    matrix = [[1e-12 if row == column else 0.0 for column in range(len(names))] for row in range(len(names))]
    with open_writing(engine) as session:
        document = SENSOR | {"name": "T-2", "camera_model": model, "initial": initial, "typical_sigma": typical}
        sensor = sensors.register_sensor(session, COMMAND_LINE, document)
        run = finished_run(
            session, people["ana"].user_id, camera_model=model, free=list(names), parameters=estimate,
            sigma=dict.fromkeys(names, 1e-6), covariance={"names": list(names), "matrix": matrix},
        )  # fmt: skip
        run.sensor_id, run.sensor_document = sensor.id, sensor.document
        row = parameter_sets.create_from_run(session, people["ana"], blobs, run.id)
        approvals.submit(session, people["ana"], blobs, row.id, "better", row.version)
        approval = lists.list_newest(session, Approval, set=row.id)[0]
        approve(session, people["cy"], approval)
        promoted = approvals.promote(session, people["dee"], row.id, row.version)

    assert promoted.ground_state == "BASELINE"
    assert promoted.document["parameters"] == estimate
    assert promoted.document["camera_model"] == model
