"""Who may sign: nobody who submitted the set, launched its run or campaign, or created it, by whatever credential."""

from collections.abc import Callable, Mapping

import pytest

from boresight.console import transitions
from boresight.console.access import api_keys
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval
from boresight.console.campaigns import service as campaigns
from boresight.console.campaigns.tables import Campaign, CampaignRun
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.console.uplinks.packages import four_eyes
from boresight.errors import ConflictError, ForbiddenError
from boresight.platform.actors import POLICY, Actor, Policy
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from tests.console.conftest import PASSWORD
from tests.passwords import add_person, approve, proved

People = Mapping[str, Actor]
ALONE = Policy(four_eyes=False)


@pytest.fixture
def created(
    engine: Engine, people: People, blobs: BlobStore, finished_run: Callable[..., Run]
) -> Callable[..., ParameterSet]:
    def make(creator: Actor | str, launcher: str = "ana") -> ParameterSet:
        actor = people[creator] if isinstance(creator, str) else creator
        with open_writing(engine) as session:
            run = finished_run(session, people[launcher].user_id)
            return parameter_sets.create_from_run(session, actor, blobs, run.id)

    return make


@pytest.fixture
def ask(engine: Engine, people: People, blobs: BlobStore) -> Callable[..., Approval]:
    def make(row: ParameterSet, submitter: str = "ana", policy: Policy = POLICY) -> Approval:
        with open_writing(engine) as session:
            return approvals.submit(session, people[submitter], blobs, row.id, "better", row.version, policy=policy)

    return make


def _sign(engine: Engine, actor: Actor, approval: Approval, policy: Policy = POLICY) -> str:
    with open_writing(engine) as session:
        seen = transitions.get_approval(session, approval.id).version
        approve(session, actor, approval, seen_version=seen, policy=policy)
        return transitions.get_approval(session, approval.id).state


def _signers(engine: Engine, approval: Approval, policy: Policy = POLICY) -> dict[str, tuple[str, ...] | None]:
    with open_reading(engine) as session:
        found = approvals.who_may_sign(session, approval.id, policy=policy)
    return {one.user.name: one.roles if one.refusal else None for one in found}


def test_who_created_a_set_does_not_approve_it(
    engine: Engine, people: People, created: Callable[..., ParameterSet], ask: Callable[..., Approval]
) -> None:
    approval = ask(created("bo"))
    with pytest.raises(ForbiddenError, match="You created this set; another approver must sign"):
        _sign(engine, people["bo"], approval)
    with open_reading(engine) as session:
        assert "You created this set" in str(approvals.why_not_sign(session, people["bo"], approval.id))
    assert _signers(engine, approval) == {"bo": ("CREATOR",), "cy": None}
    assert _sign(engine, people["cy"], approval) == "APPROVED"


def test_each_of_the_three_parts_excludes_and_all_are_named(
    engine: Engine, people: People, created: Callable[..., ParameterSet], ask: Callable[..., Approval]
) -> None:
    approval = ask(created("bo", "bo"), "bo")
    assert _signers(engine, approval) == {"bo": ("SUBMITTER", "LAUNCHER", "CREATOR"), "cy": None}
    with pytest.raises(ForbiddenError, match=r"submitted this set and launched run \d+ behind this set and created"):
        _sign(engine, people["bo"], approval)
    with open_writing(engine) as session, pytest.raises(ConflictError, match="Bo submitted this set"):
        approvals.assign(session, people["ana"], approval.id, people["bo"].user_id, approval.version)


def test_a_set_created_with_a_key_is_its_owners(
    engine: Engine, people: People, created: Callable[..., ParameterSet], ask: Callable[..., Approval]
) -> None:
    with open_writing(engine) as session:
        secret = api_keys.create_key(session, people["bo"], label="robot", scopes=["parameter-sets"])[1]
        robot = api_keys.actor_of_key(session, secret)
    approval = ask(created(robot))
    with pytest.raises(ForbiddenError, match="You created this set"):
        _sign(engine, people["bo"], approval)


def test_over_the_shoulder_the_creator_does_not_sign_either(
    engine: Engine, people: People, created: Callable[..., ParameterSet], ask: Callable[..., Approval]
) -> None:
    approval = ask(created("bo"))
    with open_reading(engine) as session:
        words = ("APPROVE", "I approve", "", proved(session, "bo", PASSWORD), approval.version)
    with open_writing(engine) as session, pytest.raises(ForbiddenError, match="You created this set"):
        approvals.sign_over_the_shoulder(session, people["ana"], approval.id, *words)


def test_who_launched_the_campaign_does_not_approve_what_another_launched_again(
    engine: Engine, people: People, created: Callable[..., ParameterSet], ask: Callable[..., Approval]
) -> None:
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
    with pytest.raises(ForbiddenError, match="You launched campaign 1 behind this set"):
        _sign(engine, people["bo"], approval)


def test_a_roll_back_excludes_who_created_the_former_baseline(
    engine: Engine, people: People, blobs: BlobStore, created: Callable[..., ParameterSet], ask: Callable[..., Approval]
) -> None:
    rows = [created("bo"), created("ana")]
    for row in rows:
        approval = ask(row)
        _sign(engine, people["cy"], approval)
        with open_writing(engine) as session:
            version = transitions.get_parameter_set(session, row.id).version
            approvals.promote(session, people["dee"], row.id, version)
    with open_writing(engine) as session:
        version = transitions.get_parameter_set(session, rows[0].id).version
        back = approvals.roll_back(session, people["dee"], blobs, rows[0].id, "It drifts.", version)
    with pytest.raises(ForbiddenError, match="You created this set"):
        _sign(engine, people["bo"], back)
    assert _sign(engine, people["cy"], back) == "APPROVED"


def test_of_several_approvals_none_is_the_creators(
    engine: Engine, people: People, created: Callable[..., ParameterSet], ask: Callable[..., Approval]
) -> None:
    two = Policy(approvals=2)
    with open_writing(engine) as session:
        add_person(session, "flo", "approver")
    approval = ask(created("bo"), policy=two)
    assert _sign(engine, people["cy"], approval, two) == "OPEN"
    with pytest.raises(ForbiddenError, match="You created this set"):
        _sign(engine, people["bo"], approval, two)
    assert _signers(engine, approval, two) == {"bo": ("CREATOR",), "cy": (), "flo": None}


def test_what_the_creator_signed_while_four_eyes_was_off_does_not_pass_once_it_is_on(
    engine: Engine, people: People, created: Callable[..., ParameterSet], ask: Callable[..., Approval]
) -> None:
    row = created("bo")
    approval = ask(row, policy=ALONE)
    assert _signers(engine, approval, ALONE) == {"bo": None, "cy": None}
    assert _sign(engine, people["bo"], approval, ALONE) == "APPROVED"
    with open_writing(engine) as session:
        version = transitions.get_parameter_set(session, row.id).version
        with pytest.raises(ConflictError, match="0 of 1 approvals by a second person"):
            approvals.promote(session, people["dee"], row.id, version)
        assert four_eyes(session, row, POLICY)["kept"] is False
