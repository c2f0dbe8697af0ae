"""Stars in an image, by `sep` (Barbary 2016, SExtractor's algorithms): background, detection, windowed centroids, their covariance.

What all images of a set have in common is learned first, from some of them (`learn`):

- **Bad pixels.** With x the pixel less the background, in sigmas, held within +-`CLIP`, its mean over n images is beyond
  max(`BAD_SIGMAS` / sqrt(n), `BAD_MEAN`) where a pixel is hot or dead, for stars pass it by. Stars that stay at one place would be
  hot as well, but they are no single pixels: a group of more than `LARGEST_BAD` neighbours is none. Of fewer than
  `FEWEST_IMAGES` images nothing can be told that way; then a pixel is hot that stands out of its eight neighbours as no star of the
  set's width does.
- **Width of stars**: the median half-flux radius of bright ones, over sqrt(2 ln 2). It is the window of the centroids.
- **Gain**, where neither file nor user gives it: the finest structure of an image (fourth differences along both axes) holds noise
  and next to no starlight, and its variance is

      v(I) = sigma^2 + I / gain + (c I)^2,

  the last term for the starlight that it does hold. Medians of squares in bins of I give v; non-negative least squares the two
  unknowns.

Then each image by itself: what is large or long is no star (trails, the Moon, a horizon), and its pixels are left out with a
margin; stars are detected by the filter that is matched to the set's star; those on bad pixels or the edge, blended ones and those
of another shape than stars are left out and counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from scipy.ndimage import binary_dilation, convolve1d, label
from scipy.optimize import nnls

from boresight.arrays import BoolArray, FloatArray
from boresight.errors import RefusedInputError
from boresight.images.psf import (
    HALF_FLUX,
    Window,
    centroid_covariance,
    compute_reach,
    cut_patches,
    find_slopes,
    make_window,
)
from boresight.sky.guide_stars import LARGEST_PULL

BOX_PX = 32
#: What clipping at three sigmas leaves of a Gaussian's sigma: the background's noise is estimated that way.
CLIPPED = 0.9866
CLIP, BAD_SIGMAS, BAD_MEAN, LARGEST_BAD, FEWEST_IMAGES = 5.0, 6.0, 1.5, 4, 4
#: A pixel stands out of its neighbours by so many sigmas, and they have less than this share of it.
SPIKE_SIGMAS, SPIKE_SHARE = 8.0, 0.12
#: Images that are looked at to learn what all have in common.
LOOKED_AT = 24
#: Matched signal-to-noise ratios of stars whose width and shape count: the second where the first gives fewer than are enough.
BRIGHT, ENOUGH = (30.0, 10.0), 20
FIRST_WIDTH_PX, NARROWEST_PX, WIDEST_PX = 1.2, 0.4, 12.0
#: An object is none of a star's size beyond so many times a star's area, or so many times as long as wide.
LARGEST_AREAS, LONGEST = 60.0, 3.0
#: Shapes of stars within these times the window's width; noise widens the bounds of faint ones.
SHAPE = (0.6, 1.6)
GAIN_BINS = 10
#: Weights along an axis that keep the finest structure alone, in which stars that are well sampled have no light.
FINEST = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
#: Median of chi-square with one degree of freedom.
CHI2_MEDIAN = 0.4549
FEWEST_GAIN_PIXELS = 300
SEP_PIXELS = 3_000_000

#: Why an object is not among the stars, in the order of the tests.
REASONS: Final = ("edge", "bad pixel", "trail or large object", "shape", "blended", "beyond the requested number")


@dataclass(frozen=True)
class Common:
    """What the images of a set have in common.

    `hot`, `dead`: (rows, columns) pixels. `window`: of the centroids. `gain_e_per_dn`: and whether it was estimated from the
    images. `saturation_dn`: None where no pixel shows one. `looked_at`: images it was learned from. `stars_move`: whether they do.
    """

    hot: BoolArray
    dead: BoolArray
    window: Window
    gain_e_per_dn: float | None
    gain_estimated: bool
    saturation_dn: float | None
    looked_at: int
    stars_move: bool = True

    @property
    def bad(self) -> BoolArray:
        """Pixels that say nothing."""
        return np.asarray(self.hot | self.dead)


@dataclass(frozen=True)
class Detections:
    """Stars of one image, brightest first; arrays (n,).

    `row_px`, `col_px`: centroid, the centre of the top-left pixel is (0, 0). `covariance`: (n, 3) of rows, columns, both, px^2.
    `flux_dn`, `flux_sigma_dn`, `peak_dn`. `background_dn`, `background_sigma_dn`: of a pixel there. `saturated`. `left_out`:
    objects by the reason why they are none. `trail_pixels`: pixels left out as of trails and large objects.
    """

    row_px: FloatArray
    col_px: FloatArray
    covariance: FloatArray
    flux_dn: FloatArray
    flux_sigma_dn: FloatArray
    peak_dn: FloatArray
    background_dn: FloatArray
    background_sigma_dn: FloatArray
    saturated: BoolArray
    left_out: dict[str, int] = field(default_factory=dict)
    trail_pixels: int = 0

    def __len__(self) -> int:
        """Count the stars."""
        return len(self.row_px)

    @property
    def sigma_px(self) -> FloatArray:
        """One-axis standard deviation (n,): the root mean square of both axes."""
        return np.asarray(np.sqrt(self.covariance[:, :2].mean(axis=1)))


@dataclass(frozen=True)
class DetectionOptions:
    """How stars are looked for.

    `threshold`: matched signal-to-noise ratio. `most_stars`: of an image. `gain_e_per_dn`, `saturation_dn`: where they are known.
    """

    threshold: float = 8.0
    most_stars: int = 200
    gain_e_per_dn: float | None = None
    saturation_dn: float | None = None


@dataclass(frozen=True)
class _Sky:
    """An image less its background, and the noise of a pixel of it."""

    pixels: FloatArray
    level: FloatArray
    sigma: FloatArray


def subtract_sky(dn: FloatArray, mask: BoolArray | None = None) -> _Sky:
    """Estimate the background and its noise, and subtract it."""
    return _less_background(dn, _estimate_background(dn, mask))


def _estimate_background(dn: FloatArray, mask: BoolArray | None = None) -> Any:
    import sep  # noqa: PLC0415 - it belongs to the extra for images

    sep.set_extract_pixstack(SEP_PIXELS)
    return sep.Background(dn, mask=mask, bw=BOX_PX, bh=BOX_PX)


def _less_background(dn: FloatArray, found: Any) -> _Sky:
    sigma, level = found.rms(), found.back()
    sigma /= CLIPPED
    np.maximum(sigma, 0.29, out=sigma)  # a whole number has the noise of its rounding
    return _Sky(
        np.ascontiguousarray(dn - level, dtype=np.float64), level, np.ascontiguousarray(sigma, dtype=np.float64)
    )


class Look:
    """An image that is looked at several times with others: its numbers as small as they are exact, and its background's mesh.

    Two dozen of five megapixels take a quarter of a gigabyte so, where their skies would take three.
    """

    def __init__(self, dn: FloatArray) -> None:
        exact = (np.uint16, np.float32)
        with np.errstate(invalid="ignore"):
            self._dn = next((small for kind in exact if np.array_equal(small := dn.astype(kind), dn)), dn)
        self._background = _estimate_background(dn)
        self.largest = float(dn.max())
        self.at_largest = int(np.count_nonzero(dn == self.largest))

    @property
    def dn(self) -> FloatArray:
        """The image (rows, columns)."""
        return self._dn.astype(np.float64)

    def sky(self) -> _Sky:
        """The image less its background, made again."""
        return _less_background(self.dn, self._background)


def learn(looks: Sequence[Look], options: DetectionOptions, white_dn: float | None) -> Common:
    """Learn what images have in common, of which one at a time is held whole.

    Raises
    ------
    RefusedInputError
        Where no image shows stars that could be measured.
    """
    saturation = options.saturation_dn or white_dn or _find_saturation(looks)
    hot, dead, stars_move = _find_bad_pixels(looks)
    samples: list[_Sample] = []
    for threshold in BRIGHT:
        samples = [_Sample.of(look.sky(), hot | dead, saturation, look.dn, threshold) for look in looks]
        if sum(len(sample.x) for sample in samples) >= ENOUGH:
            break
    width = _find_width(samples)
    lit = [
        _LitPixels.of(look.sky(), sample, width) for look, sample in zip(looks, samples, strict=True) if len(sample.x)
    ]
    window = make_window(width, _find_slope(lit))
    gain, estimated = options.gain_e_per_dn, False
    if gain is None:
        gain = _find_gain(lit)
        estimated = gain is not None
    return Common(hot, dead, window, gain, estimated, saturation, len(looks), stars_move)


def _find_saturation(looks: Sequence[Look]) -> float | None:
    """Return the largest number of all images where so many pixels have it that it is a limit and no star's peak."""
    largest = max(look.largest for look in looks)
    count = sum(look.at_largest for look in looks if look.largest == largest)
    return largest if count >= 4 * len(looks) else None


def _find_bad_pixels(looks: Sequence[Look]) -> tuple[BoolArray, BoolArray, bool]:
    """Return hot pixels, dead ones, and whether the stars moved."""
    shape = looks[0].dn.shape
    spikes, mean = np.zeros(shape, dtype=np.int64), np.zeros(shape)
    for look in looks:
        sky = look.sky()
        spikes += _find_spikes(sky)
        mean += np.clip(sky.pixels / sky.sigma, -CLIP, CLIP) / len(looks)
    if len(looks) < FEWEST_IMAGES:
        return np.asarray(spikes > 0), np.zeros(shape, dtype=np.bool_), True
    limit = max(BAD_SIGMAS / np.sqrt(len(looks)), BAD_MEAN)
    hot, large = _without_large(mean > limit)
    dead, _ = _without_large(mean < -limit)
    # of a fixed field many stars are lit at one place: then only what is sharper than a star is hot
    stars_move = large <= max(3, 0.2 * int(label(hot)[1]))
    if not stars_move:
        hot = np.asarray(2 * spikes > len(looks))
    return hot, dead, stars_move


def _find_spikes(sky: _Sky) -> BoolArray:
    """Tell which pixels stand out of their neighbours as no star does."""
    row, column = np.nonzero(sky.pixels > SPIKE_SIGMAS * sky.sigma)
    value, sigma = sky.pixels[row, column], sky.sigma[row, column]
    around = np.delete(cut_patches(sky.pixels, row, column, 1).reshape(len(row), 9), 4, axis=1)
    # of the four pixels at its sides the brightest but one: an undersampled star lights at least two
    second = np.sort(around, axis=1)[:, -2]
    spike = second < np.maximum(SPIKE_SHARE * value, 2.5 * sigma)
    found = np.zeros(sky.pixels.shape, dtype=np.bool_)
    found[row[spike], column[spike]] = True
    return found


def _without_large(marked: BoolArray) -> tuple[BoolArray, int]:
    """Return marked pixels (rows, columns) without groups of many, and how many groups were taken out."""
    groups, count = label(marked, structure=np.ones((3, 3)))
    size = np.bincount(groups.ravel(), minlength=count + 1)
    keep = size <= LARGEST_BAD
    keep[0] = False
    return np.asarray(keep[groups]), int(np.count_nonzero(~keep[1:]))


@dataclass(frozen=True)
class _Sample:
    """Bright, round, unsaturated stars (n,) of one image."""

    x: FloatArray
    y: FloatArray
    flux: FloatArray
    radius: FloatArray

    @classmethod
    def of(cls, sky: _Sky, bad: BoolArray, saturation: float | None, dn: FloatArray, threshold: float) -> _Sample:
        """Find them with a filter of common width."""
        import sep  # noqa: PLC0415 - as above

        found = sep.extract(
            sky.pixels,
            threshold * _noise_left(FIRST_WIDTH_PX),
            err=sky.sigma,
            mask=bad,
            filter_kernel=_kernel(FIRST_WIDTH_PX),
            filter_type="conv",
            minarea=3,
        )
        round_ = (found["flag"] == 0) & (found["a"] < 1.5 * found["b"]) & (found["npix"] >= 4)
        if saturation is not None:
            peak = dn[found["ypeak"], found["xpeak"]]
            round_ &= peak < 0.8 * saturation
        found = found[round_]
        if not len(found):
            nothing = np.empty(0)
            return cls(nothing, nothing, nothing, nothing)
        reach = np.full(len(found), 2.0) + 5.0 * found["a"]
        flux, _, _ = sep.sum_circle(sky.pixels, found["x"], found["y"], reach, subpix=5)
        radius, flag = sep.flux_radius(sky.pixels, found["x"], found["y"], reach, 0.5, normflux=flux, subpix=5)
        good = (flag == 0) & (flux > 0) & np.isfinite(radius)
        return cls(found["x"][good], found["y"][good], flux[good], radius[good])


def _find_width(samples: Sequence[_Sample]) -> float:
    radii = np.concatenate([sample.radius for sample in samples])
    if not len(radii):
        raise RefusedInputError(
            "No measurable star was found in any image: they are too faint, all saturated, or hidden by clouds; change the "
            "exposure time, or check an image."
        )
    width = float(np.median(radii)) / HALF_FLUX
    if not NARROWEST_PX <= width <= WIDEST_PX:
        raise RefusedInputError(
            f"Stars are {width:.2g} px wide (one sigma), expected {NARROWEST_PX:g} to {WIDEST_PX:g}: put the lens "
            "into focus, or bin "
            "the image."
        )
    return width


@dataclass(frozen=True)
class _LitPixels:
    """What the pixels of one image's stars say, once their width is known.

    `slopes`: (n,) of the stars at their windowed centroids. `light`, `fine2`, `dark`: (n,) light of a pixel, square of the finest
    structure there, and variance of the sky.
    """

    slopes: FloatArray
    light: FloatArray
    fine2: FloatArray
    dark: FloatArray

    @classmethod
    def of(cls, sky: _Sky, sample: _Sample, width: float) -> _LitPixels:
        """Look at them."""
        return cls(_measure_slopes(sky, sample, width), *_noise_beside_light(sky, sample, width))


def _measure_slopes(sky: _Sky, sample: _Sample, width: float) -> FloatArray:
    import sep  # noqa: PLC0415 - as above

    x, y, _ = sep.winpos(sky.pixels, sample.x, sample.y, np.full(len(sample.x), width))
    row, column = _on(y, sky.pixels.shape[0]), _on(x, sky.pixels.shape[1])
    return find_slopes(cut_patches(sky.pixels, row, column, int(np.ceil(4.0 * width))), y - row, x - column, width)


def _find_slope(lit: Sequence[_LitPixels]) -> float | None:
    """Return the slope of the set's stars."""
    slopes = np.concatenate([one.slopes for one in lit])
    slopes = slopes[np.isfinite(slopes) & (slopes > 0.2) & (slopes < 0.8)]
    return float(np.median(slopes)) if len(slopes) else None


def _on(place: FloatArray, size: int) -> Any:
    """Nearest pixel (n,) of places along an axis."""
    return np.clip(np.rint(place).astype(np.int64), 0, size - 1)


def _find_gain(lit: Sequence[_LitPixels]) -> float | None:
    """Estimate electrons a DN; None where stars are too few or show no noise of their own."""
    I, v, s = (np.concatenate([getattr(one, name) for one in lit]) for name in ("light", "fine2", "dark"))
    sigma = np.sqrt(np.median(s))
    used = (sigma < I) & (1000.0 * sigma > I)
    if np.count_nonzero(used) < FEWEST_GAIN_PIXELS:
        return None
    I, v, s = I[used], v[used], s[used]
    edges = np.unique(np.quantile(I, np.linspace(0.0, 1.0, GAIN_BINS + 1)))
    bins = np.digitize(I, edges[1:-1])
    medians = np.array([[np.median(part[bins == k]) for part in (I, v, s)] for k in np.unique(bins)])
    light, noise, dark = medians[:, 0], medians[:, 1] / CHI2_MEDIAN, medians[:, 2]
    A = np.column_stack([light, light**2]) / noise[:, None]
    solution, _ = nnls(A, np.maximum(noise - dark, 0.0) / noise)
    return float(1.0 / solution[0]) if solution[0] > 0 else None


def _noise_beside_light(sky: _Sky, sample: _Sample, width: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Light, square of the finest structure, and variance of the sky (n,) at the pixels of stars."""
    row, column = _on(sample.y, sky.pixels.shape[0]), _on(sample.x, sky.pixels.shape[1])
    patches = cut_patches(sky.pixels, row, column, compute_reach(width) + len(FINEST) // 2)
    fine, light = patches, patches
    for axis in (1, 2):
        fine = convolve1d(fine, FINEST / np.sqrt((FINEST**2).sum()), axis=axis)
        light = convolve1d(light, FINEST**2 / (FINEST**2).sum(), axis=axis)
    inner = slice(len(FINEST) // 2, -(len(FINEST) // 2))
    light, fine = light[:, inner, inner], fine[:, inner, inner]
    dark = np.broadcast_to((sky.sigma[row, column] ** 2)[:, None, None], light.shape)
    return light.ravel(), fine.ravel() ** 2, dark.ravel()


def _kernel(sigma_px: float) -> FloatArray:
    """A Gaussian (k, k) to filter by."""
    half = int(np.ceil(2.0 * sigma_px))
    d = np.arange(-half, half + 1)
    return np.asarray(np.exp(-(d[:, None] ** 2 + d[None, :] ** 2) / (2.0 * sigma_px**2)))


def _noise_left(sigma_px: float) -> float:
    """Standard deviation of white noise after filtering by `_kernel`, for one before."""
    kernel = _kernel(sigma_px)
    return float(np.sqrt((kernel**2).sum()) / kernel.sum())


def detect(dn: FloatArray, common: Common, options: DetectionOptions) -> Detections:
    """Find the stars of an image (rows, columns)."""
    import sep  # noqa: PLC0415 - as above

    bad = common.bad
    sky = subtract_sky(dn, bad if bad.any() else None)
    trails, spoiled = _find_large(sky, common)
    sky = subtract_sky(dn, bad | trails) if trails.any() else sky
    pixels = _fill(sky.pixels, bad)
    found = sep.extract(
        pixels,
        options.threshold * _noise_left(common.window.sigma_px),
        err=sky.sigma,
        mask=trails,
        filter_kernel=_kernel(common.window.sigma_px),
        filter_type="conv",
        minarea=2,
        deblend_cont=0.005,
    )
    x, y, flag = sep.winpos(pixels, found["x"], found["y"], np.full(len(found), common.window.sigma_px), mask=trails)
    stars = _measure(dn, pixels, sky, found, x, y, common, options)
    reason = _judge(found, x, y, flag, stars, bad, trails, common, 0.5 * options.threshold)
    kept = np.flatnonzero(reason == "")
    kept = kept[np.argsort(-stars.flux_dn[kept], kind="stable")]
    reason[kept[options.most_stars :]] = REASONS[-1]
    kept = kept[: options.most_stars]
    left_out = {name: int(np.count_nonzero(reason == name)) for name in REASONS}
    left_out["trail or large object"] += spoiled
    return _take(stars, kept, left_out, int(np.count_nonzero(trails)))


def _fill(pixels: FloatArray, bad: BoolArray) -> FloatArray:
    """Put the median of the neighbours in place of bad pixels."""
    row, column = np.nonzero(bad)
    filled = pixels.copy()
    around = cut_patches(np.where(bad, np.nan, pixels), row, column, 1).reshape(len(row), 9)
    with np.errstate(all="ignore"):
        known = np.isfinite(around).any(axis=1)
        filled[row[known], column[known]] = np.nanmedian(around[known], axis=1)
    filled[row[~known], column[~known]] = 0.0
    return filled


def _find_large(sky: _Sky, common: Common) -> tuple[BoolArray, int]:
    """Find what is too large or too long for a star; returns its pixels with a margin, and how many objects they are."""
    import sep  # noqa: PLC0415 - as above

    sigma = common.window.sigma_px
    found, segments = sep.extract(
        sky.pixels, 2.5, err=sky.sigma, mask=common.bad, filter_kernel=None,
        minarea=max(5, int(4.0 * sigma**2)), deblend_cont=1.0, clean=False, segmentation_map=True,
    )  # fmt: skip
    # a star of this peak covers so much above the threshold; a bright one's wings go far
    contrast = np.maximum(found["cpeak"] / np.maximum(found["thresh"], 1e-9), 2.0)
    area = np.pi * (2.0 * np.log(contrast)) * 2.0 * sigma**2
    long = (found["a"] > LONGEST * found["b"]) & (found["a"] > LONGEST * sigma)
    large = (found["npix"] > 6.0 * area + 30.0 * sigma**2) & (found["npix"] > LARGEST_AREAS * sigma**2)
    wrong = np.flatnonzero(long | large)
    if not len(wrong):
        return np.zeros(sky.pixels.shape, dtype=np.bool_), 0
    marked = np.isin(segments, wrong + 1)
    for k in wrong[long[wrong]]:
        marked |= _line_through(marked.shape, found[k], 2.0 * sigma)
    margin = int(np.ceil(2.0 * sigma)) + 1
    disc = np.hypot(*np.mgrid[-margin : margin + 1, -margin : margin + 1]) <= margin
    return np.asarray(binary_dilation(marked, structure=disc)), len(wrong)


def _line_through(shape: tuple[int, ...], item: Any, half_width: float) -> BoolArray:
    """Pixels of the line along a long object, which goes on where it is too faint to be seen, as far as it is long again."""
    row, column = np.arange(shape[0])[:, None] - item["y"], np.arange(shape[1])[None, :] - item["x"]
    cosine, sine = np.cos(item["theta"]), np.sin(item["theta"])
    return np.asarray(
        (np.abs(row * cosine - column * sine) <= half_width) & (np.abs(column * cosine + row * sine) <= 4.0 * item["a"])
    )


def _measure(
    dn: FloatArray,
    pixels: FloatArray,
    sky: _Sky,
    found: Any,
    x: FloatArray,
    y: FloatArray,
    common: Common,
    options: DetectionOptions,
) -> Detections:
    """Measure every object."""
    import sep  # noqa: PLC0415 - as above

    row, column = _on(y, dn.shape[0]), _on(x, dn.shape[1])
    patches = cut_patches(pixels, row, column, common.window.reach)
    sigma = sky.sigma[row, column]
    gain = options.gain_e_per_dn or common.gain_e_per_dn
    photons = 0.0 if gain is None else np.maximum(patches, 0.0) / gain
    covariance = centroid_covariance(patches, sigma[:, None, None] ** 2 + photons, y - row, x - column, common.window)
    radius = np.full(len(found), 2.5 * common.window.sigma_px)
    flux, flux_sigma, _ = sep.sum_circle(
        pixels, x, y, radius, err=sky.sigma, gain=gain, bkgann=(1.6 * radius, 2.4 * radius), subpix=5
    )
    saturated = np.zeros(len(found), dtype=np.bool_)
    if common.saturation_dn is not None:
        around = cut_patches(dn, row, column, max(1, round(common.window.sigma_px)))
        saturated = np.asarray((around >= common.saturation_dn).any(axis=(1, 2)))
    # a flat top says nothing of where its middle is: the window is blind by as much as the top is wide
    covariance[saturated, :2] += (0.5 * common.window.sigma_px) ** 2
    return Detections(
        row_px=y,
        col_px=x,
        covariance=covariance,
        flux_dn=flux,
        flux_sigma_dn=flux_sigma,
        peak_dn=dn[row, column],
        background_dn=np.asarray(sky.level[row, column], dtype=np.float64),
        background_sigma_dn=sigma,
        saturated=saturated,
    )


def _judge(  # noqa: PLR0913, PLR0917 - what a judgement rests on
    found: Any,
    x: FloatArray,
    y: FloatArray,
    flag: Any,
    stars: Detections,
    bad: BoolArray,
    trails: BoolArray,
    common: Common,
    faintest: float,
) -> Any:
    """Return the reason (n,) why each object is no star, empty where it is one."""
    sigma = common.window.sigma_px
    reach, shape = 2.5 * sigma, bad.shape
    row, column = _on(y, shape[0]), _on(x, shape[1])
    near_bad = cut_patches(bad.astype(np.float64), row, column, round(1.5 * sigma)).any(axis=(1, 2))
    on_trail = cut_patches(trails.astype(np.float64), row, column, round(1.5 * sigma)).any(axis=(1, 2))
    edge = (y < reach) | (x < reach) | (y > shape[0] - 1 - reach) | (x > shape[1] - 1 - reach)
    snr = stars.flux_dn / stars.flux_sigma_dn
    slack = 1.0 + 6.0 / np.maximum(snr, 1e-9)
    width = np.sqrt(found["a"] * found["b"])
    round_ = (width < SHAPE[1] * slack * sigma) | stars.saturated
    round_ &= found["a"] < 1.7 * slack * np.maximum(found["b"], 0.3)
    strayed = np.hypot(x - found["x"], y - found["y"]) > sigma
    measured = (flag == 0) & np.isfinite(stars.covariance).all(axis=1) & (snr > faintest)
    blended = _is_blended(x, y, stars, common.window)
    tests = (edge, near_bad, on_trail, ~(round_ & measured) | strayed, blended)
    reason = np.full(len(found), "", dtype=object)
    for name, test in reversed(list(zip(REASONS, tests, strict=False))):
        reason[test] = name
    return reason


def _is_blended(x: FloatArray, y: FloatArray, stars: Detections, window: Window) -> BoolArray:
    """Tell which objects (n,) a detected neighbour draws by over `LARGEST_PULL` of their sigma.

    Of a star of flux F a neighbour of flux G at distance d draws the centroid by G d exp(-d^2 / 4 s^2) / (2 F k), both Gaussians
    of the window's width s.
    """
    from scipy.spatial import KDTree  # noqa: PLC0415 - 20 ms

    s = window.sigma_px
    blended = np.zeros(len(x), dtype=np.bool_)
    if len(x) > 1:
        pairs = KDTree(np.column_stack([x, y])).query_pairs(8.0 * s, output_type="ndarray")
        for i, j in (pairs.T, pairs[:, ::-1].T):
            d = np.hypot(x[i] - x[j], y[i] - y[j])
            with np.errstate(divide="ignore", invalid="ignore"):
                pull = stars.flux_dn[j] / stars.flux_dn[i] * d * np.exp(-((d / s) ** 2) / 4.0) / (2.0 * window.slope)
            blended[i[pull > LARGEST_PULL * stars.sigma_px[i]]] = True
    return blended


def _take(stars: Detections, rows: Any, left_out: dict[str, int], trail_pixels: int) -> Detections:
    """Return some of the stars."""
    return Detections(
        row_px=stars.row_px[rows],
        col_px=stars.col_px[rows],
        covariance=stars.covariance[rows],
        flux_dn=stars.flux_dn[rows],
        flux_sigma_dn=stars.flux_sigma_dn[rows],
        peak_dn=stars.peak_dn[rows],
        background_dn=stars.background_dn[rows],
        background_sigma_dn=stars.background_sigma_dn[rows],
        saturated=stars.saturated[rows],
        left_out=left_out,
        trail_pixels=trail_pixels,
    )
