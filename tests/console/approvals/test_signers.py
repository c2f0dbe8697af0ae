"""Who may sign: nobody who submitted the set, launched its run or campaign, or created it, by whatever credential."""

from collections.abc import Callable, Mapping
from typing import Any

import pytest

from boresight.console import list_queries as lists
from boresight.console.access import api_keys, users
from boresight.console.approvals import gate_profiles, gates, staleness, threads
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import queries as gate_rows
from boresight.console.approvals import service as approvals
from boresight.console.approvals.review import read_points
from boresight.console.approvals.tables import Approval, Signature
from boresight.console.campaigns import service as campaigns
from boresight.console.campaigns.tables import Campaign, CampaignRun
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks.packages import describe_four_eyes
from boresight.errors import (
    ConflictError,
    ForbiddenError,
    NotFoundError,
    RefusedInputError,
    StaleError,
    UnauthenticatedError,
)
from boresight.platform.actors import COMMAND_LINE, POLICY, Actor, Policy
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, open_reading, open_writing, utc_after
from tests.console.conftest import PASSWORD, SENSOR
from tests.passwords import add_person, new_password, proved
from tests.refusals import has_code

People = Mapping[str, Actor]
ALONE, TWO = Policy(four_eyes=False), Policy(approvals=2)


@pytest.fixture
def created(engine, people, blobs, finished_run) -> Callable[..., ParameterSet]:
    def make(creator: Actor | str, launcher: str = "ana", **result: Any) -> ParameterSet:
        actor = people[creator] if isinstance(creator, str) else creator
        with open_writing(engine) as session:
            run = finished_run(session, people[launcher].user_id, **result)
            return parameter_sets.create_from_run(session, actor, blobs, run.id)

    return make


@pytest.fixture
def ask(engine, people, blobs) -> Callable[..., Approval]:
    def make(row: ParameterSet, submitter: str = "ana", policy: Policy = POLICY) -> Approval:
        with open_writing(engine) as session:
            seen = session.get_known(ParameterSet, row.id).version
            return approvals.submit(session, people[submitter], blobs, row.id, "better", seen, policy=policy)

    return make


def _decide(engine, actor, approval, decision="APPROVE", policy=POLICY) -> Approval:
    with open_writing(engine) as session:
        seen = session.get_known(Approval, approval.id).version
        words = (approvals.Decision(decision, "I decide", "seen"), proved(session, actor, PASSWORD), seen)
        approvals.sign(session, actor, approval.id, *words, policy=policy)
        return session.get_known(Approval, approval.id)


def _sign(engine: Engine, actor: Actor, approval: Approval, policy: Policy = POLICY) -> str:
    return _decide(engine, actor, approval, policy=policy).state


def _signers(engine: Engine, approval: Approval, policy: Policy = POLICY) -> dict[str, tuple[str, ...] | None]:
    with open_reading(engine) as session:
        found = approvals.list_request_signers(session, approval.id, policy=policy)
    return {one.user.name: one.roles if one.refusal else None for one in found}


def test_who_created_a_set_does_not_approve_it(engine, people, created, ask):
    approval = ask(created("bo"))
    with pytest.raises(ForbiddenError, match="created", check=has_code("own-part")):
        _sign(engine, people["bo"], approval)
    with open_reading(engine) as session:
        assert "You created" in str(approvals.explain_why_not_sign(session, people["bo"], approval.id))
    assert _signers(engine, approval) == {"bo": ("CREATOR",), "cy": None}
    assert _sign(engine, people["cy"], approval) == "APPROVED"


def test_each_of_the_three_parts_excludes_and_all_are_named(engine, people, created, ask):
    approval = ask(created("bo", "bo"), "bo")
    assert _signers(engine, approval) == {"bo": ("SUBMITTER", "LAUNCHER", "CREATOR"), "cy": None}
    with pytest.raises(ForbiddenError, match=r"submitted.*launched run \d+ .*created", check=has_code("own-part")):
        _sign(engine, people["bo"], approval)
    with (
        open_writing(engine) as session,
        pytest.raises(ConflictError, match=r"^Bo submitted", check=has_code("signer-refused")),
    ):
        approvals.assign(session, people["ana"], approval.id, people["bo"].user_id, approval.version)


def test_a_set_created_with_a_key_is_its_owners(engine, people, created, ask):
    with open_writing(engine) as session:
        secret = api_keys.create_key(session, people["bo"], label="robot", scopes=["parameter-sets"])[1]
        robot = api_keys.find_actor_of_key(session, secret)
    approval = ask(created(robot))
    with pytest.raises(ForbiddenError, match="created", check=has_code("own-part")):
        _sign(engine, people["bo"], approval)


def test_over_the_shoulder_the_creator_does_not_sign_either(engine, people, created, ask):
    approval = ask(created("bo"))
    with open_reading(engine) as session:
        words = (approvals.Decision("APPROVE", "I approve"), proved(session, "bo", PASSWORD), approval.version)
    with open_writing(engine) as session, pytest.raises(ForbiddenError, match="created", check=has_code("own-part")):
        approvals.sign_over_the_shoulder(session, people["ana"], approval.id, *words)


def test_who_launched_the_campaign_does_not_approve_what_another_launched_again(engine, people, created, ask):
    row = created("ana")
    with open_writing(engine) as session:
        settings = {"label": "x", "settings": {}, "launched_utc": row.created_utc}
        campaign = Campaign(launched_by=people["bo"].user_id, **settings)
        session.add(campaign)
        session.flush()
        session.add(CampaignRun(campaign_id=campaign.id, sensor_id=row.sensor_id, run_id=row.run_id))
        campaigns.audit.append(session, people["bo"], "launched", f"campaigns/{campaign.id}")
    approval = ask(row)
    assert _signers(engine, approval) == {"bo": ("LAUNCHER",), "cy": None}
    with pytest.raises(ForbiddenError, match="campaign 1", check=has_code("own-part")):
        _sign(engine, people["bo"], approval)


def test_a_roll_back_excludes_who_created_the_former_baseline(engine, people, blobs, created, ask):
    rows = [created("bo"), created("ana")]
    for row in rows:
        _sign(engine, people["cy"], ask(row))
        _promote(engine, people["dee"], row.id)
    with open_writing(engine) as session:
        version = session.get_known(ParameterSet, rows[0].id).version
        back = approvals.roll_back(session, people["dee"], blobs, rows[0].id, "It drifts.", version)
    with pytest.raises(ForbiddenError, match="created", check=has_code("own-part")):
        _sign(engine, people["bo"], back)
    assert _sign(engine, people["cy"], back) == "APPROVED"


def test_of_several_approvals_none_is_the_creators(engine, people, created, ask):
    with open_writing(engine) as session:
        add_person(session, "flo", "approver")
    approval = ask(created("bo"), policy=TWO)
    assert _sign(engine, people["cy"], approval, TWO) == "OPEN"
    with pytest.raises(ForbiddenError, match="created", check=has_code("own-part")):
        _sign(engine, people["bo"], approval, TWO)
    assert _signers(engine, approval, TWO) == {"bo": ("CREATOR",), "cy": (), "flo": None}


def test_what_the_creator_signed_while_four_eyes_was_off_does_not_pass_once_it_is_on(engine, people, created, ask):
    row = created("bo")
    approval = ask(row, policy=ALONE)
    assert _signers(engine, approval, ALONE) == {"bo": None, "cy": None}
    assert _sign(engine, people["bo"], approval, ALONE) == "APPROVED"
    with open_writing(engine) as session:
        version = session.get_known(ParameterSet, row.id).version
        with pytest.raises(ConflictError, match="0 of 1", check=has_code("too-few-second-persons")):
            approvals.promote(session, people["dee"], row.id, version)
        assert describe_four_eyes(session, row, POLICY)["kept"] is False


TIGHT = {"gates": [{"name": "parameter-shift", "limit": 1e-6, "marginal": 1e-6}]}
MOVED = SENSOR["initial"] | {"f_m": 0.0161}


@pytest.fixture
def ask_anew(created, ask) -> Callable[..., Approval]:
    def make(by: str = "ana", policy: Policy = POLICY, **result: Any) -> Approval:
        return ask(created(by, by, **result), by, policy)

    return make


def _promote(engine: Engine, actor: Actor, set_id: int, policy: Policy = POLICY) -> str:
    with open_writing(engine) as session:
        version = session.get_known(ParameterSet, set_id).version
        return approvals.promote(session, actor, set_id, version, policy=policy).ground_state


def test_a_request_that_needs_two_stays_open_after_one_and_is_approved_after_two(engine, people, ask_anew):
    approval = ask_anew(policy=TWO)
    first = _decide(engine, people["cy"], approval)
    assert (first.needed, first.state, first.version, first.closed_utc) == (2, "OPEN", 2, None)
    with open_reading(engine) as session:
        record = audit.find_last_change(session, f"approvals/{approval.id}")
        assert record.after["approvals"] == "1 of 2"
        assert session.get_known(ParameterSet, approval.parameter_set_id).ground_state == "SUBMITTED"
    with pytest.raises(ConflictError, check=has_code("already-signed")):
        _decide(engine, people["cy"], approval)
    assert _decide(engine, people["bo"], approval).state == "APPROVED"
    assert _promote(engine, people["dee"], approval.parameter_set_id) == "BASELINE"


def test_one_refusal_blocks_whatever_was_approved(engine, people, ask_anew):
    approval = ask_anew(policy=TWO)
    _decide(engine, people["cy"], approval)
    assert _decide(engine, people["bo"], approval, "REFUSE").state == "REJECTED"


@pytest.fixture
def tight(engine, people) -> None:
    with open_writing(engine) as session:
        gate_profiles.set_profile(session, people["root"], 1, TIGHT, "To be tried.", 0)


@pytest.mark.usefixtures("tight")
def test_what_a_gate_stops_can_be_refused_and_not_approved(engine, people, ask_anew):
    approval = ask_anew(parameters=MOVED)
    with pytest.raises(ConflictError, match=r"parameter-shift \(FAIL\)\. Waive", check=has_code("blocked-by-gates")):
        _decide(engine, people["cy"], approval)
    assert _decide(engine, people["cy"], approval, "REFUSE").state == "REJECTED"


def test_a_critical_gate_is_never_passed(engine, people, ask_anew):
    names = ["f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y"]
    negative = {"names": names, "matrix": [[-1e-12 if i == j else 0.0 for j in range(8)] for i in range(8)]}
    approval = ask_anew(covariance=negative)
    with pytest.raises(ConflictError, match=r"covariance \(FAIL\).*recalibrate", check=has_code("blocked-by-gates")):
        _decide(engine, people["cy"], approval)


@pytest.mark.usefixtures("tight")
def test_a_waiver_asks_for_a_new_request_with_a_second_approval(engine, people, ask, ask_anew):
    approval = ask_anew(parameters=MOVED)
    with open_writing(engine) as session:
        row = session.get_known(ParameterSet, approval.parameter_set_id)
        proof = proved(session, people["ana"], PASSWORD)
        words = ("known-cause", "The wheels were spun up during this pass.", utc_after(86400.0), proof, row.version)
        waiver = gates.waive(session, people["ana"], row.id, "parameter-shift", *words)
    again = ask(row)
    with open_reading(engine) as session:
        state = session.get_known(Approval, approval.id).state
    assert (state, again.needed, again.bound["waivers"]) == ("STALE", 2, [waiver.id])
    _decide(engine, people["cy"], again)
    assert _decide(engine, people["bo"], again).state == "APPROVED"
    assert _promote(engine, people["dee"], again.parameter_set_id) == "BASELINE"
    with open_reading(engine) as session:
        report = gates.lay_waivers(session, gate_rows.find_newest_report(session, row.id))
    assert "waived" in report.words


def test_a_signature_stands_for_gate_report_waivers_and_time(ask_anew):
    approval = ask_anew()
    shown = staleness.compute_binding_sha256(approval)
    for name in ("gate_report_sha256", "profile_sha256", "incumbent_sha256", "table_definition_sha256", "waivers"):
        other = Approval(**{**_columns(approval), "bound": approval.bound | {name: "another"}})
        assert staleness.compute_binding_sha256(other) != shown
    for name, value in (("needed", 2), ("kind", "ROLLBACK"), ("expires_utc", "2099-01-01T00:00:00.000000Z")):
        assert staleness.compute_binding_sha256(Approval(**{**_columns(approval), name: value})) != shown


def _columns(approval: Approval) -> dict[str, Any]:
    return {column.name: getattr(approval, column.name) for column in Approval.__table__.columns}


def test_with_four_eyes_off_the_submitter_signs_and_the_record_says_so(engine, people, ask_anew):
    approval = ask_anew("bo", ALONE)
    with pytest.raises(ForbiddenError, match="submitted", check=has_code("own-part")):
        _decide(engine, people["bo"], approval)
    assert _decide(engine, people["bo"], approval, policy=ALONE).state == "APPROVED"
    with open_reading(engine) as session:
        record = audit.find_last_change(session, f"approvals/{approval.id}")
        assert record.after["four_eyes"] is False
    assert _promote(engine, people["dee"], approval.parameter_set_id, ALONE) == "BASELINE"


def test_what_was_signed_alone_does_not_pass_once_four_eyes_is_on(engine, people, ask_anew):
    approval = ask_anew("bo", ALONE)
    _decide(engine, people["bo"], approval, policy=ALONE)
    with pytest.raises(ConflictError, match="0 of 1", check=has_code("too-few-second-persons")):
        _promote(engine, people["dee"], approval.parameter_set_id)


@pytest.mark.parametrize(
    ("policy", "waived", "needed"),
    [(POLICY, False, 1), (POLICY, True, 2), (TWO, False, 2), (ALONE, True, 1)],
)
def test_the_policy_says_how_many_must_sign(policy, waived, needed):
    assert policy.needed(waived=waived) == needed


@pytest.fixture
def request_id(engine, submitted) -> int:
    row = submitted()
    with open_reading(engine) as session:
        return lists.list_newest(session, Approval, set=row.id)[0].id


def _beside(engine: Engine, console: Actor, request_id: int, name: str, password: str = PASSWORD) -> Signature:
    with open_writing(engine) as session:
        words = (approvals.Decision("APPROVE", "I approve"), proved(session, name, password), 1)
        return approvals.sign_over_the_shoulder(session, console, request_id, *words)


def test_a_second_person_signs_at_the_console_of_another(engine, people, request_id):
    signature = _beside(engine, people["ana"], request_id, "cy")
    assert (signature.user_id, signature.printed_name, signature.console) == (people["cy"].user_id, "Cy", "Ana")
    with open_reading(engine) as session:
        assert session.get_known(Approval, request_id).state == "APPROVED"
        record = audit.find_last_change(session, f"approvals/{request_id}")
        assert (record.actor, record.after["console"]) == ("Cy", "Ana")
        assert record.after["password_by"] == signature.password_by
    assert str(signature.password_by).startswith("given by Command")


@pytest.mark.parametrize(
    ("console", "name", "password", "error", "says"),
    [
        ("ana", "ana", PASSWORD, ForbiddenError, "your own console"),
        ("cy", "cy", PASSWORD, ForbiddenError, "leave the name empty"),
        ("cy", "ana", PASSWORD, ForbiddenError, "role approver, but Ana has only analyst"),
        ("ana", "root", PASSWORD, ForbiddenError, "An administrator cannot sign"),
        ("ana", "cy", "wrong horse battery", UnauthenticatedError, "Wrong name or password"),
        ("ana", "nobody", PASSWORD, UnauthenticatedError, "Wrong name or password"),
    ],
)
def test_over_the_shoulder_signs_nobody_who_may_not(engine, people, request_id, console, name, password, error, says):
    with pytest.raises(error, match=says):
        _beside(engine, people[console], request_id, name, password)
    with open_reading(engine) as session:
        assert session.get_known(Approval, request_id).state == "OPEN"
        assert not approval_queries.list_signatures(session, request_id)


def test_no_command_line_lends_a_console_and_whose_password_another_set_does_not_sign(engine, people, request_id):
    with pytest.raises(ForbiddenError, check=has_code("not-a-person")):
        _beside(engine, COMMAND_LINE, request_id, "cy")
    with open_writing(engine) as session:
        users.change_password(session, people["root"], people["cy"].user_id, new_password("another good one"))
    with pytest.raises(ForbiddenError, check=has_code("password-due")):
        _beside(engine, people["ana"], request_id, "cy", "another good one")


def _assign(engine: Engine, actor: Actor, request_id: int, user_id: int | None, version: int) -> Approval:
    with open_writing(engine) as session:
        return approvals.assign(session, actor, request_id, user_id, version)


def test_a_request_is_assigned_to_who_may_sign_it(engine, people, request_id):
    row = _assign(engine, people["ana"], request_id, people["cy"].user_id, 1)
    assert (row.assigned_to, row.version, row.state) == (people["cy"].user_id, 2, "OPEN")
    with pytest.raises(StaleError, match=r"v1.*v2.*Ana assigned", check=has_code("changed-since-read")):
        _assign(engine, people["ana"], request_id, None, 1)
    assert _assign(engine, people["dee"], request_id, None, 2).assigned_to is None


@pytest.mark.parametrize(
    ("actor", "named", "error", "says"),
    [
        ("ana", "ana", ConflictError, "Ana cannot sign this request"),
        ("ana", "root", ConflictError, "Root cannot sign"),
        ("eve", "cy", ForbiddenError, "role analyst"),
        ("ana", None, NotFoundError, "no user 99"),
    ],
)
def test_an_assignment_that_makes_no_sense_is_refused(engine, people, request_id, actor, named, error, says):
    with pytest.raises(error, match=says):
        _assign(engine, people[actor], request_id, people[named].user_id if named else 99, 1)


def test_a_disabled_person_is_asked_nothing_and_of_a_decided_request_nobody(engine, people, request_id):
    with open_writing(engine) as session:
        users.disable_user(session, people["root"], people["bo"].user_id)
    with pytest.raises(ConflictError, match=r"^Bo", check=has_code("person-disabled")):
        _assign(engine, people["ana"], request_id, people["bo"].user_id, 1)
    _beside(engine, people["ana"], request_id, "cy")
    with pytest.raises(ConflictError, match="APPROVED: Cy", check=has_code("wrong-state")):
        _assign(engine, people["ana"], request_id, people["cy"].user_id, 2)


def test_remarks_are_kept_in_order_and_on_record_and_hide_no_change(engine, people, request_id):
    with open_writing(engine) as session:
        threads.add_remark(session, people["cy"], request_id, " Was the heater on? ")
        threads.add_remark(session, people["ana"], request_id, "No.")
    with open_reading(engine) as session:
        said = [(row.printed_name, row.text) for row in approvals.list_remarks(session, request_id)]
        last = audit.find_last_change(session, f"approvals/{request_id}")
        assert last.action == "opened"  # who changed the request is still who submitted it
        assert audit.verify(session).ok
    assert said == [("Cy", "Was the heater on?"), ("Ana", "No.")]


@pytest.mark.parametrize(
    ("actor", "text", "error", "says"),
    [
        ("cy", "  ", RefusedInputError, "1 to 4000"),
        ("cy", "x" * 4001, RefusedInputError, "of 4001 characters"),
        ("cy", "a\x00b", RefusedInputError, "control character"),
        ("eve", "Hm.", ForbiddenError, "role analyst"),
    ],
)
def test_a_remark_that_says_nothing_or_too_much_is_refused(engine, people, request_id, actor, text, error, says):
    with open_writing(engine) as session, pytest.raises(error, match=says):
        threads.add_remark(session, people[actor], request_id, text)


def test_what_a_person_opened_is_kept_once_and_not_before_it_was_in_sight(engine, people, request_id, monkeypatch):
    with open_writing(engine) as session:
        for name in ("cy", "cy", "bo"):
            approvals.record_delivery(session, people[name], request_id, "radial")
        with pytest.raises(ConflictError):  # it was given just now
            approvals.record_opening(session, people["cy"], request_id, "radial")
        monkeypatch.setattr(approvals, "SHOWN_S", 0.0)
        with pytest.raises(ConflictError):  # nobody gave it to her
            approvals.record_opening(session, people["ana"], request_id, "radial")
        for name in ("cy", "cy", "bo"):
            approvals.record_opening(session, people[name], request_id, "radial")
    with open_reading(engine) as session:
        opened = [row.user_id for row in approvals.list_openings(session, request_id)]
    assert opened == [people["cy"].user_id, people["bo"].user_id]


def test_what_the_person_at_the_console_opened_does_not_count_for_who_signs_there(
    engine, people, request_id, monkeypatch
):
    monkeypatch.setattr(approvals, "SHOWN_S", 0.0)
    with open_writing(engine) as session:
        approvals.record_delivery(session, people["ana"], request_id, "radial")
        approvals.record_opening(session, people["ana"], request_id, "radial")
        decided = approvals.Decision("APPROVE", "I approve this set.", "")
        words = (request_id, decided, proved(session, people["cy"], PASSWORD), 1)
        signature = approvals.sign_over_the_shoulder(session, people["ana"], *words)
        assert [point.name for point in read_points(signature.points) if point.opened_utc is not None] == []
