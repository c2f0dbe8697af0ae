"""Every question of the operator's checklist is answered where the list says: the page opens and the element is on it."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser

LIST = Path(__file__).parents[2] / "docs" / "operators-checklist.md"
ROW = re.compile(r"^\| +(\d+) \| ([^|]+) \| `([^`]+)` \| `([^`]+)` \| ([^|]+) \|$", re.MULTILINE)
SOON_MS = 30_000
QUESTIONS = ROW.findall(LIST.read_text())


def test_there_are_twenty_questions():
    assert [int(number) for number, *_ in QUESTIONS] == list(range(1, 21))


@pytest.mark.full
def test_each_question_is_answered_on_its_page(people, numbers):
    missing = []
    with people.seat("approver") as window:
        for number, question, address, element, _ in QUESTIONS:
            window.open(address.format(**numbers))
            try:
                expect(window.page.locator(element).first).to_be_visible(timeout=SOON_MS)
            except AssertionError:
                missing.append(f"{number}: {question} ({address} {element})")
    assert not missing
