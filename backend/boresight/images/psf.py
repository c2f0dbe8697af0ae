"""The image of a star: a Gaussian integrated over pixels, and what its windowed centroid makes of noise and of pixels.

The windowed centroid (Bertin & Arnouts 1996; SExtractor's XWIN, `sep.winpos`) rests where

    sum_i w_i I_i d_i = 0,        d_i = x_i - x,        w_i = exp(-|d_i|^2 / 2 s^2),

I the pixels less the background. Noise n of variance v_i = sigma^2 + I_i / gain moves the point of rest by

    dx = sum_i w_i n_i d_i / k,        k = sum_i w_i I_i (1 - d_i^2 / s^2),        cov = sum_i w_i^2 v_i d_i d_i^T / k^2

For a Gaussian star of the window's own width k = sum w I / 2, which gives SExtractor's factor 4; here k is that of the set's star,
because a defocused or undersampled one has another. Pixels are no points: the point of rest of a noiseless star depends on where in
its pixel it lies. That error, `phase_error_px`, is measured on noiseless stars and goes into the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from boresight.arrays import FloatArray, IntArray

#: A window reaches so many of its sigmas.
WINDOW_REACH = 4.0
PHASES = 12
#: Half-flux radius of a Gaussian, in sigmas.
HALF_FLUX = float(np.sqrt(2.0 * np.log(2.0)))


def pixel_shares(pixel: IntArray, centre: FloatArray, sigma: float) -> FloatArray:
    """Shares (n_centres, n_pixels) of Gaussians' light in consecutive pixels along one axis."""
    edges = (np.append(pixel, pixel[-1] + 1) - 0.5 - centre[:, None]) / (np.sqrt(2.0) * sigma)
    return np.asarray(np.diff(erf(edges), axis=1) / 2.0)


@dataclass(frozen=True)
class Window:
    """The window of a set: its sigma, the slope k over sum w I, and the error that pixels leave, px."""

    sigma_px: float
    slope: float
    phase_error_px: float

    @property
    def reach(self) -> int:
        """Pixels on either side that count."""
        return compute_reach(self.sigma_px)


def compute_reach(sigma_px: float) -> int:
    """Pixels on either side that count in a window of this sigma."""
    return int(np.ceil(WINDOW_REACH * sigma_px))


def make_window(sigma_px: float, slope: float | None = None) -> Window:
    """Measure a window on noiseless stars whose width, with that of a pixel, is its own.

    They lie at `PHASES` places in a pixel along each axis. `slope`: that of real stars, where it is known.
    """
    import sep  # noqa: PLC0415 - loaded with the first image

    window_px, sigma_px = sigma_px, float(np.sqrt(max(sigma_px**2 - 1.0 / 12.0, 0.2**2)))
    half = int(np.ceil(6.0 * sigma_px)) + 1
    size = 2 * half + 1
    phase = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    shares = pixel_shares(np.arange(size), half + phase, sigma_px)
    image = np.einsum("ai,bj->aibj", shares, shares).reshape(PHASES * size, PHASES * size)
    place = (np.arange(PHASES) * size + half + phase).astype(np.float64)
    rows, columns = (axis.ravel() for axis in np.meshgrid(place, place, indexing="ij"))
    x, y, _ = sep.winpos(np.ascontiguousarray(image), columns, rows, np.full(len(rows), window_px))
    error = float(np.sqrt(np.mean(np.concatenate([x - columns, y - rows]) ** 2)))
    if slope is None:
        d = np.arange(-half, half + 1)
        star = pixel_shares(d, np.zeros(1), sigma_px)
        slope = float(find_slopes((star.T @ star)[None], np.zeros(1), np.zeros(1), window_px)[0])
    return Window(window_px, slope, error)


def find_slopes(patches: FloatArray, d_row: FloatArray, d_col: FloatArray, sigma_px: float) -> FloatArray:
    """Slopes (n,) k over sum w I of stars, as `centroid_covariance` takes them, mean of both axes."""
    r, c, w = _weights(patches, d_row, d_col, sigma_px)
    weighted = w * patches
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = (weighted * (r**2 + c**2)).sum(axis=(1, 2)) / (2.0 * sigma_px**2) / weighted.sum(axis=(1, 2))
    return np.asarray(1.0 - spread)


def _weights(
    patches: FloatArray, d_row: FloatArray, d_col: FloatArray, sigma_px: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distances from the centroids along rows (n, k, 1) and columns (n, 1, k), and the window (n, k, k)."""
    half = patches.shape[1] // 2
    offset = np.arange(-half, half + 1)
    r, c = offset[None, :, None] - d_row[:, None, None], offset[None, None, :] - d_col[:, None, None]
    return r, c, np.exp(-(r**2 + c**2) / (2.0 * sigma_px**2))


def cut_patches(image: FloatArray, row: IntArray, column: IntArray, reach: int) -> FloatArray:
    """Patches (n, 2 reach + 1, 2 reach + 1) about pixels (n,), zero beyond the image's edge."""
    padded = np.pad(image, reach)
    offset = np.arange(2 * reach + 1)
    return np.asarray(padded[row[:, None, None] + offset[:, None], column[:, None, None] + offset])


def centroid_covariance(
    patches: FloatArray, variance: FloatArray, d_row: FloatArray, d_col: FloatArray, window: Window
) -> FloatArray:
    """Covariance (n, 3) of windowed centroids: of rows, of columns, between them, px^2.

    Parameters
    ----------
    patches
        (n, k, k) pixels less the background, as `cut_patches` gives them.
    variance
        (n, k, k) of each pixel.
    d_row, d_col
        (n,) centroid less the centre of its patch.
    window
        The window of the centroids.
    """
    r, c, w = _weights(patches, d_row, d_col, window.sigma_px)
    k = window.slope * np.einsum("nij,nij->n", w, patches)
    w2 = w**2 * variance
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = [(w2 * first * second).sum(axis=(1, 2)) / k**2 for first, second in ((r, r), (c, c), (r, c))]
    found = np.column_stack(parts)
    found[:, :2] += window.phase_error_px**2
    return np.asarray(np.where((k > 0)[:, None], found, np.nan))
