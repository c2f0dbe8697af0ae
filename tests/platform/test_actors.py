"""Actors: who may do what, and that a refusal says who may."""

import pytest

from boresight.errors import ForbiddenError
from boresight.platform.actors import (
    COMMAND_LINE,
    SYSTEM,
    Actor,
    require_person,
    require_role,
    require_scope,
    require_user,
)
from tests.refusals import has_code

ANA = Actor(7, "ana", "Ana Lima", frozenset({"analyst"}), "session")
KEY = Actor(7, "ana", "Ana Lima", frozenset({"analyst"}), "key:ab12cd34", frozenset({"runs"}))


def test_one_of_the_roles_is_enough() -> None:
    require_role(ANA, "operator", "analyst")


def test_a_missing_role_is_named_with_those_held() -> None:
    with pytest.raises(ForbiddenError, match=r"operator.*approver.*Ana Lima.*analyst", check=has_code("role-missing")):
        require_role(ANA, "operator", "approver")


def test_a_key_stays_within_its_scopes_and_a_person_has_none() -> None:
    require_scope(KEY, "runs")
    require_scope(ANA, "uplinks")
    with pytest.raises(ForbiddenError, match="uplinks", check=has_code("scope-missing")):
        require_scope(KEY, "uplinks")


@pytest.mark.parametrize("actor", [KEY, SYSTEM, COMMAND_LINE])
def test_only_a_person_passes_for_a_person(actor: Actor) -> None:
    assert require_person(ANA, "sign") == 7
    with pytest.raises(ForbiddenError, check=has_code("not-a-person")):
        require_person(actor, "sign")


def test_somebody_answers_for_a_key_and_nobody_for_the_system() -> None:
    assert require_user(KEY, "submit") == 7
    with pytest.raises(ForbiddenError, check=has_code("no-user")):
        require_user(SYSTEM, "submit")


def test_nobody_signs_without_being_a_person() -> None:
    assert "approver" not in SYSTEM.roles | COMMAND_LINE.roles
