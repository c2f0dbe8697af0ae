"""What an audit record says is read once: an address is written as it was stored, and the actions read are those written."""

import pytest

from boresight.console.alarms.tables import ALARM_ACTIONS
from boresight.platform.audit.subjects import AuditAction, AuditOutcome, AuditSubject, parse_outcome, parse_subject


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("backups", AuditSubject("backups")),
        ("approvals/3", AuditSubject("approvals", 3)),
        ("approvals/3/remarks/5", AuditSubject("approvals", 3, AuditSubject("remarks", 5))),
        ("parameter-sets/7/gate-report", AuditSubject("parameter-sets", 7, AuditSubject("gate-report"))),
        ("files/abc", AuditSubject("files", None, AuditSubject("abc"))),
        ("runs/007", AuditSubject("runs", None, AuditSubject("007"))),
        (f"runs/{'9' * 5000}", AuditSubject("runs", None, AuditSubject("9" * 5000))),
        ("runs/٣", AuditSubject("runs", None, AuditSubject("٣"))),
        ("runs/", AuditSubject("runs", None, AuditSubject(""))),
        ("", AuditSubject("")),
    ],
)
def test_an_address_is_taken_apart_and_written_as_it_was(address, expected):
    assert parse_subject(address) == expected
    assert str(expected) == address


def test_the_actions_on_alarms_are_those_that_are_written():
    read = {action for action in AuditAction if action.name.startswith("ALARM_")}
    assert len(read) == 4
    assert read <= set(ALARM_ACTIONS.values())


def test_of_what_a_record_keeps_the_members_of_a_state_are_read():
    assert parse_outcome(None) == AuditOutcome()
    assert parse_outcome({"state": "OPEN", "version": 3, "level": "serious"}) == AuditOutcome("OPEN", level="serious")
