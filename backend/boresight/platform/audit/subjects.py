"""What audit records say, typed: what one is about, the actions that something reads, and the state it left."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

#: Digits of a row's number: what is longer is none.
MOST_DIGITS = 18


@dataclass(frozen=True)
class AuditSubject:
    """What a record is about, as the REST API addresses it: `approvals/3/remarks/5` is remark 5, a part of request 3."""

    noun: str
    id: int | None = None
    part: AuditSubject | None = None

    def __str__(self) -> str:
        """Write the address, as the log stores it."""
        return "/".join(str(one) for one in (self.noun, self.id, self.part) if one is not None)


def parse_subject(address: str) -> AuditSubject:
    """Read the object of a record; what has no number has its further words as parts."""
    noun, _, rest = address.partition("/")
    number, further, part = rest.partition("/")
    if number.isdecimal() and len(number) <= MOST_DIGITS and str(int(number)) == number:
        return AuditSubject(noun, int(number), parse_subject(part) if further else None)
    return AuditSubject(noun, None, parse_subject(rest) if "/" in address else None)


class AuditAction(StrEnum):
    """The actions that something reads; the log stores and shows these words, and many others that people alone read."""

    ALARM_RAISED = "alarm raised"
    ALARM_RAISED_AGAIN = "alarm raised again"
    ALARM_RETURNED = "alarm returned"
    ALARM_ASSIGNED = "alarm assigned"
    APPROVED = "approved"
    ASSIGNED = "assigned"
    DECIDED = "decided"
    ENDED = "ended"
    LET_EXPIRE = "let expire"
    MADE_STALE = "made stale"
    OPENED = "opened"
    PROMOTED = "promoted"
    PROPOSED = "proposed"
    REFUSED = "refused"
    REMARKED = "remarked"
    SUBMITTED = "submitted"
    WITHDRAWN = "withdrawn"
    WITHDREW = "withdrew"


@dataclass(frozen=True)
class AuditOutcome:
    """What a record says of the state afterwards, where its object has one: of a request, a run, a set or an alarm."""

    state: str | None = None
    onboard_state: str | None = None
    event: str | None = None
    kind: str | None = None
    level: str | None = None


def parse_outcome(after: Mapping[str, Any] | None) -> AuditOutcome:
    """Read the members that tell a state from what a record keeps as `after`."""
    told = after or {}
    return AuditOutcome(**{name: told.get(name) for name in AuditOutcome.__dataclass_fields__})
