"""Results: aligned columns for people on standard output, JSON for machines in a file or, with `-`, on standard output."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import click
import orjson

from boresight.errors import RefusedInputError

json_option = click.option(
    "--json", "json_file", metavar="FILE", help="Write the machine-readable result to FILE; - is standard output."
)


def check_writable(json_file: str | None) -> None:
    """Refuse a file that could not be written, before the work begins.

    Raises
    ------
    RefusedInputError
        When its folder does not exist, or it is a folder itself.
    """
    if json_file in (None, "-"):
        return
    path = Path(str(json_file))
    if path.is_dir():
        raise RefusedInputError(f"{path} is a folder: name the file to write in it.")
    if not path.absolute().parent.is_dir():
        raise RefusedInputError(f"The folder {path.parent} does not exist: make it first, or choose another place.")


def write_json(document: Any, json_file: str | None) -> None:
    """Write a document where `--json` says; nothing without it.

    Raises
    ------
    RefusedInputError
        When the file cannot be written.
    """
    if json_file is None:
        return
    data = orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)
    if json_file == "-":
        click.echo(data, nl=False)
        return
    try:
        Path(json_file).write_bytes(data)
    except OSError as error:
        raise RefusedInputError(f"{json_file} cannot be written: {error.strerror}; choose another place.") from error


def aligned(rows: Iterable[Sequence[str]], left: Iterable[int] = (0,)) -> str:
    """Lay rows out in columns two spaces apart, numbers to the right, the columns of `left` to the left."""
    table = [[str(cell) for cell in row] for row in rows]
    widths = [max(len(cell) for cell in column) for column in zip(*table, strict=True)]
    sides = [str.ljust if i in set(left) else str.rjust for i in range(len(widths))]
    return "\n".join(
        "  ".join(side(cell, width) for side, cell, width in zip(sides, row, widths, strict=True)).rstrip()
        for row in table
    )
