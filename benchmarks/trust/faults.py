"""What can be wrong in telemetry: the cases whose numbers are known, and thirty faults of three strengths each.

A fault is a function `(scene, strength, rng) -> scene` that changes a clean scene; the calibration is told nothing of it. `visible`
is False where no residual can show it, so that only a declaration can. Strengths are in `unit`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.trust.scenes import (
    DAY_S,
    ORBIT_S,
    PINHOLE,
    SPARSE,
    ST16,
    Array,
    Optics,
    Scene,
    earth_km_s,
    temperature,
)

#: More than an exposure has.
DETECTIONS = 40
Change = Callable[[Scene, float, np.random.Generator], Scene]


@dataclass(frozen=True)
class Fault:
    """What is wrong: in words, how, how strong, and with which optics; `frames` where the set is not of the usual size."""

    name: str
    says: str
    change: Change
    strengths: tuple[float, ...]
    unit: str = ""
    optics: Optics = ST16
    visible: bool = True
    frames: int | None = None
    exposures: int = 2

    @property
    def of_geometry(self) -> bool:
        """Whether the data are as the model says and only tell little."""
        return self.change is nothing


def renamed(scene: Scene, rows: Any, stars: Any) -> Scene:
    """Tell other stars, by their numbers and directions, in some rows."""
    found = scene.telemetry()
    s = scene.sky.seen(stars, earth_km_s())
    hip, ra, dec = (np.array(found[name]) for name in ("star_id", "ra_deg", "dec_deg"))
    hip[rows] = scene.sky.hip[stars]
    ra[rows], dec[rows] = np.degrees(np.arctan2(s[:, 1], s[:, 0])) % 360, np.degrees(np.arcsin(s[:, 2]))
    return scene.telling(star_id=hip, ra_deg=ra, dec_deg=dec)


def directed(scene: Scene, s: Array) -> Scene:
    """Tell other directions."""
    s = s / np.linalg.norm(s, axis=1, keepdims=True)
    return scene.telling(ra_deg=np.degrees(np.arctan2(s[:, 1], s[:, 0])) % 360, dec_deg=np.degrees(np.arcsin(s[:, 2])))


def _few(scene: Scene, share_or_count: float, rng: np.random.Generator) -> Any:
    """Choose rows: a share below 1, a count from 1 on."""
    count = int(share_or_count) if share_or_count >= 1 else round(share_or_count * scene.n)
    return rng.choice(scene.n, max(1, count), replace=False)


def wrong_identities(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """Name a star within 12 degrees of the true one."""
    return _misnamed(scene, share, rng, lambda near: rng.permutation(np.flatnonzero(near > np.cos(np.radians(12)))))


def neighbours_named(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """Name the star next to the true one."""
    return _misnamed(scene, share, rng, lambda near: np.argsort(-near)[:DETECTIONS])


def _misnamed(scene: Scene, share: float, rng: np.random.Generator, order: Callable[[Array], Any]) -> Scene:
    """Name others, the first in an order by the cosine of their distance that no row of the exposure names."""
    rows, named = _few(scene, share, rng), scene.star.copy()
    for row in rows:
        taken = {
            *named[scene.exposure_of == scene.exposure_of[row]],
            *scene.star[scene.exposure_of == scene.exposure_of[row]],
        }
        named[row] = next(star for star in order(scene.sky.s @ scene.s_i[row]) if star not in taken)
    return renamed(scene, rows, named[rows])


def swapped_rows(scene: Scene, exposures: float, rng: np.random.Generator) -> Scene:
    """Swap the identities of two stars of an exposure."""
    chosen = rng.choice(int(scene.exposure_of.max()) + 1, int(exposures), replace=False)
    pairs = np.array([rng.choice(np.flatnonzero(scene.exposure_of == k), 2, replace=False) for k in chosen])
    return renamed(scene, pairs.ravel(), scene.star[pairs[:, ::-1].ravel()])


def hot_pixel(scene: Scene, rows: float, rng: np.random.Generator) -> Scene:
    """Take a stuck pixel for the stars that come nearest to it."""
    pixel = np.array(scene.optics.size) * rng.uniform(0.25, 0.75, 2)
    nearest = np.argsort(np.sum((scene.place_px - pixel) ** 2, axis=1))[: int(rows)]
    measured = scene.measured_px().copy()
    measured[nearest] = np.round(pixel)
    return scene.telling(measured_px=measured)


def false_stars(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """Put detections without a star anywhere, which have a name though; matched again."""
    rows = _few(scene, share, rng)
    measured = scene.measured_px().copy()
    measured[rows] = np.array(scene.optics.size) * rng.uniform(0.02, 0.98, (len(rows), 2))
    return scene.telling(measured_px=measured).by_catalogue().setting(match="rematch")


def cosmic_rays(scene: Scene, px: float, rng: np.random.Generator) -> Scene:
    """Two of a hundred centroids are far off."""
    rows = _few(scene, 0.02, rng)
    shift = np.zeros((scene.n, 2))
    shift[rows] = px * rng.normal(size=(len(rows), 2))
    return scene.shifted(shift)


def proper_motion_epoch(scene: Scene, years: float, _rng: np.random.Generator) -> Scene:
    """Tell directions of a catalogue whose proper motions were applied to another epoch."""
    return directed(scene, scene.s_i + years * scene.sky.motion[scene.star])


def photocentres(scene: Scene, px: float, rng: np.random.Generator) -> Scene:
    """One star in fifty is a double: the light's centre lies beside the catalogue's place, always on the same side."""
    off = rng.normal(size=scene.sky.s.shape) * (rng.random(len(scene.sky.hip)) < 0.02)[:, None]
    return directed(scene, scene.s_i + px * scene.optics.pitch_m / scene.optics.truth["f_m"] * off[scene.star])


def one_star_displaced(scene: Scene, px: float, rng: np.random.Generator) -> Scene:
    """The star that is seen most has a wrong place in the catalogue."""
    often = np.argmax(np.bincount(scene.star))
    off = rng.normal(size=3) * px * scene.optics.pitch_m / scene.optics.truth["f_m"]
    return directed(scene, scene.s_i + np.outer(scene.star == often, off))


def shear(scene: Scene, angle: float, _rng: np.random.Generator) -> Scene:
    """Rows and columns of the detector are not at right angles."""
    across = scene.place_px[:, 1] - scene.optics.size[1] / 2
    return scene.shifted(np.column_stack([angle * across, np.zeros(scene.n)]))


def tilted(scene: Scene, tilt: float, _rng: np.random.Generator) -> Scene:
    """The detector is tilted, and the camera model has no tilt."""
    f_px = scene.optics.truth["f_m"] / scene.optics.pitch_m
    from_axis = scene.place_px - np.array(scene.optics.size) / 2
    return scene.shifted(tilt * from_axis * (0.8 * from_axis[:, :1] + 0.6 * from_axis[:, 1:]) / f_px)


def faint_stars_noisier(scene: Scene, factor: float, _rng: np.random.Generator) -> Scene:
    """The sigma that is told holds for bright stars; the fainter half is noisier."""
    faint = scene.magnitude > np.median(scene.magnitude)
    noise = scene.noise_px * np.where(faint, factor, 1.0)[:, None]
    return replace(scene, noise_px=noise).telling(sigma_px=np.full(scene.n, scene.optics.noise_px))


def sigma_stated(scene: Scene, ratio: float, _rng: np.random.Generator) -> Scene:
    """The noise is so many times what the file says."""
    return replace(scene, noise_px=ratio * scene.noise_px)


def clock(scene: Scene, days: float, _rng: np.random.Generator) -> Scene:
    """The clock is wrong, and directions come from the catalogue at its time."""
    return (
        replace(scene, seconds=scene.seconds + days * DAY_S)
        .by_catalogue()
        .telling(**{name: scene.telemetry()[name] for name in ("vx_km_s", "vy_km_s", "vz_km_s")})
    )


def velocity(scene: Scene, factor: float, _rng: np.random.Generator) -> Scene:
    """The satellite's velocity is told so many times, -1 with the wrong sign."""
    told = dict(zip(("vx_km_s", "vy_km_s", "vz_km_s"), factor * scene.velocity_km_s.T, strict=True))
    return scene.by_catalogue().telling(**told)


def unaberrated(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """Tell catalogue directions without aberration, as if they were apparent, in a share of the exposures."""
    exposures = int(scene.exposure_of.max()) + 1
    of = rng.permuted(np.arange(exposures) < share * exposures)
    moved = (earth_km_s() + scene.velocity_km_s) / 299_792.458
    return directed(scene, scene.s_i - of[scene.exposure_of][:, None] * moved)


def lens_of(scene: Scene, change_of_f: Any) -> Scene:
    """Let the focal length change by a ratio, by star."""
    x: list[Any] = list(scene.optics.x)
    place = list(scene.optics.truth).index("f_m")
    x[place] = x[place] * (1 + change_of_f)
    return scene.seen_by(x)


def focal_sine(scene: Scene, ppm: float, _rng: np.random.Generator) -> Scene:
    """The focal length follows the temperature."""
    return lens_of(scene, 1e-6 * ppm * (scene.temperature_c - 20) / 5)


def temperature_lag(scene: Scene, ppm: float, _rng: np.random.Generator) -> Scene:
    """The focal length follows the temperature a sixth of an orbit later."""
    return lens_of(scene, 1e-6 * ppm * (temperature(scene.seconds - ORBIT_S / 6) - 20) / 5)


def focal_step(scene: Scene, ppm: float, _rng: np.random.Generator) -> Scene:
    """The focal length steps in the middle of the set."""
    return lens_of(scene, 1e-6 * ppm * (scene.frame > scene.frame.max() / 2))


def focal_drift(scene: Scene, ppm: float, _rng: np.random.Generator) -> Scene:
    """The focal length drifts over the set, towards what it is at the end."""
    return lens_of(scene, 1e-6 * ppm * (scene.frame / scene.frame.max() - 1))


def second_exposure(scene: Scene, ppm: float, _rng: np.random.Generator) -> Scene:
    """The second exposure of each frame has another scale."""
    return lens_of(scene, 1e-6 * ppm * scene.exposure)


def smeared_frame(scene: Scene, px: float, rng: np.random.Generator) -> Scene:
    """Both exposures of one frame are smeared along one direction."""
    one = scene.frame == rng.choice(np.unique(scene.frame))
    return scene.shifted(np.outer(one * px * rng.normal(size=scene.n), [0.6, 0.8]))


def moved_origin(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """Half of the frames count rows and columns from another origin."""
    return scene.shifted(np.outer(scene.frame > scene.frame.max() / 2, [px, px]))


def correlated_noise(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """A share of the noise is common to stars within 300 px of one another in an exposure."""
    noise = np.sqrt(1 - share) * scene.noise_px
    for rows in np.split(np.arange(scene.n), np.flatnonzero(np.diff(scene.exposure_of)) + 1):
        apart = scene.place_px[rows, None] - scene.place_px[None, rows]
        C = np.exp(-np.sum(apart**2, axis=2) / (2 * 300**2)) + 1e-9 * np.eye(len(rows))
        noise[rows] += np.sqrt(share) * scene.optics.noise_px * np.linalg.cholesky(C) @ rng.normal(size=(len(rows), 2))
    return replace(scene, noise_px=noise)


def saturated(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """Bright stars bleed along their column."""
    return scene.shifted(np.outer(px * np.maximum(4.0 - scene.magnitude, 0.0), [1, 0]))


def quantised(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """Centroids are rounded."""
    return scene.telling(measured_px=px * np.round(scene.measured_px() / px))


def transfer_trails(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """Charge stays behind along columns, more of faint stars and farther from the register."""
    share = scene.place_px[:, 0] / scene.optics.size[0] * (scene.magnitude - 3.0) / 2.5
    return scene.shifted(np.outer(px * share, [1, 0]))


def truncated_windows(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """Centroids within 150 px of an edge are pulled inwards."""
    size = np.array(scene.optics.size)
    low, high = (np.maximum(1 - far / 150, 0) for far in (scene.place_px, size - 1 - scene.place_px))
    return scene.shifted(px * (low - high))


def duplicated_frames(scene: Scene, copies: float, _rng: np.random.Generator) -> Scene:
    """Every frame is in the set several times, under numbers of its own."""
    times = int(copies) + 1
    order = np.argsort(np.tile(times * scene.frame, times) + np.repeat(np.arange(times), scene.n), kind="stable")
    rows, which = np.tile(np.arange(scene.n), times)[order], np.repeat(np.arange(times), scene.n)[order]
    made = scene.taken(rows)
    return replace(made, frame=made.frame * times + which, seconds=made.seconds + which)


def chromatic(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """Red stars fall farther out: pixels at the corner for a magnitude of B-V from the mean."""
    redder = scene.sky.colour[scene.star] - np.mean(scene.sky.colour[scene.star])
    return scene.shifted(px * redder[:, None] * scene.from_centre)


def high_order(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """Distortion of the seventh order, by Legendre's third polynomial little like the lower ones; pixels at the corner."""
    u = scene.from_centre
    x = 2 * np.sum(u**2, axis=1, keepdims=True) - 1
    return scene.shifted(px * u * (5 * x**3 - 3 * x) / 2)


def tangential(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """Tangential distortion, pixels at the corner."""
    X, Y = scene.from_centre[:, 1], scene.from_centre[:, 0]
    r2 = X**2 + Y**2
    row, col = 0.6 * (r2 + 2 * Y**2) + 0.8 * 2 * X * Y, 0.8 * (r2 + 2 * X**2) + 0.6 * 2 * X * Y
    return scene.shifted(px / 3 * np.column_stack([row, col]))


def tangential_lens(scene: Scene, p: float, _rng: np.random.Generator) -> Scene:
    """OpenCV's p1 and p2 in a lens that is fitted without."""
    return scene.seen_by([*scene.optics.x, p, -p])


def dent(scene: Scene, px: float, rng: np.random.Generator) -> Scene:
    """A flaw of the window displaces stars about one place."""
    from_it = scene.place_px - np.array(scene.optics.size) * rng.uniform(0.3, 0.7, 2)
    r2 = np.sum(from_it**2, axis=1, keepdims=True) / 300**2
    return scene.shifted(px * np.sqrt(np.e) * from_it / 300 * np.exp(-r2 / 2))


def stitched(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """The right half of the detector was exposed with a step along the rows' direction."""
    return scene.shifted(np.outer(scene.place_px[:, 1] > scene.optics.size[1] / 2, [px, 0.0]))


def rolling_rows(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """Rows are read one after the other while stars move along rows, so many pixels over the whole readout."""
    return scene.shifted(np.outer(px * scene.place_px[:, 0] / scene.optics.size[0], [1, 0]))


def rolling_columns(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """Rows are read one after the other while stars move along columns, so many pixels over the whole readout."""
    return scene.shifted(np.outer(px * scene.place_px[:, 0] / scene.optics.size[0], [0, 1]))


def pixel_phase(scene: Scene, px: float, _rng: np.random.Generator) -> Scene:
    """Centroids are drawn to the middle of their pixel, a sine of the phase."""
    return scene.shifted(-px * np.sin(2 * np.pi * (scene.place_px + scene.noise_px)))


def nothing(scene: Scene, _strength: float, _rng: np.random.Generator) -> Scene:
    """Change nothing."""
    return scene


def _huber(change: Change) -> Change:
    return lambda scene, strength, rng: change(scene, strength, rng).setting(robust="huber")


#: The cases that failed when this was begun, each at the strength of then.
CASES: tuple[Fault, ...] = (
    Fault("one_identity", "one wrong identity, given", wrong_identities, (1,), "stars"),
    Fault("identities", "wrong identities, given", wrong_identities, (0.01, 0.03, 0.1), "share"),
    Fault("identities_huber", "the same, with Huber's loss", _huber(wrong_identities), (0.01, 0.03, 0.1), "share"),
    Fault(
        "tangential_lens", "tangential lens at 0.1 px of noise, fitted with pinhole_radial", tangential_lens, (5e-4,), "p1, p2",
        replace(PINHOLE, noise_px=0.1),
    ),
    Fault("tangential", "tangential distortion", tangential, (1.0,), "px at the corner"),
    Fault("rolling_columns", "rolling shutter along columns", rolling_columns, (0.38,), "px over the readout"),
    Fault("focal_sine", "focal length follows the temperature", focal_sine, (100.0,), "ppm"),
    Fault("one_quarter", "stars in one quarter of the detector", nothing, (0.5,), "of each side", replace(ST16, window=0.5)),
    Fault("pixel_phase", "pixel-phase bias at 0.05 px of noise", pixel_phase, (0.1,), "px", replace(ST16, noise_px=0.05)),
    Fault("sparse", "a sparse set of five exposures", nothing, (0.0,), "", SPARSE, frames=5, exposures=1),
    Fault("rolling_rows", "rolling shutter along rows", rolling_rows, (2.0,), "px over the readout", visible=False),
)  # fmt: skip

#: Thirty faults besides, at three strengths each.
FAULTS: tuple[Fault, ...] = (
    Fault("swapped_rows", "identities of two stars swapped", swapped_rows, (1, 3, 10), "exposures"),
    Fault("neighbours_named", "named by the neighbouring star", neighbours_named, (0.001, 0.01, 0.03), "share"),
    Fault("hot_pixel", "a stuck pixel taken for stars", hot_pixel, (1, 3, 10), "stars"),
    Fault("false_stars", "false stars with names, matched again", false_stars, (0.03, 0.1, 0.3), "share"),
    Fault("cosmic_rays", "2 % of the centroids far off", cosmic_rays, (1, 3, 20), "px"),
    Fault("proper_motion_epoch", "proper motions of another epoch", proper_motion_epoch, (10, 35, 100), "years"),
    Fault("photocentres", "2 % of the stars are unresolved doubles", photocentres, (0.5, 2, 8), "px"),
    Fault("one_star_displaced", "a frequent star with a wrong place", one_star_displaced, (0.5, 2, 8), "px"),
    Fault("shear", "rows and columns not at right angles", shear, (3e-5, 1e-4, 3e-4), "rad"),
    Fault("tilted", "a tilt that the camera model lacks", tilted, (3e-4, 1e-3, 3e-3), "rad", PINHOLE),
    Fault("faint_stars_noisier", "noise of the fainter half above its sigma", faint_stars_noisier, (1.2, 1.6, 3), "times"),
    Fault("sigma_stated", "noise above the stated", sigma_stated, (1.1, 1.4, 2), "times"),
    Fault("clock", "a wrong clock", clock, (100 / DAY_S, 5, 180), "days"),
    Fault("velocity", "a wrong velocity of the satellite", velocity, (-1, -10, -30), "times"),
    Fault("unaberrated", "directions without aberration in some exposures", unaberrated, (0.1, 0.4, 1), "share"),
    Fault("temperature_lag", "focal length follows the temperature late", temperature_lag, (20, 60, 200), "ppm"),
    Fault("focal_step", "focal length steps in the middle", focal_step, (30, 100, 300), "ppm"),
    Fault("focal_drift", "focal length drifts", focal_drift, (30, 100, 300), "ppm"),
    Fault("second_exposure", "second exposures of another scale", second_exposure, (20, 60, 200), "ppm"),
    Fault("smeared_frame", "one frame smeared", smeared_frame, (1, 4, 16), "px"),
    Fault("moved_origin", "half of the frames with another origin", moved_origin, (0.5, 4, 30), "px"),
    Fault("correlated_noise", "noise common to neighbours", correlated_noise, (0.1, 0.4, 0.9), "share"),
    Fault("saturated", "bright stars bleed along columns", saturated, (0.1, 0.3, 1), "px a magnitude"),
    Fault("quantised", "rounded centroids", quantised, (0.25, 1, 2), "px"),
    Fault("transfer_trails", "charge trails along columns", transfer_trails, (0.1, 0.3, 1), "px"),
    Fault("truncated_windows", "windows cut at the edges", truncated_windows, (0.2, 0.6, 2), "px"),
    Fault("duplicated_frames", "frames several times in the set", duplicated_frames, (1, 2, 4), "copies"),
    Fault("chromatic", "scale depends on colour", chromatic, (0.1, 0.4, 1.5), "px a magnitude"),
    Fault("high_order", "distortion of high orders", high_order, (0.1, 0.4, 1.5), "px at the corner"),
    Fault("dent", "a flaw of the window", dent, (0.2, 0.6, 2), "px"),
)  # fmt: skip
BY_NAME = {fault.name: fault for fault in (*CASES, *FAULTS)}
