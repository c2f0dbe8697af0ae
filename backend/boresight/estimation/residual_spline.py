"""What a camera model leaves over: a bicubic B-spline of displacement over the detector, with its strength and its uncertainty.

A star that the camera model puts at p is measured at p + d(p) + noise. Splined camera models (mrcal's) take such a surface for the
whole lens; here it is only what the fitted model x leaves, so that it shows where another model is needed, and how much.

Data
----
With r = centroid - projection of C_e s_i at the estimate, in pixels, each star of exposure e has

    r = B c + J dx + K w_e + noise of sigma,        B c = d(p), J = -dp/dx, K = -dp/dw            (`cramer_rao`, `pixel_rows`)

c are the coefficients of both axes, 16 of each touched by a star; dx what the free parameters may still move; w_e a rotation of the
exposure. Arclengths see no rotation: their 2n - 3 numbers with their full covariance say what the 2n centroids say with w_e left
free, so w_e is eliminated here for each exposure, and then dx, whose prior is flat. What is left of the normal equations,

    T = sum over stars of [B J r]^T [B J r] / sigma^2  -  sum_e Y_e^T Y_e,      Y_e = L_e^-1 K_e^T [B J r],  L_e L_e^T = K_e^T K_e
    M = T_BB - T_BJ T_JJ^+ T_JB         g = T_Br - T_BJ T_JJ^+ T_Jr,

holds the information M on c and its score g. Arcs would say the same at a higher price: whitening fills their rows.

Gauge. M sees no displacement that rotations or free parameters make, so c is shown as what remains beside the estimate: with dx
that goes with c, -T_JJ^+ T_JB c, and less the one rotation common to all exposures that makes it least over the stars,

    c_shown = Z c,      Z = I - b_J T_JJ^+ T_JB - b_K S^-1 (X_B - X_J T_JJ^+ T_JB),

with b_J, b_K the fields J and K written as splines, and X, S the products with the common rotation. Added to the camera at the
estimate it is the best prediction of where stars fall, up to a change of C_SD.

Prior
-----
c ~ N(0, tau Q^-1), with Q of the energy of a surface that is stiff beyond the longest wave fitting the detector, l = side / 2 pi,

    E = integral d^2 + 2 l^2 |grad d|^2 + l^4 |second derivatives of d|^2       (Lindgren, Rue & Lindstroem 2011, a Matern field)

of each axis, scaled so that tau is the mean square of d over the detector, px^2. In the basis in which Q is one and M diagonal, mu,
every z_i = u_i / sqrt(mu_i) is normal with variance 1 + tau mu_i, and evidence for a strength is

    log p(g | tau) = 1/2 sum z_i^2 tau mu_i / (1 + tau mu_i) - 1/2 sum log(1 + tau mu_i),

the restricted likelihood, for dx and w are integrated out of it. It goes to a constant as tau to 0, so one best strength would
often be zero with a sigma of zero. Instead strengths are averaged by their evidence, under a prior that is flat in the
displacement sqrt(tau) (Gelman 2006), and what they differ by is in the covariance:

    mean = sum_j p_j m_j                            m_j = tau u / (1 + tau mu)
    covariance = sum_j p_j (V_j + m_j m_j^T) - mean mean^T      V_j = tau / (1 + tau mu).

A place without stars has the sigma that neighbours leave it. Bands of this kind hold 95 % averaged over the detector, not
everywhere alike (Nychka 1988): the peak of a sharp feature is flattened, and a lens smoother than this prior has too wide a band.

Test
----
Where the model is right z is standard normal, and what is left of it is tested by the likelihood ratio against a fixed strength,

    Q = sum w_i z_i^2,      w_i = tau_0 mu_i / (1 + tau_0 mu_i).

tau_0 comes from the design alone, never from the data, so the law of Q under a right model is known exactly, a weighted sum of
chi-squares; its tail is taken by the saddlepoint (Kuonen 1999), within a few per cent of itself. tau_0 is the strength at
which the test at 1 % has about even odds, where King (1987) found such tests best. Noise larger than stated is no structure: with
s^2 the residual chi-square over its degrees of freedom, what is above one divides Q and M alike.

References
----------
Lindgren, Rue, Lindstroem, "An explicit link between Gaussian fields and Gaussian Markov random fields", J. R. Stat.
Soc. B 73, 2011.
Gelman, "Prior distributions for variance parameters in hierarchical models", Bayesian Analysis 1, 2006.
Nychka, "Bayesian confidence intervals for smoothing splines", J. Am. Stat. Assoc. 83, 1988.
King, "Towards a theory of point optimal testing", Econometric Reviews 6, 1987.
Kuonen, "Saddlepoint approximations for distributions of quadratic forms in normal variables", Biometrika 86, 1999.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.cameras import CameraModel
from boresight.cameras.model import Role
from boresight.estimation.arcs import ArcSet
from boresight.estimation.attitude import attitudes
from boresight.estimation.batch import determined
from boresight.estimation.blocks import in_blocks
from boresight.estimation.statistics.special import ndtr
from boresight.kernels.spline import pixel_rows, spline_sums

DEGREE = 3
#: Cells along the longer side, and fewest along the shorter.
CELLS, FEWEST_CELLS = 8, 4
#: Strengths that are averaged, and how far they reach below the weakest and above the strongest that the data could tell.
STRENGTHS, BELOW, ABOVE = 96, 1e-2, 1e3
#: Belief in a strength below which what it says differently is left out of the covariance.
NEGLIGIBLE = 1e-9
#: Deviate of the 1 % level, for the strength that the test is made for.
DEVIATE = 2.326
#: Values of M below this share of the largest are rounding: rotations and free parameters.
ROUNDING = 1e-11
#: Residuals beyond so many spreads of what spline and attitude leave take no part: wrong matches.
OUTLIER = 6.0
#: Sigma of a star left out over its own, for the attitude of its exposure.
UNHEARD = 1e4
#: Times that such stars are looked for.
ROUNDS = 4
_GAUSS = np.polynomial.legendre.leggauss(4)  # on a cell and axis: exact for products of cubics


@dataclass(frozen=True)
class Axis:
    """Cubic B-splines on equal cells along one axis: from the outer edge of the first pixel to that of the last."""

    pixels: int
    cells: int

    @property
    def low(self) -> float:
        """Outer edge of the first pixel."""
        return -0.5

    @property
    def step(self) -> float:
        """Length of a cell, pixels."""
        return self.pixels / self.cells

    @property
    def size(self) -> int:
        """Number of splines."""
        return self.cells + DEGREE

    @property
    def knots(self) -> FloatArray:
        """All knots, (cells + 7,), as `scipy.interpolate.BSpline` takes them."""
        return np.asarray(self.low + self.step * np.arange(-DEGREE, self.cells + DEGREE + 1), dtype=np.float64)

    def design(self, places: FloatArray, derivative: int = 0) -> FloatArray:
        """Values (n, size) of the splines, or of a derivative, at places (n,)."""
        cell = np.clip(np.floor((places - self.low) / self.step).astype(int), 0, self.cells - 1)
        t = (places - self.low) / self.step - cell
        values = _pieces(t, derivative) / self.step**derivative
        table = np.zeros((len(places), self.size))
        table[np.arange(len(places))[:, None], cell[:, None] + np.arange(DEGREE + 1)] = values
        return table

    @cached_property
    def gauss(self) -> tuple[FloatArray, FloatArray]:
        """Places and weights of Gauss's rule on every cell, (cells * 4,) each."""
        x, w = _GAUSS
        places = self.low + self.step * (np.arange(self.cells)[:, None] + (x + 1) / 2)
        return places.ravel(), np.tile(w * self.step / 2, self.cells)


def _pieces(t: FloatArray, derivative: int) -> FloatArray:
    """The four cubics of a cell, (n, 4), or their derivatives by t."""
    cubics = np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6
    for _ in range(derivative):
        cubics = cubics[:, 1:] * np.arange(1, cubics.shape[1])
    powers = np.stack([t**k for k in range(cubics.shape[1])], axis=1)
    return np.asarray(powers @ cubics.T, dtype=np.float64)


def axes(rows: int, columns: int) -> tuple[Axis, Axis]:
    """Cells of a detector, nearly square."""
    longer = max(rows, columns)
    counts = (max(FEWEST_CELLS, round(CELLS * pixels / longer)) for pixels in (rows, columns))
    return Axis(rows, next(counts)), Axis(columns, next(counts))


@dataclass(frozen=True)
class Surface:
    """A displacement of both axes as a bicubic spline over the detector.

    Parameters
    ----------
    row, col
        The splines along either axis.
    coefficients
        (2, row.size, col.size) of the displacement of row and of column, pixels.
    """

    row: Axis
    col: Axis
    coefficients: FloatArray

    def __call__(self, row_px: FloatArray, col_px: FloatArray) -> FloatArray:
        """Displacement (n, 2), row and column, pixels, at places (n,); the outermost cells go on beyond the edges."""
        along, across = self.row.design(row_px), self.col.design(col_px)
        return np.asarray(np.einsum("ni,aij,nj->na", along, self.coefficients, across))


@cache
def whitener(row: Axis, col: Axis) -> FloatArray:
    """L^-1 (m, m) of one axis of displacement, with Q = L L^T scaled so that the mean variance over the detector is 1 px^2."""
    length = max(row.pixels, col.pixels) / (2 * np.pi)
    products = [[_products(axis, k) for k in range(3)] for axis in (row, col)]
    (r0, r1, r2), (c0, c1, c2) = products
    Q = np.kron(r0, c0) + 2 * length**2 * (np.kron(r1, c0) + np.kron(r0, c1))
    Q += length**4 * (np.kron(r2, c0) + 2 * np.kron(r1, c1) + np.kron(r0, c2))
    inverse = np.linalg.inv(np.linalg.cholesky(Q))
    variance = np.sum((inverse @ np.kron(r0, c0)) * inverse) / (row.pixels * col.pixels)
    return np.asarray(inverse / np.sqrt(variance))


def _products(axis: Axis, derivative: int) -> FloatArray:
    """Integrals of products of two splines' derivatives, (size, size)."""
    places, weights = axis.gauss
    table = axis.design(places, derivative)
    return np.asarray(table.T @ (weights[:, None] * table))


def write_as_spline(row: Axis, col: Axis, field: FloatArray) -> FloatArray:
    """Coefficients (2 m, k), of least squares over the detector, of fields (n, 2, k) at the `gauss_places`."""
    at = field.reshape(len(row.gauss[0]), len(col.gauss[0]), 2, -1)
    found = np.einsum("ri,cj,ijak->arck", _fitting(row), _fitting(col), at, optimize=True)
    return np.asarray(found.reshape(2 * row.size * col.size, -1))


@cache
def _fitting(axis: Axis) -> FloatArray:
    """Coefficients of least squares (size, cells * 4) of each value at the places of Gauss's rule."""
    places, weights = axis.gauss
    return np.asarray(np.linalg.solve(_products(axis, 0), axis.design(places).T * weights))


def gauss_places(row: Axis, col: Axis) -> tuple[FloatArray, FloatArray]:
    """Rows and columns (n,) of the places at which fields are written as splines."""
    at = np.meshgrid(row.gauss[0], col.gauss[0], indexing="ij")
    return at[0].ravel(), at[1].ravel()


@dataclass(frozen=True)
class PixelRows:
    """Derivatives of the places of stars.

    `tangents`: (n, 2). `J`: (n, 2, n_parameters) pixels a unit. `K`: (n, 2, 3) pixels a radian. `slope`: (n, 2, 2) pixels a unit
    of the tangents.
    """

    tangents: FloatArray
    J: FloatArray
    K: FloatArray
    slope: FloatArray


def find_pixel_rows(
    camera: CameraModel, x: FloatArray, pitch: float, row_px: FloatArray, col_px: FloatArray
) -> PixelRows:
    """Linearise a camera at places (n,)."""
    s, D = camera.directions_and_jacobian(x, row_px, col_px, pitch)
    J, K, slope = np.empty((len(s), 2, len(x))), np.empty((len(s), 2, 3)), np.empty((len(s), 2, 2))
    pixel_rows(s, D, camera.place(Role.ROW), camera.place(Role.COLUMN), J, K, slope)
    return PixelRows(s[:, :2] / s[:, 2:], J, K, slope)


@dataclass(frozen=True)
class Data:
    """What the stars say of a spline, with rotations and free parameters eliminated; see the module's derivation.

    Parameters
    ----------
    row, col
        The splines.
    M, g
        (2 m, 2 m) information and (2 m,) score, 1/px^2 and 1/px.
    Z
        (2 m, 2 m) from coefficients to those that are shown.
    chi2, dof
        Of the residuals without a spline.
    r
        (n_stars, 2) residuals, pixels; NaN without an attitude.
    stars
        How many took part.
    """

    row: Axis
    col: Axis
    M: FloatArray
    g: FloatArray
    Z: FloatArray
    chi2: float
    dof: int
    r: FloatArray
    stars: int


def gather(
    arcs: ArcSet,
    camera: CameraModel,
    x: FloatArray,
    free: IntArray,
    scale: FloatArray,
    *,
    parity: int,
    detector: tuple[int, int],
    kept: BoolArray | None = None,
) -> Data:
    """Pass over all stars of a set.

    Parameters
    ----------
    x
        (n_parameters,) the estimate, SI.
    free, scale
        (n_free,) places and typical sigmas of the free parameters.
    parity, detector
        Of the sensor; rows and columns.
    kept
        (n_stars,) which take part; all when None.
    """
    row, col = axes(*detector)
    m, n = row.size * col.size, len(free)
    weight = arcs.sigma_px**-2.0 if kept is None else np.where(kept, arcs.sigma_px**-2.0, 0.0)
    r = np.empty((arcs.n_stars, 2))

    def add(first: int, last: int) -> tuple[FloatArray, ...]:
        part = arcs.frames(first, last)
        stars = slice(*(int(arcs.star_start[arcs.frame_start[frame]]) for frame in (first, last)))
        rows = find_pixel_rows(camera, x, arcs.pitch, part.row_px, part.col_px)
        r[stars] = _residuals(part, rows, weight[stars], parity)
        G, F, H = np.zeros((m, m)), np.zeros((2 * m, n + 1)), np.zeros((n + 1, n + 1))
        Y, X, S = np.empty((part.n_exposures, 3, 2 * m + n + 1)), np.zeros((3, 2 * m + n + 1)), np.zeros((3, 3))
        places = ((axis.low, axis.step, axis.cells) for axis in (row, col))
        spline_sums(
            part.star_start, part.row_px, part.col_px, weight[stars], r[stars], rows.J, rows.K, *places, np.empty((2, 4)),
            np.empty(n + 1), free, scale, G, F, H, Y, X, S,
        )  # fmt: skip
        taken = Y.reshape(-1, 2 * m + n + 1)
        return G, F, H, taken.T @ taken, X, S

    G, F, H, taken, X, S = (sum(parts) for parts in zip(*in_blocks(add, arcs.n_frames), strict=True))
    T = _assembled(np.asarray(G), np.asarray(F), np.asarray(H)) - np.asarray(taken)
    used = np.isfinite(r[:, 0]) & (weight > 0)
    counts = np.add.reduceat(used, arcs.star_start[:-1], dtype=np.int64)
    stars = int(counts[counts >= 3].sum())
    B, J, last = slice(0, 2 * m), slice(2 * m, 2 * m + n), 2 * m + n
    values, vectors, known = determined(T[J, J])
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T
    S = np.asarray(S) + np.tril(np.asarray(S), -1).T
    follows = inverse @ T[J, B]  # -dx that goes with c
    places_row, places_col = gauss_places(row, col)
    rows = find_pixel_rows(camera, x, arcs.pitch, places_row, places_col)
    b_J = write_as_spline(row, col, rows.J[:, :, free] * scale)
    b_K = write_as_spline(row, col, rows.K)
    X = np.asarray(X)
    turn = np.linalg.solve(S, X[:, B] - X[:, J] @ follows)
    return Data(
        row, col, T[B, B] - T[B, J] @ follows, T[B, last] - follows.T @ T[J, last],
        np.eye(2 * m) - b_J @ follows - b_K @ turn, float(T[last, last] - T[last, J] @ inverse @ T[J, last]),
        2 * stars - 3 * int(np.sum(counts >= 3)) - int(known.sum()), r, stars,
    )  # fmt: skip


def _residuals(part: ArcSet, rows: PixelRows, weight: FloatArray, parity: int) -> FloatArray:
    """Centroids less projected catalogue (n_stars, 2), pixels, under the attitude that those with a weight (n_stars,) give."""
    t = rows.tangents
    s = np.column_stack([t, np.ones(len(t))]) / np.sqrt(1 + np.sum(t * t, axis=1))[:, None]
    sigma = np.where(weight > 0, 1.0, UNHEARD) * part.sigma_px
    solved = attitudes(part.star_start, s, part.s_i, sigma / sigma.min(), parity)
    C = np.repeat(solved.C, np.diff(part.star_start), axis=0)
    turned = np.einsum("nij,nj->ni", C, part.s_i)
    sky = turned[:, :2] * np.array([1.0, float(parity)]) / turned[:, 2:]
    return np.asarray(np.einsum("nij,nj->ni", rows.slope, t - sky))


def _assembled(G: FloatArray, F: FloatArray, H: FloatArray) -> FloatArray:
    """The sums as one symmetric matrix over [row splines, column splines, parameters, r]."""
    m, n = len(G), len(H)
    T = np.zeros((2 * m + n, 2 * m + n))
    T[:m, :m] = T[m : 2 * m, m : 2 * m] = np.tril(G) + np.tril(G, -1).T
    T[: 2 * m, 2 * m :], T[2 * m :, : 2 * m] = F, F.T
    T[2 * m :, 2 * m :] = H + np.tril(H, -1).T
    return T


@dataclass(frozen=True)
class Spectrum:
    """Data in the basis in which the prior is white and the information diagonal.

    Parameters
    ----------
    basis
        (2 m, k) coefficients of each direction, px.
    mu, u
        (k,) information and score of each.
    """

    basis: FloatArray
    mu: FloatArray
    u: FloatArray

    @property
    def z(self) -> FloatArray:
        """(k,) scores over their sigmas; zero where there is no information."""
        return np.asarray(np.divide(self.u, np.sqrt(self.mu), out=np.zeros_like(self.u), where=self.mu > 0))


def find_spectrum(row: Axis, col: Axis, M: FloatArray, g: FloatArray) -> Spectrum:
    """Diagonalise information M (2 m, 2 m) against the prior, with the score g (2 m,)."""
    inverse, m = whitener(row, col), row.size * col.size
    L = np.zeros((2 * m, 2 * m))
    L[:m, :m] = L[m:, m:] = inverse
    A = L @ M @ L.T
    values, vectors = np.linalg.eigh((A + A.T) / 2)
    basis = L.T @ vectors
    mu = np.where(values > ROUNDING * values[-1], values, 0.0)
    return Spectrum(basis, mu, np.where(mu > 0, g @ basis, 0.0))


def point_optimal_weights(mu: FloatArray) -> FloatArray:
    """Weights w (k,) of the test; of nothing but the design."""
    low, high = 1e-12 / mu.max(), 1e12 / mu.max()
    for _ in range(40):  # 24 decades to a ten thousandth of one
        tau = np.sqrt(low * high)
        w = tau * mu / (1 + tau * mu)
        enough = np.sum(tau * mu * w) > DEVIATE * np.sqrt(2 * np.sum(w * w))
        low, high = (low, tau) if enough else (tau, high)
    return np.asarray(w)


def quadratic_tail(q: float, w: FloatArray) -> float:
    """Chance that sum w_i chi_i^2 of standard normals exceeds q, by the saddlepoint (Kuonen 1999)."""
    w = w[w > 0]
    mean = w.sum()
    if q <= 0 or not len(w):
        return 1.0
    if abs(q - mean) < 1e-3 * np.sqrt(2 * np.sum(w * w)):  # the formula is 0/0 there: take the mean of either side
        off = 2e-3 * np.sqrt(2 * np.sum(w * w))
        return 0.5 * (quadratic_tail(mean - off, w) + quadratic_tail(mean + off, w))
    low, high = (0.0, 0.5 / w.max() * (1 - 1e-14)) if q > mean else (-len(w) / q, 0.0)
    for _ in range(60):
        t = 0.5 * (low + high)
        low, high = (t, high) if np.sum(w / (1 - 2 * t * w)) < q else (low, t)
    K = -0.5 * np.sum(np.log1p(-2 * t * w))
    curvature = 2 * np.sum((w / (1 - 2 * t * w)) ** 2)
    a = np.sign(t) * np.sqrt(2 * (t * q - K))
    v = t * np.sqrt(curvature)
    return float(np.clip(ndtr(-(a + np.log(v / a) / a)), 0.0, 1.0))


@dataclass(frozen=True)
class Test:
    """The test of a right model: Q, its mean where the model is right, and the chance of a Q as large then."""

    __test__ = False  # no test of the suite

    statistic: float
    expected: float
    p: float


def judge_spectrum(spectrum: Spectrum, variance: float) -> Test:
    """Test whether there is anything left, with noise of so many times the stated variance."""
    w = point_optimal_weights(spectrum.mu)
    statistic = float(np.sum(w * spectrum.z**2)) / variance
    return Test(statistic, float(w.sum()), quadratic_tail(statistic, w))


@dataclass(frozen=True)
class Posterior:
    """What the data leave to believe of the displacement.

    Parameters
    ----------
    surface
        Its mean, as shown.
    factor
        (2 m, k) with covariance = factor factor^T, of the coefficients as shown, px^2.
    strength_px
        sqrt(tau) of the largest evidence: root mean square displacement that the prior then expects.
    effective
        Degrees of freedom that the mean takes.
    variance
        Noise over the stated noise, at least one.
    test
        Whether there is anything at all.
    """

    surface: Surface
    factor: FloatArray
    strength_px: float
    effective: float
    variance: float
    test: Test

    def covariance(self, row_px: FloatArray, col_px: FloatArray) -> FloatArray:
        """Covariance (n, 2, 2) of the displacement at places (n,), px^2."""
        row, col = self.surface.row, self.surface.col
        both = np.einsum("ni,nj->nij", row.design(row_px), col.design(col_px)).reshape(len(row_px), -1)
        at = np.stack([both @ part for part in np.split(self.factor, 2)], axis=1)
        return np.asarray(at @ at.transpose(0, 2, 1))


def infer(data: Data, spectrum: Spectrum | None = None) -> Posterior:
    """Average over strengths by their evidence."""
    spectrum = spectrum or find_spectrum(data.row, data.col, data.M, data.g)
    variance = 1.0
    for _ in range(3):  # the noise follows from what the spline leaves, which hardly depends on it
        tau, p, gains = _strengths(spectrum, variance)
        mean = (p @ gains) * spectrum.u / variance
        effective = float(p @ gains @ spectrum.mu) / variance
        rest = data.chi2 - float(np.sum(2 * spectrum.u * mean - spectrum.mu * mean**2))
        variance = max(1.0, rest / max(data.dof - effective, 1.0))
    held = p > NEGLIGIBLE
    each = np.sqrt(p[held])[:, None] * (gains[held] * spectrum.u / variance - mean)
    shown = data.Z @ spectrum.basis
    coefficients = (shown @ mean).reshape(2, data.row.size, data.col.size)
    factor = np.concatenate([shown * np.sqrt(p @ gains), shown @ each.T], axis=1)
    return Posterior(
        Surface(data.row, data.col, coefficients), factor, float(np.sqrt(tau[np.argmax(p / np.sqrt(tau))])), effective, variance,
        judge_spectrum(spectrum, variance),
    )  # fmt: skip


def _strengths(spectrum: Spectrum, variance: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Strengths tau (n,), the belief in each (n,), and tau / (1 + tau mu) (n, k)."""
    mu = spectrum.mu / variance
    z2 = spectrum.z**2 / variance
    amplitude = np.geomspace(BELOW, ABOVE * max(1.0, np.sqrt(z2.max())), STRENGTHS) / np.sqrt(mu.max())
    tau = amplitude**2
    gains = tau[:, None] / (1 + tau[:, None] * mu)
    log_marginal_likelihood = 0.5 * (gains * mu) @ z2 - 0.5 * np.log1p(tau[:, None] * mu).sum(axis=1)
    belief = (
        np.exp(log_marginal_likelihood - log_marginal_likelihood.max()) * amplitude
    )  # flat in the amplitude, taken at equal steps of its logarithm
    return tau, belief / belief.sum(), gains


@dataclass(frozen=True)
class Fit:
    """A spline with what it was made of; `left_out` (n_stars,) are taken for wrong matches."""

    data: Data
    spectrum: Spectrum
    posterior: Posterior
    left_out: BoolArray


def fit(
    arcs: ArcSet,
    camera: CameraModel,
    x: FloatArray,
    free: IntArray,
    scale: FloatArray,
    *,
    parity: int,
    detector: tuple[int, int],
) -> Fit:
    """Fit the spline of what a camera leaves, without stars that are far off whatever the spline; the arguments are `gather`'s."""
    left_out = np.zeros(arcs.n_stars, np.bool_)
    for _ in range(ROUNDS):
        data = gather(arcs, camera, x, free, scale, parity=parity, detector=detector, kept=~left_out)
        spectrum = find_spectrum(data.row, data.col, data.M, data.g)
        posterior = infer(data, spectrum)
        far = _far_off(data, posterior, arcs, left_out)
        if not far.any():
            break
        left_out = left_out | far
    return Fit(data, spectrum, posterior, left_out)


def _far_off(data: Data, posterior: Posterior, arcs: ArcSet, left_out: BoolArray) -> BoolArray:
    """Stars (n_stars,) far off what spline and attitudes leave of the others.

    The worst of an exposure alone, for it drags the attitude and by that its neighbours; only where a residual is that large is the
    spline asked.
    """
    off = np.abs(data.r / arcs.sigma_px[:, None])
    spread = max(1.0, float(np.nanmedian(off)) / 0.67449)
    found = np.zeros(arcs.n_stars, np.bool_)
    if not np.nanmax(off) > OUTLIER * spread:
        return found
    off = np.abs(data.r - posterior.surface(arcs.row_px, arcs.col_px)) / arcs.sigma_px[:, None]
    spread = max(1.0, float(np.nanmedian(off)) / 0.67449)
    size = np.where(np.isfinite(off).all(axis=1) & ~left_out, off.max(axis=1), 0.0)
    worst = np.maximum.reduceat(size, arcs.star_start[:-1])
    return np.asarray((size > OUTLIER * spread) & (size == np.repeat(worst, np.diff(arcs.star_start))))
