"""What is put right in telemetry before anything is estimated from it, and repeated at the result: directions, readout, noise.

In this order: directions that are declared to be of J2000.0 become apparent ones; from a site on the ground those without
refraction are refracted, here where the file gives them, and when they are made where the catalogue does; the bias that an
earlier pass found against pixel phase and colour is subtracted from the centroids as measured, and its noise replaces the stated;
centroids of a rolling shutter that nobody corrected are moved back to the time of the first line. Readout and noise depend a
little on the camera's state, and on the stars that a first pass matched, so a calibration is made again with what it found until
that changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.calibration import Noise
from boresight.calibration.evaluation.pixel_residuals import FreeCovariance
from boresight.calibration.noise import MOST_FRAMES, apply_noise, estimate_noise, find_quantities, marked_as_applied
from boresight.calibration.readout import FROM_STARS, ReadoutCorrection, correct_readout, find_rates
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation.arcs import ArcSet
from boresight.sky.apparent import apparent_from_j2000
from boresight.sky.catalogue import Catalogue
from boresight.sky.ground import refracted_at, velocity_at
from boresight.telemetry.schema import Telemetry, find_exposures
from boresight.telemetry.sensors import Sensor

#: Share of the centroid noise below which a change of the readout's displacement does not matter.
NO_MATTER = 0.02
MOST_PASSES = 4


class Corrections:
    """What is put right in the telemetry of a sensor, under a state x (n_parameters,) of its camera.

    `star_id`: (n_rows,) stars of the set as an earlier pass matched them; None before. `noise`: what is applied of the noise.
    `done`: what was done about the readout so far. `left_out`: Hipparcos numbers of stars that take no part, which `catalogue`
    does not contain either.
    """

    def __init__(
        self,
        sensor: Sensor,
        catalogue: Catalogue,
        x: FloatArray | None = None,
        star_id: IntArray | None = None,
        noise: Noise | None = None,
        passes: int = 0,
        *,
        left_out: tuple[int, ...] = (),
    ) -> None:
        self.sensor, self.catalogue, self.left_out = sensor, catalogue, left_out
        self.x = sensor.initial if x is None else x
        self.star_id, self.noise, self.passes = star_id, noise, passes
        self.done = ReadoutCorrection()
        self.measured: Telemetry | None = None

    @property
    def needed(self) -> bool:
        """Whether there is anything to put right."""
        return (
            self.noise is not None
            or bool(self.left_out)
            or self._in_centroids
            or self.sensor.declared.directions == "j2000"
            or self.sensor.site is not None
        )

    @property
    def _in_centroids(self) -> bool:
        return self.sensor.readout is not None and self.sensor.readout.is_in_centroids

    @property
    def _wants_rates(self) -> bool:
        return self.noise is not None and any(term.name == "rate" and term.applied for term in self.noise.terms)

    def apply(self, telemetry: Telemetry, *, whole: bool = False) -> Telemetry:
        """Return telemetry put right; `whole` for the set itself, whose stars and measured centroids are known."""
        self.measured = telemetry if whole else None
        if not self.needed:
            return telemetry
        right = with_directions(without_stars(telemetry, self.left_out), self.sensor, self.catalogue)
        named = replace(right, star_id=self.star_id) if whole and self.star_id is not None else right
        rates = None
        if self._in_centroids or self._wants_rates:
            rates = find_rates(named, self.sensor, self.catalogue, self.x)
        if self.noise is not None:
            rows = np.arange(len(telemetry))
            w = None if rates is None else rates.w[find_exposures(named).of_entry]
            quantities = find_quantities(named, rows, self.sensor, self.x, self.catalogue, w, telemetry)
            right = apply_noise(right, self.sensor, self.noise.terms, quantities)
        if self._in_centroids:
            right, done = correct_readout(right, self.sensor, rates, self.x)
            self.done = self.done.with_part(done)
        return right

    def estimate_noise(
        self, telemetry: Telemetry, arcs: ArcSet, x: FloatArray, freedom: FreeCovariance, *, to_apply: bool
    ) -> Noise:
        """Estimate how noise and bias depend on what is known of the stars: none of it applied.

        `telemetry`: the rows that `arcs` come from, with the stars that they were matched with. `to_apply`: look at more of them.
        """
        measured = telemetry if not self._in_centroids else self.measured
        if measured is not None and len(measured) != len(telemetry):
            measured = None
        most = (4 if to_apply else 1) * MOST_FRAMES
        return estimate_noise(arcs, self.sensor, x, freedom, self.catalogue, telemetry, measured, most)

    def refined(
        self, x: FloatArray, star_id: IntArray | None, estimate: Callable[[], Noise] | None
    ) -> Corrections | None:
        """Return what is to be put right in another pass, None where that would change nothing.

        `x`: (n_parameters,) result of this pass. `star_id`: stars that it matched, of a set in memory. `estimate`: estimates the
        noise, of which what is needed is applied; None where nobody asks for it.
        """
        if self.passes + 1 >= MOST_PASSES or not np.isfinite(x).all():
            return None
        if self._readout_moves(x, star_id):
            return self._make_next(x, star_id, self.noise)
        if estimate is None or self.noise is not None:
            return None
        noise = estimate()
        if not any(term.needed for term in noise.terms):
            return None
        return self._make_next(x, star_id, marked_as_applied(noise))

    def _make_next(self, x: FloatArray, star_id: IntArray | None, noise: Noise | None) -> Corrections:
        return Corrections(self.sensor, self.catalogue, x, star_id, noise, self.passes + 1, left_out=self.left_out)

    def _readout_moves(self, x: FloatArray, star_id: IntArray | None) -> bool:
        """Whether the centroids of a rolling shutter would lie elsewhere under x and the stars matched."""
        if not self._in_centroids:
            return False
        if not self.done.source or (self.done.source == FROM_STARS and self.star_id is None):
            return star_id is not None and self.star_id is None
        camera, pitch = CAMERA_MODELS[self.sensor.camera_model], self.sensor.pixel_pitch_m
        change = abs(camera.focal_px(x, pitch) / camera.focal_px(self.x, pitch) - 1)
        return bool(change * self.done.largest_px > NO_MATTER * self.sensor.centroid_sigma_px)


def without_stars(telemetry: Telemetry, hip: Sequence[int]) -> Telemetry:
    """Return telemetry whose rows of some stars have no star and no direction: detections like any other."""
    if not len(hip) or telemetry.star_id is None:
        return telemetry
    out = np.isin(telemetry.star_id, hip)
    star_id = np.where(out, 0, telemetry.star_id)
    right, down = telemetry.ra_rad, telemetry.dec_rad
    return replace(
        telemetry,
        star_id=star_id,
        ra_rad=None if right is None else np.where(out, np.nan, right),
        dec_rad=None if down is None else np.where(out, np.nan, down),
    )


def put_right(telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue, x: FloatArray | None = None) -> Telemetry:
    """Return telemetry as its sensor's declarations want it: apparent directions, centroids of the first line; x as above."""
    return Corrections(sensor, catalogue, x).apply(telemetry)


def with_directions(telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue) -> Telemetry:
    """Return telemetry with directions as its sensor's declarations want them, and the site through whose air stars are seen."""
    right = telemetry if sensor.site is None else replace(telemetry, site=sensor.site)
    if sensor.declared.directions == "j2000":
        right = to_apparent(right, catalogue)
    return to_observed(right) if lacks_refraction(sensor) else right


def lacks_refraction(sensor: Sensor) -> bool:
    """Whether directions that the telemetry of a sensor on the ground gives are to be refracted: they are said to hold none.

    Of J2000.0 they cannot hold any; apparent ones are taken to be as observed unless `refraction` is declared uncorrected.
    """
    declared = sensor.declared
    return sensor.site is not None and (
        declared.refraction == "uncorrected" or (declared.directions == "j2000" and declared.refraction is None)
    )


def to_observed(telemetry: Telemetry) -> Telemetry:
    """Bend directions that the telemetry gives by the air above its site.

    Raises RefusedInputError when there are directions and no times.
    """
    if telemetry.ra_rad is None or telemetry.dec_rad is None or telemetry.site is None:
        return telemetry
    if telemetry.time_utc is None:
        raise RefusedInputError(
            "The sensor has a site on the ground, but the telemetry has no time, which is needed to find the zenith: "
            "add time_utc (ISO 8601, UTC), or declare refraction corrected if its directions include it."
        )
    cos_dec = np.cos(telemetry.dec_rad)
    s = np.column_stack(
        [cos_dec * np.cos(telemetry.ra_rad), cos_dec * np.sin(telemetry.ra_rad), np.sin(telemetry.dec_rad)]
    )
    s = refracted_at(s, telemetry.site, telemetry.time_utc)
    return replace(telemetry, ra_rad=np.arctan2(s[:, 1], s[:, 0]), dec_rad=np.arcsin(np.clip(s[:, 2], -1.0, 1.0)))


def to_apparent(telemetry: Telemetry, catalogue: Catalogue) -> Telemetry:
    """Turn directions of J2000.0 into apparent ones at the time of each row.

    Raises RefusedInputError when there are directions and no times.
    """
    if telemetry.ra_rad is None or telemetry.dec_rad is None:
        return telemetry
    if telemetry.time_utc is None:
        raise RefusedInputError(
            "The sensor declares directions of J2000.0, but the telemetry has no time to compute apparent ones: "
            "add time_utc (ISO 8601, UTC), or give apparent directions and declare them so."
        )
    known = np.zeros(len(telemetry), np.int64) if telemetry.star_id is None else telemetry.star_id
    velocity = telemetry.velocity_m_s
    if velocity is None and telemetry.site is not None:
        velocity = velocity_at(telemetry.site, telemetry.time_utc)
    s = apparent_from_j2000(
        telemetry.ra_rad, telemetry.dec_rad, catalogue, catalogue.find_index(known), telemetry.time_utc,
        velocity,
    )  # fmt: skip
    return replace(telemetry, ra_rad=np.arctan2(s[:, 1], s[:, 0]), dec_rad=np.arcsin(np.clip(s[:, 2], -1.0, 1.0)))
