"""Stars of a known lens as arcs, and the search on them, for the tests of choosing."""

from dataclasses import replace

import numpy as np

from boresight.calibration.choice.fits import whitened_at
from boresight.calibration.choice.search import find_least, fit_ladders
from boresight.cameras import CAMERA_MODELS
from boresight.telemetry.sensors import Sensor
from tests.estimation.fields import arranged, drawn

PITCH, SIZE, FOCAL_PX, NOISE_PX = 5.5e-6, 2048, 4500.0, 0.1
CORNER = np.hypot(SIZE, SIZE) / 2 / FOCAL_PX  # tangent at the corner
#: Tangential terms that move a star at the corner by so much a pixel.
DECENTRING_PER_PX = 1 / (3 * FOCAL_PX * CORNER**2)
PLAIN = {"focal_px": 4510.0, "row_px": 1030.0, "col_px": 1015.0}


def lens(name, **terms):
    """A lens near 4510 px with some parameters of its own."""
    camera = CAMERA_MODELS[name]
    x = camera.plain(**PLAIN, pitch=PITCH)
    for key, value in terms.items():
        x[camera.parameter_names.index(key)] = value
    return camera, x


def sensor(name, noise_px=NOISE_PX):
    camera = CAMERA_MODELS[name]
    x = camera.plain(FOCAL_PX, (SIZE - 1) / 2, (SIZE - 1) / 2, PITCH)
    sigma = np.array(camera.default_typical_sigma)
    return Sensor("lens", SIZE, SIZE, PITCH, name, 1, noise_px, x, sigma, camera.parameter_names)


def field(rng, camera, truth, frames=60, stars=14, noise_px=NOISE_PX, stated_px=None):
    drawn_stars = drawn(rng, camera, truth, PITCH, (SIZE, SIZE), frames, stars, noise_px)
    starts, *rest = drawn_stars
    arcs = arranged(starts, np.arange(frames + 1), *rest, noise_px if stated_px is None else stated_px)
    return replace(arcs, camera=camera, pitch=PITCH)


def search(arcs, of_sensor):
    """The search as `choose` makes it, from arcs on."""
    camera, x = CAMERA_MODELS[of_sensor.camera_model], of_sensor.initial
    for _ in range(2):
        fits, richest = fit_ladders(whitened_at(arcs, camera, x), of_sensor)
        camera, x = richest.camera, richest.x
    return fits, find_least(fits, richest)
