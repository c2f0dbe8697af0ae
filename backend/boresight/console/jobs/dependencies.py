"""Dependencies of the endpoints on the background services of the server that answers, which know no web themselves."""

from __future__ import annotations

from typing import Annotated

from boresight.console.access.dependencies import of_server
from boresight.console.jobs.broadcast import Broadcast
from boresight.console.jobs.maintenance import Maintenance
from boresight.console.jobs.webhook_sender import WebhookSender

Feed = Annotated[Broadcast, of_server("broadcast")]
ServerMaintenance = Annotated[Maintenance, of_server("maintenance")]
ServerWebhookSender = Annotated[WebhookSender, of_server("webhook_sender")]
