"""The security page holds every section of the standard against the product, and names tests that exist."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "security.md").read_text()
NAMED = sorted(set(re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", PAGE)))
ROWS = re.findall(r"^\| V(\d+)\.(\d+) [^|]*\| (pass|fail|not applicable) \| ([^|]+) \| ([^|]*) \|$", PAGE, re.MULTILINE)
#: How many sections each chapter of ASVS 4.0.3 has, and those without a requirement at levels 1 and 2.
SECTIONS = {1: 14, 2: 10, 3: 7, 4: 3, 5: 5, 6: 4, 7: 4, 8: 3, 9: 2, 10: 3, 11: 1, 12: 6, 13: 4, 14: 5}
WITHOUT = {(1, 3), (1, 13), (3, 6), (10, 1)}


@cache
def _find_tests(name: str) -> frozenset[str]:
    tree = ast.parse((ROOT / name).read_text())
    return frozenset(node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


@pytest.mark.parametrize(("file", "name"), NAMED, ids=[name for _, name in NAMED])
def test_a_test_that_the_page_names_exists(file: str, name: str) -> None:
    assert name in _find_tests(file)


def test_the_page_judges_every_section_of_the_standard_once() -> None:
    expected = [
        (chapter, section)
        for chapter, sections in SECTIONS.items()
        for section in range(1, sections + 1)
        if (chapter, section) not in WITHOUT
    ]
    assert [(int(chapter), int(section)) for chapter, section, *_ in ROWS] == expected


def test_a_section_that_fails_names_the_requirement_that_is_not_met() -> None:
    failing = [reason for _, _, verdict, reason, _ in ROWS if verdict == "fail"]
    assert failing
    assert all(re.search(r"Not met[^(]*\([^)]*\d+\.\d+\.\d+", reason) for reason in failing)


def test_the_page_names_tests_for_most_sections() -> None:
    assert len(NAMED) > 30
