"""What the compiled loops ask of a camera: `star`, which every camera's own file defines for the state that it has.

A loop is compiled once for each kind of state that it is called with, and `star` is chosen by that kind while it is compiled: no
loop names a camera, and none asks at run time which one it has. The argument `camera` of a loop is any state of the camera, for
its type is all that counts; `x` are the parameters as an array (n_parameters,).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba.core import types
from numba.extending import overload
from numba.np.unsafe.ndarray import to_fixed_tuple

from boresight.kernels.compilation import FAST, PART
from boresight.kernels.compilation import part as marked

_OPTIONS = PART | {"fastmath": FAST}


def star(camera: Any, x: Any, pitch: float, row_px: float, col_px: float) -> Any:
    """Return t_x, t_y, and the derivatives of each by the parameters; `boresight.cameras.model` says what they are."""
    raise NotImplementedError(f"{type(camera).__name__} is no camera's state.")


def numbers(camera: Any, x: Any) -> Any:
    """Return the parameters as a tuple: the compiler then knows that no store changes them, and keeps them in registers."""
    raise NotImplementedError(f"{type(camera).__name__} is no camera's state.")


@overload(numbers, jit_options=_OPTIONS, strict=False)
def _numbers(camera: Any, x: Any) -> Callable[..., Any] | None:  # noqa: ARG001 - its signature is that of `numbers`
    if not isinstance(camera, types.BaseNamedTuple):
        return None
    n = len(camera)
    return lambda camera, x: to_fixed_tuple(x, n)  # noqa: ARG005 - its signature is that of `numbers`


def part(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a function that a camera's `star` calls: it is compiled into the loops, and remains Python elsewhere."""
    return marked(fastmath=FAST)(function)


def define(state: type, function: Callable[..., Any]) -> None:
    """Make `function(x, pitch, row_px, col_px)` the `star` of a kind of state."""
    compiled = part(function)

    @overload(star, jit_options=_OPTIONS, strict=False)
    def _star(camera: Any, x: Any, pitch: Any, row_px: Any, col_px: Any) -> Callable[..., Any] | None:  # noqa: ARG001 - its signature is that of `star`
        if isinstance(camera, types.BaseNamedTuple) and camera.instance_class is state:
            return lambda camera, x, pitch, row_px, col_px: compiled(x, pitch, row_px, col_px)  # noqa: ARG005 - as above
        return None
