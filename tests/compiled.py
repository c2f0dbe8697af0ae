"""Parts of compiled loops as functions of their own, so that a test calls compiled code and not Python."""

from functools import cache
from types import FunctionType

import numba

from boresight.kernels.compilation import FAST


@cache
def compiled(part):
    """Compile a part by itself."""
    return numba.njit(error_model="numpy", fastmath=FAST)(part)


class CompiledParts:
    """A module of loops, its parts compiled each by itself."""

    def __init__(self, module) -> None:
        self._module = module

    def __getattr__(self, name):
        value = getattr(self._module, name)
        part_of_it = isinstance(value, FunctionType) and value.__module__ == self._module.__name__
        return compiled(value) if part_of_it and name not in {"scratch", "frame_space"} else value
