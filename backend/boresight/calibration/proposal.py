"""A sensor file proposed from stars alone: no focal length, no field of view, no names; guess, solve, propose.

**Guess.** The fields of `FIELDS_DEG`, each across the longer side of a pinhole camera with its principal point in the middle.
`sky.identification.recognise` tells from each guess fields from 1 / 1.5 to 1.75 times as wide, upright or mirrored, so four guesses
leave nothing out between 2.8 and 108 degrees. A field or a focal length that somebody gives is guessed first. Of each guess up to
`PROBED` exposures are looked at; a wrong one costs some tenths of a second for each. The widest of common fields comes first, the
narrowest last, because its table of patterns takes a minute to make and 320 MB.

**Solve.** What the recognised exposures agree on is a parity and a focal length, good to half a percent. With these a whole sensor
is derived (`telemetry.new_sensor`), every exposure recognised and matched with the catalogue under it, and its camera fitted to the
stars matched (`diagnosis.camera_fit`): focal length and lowest radial term, for without the one a lens that bends by a percent has
the wrong other; the principal point is freed and left in the middle, because a turn of the camera looks the same. The stars then
tell two more numbers: with r the residuals of n matched stars, chi2 their weighted squares over the exposures, and p
the parameters that they tell (the trace of H (H + I)^-1),

    sigma = sqrt(chi2 / (dof - p)) times that assumed.

The fit is taken unless it solves fewer exposures, or far fewer stars, than what was recognised; a worse lens matches more of
them by chance.

**Propose.** Nothing is proposed because it is plausible: the sample is matched with the proposal, which must solve more than one
exposure, where there are several, and by no coincidence (`diagnosis.trials`). Stars show angles alone, so focal length and pixel
pitch are known as their ratio: where neither is given, a pixel is taken as `PITCH_UM`. The spread of the focal length stays that
of any lens, for a prior made of the same stars would count them twice.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.diagnosis.camera_fit import fit_camera
from boresight.calibration.diagnosis.diagnose import (
    FEWEST,
    TOO_LIKELY,
    Consensus,
    find_consensus,
    sample_exposures,
)
from boresight.calibration.diagnosis.trials import Bench, Hypothesis, Trial
from boresight.calibration.matching.rematch import centroid_sigma_px
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import TelemetryFile, TelemetryInput, is_large, read_whole
from boresight.cameras import CAMERA_MODELS, usual_camera
from boresight.cameras.model import Role
from boresight.errors import RefusedInputError
from boresight.images.extraction import run_apart
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.sky.identification import (
    FEWEST_STARS,
    NARROWEST,
    WIDEST,
    Recognised,
    field_of_view_deg,
    identify,
    recognise,
)
from boresight.telemetry.data_sheets import ASKED, LensAndDetector
from boresight.telemetry.new_sensor import FOCAL_SHARE, UPRIGHT, Described, complete, describe_sensor
from boresight.telemetry.schema import Telemetry, find_exposures
from boresight.telemetry.sensors import Sensor
from boresight.waiting import ignore_progress

Report = Callable[[str, float | None], None]

#: Fields that are guessed, degrees across the longer side, in the order in which they are tried.
FIELDS_DEG = (25.376, 61.97, 10.394, 4.2571)
#: Exposures that each guess is tried on, spread over the sample, and seconds after which no other is tried.
PROBED, BUDGET_S = 8, 300.0
#: A pixel where neither its pitch nor the focal length is given, micrometres.
PITCH_UM = 5.0
#: A fit that moves the focal length farther than this was led astray.
FARTHEST_FIT = 0.03
#: Of the stars that were matched as recognised a fit has to match so many, for a worse lens matches more of them by chance.
FEWER = 0.7
#: Times that a lens is fitted and matched with; and typical sigmas that the fit frees what it estimates by, and holds the rest to.
ROUNDS, FREED, HELD = 3, 3.0, 1e-6
#: Share of the matched stars that are no fainter than the magnitude limit.
SEEN_SHARE = 0.98
#: Magnitudes beyond the faintest of a few fields: others show fainter ones.
BEYOND_MAG = 0.3
#: Of the detections so many may lie off the detector that was given.
FEW_OFF = 0.02
#: An exposure with so many detections should be recognised.
ENOUGH_STARS = 7
#: Centroid errors that a sensor file may state, pixels.
SIGMAS_PX = (0.005, 5.0)


@dataclass(frozen=True)
class TriedField:
    """A guess: the fields that it covers, degrees, and how many of the exposures looked at were recognised."""

    narrowest_deg: float
    widest_deg: float
    exposures: int
    recognised: int


@dataclass(frozen=True)
class Proposal:
    """A sensor that stars propose.

    `described`: the sensor and why its numbers are what they are. `exposures`, `of_exposures`: looked at, of how many; `solved`: by
    the proposal; `stars`: matched in them. `focal_px`, `focal_sigma_px`: focal length and its uncertainty, pixels.
    `across_deg`, `down_deg`: field of view along the longer and the shorter side. `tried`: in order. `sentences`: what was
    found and assumed.
    """

    described: Described
    exposures: int
    of_exposures: int
    solved: int
    stars: int
    focal_px: float
    focal_sigma_px: float
    across_deg: float
    down_deg: float
    tried: list[TriedField]
    sentences: list[str]


def propose(
    telemetry: TelemetryInput,
    catalogue: Catalogue,
    known: LensAndDetector | None = None,
    *,
    of_images: bool = False,
    cache_folder: Path | None = None,
    report: Report | None = None,
    budget_s: float = BUDGET_S,
    subject: str = "The new sensor",
) -> Proposal:
    """Propose a sensor file for telemetry of which nothing is known but its centroids.

    Parameters
    ----------
    telemetry, catalogue
        The set, and the stars there are. Names, attitudes and directions in it count for nothing.
    known
        What somebody knows of the camera all the same. Rows and columns follow from where detections lie if they are left out;
        parity, focal length and field of view are what the stars say, whatever was given.
    of_images
        Whether the centroids were extracted from images, which is said.
    cache_folder
        Where the tables of star patterns are kept; None makes them again.
    report
        Told what is being tried.
    budget_s
        Seconds after which no further field is guessed.
    subject
        What refusals of the numbers given call the sensor.

    Raises
    ------
    RefusedInputError
        When the numbers given make no sense, or no exposure is recognised: with what was tried and what to do.
    """
    given = complete(known or LensAndDetector(), subject)
    sample, of_exposures = sample_exposures(telemetry)
    rows, columns, measured = _detector(telemetry, given)
    sized = replace(given, rows=rows, columns=columns)
    bare = replace(sample, star_id=None, ra_rad=None, dec_rad=None, quaternion=None)
    search = _Search(
        bare, catalogue, sized, cache_folder, report or ignore_progress, time.perf_counter() + budget_s, subject
    )
    found = search.run()
    if found is None:
        raise RefusedInputError(_say_nothing(search, of_exposures, of_images=of_images))
    return _conclude(search, found, given, of_exposures, of_images=of_images, measured=measured)


def propose_apart(
    telemetry: Telemetry | TelemetryFile,
    catalogue_folder: Path,
    known: LensAndDetector,
    *,
    of_images: bool,
    seconds: float,
    subject: str,
) -> Proposal:
    """Propose as `propose` does, in a process of its own that ends when the time is over: a server goes on answering meanwhile."""
    work = partial(_propose_in, telemetry, catalogue_folder, known, of_images=of_images, subject=subject)
    return run_apart(
        work,
        seconds,
        "Recognising the stars {}: also give the field of view, or use `boresight sensor new` on your own machine.",
    )


def _propose_in(
    telemetry: Telemetry | TelemetryFile,
    catalogue_folder: Path,
    known: LensAndDetector,
    *,
    of_images: bool,
    subject: str,
) -> Proposal:
    catalogue = load_catalogue(catalogue_folder)
    telemetry = telemetry.opened() if isinstance(telemetry, TelemetryFile) else telemetry
    return propose(telemetry, catalogue, known, of_images=of_images, cache_folder=catalogue_folder, subject=subject)


def _detector(telemetry: TelemetryInput, given: LensAndDetector) -> tuple[int, int, tuple[str, ...]]:
    """Rows and columns, and which of these followed from where the detections lie; refuses a detector that they lie off."""
    ends, total = np.full((2, 2), np.nan), 0
    sides: dict[str, int | None] = {"rows": given.rows, "columns": given.columns}
    off = 0
    whole = telemetry.chunks() if is_large(telemetry) else iter([read_whole(telemetry)])
    for part in whole:
        places = np.stack([part.row_px, part.col_px])
        ends = np.stack([np.fmin(ends[0], places.min(axis=1)), np.fmax(ends[1], places.max(axis=1))])
        size = np.array([[side or np.inf] for side in sides.values()])
        off, total = off + int(((places < -1) | (places > size)).any(axis=0).sum()), total + places.shape[1]
    if off > FEW_OFF * total:
        raise RefusedInputError(
            f"{off:,} of {total:,} detections are outside a detector of {given.rows or 'any'} rows and {given.columns or 'any'} "
            f"columns, up to row {ends[1, 0]:.0f} and column {ends[1, 1]:.0f}: correct rows and columns, or omit them."
        )
    found = [
        side or max(round(max(first, 0.0) + last), math.floor(last + 0.5), int(ASKED["rows"].lowest)) + 1
        for side, first, last in zip(sides.values(), ends[0], ends[1], strict=True)
    ]
    return found[0], found[1], tuple(name for name, side in sides.items() if side is None)


@dataclass(frozen=True)
class _Lens:
    """Focal length, pixels, and the lowest radial term."""

    focal_px: float
    radial: float = 0.0


@dataclass(frozen=True)
class _Matched:
    """A sensor, what it was made of, and the sample matched under it."""

    known: LensAndDetector
    described: Described
    trial: Trial

    @property
    def focal_px(self) -> float:
        """Focal length, pixels."""
        sensor = self.described.sensor
        return float(CAMERA_MODELS[sensor.camera_model].focal_px(sensor.initial, sensor.pixel_pitch_m))


@dataclass(frozen=True)
class _Found:
    """The sensor that the sample matches, which way round its images are, and the scatter of their focal lengths, a share of it."""

    matched: _Matched
    mirrored: bool
    scatter: float


class _Search:
    """One search: what was tried so far."""

    def __init__(
        self,
        sample: Telemetry,
        catalogue: Catalogue,
        known: LensAndDetector,
        cache_folder: Path | None,
        tell: Report,
        ends: float,
        subject: str,
    ) -> None:
        self.sample, self.known, self.tried = sample, known, list[TriedField]()
        self.exposures = find_exposures(sample)
        self._catalogue, self._folder, self._tell, self._ends = catalogue, cache_folder, tell, ends
        self._subject = subject
        self.rows, self.columns = int(known.rows or 0), int(known.columns or 0)
        enough = np.flatnonzero(self.exposures.count >= FEWEST_STARS)
        self._probes = enough[
            np.unique(np.linspace(0, len(enough) - 1, PROBED).round().astype(np.int64))[: len(enough)]
        ]
        self.cut_short = False

    def run(self) -> _Found | None:
        """Guess until a sensor is found; None where none is."""
        for field_deg in self._guesses():
            if self.cut_short or not len(self._probes):
                return None
            self.cut_short = time.perf_counter() > self._ends
            consensus = self._probe(field_deg)
            found = None if consensus is None else self._solve(field_deg, consensus)
            if found is not None:
                return found
        return None

    def _guesses(self) -> Iterator[float]:
        """The field that somebody gave, and those that are tried of every camera."""
        known = self.known
        if known.field_of_view_deg is not None:
            yield known.field_of_view_deg
        elif known.focal_length_mm is not None and known.pixel_pitch_um is not None:
            side_mm = max(self.rows, self.columns) * known.pixel_pitch_um * 1e-3
            yield float(np.degrees(2 * np.arctan(side_mm / 2 / known.focal_length_mm)))
        yield from FIELDS_DEG

    def _probe(self, field_deg: float) -> Consensus | None:
        """Recognise some exposures under a guess."""
        narrowest, widest = NARROWEST * field_deg, min(WIDEST * field_deg, 170.0)
        self._tell(
            f"trying fields of {narrowest:.2g}° to {widest:.3g}°; the first time builds a table of star patterns", None
        )
        found: list[Recognised | None] = []
        for place in self._probes:
            found.append(self._recognise(int(place), field_deg, UPRIGHT))
            if find_consensus(found, FEWEST + 1) is not None:
                break
        count = sum(one is not None for one in found)
        self.tried.append(TriedField(narrowest, widest, len(found), count))
        return find_consensus(found, 1)

    def _guessed_focal_px(self, field_deg: float) -> float:
        return max(self.rows, self.columns) / 2 / math.tan(math.radians(field_deg) / 2)

    def _recognise(self, place: int, field_deg: float, parity: int) -> Recognised | None:
        """Recognise one exposure by a pinhole camera of that field."""
        rows = self._rows(place)
        camera, pitch = usual_camera(), PITCH_UM * 1e-6
        x = camera.plain(self._guessed_focal_px(field_deg), (self.rows - 1) / 2, (self.columns - 1) / 2, pitch)
        s_d = camera.directions(x, self.sample.row_px[rows], self.sample.col_px[rows], pitch)
        magnitude = None if self.sample.magnitude is None else self.sample.magnitude[rows]
        return recognise(s_d, magnitude, parity, field_deg, self._folder)

    def _solve(self, field_deg: float, consensus: Consensus) -> _Found | None:
        """Match the sample as recognised, and as its stars then say; None where it does not match."""
        parity = -UPRIGHT if consensus.mirrored else UPRIGHT
        self._tell("recognising and matching the stars", None)
        seen = [self._recognise(place, field_deg, parity) for place in range(len(self.exposures))]
        upright = [one for one in seen if one is not None and not one.mirrored]
        agreed = find_consensus(upright, 1)
        if agreed is None:
            return None
        recognised = [_agreeing(one, agreed.focal_ratio) for one in seen]
        ratios = np.array([one.focal_ratio for one in upright])
        scatter = float(1.4826 * np.median(np.abs(ratios / agreed.focal_ratio - 1)))
        focal_px = agreed.focal_ratio * self._guessed_focal_px(field_deg)
        first = self._match(replace(self.known, parity=parity), _Lens(focal_px), recognised)
        if not self._stands(first.trial):
            return None
        recognised = self._completed(first.described, recognised)
        return _Found(self._refined(first, recognised), consensus.mirrored, scatter)

    def _completed(self, described: Described, recognised: list[Recognised | None]) -> list[Recognised | None]:
        """Identify by the sensor found the exposures that the guess did not recognise, with the table that a calibration needs."""
        sensor, completed = described.sensor, list(recognised)
        camera, pitch = CAMERA_MODELS[sensor.camera_model], sensor.pixel_pitch_m
        field_deg = field_of_view_deg(camera, sensor.initial, sensor.rows, sensor.columns, pitch)
        for place, one in enumerate(recognised):
            if one is None and self.exposures.count[place] >= ENOUGH_STARS:
                rows = self._rows(place)
                s_d = camera.directions(sensor.initial, self.sample.row_px[rows], self.sample.col_px[rows], pitch)
                bright = None if self.sample.magnitude is None else self.sample.magnitude[rows]
                attitude = identify(s_d, bright, sensor.parity, field_deg, self._folder)
                completed[place] = None if attitude is None else Recognised(attitude, mirrored=False, focal_ratio=1.0)
        return completed

    def _rows(self, place: int) -> slice:
        first = int(self.exposures.start[place])
        return slice(first, first + int(self.exposures.count[place]))

    def _refined(self, first: _Matched, recognised: list[Recognised | None]) -> _Matched:
        """The sensor that its stars fit, with what else they tell; the one recognised where the fit is led astray."""
        best, focal_px = first, first.focal_px
        for _ in range(ROUNDS):
            lens = _fitted_lens(best)
            if lens is None or abs(lens.focal_px / focal_px - 1) > FARTHEST_FIT:
                lens = _Lens(focal_px)
            found = self._match(self._measured(best), lens, recognised)
            enough = found.trial.solved >= first.trial.solved and found.trial.stars >= FEWER * first.trial.stars
            if not enough or not self._stands(found.trial):
                break
            best = found
        return best

    def _measured(self, matched: _Matched) -> LensAndDetector:
        """What is known with the noise and the faintest magnitude that matched stars tell."""
        known = self.known
        return replace(
            matched.known,
            centroid_sigma_px=known.centroid_sigma_px or _centroid_sigma(matched.trial),
            magnitude_limit=_magnitude_seen(matched.trial, self._catalogue)
            if known.magnitude_limit is None
            else known.magnitude_limit,
        )

    def _match(self, known: LensAndDetector, lens: _Lens, recognised: list[Recognised | None]) -> _Matched:
        """Match the sample under a lens."""
        pitch_um = _pitch_um(self.known, lens.focal_px)
        numbers = replace(
            known,
            sheet=None,
            pixel_pitch_um=pitch_um,
            focal_length_mm=lens.focal_px * pitch_um * 1e-3,
            field_of_view_deg=None,
        )
        described = _bent(describe_sensor(numbers, self._subject), lens)
        bench = Bench(self.sample, described.sensor, self._catalogue, CalibrationSettings(), self._folder)
        telemetry, sensor = bench.read(Hypothesis())
        matches = bench.match(telemetry, sensor, recognised)
        fit = fit_camera(telemetry, sensor, matches, 1.0)
        return _Matched(known, described, Trial(Hypothesis(), sensor, telemetry, matches, fit))

    def _stands(self, trial: Trial) -> bool:
        return trial.solved >= min(FEWEST, len(self._probes)) and trial.log10_chance < TOO_LIKELY


def _agreeing(one: Recognised | None, focal_ratio: float) -> Recognised | None:
    """What was recognised as far as it agrees with the others, and its focal length as theirs."""
    if one is None or one.mirrored or abs(one.focal_ratio / focal_ratio - 1) > FARTHEST_FIT:
        return None
    return Recognised(one.quaternion, mirrored=False, focal_ratio=1.0)


def _radial_place(sensor: Sensor) -> int | None:
    """Place of the radial term that is estimated; None of a camera without one."""
    camera = CAMERA_MODELS[sensor.camera_model]
    named = zip(camera.parameter_names, camera.parameters, strict=True)
    return next((k for k, (name, one) in enumerate(named) if one.role is Role.RADIAL and name in sensor.free), None)


def _bent(described: Described, lens: _Lens) -> Described:
    """A sensor with the radial term of a lens, as far as it then sees the sky with its whole detector."""
    sensor = described.sensor
    place, camera = _radial_place(sensor), CAMERA_MODELS[sensor.camera_model]
    if place is None or not lens.radial:
        return described
    x = sensor.initial.copy()
    x[place] = lens.radial
    if camera.blind_corner(x, sensor.rows, sensor.columns, sensor.pixel_pitch_m) is not None:
        return described
    return replace(described, sensor=replace(sensor, initial=x))


def _fitted_lens(matched: _Matched) -> _Lens | None:
    """Focal length and lowest radial term that fit the matched stars, with the principal point free and every other term held."""
    sensor = matched.described.sensor
    camera, place = CAMERA_MODELS[sensor.camera_model], _radial_place(sensor)
    free = {camera.place(Role.FOCAL), *camera.principal_places, place}
    sigma = np.where([k in free for k in range(len(sensor.initial))], 1.0, HELD) * sensor.typical_sigma
    fit = fit_camera(matched.trial.telemetry, replace(sensor, typical_sigma=sigma), matched.trial.matches, FREED)
    if fit is None:
        return None
    focal_px = float(camera.focal_px(fit.x, sensor.pixel_pitch_m))
    return _Lens(focal_px, 0.0 if place is None else float(fit.x[place]))


def _pitch_um(known: LensAndDetector, focal_px: float) -> float:
    """The pitch that was given, or follows from the focal length that was, or is taken."""
    if known.pixel_pitch_um is not None:
        return known.pixel_pitch_um
    asked = ASKED["pixel_pitch_um"]
    by_lens = PITCH_UM if known.focal_length_mm is None else 1e3 * known.focal_length_mm / focal_px
    return by_lens if asked.lowest <= by_lens <= asked.highest else PITCH_UM


def _centroid_sigma(trial: Trial) -> float | None:
    """Centroid error that the matched stars show, one axis, pixels; None of too few."""
    fit, matched = trial.agreement, trial.matches.star_id > 0
    if fit is None:
        return None
    told = float(np.trace(fit.H @ np.linalg.inv(fit.H + np.eye(len(fit.b)))))
    if fit.dof - told < 3:
        return None
    stated = float(np.median(centroid_sigma_px(trial.telemetry, trial.sensor)[matched]))
    return float(np.clip(stated * math.sqrt(fit.chi2 / (fit.dof - told)), *SIGMAS_PX))


def _matched_magnitudes(trial: Trial, catalogue: Catalogue) -> FloatArray:
    index: IntArray = catalogue.find_index(trial.matches.star_id[trial.matches.star_id > 0])
    return np.asarray(catalogue.magnitude[index[index >= 0]])


def _magnitude_seen(trial: Trial, catalogue: Catalogue) -> float | None:
    """Magnitude of the faintest matched stars, but for a few, and `BEYOND_MAG` more, rounded up to a tenth; None of none."""
    magnitude = _matched_magnitudes(trial, catalogue)
    return None if not len(magnitude) else math.ceil(10 * (float(np.quantile(magnitude, SEEN_SHARE)) + BEYOND_MAG)) / 10


def _focal_sigma(found: _Found) -> float:
    """Uncertainty of the focal length as a share of it: of the fit where there is one, else as the exposures scatter."""
    fit, sensor = found.matched.trial.agreement, found.matched.described.sensor
    if fit is None:
        return found.scatter
    place = CAMERA_MODELS[fit.camera_model].place(Role.FOCAL)
    return float(fit.noise * fit.sigma[place] * sensor.typical_sigma[place] / sensor.initial[place])


def _conclude(
    search: _Search,
    found: _Found,
    given: LensAndDetector,
    of_exposures: int,
    *,
    of_images: bool,
    measured: tuple[str, ...],
) -> Proposal:
    """Say what was found, and why each number is what it is."""
    matched, what = found.matched, "images" if of_images else "exposures"
    sensor, trial = matched.described.sensor, matched.trial
    camera = CAMERA_MODELS[sensor.camera_model]
    focal_px, share, place = matched.focal_px, _focal_sigma(found), camera.place(Role.FOCAL)
    across = field_of_view_deg(camera, sensor.initial, sensor.rows, sensor.columns, sensor.pixel_pitch_m)
    down = 2 * math.degrees(math.atan(min(sensor.rows, sensor.columns) / 2 / focal_px))
    few = 3 * share > FOCAL_SHARE  # so few stars that they tell less than the label of a lens
    if few:
        sigma = sensor.typical_sigma.copy()
        sigma[place] = 3 * share * sensor.initial[place]
        sensor = replace(sensor, typical_sigma=sigma)
    way, parity = ("mirrored", "1") if found.mirrored else ("upright", "-1")
    n = len(search.exposures)
    looked = f"{n:,} {what}" + (f" looked at, of {of_exposures:,}," if of_exposures > n else "")
    focal_mm, uncertain = focal_px * sensor.pixel_pitch_m * 1e3, f"{focal_px:.1f} ± {share * focal_px:.2g} px"
    pitch = _say_pitch(given, sensor.pixel_pitch_m * 1e6, focal_mm, share * focal_mm)
    sentences = [
        (
            f"{trial.solved:,} of {looked} were solved with {trial.stars:,} stars: the image is {way} (parity {parity}) and covers "
            f"{across:.3g}° by {down:.3g}°; focal length {uncertain}."
        ),
        pitch,
        *_compare(given, focal_mm, across),
    ]
    reasons = {
        **matched.described.reasons,
        "detector": _say_detector(given, measured, of_images=of_images),
        "detector.pixel_pitch_m": pitch,
        "initial": (
            "The principal point in the middle of the detector; focal length and lowest radial term from a quick fit, "
            "as a start for calibrations."
        ),
        "initial.focal_length": (
            f"{focal_mm:.5g} mm, {uncertain}, measured from {trial.stars:,} stars in {trial.solved:,} {what}; the field covers "
            f"{across:.3g}° by {down:.3g}°."
        ),
        f"typical_sigma.{camera.parameter_names[place]}": (
            "Three times the uncertainty from so few stars."
            if few
            else f"{FOCAL_SHARE:.0%} of it, as for any lens. These stars give {share:.2%}, but using that would count them twice "
            "in "
            "a calibration."
        ),
        "parity": f"{trial.solved:,} of {looked} were solved as {way}.",
    }
    if given.centroid_sigma_px is None and matched.known.centroid_sigma_px is not None:
        reasons["centroid_sigma_px"] = f"Measured: distance of {trial.stars:,} stars from their catalogue positions."
    if given.magnitude_limit is None and matched.known.magnitude_limit is not None:
        reasons["magnitude_limit"] = (
            f"Observed: {SEEN_SHARE:.0%} of the matched stars are at least {BEYOND_MAG:g} mag brighter."
        )
    return Proposal(
        described=Described(sensor, reasons),
        exposures=n,
        of_exposures=of_exposures,
        solved=trial.solved,
        stars=trial.stars,
        focal_px=focal_px,
        focal_sigma_px=share * focal_px,
        across_deg=across,
        down_deg=down,
        tried=search.tried,
        sentences=sentences,
    )


def _say_pitch(given: LensAndDetector, pitch_um: float, focal_mm: float, sigma_mm: float) -> str:
    if given.pixel_pitch_um is not None:
        return f"With the pixel pitch given, {pitch_um:.4g} µm, that is {focal_mm:.5g} ± {sigma_mm:.2g} mm."
    if given.focal_length_mm is not None and pitch_um != PITCH_UM:
        return (
            f"Stars only determine focal length over pixel pitch, so the focal length given, {focal_mm:.4g} mm, makes a pixel "
            f"{pitch_um:.4g} µm."
        )
    return (
        f"Stars only determine focal length over pixel pitch, and neither was given: a pixel pitch of {pitch_um:g} µm is "
        f"assumed, which makes the focal length {focal_mm:.4g} mm; another pitch scales all lengths equally and moves no star."
    )


def _compare(given: LensAndDetector, focal_mm: float, across_deg: float) -> Iterator[str]:
    """Say where the stars contradict a number that was given; theirs is taken."""
    if given.focal_length_mm is not None and given.pixel_pitch_um is not None:
        off = focal_mm / given.focal_length_mm - 1
        if abs(off) > 3 * FOCAL_SHARE:
            yield (
                f"The focal length given, {given.focal_length_mm:g} mm, contradicts the stars ({off:+.1%}): check it and the "
                "pixel pitch, after binning."
            )
    view = given.field_of_view_deg
    if view is not None and abs(across_deg / view - 1) > 3 * FOCAL_SHARE:
        yield f"The field of view given, {view:g}°, contradicts the stars, {across_deg:.4g}°."


def _say_detector(given: LensAndDetector, measured: tuple[str, ...], *, of_images: bool) -> str:
    if measured:
        names = " and ".join(measured)
        return (
            f"{names.capitalize()} estimated from the extent of the detections, with equal margins at both ends; give {names} if "
            "known."
        )
    return "As large as the images." if of_images and given.sheet is None else "As given."


def _say_nothing(search: _Search, of_exposures: int, *, of_images: bool) -> str:
    """Say that nothing was recognised, what was tried, and what to do by the likeliest cause."""
    what = "images" if of_images else "exposures"
    count, n = search.exposures.count, len(search.exposures)
    of = f"{n:,}" if of_exposures == n else f"{n:,} looked at, of {of_exposures:,},"
    rich = int(np.sum(count >= ENOUGH_STARS))
    if 2 * rich < n:
        return (
            f"None of the {of} {what} could be solved, because {n - rich:,} show fewer than {ENOUGH_STARS} stars (the median is "
            f"{np.median(count):.0f}): expose longer or look for fainter stars"
            + (" (--threshold)" if of_images else "")
            + ", and check that the lens is in focus and the sky clear."
        )
    tried = "; ".join(
        f"{one.narrowest_deg:.2g}° to {one.widest_deg:.3g}° ({one.recognised} of {one.exposures})"
        for one in search.tried
    )
    late = " The time limit was reached before all fields were tried." if search.cut_short else ""
    return (
        f"None of the {of} {what} could be solved (median {np.median(count):.0f} stars). Fields of view tested, upright and "
        f"mirrored, with the number recognised in brackets: {tried}.{late} Give the field of view if it is different, "
        "leave out images with clouds, trails or motion, and check that rows and columns are those of the whole detector."
    )
