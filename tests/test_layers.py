"""Who may import whom inside the console: roles in one order, nouns in one order."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

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


def _imports(path: Path) -> Iterator[str]:
    """Yield every module that a file imports, and every name that may be one."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _used(name: str) -> set[str]:
    """Return the modules of the console that one of them imports."""
    prefix = "boresight.console."
    found = {one.removeprefix(prefix) for one in _imports(MODULES[name]) if one.startswith(prefix)}
    return {one for one in found if one in MODULES and one not in NOUNS} - {name}


def test_every_noun_has_its_place_in_the_order() -> None:
    folders = {path.name for path in CONSOLE.iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert folders - SHARED == set(NOUNS)


@pytest.mark.parametrize("name", MODULES)
def test_no_role_uses_one_above_it(name: str) -> None:
    assert {one for one in _used(name) if RANKS[_role(one)] > RANKS[_role(name)]} == set()
    assert {one for one in _used(name) if {_role(one), _role(name)} == {"pages", "routes"}} == set()


@pytest.mark.parametrize("name", [name for name in MODULES if _is_of_noun(name) and _role(name) == "service"])
def test_services_use_services_of_nouns_before_theirs_alone(name: str) -> None:
    place = NOUNS.index(name.split(".", maxsplit=1)[0])
    used = {one for one in _used(name) if _is_of_noun(one) and _role(one) == "service"}
    later = {one for one in used if NOUNS.index(one.split(".")[0]) > place}
    assert later == set()


@pytest.mark.parametrize("name", MODULES)
def test_only_queries_and_tables_speak_sql_and_only_pages_and_routes_with_their_dependencies_know_http(
    name: str,
) -> None:
    roots = {one.split(".")[0] for one in _imports(MODULES[name])}
    assert _role(name) in {"tables", "queries"} or not roots & {"sqlalchemy", "alembic"}
    assert (
        _role(name) in {"dependencies", "routes", "pages"}
        or name in HTTP
        or not roots & {"fastapi", "starlette", "uvicorn"}
    )


def test_no_exception_is_kept_that_nothing_needs() -> None:
    roots = {name: {one.split(".")[0] for one in _imports(path)} for name, path in MODULES.items()}
    assert {name for name in HTTP if not roots[name] & {"fastapi", "starlette"}} == set()


def test_nothing_of_the_console_takes_a_threshold_from_the_drawings() -> None:
    """Import contracts see modules, not names: what a number means is declared in `verdicts` or below."""
    taken = [
        f"{name}: {alias.name} of {node.module}"
        for name, path in MODULES.items()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("boresight.figures")
        for alias in node.names
        if isinstance(getattr(import_module(node.module or ""), alias.name, None), int | float)
    ]
    assert taken == []
