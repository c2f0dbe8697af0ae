"""Centroids with the covariance that truth has, bad pixels from the set itself, trails and clouds without a false star."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy import stats

from boresight.errors import RefusedInputError
from boresight.images.detection import DetectionOptions, Look, detect, learn, subtract_sky
from boresight.images.psf import centroid_covariance, cut_patches, make_window, pixel_shares
from boresight.simulation.images import Optics, draw_stars, simulate_images
from boresight.sky.catalogue import Catalogue
from boresight.sky.guide_stars import compute_pulls
from tests.effort import effort

ONE_IN_A_MILLION = 1e-6


def pixels(images):
    return [image.dn.astype(np.float64) for image in images]


def looks(images):
    return [Look(dn) for dn in pixels(images)]


def grid_images(optics, count, rng):
    """Stars far from one another, of all brightnesses, each at a place of its own in its pixel: image, rows, columns."""
    place = np.arange(1, 12) * 40.0
    made = []
    for _ in range(count):
        row, col = (axis.ravel() + rng.uniform(-0.5, 0.5, 121) for axis in np.meshgrid(place, place, indexing="ij"))
        electrons = np.full((480, 480), optics.sky_e)
        peak = 10.0 ** rng.uniform(0.9, 2.5, 121) * optics.background_sigma_e
        spread = optics.psf_sigma_px**2 + optics.defocus_radius_px**2 / 4
        draw_stars(electrons, row, col, peak * 2 * np.pi * spread, optics)
        noisy = rng.poisson(electrons) + optics.read_noise_e * rng.standard_normal(electrons.shape)
        made.append((np.rint(optics.bias_dn + noisy / optics.gain_e_per_dn), row, col))
    return made


def normalised(found, row, col):
    """Squares of the errors (n, 2) over their variances, of the stars within 1.5 px of a true one."""
    apart = np.hypot(found.row_px[:, None] - row, found.col_px[:, None] - col)
    nearest, near = apart.argmin(axis=1), apart.min(axis=1) < 1.5
    errors = np.column_stack([found.row_px - row[nearest], found.col_px - col[nearest]])
    return (errors**2 / found.covariance[:, :2])[near], int((~near).sum())


@pytest.mark.full
@pytest.mark.parametrize(
    ("optics", "gain"),
    [
        (Optics(), 1.0),
        (Optics(gain_e_per_dn=2.5), None),  # told from the images
        (Optics(psf_sigma_px=0.8, defocus_radius_px=2.5), None),
        (Optics(psf_sigma_px=1.7), None),
    ],
)
def test_errors_of_centroids_are_what_their_covariance_says(optics, gain):
    images = grid_images(optics, effort(4, 16), np.random.default_rng(3))
    options = DetectionOptions(gain_e_per_dn=gain)
    common = learn([Look(dn) for dn, _, _ in images], options, None)
    squares = [normalised(detect(dn, common, options), row, col) for dn, row, col in images]
    assert sum(false for _, false in squares) == 0
    z2 = np.concatenate([one for one, _ in squares])
    assert len(z2) > 100 * len(images)
    # ten per cent stand for the gain and width that are estimated; the rest is chance
    low, high = stats.chi2.ppf([ONE_IN_A_MILLION, 1 - ONE_IN_A_MILLION], z2.size) / z2.size
    assert 0.9 * low < z2.mean() < 1.1 * high
    assert common.gain_e_per_dn == pytest.approx(optics.gain_e_per_dn, rel=0.25)


def test_the_covariance_is_that_of_windowed_centroids_of_many_images_of_one_star():
    sep = pytest.importorskip("sep")
    rng, optics, n = np.random.default_rng(4), Optics(psf_sigma_px=1.3), effort(1500, 20000)
    star = pixel_shares(np.arange(25), np.array([12.3]), 1.3)
    electrons = 4000 * star.T @ star
    noisy = rng.poisson(electrons + optics.sky_e, (n, 25, 25)) - optics.sky_e + 6 * rng.standard_normal((n, 25, 25))
    window = make_window(1.35)
    x, y = np.array(
        [sep.winpos(one.copy(), [12.3], [12.3], [window.sigma_px])[:2] for one in noisy.astype(np.float64)]
    )[:, :, 0].T
    patch = cut_patches(electrons, np.array([12]), np.array([12]), window.reach)
    light = np.maximum(patch, 0) + optics.sky_e + 36
    claimed = centroid_covariance(patch, light, np.array([0.3]), np.array([0.3]), window)[0]
    measured = np.cov(np.vstack([y, x]))
    assert measured[0, 0] == pytest.approx(claimed[0], rel=5 * np.sqrt(2 / n) + 0.03)
    assert measured[1, 1] == pytest.approx(claimed[1], rel=5 * np.sqrt(2 / n) + 0.03)
    assert abs(measured[0, 1]) < 5 * claimed[0] / np.sqrt(n)


def test_a_narrow_star_has_an_error_of_its_place_in_the_pixel_and_a_wide_one_has_none():
    assert make_window(0.6).phase_error_px > 100 * make_window(1.5).phase_error_px


def test_hot_and_dead_pixels_are_told_from_the_set_and_leave_no_star(hard_images):
    options = DetectionOptions(gain_e_per_dn=1.0)
    common = learn(looks(hard_images), options, None)
    lit = np.mean([subtract_sky(dn).pixels for dn in pixels(hard_images)], axis=0) > 60.0
    assert common.hot.sum() >= 20
    assert common.dead.sum() >= 8
    assert (common.hot & lit).sum() >= 0.9 * common.hot.sum()
    for image in hard_images:
        found = detect(image.dn.astype(np.float64), common, options)
        _, false = normalised(found, image.row_px, image.col_px)
        assert false <= 1


def test_a_set_whose_stars_stay_in_place_loses_no_star_to_hot_pixels():
    optics, rng = Optics(), np.random.default_rng(5)
    row, col = rng.uniform(10, 470, (2, 60))
    electrons = np.full((480, 480), optics.sky_e)
    draw_stars(electrons, row, col, 10.0 ** rng.uniform(3, 4.5, 60), optics)
    images = [np.rint(100 + rng.poisson(electrons) + 6 * rng.standard_normal(electrons.shape)) for _ in range(6)]
    options = DetectionOptions()
    common = learn([Look(dn) for dn in images], options, None)
    alone = learn([Look(images[0])], options, None)
    assert not common.stars_move
    assert len(detect(images[0], common, options)) >= 0.9 * len(detect(images[0], alone, options)) > 20


@pytest.mark.full
def test_trails_give_no_star_and_their_pixels_are_counted(night, catalogue):
    optics = replace(Optics(zero_magnitude_e=3e5), trails=3.0)
    images = list(simulate_images(night, optics, np.random.default_rng(6), catalogue))
    options = DetectionOptions(gain_e_per_dn=1.0)
    common = learn(looks(images), options, None)
    trailed = [image for image in images if image.trails_px]
    assert trailed
    for image in trailed:
        found = detect(image.dn.astype(np.float64), common, options)
        for row, col, d_row, d_col in image.trails_px:
            across = np.abs((found.row_px - row) * d_col - (found.col_px - col) * d_row)
            assert (across > common.window.sigma_px).all()
        assert found.trail_pixels > 0
        assert normalised(found, image.row_px, image.col_px)[1] <= 1


@pytest.mark.full
def test_saturated_stars_are_flagged_and_widened(night, catalogue):
    optics = Optics(zero_magnitude_e=8e6, bits=12, gain_e_per_dn=4.0)
    images = list(simulate_images(night, optics, np.random.default_rng(7), catalogue))
    options = DetectionOptions(gain_e_per_dn=4.0)
    common = learn(looks(images), options, None)
    assert common.saturation_dn == 4095
    squares = []
    for image in images:
        found = detect(image.dn.astype(np.float64), common, options)
        assert (found.saturated == (found.peak_dn >= 4095)).mean() > 0.9
        apart = np.hypot(found.row_px[:, None] - image.row_px, found.col_px[:, None] - image.col_px)
        squares += (apart.min(axis=1)[found.saturated] ** 2 / found.covariance[found.saturated, 0]).tolist()
    assert squares
    assert np.mean(squares) < 2.0  # two axes; they claim no less than they are wrong


def test_images_without_stars_are_refused():
    rng = np.random.default_rng(8)
    with pytest.raises(RefusedInputError):
        learn([Look(np.rint(rng.normal(100, 10, (128, 160))))], DetectionOptions(), None)


@pytest.mark.parametrize("apart_px", [1.0, 2.0, 3.0, 4.0, 5.0])
@pytest.mark.parametrize("ratio", [0.05, 0.2])
def test_a_neighbour_draws_a_centroid_by_what_matching_takes_it_to(apart_px, ratio):
    sep = pytest.importorskip("sep")
    pixel, width = np.arange(41), 1.1
    rows, star, other = (pixel_shares(pixel, np.array([c]), width)[0] for c in (20.2, 20.3, 20.3 + apart_px))
    window = np.hypot(width, np.sqrt(1.0 / 12.0))  # of the pixels too
    image = np.ascontiguousarray(1e5 * np.outer(rows, star + ratio * other))
    x, _, _ = sep.winpos(image, [20.3], [20.2], [window])
    zero = np.zeros(2)
    arrays = {one.name: zero for one in fields(Catalogue)}
    places = {"ra_rad": np.array([0.0, apart_px * 1e-5]), "magnitude": np.array([5.0, 5.0 - 2.5 * np.log10(ratio)])}
    pair = Catalogue(**arrays | places)
    expected = compute_pulls(pair, np.array([0]), window * 1e-5)[0] / 1e-5
    assert x[0] - 20.3 == pytest.approx(expected, rel=0.15)
