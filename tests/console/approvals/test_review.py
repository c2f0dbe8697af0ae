"""What an approval must answer for, over REST and in the service, and comments on single things."""

import dataclasses
from typing import Any

import pytest

from boresight.console import list_queries as lists
from boresight.console.approvals import service as approvals
from boresight.console.approvals import threads
from boresight.console.approvals.review import Acknowledgement, Point, answer_points, refuse_open_points
from boresight.console.approvals.tables import Approval
from boresight.errors import ConflictError, ForbiddenError, RefusedInputError, StaleError
from boresight.platform.actors import POLICY
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing
from tests.passwords import PASSWORD, approve, proved

COVERAGE = Point("gate", "coverage", "Detector coverage", "One corner is empty.", "MARGINAL")
WARNED = Point("warning", "advice-1", "Warning", "Only 5 frames took part.")
SEEN = Point("evidence", "rms", "RMS", "The figure RMS.", opened_utc="2026-01-01T00:00:00Z")
UNSEEN = Point("evidence", "radial", "Radial difference", "The figure.")
POINTS = (COVERAGE, WARNED, SEEN, UNSEEN)
WHOLE = tuple(Acknowledgement(point.kind, point.name, "Known.") for point in POINTS if point is not SEEN)


@pytest.mark.parametrize(
    ("left_out", "named"),
    [(0, "Detector coverage is MARGINAL"), (1, "Only 5 frames took part"), (2, "Radial difference was not")],
)
def test_the_first_point_without_an_answer_is_named(left_out, named):
    given = [one for i, one in enumerate(WHOLE) if i != left_out]
    with pytest.raises(RefusedInputError, match=named):
        refuse_open_points(answer_points(POINTS, given))


def test_reasons_close_points_and_an_opened_figure_needs_none():
    answered = answer_points(POINTS, WHOLE)
    refuse_open_points(answered)
    assert [point.reason for point in answered] == ["Known.", "Known.", None, "Known."]


@pytest.mark.parametrize(
    "given",
    [
        [Acknowledgement("gate", "moon", "Known.")],
        [Acknowledgement("gate", "coverage", "  ")],
        [Acknowledgement("gate", "coverage", "x" * 1001)],
        [Acknowledgement("gate", "coverage", "a\x00b")],
        [WHOLE[0], WHOLE[0]],
    ],
)
def test_a_reason_that_is_no_answer_is_refused(given):
    with pytest.raises(RefusedInputError):
        answer_points(POINTS, given)


@pytest.fixture
def request_id(engine, submitted) -> int:
    row = submitted()
    with open_reading(engine) as session:
        return lists.list_newest(session, Approval, set=row.id)[0].id


def _answers(points: list[dict[str, Any]]) -> list[dict[str, str]]:
    return [{"kind": one["kind"], "name": one["name"], "reason": "Known."} for one in points if not one["opened_utc"]]


def test_over_rest_points_that_are_given_must_be_whole_and_stand_in_the_signature_with_what_was_opened(
    house, monkeypatch
):
    approval = house.submitted()
    alan, address = house.person("alan"), f"/api/v1/approvals/{approval['id']}"
    assert alan.get(f"{address}/figures/radial").status_code == 200
    assert not any(one["opened_utc"] for one in alan.get(f"{address}/points").json()["items"])
    monkeypatch.setattr(approvals, "SHOWN_S", 0.0)
    assert alan.post(f"{address}/openings", json={"evidence": "radial"}).status_code == 200
    points = alan.get(f"{address}/points").json()["items"]
    assert {one["kind"] for one in points} >= {"gate", "evidence"}
    assert [one["name"] for one in points if one["opened_utc"]] == ["radial"]
    given = _answers(points)
    assert house.sign("alan", approval, acknowledged=given[1:]).status_code == 422
    (signature,) = house.sign("alan", approval, acknowledged=given).json()["signatures"]
    assert [(one["kind"], one["name"]) for one in signature["points"]] == [(one["kind"], one["name"]) for one in points]
    assert all(bool(one["opened_utc"]) == (one["name"] == "radial") for one in signature["points"])
    assert all(one["reason"] == "Known." for one in signature["points"] if not one["opened_utc"])
    with open_reading(house.app.state.engine) as session:
        record = audit.find_last_change(session, f"approvals/{approval['id']}")
        told = {name: said for name, said in record.after.items() if name.startswith("point ")}
    assert len(told) == len(points)
    assert told["point evidence rms"] == "Known."
    assert told["point evidence radial"].startswith("opened ")


def test_an_approval_over_rest_that_knows_no_points_is_taken_and_its_record_says_what_was_left_open(house):
    approval = house.submitted()
    (signature,) = house.sign("alan", approval).json()["signatures"]
    assert signature["points"]
    assert all(one["reason"] is one["opened_utc"] is None for one in signature["points"])


def test_a_key_and_a_decided_request_open_nothing(house):
    approval = house.submitted()
    address = f"/api/v1/approvals/{approval['id']}"
    assert house.key("alan", "runs").get(f"{address}/figures/rms").status_code == 200
    house.sign("alan", approval, "refuse")
    assert house.person("alan").get(f"{address}/figures/rms").status_code == 200
    assert house.person("alan").get(f"{address}/openings").json()["items"] == []


def test_where_the_setting_asks_no_approval_leaves_a_point_open(engine, people, request_id):
    strict = dataclasses.replace(POLICY, rest_review=True)
    with open_writing(engine) as session:
        approval = session.get_known(Approval, request_id)
        with pytest.raises(RefusedInputError):
            approve(session, people["cy"], approval, policy=strict)


def test_a_thread_is_resolved_once_by_who_saw_it_last_and_is_on_record(engine, people, request_id):
    with open_writing(engine) as session:
        made = threads.open_thread(session, people["ana"], request_id, "parameter", "f_m", "@cy why? mail me@x.org")
        assert made.remarks[0].mentions == ["cy"]
        threads.set_resolved(session, people["cy"], request_id, made.id, "resolved", 1)
    with open_reading(engine) as session:
        (row,) = threads.list_threads(session, request_id)
        assert (row.state, row.resolver, row.version) == ("RESOLVED", "Cy", 2)
        assert audit.verify(session).ok
        for version, error in ((1, StaleError), (2, ConflictError)):
            with pytest.raises(error):
                threads.set_resolved(session, people["cy"], request_id, row.id, "resolved", version)


def test_a_mention_waits_until_it_is_answered_in_its_place_or_its_thread_is_resolved(engine, people, request_id):
    def waiting() -> dict[str, int]:
        with open_reading(engine) as session:
            return {name: len(found) for name, found in threads.find_open_mentions(session).items()}

    with open_writing(engine) as session:
        f_m = threads.open_thread(session, people["ana"], request_id, "parameter", "f_m", "@cy and @bo: why?")
        threads.add_remark(session, people["ana"], request_id, "@cy look, please")
    assert waiting() == {"cy": 2, "bo": 1}
    with open_writing(engine) as session:
        threads.add_remark(session, people["cy"], request_id, "I did.")
    assert waiting() == {"cy": 1, "bo": 1}
    with open_writing(engine) as session:
        threads.set_resolved(session, people["cy"], request_id, f_m.id, "resolved", 1)
    assert waiting() == {}


def test_a_decided_request_waits_for_nobodys_answer(engine, people, request_id):
    with open_writing(engine) as session:
        threads.add_remark(session, people["ana"], request_id, "@cy look, please")
        decided = approvals.Decision("REFUSE", "I refuse", "too few stars at the rim")
        proof = proved(session, people["cy"], PASSWORD)
        approvals.sign(session, people["cy"], request_id, decided, proof, seen_version=1)
    with open_reading(engine) as session:
        assert threads.find_open_mentions(session) == {}


@pytest.mark.parametrize(
    ("who", "about", "text", "error"),
    [
        ("ana", ("gate", "moon"), "Why?", RefusedInputError),
        ("ana", ("run", "1"), "Why?", RefusedInputError),
        ("ana", ("gate", "coverage"), " ", RefusedInputError),
        ("ana", ("gate", "coverage"), "@nobody why?", RefusedInputError),
        ("eve", ("gate", "coverage"), "Why?", ForbiddenError),
    ],
)
def test_a_thread_about_nothing_by_nobody_or_to_nobody_is_refused(engine, people, request_id, who, about, text, error):
    with open_writing(engine) as session, pytest.raises(error):
        threads.open_thread(session, people[who], request_id, *about, text)
