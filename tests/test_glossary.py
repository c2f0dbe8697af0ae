"""The glossary and the code use the same words."""

import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
LINES = [line for line in (ROOT / "docs/glossary.md").read_text(encoding="utf-8").splitlines() if line.startswith("- ")]
TERM = re.compile(r"- \*\*(?P<term>[^*]+)\*\*: .+\.(?P<names>(?: `[\w.]+`)+)")
DEFINED = re.compile(r"\b(?:def|class) (\w+)|^ *(\w+)(?::| =)|[(,] *(\w+): ", re.MULTILINE)


def test_each_term_of_the_glossary_is_one_line_and_stands_once():
    found = [TERM.fullmatch(line) for line in LINES]
    assert [line for line, match in zip(LINES, found, strict=True) if match is None] == []
    assert 75 <= len(found) <= 95
    terms = Counter(term for match in found for term in match["term"].split(", "))
    assert [term for term, count in terms.items() if count > 1] == []


def test_each_code_name_of_the_glossary_is_a_name_in_the_code():
    paths = list((ROOT / "backend/boresight").rglob("*.py"))
    known = {name for path in paths for name in (path.stem, path.parent.name)}
    known.update(
        name for path in paths for found in DEFINED.findall(path.read_text(encoding="utf-8")) for name in found
    )
    named = {
        name.rpartition(".")[2] for line in LINES for name in re.findall(r"`([\w.]+)`", TERM.fullmatch(line)["names"])
    }
    assert sorted(named - known) == []
