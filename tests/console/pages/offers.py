"""What a page offers, as the forms that its buttons send, and whether the server would accept them, by dry runs."""

from html.parser import HTMLParser
from typing import Any

REASON = "The limit was only set to be tried."


class Offers(HTMLParser):
    """The buttons of a page that would send a form: its address and fields, and the dialog that it is in."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.sent: list[tuple[str, dict[str, str], str | None]] = []
        self.openers: set[str] = set()
        self._ahead: dict[str, dict[str, str]] = {}  # fields that stand before the form that they name
        self._form: tuple[str, dict[str, str]] | None = None
        self._dialog: str | None = None
        self.feed(page)

    def handle_starttag(self, tag: str, given: list[tuple[str, str | None]]) -> None:
        has = {name: value or "" for name, value in given}
        if tag == "form":
            fields = self._ahead.get(has.get("id", ""), {})
            self._form = (has.get("action", ""), fields) if has.get("method") == "post" else None
        elif tag == "dialog":
            self._dialog = has["id"]
        elif tag == "a" and "#" in has.get("href", ""):
            self.openers.add(has["href"].partition("#")[2])
        elif tag in {"input", "textarea", "select"} and "disabled" not in has:
            if "form" in has:
                self._ahead.setdefault(has["form"], {})[has.get("name", "")] = has.get("value", "")
            elif self._form:
                self._form[1].setdefault(has.get("name", ""), has.get("value", ""))
        elif tag == "button" and not {"disabled", "hidden"} & set(has):
            if "data-act" in has:
                self.openers.add(has["popovertarget"])
            elif has.get("type", "submit") == "submit" and self._form:
                fields = self._form[1]
                fields |= {has["name"]: has.get("value", "")} if "name" in has else {}
                self.sent.append((has.get("formaction", self._form[0]), dict(fields), self._dialog))

    def handle_endtag(self, tag: str) -> None:
        if tag == "form":
            self._form = None
        if tag == "dialog":
            self._dialog = None

    def reachable(self) -> list[tuple[str, dict[str, str]]]:
        """Return what can be sent from the page: the forms that are in no dialog, or in one that something opens."""
        return [(place, fields) for place, fields, dialog in self.sent if dialog is None or dialog in self.openers]


def is_accepted(act: str, answer: Any) -> bool:
    """Return whether a dry run would have been done; any answer but a refusal for who asks or how things stand is a fault."""
    assert answer.status_code in {200, 201, 202, 401, 403, 404, 409, 412, 422}, (act, answer.text)
    return answer.status_code < 300
