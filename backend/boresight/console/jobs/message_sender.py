"""The message sender: a thread looks for due messages to people and has a process of its own send them."""

from __future__ import annotations

import time
from collections.abc import Callable

from boresight.console.messages import service as messages
from boresight.console.messages.service import DueMessages, Outlets
from boresight.errors import RefusedInputError
from boresight.platform.actors import Actor, Policy
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from boresight.platform.jobs import message_transport as transport
from boresight.platform.jobs.message_transport import CheckedAddress, OutboundMessage
from boresight.platform.jobs.periodic_thread import PeriodicThread, PeriodicWorker
from boresight.platform.web.targets import WebhookTargets

LOOK_EVERY_S = 2.0
LOOK_AFTER_S = 0.5
AT_ONCE = 200
NO_MAIL = "Not sent: this server has no mail server any more; have BORESIGHT_MAIL_SERVER set."


class MessageSender(PeriodicWorker):
    """Sends the messages of one server's people."""

    patience_s = transport.TIMEOUT_S + 1.0

    def __init__(
        self, database: Engine, targets: WebhookTargets, box: SecretBox, outlets: Outlets, policy: Callable[[], Policy]
    ) -> None:
        self._database = database
        self._targets = targets
        self._box = box
        self.outlets = outlets
        self._policy = policy
        self._forgot_s = float("-inf")
        self._thread = PeriodicThread("messages", [self.deliver, self.forget], lambda: LOOK_EVERY_S, LOOK_AFTER_S)

    def judge_address(self, actor: Actor, typed: str) -> tuple[str, CheckedAddress]:
        """Return an address in its normal form with what is shown of it, or refuse it; call it outside writing transactions."""
        address, is_mail = messages.read_address(actor, typed, self.outlets)
        if is_mail:
            return address, messages.mask_mail(address)
        checked = transport.check(address, self._targets)
        if checked.service not in self.outlets.services:
            raise RefusedInputError(f"Messages by {checked.service} are not allowed here; choose another service.")
        return address, checked

    def deliver(self) -> None:
        """Send all messages that are due."""
        with open_reading(self._database) as session:
            if not messages.is_any_due(session, self._box):
                return
        with open_writing(self._database) as session:
            messages.queue_new(session, self._policy())
            due = messages.take_due(session, AT_ONCE, self._box, self.outlets)
        if due:
            self._send(due)

    def forget(self) -> None:
        """Remove old messages, once an hour."""
        if time.monotonic() - self._forgot_s < messages.FORGET_EVERY_S:
            return
        self._forgot_s = time.monotonic()
        with open_writing(self._database) as session:
            messages.forget_old(session)

    def _send(self, due: list[DueMessages]) -> None:
        told = {place: (False, NO_MAIL) for place, one in enumerate(due) if not one.address}
        wanted = [
            OutboundMessage(place, one.subject, one.text, one.is_mail, one.address)
            for place, one in enumerate(due)
            if one.address
        ]
        if wanted:
            told |= {one.id: (one.ok, one.outcome) for one in transport.send(wanted, self._targets)}
        with open_writing(self._database) as session:
            for place, one in enumerate(due):
                ok, outcome = told[place]
                messages.settle(session, one, ok=ok, outcome=outcome)
