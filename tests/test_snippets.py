"""Every command and example of the documentation: each is one that there is, and what can run is run, as a reader would.

A page's blocks run in their order in a folder of the page's own: `sh` by a shell, or in this process where a line is nothing but
a command of ours, and `python` in one namespace. Blocks of other kinds (`console`, `json`, `yaml`, `text`) are only shown; of the
commands in them names and options are checked. `docs/deployment.md` and `docs/library.md` are run by tests of their own.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from boresight.cli import main
from tests.stores import environment_in

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md"))
}
BLOCK = re.compile(r"^( *)```([a-z]*)([^\n]*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
RUN = ("docs/tutorials/", "docs/how-to/", "docs/explanation/")
#: Pages that run in a few seconds; the others under --full.
QUICK = ("docs/explanation/errata.md", "docs/how-to/first-sensor.md", "docs/how-to/map-my-telemetry.md")
#: What a shell would make something else of.
SHELL = re.compile(r"[|<>&;$*`()]|^\s*(?:export|cat|head|python|mkdir|cp|END)\b", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page: its language, its text, and the line at which it stands."""

    language: str
    text: str
    line: int


def blocks(text: str) -> Iterator[Block]:
    for found in BLOCK.finditer(text):
        inner = re.sub(rf"^{found[1]}", "", found[4], flags=re.MULTILINE)
        yield Block(found[2], inner, text[: found.start()].count("\n") + 1)


def commands(text: str) -> Iterator[list[str]]:
    """The commands of ours in a page's blocks, as words."""
    for block in blocks(text):
        if block.language in {"", "sh", "bash", "console"}:
            joined = re.sub(r"\$\(.*?\)", "…", block.text.replace("\\\n", " "))
            for line in joined.splitlines():
                for part in re.split(r" [|] |; |&& ", line.removeprefix("$ ")):
                    if re.match(r"boresight [a-z]", part):
                        yield shlex.split(re.split(r" <+ ?| >", part)[0], comments=True)


def _is_complete(group: click.Group, rest: list[str]) -> bool:
    """Whether a group is a command by itself, and these are its options."""
    return group.invoke_without_command and rest[:1] != [] and rest[0].startswith("--")


COMMANDS = [(name, words) for name, text in PAGES.items() for words in commands(text)]
INLINE = [(name, found) for name, text in PAGES.items() for found in re.findall(r"`(boresight [a-z][^`\n]*)`", text)]


@pytest.mark.parametrize(("page", "words"), COMMANDS, ids=lambda one: one if isinstance(one, str) else " ".join(one))
def test_every_command_of_a_page_is_one_with_options_that_there_are(page, words, monkeypatch, tmp_path):
    assert page in PAGES
    command, rest = main, ["table.csv" if word == "-" else word for word in words[1:]]  # nobody types at a test
    while isinstance(command, click.Group) and not _is_complete(command, rest):
        command, rest = command.commands[rest[0]], rest[1:]
    for one in command.params:
        if isinstance(one.type, click.Path):
            monkeypatch.setattr(one.type, "exists", False)  # the page's files
    monkeypatch.chdir(tmp_path)
    command.make_context(" ".join(words), list(rest))  # refuses an unknown option, or a value that it cannot take


@pytest.mark.parametrize(("page", "text"), INLINE, ids=str)
def test_every_command_within_a_sentence_names_a_command_and_options_that_there_are(page, text):
    assert page in PAGES
    command, rest = main, text.replace("\\|", "|").split()[1:]
    while isinstance(command, click.Group) and rest and not _is_complete(command, rest):
        name, *rest = rest
        if "|" in name or name.isupper() or name == "...":
            return
        command = command.commands[name]
    known = {name for one in command.params for name in (*one.opts, *one.secondary_opts)} | {
        "--help",
        "--version",
        "--debug",
    }
    assert [word for word in rest if word.startswith("--") and word.split("=")[0] not in known] == []


def test_there_is_something_to_check():
    assert len(COMMANDS) > 40
    assert len(INLINE) > 60


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder to work in, with a data folder of its own."""
    monkeypatch.chdir(tmp_path)
    environment = {
        "BORESIGHT_DATA_FOLDER": str(tmp_path / "data"), "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", ""),
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", **environment_in(tmp_path / "data"),
    }  # fmt: skip
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    return tmp_path


def _run_shell(block: Block) -> None:
    """Run a block: plain commands of ours in this process, which has them loaded, and everything else by a shell."""
    if SHELL.search(block.text):
        done = subprocess.run(["bash", "-ec", block.text], capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"line {block.line}: {done.stderr[-2000:]}"
        return
    for line in block.text.replace("\\\n", " ").splitlines():
        if line.strip():
            done = CliRunner().invoke(main, shlex.split(line)[1:], catch_exceptions=False)
            assert done.exit_code == 0, f"line {block.line}: {line}\n{done.stderr}"


RUNNABLE = [
    pytest.param(name, marks=() if name in QUICK else pytest.mark.full)
    for name, text in PAGES.items()
    if name.startswith(RUN) and any(block.language in {"sh", "python"} for block in blocks(text))
]


@pytest.mark.parametrize("page", RUNNABLE)
@pytest.mark.usefixtures("folder")
def test_a_page_runs_from_top_to_bottom(page):
    if "BORESIGHT_DATA_FOLDER=.demo" in PAGES[page]:  # of a demonstration that its reader has running
        _run_shell(Block("sh", "export BORESIGHT_DATA_FOLDER=.demo; boresight migrate", 0))
    names: dict[str, object] = {"__name__": "page"}
    exports = ""
    for block in blocks(PAGES[page]):
        if block.language == "sh":
            _run_shell(Block("sh", exports + block.text, block.line))
            exports += "".join(f"{line}\n" for line in block.text.splitlines() if line.startswith("export "))
        elif block.language == "python":
            exec(compile(block.text, f"{page}, line {block.line}", "exec"), names)  # noqa: S102 - they are ours
