"""The pages of proposed changes: proposed from the form, shown where it matters, confirmed by another person."""

import re
from dataclasses import replace

import pytest

from boresight.console.approvals import gate_profiles
from boresight.platform.db.sessions import open_reading, open_writing
from tests.console.approvals.test_gate_pages import EDITOR, fields
from tests.passwords import add_person
from tests.sites import PEOPLE

REASON = "Corners matter."


@pytest.fixture
def asking(site, monkeypatch):
    site.app.state.policy = replace(site.app.state.policy, second_person=True)
    monkeypatch.setitem(PEOPLE, "agnes", ("administrator",))  # the next number is hers
    with open_writing(site.engine) as session:
        add_person(session, "agnes", "administrator")
    return site


def _proposed(site) -> str:
    visitor = site.visitor("adele")
    typed = fields(visitor.get(EDITOR)) | {"coverage.limit": "0.25", "action": "set", "reason": REASON}
    answer = visitor.post(EDITOR, **typed)
    assert answer.status_code == 303
    return answer.headers["location"]


def _in_force(site) -> int:
    with open_reading(site.engine) as session:
        return gate_profiles.profile_in_force(session, 1).number


def test_what_was_proposed_waits_on_every_page_that_it_touches_until_another_confirms_it(asking, read):
    assert "Propose version 1" in read(asking.visitor("adele").get(EDITOR))
    page = _proposed(asking)
    assert re.fullmatch(r"/change-proposals/\d+", page)
    others = read(asking.visitor("agnes").get(page))
    assert "gates[coverage].limit" in others
    assert "0.25" in others
    for name, place in (("adele", EDITOR), ("agnes", "/change-proposals"), ("agnes", "/")):
        assert f'href="{page}"' in asking.visitor(name).get(place)
    assert _in_force(asking) == 0
    answer = asking.visitor("agnes").post(f"{page}/decide", version="1", action="confirm")
    assert answer.status_code == 303
    assert _in_force(asking) == 1
    assert f'href="{page}"' in asking.visitor("adele").get(EDITOR)  # beside the version that it became
    assert "Nothing waits" in read(asking.visitor("adele").get("/change-proposals"))
    assert "CONFIRMED" in read(asking.visitor("adele").get("/change-proposals?show=all"))


def test_a_refusal_without_a_comment_keeps_the_page_and_one_with_it_ends_the_proposal(asking, read):
    page = _proposed(asking)
    refused = asking.visitor("agnes").post(f"{page}/decide", version="1", action="refuse")
    assert refused.status_code == 422
    asking.visitor("agnes").post(f"{page}/decide", version="1", action="refuse", comment="Not before the eclipse.")
    words = read(asking.visitor("adele").get(page))
    assert "REFUSED" in words
    assert "Not before the eclipse." in words
    assert _in_force(asking) == 0


def test_who_may_not_decide_is_told_why_and_the_proposer_takes_it_back(asking, read):
    page = _proposed(asking)
    assert 'id="decide-blocked"' in asking.visitor("ada").get(page)
    assert asking.visitor("ada").post(f"{page}/decide", version="1", action="confirm").status_code == 403
    assert asking.visitor("adele").post(f"{page}/decide", version="1", action="withdraw").status_code == 303
    assert "WITHDRAWN" in read(asking.visitor("adele").get(page))
