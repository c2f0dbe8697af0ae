"""The spline of what a camera leaves over: against dense NumPy with SciPy's splines, its test, its band, lenses it must see."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import BSpline, NdBSpline
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

from boresight.cameras import CAMERA_MODELS
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch
from boresight.estimation import residual_spline as rs
from boresight.estimation.residual_spline import Axis, Surface
from tests.effort import effort
from tests.estimation.fields import drawn

ROWS, COLUMNS = 1536, 2048
DETECTOR = (ROWS, COLUMNS)
PITCH = 2.2e-6
NOISE_PX = 0.1
BROWN = CAMERA_MODELS["brown_conrady"]
PINHOLE = CAMERA_MODELS["pinhole_radial"]
PLAIN = np.array([1.0002, 6000.0 * PITCH, 1030.0, 760.0, -0.1, 0.1, 0.0, 0.0, 0.0])
#: Tangential distortion of 0.3 px in the corner.
TANGENTIAL = PLAIN + np.array([0, 0, 0, 0, 0, 0, 3.5e-4, -2.5e-4, 0])
BROWN_SCALE = np.array([2e-4, 3.0 * PITCH, 10.0, 10.0, 1e-2, 0.1, 1e-3, 1e-3, 1.0])
PINHOLE_SCALE = np.array([2e-4, 3.0 * PITCH, 10.0, 10.0, 1e-2, 0.1])


def field(rng, truth=PLAIN, exposures=120, stars=16.0, noise_px=NOISE_PX, camera=BROWN):
    starts, *seen = drawn(rng, camera, truth, PITCH, DETECTOR, exposures, stars, noise_px)
    star_start, s_i = np.array(starts), seen[2]
    places, _ = arcsets.order(star_start, s_i)
    return arcsets.ArcSet(
        camera=camera,
        pitch=PITCH,
        frame=np.arange(exposures),
        frame_start=np.arange(exposures + 1),
        star_start=star_start,
        row_px=seen[0][places],
        col_px=seen[1][places],
        sigma_px=np.full(len(places), noise_px),
        s_i=np.ascontiguousarray(s_i[places]),
        source_row=places,
        phi=np.empty(0),
        band=np.empty((0, 5)),
    )


def fitted(arcs, camera, x0, scale):
    arcs, free = replace(arcs, camera=camera), np.arange(len(x0))
    for _ in range(2):
        found = batch.fit(
            arcsets.whiten(arcs, arcsets.angular_sigma(camera, x0, arcs))[0], x0, free, scale, max_iterations=20
        )
        x0 = found.x
    return arcs, x0


def left_by(arcs, camera, x0, scale, kept=None):
    arcs, x = fitted(arcs, camera, x0, scale)
    data = rs.gather(arcs, camera, x, np.arange(len(x)), scale, parity=1, detector=DETECTOR, kept=kept)
    return arcs, x, data


def test_the_splines_and_their_derivatives_are_scipy_s():
    axis = Axis(1000, 7)
    places = np.random.default_rng(1).uniform(-0.5, 999.5, 200)
    for derivative in range(3):
        mine = axis.design(places, derivative)
        for k in range(axis.size):
            spline = BSpline(axis.knots, np.eye(axis.size)[k], 3)
            np.testing.assert_allclose(mine[:, k], spline(places, nu=derivative), atol=1e-14)


def test_a_surface_is_scipy_s_tensor_spline():
    rng = np.random.default_rng(2)
    row, col = rs.axes(*DETECTOR)
    surface = Surface(row, col, rng.normal(size=(2, row.size, col.size)))
    places = rng.uniform((-0.5, -0.5), (ROWS - 0.5, COLUMNS - 0.5), (100, 2))
    peer = NdBSpline((row.knots, col.knots), np.moveaxis(surface.coefficients, 0, -1), 3)
    np.testing.assert_allclose(surface(*places.T), peer(places), atol=1e-13)


def test_the_prior_s_energy_is_the_integral_of_its_definition_and_its_mean_variance_one():
    row, col = Axis(600, 4), Axis(900, 5)
    inverse = rs.whitener(row, col)
    Q = np.linalg.inv(inverse.T @ inverse)
    rng, length = np.random.default_rng(3), 900 / (2 * np.pi)
    c = rng.normal(size=(row.size, col.size))
    spline = NdBSpline((row.knots, col.knots), c, 3)
    x, w = np.polynomial.legendre.leggauss(40)
    at = [(axis.low + axis.step * (np.arange(axis.cells)[:, None] + (x + 1) / 2)).ravel() for axis in (row, col)]
    weights = [np.tile(w * axis.step / 2, axis.cells) for axis in (row, col)]
    grid = np.stack(np.meshgrid(*at, indexing="ij"), axis=-1)

    def squares(*nu):
        return weights[0] @ spline(grid, nu=nu) ** 2 @ weights[1]

    energy = squares(0, 0) + 2 * length**2 * (squares(1, 0) + squares(0, 1))
    energy += length**4 * (squares(2, 0) + 2 * squares(1, 1) + squares(0, 2))
    ratio = (c.ravel() @ Q @ c.ravel()) / energy

    values = np.kron(row.design(at[0]), col.design(at[1])) @ inverse.T
    variance = np.sum(values**2, axis=1).reshape(len(at[0]), -1)
    assert weights[0] @ variance @ weights[1] / (600 * 900) == pytest.approx(1.0, rel=1e-9)
    other = rng.normal(size=c.size)
    spline = NdBSpline((row.knots, col.knots), other.reshape(c.shape), 3)
    again = squares(0, 0) + 2 * length**2 * (squares(1, 0) + squares(0, 1))
    again += length**4 * (squares(2, 0) + 2 * squares(1, 1) + squares(0, 2))
    assert other @ Q @ other == pytest.approx(ratio * again, rel=1e-9)


def dense(arcs, camera, x, scale, row, col):
    """Whitened rows [B, J, K of every exposure] and r, derivatives by differences of the projection."""
    sigma = arcs.sigma_px[:, None]
    places = np.stack([arcs.row_px, arcs.col_px], axis=1)
    s_d = camera.directions(x, arcs.row_px, arcs.col_px, arcs.pitch)

    def predicted(x, turns):
        s = np.concatenate(
            [
                Rotation.from_rotvec(turn).apply(s)
                for turn, s in zip(turns, np.split(sky, arcs.star_start[1:-1]), strict=True)
            ]
        )
        return np.stack(camera.project(x, s, arcs.pitch), axis=1)

    found = [
        Rotation.align_vectors(s_d[a:b], arcs.s_i[a:b])[0].apply(arcs.s_i[a:b])
        for a, b in zip(arcs.star_start[:-1], arcs.star_start[1:], strict=True)
    ]
    sky, still = np.concatenate(found), np.zeros((arcs.n_exposures, 3))
    columns = []
    for p in range(len(x)):
        step = np.eye(len(x))[p] * scale * 1e-3
        columns.append((predicted(x + step, still) - predicted(x - step, still)) / 2e-3)
    for e in range(arcs.n_exposures):
        for axis in range(3):
            turn = still.copy()
            turn[e, axis] = 1e-5
            columns.append((predicted(x, turn) - predicted(x, -turn)) / 2e-5)
    table = BSpline.design_matrix(arcs.row_px, row.knots, 3), BSpline.design_matrix(arcs.col_px, col.knots, 3)
    b = np.einsum("ni,nj->nij", *(one.toarray() for one in table)).reshape(len(places), -1)
    zero = np.zeros_like(b)
    B = np.stack([np.concatenate([b, zero], axis=1), np.concatenate([zero, b], axis=1)], axis=1)
    others = np.stack(columns, axis=-1)
    r = places - predicted(x, still)
    return (np.reshape(v / sigma[..., None], (-1, v.shape[-1])) for v in (B, others, r[..., None]))


def test_information_and_score_are_those_of_dense_least_squares_with_every_attitude_and_parameter_free():
    rng = np.random.default_rng(4)
    arcs, x, data = left_by(
        field(rng, exposures=10, stars=20.0, noise_px=1e-3), PINHOLE, PLAIN[:6], PINHOLE_SCALE
    )  # noise so small that linearising at the centroid or at its star is the same
    B, others, r = dense(arcs, PINHOLE, x, PINHOLE_SCALE, data.row, data.col)
    u, size, _ = np.linalg.svd(others / np.linalg.norm(others, axis=0), full_matrices=False)
    u = u[:, size > 1e-8]
    B_left, r_left = B - u @ (u.T @ B), r - u @ (u.T @ r)
    M, g = B_left.T @ B_left, (B_left.T @ r_left)[:, 0]
    size = np.abs(M).max()
    np.testing.assert_allclose(data.M / size, M / size, atol=1e-6)
    np.testing.assert_allclose(data.g / np.abs(g).max(), g / np.abs(g).max(), atol=1e-4)
    assert data.chi2 == pytest.approx(np.sum(r_left**2), rel=1e-3)
    assert data.dof == len(r) - u.shape[1]


def test_the_posterior_is_the_average_of_dense_solutions_over_strengths():
    rng = np.random.default_rng(5)
    _, _, data = left_by(field(rng, TANGENTIAL), PINHOLE, PLAIN[:6], PINHOLE_SCALE)
    spectrum = rs.find_spectrum(data.row, data.col, data.M, data.g)
    found = rs.infer(data, spectrum)
    inverse = rs.whitener(data.row, data.col)
    Q = np.kron(np.eye(2), np.linalg.inv(inverse.T @ inverse))
    M, g = data.M / found.variance, data.g / found.variance
    amplitude = np.geomspace(1e-4, 30.0, 300)
    means, covariances, evidence = [], [], []
    for a in amplitude:
        P = np.linalg.inv(M + Q / a**2)
        means.append(P @ g)
        covariances.append(P)
        # log p(g | tau) by the determinant of the marginal covariance, up to what does not depend on it
        evidence.append(0.5 * g @ P @ g + 0.5 * (np.linalg.slogdet(P)[1] + np.linalg.slogdet(Q / a**2)[1]))
    p = np.exp(np.array(evidence) - np.max(evidence)) * amplitude
    p /= p.sum()
    mean = np.einsum("j,jk->k", p, means)
    covariance = np.einsum("j,jkl->kl", p, covariances)
    covariance += np.einsum("j,jk,jl->kl", p, means - mean, means - mean)
    places = rng.uniform((0, 0), DETECTOR, (40, 2)).T
    shown = Surface(data.row, data.col, (data.Z @ mean).reshape(2, data.row.size, data.col.size))
    np.testing.assert_allclose(found.surface(*places), shown(*places), atol=2e-4)
    b = np.kron(
        np.eye(2), np.einsum("ni,nj->nij", data.row.design(places[0]), data.col.design(places[1])).reshape(40, -1)
    )
    dense_sigma = np.sqrt(np.diag(b @ data.Z @ covariance @ data.Z.T @ b.T)).reshape(2, 40).T
    sigma = np.sqrt(np.diagonal(found.covariance(*places), axis1=1, axis2=2))
    np.testing.assert_allclose(sigma, dense_sigma, rtol=0.02)
    assert found.strength_px == pytest.approx(amplitude[np.argmax(evidence)], rel=0.15)


def test_a_displacement_that_rotation_or_a_free_parameter_makes_is_not_seen_and_not_shown():
    rng = np.random.default_rng(6)
    _, x, data = left_by(field(rng), PINHOLE, PLAIN[:6], PINHOLE_SCALE)
    places = rs.gauss_places(data.row, data.col)
    rows = rs.find_pixel_rows(PINHOLE, x, PITCH, *places)
    explained = rs.write_as_spline(
        data.row, data.col, np.concatenate([rows.J * PINHOLE_SCALE, rows.K / 6000.0], axis=-1)
    )
    at = rng.uniform((0, 0), DETECTOR, (50, 2)).T
    for coefficients in explained.T:

        def size(c):
            return np.abs(Surface(data.row, data.col, c.reshape(2, data.row.size, -1))(*at)).max()

        assert coefficients @ data.M @ coefficients < 1e-4 * data.chi2 * size(coefficients) ** 2
        assert size(data.Z @ coefficients) < 2e-3 * size(coefficients)


def test_the_tail_of_a_weighted_sum_of_chi_squares_is_that_of_its_special_cases_and_of_imhof_s_integral():
    for dof in (1, 5, 40):
        for q in chi2.ppf([0.2, 0.5, 0.9, 0.99, 1 - 1e-6], dof):
            assert rs.quadratic_tail(2.5 * q, np.full(dof, 2.5)) == pytest.approx(
                chi2.sf(q, dof), rel=0.1 if dof == 1 else 0.02
            )
    w = np.array([1.0, 0.5, 0.3, 0.1, 0.1, 0.02])
    for q in (1.0, 2.0, 5.0, 9.0):

        def integrand(t, q=q):
            return np.sin(0.5 * (np.arctan(w * t).sum() - q * t)) / (t * np.prod((1 + (w * t) ** 2) ** 0.25))

        imhof = 0.5 + quad(integrand, 0, 400, limit=2000)[0] / np.pi
        assert rs.quadratic_tail(q, w) == pytest.approx(imhof, rel=0.05, abs=1e-4)


@pytest.mark.full
def test_with_the_right_model_it_claims_something_at_the_stated_rate():
    n = effort(60, 400)
    p = np.array([
        rs.infer(left_by(field(np.random.default_rng([7, k]), TANGENTIAL, 60), BROWN, TANGENTIAL, BROWN_SCALE)[2]).test.p
        for k in range(n)
    ])  # fmt: skip
    # the noise is never taken smaller than stated, so p is a little too large; hence no limit on large values
    assert np.sum(p < 0.01) <= 1 + 0.01 * n + 3 * np.sqrt(0.01 * n)
    assert kstest(p, "uniform", alternative="greater").pvalue > 0.005
    assert 0.02 <= np.mean(p < 0.1) <= 0.18


def left_over(x, truth, camera, true_camera, places):
    """Where the true camera shows a star less where the fitted one does, at places of the detector."""
    s = true_camera.directions(truth, *places, PITCH)
    return np.stack(places, axis=1) - np.stack(camera.project(x, s, PITCH), axis=1)


def shown_truth(data, x, truth):
    """The displacement that is there, in the gauge that is shown."""
    places = rs.gauss_places(data.row, data.col)
    truth_px = left_over(x, truth, PINHOLE, BROWN, places)
    shown = data.Z @ rs.write_as_spline(data.row, data.col, truth_px[..., None])[:, 0]
    return Surface(data.row, data.col, shown.reshape(2, data.row.size, -1))


GRID = tuple(
    at.ravel() for at in np.meshgrid(np.linspace(0, ROWS - 1, 13), np.linspace(0, COLUMNS - 1, 17), indexing="ij")
)


def test_tangential_distortion_under_a_radial_model_is_recovered_within_three_sigma():
    n = effort(6, 60)
    inside, coverage, largest = [], [], []
    for k in range(n):
        _, x, data = left_by(field(np.random.default_rng([8, k]), TANGENTIAL), PINHOLE, PLAIN[:6], PINHOLE_SCALE)
        found = rs.infer(data)
        assert found.test.p < 1e-6
        truth = shown_truth(data, x, TANGENTIAL)(*GRID)
        z = (found.surface(*GRID) - truth) / np.sqrt(np.diagonal(found.covariance(*GRID), axis1=1, axis2=2))
        inside.append(np.mean(np.abs(z) < 3))
        coverage.append(np.mean(np.abs(z) < 1.96))
        largest.append(np.abs(truth).max())
        # the spline halves what is left many times over
        assert np.sqrt(np.mean((found.surface(*GRID) - truth) ** 2)) < 0.5 * np.sqrt(np.mean(truth**2))
    assert np.mean(largest) > 0.05
    assert np.mean(inside) > 0.985
    assert np.mean(coverage) > 0.93  # a lens is smoother than the prior thinks, so the band is wide for it


def test_the_band_of_displacements_drawn_from_the_prior_holds_95_per_cent():
    rng = np.random.default_rng(9)
    _, _, data = left_by(field(rng), PINHOLE, PLAIN[:6], PINHOLE_SCALE)
    spectrum = rs.find_spectrum(data.row, data.col, data.M, data.g)
    coverage = []
    for _ in range(effort(60, 400)):
        strength = 10 ** rng.uniform(-1.5, 0)
        a = strength * rng.normal(size=len(spectrum.mu))
        u = spectrum.mu * a + np.sqrt(spectrum.mu) * rng.normal(size=len(a))
        noise = u - spectrum.mu * a
        told = spectrum.mu > 0
        chi = rng.chisquare(data.dof - told.sum()) + np.sum(noise[told] ** 2 / spectrum.mu[told])
        chi += np.sum(2 * noise * a + spectrum.mu * a**2)
        found = rs.infer(replace(data, chi2=chi), replace(spectrum, u=u))
        truth = Surface(data.row, data.col, (data.Z @ spectrum.basis @ a).reshape(2, data.row.size, -1))(*GRID)
        sigma = np.sqrt(np.diagonal(found.covariance(*GRID), axis1=1, axis2=2))
        coverage.append(np.mean(np.abs(found.surface(*GRID) - truth) < 1.96 * sigma))
    off = 3 * np.std(coverage) / np.sqrt(len(coverage))
    assert abs(np.mean(coverage) - 0.95) < max(off, 0.01)


def test_noise_above_the_stated_is_no_structure_and_makes_the_sigma_grow():
    claimed, widened = [], []
    for k in range(effort(15, 100)):
        arcs = field(np.random.default_rng([10, k]), TANGENTIAL, 60, noise_px=2 * NOISE_PX)
        arcs = replace(arcs, sigma_px=np.full(arcs.n_stars, NOISE_PX))
        found = rs.infer(left_by(arcs, BROWN, TANGENTIAL, BROWN_SCALE)[2])
        claimed.append(found.test.p < 0.01)
        widened.append(found.variance)
    assert np.mean(widened) == pytest.approx(4.0, rel=0.1)
    assert sum(claimed) <= effort(1, 5)


def test_a_wrong_match_is_left_out_and_makes_no_structure():
    rng = np.random.default_rng(11)
    arcs = field(rng, TANGENTIAL)
    row = arcs.row_px.copy()
    wrong = rng.choice(arcs.n_stars, 3, replace=False)
    row[wrong] += 4.0
    arcs, x, data = left_by(replace(arcs, row_px=row), BROWN, TANGENTIAL, BROWN_SCALE)
    assert rs.infer(data).variance > 1.5
    found = rs.fit(arcs, BROWN, x, np.arange(len(x)), BROWN_SCALE, parity=1, detector=DETECTOR)
    assert set(np.flatnonzero(found.left_out)) == set(wrong)
    assert found.data.stars == data.stars - 3
    assert found.posterior.test.p > 0.01
    assert found.posterior.variance < 1.1
