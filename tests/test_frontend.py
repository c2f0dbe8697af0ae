"""The makings of the pages fit together: what is named is there, what is there is named, and types are checked everywhere."""

import json
import re
from pathlib import Path

import pytest
from jinja2 import Environment, FileSystemLoader, meta

from boresight.console.pages.rendering import TEMPLATES
from boresight.platform.web.static_files import SHIPPED

FRONTEND = Path(__file__).parents[1] / "frontend"
STATIC = FRONTEND / "static"
PAGES = {
    path.relative_to(FRONTEND / "templates").as_posix(): path.read_text()
    for path in FRONTEND.glob("templates/**/*.html")
}
MODULES = {path.relative_to(STATIC).as_posix(): path.read_text() for path in STATIC.rglob("*.js")}
SHEETS = {path.relative_to(STATIC).as_posix(): path.read_text() for path in STATIC.rglob("*.css")}
ALONE = {"figures/report.html", "uplinks/verification_sheet.html"} | {
    name for name in PAGES if name.startswith("papers/")
}
# What Python says of a state, a mode or a colour, after what a template or a module says itself.
BEGINNINGS = ("mode-", "notice-", "run-colour-", "status-", "tile-")
LITERAL = r"""["']([a-z][a-z0-9 -]*)["']"""


@pytest.mark.parametrize("name", PAGES)
def test_a_template_names_only_templates_that_are_there(name):
    tree = Environment(loader=FileSystemLoader(FRONTEND / "templates"), autoescape=True).parse(PAGES[name])
    assert set(meta.find_referenced_templates(tree)) <= set(PAGES)
    if name not in ALONE:  # those have filters of their own
        TEMPLATES.get_template(name)


def test_every_template_is_named_by_python_or_by_another():
    package = FRONTEND.parent / "backend" / "boresight"
    texts = [*PAGES.values(), *(path.read_text() for path in package.rglob("*.py"))]
    assert {name for name in PAGES if not any(f'"{name}"' in text for text in texts)} == set()


def test_every_static_file_is_named_and_every_name_is_a_file():
    named = {found for text in PAGES.values() for found in re.findall(r"/static/([\w./-]+)", text)}
    for name, text in MODULES.items():
        paths = (STATIC / name).parent, re.findall(r'^import .* from "(.+)";$', text, re.MULTILINE)
        named |= {(paths[0] / path).resolve().relative_to(STATIC).as_posix() for path in paths[1]}
    assert named - set(SHIPPED) == {path.relative_to(STATIC).as_posix() for path in STATIC.rglob("*") if path.is_file()}


def _classes_and_ids() -> set[str]:
    words: set[str] = set()
    for text in PAGES.values():
        for found in re.findall(r'(?:class|id)="?((?:[^"{>]|\{\{.*?\}\}|\{%.*?%\})*)', text):
            words |= set(re.findall(r"[\w-]+", found))
        words |= {word for found in re.findall(LITERAL, text) for word in found.split()}
        words |= set(re.findall(r'class=(\w+)"', text))
    for text in MODULES.values():
        words |= {word for found in re.findall(LITERAL, text) for word in found.split()}
    for path in (FRONTEND.parent / "backend" / "boresight").rglob("*.py"):
        words |= {word for found in re.findall(LITERAL, path.read_text()) for word in found.split()}
    return words


def test_every_class_and_id_of_a_style_sheet_is_given_to_something():
    rules = {name: re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL) for name, text in SHEETS.items()}
    selectors = {(name, found) for name, text in rules.items() for found in re.findall(r"([^{}]+)\{", text)}
    styled = {(name, word) for name, found in selectors for word in re.findall(r"[.#]([A-Za-z][\w-]*)", found)}
    given = _classes_and_ids()
    assert {one for one in styled if one[1] not in given and not one[1].startswith(BEGINNINGS)} == set()


ACTS = (
    r'action="[^"]*/(promote|roll-back|uplink/record|uplink/activate|disable|revoke|reset-second-factor)"'
    r'|name="decision",? value=("APPROVE"|decision)'
)


def test_no_act_with_consequences_is_without_its_dialog():
    found = set()
    for path in (FRONTEND / "templates").rglob("*.html"):
        text = path.read_text()
        for act in re.finditer(ACTS, text):
            before = text[: act.start()]
            assert before.rfind("call act_dialog(") > before.rfind("endcall"), f"{path.name}: {act[0]}"
            found.add(act[1] or {"decision": "refuse"}.get(act[2], "approve"))
    acts = {"promote", "roll-back", "uplink/record", "uplink/activate", "disable", "revoke", "reset-second-factor"}
    assert found == {*acts, "approve", "refuse"}


def test_only_one_module_touches_plotly_and_knows_its_private_fields():
    private = re.compile(r"\b_(?:full\w+|context|plots|offset|length)\b|\bwindow\.Plotly\b|\b(?:p2d|d2p)\b")
    assert {name for name, text in MODULES.items() if private.search(text)} == {"shared/plotly.js"}


def test_types_are_checked_strictly_in_every_module_with_no_way_around():
    options = json.loads((FRONTEND / "tsconfig.json").read_text())
    texts = [*MODULES.values(), *(path.read_text() for path in (FRONTEND / "types").glob("*.d.ts"))]
    assert options["include"] == ["static", "types"]
    assert options["compilerOptions"]["checkJs"]
    assert options["compilerOptions"]["strict"]
    assert [found for text in texts for found in re.findall(r"@ts-\w+|[{<:|] ?any\b", text)] == []


def test_the_checker_of_types_is_pinned_and_nothing_of_it_is_shipped():
    wanted = json.loads((FRONTEND / "package.json").read_text())
    locked = json.loads((FRONTEND / "package-lock.json").read_text())["packages"]
    assert set(wanted) == {"name", "description", "private", "devDependencies"}
    for name, version in wanted["devDependencies"].items():
        assert locked[f"node_modules/{name}"]["version"] == version
    assert all(package["integrity"].startswith("sha512-") for path, package in locked.items() if path)


def test_no_page_leads_to_the_documentation_where_it_was_not_built():
    linking = {name: text for name, text in PAGES.items() if 'href="/docs/' in text}
    assert len(linking) > 4
    guarded = r"{% if [^%]*\bhas_documentation\(\) %}(?:(?!{% (?:if|else|elif|endif)\b).)*"
    bare = {name for name, text in linking.items() if 'href="/docs/' in re.sub(guarded, "", text, flags=re.DOTALL)}
    assert bare == set()


def test_the_line_over_a_page_leads_to_what_is_above_it_and_ends_with_the_page_itself():
    told = {name: re.findall(r"{% block context %}(.+?){% endblock %}", page) for name, page in PAGES.items()}
    lines = {name: line for name, found in told.items() for line in found}
    assert len(lines) > 15
    step = r'(?:<a href="[^"]*">[^<]*</a>|{% if .*?{% endif %})'
    wrong = [name for name, line in lines.items() if not re.fullmatch(rf"{step}(?: · {step})* · [^<]+", line)]
    assert wrong == []
