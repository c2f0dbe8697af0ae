"""Where a person gets messages; each person's own, never a key's."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Depends
from pydantic import Field

from boresight.console.access.dependencies import Reading, SecretKeeper, Who, Writing
from boresight.console.jobs.dependencies import ServerMessageSender
from boresight.console.messages import service as messages
from boresight.console.messages import tables
from boresight.console.messages.kinds import KINDS
from boresight.console.operation import RowWithFields, operations
from boresight.console.schemas import Row, Shape
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.jobs.message_transport import CheckedAddress
from boresight.platform.web.paging import Id, Listing, Page, Paged


class MessageAddress(Row):
    """Where a person gets messages, without the address itself."""

    location = "/message-addresses/{row.id}"

    id: int
    label: str
    service: str = Field(description="Scheme of apprise; mailto: by this server's mail server.")
    shown: str = Field(description="The shortened address.")
    kinds: list[str]
    quiet_from: str | None = Field(description="Start of quiet hours (HH:MM).")
    quiet_until: str | None
    quiet_zone: str = Field(description="Time zone of both; empty: UTC.")
    created_utc: str
    state: Literal["ENABLED", "PAUSED"] = Field(
        description="PAUSED: it cannot be decrypted with this server's key; remove it and enter it again."
    )


class Message(Row):
    """One message, and what came of its last attempt."""

    id: int
    address_id: int
    audit_id: int | None = Field(description="Audit record that the message is about; null for a test message.")
    kind: str
    subject: str
    text: str
    path: str
    state: Literal["PENDING", "DELIVERED", "FAILED", "DROPPED"]
    attempts: int
    due_utc: str
    attempted_utc: str | None
    outcome: str | None
    created_utc: str


router = operations("/message-addresses", tags=["messages"])


class WantedKinds(Shape):
    """Of what a person is told at an address, and when not."""

    kinds: list[str] = Field([], description=f"Some of {', '.join(KINDS)}.", examples=[["signature-waits", "alarm"]])
    quiet_from: str = Field("", description="HH:MM; empty: no quiet hours.", examples=["22:00"])
    quiet_until: str = Field("", examples=["07:00"])
    quiet_zone: str = Field("", description="Empty: UTC.", examples=["Europe/Amsterdam"])

    def choice(self) -> messages.AddressChoice:
        """Return it as the service takes it."""
        return messages.AddressChoice(tuple(self.kinds), self.quiet_from, self.quiet_until, self.quiet_zone)


class NewAddress(WantedKinds):
    """An address of the acting person."""

    address: str = Field(description="A mail address, or an address of apprise.", examples=["ada@mission.example"])
    label: str = Field("", description="Empty: what is shown of the address.", examples=["On-call channel"])


def _judge(new: NewAddress, actor: Who, sender: ServerMessageSender) -> tuple[str, CheckedAddress]:
    """Check the address before the writing transaction, because that takes a second."""
    return sender.judge_address(actor, new.address)


def make_row(row: tables.MessageAddress, box: SecretBox) -> RowWithFields:
    """Return an address with its state."""
    return RowWithFields(row, state=messages.get_state(row, box))


@router.get("", summary="List your addresses", response_model=Page[MessageAddress])
def list_message_addresses(actor: Who, session: Reading, page: Paged, box: SecretKeeper) -> Listing[RowWithFields]:
    """List where you get messages."""
    return page.cut_whole(messages.list_addresses(session, actor), lambda row: make_row(row, box))


@router.post("", summary="Add an address", status_code=201, response_model=MessageAddress)
def add_message_address(
    new: NewAddress,
    actor: Who,
    box: SecretKeeper,
    session: Writing,
    judged: Annotated[tuple[str, CheckedAddress], Depends(_judge)],
) -> RowWithFields:
    """Get messages at an address from now on. It is stored encrypted and never shown again."""
    address, checked = judged
    return make_row(messages.add_address(session, actor, box, new.label, address, checked, new.choice()), box)


@router.get("/{address_id}", summary="Read an address", response_model=MessageAddress)
def get_message_address(address_id: Id, actor: Who, session: Reading, box: SecretKeeper) -> RowWithFields:
    """Read what you get at an address of yours."""
    return make_row(messages.get_address(session, actor, address_id), box)


@router.post("/{address_id}:change", summary="Choose other kinds", response_model=MessageAddress)
def change_message_address(
    address_id: Id, wanted: WantedKinds, actor: Who, box: SecretKeeper, session: Writing
) -> RowWithFields:
    """Choose other kinds and quiet hours."""
    return make_row(messages.change_address(session, actor, address_id, wanted.choice()), box)


@router.post("/{address_id}:remove", summary="Remove an address", response_model=MessageAddress)
def remove_message_address(address_id: Id, actor: Who, box: SecretKeeper, session: Writing) -> RowWithFields:
    """Forget an address; what waits for it is not sent."""
    return make_row(messages.remove_address(session, actor, address_id), box)


@router.post("/{address_id}:try", summary="Send a test message", status_code=202, response_model=Message)
def try_message_address(address_id: Id, actor: Who, session: Writing) -> tables.Message:
    """Queue a message that says nothing but that it came."""
    return messages.try_address(session, actor, address_id)


@router.get("/{address_id}/messages", summary="List messages", response_model=Page[Message])
def list_address_messages(address_id: Id, actor: Who, session: Reading, page: Paged) -> Listing[tables.Message]:
    """List what was sent to an address of yours and what is to be sent, newest first."""
    return page.cut(messages.list_messages(session, actor, address_id, **page.rows))
