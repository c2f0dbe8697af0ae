"""The same arithmetic as an engineer would write it without compiled loops: NumPy in batches, SciPy's optimiser, a NumPy filter.

They are the yardstick of `studies.speed` and share its data. Nothing in the product calls them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from boresight.arrays import FloatArray
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import ArcSet
from boresight.estimation.cameras.inverted_wang import INVERTED_WANG, directions_and_jacobian


@dataclass(frozen=True)
class EqualExposures:
    """Exposures with the same number of stars, so that NumPy can take them in one piece.

    Parameters
    ----------
    row_px, col_px
        (n_exposures, n) centroids in arc order.
    phi
        (n_exposures, 2n - 3) catalogue arcs, rad.
    whitener
        (n_exposures, 2n - 3, 2n - 3) inverse of the lower factor of R.
    """

    pitch: float
    row_px: FloatArray
    col_px: FloatArray
    phi: FloatArray
    whitener: FloatArray

    @classmethod
    def of(cls, arcs: ArcSet, n: int) -> EqualExposures:
        """Reshape a weighed set of n-star exposures, and invert its factors."""
        m = 2 * n - 3
        band = arcs.band.reshape(-1, m, 5)
        L = np.zeros((len(band), m, m))
        for d in range(5):
            L[:, np.arange(d, m), np.arange(m - d)] = band[:, d:, 4 - d]
        shape = (-1, n)
        return cls(
            arcs.pitch,
            arcs.row_px.reshape(shape),
            arcs.col_px.reshape(shape),
            arcs.phi.reshape(-1, m),
            np.asarray(np.linalg.inv(L)),
        )

    def part(self, first: int, last: int) -> EqualExposures:
        """Return the exposures first <= k < last."""
        part = slice(first, last)
        return EqualExposures(self.pitch, self.row_px[part], self.col_px[part], self.phi[part], self.whitener[part])

    def rows(self, x: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals (n_arcs,) and scaled Jacobian (n_arcs, 8) of all exposures at once."""
        s, ds = directions_and_jacobian(x, self.row_px, self.col_px, self.pitch)
        i, j = arcsets.pairs(self.row_px.shape[1]).T
        measured = arcsets.arclength(s[:, i], s[:, j])
        e = measured - self.phi
        H = np.einsum("kai,kaip->kap", s[:, j], ds[:, i]) + np.einsum("kai,kaip->kap", s[:, i], ds[:, j])
        H *= -(1.0 / np.sin(measured))[..., None] * scale
        return (self.whitener @ e[..., None]).ravel(), (self.whitener @ H).reshape(-1, len(x))


def numpy_evaluation(data: EqualExposures, x: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A and b of the normal equations by batched NumPy with a dense whitener."""
    e, H = data.rows(x, scale)
    return H.T @ H, H.T @ e


def scipy_fit(data: EqualExposures, x_0: FloatArray, scale: FloatArray) -> tuple[FloatArray, int]:
    """Fit by `scipy.optimize.least_squares` with the analytic Jacobian, residuals and Jacobian batched.

    Returns
    -------
    x
        (8,) estimate, SI.
    evaluations
        How often residuals with Jacobian were evaluated.
    """
    solved = least_squares(
        lambda z: data.rows(x_0 + z * scale, scale)[0],
        np.zeros(len(x_0)),
        jac=lambda z: data.rows(x_0 + z * scale, scale)[1],
        xtol=1e-10,
    )
    return np.asarray(x_0 + solved.x * scale), int(solved.njev)


def numpy_square_root_filter(
    arcs: ArcSet, x_0: FloatArray, scale: FloatArray, start_sigma: float, linearisations: int, rest: float
) -> FloatArray:
    """The whole job of the product's filter, frame by frame in plain NumPy; returns x (8,).

    Each frame gets its R (E Eqs 16-18) and Cholesky factor, its model and Jacobian, Carlson's update element by element as the
    textbook prints it (Grewal and Andrews), and is linearised again until its residual agrees with its linear prediction.
    """
    z, S = np.zeros(len(x_0)), start_sigma * np.eye(len(x_0))
    for k in range(arcs.n_frames):
        frame = arcs.frames(k, k + 1)
        whiteners = _plain_whiteners(frame, x_0 + z * scale)
        z_prior, S_prior = z, S
        for _ in range(linearisations):
            z_lin = z
            e, H = _plain_rows(frame, x_0 + z * scale, scale, whiteners)
            z, S = z_prior.copy(), S_prior.copy()
            for a in range(len(e)):
                _carlson(z, S, H[a], e[a] + H[a] @ (z - z_lin))
            after, _ = _plain_rows(frame, x_0 + z * scale, scale, whiteners)
            if np.abs(after - e - H @ (z - z_lin)).max() < rest:
                break
    return np.asarray(x_0 + z * scale)


def _plain_whiteners(frame: ArcSet, x: FloatArray) -> list[FloatArray]:
    """Inverse Cholesky factors of each exposure's full R at state x."""
    sigma = arcsets.angular_sigma(INVERTED_WANG, x, frame)
    parts = [slice(*frame.star_start[m : m + 2]) for m in range(frame.n_exposures)]
    return [np.linalg.inv(np.linalg.cholesky(arcsets.covariance(frame.s_i[part], sigma[part]))) for part in parts]


def _plain_rows(
    frame: ArcSet, x: FloatArray, scale: FloatArray, whiteners: list[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Whitened residuals and scaled Jacobian of a frame, exposure by exposure."""
    residuals, jacobians = [], []
    for m, whitener in enumerate(whiteners):
        part = slice(*frame.star_start[m : m + 2])
        s, ds = directions_and_jacobian(x, frame.row_px[part], frame.col_px[part], frame.pitch)
        i, j = arcsets.pairs(len(s)).T
        measured = arcsets.arclength(s[i], s[j])
        e = measured - arcsets.arclength(frame.s_i[part][i], frame.s_i[part][j])
        H = np.einsum("ai,aip->ap", s[j], ds[i]) + np.einsum("ai,aip->ap", s[i], ds[j])
        residuals.append(whitener @ e)
        jacobians.append(whitener @ (-H / np.sin(measured)[:, None] * scale))
    return np.concatenate(residuals), np.concatenate(jacobians)


def _carlson(z: FloatArray, S: FloatArray, h: FloatArray, innovation: float) -> None:
    """One scalar update in place, see `estimation.filters.square_root`."""
    n = len(z)
    f, gain = S.T @ h, np.zeros(n)
    alpha = 1.0
    for j in range(n):
        before, alpha = alpha, alpha + f[j] ** 2
        keep, move = np.sqrt(before / alpha), f[j] / np.sqrt(before * alpha)
        for i in range(j + 1):
            old = S[i, j]
            S[i, j] = keep * old - move * gain[i]
            gain[i] += old * f[j]
    z -= gain / alpha * innovation


def numpy_lean_square_root_filter(
    data: EqualExposures, x_0: FloatArray, scale: FloatArray, start_sigma: float
) -> FloatArray:
    """The leanest NumPy filter: whiteners given, one linearisation a frame, a column of S in one expression; returns x (8,)."""
    z, S = np.zeros(len(x_0)), start_sigma * np.eye(len(x_0))
    for first in range(0, len(data.phi), 2):
        z_lin = z.copy()
        e, H = data.part(first, first + 2).rows(x_0 + z * scale, scale)
        for a in range(len(e)):
            _carlson_by_columns(z, S, H[a], e[a] + H[a] @ (z - z_lin))
    return np.asarray(x_0 + z * scale)


def _carlson_by_columns(z: FloatArray, S: FloatArray, h: FloatArray, innovation: float) -> None:
    """One scalar update in place with each column in one NumPy expression."""
    f, gain = S.T @ h, np.zeros(len(z))
    alpha = 1.0
    for j in range(len(z)):
        before, alpha = alpha, alpha + f[j] ** 2
        column = S[:, j].copy()
        S[:, j] = np.sqrt(before / alpha) * column - f[j] / np.sqrt(before * alpha) * gain
        gain += column * f[j]
    z -= gain / alpha * innovation


def numpy_extended_filter(data: EqualExposures, x_0: FloatArray, scale: FloatArray, start_sigma: float) -> FloatArray:
    """Vector extended Kalman filter, whiteners given, one linearisation a frame; returns x (8,)."""
    z, P = np.zeros(len(x_0)), start_sigma**2 * np.eye(len(x_0))
    for first in range(0, len(data.phi), 2):
        e, H = data.part(first, first + 2).rows(x_0 + z * scale, scale)
        K = np.linalg.solve(H @ P @ H.T + np.eye(len(e)), H @ P).T
        z, P = z - K @ e, (np.eye(len(z)) - K @ H) @ P
    return np.asarray(x_0 + z * scale)
