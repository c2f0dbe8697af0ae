"""Whether the claimed sigmas are the smallest that these centroids allow.

The bound is `estimation.statistics.cramer_rao`'s: centroids with attitude as nuisance, no arcs. A filter knows its start besides,
with covariance s^2 I, so its bound is (information + I / s^2)^-1. Beyond `MOST_FRAMES` the bound is taken on frames spaced evenly:
with the arcs' information of those frames A_t = L_t L_t^T and of all A = L L^T, the information of all is L (L_t^-1 I_t L_t^-T)
L^T.

A ratio over one is information left behind: process noise, forgetting, a robust loss. A ratio under one cannot be had by an
honest estimator: such sigmas are too small. Over all directions together the ratio is (det P / det bound)^(1 / 2n).

A robust fit takes the size of the noise from the residuals, and so does its bound here: their median square over that of a unit
normal.

How well an arc is known about the detector, from the parameters' covariance alone.

`estimation.statistics.uncertainty.arc_sigma` derives it. The length is 5 degrees, or a quarter of the shorter side where the field
is narrower
than 10: long enough that focal length and distortion show, short enough that most places have arcs on all sides. Centroid noise is
not in it: this is what the calibration itself adds to every arc that the sensor will measure at that place.

What more data would buy: predicted sigma against further frames of the same kind.

How it follows is told in `estimation.statistics.observability`. "Of the same kind" means as many stars, as well spread, seen as
sharply: the
mean information of the frames that are there. Where a set is short or covers little sky, further frames bring other stars and
the prediction is only as good as the sample. How unlike its parts are tells how good: the set is cut into `BLOCKS` runs of
frames, each is left out in turn, and the jackknife gives the relative uncertainty of the sigma that many further frames would
leave,

    s^2 = (B - 1) / B  sum_b (ln sigma_b - mean ln sigma)^2,        sigma_b^2 = diag((A - A_b) / (n - n_b))^-1.

`python -m benchmarks.monte_carlo more-data` checks the prediction by running the frames.
"""

from __future__ import annotations

import numpy as np

from boresight.arrays import ARCSEC_PER_RAD, FloatArray
from boresight.calibration.calibration import ArcSigmaMap, Efficiency, MoreData, Values
from boresight.calibration.trust.fitted_set import FittedSet, Unavailable, grid, nested
from boresight.cameras import CAMERA_MODELS
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet, arclength
from boresight.estimation.statistics.cramer_rao import centroid_rows
from boresight.estimation.statistics.observability import further_covariance
from boresight.estimation.statistics.uncertainty import arc_sigma
from boresight.telemetry.sensors import Sensor

MOST_FRAMES = 400
#: Ratios within this share of one are one: the isotropic error of an arc's ends is that near to a round pixel error.
NEAR = 0.03
#: Median of the square of a unit normal number.
MEDIAN_OF_A_SQUARE = 0.454936


def efficiency(fitted: FittedSet) -> Efficiency:
    """Claimed sigma over bound, a parameter at a time and over all directions."""
    if not fitted.determined:
        raise Unavailable(
            "The data do not determine one direction of the parameters, so there is no bound: hold a parameter fixed."
        )
    arcs = fitted.thinned(MOST_FRAMES)
    held = _centroid_information(fitted, arcs)
    if fitted.settings.sequential or fitted.parameters.prior is not None:
        held = held + fitted.parameters.known_at_start(fitted.settings)
    bound, P = np.linalg.inv(held) * _noise(fitted), fitted.estimate.P
    if not (np.diag(P) > 0).all() or not (np.diag(bound) > 0).all():
        raise np.linalg.LinAlgError("Expected positive variances, received rounding errors")
    ratio = np.sqrt(np.diag(P) / np.diag(bound))
    overall = float(np.exp((np.linalg.slogdet(P)[1] - np.linalg.slogdet(bound)[1]) / (2 * len(P))))
    sigma = np.sqrt(np.diag(bound)) * fitted.parameters.scale
    return Efficiency(
        names=fitted.names,
        cramer_rao_sigma=Values(dict(zip(fitted.names, nested(sigma), strict=True))),
        ratio=Values(dict(zip(fitted.names, nested(ratio), strict=True))),
        overall_ratio=overall,
        frames_used=arcs.n_frames,
        sentence=_efficiency_sentence(overall, ratio, fitted, arcs.n_frames),
    )


def _noise(fitted: FittedSet) -> float:
    """Variance of the residuals over the stated one where the claim follows it, as a robust fit's does; else one."""
    return 1.0 if fitted.settings.robust == "none" else float(np.median(fitted.e**2)) / MEDIAN_OF_A_SQUARE


def _centroid_information(fitted: FittedSet, arcs: ArcSet) -> FloatArray:
    """Information of the centroids of all frames, from those of some (see above)."""
    free, scale, x = fitted.parameters.free, fitted.parameters.scale, fitted.x
    held = centroid_rows(fitted.problem.camera, x, arcs, free, scale).information
    if arcs.n_frames == fitted.arcs.n_frames:
        return held
    L = np.linalg.cholesky(fitted.A)
    L_t = np.linalg.cholesky(batch.normal_equations(arcs, x, free, scale).A)
    to_all = L @ np.linalg.inv(L_t)
    return np.asarray(to_all @ held @ to_all.T)


def _efficiency_sentence(overall: float, ratio: FloatArray, fitted: FittedSet, frames_used: int) -> str:
    of = "" if frames_used == fitted.arcs.n_frames else f", from {frames_used} frames spaced evenly over the set"
    worst = int(np.argmax(ratio))
    numbers = (
        f"{overall:.3f} times the Cramér-Rao bound over all directions, {ratio[worst]:.3f} for {fitted.symbols[worst]}"
    )
    remedy = "; run the batch" if fitted.settings.sequential else ""
    if overall < 1 - NEAR:
        return f"The claimed sigmas are {numbers}{of}: less than the centroids allow, so they are too small{remedy}."
    if overall > 1 + NEAR:
        return f"The claimed sigmas are {numbers}{of}: these centroids contain more information than the method used."
    return f"The claimed sigmas are {numbers}{of}: the method uses all the information in these centroids."


ARC_DEG = 5.0
ROWS, COLUMNS = 13, 17


def arc_length_rad(sensor: Sensor, x: FloatArray) -> float:
    """Length of the map's arcs on a sensor with parameters x (n_parameters,)."""
    middle_row, middle_col = (sensor.rows - 1) / 2, (sensor.columns - 1) / 2
    row = np.array([0.0, sensor.rows - 1.0, middle_row, middle_row])
    col = np.array([middle_col, middle_col, 0.0, sensor.columns - 1.0])
    s = CAMERA_MODELS[sensor.camera_model].directions(x, row, col, sensor.pixel_pitch_m)
    shorter = float(arclength(s[[0, 2]], s[[1, 3]]).min())
    return float(np.radians(ARC_DEG) if shorter >= 2 * np.radians(ARC_DEG) else shorter / 4)


def field_arc_sigma(sensor: Sensor, x: FloatArray, P: FloatArray) -> tuple[FloatArray, float]:
    """Error of arcs over the detector.

    `x`, `P`: (n_parameters,) and (n_parameters, n_parameters), SI; zero rows for fixed parameters. Returns (ROWS, COLUMNS)
    sigma of arcs that begin at places spread over the detector, rad; and the arcs' length, rad.
    """
    row, col = grid(sensor.rows, sensor.columns, ROWS, COLUMNS)
    places = (np.repeat(row, COLUMNS), np.tile(col, ROWS))
    length = arc_length_rad(sensor, x)
    detector = (sensor.rows, sensor.columns, sensor.pixel_pitch_m)
    sigma = arc_sigma(CAMERA_MODELS[sensor.camera_model], x, P, places, length, detector)
    return sigma.reshape(ROWS, COLUMNS), length


def arc_sigma_map(fitted: FittedSet) -> ArcSigmaMap:
    """The map, with the length of its arcs and a sentence."""
    if not fitted.determined:
        raise Unavailable(
            "The data do not determine one direction of the parameters, so arcs have no bounded error: hold a parameter fixed."
        )
    sensor = fitted.problem.sensor
    row, col = grid(sensor.rows, sensor.columns, ROWS, COLUMNS)
    sigma, length = field_arc_sigma(sensor, fitted.estimate.x, fitted.full_covariance(fitted.estimate.P))
    if not np.isfinite(sigma).any():
        raise Unavailable("At these parameters no arc of the detector has a bounded error: check sensor and matches.")
    sigma_arcsec = ARCSEC_PER_RAD * sigma
    best, worst, degrees = np.nanmin(sigma_arcsec), np.nanmax(sigma_arcsec), np.degrees(length)
    return ArcSigmaMap(
        row_px=nested(row),
        col_px=nested(col),
        sigma_arcsec=nested(sigma_arcsec),
        arc_deg=float(degrees),
        sentence=(
            f"From the parameters alone an arc of {degrees:.2g}° is known to {best:.2g} arcsec at the best place of the "
            f"detector and to {worst:.2g} arcsec at the worst (1 sigma)."
        ),
    )


#: Share of a sigma that twenty times the data must lower it by, to be worth speaking of.
LITTLE = 0.3
#: Parts of the set that are left out in turn.
BLOCKS = 20
#: Further frames as shares of those that are there.
SHARES = (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


def more_data(fitted: FittedSet) -> MoreData:
    """Predicted one-sigma of each free parameter, SI."""
    if not fitted.determined:
        raise Unavailable(
            "More frames of the same kind would not determine this direction: add frames at other attitudes, or hold one of its "
            "parameters fixed."
        )
    n = fitted.arcs.n_frames
    frames = sorted({round(share * n) for share in SHARES})
    noise, forgetting = 0.0, 1.0
    if fitted.settings.sequential:
        noise, forgetting = fitted.settings.process_noise, fitted.settings.forgetting_factor
    doubt = _doubt(fitted)
    P = [further_covariance(fitted.estimate.P, fitted.estimate.A / n, k, noise, forgetting) for k in frames]
    sigma = np.sqrt(np.array([np.diag(matrix) for matrix in P]))
    shown = sigma * fitted.parameters.scale
    return MoreData(
        frames=n,
        further_frames=frames,
        sigma={name: nested(shown[:, i]) for i, name in enumerate(fitted.names)},
        relative_uncertainty=None if doubt is None else Values(dict(zip(fitted.names, nested(doubt), strict=True))),
        sentence=_more_data_sentence(fitted, frames, sigma, doubt),
    )


def _doubt(fitted: FittedSet) -> FloatArray | None:
    """Relative uncertainty (n_free,) of the predicted sigmas; None where the blocks are too few or too thin."""
    n = fitted.arcs.n_frames
    blocks = min(n, BLOCKS)
    if blocks < 3:
        return None
    block = np.arange(n) * blocks // n
    starts = fitted.arcs.frame_arcs
    cuts = starts[np.searchsorted(block, np.arange(blocks + 1))]
    logs = []
    for b in range(blocks):
        H = fitted.H[cuts[b] : cuts[b + 1]]
        left = (fitted.A - H.T @ H) / (n - np.sum(block == b))
        if not batch.determined(left)[2].all():
            return None
        logs.append(np.log(np.diag(np.linalg.inv(left))) / 2)
    return np.asarray(np.sqrt((blocks - 1) * np.var(logs, axis=0)))


def _more_data_sentence(fitted: FittedSet, frames: list[int], sigma: FloatArray, doubt: FloatArray | None) -> str:
    """What twice the data would buy for the parameter that is known least."""
    least = int(np.argmax(sigma[0]))
    double, most = frames.index(fitted.arcs.n_frames), len(frames) - 1
    symbol = fitted.symbols[least]
    gain = 1 - sigma[:, least] / sigma[0, least]
    if gain[most] < LITTLE:
        return (
            f"A filter that forgets uses only its last frames: even {frames[most]:,} further frames of the same kind would "
            f"lower the sigma of {symbol} by only {gain[most]:.0%}."
        )
    unlike = (
        ""
        if doubt is None
        else f"; judging from the differences between parts of the set, this prediction may be off by {doubt[least]:.0%} (1 sigma)"
    )
    return (
        f"{frames[double]:,} further frames of the same kind would lower the sigma of {symbol}, the least known parameter "
        f"relative to its typical sigma, by {gain[double]:.0%}, and {frames[most]:,} by {gain[most]:.0%}{unlike}."
    )
