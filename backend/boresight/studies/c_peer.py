"""The C peer of `boresight bench`: the same arithmetic as the compiled loops, by gcc -O3 -march=native, on one thread.

`arclengths.c` beside this file is compiled into a folder that is thrown away when the measurement ends. Without a C compiler the
bench has no such figures; nothing else of the product needs one.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray
from boresight.estimation.arcs import ArcSet
from boresight.estimation.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation.filters import FilterHistory, Tuning
from boresight.estimation.filters.history import FilterState
from boresight.estimation.filters.square_root import padded

SOURCE = Path(__file__).with_name("arclengths.c")
COMPILERS = ("gcc", "cc", "clang")
FLAGS = ("-std=c11", "-O3", "-march=native", "-fPIC")
#: IEEE order of sums as a C programmer gets it by default, and reordered as our loops allow it.
VARIANTS = {"c": (), "c_fast_math": ("-ffast-math",)}
COMPILE_S = 60.0


@dataclass(frozen=True)
class CPeer:
    """A compiled copy of the C source."""

    library: ctypes.CDLL

    def normal_equations(
        self, arcs: ArcSet, x: FloatArray, scale: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A (8, 8), b (8,) and (chi-square, sum of squares) with all eight parameters free, as `batch.normal_equations`."""
        _refuse_other_models(arcs)
        free = np.arange(len(scale))
        A, b, costs = np.empty((len(free), len(free))), np.empty(len(free)), np.empty(2)
        self.library.normal_equations(
            _at(x), ctypes.c_double(arcs.pitch), ctypes.c_long(len(arcs.star_start) - 1), _at(arcs.star_start), _at(arcs.row_px),
            _at(arcs.col_px), _at(arcs.phi), _at(arcs.band), ctypes.c_long(len(free)), _at(free), _at(scale), _at(A), _at(b),
            _at(costs),
        )  # fmt: skip
        return A, b, costs

    def square_root_filter(self, arcs: ArcSet, state: FilterState, scale: FloatArray, tuning: Tuning) -> FilterHistory:
        """Run Carlson's filter without process noise over weighed arcs, all eight parameters free."""
        _refuse_other_models(arcs)
        n, free = arcs.n_frames, np.arange(len(scale))
        x, z, S = state.x.copy(), padded(state.z), padded(state.S)
        states, sigmas, nis, squares = np.empty((n, len(x))), np.empty((n, len(free))), np.empty(n), np.empty(n)
        self.library.square_root_filter(
            _at(x), _at(z), _at(S.T), ctypes.c_double(arcs.pitch), ctypes.c_long(n), _at(arcs.frame_start), _at(arcs.star_start),
            _at(arcs.row_px), _at(arcs.col_px), _at(arcs.phi), _at(arcs.band), ctypes.c_long(len(free)), _at(free), _at(scale),
            ctypes.c_long(tuning.linearisations), ctypes.c_double(tuning.rest), _at(states), _at(sigmas), _at(nis), _at(squares),
        )  # fmt: skip
        dof = 2 * np.diff(arcs.star_start[arcs.frame_start]) - 3 * np.diff(arcs.frame_start)
        return FilterHistory(states, sigmas, nis, dof, squares, np.zeros(n, np.int64), FilterState(x, z, S), True)


@contextmanager
def compiled() -> Iterator[dict[str, CPeer]]:
    """Compile every variant for the length of a measurement; empty where there is no C compiler that can."""
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    with tempfile.TemporaryDirectory(prefix="boresight-c-") as folder:
        yield {} if compiler is None else dict(_built(compiler, Path(folder)))


def _built(compiler: str, folder: Path) -> Iterator[tuple[str, CPeer]]:
    """Compile and load the variants that the compiler accepts."""
    for name, more in VARIANTS.items():
        target = folder / f"{name}.so"
        part = target.with_suffix(".o")
        # linked apart: gcc would link a start file with -ffast-math that lets this whole process lose its denormal numbers
        steps = [
            [compiler, *FLAGS, *more, "-c", str(SOURCE), "-o", str(part)],
            [compiler, "-shared", str(part), "-o", str(target), "-lm"],
        ]
        if all(_done(words) for words in steps):
            yield name, CPeer(ctypes.CDLL(str(target)))


def _done(words: list[str]) -> bool:
    """Run one step of the compiler; whether it could."""
    done = subprocess.run(words, capture_output=True, timeout=COMPILE_S, check=False)  # noqa: S603 - words of our own
    return done.returncode == 0


def _refuse_other_models(arcs: ArcSet) -> None:
    """Raise where the C source does not know the model."""
    if arcs.model != INVERTED_WANG.kernel:
        raise ValueError(f"Expected arcs of inverted_wang / Received model {arcs.model}")


def _at(values: NDArray[Any]) -> ctypes.c_void_p:
    """Address of a contiguous array of doubles or long integers."""
    if not values.flags.c_contiguous or values.dtype not in (np.float64, np.dtype(ctypes.c_long)):
        raise ValueError(f"Expected a contiguous array of doubles or longs / Received {values.dtype}, {values.flags}")
    return ctypes.c_void_p(values.ctypes.data)
