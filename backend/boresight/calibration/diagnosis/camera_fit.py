"""How well matched stars agree with a sensor file: a fit of its camera to them that holds on to the file.

With r the residuals of the matched stars of an exposure across their directions, theta the error of its attitude, and x = x_0 +
P^(1/2) w the true parameters, P^(1/2) = diag(typical sigmas), as in `sky.matching`

    r = A_theta theta + A_w w + e,        e ~ N(0, sigma^2 I),        w ~ N(mu, I)

where mu is 0 unless a hypothesis says that a parameter is another than the file's by just so much. The attitude of each exposure is
eliminated by the projection M onto what A_theta does not reach; summed over exposures

    H = sum A_w^T M A_w / sigma^2,     b = sum A_w^T M r / sigma^2,     c = sum r^T M r / sigma^2,

    chi2(mu) = min_w  c - 2 b^T w + w^T H w + |w - mu|^2 = c + |mu|^2 - (b + mu)^T (H + I)^-1 (b + mu),

reached at w = (H + I)^-1 (b + mu), with covariance (H + I)^-1. A focal length that is far off bends this, so it is linearised again
at the answer, a few times. Two hypotheses on the same stars differ by half the difference of their chi2 in log likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.calibration.matching.rematch import Matches, ground_covariance, measured_directions, square_root
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.attitude import wahba
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

_LINEARISATIONS = 4
#: An exposure has three numbers of attitude; two stars fix it.
_ATTITUDE_STARS = 2


@dataclass(frozen=True)
class Agreement:
    """The fit of a camera to matched stars.

    `x`: (n_parameters,) state at w. `w`, `b`: (n_parameters,) and `H`: (n_parameters, n_parameters), of typical sigmas times
    `scale`. `c`, `dof`: see above; dof counts no parameter. `camera_model`: whose parameters these are.
    """

    x: FloatArray
    w: FloatArray
    H: FloatArray
    b: FloatArray
    c: float
    dof: int
    camera_model: str

    @property
    def chi2(self) -> float:
        """chi2 at mu = 0."""
        return self.chi2_at(np.zeros(len(self.b)))

    @property
    def noise(self) -> float:
        """Centroid noise over that stated, at least 1."""
        return float(np.sqrt(max(1.0, self.chi2 / max(self.dof, 1))))

    @property
    def sigma(self) -> FloatArray:
        """(n_parameters,) sigma of w."""
        return np.sqrt(np.diag(np.linalg.inv(self.H + np.eye(len(self.b)))))

    def chi2_at(self, mu: FloatArray) -> float:
        """chi2 where the file is off by mu (n_parameters,)."""
        pulled = self.b + mu
        return float(self.c + mu @ mu - pulled @ np.linalg.solve(self.H + np.eye(len(mu)), pulled))

    def chi2_free(self, places: list[int]) -> float:
        """chi2 where the file says nothing of some parameters."""
        held = np.ones(len(self.b))
        held[places] = 1e-9  # what stars do not show of them either stays where it is
        return float(self.c - self.b @ np.linalg.solve(self.H + np.diag(held), self.b))


def fit_camera(telemetry: Telemetry, sensor: Sensor, matches: Matches, scale: float) -> Agreement | None:
    """Fit a sensor's camera to the stars matched, the file's sigmas being `scale` typical sigmas; None of no star."""
    return fit_directions(telemetry, sensor, matches.star_id > 0, matches.s_i, matches.exposure_start, scale)


def fit_directions(
    telemetry: Telemetry,
    sensor: Sensor,
    used: BoolArray,
    s_i: FloatArray,
    exposure_start: IntArray,
    scale: float,
    near: FloatArray | None = None,
) -> Agreement | None:
    """Fit a sensor's camera to stars (n_rows,) marked as used, seen in directions s_i (n_rows, 3), ICRS.

    `near`: (n_parameters,) a w so near the answer that one linearisation there will do.
    """
    used = np.asarray(used & np.isfinite(s_i[:, 0]))
    P = ground_covariance(sensor, scale)
    root = square_root(P)
    w: FloatArray = np.zeros(len(sensor.initial)) if near is None else near
    found: Agreement | None = None
    for _ in range(_LINEARISATIONS if near is None else 1):
        x = sensor.initial + root @ w
        if not _sees(sensor, x):
            break
        s, G, sigma = measured_directions(telemetry, slice(0, len(telemetry)), sensor, x, P)
        H, b, c, dof = np.zeros((len(w), len(w))), np.zeros(len(w)), 0.0, 0
        for first, last in pairwise(exposure_start.tolist()):
            rows = np.arange(first, last)[used[first:last] & np.isfinite(s[first:last, 0])]
            part = _normal(s[rows], G[rows], sigma[rows], s_i[rows], w)
            if part is not None:
                H, b, c, dof = H + part[0], b + part[1], c + part[2], dof + part[3]
        if not dof:
            return None
        w = np.asarray(np.linalg.solve(H + np.eye(len(w)), b))
        found = Agreement(sensor.initial + root @ w, w, H, b, c, dof, sensor.camera_model)
    return found


def _sees(sensor: Sensor, x: FloatArray) -> bool:
    """Whether every corner of the detector has a direction under x."""
    camera = CAMERA_MODELS[sensor.camera_model]
    return bool(np.isfinite(x).all()) and (
        camera.blind_corner(x, sensor.rows, sensor.columns, sensor.pixel_pitch_m) is None
    )


def _normal(
    s: FloatArray, G: FloatArray, sigma: FloatArray, s_i: FloatArray, w: FloatArray
) -> tuple[FloatArray, FloatArray, float, int] | None:
    """What one exposure adds to H, b, c and their degrees of freedom; residuals are brought back from w to w = 0."""
    n = len(s)
    if n <= _ATTITUDE_STARS:
        return None
    attitude = wahba(s, s_i, sigma)
    if attitude is None:
        return None
    e1 = np.column_stack([s[:, 2], np.zeros(n), -s[:, 0]])
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    e2 = np.cross(s, e1)
    off = s - s_i @ attitude.C.T
    r = np.concatenate([np.sum(e1 * off, axis=1), np.sum(e2 * off, axis=1)])
    A_w = np.concatenate([-np.einsum("na,nap->np", e1, G), -np.einsum("na,nap->np", e2, G)])
    A_theta = np.concatenate([-e2, e1])
    weight = np.tile(1.0 / sigma, 2)
    q, _ = np.linalg.qr(weight[:, None] * A_theta)
    r, A_w = weight * r, weight[:, None] * A_w
    r, A_w = r - q @ (q.T @ r), A_w - q @ (q.T @ A_w)
    r = r + A_w @ w
    return A_w.T @ A_w, A_w.T @ r, float(r @ r), 2 * n - 3
