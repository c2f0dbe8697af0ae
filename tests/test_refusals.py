"""Every refusal says what to do: by an imperative, by what a value must be, or by that there is nothing to do.

What is said is read from the syntax trees. A placeholder stands for any text; one that brings the remedy says so by its name.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from boresight import errors

SOURCE = Path(__file__).resolve().parents[1] / "backend" / "boresight"
#: One is stopped, as asked; the other has its sentences in a table of its own.
OTHERS = {"CancelledError", "SessionEndedError"}
REFUSALS = {
    name
    for name, kind in vars(errors).items()
    if isinstance(kind, type) and issubclass(kind, errors.BoresightError) and name not in OTHERS
} | {"OffDetectorError", "OtherCameraError", "Unavailable", "UnlikeModelsError"}
#: Placeholders at the end of a text that bring the remedy.
REMEDIES = {
    "advice", "expected", "fault", "give", "hint", "kept", "more", "own", "refusal", "remedy", "way_out", "why",
}  # fmt: skip
WORDS = """
    add agree align ask assess begin bin bring build calibrate change check chmod choose comment compare convert copy correct
    create cut delete diagnose do download dump edit enable end enrol enter export expose extract find free give have hold
    import install keep launch leave let list log look lower make mend mount move name number omit open pack paste pick pip pipe
    print promote propose put raise read recalibrate record register rehearse reload remove rename repeat restore rotate run
    save say see send set shorten show sign sort split start stop submit take tick try turn type unpack upload use verify wait
    withdraw write
"""
VERBS = frozenset(WORDS.split())
ANY = "…"
BEGINS = re.compile(rf"(?:^|[:;.?{ANY}] |\| )(?:(?:only|first|then) )?([A-Za-z]+)")
PLAIN = re.compile(r"\bmust (?:be|give|look)\b|there is nothing to \w|did you mean", re.IGNORECASE)


def says_what_to_do(text: str) -> bool:
    return bool(PLAIN.search(text)) or any(word.lower() in VERBS for word in BEGINS.findall(text))


class Texts:
    """The texts of a module, with its own constants and the names of placeholders at their ends."""

    def __init__(self, tree: ast.Module) -> None:
        self.constants = {
            target.id: node.value
            for node in tree.body
            if isinstance(node, ast.Assign)
            for target in node.targets
            if isinstance(target, ast.Name)
        }

    def read(self, node: ast.expr) -> str | None:
        """Return a text, `ANY` for what is not known; None where nothing of it is."""
        match node:
            case ast.Constant(value=str(text)):
                return text
            case ast.JoinedStr(values=parts):
                return "".join(
                    self.read(one.value if isinstance(one, ast.FormattedValue) else one) or ANY for one in parts
                )
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return (self.read(left) or ANY) + (self.read(right) or ANY)
            case ast.IfExp(body=body, orelse=other):
                return f"{self.read(body) or ANY} | {self.read(other) or ANY}"
            case ast.Name(id=name) if name in self.constants:
                return self.read(self.constants[name])
        return None

    def is_assembled(self, node: ast.expr) -> bool:
        """Whether the last placeholder of a text, with nothing but a full stop after it, brings the remedy."""
        match node:
            case ast.JoinedStr(values=[*_, ast.FormattedValue(value=last)]):
                pass
            case ast.JoinedStr(values=[*_, ast.FormattedValue(value=last), ast.Constant(value=".")]):
                pass
            case _:
                return False
        names = {one.id for one in ast.walk(last) if isinstance(one, ast.Name)}
        return bool((names | {one.attr for one in ast.walk(last) if isinstance(one, ast.Attribute)}) & REMEDIES)


def _said(call: ast.Call) -> ast.expr | None:
    """Return what a call refuses with; None where it refuses nothing."""
    match call:
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=[text, *_]) if name in REFUSALS:
            return text
        case ast.Call(func=ast.Attribute(value=faults, attr="add"), args=[text, *_]) if _are_faults(faults):
            return text
        case ast.Call(func=ast.Attribute(value=faults, attr="add_entries" | "add_entry"), args=[_, _, text]) if (
            _are_faults(faults)
        ):
            return text.body if isinstance(text, ast.Lambda) else text
    return None


def _are_faults(node: ast.expr) -> bool:
    return ast.unparse(node).endswith(("faults", "absent"))


def refusals() -> Iterator[tuple[str, str, bool]]:
    """Yield the place and text of each refusal, and whether its remedy is assembled elsewhere."""
    for path in sorted(SOURCE.rglob("*.py")):
        tree = ast.parse(path.read_text())
        texts = Texts(tree)
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            said = _said(call)
            text = None if said is None else texts.read(said)
            if said is not None and text is not None:
                yield f"{path.relative_to(SOURCE)}:{call.lineno}", text, texts.is_assembled(said)


def test_every_refusal_says_what_to_do():
    found = list(refusals())
    assert len(found) > 600
    assert [text for text in errors.SessionEndedError.SENTENCES.values() if not says_what_to_do(text)] == []
    assert [f"{place}: {text}" for place, text, assembled in found if not (assembled or says_what_to_do(text))] == []


@pytest.mark.parametrize(
    ("text", "helps"),
    [
        ("… is empty: copy it again.", True),
        ("Give the reason why …", True),
        ("Alarm … is not shelved; there is nothing to unshelve.", True),
        ("There is no role …; the roles are ….", False),
        ("… cannot be read: ….", False),
        ("This needs the role …; … has ….", False),
    ],
)
def test_a_text_that_only_tells_a_state_is_not_taken_for_advice(text, helps):
    assert says_what_to_do(text) is helps
