"""The documentation as readers get it: built without a warning, every link leads somewhere, and nothing comes from elsewhere."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from benchmarks import screenshots
from boresight.calibration.advice_kinds import ADVICE_KINDS, CAUSE
from boresight.calibration.trust.causes import CAUSES, UNKNOWN
from boresight.console.alarms.tables import ALARM_KINDS
from boresight.figures.charts import FIGURES
from boresight.figures.example_calibration import get_example_calibrations
from boresight.telemetry.quality.findings import SEVERITIES
from boresight.verdicts.gates.measurements import GATES
from boresight.verdicts.verdict import LEVEL_OF_STATUS, make_verdict_marks, trust_marks

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
REVIEW = (ROOT / "frontend" / "templates" / "shared" / "review.html").read_text(encoding="utf-8")
EXAMPLE = get_example_calibrations()["filter"]
ADDRESSES = {"a": "href", "link": "href", "script": "src", "img": "src", "object": "data"}
#: What stands on the pages for those who write them, and in no formula: a code block, or a figure's JSON.
CODE = re.compile(r"<(pre|code|script)\b.*?</\1>", re.DOTALL)


class Page(HTMLParser):
    """What a page has: names of places, addresses by tag, and scripts and styles that stand in the page itself."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.addresses: list[tuple[str, str]] = []
        self.inline: list[str] = []
        self.images_without_text: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        has = dict(attrs)
        self.names |= {has[name] for name in ("id", "name") if has.get(name)}
        if has.get(ADDRESSES.get(tag, "")):
            self.addresses.append((tag, has[ADDRESSES[tag]]))
        if tag == "style" or (tag == "script" and "src" not in has and has.get("type") != "application/json"):
            self.inline.append(str(attrs))
        if tag == "img" and not has.get("alt"):
            self.images_without_text.append(str(has.get("src")))


@pytest.fixture(scope="module")
def pages(built_site: Path) -> dict[Path, Page]:
    return {path: Page(path.read_text(encoding="utf-8")) for path in built_site.rglob("*.html")}


def _local(pages: dict[Path, Page]) -> Iterator[tuple[Path, str, Path, str]]:
    for path, page in pages.items():
        for _, address in page.addresses:
            parts = urlsplit(address)
            if not parts.scheme:
                target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
                yield path, address, target, unquote(parts.fragment)


def test_every_link_leads_to_a_file_of_the_site_and_every_place_in_it_stands_there(pages):
    by_path = {path.resolve(): page for path, page in pages.items()}
    found = list(_local(pages))
    lost = [(path.name, address) for path, address, target, _ in found if not target.is_file()]
    nowhere = [
        (path.name, address)
        for path, address, target, place in found
        if place and target in by_path and place not in by_path[target].names
    ]
    assert len(found) > 2000
    assert lost == []
    assert nowhere == []


def test_a_page_loads_nothing_from_elsewhere_and_holds_no_script_or_style_of_its_own(pages, built_site):
    loaded = [
        (path.name, one) for path, page in pages.items() for tag, one in page.addresses if tag != "a" and "//" in one
    ]
    sheets = "".join(path.read_text(encoding="utf-8") for path in built_site.rglob("*.css"))
    assert loaded == []
    assert {path.name: page.inline for path, page in pages.items() if page.inline} == {}
    assert re.findall(r"url\(['\"]?(?:https?:)?//", sheets) == []


def test_every_picture_says_what_it_shows(pages):
    assert {path.name: page.images_without_text for path, page in pages.items() if page.images_without_text} == {}


def test_no_formula_is_left_as_it_was_typed(built_site):
    left = [
        (path.name, found)
        for path in built_site.rglob("*.html")
        for found in re.findall(r"\$[^$\n<>]*\\[^$\n<>]*\$", CODE.sub("", path.read_text(encoding="utf-8")))
    ]
    assert left == []
    assert any('class="katex"' in path.read_text(encoding="utf-8") for path in built_site.rglob("*.html"))


def test_every_picture_of_a_page_is_one_that_the_script_takes_and_every_chart_one_of_the_gallery():
    texts = [path.read_text(encoding="utf-8") for path in (*DOCS.rglob("*.md"), ROOT / "README.md")]
    shown = {Path(found).name for text in texts for found in re.findall(r"!\[[^]]*\]\(([^)]+\.png)\)", text)}
    taken = {f"{name}.png" for name in screenshots.NAMES}
    assert shown == taken == {path.name for path in DOCS.rglob("*.png")}
    charts = {
        path.stem.removesuffix("-weak") for path in (DOCS / "figures").iterdir()
    }  # the same chart of the weak example
    assert charts <= set(FIGURES)


def test_every_document_of_the_folder_is_a_page(built_site):
    sources = [
        path.relative_to(DOCS).with_suffix(".html") for path in DOCS.rglob("*") if path.suffix in {".md", ".ipynb"}
    ]
    assert [str(name) for name in sources if not (built_site / name).is_file()] == []


def test_every_alarm_has_its_place_in_the_guide(pages, built_site):
    guide = pages[built_site / "how-to" / "respond-to-an-alarm.html"]
    assert {kind.lower() for kind in ALARM_KINDS} <= guide.names


def test_every_gate_and_every_finding_on_telemetry_has_its_place_in_a_guide_and_pages_link_to_it(pages, built_site):
    calls = [
        node
        for path in (ROOT / "backend" / "boresight").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in {"Finding", "marked_rows"}
    ]
    within = [one for call in calls for argument in call.args[:2] for one in ast.walk(argument)]
    words = {str(one.value) for one in within if isinstance(one, ast.Constant)} - set(SEVERITIES)
    codes = {f"finding-{word.lower().replace('_', '-')}" for word in words if word.isupper()}
    assert len(codes) > 30
    assert codes - pages[built_site / "how-to" / "respond-to-a-finding.html"].names == set()
    gates = {f"gate-{name}" for name in GATES}
    assert gates - pages[built_site / "how-to" / "respond-to-a-gate.html"].names == set()
    templates = ROOT / "frontend" / "templates"
    for name, guide in {
        "approvals/gates_panel.html": "respond-to-a-gate.html#gate-",
        "telemetry/telemetry_set.html": "respond-to-a-finding.html#finding-",
    }.items():
        assert f"/docs/how-to/{guide}" in (templates / name).read_text(encoding="utf-8")


def test_every_kind_of_advice_is_used_and_has_its_place_in_the_guide(pages, built_site):
    calls = [
        node
        for path in (ROOT / "backend" / "boresight").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func) in {"Advice", "Advice.begin", "make_advice"}
    ]
    used = {one.value for call in calls for one in call.args if isinstance(one, ast.Constant)}
    of_marks = {mark.name for mark in (*make_verdict_marks(EXAMPLE), *trust_marks(EXAMPLE))} - {"fit"}
    assert ADVICE_KINDS.keys() <= used | of_marks | {"running", "ground_calibration"}
    assert of_marks | {status for status, level in LEVEL_OF_STATUS.items() if level != "normal"} <= ADVICE_KINDS.keys()
    guide = pages[built_site / "how-to" / "respond-to-advice.html"]
    codes = [*ADVICE_KINDS, *(f"{CAUSE}{name}" for name in (*CAUSES, UNKNOWN.name))]
    assert {f"advice-{code.replace('_', '-')}" for code in codes} - guide.names == set()
    (linked,) = re.findall(r"/docs/how-to/respond-to-advice.html#advice-{{ ([^}]*) }}", REVIEW)
    assert linked == 'code | replace("_", "-")'
    templates = ROOT / "frontend" / "templates"
    for name in ("campaigns/campaign.html", "alignments/alignment.html", "fleet/advice_panel.html"):
        assert "what_to_do(" in (templates / name).read_text(encoding="utf-8")
    assert "advice_list(choice.found.advice)" in (templates / "runs" / "choice.html").read_text(encoding="utf-8")


def test_the_words_are_spelled_as_they_are():
    words = [sys.executable, "-m", "codespell_lib", "--ignore-words-list", "nees,tung"]
    sources = [str(path) for path in (*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb"), ROOT / "README.md")]
    done = subprocess.run([*words, *sources], capture_output=True, text=True, check=False)
    assert done.stdout == ""


def test_what_a_tutorial_tells_to_press_stands_on_the_pages():
    """A word in bold of the two tutorials in the browser is a label: a button, or a place in the side bar."""
    sources = [
        *(ROOT / "frontend" / "templates").rglob("*.html"),
        *(ROOT / "backend" / "boresight" / "console").rglob("*.py"),
    ]
    said = "".join(path.read_text(encoding="utf-8") for path in sources)
    told = [
        label
        for name in ("browser.md", "first-week.md")
        for label in re.findall(r"\*\*([A-Z][^*:.]*)\*\*", (DOCS / "tutorials" / name).read_text(encoding="utf-8"))
    ]
    assert len(told) > 20
    assert [label for label in told if label not in said] == []
