"""Dependencies of the endpoints on the background services of the server that answers, which know no web themselves."""

from __future__ import annotations

from typing import Annotated

from boresight.console.access.dependencies import depend_on_server
from boresight.console.jobs.anchoring import Anchoring
from boresight.console.jobs.broadcast import Broadcast
from boresight.console.jobs.maintenance import Maintenance
from boresight.console.jobs.message_sender import MessageSender
from boresight.console.jobs.webhook_sender import WebhookSender

Feed = Annotated[Broadcast, depend_on_server("broadcast")]
ServerMessageSender = Annotated[MessageSender, depend_on_server("message_sender")]
ServerMaintenance = Annotated[Maintenance, depend_on_server("maintenance")]
ServerWebhookSender = Annotated[WebhookSender, depend_on_server("webhook_sender")]
ServerAnchoring = Annotated[Anchoring, depend_on_server("anchoring")]
