"""Images with known truth: the stars of a scenario as a detector records them, with everything that makes extraction hard.

A star of magnitude m at (r, c) puts into the pixel (i, j) the electrons

    N = N_0 10^(-0.4 m) T(r, c) sum_k w_k Phi_i(r + d_k) Phi_j(c + e_k),     Phi_i(r) = [erf((i + 1/2 - r) / s) - erf((i - 1/2
    - r) / s)] / 2

with s = sqrt(2) sigma: a Gaussian integrated over pixels. In focus there is one term; a defocused spot is a disc, filled by
`DISC_POINTS` Gaussians on a sunflower spiral. T is the transmission of clouds, a smooth random field of which a share of the image
lies under cloud; clouds scatter as much light from below as they take from above, so the sky brightens under them. To
the stars are added the sky, a satellite's trail (a straight line with the profile of a star), and pixels that are hot or dead in
every image of the set. Then

    DN = round(bias + (Poisson(electrons) + read noise) / gain),   held within 0 and the white level.

A sensor with a `site` stands on the ground: its scenario's fields stand over the horizon, and the air of the site lifts their stars
(`simulation.scenes`). Not modelled: the smear of stars during an exposure, scintillation.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import zoom

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.images.psf import pixel_shares
from boresight.simulation.scenes import Scenario, SimulatedExposures, expose, is_on_detector, read_out, visible_stars
from boresight.sky.catalogue import Catalogue

DISC_POINTS = 37
GOLDEN_ANGLE_RAD = np.pi * (3.0 - np.sqrt(5.0))
#: A star is drawn out to so many sigmas beyond its disc: a Gaussian has 2e-7 of its light farther out.
REACH_SIGMAS = 5.2
#: Stars are drawn down to this share of a sigma of the background in their brightest pixel.
FAINTEST_PEAK = 0.1
#: Electrons a second of hot pixels follow an exponential law; this many an exposure are their mean.
HOT_MEAN_E = 4000.0
CLOUD_CELLS = 6
CLOUD_EDGE = 0.15


@dataclass(frozen=True)
class Optics:
    """How a detector records stars; electrons are of one exposure.

    Parameters
    ----------
    psf_sigma_px, defocus_radius_px
        Width of the Gaussian, and radius of the disc that it blurs.
    zero_magnitude_e
        Electrons of a star of magnitude 0.
    sky_e, read_noise_e, gain_e_per_dn, bias_dn, bits
        Of a pixel; bits set the white level 2^bits - 1.
    hot_share, dead_share
        Shares of the pixels that are hot, or answer to nothing, in every image of a set.
    trails
        Mean number of satellites that cross an image.
    trail_e
        Electrons a pixel on the crest of a trail.
    cloud_share, cloud_transmission
        Share of an image under cloud, and how much of a star's light passes there.
    exposure_s
        Time of exposure.
    """

    psf_sigma_px: float = 1.1
    defocus_radius_px: float = 0.0
    zero_magnitude_e: float = 2.0e6
    sky_e: float = 60.0
    read_noise_e: float = 6.0
    gain_e_per_dn: float = 1.0
    bias_dn: float = 100.0
    bits: int = 16
    hot_share: float = 0.0
    dead_share: float = 0.0
    trails: float = 0.0
    trail_e: float = 600.0
    cloud_share: float = 0.0
    cloud_transmission: float = 0.1
    exposure_s: float = 0.5

    @property
    def white_dn(self) -> int:
        """The largest number of a pixel."""
        return int(2**self.bits) - 1

    @property
    def background_sigma_e(self) -> float:
        """Standard deviation of a pixel of the sky."""
        return float(np.sqrt(self.sky_e + self.read_noise_e**2))


@dataclass(frozen=True)
class SimulatedImage:
    """One image with its truth.

    `dn`: (rows, columns) uint16. `time_utc`: mid-exposure. `row_px`, `col_px`, `magnitude`, `star_id`: (n_stars,) where the
    stars on the detector truly are, brightest first. `expected_e`: (n_stars,) electrons that each is expected to leave.
    `trails_px`: ends of trails.
    """

    frame: int
    exposure: int
    dn: np.ndarray[tuple[int, int], np.dtype[np.uint16]]
    time_utc: np.datetime64
    row_px: FloatArray
    col_px: FloatArray
    magnitude: FloatArray
    star_id: IntArray
    expected_e: FloatArray
    trails_px: list[tuple[float, float, float, float]]


@dataclass(frozen=True)
class _Pixels:
    """What is wrong with pixels of a detector: additional electrons, and the share of light that each answers to."""

    extra_e: FloatArray
    response: FloatArray


def simulate_images(
    scenario: Scenario, optics: Optics, rng: np.random.Generator, catalogue: Catalogue
) -> Iterator[SimulatedImage]:
    """Simulate the images of a scenario, one an exposure.

    Of the scenario its sensor, truth, orbit or site, motion and numbers of frames and exposures count; noise, limit and false stars
    come of the optics.
    """
    exposures = expose(scenario)
    faintest = _faintest(optics)
    index, star, s_i = visible_stars(scenario, exposures, catalogue, faintest)
    row_px, col_px = read_out(scenario, exposures, index, s_i)
    pixels = _draw_pixels(scenario, optics, rng)
    reach = _reach_px(optics)
    ends = np.searchsorted(index, np.arange(len(exposures.frame) + 1))
    for k in range(len(exposures.frame)):
        part = slice(ends[k], ends[k + 1])
        near = _is_near(scenario, row_px[part], col_px[part], reach)
        places = row_px[part][near], col_px[part][near]
        yield _record(scenario, optics, exposures, k, places, star[part][near], pixels, catalogue, rng)


def write_images(folder: Path, images: Iterable[SimulatedImage], optics: Optics) -> list[Path]:
    """Write images as FITS into a folder, which is made, with their time of exposure, gain and white level; returns the files."""
    from astropy.io import fits  # noqa: PLC0415 - 0.2 s

    folder.mkdir(parents=True, exist_ok=True)
    written = []
    half = np.timedelta64(round(optics.exposure_s / 2.0 * 1e6), "us")
    for image in images:
        header = fits.Header()
        header["DATE-OBS"] = f"{image.time_utc - half}"
        header["EXPTIME"], header["EGAIN"], header["SATURATE"] = (
            optics.exposure_s,
            optics.gain_e_per_dn,
            optics.white_dn,
        )
        written.append(folder / f"image-{image.frame:05d}-{image.exposure}.fits")
        fits.writeto(written[-1], image.dn, header, overwrite=True)
    return written


def _record(  # noqa: PLR0913, PLR0917 - what an image is made of
    scenario: Scenario,
    optics: Optics,
    exposures: SimulatedExposures,
    k: int,
    places: tuple[FloatArray, FloatArray],
    star: IntArray,
    pixels: _Pixels,
    catalogue: Catalogue,
    rng: np.random.Generator,
) -> SimulatedImage:
    """Expose once: stars, sky, clouds, trails, bad pixels, noise."""
    shape = scenario.sensor.rows, scenario.sensor.columns
    row_px, col_px = places
    clear = _transmission(shape, optics, rng)
    at = np.clip(row_px.round().astype(int), 0, shape[0] - 1), np.clip(col_px.round().astype(int), 0, shape[1] - 1)
    expected = optics.zero_magnitude_e * 10.0 ** (-0.4 * catalogue.magnitude[star]) * clear[at]
    electrons = optics.sky_e * (2.0 - clear)
    draw_stars(electrons, row_px, col_px, expected, optics)
    trails = [_add_trail(electrons, optics, rng) for _ in range(rng.poisson(optics.trails))]
    electrons = rng.poisson(electrons * pixels.response + pixels.extra_e).astype(np.float64)
    electrons += optics.read_noise_e * rng.standard_normal(shape)
    dn = np.clip(np.rint(optics.bias_dn + electrons / optics.gain_e_per_dn), 0, optics.white_dn).astype(np.uint16)
    on = np.flatnonzero(is_on_detector(scenario.sensor, row_px, col_px))
    on = on[np.argsort(-expected[on], kind="stable")]
    return SimulatedImage(
        frame=int(exposures.frame[k]),
        exposure=int(exposures.exposure[k]),
        dn=dn,
        time_utc=exposures.time_utc[k],
        row_px=row_px[on],
        col_px=col_px[on],
        magnitude=catalogue.magnitude[star][on],
        star_id=catalogue.hip[star][on],
        expected_e=expected[on],
        trails_px=trails,
    )


def draw_stars(
    electrons: FloatArray, row_px: FloatArray, col_px: FloatArray, total: FloatArray, optics: Optics
) -> None:
    """Add stars of so many electrons (n,) at row_px, col_px (n,) to an image (rows, columns) in place."""
    rows, columns = electrons.shape
    reach = _reach_px(optics)
    offsets = _disc(optics.defocus_radius_px)
    for r, c, amount in zip(row_px, col_px, total, strict=True):
        top, bottom = max(0, int(np.ceil(r - reach))), min(rows, int(r + reach) + 1)
        left, right = max(0, int(np.ceil(c - reach))), min(columns, int(c + reach) + 1)
        if top >= bottom or left >= right:
            continue
        along_rows = pixel_shares(np.arange(top, bottom), r + offsets[:, 0], optics.psf_sigma_px)
        along_columns = pixel_shares(np.arange(left, right), c + offsets[:, 1], optics.psf_sigma_px)
        electrons[top:bottom, left:right] += amount / len(offsets) * (along_rows.T @ along_columns)


def _disc(radius: float) -> FloatArray:
    """Points (n, 2) that fill a disc evenly; one point where there is no disc."""
    if radius == 0.0:
        return np.zeros((1, 2))
    k = np.arange(DISC_POINTS)
    r, angle = radius * np.sqrt((k + 0.5) / DISC_POINTS), GOLDEN_ANGLE_RAD * k
    points = np.column_stack([r * np.cos(angle), r * np.sin(angle)])
    return np.asarray(points - points.mean(axis=0))  # so that the spot's centre is the star's place


def _reach_px(optics: Optics) -> float:
    return REACH_SIGMAS * optics.psf_sigma_px + optics.defocus_radius_px


def _faintest(optics: Optics) -> float:
    """Return the magnitude whose brightest pixel is lost in the noise of the sky."""
    spread = optics.psf_sigma_px**2 + optics.defocus_radius_px**2 / 4.0
    peak = optics.zero_magnitude_e / (2.0 * np.pi * spread)
    return float(2.5 * np.log10(peak / (FAINTEST_PEAK * optics.background_sigma_e)))


def _is_near(scenario: Scenario, row_px: FloatArray, col_px: FloatArray, reach: float) -> BoolArray:
    """Tell (n,) which stars leave light on the detector; NaN does not."""
    rows, columns = scenario.sensor.rows, scenario.sensor.columns
    near: BoolArray = (row_px > -reach) & (row_px < rows + reach) & (col_px > -reach) & (col_px < columns + reach)
    return near


def _draw_pixels(scenario: Scenario, optics: Optics, rng: np.random.Generator) -> _Pixels:
    shape = scenario.sensor.rows, scenario.sensor.columns
    extra = np.where(rng.random(shape) < optics.hot_share, rng.exponential(HOT_MEAN_E, shape), 0.0)
    return _Pixels(extra, np.where(rng.random(shape) < optics.dead_share, 0.0, 1.0))


def _transmission(shape: tuple[int, int], optics: Optics, rng: np.random.Generator) -> FloatArray:
    """Share of light (rows, columns) that passes the clouds."""
    if optics.cloud_share == 0.0:
        return np.ones(shape)
    cells = rng.standard_normal((CLOUD_CELLS, CLOUD_CELLS))
    smooth = zoom(cells, (shape[0] / CLOUD_CELLS, shape[1] / CLOUD_CELLS), order=3)[: shape[0], : shape[1]]
    height = (smooth - np.quantile(smooth, optics.cloud_share)) / (CLOUD_EDGE * smooth.std())
    return np.asarray(
        optics.cloud_transmission + (1.0 - optics.cloud_transmission) / (1.0 + np.exp(-np.clip(height, -30, 30)))
    )


def _add_trail(electrons: FloatArray, optics: Optics, rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Add a straight trail across the image in place; returns a point on it and its direction: row, column, d_row, d_column."""
    rows, columns = electrons.shape
    r, c, angle = rng.uniform(0, rows), rng.uniform(0, columns), rng.uniform(0, np.pi)
    d_row, d_col = np.sin(angle), np.cos(angle)
    across = (np.arange(rows)[:, None] - r) * d_col - (np.arange(columns)[None, :] - c) * d_row
    electrons += optics.trail_e * np.exp(-0.5 * (across / optics.psf_sigma_px) ** 2)
    return float(r), float(c), float(d_row), float(d_col)
