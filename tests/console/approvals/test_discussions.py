"""Around a request: the second person at another's console, who is asked to decide, what is said, what was opened."""

from collections.abc import Callable, Mapping

import pytest

from boresight.console import transitions
from boresight.console.access import users
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval, Signature
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.errors import (
    BoresightError,
    ConflictError,
    ForbiddenError,
    NotFoundError,
    RefusedInputError,
    StaleError,
    UnauthenticatedError,
)
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from tests.passwords import new_password, proved

PASSWORD = "correct horse battery"
People = Mapping[str, Actor]


@pytest.fixture
def request_id(engine: Engine, submitted: Callable[[], ParameterSet]) -> int:
    row = submitted()
    with open_reading(engine) as session:
        return approvals.list_approvals(session, parameter_set_id=row.id)[0].id


def _beside(engine: Engine, console: Actor, request_id: int, name: str, password: str = PASSWORD) -> Signature:
    with open_writing(engine) as session:
        words = ("APPROVE", "I approve", "", proved(session, name, password), 1)
        return approvals.sign_over_the_shoulder(session, console, request_id, *words)


def test_a_second_person_signs_at_the_console_of_another(engine: Engine, people: People, request_id: int) -> None:
    signature = _beside(engine, people["ana"], request_id, "cy")
    assert (signature.user_id, signature.printed_name, signature.console) == (people["cy"].user_id, "Cy", "Ana")
    with open_reading(engine) as session:
        assert transitions.get_approval(session, request_id).state == "APPROVED"
        record = audit.last_change(session, f"approvals/{request_id}")
        assert record is not None
        assert (record.actor, (record.after or {})["console"]) == ("Cy", "Ana")
        assert (record.after or {})["password_by"] == signature.password_by
    assert str(signature.password_by).startswith("given by Command line at ")


@pytest.mark.parametrize(
    ("console", "name", "password", "error", "says"),
    [
        ("ana", "ana", PASSWORD, ForbiddenError, "your own console"),
        ("cy", "cy", PASSWORD, ForbiddenError, "sign without a name"),
        ("cy", "ana", PASSWORD, ForbiddenError, "role approver; Ana has analyst"),
        ("ana", "root", PASSWORD, ForbiddenError, "An administrator cannot sign"),
        ("ana", "cy", "wrong horse battery", UnauthenticatedError, "do not fit"),
        ("ana", "nobody", PASSWORD, UnauthenticatedError, "do not fit"),
    ],
)
def test_over_the_shoulder_signs_nobody_who_may_not(
    engine: Engine,
    people: People,
    request_id: int,
    console: str,
    name: str,
    password: str,
    error: type[BoresightError],
    says: str,
) -> None:
    with pytest.raises(error, match=says):
        _beside(engine, people[console], request_id, name, password)
    with open_reading(engine) as session:
        assert transitions.get_approval(session, request_id).state == "OPEN"
        assert not approval_queries.signatures(session, request_id)


def test_no_key_and_no_command_line_lends_a_console(engine: Engine, request_id: int) -> None:
    with pytest.raises(ForbiddenError, match="Only a person"):
        _beside(engine, COMMAND_LINE, request_id, "cy")


def test_whose_password_another_set_does_not_sign(engine: Engine, people: People, request_id: int) -> None:
    with open_writing(engine) as session:
        users.change_password(session, people["root"], people["cy"].user_id or 0, new_password("another good one"))
    with pytest.raises(ForbiddenError, match="set your own first"):
        _beside(engine, people["ana"], request_id, "cy", "another good one")


def _assign(engine: Engine, actor: Actor, request_id: int, user_id: int | None, version: int) -> Approval:
    with open_writing(engine) as session:
        return approvals.assign(session, actor, request_id, user_id, version)


def test_a_request_is_assigned_to_who_may_sign_it(engine: Engine, people: People, request_id: int) -> None:
    row = _assign(engine, people["ana"], request_id, people["cy"].user_id, 1)
    assert (row.assigned_to, row.version, row.state) == (people["cy"].user_id, 2, "OPEN")
    with pytest.raises(StaleError, match=r"you saw v1, it is v2\): Ana assigned it at"):
        _assign(engine, people["ana"], request_id, None, 1)
    assert _assign(engine, people["dee"], request_id, None, 2).assigned_to is None


@pytest.mark.parametrize(
    ("actor", "named", "error", "says"),
    [
        ("ana", "ana", ConflictError, "Ana cannot sign this request"),
        ("ana", "root", ConflictError, "Root cannot sign"),
        ("eve", "cy", ForbiddenError, "role analyst"),
        ("ana", None, NotFoundError, "no user 99"),
    ],
)
def test_an_assignment_that_makes_no_sense_is_refused(
    engine: Engine,
    people: People,
    request_id: int,
    actor: str,
    named: str | None,
    error: type[BoresightError],
    says: str,
) -> None:
    with pytest.raises(error, match=says):
        _assign(engine, people[actor], request_id, people[named].user_id if named else 99, 1)


def test_a_disabled_person_is_asked_nothing(engine: Engine, people: People, request_id: int) -> None:
    with open_writing(engine) as session:
        users.disable_user(session, people["root"], people["cy"].user_id or 0)
    with pytest.raises(ConflictError, match="Cy is disabled"):
        _assign(engine, people["ana"], request_id, people["cy"].user_id, 1)


def test_a_decided_request_is_assigned_to_nobody(engine: Engine, people: People, request_id: int) -> None:
    _beside(engine, people["ana"], request_id, "cy")
    with pytest.raises(ConflictError, match="is APPROVED: Cy approved it"):
        _assign(engine, people["ana"], request_id, people["bo"].user_id, 2)


def test_remarks_are_kept_in_order_and_on_record_and_hide_no_change(
    engine: Engine, people: People, request_id: int
) -> None:
    with open_writing(engine) as session:
        approvals.remark(session, people["cy"], request_id, " Was the heater on? ")
        approvals.remark(session, people["ana"], request_id, "No.")
    with open_reading(engine) as session:
        said = [(row.printed_name, row.text) for row in approvals.list_remarks(session, request_id)]
        last = audit.last_change(session, f"approvals/{request_id}")
        assert last is not None
        assert last.action == "opened"  # who changed the request is still who submitted it
        assert audit.verify(session).ok
    assert said == [("Cy", "Was the heater on?"), ("Ana", "No.")]


@pytest.mark.parametrize(
    ("actor", "text", "error", "says"),
    [
        ("cy", "  ", RefusedInputError, "1 to 4000 characters"),
        ("cy", "x" * 4001, RefusedInputError, "this one has 4001"),
        ("cy", "a\x00b", RefusedInputError, "control character"),
        ("eve", "Hm.", ForbiddenError, "role analyst"),
    ],
)
def test_a_remark_that_says_nothing_or_too_much_is_refused(
    engine: Engine, people: People, request_id: int, actor: str, text: str, error: type[BoresightError], says: str
) -> None:
    with open_writing(engine) as session, pytest.raises(error, match=says):
        approvals.remark(session, people[actor], request_id, text)


def test_what_a_person_opened_is_kept_once(engine: Engine, people: People, request_id: int) -> None:
    with open_writing(engine) as session:
        first = approvals.record_opening(session, people["cy"], request_id, "gate-report")
        again = approvals.record_opening(session, people["cy"], request_id, "gate-report")
        approvals.record_opening(session, people["bo"], request_id, "gate-report")
    with open_reading(engine) as session:
        opened = [row.user_id for row in approvals.list_openings(session, request_id)]
    assert (first.id, opened) == (again.id, [people["cy"].user_id, people["bo"].user_id])
    with open_writing(engine) as session, pytest.raises(RefusedInputError, match="Name the evidence"):
        approvals.record_opening(session, people["cy"], request_id, "<script>")
