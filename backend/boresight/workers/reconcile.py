"""Keeping the run rows true: everything the engine writes to the database, one short transaction each.

Leases: what we hold we renew three times a lease; what lapses belonged to a server that is gone and is queued again,
or ended when it has lost too many attempts. Every write is fenced by attempt and state (see `boresight.store.runs`), so
two servers on one database cannot both end a run, and a result that comes too late writes nothing.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from boresight.store import runs
from boresight.store.marks import Kept, Marks
from boresight.store.queued_runs import Claimed, Waiting, waiting_runs
from boresight.store.run_events import Line, write_event
from boresight.store.runs import End, Held
from boresight.store.sessions import Engine as Database
from boresight.store.sessions import reading, utc_now, writing
from boresight.workers.paces import Paces
from boresight.workers.planning import Group, planned
from boresight.workers.reports import Report

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Reconciler:
    """The database as one owner of runs sees it.

    Parameters
    ----------
    database
        The store.
    owner
        Names this engine among all that share the database.
    lease_s
        How long a claim holds without a renewal.
    max_attempts
        After so many lost attempts a run is ended.
    paces
        What the newest runs took, from which groups are made.
    """

    database: Database
    owner: str
    lease_s: float
    max_attempts: int
    paces: Paces = field(default_factory=Paces)

    @cached_property
    def _marks(self) -> Marks:
        """Tells whether anything was committed: what is asked every turn is read only then."""
        return Marks(self.database)

    @cached_property
    def _waiting(self) -> Kept[list[Waiting]]:
        return Kept(self._marks)

    @cached_property
    def _stops(self) -> Kept[set[Held]]:
        return Kept(self._marks)

    def close(self) -> None:
        """Let go of the store."""
        self._marks.close()

    def settle(self, ends: Sequence[End]) -> None:
        """Write how attempts ended, unless they no longer hold their runs."""
        with writing(self.database) as session:
            written = runs.finish_all(session, ends)
        for held in {(end.run_id, end.attempt) for end in ends} - written.keys():
            log.info("Run %d: a late end of attempt %d writes nothing", *held)

    def give_up(self, members: Collection[Held], cause: str, *, begun: bool = True) -> None:
        """Write that a task was lost with its worker.

        A run that was alone in it is charged with the loss. Of several nobody knows which one was guilty, and of a task that had
        not begun none was: they go back unharmed, and alone the next time.
        """
        with writing(self.database) as session:
            for held in members:
                if begun and len(members) == 1:
                    runs.give_up_attempt(session, *held, cause, self.max_attempts)
                else:
                    runs.put_back(session, *held, cause)

    def put_back(self, members: Collection[Held], cause: str) -> None:
        """Queue attempts again that ended through no fault of their own."""
        if members:
            with writing(self.database) as session:
                for held in members:
                    runs.put_back(session, *held, cause)

    def put_back_or_give_up(self, members: Collection[Held], cause: str) -> None:
        """Queue attempts again whose worker was gone though the scheduler charged nobody with its end.

        They are not to blame, unless it goes on so: a scheduler that allows failures never says which task ended a
        worker, and a run that ends every worker must come to an end itself.
        """
        again = {held for held in members if held[1] <= 2 * self.max_attempts}
        self.put_back(again, cause)
        self.give_up(set(members) - again, cause)

    def end_cancelled(self, held: Held) -> None:
        """Write that an attempt which did not answer was ended by force."""
        with writing(self.database) as session:
            runs.finish(session, *held, "CANCELLED")

    def renew(self, members: Collection[Held]) -> set[Held]:
        """Renew our leases and give up lapsed ones of others; return those of `members` that are no longer ours."""
        with writing(self.database) as session:
            ours = runs.renew(session, self.owner, self.lease_s, [run_id for run_id, _ in members])
            runs.give_up_expired(session, self.max_attempts)
        return {held for held in members if held not in ours}

    def stops(self, members: Collection[Held]) -> set[Held]:
        """Return those attempts that somebody asked to stop."""
        return self._stops.answer(frozenset(members), lambda: self._asked_to_stop(members))

    def _asked_to_stop(self, members: Collection[Held]) -> set[Held]:
        """Read the states of attempts."""
        with reading(self.database) as session:
            states = runs.states_of(session, [run_id for run_id, _ in members])
        return {held for held in members if states.get(held) == "CANCELLING"}

    def record(self, reports: Mapping[Held, Report], lines: Mapping[Held, Line]) -> None:
        """Write how far attempts are and when they said so, with what a live page draws, and lines for their logs."""
        with writing(self.database) as session:
            for held, report in reports.items():
                if runs.record_progress(session, *held, report.progress(utc_now())) and held in lines:
                    write_event(session, *held, lines[held])

    def waiting(self, limit: int) -> list[Waiting]:
        """Return the oldest runs that wait."""
        return self._waiting.answer(limit, lambda: self._oldest(limit))

    def _oldest(self, limit: int) -> list[Waiting]:
        """Read the oldest runs that wait."""
        with reading(self.database) as session:
            return waiting_runs(session, limit)

    def take(
        self, waiting: Sequence[Waiting], free: int, followed: int, threads: int
    ) -> list[tuple[Group, list[Claimed]]]:
        """Claim the oldest of the waiting runs for free threads and for those to be followed, grouped into tasks."""
        with writing(self.database) as session:
            self.paces.refresh(session, {run.method for run in waiting})
            groups = planned(waiting, free, followed, threads, self.paces.seconds)
            run_ids = [run_id for group in groups for run_id in group.run_ids]
            claimed = runs.claim(session, self.owner, self.lease_s, len(run_ids), run_ids) if run_ids else []
        ours = {run.run_id: run for run in claimed}
        kept = [(group, [ours[run_id] for run_id in group.run_ids if run_id in ours]) for group in groups]
        return [(group, members) for group, members in kept if members]
