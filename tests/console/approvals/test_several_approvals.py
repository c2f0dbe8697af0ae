"""How many sign: as many as the request needs, two where a gate is waived, and nobody twice over, with four eyes or one pair."""

from collections.abc import Callable, Mapping
from typing import Any

import pytest

from boresight.console import transitions
from boresight.console.approvals import gate_profiles, gates, staleness
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.errors import ConflictError, ForbiddenError
from boresight.platform.actors import POLICY, Actor, Policy
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, open_reading, open_writing, utc_after
from tests.console.conftest import SENSOR
from tests.passwords import proved

PASSWORD = "correct horse battery"
TWO, ALONE = Policy(approvals=2), Policy(four_eyes=False)
TIGHT = {"gates": [{"name": "parameter-shift", "limit": 1e-6, "marginal": 1e-6}]}
MOVED = SENSOR["initial"] | {"f_m": 0.0161}
People = Mapping[str, Actor]
Ask = Callable[..., Approval]


@pytest.fixture
def ask(engine: Engine, people: People, blobs: BlobStore, finished_run: Callable[..., Run]) -> Ask:
    def make(by: str = "ana", policy: Policy = POLICY, row: ParameterSet | None = None, **result: Any) -> Approval:
        with open_writing(engine) as session:
            if row is None:
                run = finished_run(session, people[by].user_id, **result)
                row = parameter_sets.create_from_run(session, people[by], blobs, run.id)
            now = transitions.get_parameter_set(session, row.id)
            return approvals.submit(session, people[by], blobs, row.id, "better", now.version, policy=policy)

    return make


def _sign(
    engine: Engine, actor: Actor, approval: Approval, decision: str = "APPROVE", policy: Policy = POLICY
) -> Approval:
    with open_writing(engine) as session:
        seen = transitions.get_approval(session, approval.id).version
        words = (decision, "I decide", "seen", proved(session, actor, PASSWORD), seen)
        approvals.sign(session, actor, approval.id, *words, policy=policy)
    with open_reading(engine) as session:
        return transitions.get_approval(session, approval.id)


def _promote(engine: Engine, actor: Actor, approval: Approval, policy: Policy = POLICY) -> str:
    with open_writing(engine) as session:
        row = transitions.get_parameter_set(session, approval.parameter_set_id)
        return approvals.promote(session, actor, row.id, row.version, policy=policy).ground_state


def test_a_request_that_needs_two_stays_open_after_one_and_is_approved_after_two(
    engine: Engine, people: People, ask: Ask
) -> None:
    approval = ask(policy=TWO)
    first = _sign(engine, people["cy"], approval)
    assert (first.needed, first.state, first.version, first.closed_utc) == (2, "OPEN", 2, None)
    with open_reading(engine) as session:
        record = audit.last_change(session, f"approvals/{approval.id}")
        assert record is not None
        assert (record.after or {})["approvals"] == "1 of 2"
        assert transitions.get_parameter_set(session, approval.parameter_set_id).ground_state == "SUBMITTED"
    with pytest.raises(ConflictError, match="You signed this request already"):
        _sign(engine, people["cy"], approval)
    assert _sign(engine, people["bo"], approval).state == "APPROVED"
    assert _promote(engine, people["dee"], approval) == "BASELINE"


def test_one_refusal_blocks_whatever_was_approved(engine: Engine, people: People, ask: Ask) -> None:
    approval = ask(policy=TWO)
    _sign(engine, people["cy"], approval)
    assert _sign(engine, people["bo"], approval, "REFUSE").state == "REJECTED"


@pytest.fixture
def tight(engine: Engine, people: People) -> None:
    with open_writing(engine) as session:
        gate_profiles.set_profile(session, people["root"], 1, TIGHT, "To be tried.", 0)


@pytest.mark.usefixtures("tight")
def test_what_a_gate_stops_can_be_refused_and_not_approved(engine: Engine, people: People, ask: Ask) -> None:
    approval = ask(parameters=MOVED)
    with pytest.raises(ConflictError, match=r"stopped by its gates: parameter-shift \(FAIL\)\. Waive it"):
        _sign(engine, people["cy"], approval)
    assert _sign(engine, people["cy"], approval, "REFUSE").state == "REJECTED"


def test_a_critical_gate_is_never_passed(engine: Engine, people: People, ask: Ask) -> None:
    names = ["f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y"]
    negative = {"names": names, "matrix": [[-1e-12 if i == j else 0.0 for j in range(8)] for i in range(8)]}
    approval = ask(covariance=negative)
    with pytest.raises(ConflictError, match=r"covariance \(FAIL\).* covariance cannot be waived: recalibrate"):
        _sign(engine, people["cy"], approval)


@pytest.mark.usefixtures("tight")
def test_a_waiver_asks_for_a_new_request_with_a_second_approval(engine: Engine, people: People, ask: Ask) -> None:
    approval = ask(parameters=MOVED)
    with open_writing(engine) as session:
        row = transitions.get_parameter_set(session, approval.parameter_set_id)
        proof = proved(session, people["ana"], PASSWORD)
        words = ("known-cause", "The wheels were spun up during this pass.", utc_after(86400.0), proof, row.version)
        waiver = gates.waive(session, people["ana"], row.id, "parameter-shift", *words)
    again = ask(row=row)
    assert (_state(engine, approval), again.needed, again.bound["waivers"]) == ("STALE", 2, [waiver.id])
    _sign(engine, people["cy"], again)
    assert _sign(engine, people["bo"], again).state == "APPROVED"
    assert _promote(engine, people["dee"], again) == "BASELINE"
    with open_reading(engine) as session:
        report = gates.with_waivers(session, gates.newest_report(session, row.id))
    assert "waived" in report["words"]


def _state(engine: Engine, approval: Approval) -> str:
    with open_reading(engine) as session:
        return transitions.get_approval(session, approval.id).state


def test_a_signature_stands_for_gate_report_waivers_and_time(ask: Ask) -> None:
    approval = ask()
    shown = staleness.compute_binding_sha256(approval)
    for name in ("gate_report_sha256", "profile_sha256", "incumbent_sha256", "table_definition_sha256", "waivers"):
        other = Approval(**{**_columns(approval), "bound": approval.bound | {name: "another"}})
        assert staleness.compute_binding_sha256(other) != shown
    for name, value in (("needed", 2), ("kind", "ROLLBACK"), ("expires_utc", "2099-01-01T00:00:00.000000Z")):
        assert staleness.compute_binding_sha256(Approval(**{**_columns(approval), name: value})) != shown


def _columns(approval: Approval) -> dict[str, Any]:
    return {column.name: getattr(approval, column.name) for column in Approval.__table__.columns}


def test_with_four_eyes_off_the_submitter_signs_and_the_record_says_so(
    engine: Engine, people: People, ask: Ask
) -> None:
    approval = ask("bo", ALONE)
    with pytest.raises(ForbiddenError, match="You submitted this set"):
        _sign(engine, people["bo"], approval)
    assert _sign(engine, people["bo"], approval, policy=ALONE).state == "APPROVED"
    with open_reading(engine) as session:
        record = audit.last_change(session, f"approvals/{approval.id}")
        assert record is not None
        assert (record.after or {})["four_eyes"] is False
    assert _promote(engine, people["dee"], approval, ALONE) == "BASELINE"


def test_what_was_signed_alone_does_not_pass_once_four_eyes_is_on(engine: Engine, people: People, ask: Ask) -> None:
    approval = ask("bo", ALONE)
    _sign(engine, people["bo"], approval, policy=ALONE)
    with pytest.raises(
        ConflictError, match=r"0 of 1 approvals by a second person: it was signed while four-eyes was off"
    ):
        _promote(engine, people["dee"], approval)


@pytest.mark.parametrize(
    ("policy", "waived", "needed"), [(POLICY, False, 1), (POLICY, True, 2), (TWO, False, 2), (ALONE, True, 1)]
)
def test_the_policy_says_how_many_must_sign(policy: Policy, waived: bool, needed: int) -> None:
    assert policy.needed(waived=waived) == needed
