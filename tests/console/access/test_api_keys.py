"""API keys: shown once, kept hashed, never more than their owner, never beyond their scopes."""

from collections.abc import Callable, Mapping

import pytest

from boresight.console.access import api_keys, users
from boresight.console.access.tables import ApiKey
from boresight.console.approvals import service as approvals
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.errors import ForbiddenError, NotFoundError, RefusedInputError, UnauthenticatedError
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_after


@pytest.fixture
def key(session: Session, people: Mapping[str, Actor]) -> tuple[ApiKey, str]:
    return api_keys.create_key(session, people["ana"], label="downlink", scopes=["runs"])


def test_a_secret_lets_its_program_act_as_the_owner_within_its_scopes(
    session: Session, people: Mapping[str, Actor], key: tuple[ApiKey, str]
) -> None:
    row, secret = key
    actor = api_keys.actor_of_key(session, secret)
    assert (actor.user_id, actor.roles) == (people["ana"].user_id, people["ana"].roles)
    assert (actor.credential, actor.scopes) == (f"key:{row.prefix}", {"runs"})


def test_the_secret_itself_is_not_kept(key: tuple[ApiKey, str]) -> None:
    row, secret = key
    assert secret.startswith(f"bs_{row.prefix}_")
    kept = [str(getattr(row, column.key)) for column in ApiKey.__table__.columns]
    assert all(secret.split("_", 2)[2] not in value for value in kept)


def test_a_secret_with_one_letter_changed_is_unknown(session: Session, key: tuple[ApiKey, str]) -> None:
    secret = key[1]
    for wrong in (secret[:-1] + ("A" if secret[-1] != "A" else "B"), secret[:-1], "", "bs_", "bs_a_b", "é_é_é"):
        with pytest.raises(UnauthenticatedError, match="copied whole"):
            api_keys.actor_of_key(session, wrong)


def test_a_key_loses_what_its_owner_loses(
    session: Session, people: Mapping[str, Actor], key: tuple[ApiKey, str]
) -> None:
    ana = people["ana"].user_id
    assert ana is not None
    users.change_roles(session, people["root"], ana, ["viewer"])
    assert api_keys.actor_of_key(session, key[1]).roles == {"viewer"}
    users.disable_user(session, people["root"], ana)
    with pytest.raises(UnauthenticatedError, match=r"owner .* is disabled"):
        api_keys.actor_of_key(session, key[1])


def test_an_expired_and_a_revoked_key_are_told_apart(
    session: Session, people: Mapping[str, Actor], key: tuple[ApiKey, str]
) -> None:
    row, secret = key
    row.expires_utc = utc_after(-1.0)
    with pytest.raises(UnauthenticatedError, match="expired at"):
        api_keys.actor_of_key(session, secret)
    api_keys.revoke_key(session, people["ana"], row.id)
    with pytest.raises(UnauthenticatedError, match="was revoked"):
        api_keys.actor_of_key(session, secret)


def test_only_owner_and_administrator_revoke(
    session: Session, people: Mapping[str, Actor], key: tuple[ApiKey, str]
) -> None:
    with pytest.raises(ForbiddenError, match="owner or an administrator"):
        api_keys.revoke_key(session, people["bo"], key[0].id)
    assert api_keys.revoke_key(session, people["root"], key[0].id).revoked_utc is not None
    with pytest.raises(NotFoundError):
        api_keys.revoke_key(session, people["root"], 99)


def test_a_key_makes_no_key(session: Session, key: tuple[ApiKey, str]) -> None:
    with pytest.raises(ForbiddenError, match="Only a person"):
        api_keys.create_key(session, api_keys.actor_of_key(session, key[1]), label="child")
    with pytest.raises(ForbiddenError, match="API key may not revoke"):
        api_keys.revoke_key(session, api_keys.actor_of_key(session, key[1]), key[0].id)
    with pytest.raises(ForbiddenError, match="Only a person"):
        api_keys.create_key(session, COMMAND_LINE, label="child")


@pytest.mark.parametrize(
    ("choices", "says"),
    [
        ({"label": "x", "scopes": ["everything"]}, "no scope everything; the scopes are"),
        ({"label": "  "}, "needs a label"),
        ({"label": "x", "expires_days": 0}, "lasts 1 to 3650 days"),
    ],
)
def test_a_key_that_cannot_be_is_refused(
    session: Session, people: Mapping[str, Actor], choices: dict[str, object], says: str
) -> None:
    with pytest.raises(RefusedInputError, match=says):
        api_keys.create_key(session, people["ana"], **choices)  # type: ignore[arg-type]
    assert api_keys.list_keys(session) == []


def test_what_a_key_changed_is_on_record_as_the_key(
    engine: Engine, people: Mapping[str, Actor], candidate: Callable[..., ParameterSet], blobs: BlobStore
) -> None:
    row = candidate()
    with open_writing(engine) as session:
        key, secret = api_keys.create_key(session, people["ana"], label="robot", scopes=["parameter-sets"])
    with open_writing(engine) as session:
        robot = api_keys.actor_of_key(session, secret)
        approvals.submit(session, robot, blobs, row.id, "better", row.version)
    with open_reading(engine) as session:
        record = audit.last_change(session, f"parameter-sets/{row.id}")
        assert record is not None
        assert record.credential == f"key:{key.prefix}"
        assert [listed.id for listed in api_keys.list_keys(session, people["ana"].user_id)] == [key.id]
        assert api_keys.list_keys(session, people["bo"].user_id) == []


def test_the_last_use_of_a_key_is_kept_and_only_ever_moves_on(engine: Engine, people: Mapping[str, Actor]) -> None:
    with open_writing(engine) as session:
        key, _ = api_keys.create_key(session, people["ana"], label="robot")
    for at_utc in ("2026-11-21T10:00:00.000000Z", "2026-11-21T09:00:00.000000Z"):
        with open_writing(engine) as session:
            api_keys.record_uses(session, {key.prefix: at_utc, "unknown": at_utc})
    with open_reading(engine) as session:
        assert api_keys.get_key(session, key.id).last_used_utc == "2026-11-21T10:00:00.000000Z"
        assert audit.verify(session).ok
