"""Output of the command line: results in files or on standard output, and refusals."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import click
import orjson

from boresight.disks import storage_error
from boresight.errors import BoresightError, RefusedInputError

json_option = click.option(
    "--json", "json_file", metavar="FILE", help="Write the machine-readable result to FILE; - is standard output."
)


#: The name that stands for standard output; a file of that name is written as `./-`.
STANDARD_OUTPUT = "-"
#: What people and programs expect in a file with this suffix.
FORMATS = {
    ".csv": "CSV",
    ".docx": "Word",
    ".fit": "FITS",
    ".fits": "FITS",
    ".gz": "gzip",
    ".h5": "HDF5",
    ".htm": "HTML",
    ".html": "HTML",
    ".jpeg": "JPEG",
    ".jpg": "JPEG",
    ".json": "JSON",
    ".jsonl": "JSON Lines",
    ".md": "Markdown",
    ".ndjson": "JSON Lines",
    ".npy": "NumPy",
    ".npz": "NumPy",
    ".parquet": "Parquet",
    ".pdf": "PDF",
    ".png": "PNG",
    ".svg": "SVG",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".tsv": "TSV",
    ".xls": "Excel",
    ".xlsx": "Excel",
    ".xml": "XML",
    ".yaml": "YAML",
    ".yml": "YAML",
    ".zip": "ZIP",
}


def check_writable(
    place: str | Path | None, form: str = "JSON", *, forms: tuple[str, ...] = (), title: str | None = None
) -> None:
    """Refuse, before the work begins, a file that cannot be written or whose suffix means another format.

    `form`: what is written, as `FORMATS` calls it. `forms`: endings that the name must have one of, where the format is none of
    those; `title` is what it is called then.
    """
    if place is None or str(place) == STANDARD_OUTPUT:
        return
    path = Path(place)
    if path.is_dir():
        raise RefusedInputError(f"{path} is a folder: name the file to write in it.")
    if not path.absolute().parent.is_dir():
        raise RefusedInputError(
            f"The folder {path.parent} does not exist: make it first, or choose another place.", code="no-such-folder"
        )
    ending = path.suffix.lower()
    if forms and ending not in forms:
        raise RefusedInputError(
            f"The extension of {path.name} does not fit {title}: end the name with {' or '.join(forms)}."
        )
    promised = FORMATS.get(ending, form)
    if not forms and promised != form:
        own = " or ".join(ending for ending, name in FORMATS.items() if name == form)
        raise RefusedInputError(
            f"The extension of {path.name} means {promised}, but {form or 'another format'} is written: "
            f"{f'use the extension {own}' if own else 'choose another name'}."
        )


def refuse_standard_output(place: str | Path, what: str) -> None:
    """Refuse `-` where the result cannot go to a stream; `what` describes the result."""
    if str(place) == STANDARD_OUTPUT:
        raise RefusedInputError(f"{what} cannot go to standard output: name a file for it (./- for a file named -).")


def check_one_stream(*places: str | Path | None) -> None:
    """Refuse to write two results to standard output."""
    if sum(str(place) == STANDARD_OUTPUT for place in places) > 1:
        raise RefusedInputError("Two results cannot share standard output: name a file for one of them.")


def write_json(document: Any, json_file: str | None) -> None:
    """Write a document to the file of `--json`, if given."""
    if json_file is not None:
        write_bytes(orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE), json_file)


def write_bytes(content: bytes, place: str | Path) -> None:
    """Write a result to a file or, where the place is `-`, to standard output."""
    with opened_for_writing(place) as stream:
        stream.write(content)


@contextmanager
def opened_for_writing(place: str | Path) -> Iterator[IO[bytes]]:
    """Open a file or, where the place is `-`, standard output."""
    if str(place) == STANDARD_OUTPUT:
        sys.stdout.flush()
        yield sys.stdout.buffer
        sys.stdout.buffer.flush()
        return
    try:
        with Path(place).open("wb") as file:
            yield file
    except OSError as error:
        raise RefusedInputError(f"{place} cannot be written: {error.strerror}; choose another place.") from error


def tell(text: str, place: str | Path) -> None:
    """Print a message about a result, to standard error where standard output is the result itself."""
    click.echo(text, err=str(place) == STANDARD_OUTPUT)


FAULTS_SHOWN = 10
REFUSED, INTERRUPTED = 1, 130


class RefusingGroup(click.Group):
    """A command group that turns errors into lines and exit codes."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; a refusal becomes exit code 1, Ctrl-C 130."""
        try:
            return super().invoke(ctx)
        except BoresightError as error:
            _print_refusal(error)
            ctx.exit(REFUSED)
        except KeyboardInterrupt as stop:
            click.echo("boresight: stopped.", err=True)
            _print_notes(stop)
            ctx.exit(INTERRUPTED)
        except (click.ClickException, click.exceptions.Exit, click.Abort, BrokenPipeError):
            raise
        except Exception as error:
            of_disk = storage_error(error) if isinstance(error, OSError) else None
            if of_disk is not None:
                _print_refusal(of_disk)
                ctx.exit(REFUSED)
            if ctx.params.get("debug"):
                raise
            sentence = (
                f"Unexpected {type(error).__name__}: {error}. Run the command again with `boresight --debug ...` to see the "
                "traceback."
            )
            click.echo(f"boresight: {sentence}", err=True)
            ctx.exit(REFUSED)


def _print_notes(error: BaseException) -> None:
    """Print what goes on in spite of it."""
    for note in getattr(error, "__notes__", ()):
        click.echo(f"  {note}", err=True)


def _print_refusal(error: BoresightError) -> None:
    """Print the sentence, then the places it speaks of."""
    click.echo(f"boresight: {error}", err=True)
    _print_notes(error)
    faults = error.faults if isinstance(error, RefusedInputError) else ()
    if len(faults) == 1:  # the sentence contains it already
        return
    for fault in faults[:FAULTS_SHOWN]:
        click.echo(f"  {fault}", err=True)
    if len(faults) > FAULTS_SHOWN:
        click.echo(f"  and {len(faults) - FAULTS_SHOWN} more.", err=True)
