"""The rows that a credential follows from, so that one who was identified is known again for the price of one look at them.

Identifying somebody makes objects of rows and rules on them: some milliseconds. While the rows say what they said, so does that.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import sqlalchemy as sa

from boresight.store.marks import Marks
from boresight.store.sessions import Session

_OWNER = "u.id, u.name, u.printed_name, u.roles, u.disabled_utc, u.must_change_password"
_QUESTIONS = {
    "session": f"SELECT s.token_hash, s.ended_because, {_OWNER} FROM login_sessions s "  # noqa: S608 - our own words
    "JOIN users u ON u.id = s.user_id WHERE s.id = :number",
    "key": f"SELECT k.key_hash, k.scopes, k.expires_utc, k.revoked_utc, {_OWNER} FROM api_keys k "  # noqa: S608 - likewise
    "JOIN users u ON u.id = k.user_id WHERE k.prefix = :number",
}


@dataclass(frozen=True)
class CredentialRows:
    """What the rows of a credential said.

    Parameters
    ----------
    kind
        `session` or `key`.
    number
        The number of the session, or the prefix of the key.
    said
        Every column that decides who acts and what they may do.
    """

    kind: str
    number: int | str
    said: tuple[Hashable, ...] | None

    @classmethod
    def read(cls, session: Session, kind: str, number: int | str) -> CredentialRows:
        """Read the rows in the transaction that identifies somebody: before it they might say what it has not seen."""
        row = session.connection().execute(sa.text(_QUESTIONS[kind]), {"number": number}).one_or_none()
        return cls(kind, number, None if row is None else tuple(row))

    def say_so_still(self, marks: Marks) -> bool:
        """Whether the rows say the same now; False where that cannot be had at once."""
        return self.said is not None and self.said == marks.row(_QUESTIONS[self.kind], {"number": self.number})
