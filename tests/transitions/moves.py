"""The one list of moves: who tries what on a request in which state, and the few moves of it that are allowed.

The moves are the full product of actors, transitions and places. What is not in ALLOWED must be refused.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

from boresight.console.access.tables import ROLES
from boresight.console.parameter_sets.tables import GROUND_STATES

ACTORS = (
    *ROLES,  # a person with one role each, who has no part in the request
    "submitter",  # analyst and approver, who submitted the set
    "launcher",  # analyst and approver, who launched the run that the set comes from
    "creator",  # analyst and approver, who created the set of somebody else's run
    "signer",  # approver, who signed whatever is signed
    "newcomer",  # approver, whose password somebody else set
    "key of the analyst",
    "key of the operator",
    "key of the approver",
    "key of the submitter",
)
PLACES = (
    *GROUND_STATES,
    "STALE",  # a candidate again, since what its request was bound to moved
    "HALF",  # submitted, and one of the two approvals that it needs is given
)
TRANSITIONS = (
    "submit",
    "roll-back",
    "withdraw",
    "approve",
    "refuse",
    "approve-over-the-shoulder",
    "refuse-over-the-shoulder",
    "promote",
    "assign",
)
OF_REQUEST = ("approve", "refuse", "approve-over-the-shoulder", "refuse-over-the-shoulder", "assign")


@dataclass(frozen=True)
class Move:
    actor: str
    transition: str
    place: str

    def __str__(self) -> str:
        return f"{self.actor}, {self.transition}, {self.place}".replace(" ", "_")


def _allow(actors: str, transitions: str, places: str) -> set[Move]:
    named = (text.split(", ") for text in (actors, transitions, places))
    return {Move(*parts) for parts in itertools.product(*named)}


SIGNATURES = "approve, refuse, approve-over-the-shoulder, refuse-over-the-shoulder"
ALLOWED = (
    _allow(
        "analyst, submitter, launcher, creator, key of the analyst, key of the submitter",
        "submit",
        "CANDIDATE, WITHDRAWN, EXPIRED, SUPERSEDED, STALE",
    )
    | _allow(
        "analyst, operator, submitter, launcher, creator, key of the analyst, key of the operator, key of the submitter",
        "roll-back",
        "SUPERSEDED",
    )
    | _allow("submitter, key of the submitter, administrator", "withdraw", "SUBMITTED, APPROVED, HALF")
    | _allow("approver, signer", SIGNATURES, "SUBMITTED")
    | _allow("approver", SIGNATURES, "HALF")
    | _allow("approver", "refuse, refuse-over-the-shoulder", "APPROVED")
    | _allow("operator, key of the operator", "promote", "APPROVED")
    | _allow(
        "analyst, operator, approver, administrator, submitter, launcher, creator, signer",
        "assign",
        "SUBMITTED, HALF",
    )
)
MOVES = [Move(*parts) for parts in itertools.product(ACTORS, TRANSITIONS, PLACES)]
FORBIDDEN = [move for move in MOVES if move not in ALLOWED]
