"""The hot loops, compiled by Numba: arrays in, arrays out; each has one documented caller.

`arclengths` holds the camera, the arcs, the batch and the square-root filters; `singular` and `angles` the references of the
filters on singular values and on all pairs, `information` their update; `matching` the association of detections with
stars. None calls another, so that Numba's cache, which looks at one file's age, never serves a stale loop.
"""

from __future__ import annotations

from boresight.kernels.angles import factor_pairs, pair_rows, whiten_pairs
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
from boresight.kernels.information import cost, information_update, invert, whiten, worst_departure
from boresight.kernels.singular import factor_values, value_rows

__all__ = [
    "HALF_BANDWIDTH",
    "N_PARAMETERS",
    "arcs_and_factors",
    "carlson_update",
    "cost",
    "count_beyond",
    "factor_pairs",
    "factor_values",
    "inflate",
    "information_update",
    "invert",
    "normal_equations",
    "order_stars",
    "pair_rows",
    "rays_and_jacobians",
    "residuals",
    "solid_angles",
    "square_root_filter",
    "sums_of_squares",
    "unscented_filter",
    "value_rows",
    "whiten",
    "whiten_pairs",
    "whitened_rows",
    "worst_departure",
]
