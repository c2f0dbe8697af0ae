"""What a client makes of a server that lies, breaks off or is another: one sentence, no traceback, and no key in it."""

import ssl

import pytest
from click.testing import CliRunner

import boresight as bs
from boresight.cli import main
from boresight.cli.remote import API_KEY
from boresight.library import client as client_module
from boresight.library.remote import parse_plan
from boresight.workers.security import issue
from tests.library.servers import answering

SECRET = "bs_secret"
PAGE = b"<html>Log in</html>"
PROBLEM = {"type": "urn:boresight:problem:refused-input", "detail": "No."}
RUN = dict.fromkeys(("sensor_id", "telemetry_set_id", "validation_set_id", "reason", "progress"))
RUN |= {"id": 7, "label": "", "method": "batch", "attempt": 1, "settings": {}}


@pytest.fixture(autouse=True)
def _hurried(monkeypatch):
    monkeypatch.setattr(client_module, "FIRST_PAUSE_S", 0.001)


def refused(answers, ask, error=bs.UnavailableError):
    with answering(answers) as (address, seen), bs.Client(address, SECRET) as client:
        with pytest.raises(error) as raised:
            ask(client)
        sentence = str(raised.value)
        assert SECRET not in sentence
        assert sentence.isprintable()
        return sentence, seen


FOREIGN = {
    "a page": (200, PAGE, {"Content-Type": "text/html"}),
    "nothing": (204, b""),
    "a list": (200, [1]),
    "null": (200, None),
    "half": (200, b'{"items":['),
    "no number": (200, b'{"items": [], "next": NaN}'),
    "no text": (200, b"\xff\xfe{"),
    "a deep one": (200, b"[" * 100_000),
    "other members": (200, {"rows": 3}),
    "members of other types": (200, {"id": 1, "items": {}, "layout": [], "progress": 3, "status": 1}),
}


@pytest.mark.few(20)
@pytest.mark.parametrize("answer", FOREIGN.values(), ids=FOREIGN)
@pytest.mark.parametrize(
    "ask",
    [
        lambda client: client.sensors(),
        lambda client: client.run(1),
        lambda client: client.figures(1),
        lambda client: client.figure(1, "convergence"),
        lambda client: client.report(1),
        lambda client: client.cancel(1),
        lambda client: client.submit(1, "It moved."),
        lambda client: client.export(1),
    ],
    ids=["sensors", "run", "figures", "figure", "report", "cancel", "submit", "export"],
)
def test_an_answer_of_something_else_is_said_to_be_one(answer, ask):
    refused([answer], ask)


@pytest.mark.parametrize("document", [{}, {"pointings": 3}, {"pointings": [3]}, {"pointings": [{}]}, {"pointings": []}])
def test_a_plan_that_lacks_members_is_of_another_server(document):
    with pytest.raises(bs.UnavailableError):
        parse_plan(document)


def test_a_redirect_is_not_followed_and_names_where_it_leads():
    sentence, seen = refused([(302, b"", {"Location": "https://evil.example/"})], lambda client: client.sensors())
    assert "https://evil.example/" in sentence
    assert len(seen) == 1


@pytest.mark.parametrize("errors", [["x"], {"a": 1}, 3, [None], [{"row": 4}]])
def test_a_refusal_keeps_its_sentence_whatever_places_it_names(errors):
    sentence, _ = refused([(422, PROBLEM | {"errors": errors})], lambda client: client.run(1), bs.RefusedInputError)
    assert sentence == "No."


def test_a_date_in_retry_after_is_no_number_of_seconds():
    slow = {"type": "urn:boresight:problem:too-many-attempts", "detail": "Later."}
    date = {"Retry-After": "Wed, 21 Oct 2026 07:28:00 GMT"}
    refused([(429, slow, date)] * 5, lambda client: client.run(1), bs.BoresightError)


def test_what_a_terminal_would_obey_is_left_out_of_sentences():
    refused([(422, PROBLEM | {"detail": "\x1b]0;owned\x07No\nroot: ok"})], lambda client: client.run(1), ValueError)
    failed = RUN | {"state": "FAILED", "reason": "\x1b[2Jno stars"}
    refused([(200, failed)], lambda client: client.wait(7), bs.RunFailedError)


def test_what_is_damaged_on_the_way_is_asked_again():
    broken = (200, b"no gzip", {"Content-Encoding": "gzip"})
    with answering([broken, (200, {"items": [], "next": None})]) as (address, seen), bs.Client(address) as client:
        assert client.sensors() == []
        assert len(seen) == 2


def test_a_list_that_begins_anew_is_not_read_for_ever():
    page = (200, {"items": [], "next": "a"})
    assert "starts again after a page" in refused([page, page], lambda client: client.sensors())[0]


def test_a_package_is_the_one_that_the_server_built():
    built = (201, {"id": 3, "sha256": "0" * 64})
    refused([built, (200, b"PK, but another")], lambda client: client.export(1))


def test_a_key_that_can_be_none_is_refused_before_it_is_sent_and_never_shown():
    for key in ("se\ncret", "se\x00cret", "sécret"):
        with pytest.raises(bs.RefusedInputError) as raised:
            bs.Client("https://boresight.example", key)
        assert "cret" not in str(raised.value)
    with answering([(200, {"items": [], "next": None})]) as (address, seen), bs.Client(address, " key\n") as client:
        client.sensors()  # as a file ends in a line's end
        assert seen[0]["Authorization"] == "Bearer key"


@pytest.mark.parametrize(
    "url",
    [
        "http://[::1",
        "http://a:b",
        "http://a?x=1",
        "http://a#b",
        "http://\x00",
        "http://h\n",
        "http://a..b",
        "file:///etc",
    ],
)
def test_what_is_no_address_is_refused(url):
    with pytest.raises(bs.RefusedInputError):
        bs.Client(url)


def test_a_certificate_that_nobody_here_knows_is_refused_at_once(tmp_path):
    issued, chain = issue(), tmp_path / "server.pem"
    chain.write_text(issued.certificate + issued.key)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(chain)
    with answering([], context) as (address, seen), bs.Client(address, SECRET) as client:
        with pytest.raises(bs.UnavailableError, match="SSL_CERT_FILE"):
            client.sensors()
        assert seen == []


def test_who_stops_waiting_or_loses_the_server_learns_which_run_goes_on(monkeypatch, tmp_path):
    running = (200, RUN | {"state": "RUNNING"})
    with answering([running, *[None] * 5]) as (address, _), bs.Client(address, SECRET) as client:
        with pytest.raises(bs.UnavailableError) as raised:
            client.wait(7)
        assert "Run 7 continues" in raised.value.__notes__[0]

    def stop(_):
        raise KeyboardInterrupt

    (tmp_path / "t.csv").write_text("frame\n")
    counts = dict.fromkeys(("id", "sensor_id", "frames", "stars"), 3)
    stored = counts | {"name": "a", "purpose": "calibration", "original_sha256": "", "quality": {}}
    sensor = {"id": 3, "name": "ST", "version": 1, "document": {}}
    answers = [(200, {"items": [sensor], "next": None}), (201, stored), (202, RUN | {"state": "QUEUED"}), running]
    monkeypatch.setattr(client_module.time, "sleep", stop)
    monkeypatch.setenv(API_KEY, SECRET)
    with answering(answers) as (address, _):
        words = ["calibrate", str(tmp_path / "t.csv"), "--sensor", "ST", "--server", address]
        ended = CliRunner().invoke(main, words)
    assert ended.exit_code == 130
    assert ended.stderr.splitlines() == [
        "boresight: stopped.",
        "  Run 7 continues on the server: see or cancel it on its page there.",
    ]
