"""Files compressed by gzip, told by their first bytes whatever they are called: expanded up to a budget and no farther."""

from __future__ import annotations

import gzip
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePath

from boresight.errors import RefusedInputError
from boresight.telemetry.read.limits import Limits

MAGIC = b"\x1f\x8b"
SUFFIX = ".gz"
_PIECE_BYTES = 1 << 20
#: What zlib calls a window of 32 kB with gzip's header.
_GZIP_BITS = 31


def is_gzip(path: Path) -> bool:
    """Whether a file is there and is compressed by gzip."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def name_inside(name: str) -> PurePath:
    """What a compressed file is called without the suffix that says so; another name as it is."""
    plain = PurePath(name)
    return plain.with_suffix("") if plain.suffix.lower() == SUFFIX else plain


def expanded_bytes(path: Path) -> int:
    """How many bytes a file has when expanded, as its last four say of gzip: a guess, for nothing holds them to it."""
    size = path.stat().st_size
    if not is_gzip(path) or size < len(MAGIC) + 4:
        return size
    with path.open("rb") as file:
        file.seek(-4, 2)
        return max(size, int.from_bytes(file.read(4), "little"))


def first_bytes(path: Path, count: int) -> bytes:
    """Return the first bytes of what is in a file, fewer where it is damaged."""
    if not is_gzip(path):
        with path.open("rb") as file:
            return file.read(count)
    with path.open("rb") as file, suppress(zlib.error):
        return zlib.decompressobj(_GZIP_BITS).decompress(file.read(4 * count), count)
    return b""


@contextmanager
def expanded(path: Path, name: str, limits: Limits) -> Iterator[Path]:
    """Where a file is as it was before gzip, in a folder that is removed afterwards; any other file where it is.

    Raises
    ------
    RefusedInputError
        When it is damaged, or is more than the limits allow.
    """
    if not is_gzip(path):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="boresight-") as folder:
        place = Path(folder) / "expanded"
        _expand(path, place, name, limits.expanded(path.stat().st_size))
        yield place


def _expand(path: Path, place: Path, name: str, most: int) -> None:
    left = most
    try:
        with gzip.open(path) as packed, place.open("wb") as file:
            while piece := packed.read(_PIECE_BYTES):
                if left == most and piece.startswith(MAGIC):
                    raise RefusedInputError(
                        f"{name} is compressed by gzip twice: unpack it once, and give the file inside."
                    )
                left -= len(piece)
                if left < 0:
                    raise RefusedInputError(
                        f"{name} expands to over {most / 1e6:,.0f} MB, more than a table of its size has: unpack it, and give "
                        "the file inside.",
                        code="expands-too-far",
                    )
                file.write(piece)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise RefusedInputError(f"{name} is damaged gzip ({error}): copy it again.") from error
