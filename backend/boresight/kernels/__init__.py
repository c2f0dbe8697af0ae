"""The hot loops, compiled by Numba: arrays in, arrays out; each has one documented caller.

`arclengths` holds the camera, the arcs, the batch and the square-root filters; `matching` the association of detections with
stars. Neither calls the other, so that Numba's cache, which looks at one file's age, never serves a stale loop.
"""

from __future__ import annotations

from boresight.kernels.arclengths import (
    HALF_BANDWIDTH,
    N_PARAMETERS,
    arcs_and_factors,
    carlson_update,
    count_beyond,
    inflate,
    normal_equations,
    order_stars,
    rays_and_jacobians,
    residuals,
    solid_angles,
    square_root_filter,
    sums_of_squares,
    unscented_filter,
    whitened_rows,
)

__all__ = [
    "HALF_BANDWIDTH",
    "N_PARAMETERS",
    "arcs_and_factors",
    "carlson_update",
    "count_beyond",
    "inflate",
    "normal_equations",
    "order_stars",
    "rays_and_jacobians",
    "residuals",
    "solid_angles",
    "square_root_filter",
    "sums_of_squares",
    "unscented_filter",
    "whitened_rows",
]
