"""The glossary and the code use the same words."""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LINES = [line for line in (ROOT / "docs/glossary.md").read_text(encoding="utf-8").splitlines() if line.startswith("- ")]
TERM = re.compile(r"- \*\*(?P<term>[^*]+)\*\*: .+\.(?P<names>(?: `[\w.]+`)+)")
#: Words of the project's own that standard ones replaced; nothing in the code is named so again.
REPLACED = set(
    re.findall(
        r"\w+",
        """Answering AtHand Beside Border Climb ClusterSpread Codings Conditions Course Desk Drawn Engine Evidence Fitness Flight
        Flights Insurance InThisProcess Judgement Keeping Kept Lanes Loan Lookout Mark Marks MatchedSet Misfit Once OnlyTry Orders
        Paces Place Ready RematchedSet Rounds Shown Sighting Sightings Sought Specimen Spread Standing StreamedSet Telling
        Told Turns Upkeep Watch Workplace climb course dressed fitness held_out judgements lookout only_try orders paces
        desk sighting specimen upkeep weigh weigh_block weighed wu_weighed""",
    )
)
#: What no function of the product is called, with or without an underscore: what acts is a verb that says what it does.
NO_VERBS = {"again", "kept", "said", "shown", "told"}
#: A member of the REST API and of stored gate reports keeps its name.
PUBLISHED = {
    "backend/boresight/console/approvals/gates.py: held_out",
    "backend/boresight/console/approvals/schemas.py: held_out",
    "backend/boresight/verdicts/gates/judgement.py: held_out",
}
IN_SCRIPTS = re.compile(r"\b(?:class|function|const|let|@typedef \{.*\}) (\w+)")
DEFINED = re.compile(r"\b(?:def|class) (\w+)|^ *(\w+)(?::| =)|[(,] *(\w+): ", re.MULTILINE)


def test_each_term_of_the_glossary_is_one_line_and_stands_once():
    found = [TERM.fullmatch(line) for line in LINES]
    assert [line for line, match in zip(LINES, found, strict=True) if match is None] == []
    assert 75 <= len(found) <= 130
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


def test_the_word_of_a_gate_without_data_is_written_for_nothing_else():
    paths = [
        *(ROOT / "backend/boresight").rglob("*.py"),
        *(ROOT / "frontend/templates").rglob("*.html"),
        *(ROOT / "docs").glob("*.md"),
    ]
    found = [path.name for path in paths if re.search("NO DATA|[\"']no data[\"']", path.read_text(encoding="utf-8"))]
    assert found == []


def find_names(tree: ast.Module) -> Iterator[str]:
    """Yield every name that a module gives to something of its own: definitions, arguments, variables, members, aliases."""
    for node in ast.walk(tree):
        match node:
            case ast.ClassDef(name) | ast.FunctionDef(name) | ast.AsyncFunctionDef(name):
                yield name
            case ast.arg(name) | ast.alias(_, str(name)) | ast.keyword(str(name)):
                yield name
            case ast.Name(name, ast.Store()) | ast.Attribute(_, name, ast.Store()):
                yield name


def test_nothing_is_named_by_a_replaced_word_again():
    found = []
    for path in (path for top in ("backend", "tests", "benchmarks") for path in (ROOT / top).rglob("*.py")):
        names = {path.stem, *find_names(ast.parse(path.read_bytes()))}
        found += [f"{path.relative_to(ROOT)}: {name}" for name in sorted(names & REPLACED)]
    for path in (ROOT / "frontend/static").rglob("*.js"):
        names = IN_SCRIPTS.findall(path.read_text(encoding="utf-8"))
        found += [f"{path.relative_to(ROOT)}: {name}" for name in (path.stem, *names) if name in REPLACED]
    assert [one for one in found if one not in PUBLISHED] == []


def test_no_function_is_named_by_a_word_that_does_not_say_what_it_does():
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"
        for path in (ROOT / "backend").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_bytes()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.strip("_") in NO_VERBS
    ]
    assert found == []


def test_in_sentences_and_tables_plus_minus_is_one_sigma_and_three_are_left_to_the_bands_of_figures():
    folders = [ROOT / "backend/boresight" / name for name in ("verdicts", "console", "figures/charts")]
    paths = [path for folder in folders for path in folder.rglob("*.py")]
    paths += (ROOT / "frontend/templates").rglob("*.html")
    found = [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for path in paths
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(r"± 3|\(3 ?σ\)|with three sigmas", line) and "hovertemplate" not in line
    ]
    assert found == []
