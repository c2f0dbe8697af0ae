"""The actor of a request with credential, roles and scopes, the policy of an installation, and the duration of log-ins."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from boresight.errors import ForbiddenError
from boresight.platform.db.times import utc_after, utc_text

SCOPES = ("sensors", "telemetry-sets", "runs", "parameter-sets", "uplinks")


DAY_S = 86400.0


@dataclass(frozen=True)
class Policy:
    """An installation's rules for requests for approval."""

    four_eyes: bool = True
    approval_days: float = 30.0
    rollback_days: float = 3.0
    approvals: int = 1
    second_person: bool = False
    rest_review: bool = False
    promotion_password: bool = True
    promotion_reason: bool = False

    def needed(self, *, waived: bool) -> int:
        """Return the number of approvals that a request needs."""
        return max(self.approvals, 2 if waived else 1) if self.four_eyes else 1


POLICY = Policy()
#: A credential that is an API key is recorded as this and the key's prefix.
KEY = "key:"


@dataclass(frozen=True)
class Actor:
    """A person, a key of a person, or Boresight itself."""

    user_id: int | None
    name: str
    printed_name: str
    roles: frozenset[str]
    credential: str
    scopes: frozenset[str] | None = None
    request_id: str | None = None
    until_utc: str | None = None
    session_id: int | None = None

    def with_request(self, request_id: str) -> Actor:
        """Return a copy with a request id; every request needs one, and `dataclasses.replace` takes three times as long."""
        return Actor(
            self.user_id, self.name, self.printed_name, self.roles, self.credential, self.scopes, request_id,
            self.until_utc, self.session_id,
        )  # fmt: skip

    @property
    def key_prefix(self) -> str:
        """What names the API key that acts; empty where none does."""
        return self.credential.removeprefix(KEY) if self.credential.startswith(KEY) else ""

    @property
    def is_key(self) -> bool:
        """Whether the actor is an API key."""
        return self.credential.startswith(KEY)


SYSTEM = Actor(None, "system", "Boresight", frozenset({"analyst", "operator", "administrator"}), "system")
COMMAND_LINE = Actor(
    None, "command line", "Command line", frozenset({"analyst", "operator", "administrator"}), "command line"
)

#: Takes telemetry in and prepares requests by a policy. It has no row of a person, so it cannot submit, sign or promote.
INGEST = Actor(
    None, "ingest", "Ingest", frozenset({"analyst"}), "service", frozenset({"telemetry-sets", "runs", "parameter-sets"})
)


def require_role(actor: Actor, *roles: str) -> None:
    """Refuse an actor without any of these roles."""
    if not actor.roles.intersection(roles):
        held = f"only {', '.join(sorted(actor.roles))}" if actor.roles else "no role"
        raise ForbiddenError(
            f"This requires the role {' or '.join(roles)}, but {actor.printed_name} has {held}. Ask someone with it.",
            code="role-missing",
        )


def require_scope(actor: Actor, scope: str) -> None:
    """Refuse a key without the scope for this noun."""
    if actor.scopes is not None and scope not in actor.scopes:
        raise ForbiddenError(f"This API key lacks the scope {scope}; make a key that has it.", code="scope-missing")


def require_person(actor: Actor, what: str) -> int:
    """Return the person's row; refuse keys, the command line and the system."""
    if actor.user_id is None or actor.credential != "session":
        raise ForbiddenError(
            f"Only a person who is logged in may {what}, not {actor.credential}; log in to do it.", code="not-a-person"
        )
    return actor.user_id


def refuse_key(actor: Actor, what: str) -> None:
    """Refuse keys: people and keys are managed by people, or on the command line, whatever scopes a key has."""
    if actor.is_key:
        raise ForbiddenError(
            f"An API key may not {what}; have a person who is logged in do it.", code="key-not-allowed"
        )


def require_user(actor: Actor, what: str) -> int:
    """Return the user id of the person, or of the owner of the key."""
    if actor.user_id is None:
        raise ForbiddenError(f"This needs a person or an API key: log in or use an API key to {what}.", code="no-user")
    return actor.user_id


@dataclass(frozen=True)
class SessionLimits:
    """How long log-ins last."""

    age_s: float
    idle_s: float

    def is_idle(self, last_used_utc: str) -> bool:
        """Whether a log-in that was last used at this time has ended."""
        return bool(self.idle_s) and last_used_utc < utc_after(-self.idle_s)

    def ends_utc(self, created_utc: str) -> str:
        """Return the latest end of a log-in that was made at this time."""
        return utc_text(datetime.fromisoformat(created_utc) + timedelta(seconds=self.age_s))
