"""Trials: a sample of a telemetry set matched under a hypothesis of what is wrong with it.

A trial reads the telemetry and the sensor file as its hypothesis says, recognises every exposure from nothing but its centroids
(`sky.identification.recognise`), and matches all with the catalogue from there, or from what the file gives. An exposure is solved
where matching calls it valid. How likely that is by chance: the gate of a match holds at most `CHANCE_STAR` chance stars, two stars
fix an attitude, so of n detections m match by chance with the probability that m - 2 or more of n - 2 do,

    p = P(binomial(n - 2, CHANCE_STAR) >= m - 2),

and exposures are independent of one another.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from boresight.arrays import BoolArray, TimeArray
from boresight.calibration.corrections import put_right
from boresight.calibration.diagnosis.camera_fit import Agreement, fit_camera
from boresight.calibration.matching.rematch import (
    Matches,
    MatchingSky,
    Rematcher,
    blend_rad,
    ground_covariance,
    magnitude_limit,
    matching_sky,
)
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import Role
from boresight.errors import RefusedInputError
from boresight.sky.catalogue import Catalogue
from boresight.sky.identification import (
    FEWEST_STARS,
    FIELD_ERROR,
    FIELDS_DEG,
    Recognised,
    field_of_view_deg,
    is_prepared,
    prepare_recognition,
    recognise,
)
from boresight.telemetry.mapping import TelemetryMapping
from boresight.telemetry.quality.detector import on_detector
from boresight.telemetry.schema import Exposures, Telemetry, find_exposures
from boresight.telemetry.sensors import Sensor

#: Chance stars that a gate of matching holds at most (`kernels.matching`).
CHANCE_STAR = 0.03
#: Times for sets that have none: only so that the catalogue has directions. Aberration is then wrong by 20 arcsec, most of it a
#: rotation of the whole image.
NOMINAL_TIME = np.datetime64("2020-01-01", "us")


@dataclass(frozen=True)
class Hypothesis:
    """What is taken to be wrong.

    `names`: of the causes that it stands for. `parity`: whether the sensor file's is the other. `focal_ratio`: true focal length
    over the file's. `mapping`: how the telemetry is read. `limit`: magnitude limit; None is the file's, NaN follows from how many
    stars an exposure has. `directions`: what the file's are declared to be, None as in the sensor file.
    """

    names: tuple[str, ...] = ()
    parity: bool = False
    focal_ratio: float = 1.0
    mapping: TelemetryMapping = field(default_factory=TelemetryMapping)
    limit: float | None = None
    directions: str | None = None

    def mend(self, sensor: Sensor) -> Sensor:
        """Return the sensor as it is if the hypothesis holds."""
        x = sensor.initial.copy()
        x[CAMERA_MODELS[sensor.camera_model].place(Role.FOCAL)] *= self.focal_ratio
        limit = sensor.magnitude_limit if self.limit is None else None if np.isnan(self.limit) else self.limit
        declared = sensor.declared if self.directions is None else replace(sensor.declared, directions=self.directions)
        parity = -sensor.parity if self.parity else sensor.parity
        return replace(sensor, initial=x, parity=parity, magnitude_limit=limit, declared=declared)


@dataclass(frozen=True)
class Trial:
    """The sample under a hypothesis: sensor and telemetry as it has them, their matches, and the fit to these."""

    hypothesis: Hypothesis
    sensor: Sensor
    telemetry: Telemetry
    matches: Matches
    agreement: Agreement | None

    @property
    def solved(self) -> int:
        """Exposures that match."""
        return int(self.matches.valid.sum())

    @property
    def stars(self) -> int:
        """Stars matched in them."""
        return int(self.matches.matched[self.matches.valid].sum())

    @property
    def log10_chance(self) -> float:
        """Of all its matches being coincidence."""
        from scipy.stats import binom  # noqa: PLC0415 - heavy, and only here

        n, m = np.diff(self.matches.exposure_start), self.matches.matched
        valid = self.matches.valid
        return float(np.sum(binom.logsf(m[valid] - 3, np.maximum(n[valid] - 2, 1), CHANCE_STAR)) / np.log(10))


class Bench:
    """A sample of a set and all that trials of it need.

    `sample`: whole exposures. `settings`: those of matching. `ends`: when the search is to be over, of `time.perf_counter`.
    """

    def __init__(
        self,
        sample: Telemetry,
        sensor: Sensor,
        catalogue: Catalogue,
        settings: CalibrationSettings,
        cache_folder: Path | None,
    ) -> None:
        self.sensor, self.catalogue, self.settings, self._folder = sensor, catalogue, settings, cache_folder
        self.timeless = sample.time_utc is None or bool(np.isnat(sample.time_utc).all())
        nominal = np.full(len(sample), NOMINAL_TIME)
        self.sample = replace(sample, time_utc=nominal) if self.timeless else sample
        self.exposures: Exposures = find_exposures(sample)
        self.ends = np.inf
        self.cut_short = False
        self.looks_up_deg: float | None = None  # field of view of the table of patterns; None is the sensor's
        self._skies: dict[float, MatchingSky] = {}

    @property
    def times(self) -> TimeArray:
        """(n_rows,) times of the sample, a nominal one where it has none."""
        time_utc = self.sample.time_utc
        return np.full(len(self.sample), NOMINAL_TIME) if time_utc is None else time_utc

    @property
    def late(self) -> bool:
        """Whether the time is over; remembers that it was."""
        self.cut_short = self.cut_short or time.perf_counter() > self.ends
        return self.cut_short

    def read(self, hypothesis: Hypothesis) -> tuple[Telemetry, Sensor]:
        """Telemetry and sensor as a hypothesis has them."""
        sensor = hypothesis.mend(self.sensor)
        telemetry = hypothesis.mapping.apply(self.sample, sensor)
        try:
            return put_right(telemetry, sensor, self.catalogue), sensor
        except RefusedInputError:  # what is declared cannot be put right: the trial does without
            return telemetry, sensor

    def recognise(self, hypothesis: Hypothesis, most: int | None = None) -> list[Recognised | None]:
        """Recognise each exposure of the sample, or the first so many, its parity and focal length untrusted."""
        telemetry, sensor = self.read(hypothesis)
        return self._recognised(telemetry, sensor, most)

    def prepare(self) -> None:
        """Load the table of patterns for this sensor, where its field of view has one and stars enough to look up."""
        if not len(self.exposures) or self.exposures.count.max() < FEWEST_STARS:
            return
        if (field_deg := self._field_deg(self.sensor)) is not None:
            prepare_recognition(field_deg, self._folder)

    @property
    def is_prepared(self) -> bool:
        """Whether nothing is to be made before exposures are recognised under this sensor."""
        return self.field_deg is not None and is_prepared(self.field_deg, self._folder)

    @property
    def field_deg(self) -> float | None:
        """Field of view of the sensor, as below."""
        return self._field_deg(self.sensor)

    def _field_deg(self, sensor: Sensor) -> float | None:
        """Field of view of a sensor, degrees; None where a corner has no direction or the field is none of a star tracker."""
        camera, pitch = CAMERA_MODELS[sensor.camera_model], sensor.pixel_pitch_m
        if camera.blind_corner(sensor.initial, sensor.rows, sensor.columns, pitch) is not None:
            return None
        field_deg = field_of_view_deg(camera, sensor.initial, sensor.rows, sensor.columns, pitch)
        return field_deg if FIELDS_DEG[0] <= field_deg <= FIELDS_DEG[1] else None

    def _recognised(self, telemetry: Telemetry, sensor: Sensor, most: int | None = None) -> list[Recognised | None]:
        found: list[Recognised | None] = [None] * len(self.exposures)
        if (field_deg := self._field_deg(sensor)) is None:
            return found
        field_deg = self.looks_up_deg or field_deg
        camera, pitch = CAMERA_MODELS[sensor.camera_model], sensor.pixel_pitch_m
        s_d = camera.directions(sensor.initial, telemetry.row_px, telemetry.col_px, pitch)
        for k, (first, count) in enumerate(zip(self.exposures.start, self.exposures.count, strict=True)):
            if self.late or k == most:
                break
            rows = np.arange(first, first + count)
            rows = rows[np.isfinite(s_d[rows, 0])]
            bright = None if telemetry.magnitude is None else telemetry.magnitude[rows]
            if np.isfinite(s_d[rows]).all() and len(rows):
                found[k] = recognise(s_d[rows], bright, sensor.parity, field_deg, self._folder)
        return found

    def try_(self, hypothesis: Hypothesis) -> Trial:
        """Match the sample under a hypothesis."""
        telemetry, sensor = self.read(hypothesis)
        matches = self.match(telemetry, sensor, self._recognised(telemetry, sensor))
        scale = self.settings.initial_sigma_scale
        return Trial(hypothesis, sensor, telemetry, matches, fit_camera(telemetry, sensor, matches, scale))

    def match_as_given(self) -> BoolArray:
        """Which exposures match (n_exposures,) as the files stand, from what they give."""
        telemetry, sensor = self.read(Hypothesis())
        return self.match(telemetry, sensor, []).valid

    def match(self, telemetry: Telemetry, sensor: Sensor, recognised: Sequence[Recognised | None]) -> Matches:
        """Match from what the file gives, and from what was recognised if sensor file and sky agree on it."""
        identified = np.full((len(self.exposures), 4), np.nan)
        for k, one in enumerate(recognised):
            if one is not None and not one.mirrored and abs(one.focal_ratio - 1) <= FIELD_ERROR:
                identified[k] = one.quaternion
        if (
            telemetry.quaternion is not None
        ):  # what the file says of an attitude that is known better would be tried first
            known = np.isfinite(identified[self.exposures.of_entry, :1])
            telemetry = replace(telemetry, quaternion=np.where(known, np.nan, telemetry.quaternion))
        given = np.zeros(0, np.int64) if telemetry.star_id is None else telemetry.star_id
        limit = magnitude_limit(telemetry, sensor, self.catalogue, given)
        if limit not in self._skies:
            self._skies[limit] = matching_sky(self.catalogue, limit, blend_rad(sensor))
        matcher = Rematcher(
            telemetry, sensor, self.catalogue, self.settings, sky=self._skies[limit], identified=identified
        )
        return matcher(sensor.initial, ground_covariance(sensor, self.settings.initial_sigma_scale))

    def on_detector(self, hypothesis: Hypothesis) -> BoolArray:
        """Which detections (n_rows,) lie on the detector under a hypothesis."""
        telemetry, sensor = self.read(hypothesis)
        return on_detector(telemetry, sensor)
