"""When the ground under a request moves: what it binds is not what was shown any more, so nobody may decide on it.

A request binds the hashes of the set, of its run's result and of the baseline that it would replace. Promoting a set
makes the sensor's other requests STALE at once; `refuse_moved` asks again at every signature and promotion, for
whatever else may have happened to the rows.
"""

from __future__ import annotations

from boresight.errors import StaleError
from boresight.services.actors import Actor
from boresight.services.transitions import bound_hashes, move, resting_state, who_changed
from boresight.store import approvals as approval_rows
from boresight.store import parameter_sets as rows
from boresight.store.documents import sha256_of
from boresight.store.sessions import Session, keep_despite_refusal, utc_now
from boresight.store.tables import Approval, ParameterSet


def make_others_stale(session: Session, actor: Actor, promoted: ParameterSet) -> None:
    """Void the requests that compare with the baseline of before."""
    for approval in approval_rows.undecided_of_sensor(session, promoted.sensor_id):
        _make_stale(session, actor, approval, f"{promoted.name} became baseline")


def _make_stale(session: Session, actor: Actor, approval: Approval, reason: str) -> None:
    """Close a request as STALE; its set may be submitted again."""
    row = session.get_one(ParameterSet, approval.parameter_set_id)
    approval.closed_utc = utc_now()
    move(session, actor, approval, "STALE", "made stale", reason=reason)
    move(session, actor, row, resting_state(row, "CANDIDATE"), "returned", reason=f"its request became stale: {reason}")


def refuse_moved(session: Session, actor: Actor, approval: Approval, row: ParameterSet) -> None:
    """Make a request stale and refuse, when anything that it binds is not what it was when submitted.

    Raises
    ------
    StaleError
        Says what moved; the request stays STALE although the refusal is raised.
    """
    current = bound_hashes(session, row)
    current["set_sha256"] = sha256_of(row.document)
    moved = [
        name.removesuffix("_sha256").replace("_", " ") for name in current if current[name] != approval.bound[name]
    ]
    if not moved:
        return
    incumbent = rows.baseline(session, row.sensor_id)
    since = f" The baseline is {incumbent.name}: {who_changed(session, incumbent)}." if incumbent else ""
    _make_stale(session, actor, approval, f"the {' and the '.join(moved)} moved")
    keep_despite_refusal(session)
    raise StaleError(f"The {' and the '.join(moved)} moved since {row.name} was submitted.{since} Submit it again.")
