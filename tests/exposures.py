"""Single exposures for the tests of the matching loops: stars measured without noise, and where an error would put them."""

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.kernels import matching
from tests.compiled import CompiledParts
from tests.estimation.fields import COLUMNS, GROUND, NOISE_PX, PITCH, ROWS, SCALE

loops = CompiledParts(matching)

SIGMA = NOISE_PX * PITCH / GROUND[0]
ROOT = np.diag(3.0 * SCALE)
GATE = 4.5
#: No error y = (theta, w) of attitude and parameters.
RIGHT = np.zeros(11)


class Exposure:
    def __init__(self, rng, n=12, spread=1.0):
        middle = np.array([(ROWS - 1) / 2, (COLUMNS - 1) / 2])
        self.pixels = middle + spread * (rng.uniform(size=(n, 2)) - 0.5) * [ROWS, COLUMNS]
        s, jacobian = INVERTED_WANG.directions_and_jacobian(GROUND, *self.pixels.T, PITCH)
        self.s, self.G = np.ascontiguousarray(s), np.ascontiguousarray(jacobian @ ROOT)
        self.sigma = np.full(n, SIGMA)
        self.A, self.T = np.empty((n, 2, 11)), np.empty((n, 2, 3))
        loops._rows(self.s, self.G, self.A, self.T)
        self.C = Rotation.random(rng=rng).as_matrix()

    def stars(self, y=RIGHT):
        true = INVERTED_WANG.directions(GROUND + ROOT @ y[3:], *self.pixels.T, PITCH)
        return true @ Rotation.from_rotvec(-y[:3]).as_matrix() @ self.C

    def information(self, use, y=RIGHT):
        weight = 1 / (self.sigma**2 + loops._CURVATURE**2 * np.sum((self.A @ y) ** 2, axis=1))
        Lambda = np.diag([loops._DIFFUSE] * 3 + [1.0] * 8)
        Lambda += np.einsum("n,nri,nrj->ij", weight[use], self.A[use], self.A[use])
        return Lambda, np.einsum("n,nri,nr->i", weight[use], self.A[use], (self.A @ y)[use])
