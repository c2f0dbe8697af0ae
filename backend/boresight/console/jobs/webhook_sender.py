"""The webhook sender: one thread looks for due messages, one thread per webhook sends them, in their order.

Where a name leads is looked up and judged by `platform.web.targets` before every attempt, and the connection goes to
the address that was judged; for the same reason redirects are not followed.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit, urlunsplit

import httpx

import boresight
from boresight.console.webhooks import service as webhook_messages
from boresight.console.webhooks.service import WebhookMessage
from boresight.errors import RefusedInputError
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from boresight.platform.jobs.periodic_thread import PeriodicThread, PeriodicWorker
from boresight.platform.web.targets import WebhookTargets, parsed

LOOK_EVERY_S = 1.0
LOOK_AFTER_S = 0.25
AT_ONCE = 20
TIMEOUT_S = 10.0
HEARD = 200  # characters of a refusing answer that the log keeps


class WebhookSender(PeriodicWorker):
    """Sends the messages of one server's webhooks."""

    patience_s = TIMEOUT_S + 1.0

    def __init__(self, database: Engine, targets: WebhookTargets, box: SecretBox) -> None:
        self._database = database
        self.targets = targets
        self._box = box
        self._thread = PeriodicThread("delivery", [self.deliver], lambda: LOOK_EVERY_S, LOOK_AFTER_S)

    def deliver(self) -> None:
        """Send all messages that are due."""
        with open_reading(self._database) as session:
            if not webhook_messages.is_any_due(session, self._box):
                return
        with open_writing(self._database) as session:
            webhook_messages.queue_new(session)
            messages = webhook_messages.take_due(session, AT_ONCE, self._box)
        by_webhook: dict[int, list[WebhookMessage]] = {}
        for message in messages:
            by_webhook.setdefault(message.webhook_id, []).append(message)
        if by_webhook:
            with ThreadPoolExecutor(len(by_webhook), "boresight-delivery") as threads:
                list(threads.map(self._serve, by_webhook.values()))

    def _serve(self, messages: Sequence[WebhookMessage]) -> None:
        """Send a webhook's messages until one gets no answer; the others wait for the next look."""
        began_s = time.monotonic()
        for message in messages:
            if self._thread.closing or time.monotonic() - began_s > TIMEOUT_S:
                return
            status, outcome = self._send(message)
            with open_writing(self._database) as session:
                webhook_messages.settle(session, message.delivery_id, status=status, outcome=outcome)
            if status is None:
                return

    def _send(self, message: WebhookMessage) -> tuple[int | None, str]:
        """Make one attempt; return the answer's status, None where there was none, and what came of it."""
        began_s = time.monotonic()
        try:
            status, said = asyncio.run(self._post(message))
        except RefusedInputError as error:
            return None, f"Not sent: {error}"
        except TimeoutError:
            return None, f"No complete answer within {TIMEOUT_S:g} s."
        except (OSError, httpx.HTTPError, httpx.InvalidURL, UnicodeError) as error:
            return None, f"No answer: {str(error) or type(error).__name__}."
        if httpx.codes.is_success(status):
            return status, f"Delivered in {time.monotonic() - began_s:.2f} s."
        return status, f"Refused with {status}: {said}".rstrip(": ")

    async def _post(self, message: WebhookMessage) -> tuple[int, str]:
        """Post a message to the address that its name leads to now, within one deadline; returns status and begin of the answer."""
        parts = urlsplit(message.url)
        host, port = parsed(message.url)
        address = self.targets.addresses(host, port)[0]
        netloc = f"[{address}]:{port}" if ":" in address else f"{address}:{port}"
        identity, now_s = webhook_messages.make_message_id(message.delivery_id), int(time.time())
        headers = {
            "Host": parts.netloc,
            "Content-Type": "application/json",
            "Accept-Encoding": "identity",
            "User-Agent": f"Boresight/{boresight.__version__}",
            "webhook-id": identity,
            "webhook-timestamp": str(now_s),
            "webhook-signature": webhook_messages.sign_message(message.secrets, identity, now_s, message.body),
        }
        address_of_request = urlunsplit((parts.scheme, netloc, parts.path or "/", parts.query, ""))
        async with (
            asyncio.timeout(TIMEOUT_S),
            httpx.AsyncClient(timeout=TIMEOUT_S, trust_env=False, follow_redirects=False) as client,
            client.stream(
                "POST",
                address_of_request,
                content=message.body.encode(),
                headers=headers,
                extensions={"sni_hostname": host},
            ) as answer,
        ):
            heard = b""
            async for piece in answer.aiter_raw():
                heard += piece
                if len(heard) >= HEARD:
                    break
            return answer.status_code, heard[:HEARD].decode("utf-8", "replace")
