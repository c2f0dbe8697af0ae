"""Messages to people: who chose which kinds, at which address, and what became of each message.

A message is a row before it is sent, made of a new audit record by a background thread, as those to webhooks are, and tried again
after the same waits. What is due for one address at once goes as one message, so that a campaign of a thousand runs is one mail
and not a thousand. In a person's quiet hours nothing is sent; it follows when they end. An address may hold a token: it is
encrypted with the key of the webhooks' secrets, and never shown again.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from urllib.parse import quote
from zoneinfo import ZoneInfo

from boresight.console import list_queries as lists
from boresight.console.messages import queries as rows
from boresight.console.messages.kinds import KINDS, KindNews, list_news
from boresight.console.messages.tables import Message, MessageAddress
from boresight.console.webhooks.queries import list_records_after
from boresight.console.webhooks.service import FIRST_WAIT_S, LEASE_S, MOST_ATTEMPTS, RECORDS_A_TURN, WAIT_GROWS
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.platform.actors import SYSTEM, Actor, Policy, require_person
from boresight.platform.audit import log as audit
from boresight.platform.audit import queries as audit_rows
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Session, utc_after, utc_now, utc_text
from boresight.platform.db.times import list_zones
from boresight.platform.jobs.message_transport import CheckedAddress
from boresight.platform.web.text_validation import normal_name, refuse_control_characters

log = logging.getLogger(__name__)

MAIL = "mailto"
TEST = "test"
MOST_ADDRESSES = 10  # of a person
LONGEST_LABEL, LONGEST_ADDRESS, LONGEST_MAIL = 80, 2000, 254
MOST_IN_ONE = 50
KEPT_S = 30 * 86400.0
FORGET_EVERY_S = 3600.0
MAIL_ADDRESS = re.compile(r"[^\s@<>,;:\"()\[\]\\?&#/%]{1,64}@[A-Za-z0-9-]+(?:\.[A-Za-z0-9-]+)+")
SERVICE = re.compile(r"([a-z][a-z0-9]{0,20})://.+", re.IGNORECASE | re.DOTALL)
CLOCK = re.compile(r"([01]\d|2[0-3]):[0-5]\d")


@dataclass(frozen=True)
class Outlets:
    """What an installation allows: services by their scheme, the mail server, and where pages are."""

    services: Collection[str] = ()
    mail_server: str = field(default="", repr=False)  # an address of apprise, with its password
    page_root: str = ""
    mode: str = "OPS"


@dataclass(frozen=True)
class AddressChoice:
    """Which kinds a person wants at an address, and when nothing is sent there."""

    kinds: Collection[str] = ()
    quiet_from: str = ""
    quiet_until: str = ""
    quiet_zone: str = ""

    def check(self) -> None:
        """Refuse kinds, times and zones that there are not."""
        for kind in self.kinds:
            if kind not in KINDS:
                raise RefusedInputError(
                    f"There are no messages of the kind {kind[:40]!r}; choose from {', '.join(KINDS)}."
                )
        if bool(self.quiet_from) != bool(self.quiet_until):
            raise RefusedInputError("Quiet hours need a start and an end; enter both or neither.")
        for text in filter(None, (self.quiet_from, self.quiet_until)):
            if CLOCK.fullmatch(text) is None:
                raise RefusedInputError(f"{text[:20]!r} is not a time of the day; write it like 22:00.")
        if self.quiet_from and self.quiet_from == self.quiet_until:
            raise RefusedInputError("Start and end of quiet hours are the same; enter a different end.")
        if self.quiet_zone and self.quiet_zone not in list_zones():
            raise RefusedInputError(
                f"{self.quiet_zone[:60]!r} is not a known time zone; type one such as Europe/Amsterdam."
            )


@dataclass(frozen=True)
class DueMessages:
    """The messages that go to an address as one; `address` is what it is sent to, None where its key is not here."""

    address_id: int
    message_ids: tuple[int, ...]
    subject: str
    text: str
    is_mail: bool
    address: str = field(repr=False)


def read_address(actor: Actor, typed: str, outlets: Outlets) -> tuple[str, bool]:
    """Return an address in its normal form and whether it is a mail address; refuse what is not allowed here."""
    require_person(actor, "have messages sent")
    refuse_control_characters(address=typed)
    address = typed.strip()
    if len(address) > LONGEST_ADDRESS:
        raise RefusedInputError(f"The address has {len(address)} characters; shorten it to {LONGEST_ADDRESS}.")
    service = SERVICE.fullmatch(address)
    if service is None or service[1].lower() in {MAIL, "mailtos"}:
        return _read_mail_address(address.removeprefix("mailto:"), outlets), True
    if service[1].lower() not in outlets.services:
        named = ", ".join(sorted(outlets.services)) or "none"
        raise RefusedInputError(
            f"Messages by {service[1].lower()} are not allowed here; choose one of {named}, or have it added to "
            "BORESIGHT_MESSAGE_SERVICES."
        )
    return address, False


def _read_mail_address(address: str, outlets: Outlets) -> str:
    if MAIL_ADDRESS.fullmatch(address) is None or len(address) > LONGEST_MAIL:
        raise RefusedInputError(
            "This is neither a mail address nor an address of a service; type ada@mission.example alone, or one like "
            "slack://… as apprise's list has it."
        )
    if MAIL not in outlets.services or not outlets.mail_server:
        raise RefusedInputError(
            "This server sends no mail; choose another service, or have BORESIGHT_MAIL_SERVER set and mailto allowed."
        )
    return address


def mask_mail(address: str) -> CheckedAddress:
    """Return how a mail address is shown."""
    name, _, domain = address.partition("@")
    return CheckedAddress(MAIL, f"{name[0]}…@{domain}")


def add_address(
    session: Session,
    actor: Actor,
    box: SecretBox,
    label: str,
    address: str,
    checked: CheckedAddress,
    choice: AddressChoice,
) -> MessageAddress:
    """Add an address of the acting person, checked before; it is told of what happens from now on."""
    user_id = require_person(actor, "have messages sent")
    choice.check()
    label = normal_name("label", label, LONGEST_LABEL)
    if len(rows.list_addresses(session, user_id)) >= MOST_ADDRESSES:
        raise ConflictError(f"You have {MOST_ADDRESSES} addresses; remove one first.")
    row = MessageAddress(
        user_id=user_id,
        label=label or checked.shown,
        service=checked.service,
        shown=checked.shown,
        address=box.seal(address),
        told_audit_id=audit_rows.read_newest_id(session),
        created_utc=utc_now(),
        kinds=[],
        quiet_zone="",
    )
    _apply(row, choice)
    session.put(row)
    audit.append(session, actor, "added", _subject(row), None, _describe(row))
    return row


def change_address(session: Session, actor: Actor, address_id: int, choice: AddressChoice) -> MessageAddress:
    """Choose other kinds and quiet hours for one's address."""
    row = get_address(session, actor, address_id)
    choice.check()
    before = _describe(row)
    _apply(row, choice)
    if _describe(row) != before:
        audit.append(session, actor, "changed", _subject(row), before, _describe(row))
    return row


def _apply(row: MessageAddress, choice: AddressChoice) -> None:
    row.kinds = [kind for kind in KINDS if kind in choice.kinds]
    row.quiet_from, row.quiet_until = choice.quiet_from or None, choice.quiet_until or None
    row.quiet_zone = choice.quiet_zone if choice.quiet_from else ""


def remove_address(session: Session, actor: Actor, address_id: int) -> MessageAddress:
    """Remove one's address: it is forgotten, and what waits for it is not sent."""
    row = get_address(session, actor, address_id)
    row.removed_utc, row.address = utc_now(), ""
    rows.drop_waiting(session, row.id, "The address was removed.")
    audit.append(session, actor, "removed", _subject(row), _describe(row))
    return row


def get_address(session: Session, actor: Actor, address_id: int) -> MessageAddress:
    """Return an address of the acting person; those of others are unknown to them."""
    user_id = require_person(actor, "see addresses for messages")
    row = session.get_known(MessageAddress, address_id)
    if row.user_id != user_id or row.removed_utc is not None:
        raise NotFoundError(f"There is no address for messages {address_id} of yours; choose one from the list.")
    return row


def list_addresses(session: Session, actor: Actor) -> Sequence[MessageAddress]:
    """Return the acting person's addresses."""
    return rows.list_addresses(session, require_person(actor, "see addresses for messages"))


def list_messages(
    session: Session, actor: Actor, address_id: int, *, before_id: int | None = None, limit: int | None = None
) -> Sequence[Message]:
    """Return a page of what was sent or is to be sent to one's address, newest first."""
    get_address(session, actor, address_id)
    return lists.list_newest(session, Message, before_id=before_id, limit=limit, address=address_id)


def try_address(session: Session, actor: Actor, address_id: int) -> Message:
    """Queue a message that says nothing but that it came; quiet hours do not hold it up."""
    row = get_address(session, actor, address_id)
    news = "this is a test message"
    return _queue(session, row, None, TEST, "Boresight", news, "/preferences/messages", utc_now())


def get_state(row: MessageAddress, box: SecretBox) -> str:
    """Return ENABLED, or PAUSED where the address cannot be decrypted here."""
    return "ENABLED" if box.open(row.address) is not None else "PAUSED"


def queue_new(session: Session, policy: Policy) -> int:
    """Make messages of the audit records that are new to people's addresses; return how many."""
    addresses, made = rows.list_subscribed(session), 0
    if not addresses:
        return 0
    for record in list_records_after(session, min(row.told_audit_id for row in addresses), RECORDS_A_TURN):
        untold = [row for row in addresses if row.told_audit_id < record.id]
        wanted = {kind for row in untold for kind in row.kinds}
        for one in _tell(session, record, policy) if wanted else ():
            made += _queue_for(session, [row for row in untold if one.kind in row.kinds], record, one)
        for row in untold:
            row.told_audit_id = record.id
    return made


def _tell(session: Session, record: AuditRecord, policy: Policy) -> list[KindNews]:
    """Return what a record tells; one that cannot be read must not hold up the others."""
    try:
        return list_news(session, record, policy)
    except Exception:
        log.exception("No message could be made of audit record %d", record.id)
        return []


def _queue_for(session: Session, addresses: Sequence[MessageAddress], record: AuditRecord, one: KindNews) -> int:
    made = 0
    for row in addresses:
        if one.news.user_ids is None or row.user_id in one.news.user_ids:
            subject = one.sensor or "Boresight"
            text = f"{one.news.said} (by {record.actor}, {record.at_utc[:19]}Z)"
            _queue(session, row, record.id, one.kind, subject, text, one.news.path, after_quiet(row, utc_now()))
            made += 1
    return made


def _queue(
    session: Session,
    row: MessageAddress,
    audit_id: int | None,
    kind: str,
    subject: str,
    text: str,
    path: str,
    due_utc: str,
) -> Message:
    message = Message(
        address_id=row.id,
        audit_id=audit_id,
        kind=kind,
        subject=subject,
        text=text,
        path=path,
        state="PENDING",
        due_utc=due_utc,
        created_utc=utc_now(),
    )
    return session.put(message)


def after_quiet(row: MessageAddress, at_utc: str) -> str:
    """Return a time, or the end of the quiet hours that it lies in."""
    if not row.quiet_from or not row.quiet_until:
        return at_utc
    local = datetime.fromisoformat(at_utc).astimezone(ZoneInfo(row.quiet_zone) if row.quiet_zone else UTC)
    clock, over_midnight = f"{local:%H:%M}", row.quiet_from > row.quiet_until
    inside = (
        clock >= row.quiet_from or clock < row.quiet_until
        if over_midnight
        else row.quiet_from <= clock < row.quiet_until
    )
    if not inside:
        return at_utc
    hour, minute = map(int, row.quiet_until.split(":"))
    end = local.replace(hour=hour, minute=minute, second=0, microsecond=0)
    return utc_text(end if end > local else end + timedelta(days=1))


def is_any_due(session: Session, box: SecretBox) -> bool:
    """Whether there is a message to make, or one to send from here."""
    return rows.is_any_untold(session) or bool(rows.list_due(session, utc_now(), 1, among=_list_readable(session, box)))


def _list_readable(session: Session, box: SecretBox) -> list[int]:
    return [row.id for row in rows.list_subscribed(session) if box.open(row.address) is not None]


def take_due(session: Session, limit: int, box: SecretBox, outlets: Outlets) -> list[DueMessages]:
    """Claim due messages, those of an address together; they are not due again before their lease is over."""
    by_address: dict[int, list[Message]] = {}
    for row in rows.list_due(session, utc_now(), limit, among=_list_readable(session, box)):
        if len(by_address.setdefault(row.address_id, [])) < MOST_IN_ONE:
            by_address[row.address_id].append(row)
            row.due_utc = utc_after(LEASE_S)
    return [_join(session, address_id, found, box, outlets) for address_id, found in by_address.items()]


def _join(session: Session, address_id: int, found: Sequence[Message], box: SecretBox, outlets: Outlets) -> DueMessages:
    """Put what is due for an address into one message."""
    row = session.get_one(MessageAddress, address_id)
    address, is_mail = str(box.open(row.address)), row.service == MAIL
    if is_mail:
        joint = "&" if "?" in outlets.mail_server else "?"
        address = f"{outlets.mail_server}{joint}to={quote(address, safe='')}" if outlets.mail_server else ""
    first = found[0]
    tag = "" if outlets.mode == "OPS" else f"[{outlets.mode}] "
    more = f", and {len(found) - 1} more" if len(found) > 1 else ""
    lines = [f"{one.subject}: {one.text}\n{outlets.page_root}{one.path}" for one in found]
    title = f"{tag}{first.subject}: {first.text}{more}"
    return DueMessages(address_id, tuple(one.id for one in found), title, "\n\n".join(lines), is_mail, address)


def settle(session: Session, sent: DueMessages, *, ok: bool, outcome: str) -> None:
    """Record the outcome of an attempt: delivered, due again later, or given up; the whole address waits after a failure."""
    for message_id in sent.message_ids:
        message = session.get_one(Message, message_id)
        if message.state != "PENDING":
            continue  # its address was removed meanwhile
        message.attempts += 1
        message.attempted_utc, message.outcome = utc_now(), outcome
        if ok:
            message.state = "DELIVERED"
        elif message.attempts >= MOST_ATTEMPTS:
            message.state = "FAILED"
        else:
            wait_s = FIRST_WAIT_S * WAIT_GROWS ** (message.attempts - 1)
            message.due_utc = after_quiet(session.get_one(MessageAddress, sent.address_id), utc_after(wait_s))
    if not ok:
        rows.put_off(session, sent.address_id, utc_after(FIRST_WAIT_S))


def forget_old(session: Session) -> int:
    """Remove the messages that ended a month ago."""
    return rows.forget_before(session, utc_after(-KEPT_S))


def encrypt_anew(session: Session, box: SecretBox) -> int:
    """Encrypt every readable address with the newest key; return how many."""
    count = 0
    for row in rows.list_addresses(session):
        if (renewed := box.renew(row.address)) is not None:
            row.address, count = renewed, count + 1
            audit.append(session, SYSTEM, "encrypted", _subject(row))
    return count


def _describe(row: MessageAddress) -> dict[str, object]:
    """Describe an address for the audit log: its service, and nothing of itself."""
    quiet = f"{row.quiet_from} to {row.quiet_until} {row.quiet_zone or 'UTC'}" if row.quiet_from else None
    return {"user": row.user_id, "service": row.service, "kinds": row.kinds, "quiet": quiet}


def _subject(row: MessageAddress) -> str:
    return f"message-addresses/{row.id}"
