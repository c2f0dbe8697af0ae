"""From images to a calibration: three extractors beside truth, and the whole way from a hard night to parameters (part `images`).

**Extractors.** Stars on a grid, at five ratios of a star's brightest pixel to the noise of the sky, each at a place of its own
in its pixel. The error of a centroid is held against the Cramer-Rao bound of a Gaussian of known width in that noise, for a
star in the middle between two kinds of places. `sep` is asked for its windowed centroids (the product's way), `sep_moments`
for those of its detection, `tetra3rs` as it comes, photutils by its finder for speed (IRAF's) and by fitting the true shape
(`photutils_fit`), which starts from sep's detections. Stars whose centroid is over a pixel off, or that are not found, are
counted as missed.

**Calibrations.** The same night sky through each extractor: centroids within a pixel of a true star keep its name, and all have one
sigma, so that only the centroids differ. What is told is how far the fitted camera is off over the detector, RMS, after the
best attitude.

**The whole way.** Sets of night images from a site on the ground, with refraction, hot and dead pixels, trails, clouds over a third
and a mirrored sky go through `extract` and `calibrate` lost in space, with the site in the sensor file: as they come, with blended
stars kept, without all that the catalogue calls double, and without the site. The error is held against the bound that calibration
states for the extractor's own sigmas:

    rmse_over_bound = sqrt(mean over sets of (x - x_true)^T P^-1 (x - x_true) / p)

A bootstrap over the sets gives its interval; NEES has its chi-square bounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from benchmarks import Report, held
from boresight.arrays import FloatArray
from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.images.detection import DetectionOptions, Look, detect, learn, subtract_sky
from boresight.images.extraction import FoundStars, assemble
from boresight.images.psf import HALF_FLUX
from boresight.settings import read_settings
from boresight.simulation.images import Optics, SimulatedImage, draw_stars, simulate_images
from boresight.simulation.scenes import GROUND, Scenario, calibration_scenario
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.declarations import Declared
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor, parse_sensor

RATIOS = (5, 10, 30, 100, 300)
GRID, SPACING_PX = 14, 40
RMSE_LIMIT = 1.15
TRUTH = np.array([1.0005, 0.0136, 652.0, 470.0, -0.12, 0.08, 0.0, 0.0, 0.0])
OPTICS = Optics(zero_magnitude_e=3e5)
#: Where the camera stands, and how far up its fields begin and reach.
SITE = {"latitude_deg": 47.0, "longitude_deg": 8.0, "height_m": 500.0, "pressure_hpa": 955.0, "temperature_c": 5.0}
LOWEST_DEG, SPAN_DEG = 30.0, 50.0
HARD = replace(OPTICS, hot_share=2e-5, dead_share=1e-5, trails=0.5, cloud_share=1.0 / 3.0)
#: Pairs that no pixel resolves are seen where neither star is; the catalogue knows most of them.
SETTINGS = {
    "as_it_comes": CalibrationSettings(),
    "blends_kept": CalibrationSettings(blends="keep"),
    "without_doubles": CalibrationSettings(blends="keep", leave_out_doubles=True),
}
#: The same without the site in the sensor file, and so without the air.
WITHOUT_SITE = "site_unknown"
Extractor = Callable[[FloatArray, Optics], FloatArray]


def measure(
    report: Report, *, stars: int = GRID * GRID, sets: int = 24, frames: int = 8, calibrations: int = 6, seed: int = 1
) -> dict[str, Any]:
    """Measure the extractors, the calibrations that result, and the whole way."""
    rng = np.random.default_rng(seed)
    catalogue = load_catalogue(read_settings().catalogue_folder)
    centroids = {}
    for k, ratio in enumerate(RATIOS):
        report(0.2 * k / len(RATIOS), f"centroids of stars {ratio} sigmas high")
        centroids[str(ratio)] = _compare_centroids(ratio, stars, rng)
    report(0.2, "calibrations by each extractor")
    results = _compare_calibrations(calibrations, frames, catalogue, seed)
    night = _go_whole_way(report, sets, frames, catalogue, seed)
    return {
        "stars": stars,
        "sets": sets,
        "frames": frames,
        "calibration_sets": calibrations,
        "centroids": centroids,
        "calibrations": results,
        "night": night,
        "limits": {
            "from hard night images through air: error over the bound": held(
                RMSE_LIMIT, night["as_it_comes"]["rmse_over_bound"]
            ),
            "from hard night images through air: chi-square outside its bounds": held(
                0, int(not night["as_it_comes"]["consistent"])
            ),
        },
    }


def make_sensor() -> Sensor:
    """A lens of 13.5 mm before a detector of 960 by 1280 pixels, mirrored: 20 by 27 degrees."""
    return parse_sensor(
        {
            "name": "night camera",
            "detector": {"rows": 960, "columns": 1280, "pixel_pitch_m": 3.75e-6},
            "camera_model": "brown_conrady",
            "parity": -1,
            "centroid_sigma_px": 0.1,
            "initial": dict(zip(_names(), [1.0, 0.0135, 640.0, 480.0, 0.0, 0.0, 0.0, 0.0, 0.0], strict=True)),
            "typical_sigma": dict(zip(_names(), [1e-3, 2e-4, 20.0, 20.0, 0.1, 0.5, 2e-3, 2e-3, 1.0], strict=True)),
            "free": ["s", "f_m", "u0_px", "v0_px", "k1", "k2"],
            "magnitude_limit": 6.5,
            "site": SITE,
            "declared": Declared("negligible", "apparent", "uncorrected").document(),
        }
    )


def _names() -> tuple[str, ...]:
    return CAMERA_MODELS["brown_conrady"].parameter_names


def make_night(frames: int, number: int = 0) -> Scenario:
    """A night over a site, a field a minute; each number another sky."""
    base = calibration_scenario(1)
    begin = np.datetime64("2026-11-01T18:00:00", "us") + number * np.timedelta64(15 * 24 * 60 + 97, "m")
    return replace(
        base,
        sensor=make_sensor(),
        truth=TRUTH,
        frames=frames,
        exposures=1,
        orbit=replace(base.orbit, start_utc=begin),
        sample_period_s=60.0,
        motion=GROUND,
        pointing_rad=float(np.radians(LOWEST_DEG)),
        elevation_span_deg=SPAN_DEG,
    )


def _compare_centroids(ratio: float, stars: int, rng: np.random.Generator) -> dict[str, Any]:
    """Errors of every extractor on one image of a grid of stars."""
    side = int(np.sqrt(stars))
    place = (np.arange(side) + 1.0) * SPACING_PX
    row, col = (axis.ravel() + rng.uniform(-0.5, 0.5, side**2) for axis in np.meshgrid(place, place, indexing="ij"))
    electrons = np.full(((side + 1) * SPACING_PX,) * 2, OPTICS.sky_e)
    total = ratio * OPTICS.background_sigma_e * 2.0 * np.pi * OPTICS.psf_sigma_px**2
    draw_stars(electrons, row, col, np.full(side**2, total), OPTICS)
    noise = OPTICS.read_noise_e * rng.standard_normal(electrons.shape)
    dn = np.rint(np.clip(rng.poisson(electrons) + noise + OPTICS.bias_dn, 0, OPTICS.white_dn))
    bound = _bound_px(total)
    found: dict[str, Any] = {"bound_px": bound}
    for name, extract in EXTRACTORS.items():
        extract(dn, OPTICS)  # what is loaded once is no part of the time
        started = time.process_time()
        try:
            places = extract(dn, OPTICS)
        except ImportError:
            found[name] = None
            continue
        spent = time.process_time() - started
        nearest, error = _errors(places, row, col)
        rmse = float(np.sqrt(np.mean(error**2))) if len(error) else None
        found[name] = {
            "rmse_px": rmse,
            "over_bound": None if rmse is None else rmse / bound,
            "missed": int(side**2 - len(np.unique(nearest))),
            "false": len(places) - len(nearest),
            "ms": spent * 1e3,
        }
    return found


def _errors(places: FloatArray, row: FloatArray, col: FloatArray) -> tuple[Any, FloatArray]:
    """The true star of each centroid (n, 2) within a pixel of one, and the errors (n, 2)."""
    if not len(places):
        return np.empty(0, np.int64), np.empty((0, 2))
    apart = np.hypot(places[:, 0, None] - row, places[:, 1, None] - col)
    nearest, near = apart.argmin(axis=1), apart.min(axis=1) < 1.0
    nearest = nearest[near]
    return nearest, places[near] - np.column_stack([row[nearest], col[nearest]])


def _bound_px(total: float) -> float:
    """Cramer-Rao bound of one axis of a centroid, where flux and background are known: they are not correlated with it."""
    size, h, place = 31, 1e-3, np.array([15.2])

    def image(shift: float) -> FloatArray:
        one = np.zeros((size, size))
        draw_stars(one, place + shift, np.array([15.3]), np.array([total]), OPTICS)
        return one

    slope = (image(h) - image(-h)) / (2.0 * h)
    return float(1.0 / np.sqrt((slope**2 / (image(0.0) + OPTICS.background_sigma_e**2)).sum()))


def _product(dn: FloatArray, optics: Optics) -> FloatArray:
    """Do what the product does, from this one image."""
    options = DetectionOptions(threshold=6.0, most_stars=5000, gain_e_per_dn=optics.gain_e_per_dn)
    found = detect(dn, learn([Look(dn)], options, None), options)
    return np.column_stack([found.row_px, found.col_px])


def _sep_moments(dn: FloatArray, _optics: Optics) -> FloatArray:
    import sep  # noqa: PLC0415 - as the peers beside it

    sky = subtract_sky(dn)
    found = sep.extract(sky.pixels, 2.5, err=sky.sigma, minarea=3)
    return np.column_stack([found["y"], found["x"]])


def _tetra3rs(dn: FloatArray, _optics: Optics) -> FloatArray:
    import tetra3rs  # noqa: PLC0415 - an extra

    found = tetra3rs.extract_centroids(dn.astype(np.uint16), threads=1).centroids
    middle = (np.array(dn.shape) - 1.0) / 2.0
    return np.array([[one.y, one.x] for one in found]).reshape(-1, 2) + middle


def _photutils(dn: FloatArray, optics: Optics) -> FloatArray:
    from photutils.detection import IRAFStarFinder  # noqa: PLC0415 - a peer

    sky = subtract_sky(dn)
    width = 2.0 * HALF_FLUX * optics.psf_sigma_px
    found = IRAFStarFinder(threshold=4.0 * float(sky.sigma.mean()), fwhm=width)(sky.pixels)
    return np.empty((0, 2)) if found is None else np.column_stack([found["y_centroid"], found["x_centroid"]])


def _photutils_fit(dn: FloatArray, optics: Optics) -> FloatArray:
    from astropy.table import Table  # noqa: PLC0415 - as below
    from photutils.psf import CircularGaussianPRF, PSFPhotometry  # noqa: PLC0415 - a peer

    start, sky = _product(dn, optics), subtract_sky(dn)
    noise = np.sqrt(sky.sigma**2 + np.maximum(sky.pixels, 0.0))
    fit = PSFPhotometry(
        CircularGaussianPRF(fwhm=2.0 * HALF_FLUX * optics.psf_sigma_px), fit_shape=(9, 9), aperture_radius=4
    )
    found = fit(sky.pixels, error=noise, init_params=Table({"x": start[:, 1], "y": start[:, 0]}))
    return np.column_stack([found["y_fit"], found["x_fit"]])


EXTRACTORS: dict[str, Extractor] = {
    "sep": _product,
    "sep_moments": _sep_moments,
    "tetra3rs": _tetra3rs,
    "photutils": _photutils,
    "photutils_fit": _photutils_fit,
}


def _compare_calibrations(sets: int, frames: int, catalogue: Catalogue, seed: int) -> dict[str, Any]:
    """Errors of the camera over the detector by each extractor, on clean nights."""
    errors: dict[str, list[float]] = {name: [] for name in EXTRACTORS}
    for k in range(sets):
        scenario = make_night(frames, k)
        images = list(simulate_images(scenario, OPTICS, np.random.default_rng([seed, 7, k]), catalogue))
        for name, extract in EXTRACTORS.items():
            try:
                found = [extract(image.dn.astype(np.float64), OPTICS) for image in images]
            except ImportError:
                continue
            telemetry = _named(found, images)
            settings = CalibrationSettings(match="given", robust="none")
            fitted = calibrate(telemetry, scenario.sensor, catalogue, settings)
            if fitted.status == "converged":
                x = np.array([getattr(fitted.parameters, n) for n in _names()])
                errors[name].append(_camera_error_px(scenario.sensor, x))
    return {
        name: {"error_px": float(np.sqrt(np.mean(np.square(some)))), "converged": len(some)} if some else None
        for name, some in errors.items()
    }


def _named(found: list[FloatArray], images: list[SimulatedImage]) -> Telemetry:
    """Telemetry of centroids that lie within a pixel of a true star brighter than the limit, with its name, each star once."""
    parts = []
    for image, places in zip(images, found, strict=True):
        bright = np.flatnonzero(image.magnitude < 6.5)
        nearest, error = _errors(places, image.row_px[bright], image.col_px[bright])
        star, first = np.unique(nearest, return_index=True)
        true = np.column_stack([image.row_px[bright], image.col_px[bright]])[star]
        parts.append(
            (np.full(len(star), image.frame), true + error[first], image.star_id[bright][star], image.time_utc)
        )
    count = [len(part[0]) for part in parts]
    place = np.concatenate([part[1] for part in parts])
    return Telemetry(
        frame=np.concatenate([part[0] for part in parts]).astype(np.int64),
        exposure=np.zeros(len(place), dtype=np.int64),
        row_px=place[:, 0].copy(),
        col_px=place[:, 1].copy(),
        time_utc=np.repeat(np.array([part[3] for part in parts]), count),
        star_id=np.concatenate([part[2] for part in parts]).astype(np.int64),
    )


def _camera_error_px(sensor: Sensor, x: FloatArray) -> float:
    """RMS over the detector of how far a camera is off, after the rotation that brings it nearest to the truth."""
    camera = CAMERA_MODELS[sensor.camera_model]
    rows, columns = (
        axis.ravel() for axis in np.meshgrid(np.linspace(0, 959, 25), np.linspace(0, 1279, 33), indexing="ij")
    )
    true, fitted = (camera.directions(one, rows, columns, sensor.pixel_pitch_m) for one in (TRUTH, x))
    u, _, v = np.linalg.svd(true.T @ fitted)
    turned = fitted @ (u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v).T
    row, col = camera.project(TRUTH, turned, sensor.pixel_pitch_m)
    return float(np.sqrt(np.mean((row - rows) ** 2 + (col - columns) ** 2) / 2.0))


def _go_whole_way(report: Report, sets: int, frames: int, catalogue: Catalogue, seed: int) -> dict[str, Any]:
    """Calibrate from hard nights, lost in space; returns errors over the bound and the time of a frame."""
    sensor = make_sensor()
    free = [_names().index(name) for name in sensor.free]
    scores: dict[str, list[tuple[float, float, float]]] = {name: [] for name in (*SETTINGS, WITHOUT_SITE)}
    spent, bad, stars = 0.0, 0, 0
    for k in range(sets):
        scenario = make_night(frames, k)
        report(0.4 + 0.6 * k / sets, f"hard night {k + 1} of {sets}")
        images = list(simulate_images(scenario, HARD, np.random.default_rng([seed, 11, k]), catalogue))
        started = time.process_time()
        telemetry, pixels = _extract(images, sensor)
        spent += time.process_time() - started
        bad, stars = bad + pixels, stars + len(telemetry)
        for name, settings in SETTINGS.items():
            scores[name].append(_score(telemetry, sensor, free, settings, catalogue))
        scores[WITHOUT_SITE].append(
            _score(telemetry, replace(sensor, site=None), free, SETTINGS["as_it_comes"], catalogue)
        )
    return {
        **{name: _summary(np.array(some), len(free), seed) for name, some in scores.items()},
        "stars_per_frame": stars / (sets * frames),
        "bad_pixels": bad / sets,
        "extraction_ms_per_frame": spent / (sets * frames) * 1e3,
        "megapixels": sensor.rows * sensor.columns / 1e6,
    }


def _score(
    telemetry: Telemetry, sensor: Sensor, free: list[int], settings: CalibrationSettings, catalogue: Catalogue
) -> tuple[float, float, float]:
    """NEES over its parameters of a calibration lost in space, its chi-square, and its stars; infinite where it failed."""
    fitted = calibrate(telemetry, sensor, catalogue, settings, cache_folder=read_settings().catalogue_folder)
    if fitted.status != "converged" or fitted.covariance is None or fitted.chi2_per_dof is None:
        return np.inf, np.inf, 0.0
    e = (np.array([getattr(fitted.parameters, name) for name in _names()]) - TRUTH)[free]
    nees = float(e @ np.linalg.solve(np.array(fitted.covariance.matrix), e)) / len(free)
    return nees, float(fitted.chi2_per_dof), float(fitted.stars)


def _summary(scores: FloatArray, parameters: int, seed: int) -> dict[str, Any]:
    """Error over the bound with its interval, NEES with its bounds, of the (sets, 3) scores."""
    values = scores[:, 0]
    bounds = chi2.ppf([0.025, 0.975], len(values) * parameters) / (len(values) * parameters)
    drawn = np.random.default_rng(seed).choice(values, (2000, len(values)))
    return {
        "rmse_over_bound": float(np.sqrt(values.mean())),
        "rmse_over_bound_interval": np.quantile(np.sqrt(drawn.mean(axis=1)), (0.025, 0.975)).tolist(),
        "nees": float(values.mean()),
        "nees_bounds": bounds.tolist(),
        "consistent": bool(bounds[0] <= values.mean() <= bounds[1]),
        "chi2_per_dof": float(scores[:, 1].mean()),
        "stars": float(scores[:, 2].mean()),
        "converged": int(np.isfinite(values).sum()),
    }


def _extract(images: list[SimulatedImage], sensor: Sensor) -> tuple[Telemetry, int]:
    """Extract images that are in memory; returns the telemetry and how many pixels were told to be bad."""
    options = DetectionOptions(gain_e_per_dn=HARD.gain_e_per_dn)
    pixels = [image.dn.astype(np.float64) for image in images]
    common = learn([Look(dn) for dn in pixels], options, None)
    found = [
        FoundStars(k, f"{k}", "", image.time_utc, "", detect(one, common, options))
        for k, (image, one) in enumerate(zip(images, pixels, strict=True))
    ]
    return assemble(found, sensor, common).telemetry, int(common.bad.sum())
