"""The text of a large file in pieces of whole rows, so that it never is in memory at once.

A piece is UTF-8 with plain line ends and without the last of them: n line ends are n + 1 rows. The byte-order mark and the
blank lines that close the file are left out. What is read does not depend on where the pieces are cut: a row that is longer than
a line may be (`Limits`) is refused wherever it stands.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from boresight.errors import RefusedInputError
from boresight.telemetry.read.formats import BYTE_ORDER_MARK, end_of_last_row, refuse_other_encodings
from boresight.telemetry.read.limits import LIMITS, Limits

#: Read at a time; some hundred thousand rows.
PIECE_BYTES = 8_000_000


def text_pieces(path: Path, name: str, limits: Limits = LIMITS) -> Iterator[bytes]:
    """Yield the rows of a text file, some hundred thousand at a time."""
    row, waiting = 1, b""
    for block, is_last in _blocks(path):
        waiting += block
        _refuse_long_rows(name, row, waiting, limits)
        whole = waiting if is_last else waiting[: waiting.rfind(b"\n") + 1]
        if not whole.isascii():
            refuse_other_encodings(name, whole, row)
        end = end_of_last_row(whole)
        if not whole[:end].strip():
            _refuse_endless(name, row, waiting, is_last=is_last)
            continue
        yield whole[:end]
        row += whole.count(b"\n", 0, end) + 1
        waiting = waiting[end + 1 :]


def _refuse_long_rows(name: str, first_row: int, text: bytes, limits: Limits) -> None:
    """Refuse a row that is longer than may be, also one that goes on after this text."""
    begins = 0
    while len(text) - begins > limits.line_bytes:
        end = text.rfind(b"\n", begins, begins + limits.line_bytes + 1)
        if end < 0:
            row = first_row + text.count(b"\n", 0, begins)
            raise RefusedInputError(
                f"{name}: row {row}: is over {limits.line_bytes:,} bytes long: write one star a row, of at most {limits.columns:,} "
                "columns."
            )
        begins = end + 1


def _refuse_endless(name: str, row: int, waiting: bytes, *, is_last: bool) -> None:
    """Refuse what fills a piece and still holds no whole row."""
    if len(waiting) > PIECE_BYTES and not is_last:
        raise RefusedInputError(
            f"{name}: row {row}: blank rows follow for over {PIECE_BYTES:,} bytes: write one star a row."
        )


def _blocks(path: Path) -> Iterator[tuple[bytes, bool]]:
    """Yield the bytes of a file with plain line ends, without byte-order mark, and whether they are the last."""
    with path.open("rb") as file:
        if file.read(len(BYTE_ORDER_MARK)) != BYTE_ORDER_MARK:
            file.seek(0)
        block, half_line_end = file.read(PIECE_BYTES), b""
        while block:
            following = file.read(PIECE_BYTES)
            text = half_line_end + block
            half_line_end = b"\r" if following and text.endswith(b"\r") else b""
            text = text[: len(text) - len(half_line_end)]
            if b"\r" in text:
                text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
            yield text, not following
            block = following
