"""Files that a command reads; `-` is standard input, which is kept in a temporary file for as long as the command runs."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import click

from boresight.cli.output import STANDARD_OUTPUT
from boresight.errors import RefusedInputError

#: What refusals call it; without a suffix its bytes say what it is.
NAME = "standard-input"
_TAKEN = "boresight.standard-input"


class InputFile(click.Path):
    """A path to read from, or `-`."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; standard input's is a copy of it."""
        return keep_standard_input(ctx) if str(value) == STANDARD_OUTPUT else super().convert(value, param, ctx)


INPUT_FILE = InputFile()


def keep_standard_input(ctx: click.Context | None) -> Path:
    """Copy standard input to a file that is removed with the command.

    Raises RefusedInputError when another argument has taken it, it is a terminal, where nobody would type a table, or it is empty.
    """
    ctx = ctx or click.get_current_context()
    if ctx.meta.get(_TAKEN):
        raise RefusedInputError("Two files cannot both come from standard input: name a file for one of them.")
    ctx.meta[_TAKEN] = True
    if sys.stdin is None or sys.stdin.isatty():
        raise RefusedInputError("Standard input is a terminal: pipe a file into the command, or name one instead of -.")
    folder = tempfile.TemporaryDirectory(prefix="boresight-")
    ctx.find_root().call_on_close(folder.cleanup)  # the command's own is not closed when another argument is refused
    path = Path(folder.name) / NAME
    with path.open("wb") as file:
        shutil.copyfileobj(sys.stdin.buffer, file)
    if not path.stat().st_size:
        raise RefusedInputError("Standard input is empty: check whether the program before the pipe wrote anything.")
    return path
