"""Arrays in one file, back to back, mapped into memory when they are asked for."""

from __future__ import annotations

import hashlib
import mmap
import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight import disks as integrity
from boresight.errors import CorruptFileError

#: Every array begins at a multiple of this, for the processor's widest loads.
ALIGNMENT = 64


@dataclass(frozen=True)
class Column:
    """Where an array is in its file: name, type as NumPy writes it, shape, first byte."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    offset: int


@dataclass(frozen=True)
class Columns:
    """Arrays in a file."""

    path: str
    layout: tuple[Column, ...]
    sha256: str

    def read(self) -> dict[str, NDArray[Any]]:
        """Map the file; what is written into the arrays stays with this process (the compiled loops take writable ones)."""
        if not integrity.is_intact(Path(self.path), self.sha256):
            raise CorruptFileError(
                f"The working copy {Path(self.path).name} was altered on the disk while the run computed, so it is not used"
                ": check the disk of the data folder, and launch the run again.",
                code="altered-working-copy",
            )
        with Path(self.path).open("rb") as file:
            if not os.fstat(file.fileno()).st_size:
                return {column.name: np.empty(column.shape, column.dtype) for column in self.layout}
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
        return {column.name: _array(mapped, column) for column in self.layout}


def _array(mapped: mmap.mmap, column: Column) -> NDArray[Any]:
    count = int(np.prod(column.shape, dtype=np.int64))
    return np.frombuffer(mapped, column.dtype, count, column.offset).reshape(column.shape)


def write_columns(path: Path, arrays: Mapping[str, NDArray[Any]]) -> Columns:
    """Write arrays under a temporary name and rename: whoever finds the file finds all of it, however often it is written."""
    layout: list[Column] = []
    digest, offset = hashlib.sha256(), 0
    unfinished = path.with_name(f"{path.name}.{secrets.token_hex(8)}")
    with unfinished.open("wb") as file:
        for name, values in arrays.items():
            padding = bytes(-offset % ALIGNMENT)
            content = (
                np.ascontiguousarray(values).tobytes()
                if values.dtype.kind == "M"
                else np.ascontiguousarray(values).data
            )
            for part in (padding, content):
                digest.update(part)
                file.write(part)
            layout.append(Column(name, values.dtype.str, values.shape, offset + len(padding)))
            offset += len(padding) + values.nbytes
    unfinished.replace(path)
    return Columns(str(path), tuple(layout), digest.hexdigest())
