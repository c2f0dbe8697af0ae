"""Which camera is chosen for lenses of every camera by sensors of every camera (part `choice`).

For each lens of `LENSES` many sets are simulated with its own model, and each is given to a sensor of every camera, as if its file
said so. The search is the command's (`calibration.choice.search`), from arcs on: matched stars, right noise. Told are, per lens and
sensor,

- `chosen`: how often each camera was chosen, and `named` the terms that were named most often;
- `false`: sets in which the choice holds something that the stars do not ask for. What they ask for is known by fitting the
  same stars without their noise, weighed as if they had it. A term is false where the camera without it would miss these by
  less than `NOTHING` in chi-square, and another camera than the sensor's where the sensor's own with everything free would. A
  plainer camera or term that fits as well is right, and so is the sensor's own camera where it holds another's lens by terms of
  its own;
- `missed`: sets in which the chosen candidate misses the noise-free stars by so much (`MISSED`) that a test of a single term
  at the level would find it in one set of two;
- `held_out_over_noise`: how far the chosen camera is off on further stars without noise, over the noise that a set's stars
  have, root mean square of whitened arcs over all sets; `own_terms_over_noise` the same of the lens's own camera and terms,
  whose error is that of the estimate alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import binom, chi2

from benchmarks import Report, held
from benchmarks.stars import uniform_field
from boresight.arrays import FloatArray
from boresight.calibration.choice.fits import Fits, FittedSubset, seen_by, whitened_at
from boresight.calibration.choice.nested_tests import LEVEL
from boresight.calibration.choice.search import find_least, fit_ladders
from boresight.calibration.choice.terms import Subset, find_terms, largest
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.errors import RefusedInputError
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.telemetry.sensors import Sensor

PITCH_M, SIZE, FOCAL_PX, NOISE_PX, STARS = 5.5e-6, 2048, 4500.0, 0.1, 14
#: Chi-square of noise-free stars below which a term or a camera is not asked for.
NOTHING = 1.0
#: Chi-square of noise-free stars from which a single term is found in one set of two.
MISSED = float(chi2.isf(LEVEL, 1))
#: Share of runs in which chance alone breaks the bound on false choices.
CHANCE = 0.001
CORNER = float(np.hypot(SIZE, SIZE) / 2 / FOCAL_PX)
#: Tangential terms, without unit, that move a star at the corner by so much a pixel.
TANGENTIAL_PER_PX = 1 / (3 * FOCAL_PX * CORNER**2)


@dataclass(frozen=True)
class Lens:
    """A lens: its camera, the terms that it has, their values, and what it shows."""

    camera: str
    shows: str
    terms: tuple[str, ...]
    values: Mapping[str, float] = field(default_factory=dict)

    @property
    def x(self) -> FloatArray:
        """Its state, near 4510 px, the principal point some pixels off the middle."""
        camera = CAMERA_MODELS[self.camera]
        x = camera.plain(4510.0, 1030.0, 1015.0, PITCH_M)
        for name, value in self.values.items():
            x[camera.parameter_names.index(name)] = value
        return x

    @property
    def subset(self) -> Subset:
        """Its camera with its terms free."""
        camera = CAMERA_MODELS[self.camera]
        return Subset(camera, tuple(term for term in find_terms(camera) if term.name in self.terms))


_P1, _P2 = 0.4 * TANGENTIAL_PER_PX, -0.3 * TANGENTIAL_PER_PX
LENSES: tuple[Lens, ...] = (
    Lens("inverted_wang", "radial distortion", ("principal point", "radial r³"), {"b2_per_m2": 150.0}),
    Lens(
        "inverted_wang_decentred", "radial distortion, 0.5 px of decentring",
        ("principal point", "radial r³", "tangential"),
        {"b2_per_m2": 150.0, "p1_per_m": _P2 / (FOCAL_PX * PITCH_M), "p2_per_m": _P1 / (FOCAL_PX * PITCH_M)},
    ),
    Lens(
        "pinhole_radial", "two orders of radial distortion", ("principal point", "radial r³", "radial r⁵"),
        {"k1": -0.1, "k2": 0.08},
    ),
    Lens(
        "brown_conrady", "two orders of radial distortion, 0.5 px of decentring",
        ("principal point", "radial r³", "radial r⁵", "tangential"), {"k1": -0.1, "k2": 0.08, "p1": _P1, "p2": _P2},
    ),
    Lens(
        "kannala_brandt", "an equidistant lens with distortion", ("principal point", "radial r³", "radial r⁵"),
        {"k1": -0.05, "k2": 0.03},
    ),
)  # fmt: skip


def describe_sensor(name: str) -> Sensor:
    """Describe a sensor of a camera without distortion, ten pixels of focal length and some of principal point off any lens."""
    camera = CAMERA_MODELS[name]
    x = camera.plain(FOCAL_PX, (SIZE - 1) / 2, (SIZE - 1) / 2, PITCH_M)
    sigma = np.array(camera.default_typical_sigma)
    return Sensor("lens", SIZE, SIZE, PITCH_M, name, 1, NOISE_PX, x, sigma, camera.parameter_names)


def search(arcs: ArcSet, sensor: Sensor) -> tuple[Fits, FittedSubset]:
    """Search as `boresight choose` does, from arcs on; returns all fits and the chosen one."""
    camera, x = CAMERA_MODELS[sensor.camera_model], sensor.initial
    fits, richest = fit_ladders(whitened_at(arcs, camera, x), sensor)
    if richest is not None:  # the weights of the richest camera, as the command takes them
        fits, richest = fit_ladders(whitened_at(arcs, richest.camera, richest.x), sensor)
    least = None if richest is None else find_least(fits, richest)
    if least is None:
        raise RefusedInputError("No camera could be fitted to a simulated set.")
    return fits, least.chosen.fitted


def measure(
    report: Report, *, sets: int = 60, frames: int = 40, cameras: tuple[str, ...] = tuple(CAMERA_MODELS)
) -> dict[str, Any]:
    """Choose for every set of every lens by a sensor of every camera."""
    lenses = [lens for lens in LENSES if lens.camera in cameras]
    found: dict[str, Any] = {}
    false, many = 0, 0
    for place, lens in enumerate(lenses):
        trials: dict[str, list[Trial]] = {name: [] for name in CAMERA_MODELS}
        for seed in range(sets):
            report((place + seed / sets) / len(lenses), f"{lens.camera}, set {seed + 1} of {sets}")
            for name, one in choose_for(lens, frames, seed).items():
                trials[name].append(one)
        found[lens.camera] = {
            "shows": lens.shows,
            "terms": list(lens.terms),
            "sensors": {name: summarise(of) for name, of in trials.items()},
        }
        false += sum(one.false for of in trials.values() for one in of)
        many += sum(map(len, trials.values()))
    own = sum(of["sensors"][camera]["false"] for camera, of in found.items())
    limits = {
        "false choices": held(_most(many), false),
        "false choices by sensors of the lens's own camera": held(_most(sets * len(lenses)), own),
    }
    return {"sets": sets, "frames": frames, "stars": STARS, "noise_px": NOISE_PX, "lenses": found, "limits": limits}


def _most(many: int) -> int:
    """Most false choices of so many that the level explains."""
    return int(binom.ppf(1 - CHANCE, many, LEVEL))


@dataclass(frozen=True)
class Trial:
    """One choice: camera and terms, whether it is false and whether it missed something, squares held out, and arcs of these."""

    camera: str
    terms: tuple[str, ...]
    false: bool
    missed: bool
    validation_chi2: float
    own_validation_chi2: float
    arcs: int


def choose_for(lens: Lens, frames: int, seed: int) -> dict[str, Trial]:
    """Simulate one set and choose for it by a sensor of each camera."""
    camera, truth = CAMERA_MODELS[lens.camera], lens.x
    noisy, clean = (_drawn(camera, truth, frames, noise, seed) for noise in (NOISE_PX, 0.0))
    further = whitened_at(_drawn(camera, truth, frames, 0.0, 10**6 + seed), camera, truth)
    found: dict[str, Trial] = {}
    for name in CAMERA_MODELS:
        sensor = describe_sensor(name)
        fits, chosen = search(noisy, sensor)
        without_noise = Fits(whitened_at(clean, camera, truth), sensor)
        found[name] = Trial(
            chosen.camera.name,
            chosen.subset.term_names,
            is_false(chosen.subset, without_noise, CAMERA_MODELS[name]),
            without_noise.fit(chosen.subset, chosen.x).chi2 > MISSED,
            _misfit(further, chosen),
            _misfit(further, fits.fit(lens.subset)),
            further.n_arcs,
        )
    return found


def _drawn(camera: CameraModel, truth: FloatArray, frames: int, noise_px: float, seed: int) -> ArcSet:
    """Draw a set by its seed, weighed as if it had the noise; without noise the stars are the same."""
    rng = np.random.default_rng([2024, seed])
    counts = np.maximum(4, rng.poisson(STARS, frames))
    drawn = uniform_field(camera, truth, (SIZE, SIZE), PITCH_M, counts, noise_px, rng)
    return replace(drawn, sigma_px=np.full(len(drawn.row_px), NOISE_PX))


def is_false(chosen: Subset, without_noise: Fits, own: CameraModel) -> bool:
    """Whether a choice holds a term, or another camera than the sensor's own, that noise-free stars do not ask for."""
    if chosen.camera is not own and without_noise.fit(largest(own)).chi2 < NOTHING:
        return True
    smaller = [without_noise.fit(chosen.without_term(term)) for term in chosen.removable()]
    whole = without_noise.fit(chosen)
    return any(one.chi2 - whole.chi2 < NOTHING for one in smaller)


def _misfit(further: ArcSet, fitted: FittedSubset) -> float:
    """Chi-square of noise-free stars under a fitted camera."""
    free, scale = fitted.subset.free, np.array(fitted.camera.default_typical_sigma)
    return batch.normal_equations(seen_by(further, fitted.camera), fitted.x, free, scale[fitted.subset.free]).chi2


def summarise(trials: list[Trial]) -> dict[str, Any]:
    """What is told of one lens and one sensor, see above."""
    named, often = Counter((one.camera, one.terms) for one in trials).most_common(1)[0]
    arcs = sum(one.arcs for one in trials)
    return {
        "chosen": dict(Counter(one.camera for one in trials).most_common()),
        "named": {"camera": named[0], "terms": list(named[1]), "sets": often},
        "false": sum(one.false for one in trials),
        "missed": sum(one.missed for one in trials),
        "held_out_over_noise": float(np.sqrt(sum(one.validation_chi2 for one in trials) / arcs)),
        "own_terms_over_noise": float(np.sqrt(sum(one.own_validation_chi2 for one in trials) / arcs)),
    }
