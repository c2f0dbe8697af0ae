"""What the camera model leaves over the detector, and which camera has it.

`estimation.residual_spline` derives spline, sigma and test. Where the test finds something, every camera model with all its
parameters free is asked whether it explains that, to first order and without a fit: with gamma what it and the fitted camera differ
by where it follows that as closely as it can, written as a spline, and beta what its parameters can move,

    g' = (I - M beta (beta^T M beta)^+ beta^T) (g - M gamma)        M' = M - M beta (beta^T M beta)^+ beta^T M

are score and information of what it would leave, and the same test is made of them. The least model that leaves nothing is named.

Beyond `MOST_FRAMES` only frames spaced evenly over the set are looked at.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.calibration import LargestDisplacement, SplineExplanation
from boresight.calibration.residual_spline import FALSE_ALARM, ResidualSplineFit, suffices
from boresight.calibration.trust.fitted_set import FittedSet, Unavailable, grid, probability
from boresight.calibration.trust.flaws import find_flaw
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import CameraModel
from boresight.estimation import residual_spline as splines
from boresight.estimation.batch import covariance
from boresight.estimation.residual_spline import Fit, PixelRows
from boresight.estimation.statistics.consistency import CLEAR_SIGMAS

MOST_FRAMES = 5000
#: Places along the longer side at which displacement and sigma are told, and fewest along the shorter.
PLACES, FEWEST_PLACES = 17, 9
#: Where another camera follows the fitted one: places along a side, steps, and share of a singular value that is rounding.
FEW, STEPS, RANK = 9, 8, 1e-10
#: Deviates of the 95 % band.
BAND = 1.959964


def find_residual_spline(fitted: FittedSet) -> ResidualSplineFit:
    """Fit the spline of what the camera leaves of a finished estimate, and ask who would explain it."""
    sensor, camera = fitted.problem.sensor, fitted.problem.camera
    arcs = fitted.thinned(MOST_FRAMES)
    fit = splines.fit(
        arcs, camera, fitted.x, fitted.parameters.free, fitted.parameters.scale,
        parity=sensor.parity, detector=(sensor.rows, sensor.columns),
    )  # fmt: skip
    if fit.data.dof <= 0 or not np.isfinite(fit.posterior.surface.coefficients).all():
        raise Unavailable("There are too few stars for a residual spline: add frames.")
    fitted.computed["flaw"] = find_flaw(fit)
    shape = (sensor.rows, sensor.columns)
    counts = [max(FEWEST_PLACES, round(PLACES * n / max(shape))) for n in shape]
    row, col = grid(*shape, *counts)
    places = tuple(at.ravel() for at in np.meshgrid(row, col, indexing="ij"))
    d, P = fit.posterior.surface(*places), fit.posterior.covariance(*places)
    sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    found, largest, at_most_px = fit.posterior, _largest(places, d, P, sigma), float(np.max(np.abs(d) + BAND * sigma))
    explained_by = _explanations(fitted, fit) if found.test.p < FALSE_ALARM else ()
    return ResidualSplineFit(
        surface=found.surface,
        row_px=row,
        col_px=col,
        displacement_px=d.T.reshape(2, *counts),
        sigma_px=sigma.T.reshape(2, *counts),
        strength_px=found.strength_px,
        effective=found.effective,
        noise=float(np.sqrt(found.variance)),
        statistic=found.test.statistic,
        expected=found.test.expected,
        p=found.test.p,
        largest=largest,
        at_most_px=at_most_px,
        explained_by=explained_by,
        stars=fit.data.stars,
        frames=arcs.n_frames,
        left_out=int(fit.left_out.sum()),
        camera_model=camera.name,
        sentence=_sentence(camera, found.test.p, largest, at_most_px, explained_by),
    )


def _largest(places: tuple[FloatArray, ...], d: FloatArray, P: FloatArray, sigma: FloatArray) -> LargestDisplacement:
    """The longest displacement among those clear of their sigma, or among all where none is."""
    size = np.hypot(*d.T)
    clear = (np.abs(d) > CLEAR_SIGMAS * sigma).any(axis=1)
    at = int(np.argmax(np.where(clear, size, -1.0) if clear.any() else size))
    along = d[at] / max(size[at], np.finfo(float).tiny)
    return LargestDisplacement(
        row_px=float(places[0][at]),
        col_px=float(places[1][at]),
        d_row_px=float(d[at, 0]),
        d_col_px=float(d[at, 1]),
        size_px=float(size[at]),
        sigma_px=float(np.sqrt(along @ P[at] @ along)),
    )


def _explanations(fitted: FittedSet, fit: Fit) -> tuple[SplineExplanation, ...]:
    """Ask every camera model, and the fitted one where parameters of it are held; those with the fewest parameters first."""
    own, free = fitted.problem.camera, len(fitted.parameters.free)
    asked = [camera for camera in CAMERA_MODELS.values() if camera is not own or free < len(camera.parameter_names)]
    asked.sort(key=lambda camera: (camera is not own, len(camera.parameter_names)))
    found = (_explanation(fitted, fit, camera) for camera in asked)
    return tuple(one for one in found if one is not None)


def _explanation(fitted: FittedSet, fit: Fit, camera: CameraModel) -> SplineExplanation | None:
    """Test what a camera would leave; None where it does not even meet the fitted one over the detector."""
    own, data = fitted.problem.camera, fit.data
    places = splines.gauss_places(data.row, data.col)
    found = _follow(fitted, camera, places)
    if found is None:
        return None
    gamma, beta = (splines.write_as_spline(data.row, data.col, field) for field in found)
    g, taken = data.g - data.M @ gamma[:, 0], data.M @ beta
    inverse = covariance(beta.T @ taken)
    left = splines.find_spectrum(
        data.row, data.col, data.M - taken @ inverse @ taken.T, g - taken @ inverse @ (beta.T @ g)
    )
    held = set(own.parameter_names) - {own.parameter_names[p] for p in fitted.parameters.free}
    more = [name for name in camera.parameter_names if name in held or name not in own.parameter_names]
    return SplineExplanation(
        camera_model=camera.name, p=splines.judge_spectrum(left, fit.posterior.variance).p, more=more
    )


Places = tuple[FloatArray, FloatArray]


def _follow(fitted: FittedSet, camera: CameraModel, places: Places) -> tuple[FloatArray, FloatArray] | None:
    """Pixels that a star moves from the fitted camera to another that follows it (n, 2, 1), and by its parameters (n, 2, k).

    None where the other has no direction somewhere. The camera's definition is evaluated as plain Python: its loops may never have
    been compiled here, and a calibration should not wait for those of a camera that it does not use.
    """
    own, sensor, pitch = fitted.problem.camera, fitted.problem.sensor, fitted.problem.sensor.pixel_pitch_m
    scale = np.array(camera.default_typical_sigma)
    at = np.meshgrid(*grid(sensor.rows, sensor.columns, FEW, FEW), indexing="ij")
    few = at[0].ravel(), at[1].ravel()
    y = camera.plain(own.focal_px(fitted.x, pitch), *own.principal_point(fitted.x), pitch)
    y = fitted.x if camera is own else y
    for _ in range(0 if camera is own else STEPS):
        away, moves = _seen_from(splines.find_pixel_rows(own, fitted.x, pitch, *few), camera, y, pitch, few)
        if not (np.isfinite(away).all() and np.isfinite(moves).all()):
            return None
        columns = (moves * scale).reshape(-1, len(scale))
        y = y + scale * np.linalg.lstsq(columns, away.ravel(), rcond=RANK)[0]
    away, moves = _seen_from(splines.find_pixel_rows(own, fitted.x, pitch, *places), camera, y, pitch, places)
    if not (np.isfinite(away).all() and np.isfinite(moves).all()):
        return None
    return away, moves * scale


def _seen_from(
    rows: PixelRows, camera: CameraModel, y: FloatArray, pitch: float, places: Places
) -> tuple[FloatArray, FloatArray]:
    """Tangents of the fitted camera less those of another (n, 2, 1), and how its parameters move these (n, 2, k), in pixels."""
    tangents, derivatives = np.full((len(places[0]), 2), np.nan), np.full((len(places[0]), 2, len(y)), np.nan)
    state = tuple(y.tolist())
    for i, (row, col) in enumerate(zip(*(at.tolist() for at in places), strict=True)):
        with suppress(ValueError, ZeroDivisionError, OverflowError):  # it sees nothing there
            tx, ty, dx, dy = camera.star(state, pitch, row, col)
            tangents[i], derivatives[i] = (tx, ty), (dx, dy)
    return rows.slope @ (rows.tangents - tangents)[..., None], rows.slope @ derivatives


def _sentence(
    camera: CameraModel,
    p: float,
    largest: LargestDisplacement,
    at_most_px: float,
    explained_by: tuple[SplineExplanation, ...],
) -> str:
    """Value, sigma, probability, and what to do."""
    if p >= FALSE_ALARM:
        return (
            f"The camera model leaves no more displacement than noise explains ({probability(p)}): at most "
            f"{at_most_px:.2g} px along an axis, anywhere on the detector (95 %)."
        )
    return (
        f"The camera model leaves stars displaced by up to {largest.size_px:.2g} ± {largest.sigma_px:.1g} px (row "
        f"{largest.row_px:.0f}, column {largest.col_px:.0f}), more than noise explains ({probability(p)}): "
        f"{_remedy(camera, explained_by)}"
    )


def _remedy(camera: CameraModel, explained_by: tuple[SplineExplanation, ...]) -> str:
    found = next((one for one in explained_by if suffices(one)), None)
    if found is None:
        return (
            "no other describes all of it. Check matches and directions; if they are right, load the correction "
            "table of this residual with the parameters."
        )
    if found.camera_model == camera.name:
        symbols = dict(zip(camera.parameter_names, camera.symbols, strict=True))
        return (
            f"some of {', '.join(symbols[name] for name in found.more)}, which are held fixed, describe it; `boresight choose` "
            "finds "
            "the fewest that are needed."
        )
    others = [one.camera_model.replace("_", " ") for one in explained_by if suffices(one) and one is not found]
    also = f", as would {' and '.join(others)}" if others else ""
    return f"the camera model {found.camera_model.replace('_', ' ')} describes it{also}; calibrate with that."
