"""Which waiting runs go to the workers next, and which of them share a task.

A task costs about 10 ms to hand over, so runs of tens of milliseconds are computed several in one task, up to about a
second's worth; a run that takes longer, or that was tried before (its neighbours shall not die with it), goes alone. No
more tasks are made than there are free threads: a run that is RUNNING is really running, and other servers that share
the database find the rest still QUEUED.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from boresight.store.runs import Waiting

GROUP_S = 1.0
GROUP_RUNS = 32


def planned(waiting: Sequence[Waiting], slots: int, seconds_of: Callable[[Waiting], float]) -> list[list[int]]:
    """Divide the oldest waiting runs over the free threads.

    Parameters
    ----------
    waiting
        Runs nobody holds, oldest first.
    slots
        Free threads.
    seconds_of
        The predicted time of a run.

    Returns
    -------
    list of list of int
        At most `slots` groups of run ids.
    """
    most = min(GROUP_RUNS, math.ceil(len(waiting) / max(1, slots)))
    groups: list[list[int]] = []
    room_s = 0.0
    for run in waiting:
        seconds = GROUP_S if run.attempt else seconds_of(run)
        if not groups or seconds > room_s or len(groups[-1]) >= most:
            if len(groups) == slots:
                break
            groups.append([])
            room_s = GROUP_S
        groups[-1].append(run.run_id)
        room_s -= seconds
    return groups
