"""Webhooks: administrators make them, try them and send again what failed; others are told who may."""

import re

from boresight.console.webhooks import service as webhooks
from boresight.platform.db.sessions import open_writing

FORM = {
    "label": "Mission chat",
    "url": "https://mission.invalid/hook",
    "actions": "parameter-sets.promoted, approvals.*",
}


def _made(site) -> str:
    answer = site.visitor("adele").post("/webhooks", **FORM)
    assert answer.status_code == 200
    return re.search(r'href="(/webhooks/\d+)"', answer.text)[1]


def test_a_new_webhooks_secret_is_shown_this_once(site):
    visitor = site.visitor("adele")
    assert "whsec_" in visitor.post("/webhooks", **FORM).text
    page = visitor.get("/webhooks")
    assert "whsec_" not in page
    assert "approvals.*" in page


def test_a_refused_webhook_keeps_what_was_typed(site, read):
    answer = site.visitor("adele").post("/webhooks", **{**FORM, "url": "mission"})
    assert answer.status_code == 422
    assert "is no address" in read(answer.text)
    assert 'value="Mission chat"' in answer.text


def test_a_trial_stands_in_the_log_and_a_message_given_up_can_be_sent_again(site, read):
    visitor, address = site.visitor("adele"), _made(site)
    assert visitor.post(f"{address}/try").status_code == 303
    number = int(re.search(r"msg_(\d+)", visitor.get(address))[1])
    with open_writing(site.engine) as session:
        for _ in range(webhooks.MOST_ATTEMPTS):
            webhooks.settle(session, number, status=None, outcome="No answer: nobody is there.")
    page = read(visitor.get(address))
    assert "FAILED" in page
    assert "No answer: nobody is there." in page
    assert visitor.post(f"{address}/deliveries/{number}/redeliver").status_code == 303
    assert "PENDING" in read(visitor.get(address))


def test_a_disabled_webhook_offers_to_be_enabled_and_nothing_else(site):
    visitor, address = site.visitor("adele"), _made(site)
    visitor.post(f"{address}/disable")
    page = visitor.get(address)
    assert f'action="{address}/try"' not in page
    assert f'action="{address}/enable"' in page


def test_who_is_no_administrator_is_told_who_may_and_shown_no_address(site, read):
    address = _made(site)
    page = read(site.visitor("ada").get("/webhooks"))
    assert "Webhooks are managed by administrators" in page
    assert "mission.invalid" not in page
    assert site.visitor("ada").send("GET", address, headers={"accept": "text/html"}).status_code == 403
