"""Which waiting runs go to the workers next, and which of them share a task.

To hand over a task, fetch its answer and write it costs tens of milliseconds, so short runs are computed several in one task: two
seconds' worth where few wait, and of a long queue up to a quarter of what waits for each thread, eight seconds at most, for who
queued a thousand runs waits for the last and not for the next. A run that takes over two seconds, or that was tried before (its
neighbours shall not die with it), goes alone. A free thread gets a task; a thread that computes short runs may get a second group
to go on with, but only while more runs wait than there are threads. So the few runs of a person are spread over the threads and
really run when they are RUNNING, and other servers that share the database find the rest still QUEUED.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from boresight.store.queued_runs import Waiting

GROUP_S = 2.0
LONG_GROUP_S, QUEUE_SHARE = 8.0, 0.25
GROUP_RUNS = 64


@dataclass(frozen=True)
class Group:
    """Runs that share a task.

    Parameters
    ----------
    run_ids
        Oldest first.
    seconds
        Predicted time of all.
    short
        Whether they all are short and were never tried before, so that such a group may follow them, or they such a group.
    """

    run_ids: list[int]
    seconds: float
    short: bool


def planned(
    waiting: Sequence[Waiting], free: int, followed: int, threads: int, seconds_of: Callable[[Waiting], float]
) -> list[Group]:
    """Divide the oldest waiting runs over the threads.

    Parameters
    ----------
    waiting
        Runs nobody holds, oldest first.
    free
        Threads without a task.
    followed
        Threads that compute short runs and may be given a group of such to follow.
    threads
        All that there are, busy or not.
    seconds_of
        The predicted time of a run.

    Returns
    -------
    list of Group
        At most `free + followed`, those beyond `free` short.
    """
    slots = free + followed
    most = min(GROUP_RUNS, math.ceil(len(waiting) / max(1, slots)))
    share_s = QUEUE_SHARE * sum(map(seconds_of, waiting)) / max(1, threads)
    longest_s = min(LONG_GROUP_S, max(GROUP_S, share_s))
    groups: list[Group] = []
    rest = list(waiting)
    while rest and len(groups) < slots:
        group = _first_group(rest, most, longest_s, seconds_of)
        if len(groups) >= free and not group.short:
            break
        groups.append(group)
        rest = rest[len(group.run_ids) :]
    return groups


def _first_group(
    waiting: Sequence[Waiting], most: int, longest_s: float, seconds_of: Callable[[Waiting], float]
) -> Group:
    """Return the oldest runs that may share a task."""
    total_s = seconds_of(waiting[0])
    if waiting[0].attempt or total_s > GROUP_S:
        return Group([waiting[0].run_id], total_s, short=False)
    chosen = [waiting[0].run_id]
    for run in waiting[1:most]:
        seconds = seconds_of(run)
        if run.attempt or seconds > GROUP_S or total_s + seconds > longest_s:
            break
        chosen.append(run.run_id)
        total_s += seconds
    return Group(chosen, total_s, short=True)
