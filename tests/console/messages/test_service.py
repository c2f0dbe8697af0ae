"""Messages to people: who is told of what, by which kinds and when; what is refused, and what the store keeps of an address."""

from datetime import datetime
from functools import partial
from typing import Any

import pytest
import sqlalchemy as sa

from boresight.console import list_queries as lists
from boresight.console.access import users
from boresight.console.alarms import rules
from boresight.console.alarms.rules import check_chain
from boresight.console.alignments.tables import Alignment, AlignmentRequest
from boresight.console.approvals import service as approvals
from boresight.console.approvals import threads
from boresight.console.approvals.tables import Approval
from boresight.console.audit.queries import NUMBERED
from boresight.console.messages import service as messages
from boresight.console.messages.kinds import KINDS
from boresight.console.messages.service import AddressChoice, Outlets
from boresight.console.messages.tables import Message, MessageAddress
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.queries import claim, finish
from boresight.console.transitions import move
from boresight.console.webhooks.service import MOST_ATTEMPTS
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.actors import COMMAND_LINE, POLICY
from boresight.platform.audit import log as audit
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Session, open_writing, utc_now
from boresight.platform.jobs.message_transport import CheckedAddress
from tests.passwords import approve

TOKEN = "slack://T1JJ3T3L2/A1BRTD4JD/TIiajkdnlazkcOXrIdevi7FQ"
OUTLETS = Outlets(
    ("mailto", "slack"), "mailtos://bs:pw@smtp.mission.example?from=bs@mission.example", "https://bs.example"
)


@pytest.fixture
def box(tmp_path) -> SecretBox:
    return SecretBox(tmp_path / "webhooks.key")


def _subscribe(session: Session, people: Any, box: SecretBox, name: str, *kinds: str, **quiet: str) -> MessageAddress:
    mail = f"{name}@mission.example"
    choice = AddressChoice(kinds or tuple(KINDS), **quiet)
    return messages.add_address(session, people[name], box, "", mail, messages.mask_mail(mail), choice)


@pytest.fixture
def subscribe(session, people, box):
    return partial(_subscribe, session, people, box)


def _told(session) -> set[tuple[str, str, str]]:
    """Return who has a message of which kind, and the page it leads to."""
    messages.queue_new(session, POLICY)
    found = session.execute(
        sa.select(Message, MessageAddress).join(MessageAddress, MessageAddress.id == Message.address_id)
    )
    return {(address.shown.split("…")[0], message.kind, message.path) for message, address in found}


def test_a_request_is_told_to_who_may_sign_it_and_its_outcome_to_who_has_a_part_in_it(engine, people, box, submitted):
    with open_writing(engine) as session:
        for name in ("ana", "bo", "cy", "dee", "eve", "root"):
            _subscribe(session, people, box, name, "signature-waits", "request-decided", "mention", "promoted")
    row = submitted()
    with open_writing(engine) as session:
        approval = lists.list_newest(session, Approval, set=row.id)[0]
        page = f"/approvals/{approval.id}"
        assert _told(session) == {("b", "signature-waits", page), ("c", "signature-waits", page)}
        threads.add_remark(session, people["ana"], approval.id, "@dee: is there a pass tonight?")
        assert ("d", "mention", page) in _told(session)
        approve(session, people["cy"], approval, comment="A secret reason.")
        told = _told(session)
        assert {who for who, kind, _ in told if kind == "request-decided"} == {"a"}, "not who decided"
        message = session.scalar(sa.select(Message).where(Message.kind == "request-decided"))
        assert message is not None
        said = f"request {approval.id} for {row.name} is approved"
        assert (message.subject, message.text.partition(" (by")[0]) == ("ST16-1", said)
        assert "secret" not in message.text
        promoted = session.get_known(ParameterSet, row.id)
        approvals.promote(session, people["dee"], row.id, promoted.version)
        assert {who for who, kind, _ in _told(session) if kind == "promoted"} == {*"abcder"}


def test_an_alignment_is_told_to_approvers_without_a_part_in_it_and_its_end_to_the_submitter(
    session, people, subscribe, finished_run
):
    for name in ("ana", "bo", "cy", "eve", "root"):
        subscribe(name, "alignment-waits", "alignment-decided")
    run = finished_run(session, people["bo"].user_id)  # who launched one of its runs does not sign
    both = dict.fromkeys(("sensor_a_id", "sensor_b_id"), 1) | dict.fromkeys(("run_a_id", "run_b_id"), run.id)
    made = Alignment(**both, options={}, created_utc=utc_now(), created_by=people["ana"].user_id, state="QUEUED")
    audit.append(session, people["ana"], "requested", f"alignments/{session.put(made).id}")
    asked = {"result_sha256": "0" * 64, "reason": "x", "submitted_utc": utc_now(), "state": "OPEN"}
    row = session.put(AlignmentRequest(alignment_id=made.id, submitted_by=people["ana"].user_id, **asked))
    audit.append(session, people["ana"], "submitted", f"alignment-requests/{row.id}")
    page = f"/alignment-requests/{row.id}"
    assert _told(session) == {("c", "alignment-waits", page)}
    move(session, people["cy"], row, "APPROVED", "approved")
    assert _told(session) == {("c", "alignment-waits", page), ("a", "alignment-decided", page)}


def test_the_end_of_a_run_is_told_to_who_launched_it_and_an_alarm_to_everybody_who_asked(
    session, people, subscribe, finished_run
):
    for name in ("ana", "eve"):
        subscribe(name, "run-failed", "alarm")
    row = finished_run(session, people["ana"].user_id, "QUEUED")
    (held,) = claim(session, "host", 60.0, 1)
    finish(session, held.run_id, held.attempt, "FAILED", "The lens cap was on.")
    rules.update_installation_alarms(session, {rules.CHAIN: check_chain("broken", "x")})
    page = f"/runs/{row.id}"
    assert _told(session) == {("a", "run-failed", page), ("a", "alarm", "/alarms/1"), ("e", "alarm", "/alarms/1")}
    assert messages.queue_new(session, POLICY) == 0, "nobody is told twice"


def test_a_change_of_ones_account_by_another_is_told_and_who_may_not_log_in_is_told_nothing(session, people, subscribe):
    subscribe("ana", "account")
    subscribe("eve", "account")
    users.change_roles(session, people["root"], people["ana"].user_id or 0, ["analyst", "operator"])
    users.disable_user(session, people["root"], people["eve"].user_id or 0)
    assert _told(session) == {("a", "account", "/sessions")}


def test_every_kind_of_message_is_made_of_records_that_exist():
    assert len(KINDS) == len({kind.title for kind in KINDS.values()}) == 15
    nouns = {kind.records.noun for kind in KINDS.values()}
    assert nouns - {"users"} <= set(NUMBERED) | {"parameter-sets"}
    assert [kind.name for kind in KINDS.values() if kind.records.actions is None] == ["account"]


def test_an_address_is_stored_encrypted_and_the_log_and_its_row_show_nothing_of_it(session, people, box):
    shown = CheckedAddress("slack", "slack://…")
    row = messages.add_address(session, people["ana"], box, "Ops", TOKEN, shown, AddressChoice(("alarm",)))
    assert box.open(row.address) == TOKEN
    record = audit.list_records(session, subject=f"message-addresses/{row.id}", limit=1)[0]
    assert record.after == {"user": people["ana"].user_id, "service": "slack", "kinds": ["alarm"], "quiet": None}
    assert all("TIiajk" not in str(value) for value in (row.address, row.shown, row.label))
    assert messages.encrypt_anew(session, box) == 1
    messages.remove_address(session, people["ana"], row.id)
    assert row.address == ""


@pytest.mark.parametrize(
    "typed",
    ["json://mission.example/x", "file:///etc/passwd", "syslog://", "mailto://u:p@10.0.0.1?to=a@b.example", "ada@mission",
     "a@b.example,c@d.example", "ada@mission.example?cc=x@y.example", "a b@mission.example", "slack://" + "x" * 2000, "",
     "slack://a\x00b"],
)  # fmt: skip
def test_what_is_no_mail_address_and_no_allowed_service_is_refused(people, typed):
    with pytest.raises(RefusedInputError):
        messages.read_address(people["ana"], typed, OUTLETS)


def test_a_mail_address_is_taken_where_there_is_a_mail_server_alone(people):
    assert messages.read_address(people["ana"], " mailto:ada@mission.example ", OUTLETS) == (
        "ada@mission.example",
        True,
    )
    assert messages.read_address(people["ana"], TOKEN, OUTLETS) == (TOKEN, False)
    with pytest.raises(RefusedInputError, match="BORESIGHT_MAIL_SERVER"):
        messages.read_address(people["ana"], "ada@mission.example", Outlets(("mailto",)))


def test_an_address_is_its_persons_alone(session, people, subscribe):
    row = subscribe("ana")
    for act in (messages.get_address, messages.remove_address, messages.try_address, messages.list_messages):
        with pytest.raises(NotFoundError):
            act(session, people["root"], row.id)
    with pytest.raises(ForbiddenError):
        messages.list_addresses(session, COMMAND_LINE)
    for _ in range(messages.MOST_ADDRESSES - 1):
        subscribe("ana")
    with pytest.raises(ConflictError):
        subscribe("ana")


@pytest.mark.parametrize(
    ("quiet", "at", "due"),
    [
        (("22:00", "07:00", ""), "2026-11-21T23:30:00.000000Z", "2026-11-22T07:00:00.000000Z"),
        (("22:00", "07:00", ""), "2026-11-21T06:59:59.000000Z", "2026-11-21T07:00:00.000000Z"),
        (("22:00", "07:00", ""), "2026-11-21T07:00:00.000000Z", "2026-11-21T07:00:00.000000Z"),
        (("22:00", "07:00", "Europe/Amsterdam"), "2026-11-21T21:30:00.000000Z", "2026-11-22T06:00:00.000000Z"),
        (("12:00", "13:00", ""), "2026-11-21T12:30:00.000000Z", "2026-11-21T13:00:00.000000Z"),
    ],
)
def test_what_happens_in_quiet_hours_is_due_when_they_end(subscribe, quiet, at, due):
    row = subscribe("ana", "alarm", **dict(zip(("quiet_from", "quiet_until", "quiet_zone"), quiet, strict=True)))
    assert messages.after_quiet(row, at) == due


@pytest.mark.parametrize(
    "choice",
    [AddressChoice(("gossip",)), AddressChoice((), "22:00", ""), AddressChoice((), "25:00", "07:00"),
     AddressChoice((), "22:00", "22:00"), AddressChoice((), "22:00", "07:00", "Mars/Olympus")],
)  # fmt: skip
def test_kinds_times_and_zones_that_there_are_not_are_refused(choice):
    with pytest.raises(RefusedInputError):
        choice.check()


def test_what_is_due_for_an_address_goes_as_one_message_that_names_the_sensor_and_leads_to_the_page(
    session, subscribe, box, people
):
    row = subscribe("ana", "account")
    for roles in (["operator"], ["viewer"], ["analyst"]):
        users.change_roles(session, people["root"], people["ana"].user_id or 0, roles)
    messages.queue_new(session, POLICY)
    (due,) = messages.take_due(session, 10, box, OUTLETS)
    assert len(due.message_ids) == 3
    assert due.subject.endswith(", and 2 more")
    assert due.text.count("https://bs.example/sessions") == 3
    assert due.address == f"{OUTLETS.mail_server}&to=ana%40mission.example"
    assert messages.take_due(session, 10, box, OUTLETS) == [], "they are leased"
    messages.settle(session, due, ok=True, outcome="Delivered.")
    assert [one.state for one in messages.list_messages(session, people["ana"], row.id)] == ["DELIVERED"] * 3


def test_a_training_server_says_so_in_the_first_place(session, subscribe, box, people):
    messages.try_address(session, people["ana"], subscribe("ana").id)
    outlets = Outlets(OUTLETS.services, OUTLETS.mail_server, OUTLETS.page_root, "SIM")
    assert messages.take_due(session, 10, box, outlets)[0].subject.startswith("[SIM] ")


def test_a_failure_is_tried_again_after_growing_waits_and_given_up_after_the_eighth(session, people, subscribe):
    message = messages.try_address(session, people["ana"], subscribe("ana").id)
    waits = []
    for _ in range(MOST_ATTEMPTS):
        due = messages.DueMessages(message.address_id, (message.id,), "", "", True, "")
        messages.settle(session, due, ok=False, outcome="Not sent: x")
        session.refresh(message)
        later = datetime.fromisoformat(message.due_utc) - datetime.fromisoformat(str(message.attempted_utc))
        waits.append(round(later.total_seconds()))
    assert waits[:-1] == [5, 20, 80, 320, 1280, 5120, 20480]
    assert (message.state, message.attempts, message.outcome) == ("FAILED", 8, "Not sent: x")


def test_without_its_key_an_address_waits_and_what_waits_for_a_removed_one_is_dropped(
    session, people, subscribe, tmp_path
):
    row = subscribe("ana")
    message = messages.try_address(session, people["ana"], row.id)
    elsewhere = SecretBox(tmp_path / "other.key")
    assert messages.get_state(row, elsewhere) == "PAUSED"
    assert messages.take_due(session, 10, elsewhere, OUTLETS) == []
    messages.remove_address(session, people["ana"], row.id)
    session.refresh(message)
    assert message.state == "DROPPED"
