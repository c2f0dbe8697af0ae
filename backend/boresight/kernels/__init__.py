"""The hot loops, compiled by Numba: arrays in, arrays out; each has one documented caller.

`arclengths` holds the camera, the arcs, the batch and the square-root filters; `singular` and `angles` the references of the
filters on singular values and on all pairs, `information` their update; `matching` the association of detections with
stars; `displacements` what displaced stars change in the arcs; `smoothing` the two passes of the smoother; `passes` the filter over
passes whose parameters walk. `compilation` says how they are compiled, and where that is kept.
"""

from __future__ import annotations

from boresight.kernels.angles import factor_pairs, pair_rows, whiten_pairs
from boresight.kernels.arclengths import (
    HALF_BANDWIDTH,
    arcs_and_factors,
    count_beyond,
    normal_equations,
    order_stars,
    project,
    rays,
    rays_and_jacobians,
    residuals,
    solid_angles,
    square_root_filter,
    sums_of_squares,
    unscented_filter,
    whitened_rows,
)
from boresight.kernels.displacements import displaced_rows
from boresight.kernels.information import cost, information_update, invert, whiten, worst_departure
from boresight.kernels.passes import filter_passes
from boresight.kernels.singular import factor_values, value_rows
from boresight.kernels.smoothing import backward_pass, forward_pass
from boresight.kernels.star import define

__all__ = [
    "HALF_BANDWIDTH",
    "arcs_and_factors",
    "backward_pass",
    "cost",
    "count_beyond",
    "define",
    "displaced_rows",
    "factor_pairs",
    "factor_values",
    "filter_passes",
    "forward_pass",
    "information_update",
    "invert",
    "normal_equations",
    "order_stars",
    "pair_rows",
    "project",
    "rays",
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
