"""How the loops are compiled, where what was compiled is kept, and who compiles what is not there yet.

**The folder.** Numba keeps a compiled loop as long as the loop's own file is the same. Loops call what other files define, cameras
above all, and would run old code after a change there. So each state of all these sources has a folder of its own, below the one
that Numba was told; others are removed a month after they were last used.

**Loops and parts.** A `loop` is called from Python and kept in the folder. What loops call are `part`s: plain functions, compiled
into each loop that calls them and nowhere else. A part counts no references and asks for no memory (a fifth of the code, and a
third of the time that it takes to compile), so it copies numbers and never assigns one array to a slice of another.

**Who compiles.** A loop that is not in the folder is compiled by two processes of our own, `boresight.kernels.workshop`, together
with all loops that a first calibration needs; then it is loaded like any other. One process at a time does so, for all users of the
folder: command, library, workers, server. No process runs code that it compiled itself, so results do not depend on who was first.

**Signatures.** A loop names the types of its arguments, so that it can be compiled before it is called: `f i b` for a number, a
whole number and a truth, `f2` for an array of numbers with two dimensions in C order, `f2F` in Fortran's, `camera` for the state of
a camera, and (class, types ...) for a tuple, named or not.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
from numba.core import types
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys
from numba.extending import register_jitable

#: Reordering of sums and fused products are allowed; NaN and infinity keep their meaning. A sum that may be reordered is taken in
#: as many parts as the processor's vectors have places, so machines with other vectors differ in the last digits: chi-square of 200
#: frames by 4e-16 of it, compiled for 512 bits and for 256, and an innovation by 4e-13. Without `reassoc` both have the same bits,
#: but an evaluation takes 1.24 times as long and the filter 1.07 times. One machine has the same bits in whichever order loops are
#: compiled.
FAST = {"contract", "reassoc", "arcp", "nsz", "afn"}
UNUSED_S = 30 * 86_400.0

#: Of parts: no references are counted, and nothing makes them callable from outside.
PART = {"error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True, "forceinline": False}
_SCALARS = {"f": types.float64, "i": types.int64, "b": types.boolean}

#: Whether this process compiles what is missing: it was started for that.
compiles_itself = False


@dataclass(frozen=True)
class Loop:
    """A loop as it is declared: what compiles it, the types of its arguments, and whether a first calibration needs it."""

    dispatcher: Any
    arguments: tuple[Any, ...]
    first: bool

    def is_kept(self, signature: tuple[Any, ...]) -> bool:
        """Whether it is compiled for these types; never where no folder can be written."""
        kept = self.dispatcher._cache  # noqa: SLF001 - Numba shows it nowhere else
        return isinstance(kept, _Kept) and kept.has(signature)

    @property
    def takes_camera(self) -> bool:
        """Whether it is compiled for each camera."""
        return "camera" in self.arguments[0].split()

    def find_camera(self, signature: Sequence[Any]) -> Any:
        """Return the camera's state type in a signature; None where it has none."""
        return signature[self.arguments[0].split().index("camera")] if self.takes_camera else None

    def signature(self, camera: Any) -> tuple[Any, ...]:
        """Return the Numba types of its arguments for a camera's state type."""
        return tuple(_types(self.arguments, camera))


#: Every loop by module and name.
LOOPS: dict[tuple[str, str], Loop] = {}


def _types(arguments: tuple[Any, ...], camera: Any) -> Iterator[Any]:
    for said in arguments:
        if isinstance(said, str):
            for word in said.split():
                if word == "camera":
                    yield camera
                else:
                    kind = _SCALARS[word[0]]
                    yield types.Array(kind, int(word[1]), word[2:] or "C") if len(word) > 1 else kind
        else:
            inner = tuple(_types(said[1:], camera))
            if said[0] is tuple:
                yield types.Tuple(inner)
                continue
            alike = all(one == inner[0] for one in inner)
            yield types.NamedUniTuple(inner[0], len(inner), said[0]) if alike else types.NamedTuple(inner, said[0])


def state_type(state: type[Any]) -> Any:
    """Return the Numba type of a camera's states."""
    return types.NamedUniTuple(types.float64, len(state._fields), state)


def loop(*arguments: Any, first: bool = True, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Declare a function that is called from Python, by the types of its arguments; `first`: by a first calibration too."""

    def declare(function: Callable[..., Any]) -> Any:
        options_of_all = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
        dispatcher = numba.njit(**(options_of_all | options))(function)
        with suppress(RuntimeError):  # no folder can be written: it is compiled in every process
            dispatcher._cache = _Kept(function)  # noqa: SLF001 - what `cache=True` sets
        LOOPS[function.__module__, function.__name__] = Loop(dispatcher, arguments, first)
        return dispatcher

    return declare


def part(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Declare a function that loops call: compiled into them, and Python elsewhere."""
    marked: Callable[[Callable[..., Any]], Callable[..., Any]] = register_jitable(**(PART | options))
    return marked


class _Reduced(CompileResultCacheImpl):  # type: ignore[misc]  # Numba ships no types
    """What is written of a compiled loop: its machine code, and of its intermediate code only which functions it defines.

    Numba keeps the whole of the latter, to build it into other functions. Nothing calls loops but Python, and reading that code
    took a third of the time that loading a loop takes.
    """

    def reduce(self, data: Any) -> Any:
        """Return what is pickled."""
        (name, kind, (machine_code, _)), *rest = super().reduce(data)
        defined = [one.name for one in data.library._get_module_for_linking().functions if not one.is_declaration]  # noqa: SLF001 - Numba shows it nowhere else
        stubs = "\n".join(f'define void @"{one}"() {{ ret void }}' for one in defined)
        return ((name, kind, (machine_code, llvm.parse_assembly(stubs).as_bitcode())), *rest)


class _Kept(FunctionCache):  # type: ignore[misc]  # Numba ships no types
    """Compiled forms of a loop: what is missing is made by others, and then loaded as if it had been there."""

    _impl_class = _Reduced

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a form, after it was made where it was missing; None where nobody could make it."""
        if compiles_itself:
            return super().load_overload(sig, target_context)
        found = self._loaded(sig, target_context)
        if found is None:
            from boresight.kernels import workshop  # noqa: PLC0415 - it needs this module

            workshop.make((self._py_func.__module__, self._py_func.__name__), sig)
            found = self._loaded(sig, target_context)
        return found

    def _loaded(self, sig: Any, target_context: Any) -> Any:
        """Load a form without the tables of functions that only a compiler asks, which take a quarter of a second to fill."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def has(self, sig: Any) -> bool:
        """Whether a form is there, without loading it."""
        return self._index_key(sig, cpu_target.target_context.codegen()) in self._cache_file._load_index()  # noqa: SLF001 - read as Numba does


@contextmanager
def one_at_a_time() -> Iterator[None]:
    """Let one process at a time compile; where there is no folder, or its files cannot be locked, several may compile the same."""
    if not numba.config.CACHE_DIR:
        yield
        return
    try:
        import fcntl  # noqa: PLC0415 - not on every system

        file = (Path(numba.config.CACHE_DIR) / "compiling").open("w", encoding="utf-8")
    except (ImportError, OSError):
        yield
        return
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)  # given back when the file is closed, whatever ends this process
        yield


def fingerprint() -> str:
    """Return a name for the sources of all loops and cameras as they are."""
    here = Path(__file__).parent
    sources = sorted([*here.glob("*.py"), *(here.parent / "cameras").glob("*.py")])
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sources)).hexdigest()[:16]


def use_own_folder() -> None:
    """Keep compiled loops in a folder of these sources, below the one that Numba was told; where it was told none, its own way."""
    told = numba.config.CACHE_DIR
    if not told:
        return
    folder = Path(told) / fingerprint()
    numba.config.CACHE_DIR = str(folder)
    with suppress(OSError):  # a folder that cannot be written still serves what is in it
        if not folder.is_dir():
            folder.mkdir(parents=True)
            for old in folder.parent.iterdir():
                if len(old.name) == len(folder.name) and time.time() - old.stat().st_mtime > UNUSED_S:
                    shutil.rmtree(old, ignore_errors=True)
        os.utime(folder)


use_own_folder()
