"""Messages over the wire: a real receiver and a real mail server get them, and a service reaches nothing else."""

import json
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from benchmarks.receivers import receiving_mail
from benchmarks.servers import listening
from boresight.console.jobs.message_sender import MessageSender
from boresight.console.messages import service as messages
from boresight.console.messages.service import AddressChoice, Outlets
from boresight.console.messages.tables import Message
from boresight.errors import RefusedInputError
from boresight.platform.actors import POLICY
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.platform.jobs import message_transport as transport
from boresight.platform.jobs.message_transport import OutboundMessage
from boresight.platform.web.targets import WebhookTargets

LOCAL = WebhookTargets(local=True)


@pytest.fixture
def received() -> Iterator[tuple[int, list[Any]]]:
    """A receiver of JSON; `/moved` redirects to the mail server's port of this machine."""
    heard: list[Any] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            heard.append((self.path, json.loads(body)))
            self.send_response(302 if self.path == "/moved" else 503 if self.path.startswith("/busy") else 200)
            self.send_header("Location", "http://169.254.169.254/latest/meta-data")
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            """Keep quiet."""

    with listening(ThreadingHTTPServer(("127.0.0.1", 0), Handler)) as port:
        yield port, heard


@pytest.fixture
def mailed() -> Iterator[tuple[int, list[str]]]:
    with receiving_mail() as received:
        yield received


def test_a_message_goes_the_whole_way_to_a_receiver_and_to_a_mail_server(engine, people, received, mailed, tmp_path):
    (port, heard), (mail_port, mail) = received, mailed
    server = f"mailto://127.0.0.1:{mail_port}?from=bs@mission.example&mode=insecure"
    outlets = Outlets(("mailto", "json"), server, "https://bs.example")
    box = SecretBox(tmp_path / "webhooks.key")
    sender = MessageSender(engine, LOCAL, box, outlets, lambda: POLICY)
    address, checked = sender.judge_address(people["ana"], f"json://127.0.0.1:{port}/hook/secrettoken")
    assert (checked.service, "secrettoken" in checked.shown) == ("json", False)
    with open_writing(engine) as session:
        ids = [
            messages.add_address(session, people["ana"], box, "", *given, AddressChoice()).id
            for given in ((address, checked), sender.judge_address(people["ana"], "ana@mission.example"))
        ]
        for address_id in ids:
            messages.try_address(session, people["ana"], address_id)
    sender.deliver()
    with open_reading(engine) as session:
        rows = session.scalars(sa.select(Message).order_by(Message.id)).all()
    assert [(row.state, row.attempts, row.outcome) for row in rows] == [("DELIVERED", 1, "Delivered.")] * 2
    ((path, body),) = heard
    assert path == "/hook/secrettoken"
    assert body["message"].endswith("https://bs.example/preferences/messages")
    assert mail[:2] == ["mail FROM:<bs@mission.example>", "rcpt TO:<ana@mission.example>"]
    assert "https://bs.example/preferences/messages" in mail[2].replace("=\r\n", "")


def test_a_service_reaches_no_address_that_webhooks_may_not_and_its_outcome_says_which(received):
    port, heard = received
    inside = OutboundMessage(1, "t", "b", False, f"json://127.0.0.1:{port}/hook")
    (told,) = transport.send([inside], WebhookTargets())
    assert (told.ok, heard) == (False, [])
    assert "BORESIGHT_WEBHOOKS_LOCAL=1" in told.outcome
    moved = OutboundMessage(2, "t", "b", False, f"json://127.0.0.1:{port}/moved")
    other = OutboundMessage(3, "t", "b", True, f"json://127.0.0.1:{port}/mail-server")
    busy = OutboundMessage(4, "t", "b", False, f"json://127.0.0.1:{port}/busy/secrettoken")
    told = {one.id: one for one in transport.send([moved, other, busy], LOCAL)}
    assert not told[2].ok
    assert "169.254.169.254" in told[2].outcome, "a redirect is judged like a first connection"
    assert told[3].ok, "the installation's own mail server may be inside"
    assert not told[4].ok
    assert "secrettoken" not in told[4].outcome
    assert repr(busy) == "OutboundMessage(id=4, title='t', body='b', trusted=False)"


def test_an_address_is_checked_before_it_is_kept():
    for address in ("json://10.0.0.1/x", "json://mission.invalid/?verify=no", "slack://x", "nothing://x"):
        with pytest.raises(RefusedInputError):
            transport.check(address, WebhookTargets())


def test_neither_the_server_nor_its_tests_import_apprise():
    sources = Path(transport.__file__).parents[2]
    importing = [path.name for path in sources.rglob("*.py") if "import apprise" in path.read_text()]
    assert importing == ["message_transport.py"]
