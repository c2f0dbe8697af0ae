"""The server's heartbeat: what happens because time passes, and nobody asks for it.

Every few seconds it looks for requests for approval and proposed changes whose time is over, in a reading transaction
that holds nobody up, and writes only when there are any.
"""

from __future__ import annotations

from collections.abc import Callable

from boresight.api.rounds import Rounds
from boresight.services import approvals, proposals
from boresight.store.sessions import Engine, reading, writing

BEAT_S = 5.0


class Heartbeat:
    """The heartbeat of one server.

    Parameters
    ----------
    database
        Where the requests are.
    tell
        Called after something was written, for those who follow the store.
    """

    def __init__(self, database: Engine, tell: Callable[[], None]) -> None:
        self._database = database
        self._tell = tell
        self._rounds = Rounds("heartbeat", [self.beat], lambda: BEAT_S)

    def start(self) -> None:
        """Begin to beat; the first beat is at once, for what became due while no server ran."""
        self._rounds.start()

    def close(self) -> None:
        """Stop; safe to call twice."""
        self._rounds.close()

    def beat(self) -> None:
        """Let everything expire whose time is over."""
        with reading(self._database) as session:
            waiting = approvals.any_due(session) or proposals.any_due(session)
        if waiting:
            with writing(self._database) as session:
                approvals.expire_due(session)
                proposals.expire_due(session)
            self._tell()
