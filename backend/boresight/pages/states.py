"""Every state word the pages show, with its level: the colour and shape it is drawn in.

The levels are the six of the Astro UX status system, worst last. Red is kept for what needs a person now, so
a cancelled run or a refused request is never red. A consolidated indicator takes the worst of its children.
"""

from __future__ import annotations

from collections.abc import Iterable

from boresight.verdicts.verdict import LEVEL_OF_STATUS, LEVELS

__all__ = ["LEVELS", "LEVEL_OF_STATE", "level_of", "worst"]

LEVEL_OF_STATE = {
    # runs
    "QUEUED": "standby",
    "RUNNING": "standby",
    "CANCELLING": "caution",
    "SUCCEEDED": "normal",
    "FAILED": "serious",
    "CANCELLED": "off",
    "LOST": "serious",
    # parameter sets on the ground
    "CANDIDATE": "standby",
    "SUBMITTED": "standby",
    "APPROVED": "normal",
    "BASELINE": "normal",
    "SUPERSEDED": "off",
    "REJECTED": "off",
    "WITHDRAWN": "off",
    "CONFIRMED": "normal",
    "REFUSED": "serious",
    "EXPIRED": "serious",
    # parameter sets on board
    "NOT SENT": "off",
    "SENT": "standby",
    "LOADED": "standby",
    "VERIFIED": "normal",
    "ACTIVE": "normal",
    "MISMATCH": "critical",
    "UNKNOWN": "off",
    # approvals and signatures
    "OPEN": "standby",
    "STALE": "caution",
    "APPROVE": "normal",
    "REFUSE": "caution",
    # gates
    "PASS": "normal",
    "MARGINAL": "caution",
    "FAIL": "serious",
    "NO-DATA": "caution",
}


def level_of(state: str) -> str:
    """Return the level of a state word; a level stands for itself in any case, an unheard-of word is `off`."""
    return state.lower() if state.lower() in LEVELS else (LEVEL_OF_STATE | LEVEL_OF_STATUS).get(state, "off")


def worst(states: Iterable[str]) -> str:
    """Return the worst level of several state words; `off` when there are none."""
    return max((level_of(state) for state in states), key=LEVELS.index, default="off")
