"""Who may import whom inside the console: roles in one order, nouns in one order."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1] / "backend" / "boresight"
CONSOLE = ROOT / "console"
RANKS = {"tables": 0, "queries": 1, "service": 2, "schemas": 3, "dependencies": 3, "routes": 4, "pages": 4}
# Services of a noun use those of nouns before it, and of none after it.
NOUNS = (
    "access",
    "saved_views",
    "notes",
    "telemetry",
    "runs",
    "parameter_sets",
    "fleet",
    "alarms",
    "approvals",
    "alignments",
    "uplinks",
    "change_proposals",
    "campaigns",
    "ingest",
    "mission_control",
    "retention",
    "webhooks",
    "messages",
    "audit",
    "backups",
    "help",
    "search",
    "administration",
    "jobs",  # no noun: the background services, over the nouns whose work they do
)
SHARED = {"pages"}
# What stands beside the nouns, by its role; `schemas` and `routes` are called as theirs are.
BESIDE = {"__init__": "tables", "list_queries": "queries", "transitions": "service", "operation": "dependencies"}
# What knows HTTP although it is neither page nor route, nor their dependencies.
HTTP = {
    "access.credentials",
    "access.password_checks",
}


def _name(path: Path) -> str:
    return ".".join(path.relative_to(CONSOLE).with_suffix("").parts).removesuffix(".__init__")


MODULES = {
    _name(path): path for path in sorted(CONSOLE.rglob("*.py")) if path.relative_to(CONSOLE).parts[0] not in SHARED
}


def _is_of_noun(name: str) -> bool:
    return name.split(".", maxsplit=1)[0] in NOUNS


def _role(name: str) -> str:
    """Return what a module of a noun is, or one beside them."""
    if name in BESIDE:
        return BESIDE[name]
    parts = name.split(".")[1:] if _is_of_noun(name) else [name]
    if "pages" in parts:
        return "pages"
    leaf = parts[0] if parts else ""
    if leaf.endswith("routes"):
        return "routes"
    return leaf if leaf in RANKS else "service"


@cache
def _imports(path: Path) -> frozenset[str]:
    """Return every module that a file imports, and every name that may be one."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(found)


def _used(name: str) -> set[str]:
    """Return the modules of the console that one of them imports."""
    prefix = "boresight.console."
    found = {one.removeprefix(prefix) for one in _imports(MODULES[name]) if one.startswith(prefix)}
    return {one for one in found if one in MODULES and one not in NOUNS} - {name}


def test_every_noun_has_its_place_in_the_order() -> None:
    folders = {path.name for path in CONSOLE.iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert folders - SHARED == set(NOUNS)


def _pairs() -> Iterator[tuple[str, str]]:
    """Yield each module of the console with each other one that it imports."""
    return ((name, one) for name in MODULES for one in sorted(_used(name)))


def test_no_role_uses_one_above_it() -> None:
    assert [pair for pair in _pairs() if RANKS[_role(pair[1])] > RANKS[_role(pair[0])]] == []
    assert [pair for pair in _pairs() if {_role(one) for one in pair} == {"pages", "routes"}] == []


def test_services_use_services_of_nouns_before_theirs_alone() -> None:
    services = [pair for pair in _pairs() if all(_is_of_noun(one) and _role(one) == "service" for one in pair)]
    places = [tuple(NOUNS.index(one.split(".", maxsplit=1)[0]) for one in pair) for pair in services]
    assert [pair for pair, (user, used) in zip(services, places, strict=True) if used > user] == []


def test_only_queries_and_tables_speak_sql_and_only_pages_and_routes_with_their_dependencies_know_http() -> None:
    roots = {name: {one.split(".")[0] for one in _imports(path)} for name, path in MODULES.items()}
    sql = {name for name, used in roots.items() if used & {"sqlalchemy", "alembic"}}
    http = {name for name, used in roots.items() if used & {"fastapi", "starlette", "uvicorn"}}
    assert {name for name in sql if _role(name) not in {"tables", "queries"}} == set()
    assert {name for name in http if _role(name) not in {"dependencies", "routes", "pages"}} - HTTP == set()


def test_no_exception_is_kept_that_nothing_needs() -> None:
    roots = {name: {one.split(".")[0] for one in _imports(path)} for name, path in MODULES.items()}
    assert {name for name in HTTP if not roots[name] & {"fastapi", "starlette"}} == set()


def test_nothing_of_the_console_takes_a_threshold_from_the_drawings() -> None:
    """Import contracts see modules, not names: what a number means is declared in `verdicts` or below."""
    taken = [
        f"{name}: {alias.name} of {node.module}"
        for name, path in MODULES.items()
        if "boresight.figures" in path.read_text()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("boresight.figures")
        for alias in node.names
        if isinstance(getattr(import_module(node.module or ""), alias.name, None), int | float)
    ]
    assert taken == []
