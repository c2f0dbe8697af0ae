"""Promotion: one is baseline whoever races, what moved is stale, and the way back is a way forward."""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import pytest
import sqlalchemy as sa

from boresight.console.approvals import service as approvals
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.errors import ForbiddenError, StaleError
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from tests.passwords import approve

PASSWORD = "correct horse battery"
People = Mapping[str, Actor]


def _approve(session: Session, approver: Actor, set_id: int) -> None:
    approval = approvals.list_approvals(session, parameter_set_id=set_id, state="OPEN")[0]
    approve(session, approver, approval)


def _promote(engine: Engine, actor: Actor, row: ParameterSet) -> ParameterSet:
    with open_writing(engine) as session:
        return approvals.promote(session, actor, row.id, row.version)


def _states(engine: Engine) -> dict[str, str]:
    with open_reading(engine) as session:
        return {row.name: row.ground_state for row in parameter_sets.list_parameter_sets(session)}


@pytest.mark.parametrize("name", ["ana", "bo", "cy", "eve", "root"])
def test_only_an_operator_promotes(
    engine: Engine, people: People, approved: Callable[[], ParameterSet], name: str
) -> None:
    row = approved()
    with pytest.raises(ForbiddenError, match="role operator"):
        _promote(engine, people[name], row)
    assert _states(engine) == {"PS-ST16-1-0": "BASELINE", row.name: "APPROVED"}


def test_promotion_supersedes_points_and_records_in_one(
    engine: Engine, people: People, approved: Callable[[], ParameterSet]
) -> None:
    row = approved()
    promoted = _promote(engine, people["dee"], row)
    assert _states(engine) == {"PS-ST16-1-0": "SUPERSEDED", row.name: "BASELINE"}
    with open_reading(engine) as session:
        ground = session.scalars(sa.select(ParameterSet).where(ParameterSet.number == 0)).one()
        assert ground.baseline_to_utc == promoted.baseline_from_utc
        promotions = session.scalars(sa.select(Promotion).order_by(Promotion.id)).all()
        assert [entry.parameter_set_id for entry in promotions] == [ground.id, row.id]
        assert promotions[1].promoted_by == people["dee"].user_id
        record = audit.last_change(session, f"parameter-sets/{row.id}")
        assert record is not None
        assert (record.action, record.after["sha256"]) == ("promoted", row.sha256)  # type: ignore[index]
        assert audit.verify(session).ok


def test_a_promotion_that_fails_at_its_end_leaves_the_old_baseline(
    engine: Engine, people: People, approved: Callable[[], ParameterSet], monkeypatch: pytest.MonkeyPatch
) -> None:
    row = approved()

    def break_down(*_: object) -> None:
        raise OSError("the disk is full")

    monkeypatch.setattr(approvals, "make_others_stale", break_down)
    with pytest.raises(OSError, match="disk"):
        _promote(engine, people["dee"], row)
    assert _states(engine) == {"PS-ST16-1-0": "BASELINE", row.name: "APPROVED"}


def test_of_two_promotions_at_once_one_wins_and_one_baseline_is_left(
    engine: Engine, people: People, approved: Callable[[], ParameterSet]
) -> None:
    rows = [approved() for _ in range(4)]

    def promote(row: ParameterSet) -> str:
        try:
            return _promote(engine, people["dee"], row).name
        except StaleError:
            return "stale"

    with ThreadPoolExecutor(4) as pool:
        outcomes = list(pool.map(promote, rows))
    states = _states(engine)
    assert sorted(outcomes)[1:] == ["stale"] * 3
    assert [name for name, state in states.items() if state == "BASELINE"] == [min(outcomes)]
    assert sorted(states.values()) == ["BASELINE", "CANDIDATE", "CANDIDATE", "CANDIDATE", "SUPERSEDED"]
    with open_reading(engine) as session:
        assert audit.verify(session).ok


def test_another_promotion_makes_every_request_of_the_sensor_stale(
    engine: Engine, people: People, submitted: Callable[[], ParameterSet], approved: Callable[[], ParameterSet]
) -> None:
    waiting, signed, winner = submitted(), approved(), approved()
    _promote(engine, people["dee"], winner)
    with open_reading(engine) as session:
        states = {row.parameter_set_id: row.state for row in approvals.list_approvals(session)}
    assert states == {waiting.id: "STALE", signed.id: "STALE", winner.id: "APPROVED"}
    assert _states(engine)[signed.name] == "CANDIDATE"


def test_an_incumbent_that_moved_unseen_makes_the_approval_stale_for_good(
    engine: Engine, people: People, approved: Callable[[], ParameterSet], candidate: Callable[..., ParameterSet]
) -> None:
    row, other = approved(), candidate()
    with open_writing(engine) as session:  # as if the incumbent had been exchanged past the services
        for number, state in ((1, "SUPERSEDED"), (other.id, "BASELINE")):
            session.get_one(ParameterSet, number).ground_state = state
            audit.append(session, people["root"], "exchanged", f"parameter-sets/{number}")
    with pytest.raises(StaleError, match=r"incumbent moved .* The baseline is PS-ST16-1-2: Root exchanged it .* again"):
        _promote(engine, people["dee"], row)
    with open_reading(engine) as session:
        assert approvals.list_approvals(session)[0].state == "STALE"
    assert _states(engine) == {"PS-ST16-1-0": "SUPERSEDED", row.name: "CANDIDATE", other.name: "BASELINE"}


def test_rollback_is_a_new_request_for_an_older_set(
    engine: Engine, people: People, approved: Callable[[], ParameterSet], blobs: BlobStore
) -> None:
    row = approved()
    _promote(engine, people["dee"], row)
    with open_writing(engine) as session:
        ground = session.scalars(sa.select(ParameterSet).where(ParameterSet.number == 0)).one()
        approvals.submit(session, people["ana"], blobs, ground.id, "the new one drifts", ground.version)
        _approve(session, people["cy"], ground.id)
        approvals.promote(session, people["dee"], ground.id, ground.version)
    assert _states(engine) == {"PS-ST16-1-0": "BASELINE", row.name: "SUPERSEDED"}


def test_a_rollback_withdrawn_stays_superseded(
    engine: Engine, people: People, approved: Callable[[], ParameterSet], blobs: BlobStore
) -> None:
    _promote(engine, people["dee"], approved())
    with open_writing(engine) as session:
        ground = session.scalars(sa.select(ParameterSet).where(ParameterSet.number == 0)).one()
        approvals.submit(session, people["ana"], blobs, ground.id, "the new one drifts", ground.version)
        approvals.withdraw(session, people["ana"], ground.id, ground.version)
        assert ground.ground_state == "SUPERSEDED"
