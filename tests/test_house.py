"""The house rules that no linter knows: files say what they are, nothing leaks, decisions can be quoted."""

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

SET_ASIDE = [line.rstrip("/") for line in (ROOT / ".gitignore").read_text().splitlines() if line and line[0] != "#"]

VAGUE_NAMES = {"utils", "util", "helpers", "helper", "common", "core", "base", "constants", "types", "misc", "models"}
SECTIONS = ["Context", "Decision", "Consequences", "Alternatives"]


def _walk(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.iterdir()):
        if path.name == ".git" or any(path.match(pattern) for pattern in SET_ASIDE):
            continue
        if path.is_dir():
            yield from _walk(path)
        else:
            yield path


@cache
def _all_files() -> tuple[Path, ...]:
    return tuple(_walk(ROOT))


def _files(*suffixes: str) -> list[Path]:
    return [path for path in _all_files() if not suffixes or path.suffix in suffixes]


@cache
def _text(path: Path) -> str:
    return path.read_text()


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _texts() -> Iterator[tuple[str, str]]:
    for path in _files():
        if path.suffix not in {".png", ".webp", ".parquet", ".npz", ".axy", ".corr", ".fits", ".xz"}:
            yield _name(path), _text(path)


def _breaking(pattern: str) -> list[str]:
    return [
        f"{name}:{number}: {line.strip()}"
        for name, text in _texts()
        for number, line in enumerate(text.splitlines(), 1)
        if re.search(pattern, line)
    ]


def _package(requirement: str) -> str:
    return re.match(r"[A-Za-z0-9-]+", requirement)[0]


def _packages() -> set[str]:
    extras = PROJECT["optional-dependencies"].values()
    return {_package(name) for group in (PROJECT["dependencies"], *extras) for name in group}


def _locked(name: str) -> dict[str, str]:
    return dict(re.findall(r"^([a-z0-9-]+)==(\S+)", (ROOT / name).read_text(), re.MULTILINE))


# Decisions can be quoted.


def _decisions() -> list[Path]:
    return sorted((ROOT / "backend" / "decisions").iterdir())


def test_decisions_are_numbered_without_gaps():
    assert [int(path.name[:4]) for path in _decisions()] == list(range(1, len(_decisions()) + 1))


def test_a_decision_has_its_number_its_sections_and_one_line_to_quote():
    for path in _decisions():
        text = path.read_text()
        quoted = text.partition("## Decision\n\n")[2].partition("\n\n## ")[0]
        assert text.startswith(f"# {int(path.name[:4])}. ")
        assert re.findall(r"^## (.*)$", text, re.MULTILINE) == SECTIONS, path
        assert re.fullmatch(r"> .{20,320}\.", quoted), path


# Files say what they are.


def test_a_module_opens_by_saying_what_it_is():
    opens = re.compile(r'(#!.*\n)?r?"""\S')
    assert [_name(path) for path in _files(".py") if not opens.match(_text(path))] == []


def test_no_module_has_a_name_that_says_nothing():
    named = [*_files(".py", ".js"), *(path for path in ROOT.glob("backend/boresight/**/") if path.is_dir())]
    assert [_name(path) for path in named if path.stem in VAGUE_NAMES] == []


def test_test_folders_mirror_the_source():
    tests, whole = ROOT / "tests", {"benchmarks", "browser", "fuzz", "transitions", "upgrade", "vectors"}
    folders = [
        path.relative_to(tests) for path in tests.glob("**/") if path != tests and "__pycache__" not in path.parts
    ]
    strange = [
        str(folder)
        for folder in folders
        if folder.parts[0] not in whole
        and folder.name != "vectors"
        and not (ROOT / "backend" / "boresight" / folder).is_dir()
    ]
    assert strange == []


def test_an_exception_from_a_rule_says_why():
    bare = re.compile(r"# noqa(?!: [A-Z]+\d+(, [A-Z]+\d+)* - \w)")
    found = [
        f"{_name(path)}:{number}"
        for path in _files(".py")
        if path != Path(__file__)
        for number, line in enumerate(_text(path).splitlines(), 1)
        if bare.search(line)
    ]
    assert found == []


# Nothing leaks.


def test_only_the_store_commits():
    committing = [
        _name(path)
        for path in _files(".py")
        if path.is_relative_to(ROOT / "backend") and ".commit" in _text(path)
        for node in ast.walk(ast.parse(_text(path)))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "commit"
    ]
    assert set(committing) == {"backend/boresight/platform/db/sessions.py"}


def test_no_path_of_one_machine_stands_in_the_project():
    assert _breaking(r"(?<![\w.])/(work|root|home)/") == []


def test_no_package_index_stands_in_the_project():
    assert _breaking(r"pypi\.org|pythonhosted\.|npmjs\.|--(extra-)?index-url|--trusted-(host)") == []


def test_the_lock_files_hold_no_address_at_all():
    assert [line for line in _breaking(r"://") if line.startswith("requirements")] == []


def test_nothing_is_left_for_later():
    assert _breaking(r"\b(TO" r"DO|FIX" r"ME|X" r"XX|HA" r"CK)\b") == []


# The lock files.


def test_every_dependency_is_locked_and_both_files_agree():
    runs, tests = _locked("requirements.lock"), _locked("requirements-dev.lock")
    assert {_package(name) for name in PROJECT["dependencies"]} <= set(runs)
    assert _packages() <= set(tests)
    assert runs.items() <= _locked("requirements-docs.lock").items() <= tests.items()


def test_what_tests_keep_beside_the_packages_is_locked_at_the_same_versions():
    beside, tests = _locked("requirements-pandas.lock"), _locked("requirements-dev.lock")
    assert "pandas" in beside
    assert "pandas" not in tests
    assert {name: beside[name] for name in beside if name != "pandas"}.items() <= tests.items()


@pytest.mark.parametrize(
    "name", ["requirements.lock", "requirements-dev.lock", "requirements-docs.lock", "requirements-pandas.lock"]
)
def test_every_locked_package_has_a_hash(name):
    entries = re.findall(r"^[a-z0-9-]+==\S+ (?:; [^\\\n]+ )?(.*)\n +(\S+)", (ROOT / name).read_text(), re.MULTILINE)
    assert len(entries) == len(_locked(name))
    assert all(rest == "\\" and hashed.startswith("--hash=sha256:") for rest, hashed in entries)


# The pages.


def test_a_page_holds_no_script_and_no_style_of_its_own():
    # One file without a server each.
    whole = {"report.html", "reproduction.html", "drawn_figures.html", "verification_sheet.html"}
    for path in (path for path in _files(".html") if path.name not in whole):
        text = re.sub(r"\{#.*?#\}", "", path.read_text(), flags=re.DOTALL)
        scripts = re.findall(r"<script\b[^>]*>", text)
        assert all(re.search(r'\bsrc=|type="application/json"', script) for script in scripts), path
        assert not re.search(r"<style\b", text), path
        assert re.findall(r"<[^>]*?\s(?:on[a-z]+|style)\s*=", text) == [], path
        assert "javascript:" not in text, path


def test_a_browser_module_is_a_module():
    forbidden = re.compile(r"\beval\(|innerHTML\s*\+?=[^=]|document\.write|\bvar ")
    assert [_name(path) for path in _files(".js") if forbidden.search(_text(path))] == []


def test_types_of_arrays_and_the_smallest_exposure_are_declared_once():
    declared = re.compile(r"^((?:Float|Int|Bool|Time)Array|MINIMUM_STARS) = ", re.MULTILINE)
    found = {_name(path): declared.findall(_text(path)) for path in _files(".py")}
    assert {name: names for name, names in found.items() if names} == {
        "backend/boresight/arrays.py": ["FloatArray", "IntArray", "BoolArray", "TimeArray"],
        "backend/boresight/estimation/__init__.py": ["MINIMUM_STARS"],
    }
