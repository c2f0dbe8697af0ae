"""Boresight itself, everything counted from centroids and directions on: order, R, fit, and R again at the solution."""

from __future__ import annotations

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.problem import weighed
from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.measurements.peers import Answer
from boresight.measurements.views import Views

START_SIGMA = 10.0


def answer_of(views: Views, x: FloatArray, P: FloatArray | None, arcs: ArcSet) -> Answer:
    """Dress an estimate of the eight parameters; the residual is that of the arcs, each of two ends, in pixels."""
    squares = batch.normal_equations(arcs, x, np.arange(len(x)), views.sensor.typical_sigma).sum_of_squares
    n_arcs = 2 * len(arcs.row_px) - 3 * (len(arcs.star_start) - 1)
    per_pixel_rad = np.median(arcsets.angular_sigma(views.camera, x, arcs) / arcs.sigma_px)
    return Answer(
        lambda row, col: views.camera.directions(x, row, col, views.sensor.pixel_pitch_m),
        float(x[0]),
        float(np.sqrt(squares / n_arcs / 2) / per_pixel_rad),
        x,
        P,
        None if P is None else float(np.sqrt(P[0, 0]) * views.sensor.typical_sigma[0]),
    )


def batch_fit(views: Views) -> Answer:
    """Fit by Levenberg-Marquardt, and once more with R at the solution, as a batch calibration does."""
    x, scale = views.sensor.initial, views.sensor.typical_sigma
    arcs = _ordered(views)
    for _ in range(2):
        arcs = weighed(arcs, views.camera, x)
        fitted = batch.fit(arcs, x, np.arange(len(x)), scale)
        x = fitted.x
    P = np.asarray(np.linalg.inv(batch.normal_equations(arcs, x, np.arange(len(x)), scale).A))
    return answer_of(views, x, P, arcs)


def square_root(views: Views) -> Answer:
    """Run the iterated square-root filter without process noise, as a sequential calibration does."""
    x, scale = views.sensor.initial, views.sensor.typical_sigma
    arcs = weighed(_ordered(views), views.camera, x)
    pooled = pool_start(arcs, START_ARCS_PER_PARAMETER * len(x))
    last = FILTERS["sqrf"](pooled, start(x, len(x), START_SIGMA), np.arange(len(x)), scale, Tuning()).last
    return answer_of(views, last.x, last.P, arcs)


def _ordered(views: Views) -> ArcSet:
    """Order the stars again, so that the work is counted."""
    arcsets.order(views.arcs.star_start, views.arcs.s_i)
    return views.arcs
