"""Output of the command line: results in columns or files, refusals, and progress on standard error."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import click
import orjson

from boresight.disks import storage_error
from boresight.errors import BoresightError, RefusedInputError
from boresight.waiting import telling

json_option = click.option(
    "--json", "json_file", metavar="FILE", help="Write the machine-readable result to FILE; - is standard output."
)


#: The name that stands for standard output; a file of that name is written as `./-`.
STANDARD_OUTPUT = "-"
#: What a file of this ending is taken for, by people and by programs.
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


def check_writable(place: str | Path | None, form: str = "JSON") -> None:
    """Refuse a file that could not be written, or whose name promises another format, before the work begins."""
    if place is None or str(place) == STANDARD_OUTPUT:
        return
    path = Path(place)
    if path.is_dir():
        raise RefusedInputError(f"{path} is a folder: name the file to write in it.")
    if not path.absolute().parent.is_dir():
        raise RefusedInputError(f"The folder {path.parent} does not exist: make it first, or choose another place.")
    promised = FORMATS.get(path.suffix.lower(), form)
    if promised != form:
        own = " or ".join(ending for ending, name in FORMATS.items() if name == form)
        raise RefusedInputError(
            f"{path.name} is named as {promised}, and {form or 'bytes of no such format'} is written: "
            f"{f'end the name with {own}' if own else 'choose another name'}."
        )


def refuse_standard_output(place: str | Path, what: str) -> None:
    """Refuse `-` where no stream can hold what is written; `what` says what it is."""
    if str(place) == STANDARD_OUTPUT:
        raise RefusedInputError(
            f"{what} cannot go to standard output: name a place for it (./- where it is to be called so)."
        )


def check_one_stream(*places: str | Path | None) -> None:
    """Refuse to write two results to standard output, where nobody could tell them apart."""
    if sum(str(place) == STANDARD_OUTPUT for place in places) > 1:
        raise RefusedInputError("Two results cannot share standard output: name a file for one of them.")


def write_json(document: Any, json_file: str | None) -> None:
    """Write a document where `--json` says; nothing without it."""
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
    """Say something about a result, on standard error where standard output is the result itself."""
    click.echo(text, err=str(place) == STANDARD_OUTPUT)


def aligned(rows: Iterable[Sequence[str]], left: Iterable[int] = (0,)) -> str:
    """Lay rows out in columns two spaces apart, numbers to the right, the columns of `left` to the left."""
    table = [[str(cell) for cell in row] for row in rows]
    widths = [max(len(cell) for cell in column) for column in zip(*table, strict=True)]
    sides = [str.ljust if i in set(left) else str.rjust for i in range(len(widths))]
    return "\n".join(
        "  ".join(side(cell, width) for side, cell, width in zip(sides, row, widths, strict=True)).rstrip()
        for row in table
    )


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
        except KeyboardInterrupt:
            click.echo("boresight: stopped.", err=True)
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
                f"unexpected {type(error).__name__}: {error}. Run it again as `boresight --debug ...` to see where."
            )
            click.echo(f"boresight: {sentence}", err=True)
            ctx.exit(REFUSED)


def _print_refusal(error: BoresightError) -> None:
    """Print the sentence, then the places it speaks of."""
    click.echo(f"boresight: {error}", err=True)
    faults = error.faults if isinstance(error, RefusedInputError) else ()
    if len(faults) == 1:  # the sentence has said it
        return
    for fault in faults[:FAULTS_SHOWN]:
        click.echo(f"  {fault}", err=True)
    if len(faults) > FAULTS_SHOWN:
        click.echo(f"  and {len(faults) - FAULTS_SHOWN} more.", err=True)


PATIENCE_S = 1.0


class Progress:
    """A bar or a line; call it with a message, and with a fraction where one is known."""

    def __init__(self, message: str) -> None:
        self._message = message
        self._bar = _Bar(message) if sys.stderr.isatty() else None
        self._timer = threading.Timer(PATIENCE_S, self._speak)
        self._timer.daemon = True
        self._timer.start()

    def __call__(self, message: str, fraction: float | None = None) -> None:
        """Say what is being done, and how much of it is done (0 to 1)."""
        self._message = message
        if self._bar is not None:
            self._bar.update(message, fraction)

    def _speak(self) -> None:
        if self._bar is not None:
            self._bar.start()
        else:
            click.echo(f"boresight: {self._message} ...", err=True)

    def close(self) -> None:
        """Take the bar away."""
        self._timer.cancel()
        if self._bar is not None:
            self._bar.stop()


class _Bar:
    """The bar itself; loads its library only in a terminal."""

    def __init__(self, message: str) -> None:
        from rich import progress as rich
        from rich.console import Console

        columns = (
            rich.SpinnerColumn(),
            rich.TextColumn("{task.description}", markup=False),
            rich.BarColumn(),
            rich.TaskProgressColumn(),
            rich.TimeElapsedColumn(),
        )
        self._progress = rich.Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task(message, total=None)

    def start(self) -> None:
        self._progress.start()

    def update(self, message: str, fraction: float | None) -> None:
        self._progress.update(self._task, description=message, completed=fraction or 0.0)
        if fraction is not None:
            self._progress.update(self._task, total=1.0)

    def stop(self) -> None:
        self._progress.stop()


@contextmanager
def progress(message: str) -> Iterator[Progress]:
    """Show progress while the block runs."""
    shown = Progress(message)
    try:
        with telling(shown):
            yield shown
    finally:
        shown.close()
