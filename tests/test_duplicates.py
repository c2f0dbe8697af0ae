"""One fact is declared once: no function and no constant of the product stands there twice."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1] / "backend/boresight"
#: Shorter ones are alike by chance.
FEWEST_LETTERS = 60
#: It verifies a log outside of Boresight, and so imports nothing of it.
ALONE = "platform/audit/audit_verifier.py"


def find_repeated(describe):
    found = defaultdict(list)
    for path in sorted(ROOT.rglob("*.py")):
        name = str(path.relative_to(ROOT))
        for node in ast.parse(path.read_bytes()).body if name != ALONE else ():
            if (text := describe(node)) is not None and len(text) >= FEWEST_LETTERS:
                found[text].append(f"{name}:{node.lineno}")
    return [places for places in found.values() if len(places) > 1]


def describe_function(node):
    """A function but for its name and docstring."""
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return None
    body = node.body[1:] if ast.get_docstring(node) is not None else node.body
    return f"{ast.unparse(node.args)}: " + "\n".join(map(ast.unparse, body)) if body else None


def describe_constant(node):
    """The value of a constant but for its name."""
    is_literal = isinstance(node, ast.Assign) and isinstance(node.value, ast.Dict | ast.Tuple | ast.List)
    return ast.unparse(node.value) if is_literal else None


def describe_class(node):
    """The members of a class but for its name, bases, decorators and docstring."""
    if not isinstance(node, ast.ClassDef):
        return None
    body = node.body[1:] if ast.get_docstring(node) is not None else node.body
    return "\n".join(map(ast.unparse, body)) if len(body) > 1 else None


def test_no_function_is_written_twice():
    assert find_repeated(describe_function) == []


def test_no_constant_is_written_twice():
    assert find_repeated(describe_constant) == []


def test_no_class_is_written_twice():
    assert find_repeated(describe_class) == []
