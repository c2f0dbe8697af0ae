"""Why a telemetry set does not match: every mistake that sensor files and telemetry are known to have, tried on a sample.

**What an image can show.** Each exposure of a sample is recognised with parity and focal length untrusted, as the file stands and
with rows and columns exchanged. Where several agree on which way round it is and, to `SAME_RATIO`, on the focal length, that is how
the image is; `FEWEST` exposures that agree by chance are not to be had. A mirrored image has one of four causes (parity, rows or
columns from the other edge, rows and columns exchanged), which stars tell apart by the shape of the detector and its principal
point, and by the attitude that the file gives, if any. Those that nothing tells apart are all named, the first in that order.

**Verification.** No mend is proposed because it is plausible. The sample is matched with it, and it stands if at least `FEWEST`
exposures and `SHARE` of those with enough stars are solved, if that is no coincidence (`TOO_LIKELY`, see `trials`), and if it
solves clearly more than the file does as it is (`BETTER`). Otherwise the cause is unknown, and what was tried is told.

**What matches and is wrong all the same.** Some mistakes do not stop the matching but bend its result. They are looked for with the
stars that matched, each against its own limit:

- focal length: the fit (`camera_fit`) is off by `FAR_FOCAL` and more than three typical sigmas, more than any launch does;
- origin: with the principal point half a pixel or one pixel off on both axes, chi2 falls by `CLEAR_CHI2`, and no other principal
  point does better by `FREE_CHI2`; or the attitudes matched look past those of the file by as much. Either shows only where the
  sensor file knows its principal point to a fraction of a pixel, for else that takes it up, and no harm is done. Or detections lie
  past the last pixel by less than one, and none in front of the first;
- quaternions: their attitudes are `AGREE_RAD` from those matched in one order and sense, not the one given;
- directions: the file's are within `SAME_PLACE_RAD` of the catalogue's of the other kind, apparent or of J2000.0;
- epoch: with the times shifted chi2 falls by `CLEAR_CHI2` times two, for proper motion and the season's aberration say when it was.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.diagnosis.camera_fit import fit_camera, fit_directions
from boresight.calibration.diagnosis.result import MOST_OFF, Diagnosis, FoundCause, Tried
from boresight.calibration.diagnosis.sentences import describe, say
from boresight.calibration.diagnosis.trials import Bench, Hypothesis, Trial
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import TelemetryInput, is_large, read_whole
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import Role
from boresight.errors import RefusedInputError
from boresight.estimation.attitude import conjugate, rotation_vector, to_matrix, triad
from boresight.estimation.attitude import product as turn
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import Catalogue, unit_vectors
from boresight.sky.directions import star_directions
from boresight.sky.identification import FEWEST_STARS, FIELD_ERROR, MOST_STARS, Recognised
from boresight.telemetry.mapping import TelemetryMapping
from boresight.telemetry.quality.detector import on_detector
from boresight.telemetry.read.checks import EARLIEST, LATEST
from boresight.telemetry.schema import Telemetry, find_exposures, joined, take_rows
from boresight.telemetry.sensors import Sensor, sensor_document
from boresight.waiting import ignore_progress

Report = Callable[[str, float | None], None]

#: Exposures that are looked at, and seconds that may be spent on them; making a table of patterns is not counted.
MOST_EXPOSURES, BUDGET_S = 40, 30.0
#: The same where exposures have more detections than any tracker sends: a pattern that is none then takes a second.
CROWDED_BUDGET_S = 2.0
#: Detections of these exposures together, about: an exposure that has very many costs as much as many exposures.
MOST_DETECTIONS = 3_000
#: Exposures of the chosen frames, as a multiple of those wanted, from which on they are thinned too.
MOST_IN_FRAMES = 4
#: Exposures that a mend has to solve, at least and as a share of those with enough stars, and log10 of the chance that it did by
#: coincidence.
FEWEST, SHARE, TOO_LIKELY = 2, 0.3, -9.0
#: An exposure with so many detections should be solved.
ENOUGH_STARS = 7
#: Of the stars that a mend matches, the file as it is matches less than this share, or the mend is none.
BETTER = 0.85
#: Of detections so much more may lie off the detector than under the candidate that has fewest there.
FEW_OFF = 0.02
#: Share of each side of the detector that centroids span.
FILLED = 0.5
#: Focal lengths over the file's that are tried where nothing is recognised, as of binned pixels, and on so many exposures.
FACTORS, MOST_FOR_FACTORS = (2.0, 0.5), 6
#: Candidates within this share of the most stars are told apart by other things.
ALIKE = 0.97
SAME_RATIO = 0.02
#: How well recognised exposures know the focal length, and how far off the file's is where it matches all the same.
SURE_RATIO, FAR_FOCAL = 0.004, 0.02
CLEAR_CHI2, FREE_CHI2 = 16.0, 9.0
AGREE_RAD = 0.06
SAME_PLACE_RAD = 1.5e-6
ORIGINS_PX = (0.5, 1.0, -0.5, -1.0)
#: What on-board clocks are mistaken by, seconds: their epochs against that of Unix, 1970-01-01.
EPOCHS_S = {"J2000": 946_728_000.0, "2000-01-01": 946_684_800.0, "GPS": 315_964_800.0, "TAI 1958": -378_691_200.0}
YEAR_S = 365.25 * 86400.0


def sample_exposures(telemetry: TelemetryInput, most: int = MOST_EXPOSURES) -> tuple[Telemetry, int]:
    """Return whole frames spread over a set, of `most` exposures about, and how many exposures it has."""
    if not is_large(telemetry):
        return _pick_frames(whole := read_whole(telemetry), most), len(find_exposures(whole))
    sample, exposures = ExposureSample(most), 0
    for chunk in telemetry.chunks():
        exposures += len(find_exposures(chunk))
        sample.add(chunk)
    return sample.get(), exposures


class ExposureSample:
    """Whole frames spread over a set that comes in parts, of `most` exposures about."""

    def __init__(self, most: int) -> None:
        self._most, self._kept = most, list[Telemetry]()

    def add(self, part: Telemetry) -> None:
        """Take frames of the next part; the memory that is held does not grow with their number."""
        if len(part):
            self._kept.append(_pick_frames(part, self._most))
        if len(self._kept) > self._most:
            self._kept = self._kept[::2]

    def get(self) -> Telemetry:
        """Return the sample of a set that has rows."""
        return _pick_frames(joined(self._kept), self._most)


def _pick_frames(telemetry: Telemetry, most: int) -> Telemetry:
    """Return frames spread over a set in memory, of those with enough detections where there are any."""
    exposures = find_exposures(telemetry)
    frames, first, of = np.unique(exposures.frame, return_index=True, return_inverse=True)
    enough = np.flatnonzero(np.maximum.reduceat(exposures.count, first) >= FEWEST_STARS)
    chosen = enough if len(enough) else np.arange(len(frames))
    most = min(most, max(FEWEST, MOST_DETECTIONS * len(exposures) // len(telemetry)))
    wanted = max(1, round(most * len(frames) / len(exposures)))
    if len(chosen) > wanted:
        chosen = chosen[np.linspace(0, len(chosen) - 1, wanted).round().astype(np.int64)]
    seen = np.flatnonzero(np.isin(of, chosen))
    if len(seen) > MOST_IN_FRAMES * most:  # frames without end
        seen = seen[np.linspace(0, len(seen) - 1, most).round().astype(np.int64)]
    if len(seen) == len(exposures) and exposures.count.max() <= MOST_STARS:
        return replace(telemetry, unknown={})
    rows = [_brightest(telemetry, int(exposures.start[k]), int(exposures.count[k])) for k in seen]
    return take_rows(telemetry, np.concatenate(rows))


def _brightest(telemetry: Telemetry, first: int, count: int) -> IntArray:
    """Rows of an exposure, of very many the brightest, or some evenly spread where magnitudes are not known."""
    if count <= MOST_STARS:
        return np.arange(first, first + count)
    if telemetry.magnitude is None or not np.isfinite(telemetry.magnitude[first : first + count]).any():
        return first + np.linspace(0, count - 1, MOST_STARS).round().astype(np.int64)
    faint = np.nan_to_num(telemetry.magnitude[first : first + count], nan=np.inf)
    return np.sort(first + np.argsort(faint, kind="stable")[:MOST_STARS])


def diagnose(
    telemetry: TelemetryInput,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings | None = None,
    *,
    cache_folder: Path | None = None,
    report: Report | None = None,
    budget_s: float = BUDGET_S,
) -> Diagnosis:
    """Find why a telemetry set does not match its sensor file.

    Parameters
    ----------
    telemetry, sensor, catalogue
        The set, whose it is, and the stars there are. Up to `MOST_EXPOSURES` exposures are looked at, spread over the set.
    settings
        Of a calibration, `minimum_stars`, `leave_out_doubles` and `initial_sigma_scale` count.
    cache_folder
        Where lost-in-space identification keeps its tables; None makes them again.
    report
        Told what is being tried.
    budget_s
        Seconds after which nothing more is tried.

    Returns
    -------
    The diagnosis; every mend in it was verified by matching with it.
    """
    sample, of_exposures = sample_exposures(telemetry)
    bench = Bench(sample, sensor, catalogue, settings or CalibrationSettings(), cache_folder)
    tell = report or ignore_progress
    tell("reading the table of star patterns", None)
    bench.prepare()  # making the table is not counted
    crowded = float(np.median(bench.exposures.count)) >= MOST_STARS if len(bench.exposures) else False
    bench.ends = time.perf_counter() + (min(budget_s, CROWDED_BUDGET_S) if crowded else budget_s)
    return _Search(bench, of_exposures, tell).run()


def match_as_they_stand(telemetry: TelemetryInput, sensor: Sensor, catalogue: Catalogue) -> bool:
    """Whether half of a sample matches by the stars and attitudes that the file itself gives; quick, and recognises nothing."""
    sample, _ = sample_exposures(telemetry)
    bench = Bench(sample, sensor, catalogue, CalibrationSettings(), None)
    valid = bench.match_as_given()
    return bool(2 * valid.sum() >= len(valid))


@dataclass(frozen=True)
class Consensus:
    """How the images of a sample are: mirrored or not, true focal length over the file's, and how many exposures say so."""

    mirrored: bool
    focal_ratio: float
    exposures: int


def find_consensus(recognised: Sequence[Recognised | None], fewest: int = FEWEST) -> Consensus | None:
    """Return what most of the recognised exposures agree on; None where fewer than so many do."""
    known = [one for one in recognised if one is not None]
    best: Consensus | None = None
    for mirrored in (False, True):
        ratios = np.sort([one.focal_ratio for one in known if one.mirrored == mirrored])
        for ratio in ratios:
            alike = ratios[(ratios >= ratio) & (ratios <= ratio * (1 + SAME_RATIO))]
            if len(alike) >= fewest and (best is None or len(alike) > best.exposures):
                best = Consensus(mirrored, float(np.median(alike)), len(alike))
    return best


#: What mirrors an image, in the order in which it is named where nothing tells them apart.
MIRRORS = {
    "parity": Hypothesis(("parity",), parity=True),
    "flipped_rows": Hypothesis(("flipped_rows",), mapping=TelemetryMapping(flipped_rows=True)),
    "flipped_columns": Hypothesis(("flipped_columns",), mapping=TelemetryMapping(flipped_columns=True)),
    "swapped_axes": Hypothesis(("swapped_axes",), mapping=TelemetryMapping(swapped_axes=True)),
}
SWAPPED = MIRRORS["swapped_axes"]


def both(one: Hypothesis, other: Hypothesis) -> Hypothesis:
    """Return one hypothesis that makes the changes of both; where both change the same thing, the second counts."""
    plain, first, second = TelemetryMapping(), one.mapping, other.mapping
    merged = {
        name: getattr(second, name) if getattr(second, name) != default else getattr(first, name)
        for name, default in vars(plain).items()
    }
    return Hypothesis(
        names=tuple(dict.fromkeys((*one.names, *other.names))),
        parity=one.parity != other.parity,
        focal_ratio=one.focal_ratio * other.focal_ratio,
        mapping=TelemetryMapping(**merged),
        limit=one.limit if other.limit is None else other.limit,
        directions=one.directions if other.directions is None else other.directions,
    )


class _Search:
    """One search: what was tried so far, and what is found."""

    def __init__(self, bench: Bench, of_exposures: int, tell: Report) -> None:
        self.bench, self.of_exposures, self.tell = bench, of_exposures, tell
        self.trials: list[Trial] = []

    def run(self) -> Diagnosis:
        """Search, from what stops the matching to what bends its result."""
        start = self._directions()
        before = self._try(start)
        start, reading = self._reading(start, before)
        best, alternatives = self._image(start, reading)
        misread = not best.hypothesis.mapping.changes and self._off_detector(best) > MOST_OFF
        if not self._stands(best) or misread:
            return self._unknown(before, start)
        best = self._focal_length(best)
        for look in (self._magnitude_limit, self._quaternions, self._epoch, self._origin):
            if not self.bench.late:
                best = look(best)
        hard = set(best.hypothesis.names) & {
            *MIRRORS,
            "centred_origin",
            "length_unit",
            "focal_length",
            "magnitude_limit",
        }
        if hard and not self._stands(best):
            return self._unknown(before, start)
        return self._diagnosis(before, best, alternatives)

    def _try(self, hypothesis: Hypothesis) -> Trial:
        self.tell(f"trying {describe(hypothesis)}", None)
        trial = self.bench.try_(hypothesis)
        self.trials.append(trial)
        return trial

    @property
    def _solvable(self) -> int:
        """Exposures with so many detections that they should match."""
        return int(np.sum(self.bench.exposures.count >= ENOUGH_STARS))

    def _stands(self, trial: Trial) -> bool:
        """Whether enough of the sample matches, and not by chance."""
        enough = max(min(FEWEST, len(self.bench.exposures)), SHARE * self._solvable)
        return trial.solved >= enough and trial.log10_chance < TOO_LIKELY

    # What stops the matching.

    def _reading(self, start: Hypothesis, before: Trial) -> tuple[Hypothesis, Trial]:
        """Find whether centroids are lengths, or counted from the detector's middle: where else they fill it and lie on it."""
        if self._fills(start) and self._off_detector(before) <= FEW_OFF:
            return start, before
        pitch = self.bench.sensor.pixel_pitch_m
        for unit_m in (pitch, 1e-3, 1e-6, 1.0):
            for centred in (False, True):
                mapping = TelemetryMapping(centred=centred, unit_px=unit_m / pitch)
                names = (*(["centred_origin"] if centred else []), *(["length_unit"] if unit_m != pitch else []))
                hypothesis = both(start, Hypothesis(names, mapping=mapping))
                if names and self._fills(hypothesis):
                    found = self._try(hypothesis)
                    return hypothesis, found
        return start, before

    def _fills(self, hypothesis: Hypothesis) -> bool:
        """Whether centroids lie on the detector, as it is or with rows and columns exchanged, and span most of both its sides."""
        for read in (hypothesis, both(hypothesis, SWAPPED)):
            telemetry, sensor = self.bench.read(read)
            spans = (
                np.ptp(telemetry.row_px) > FILLED * sensor.rows and np.ptp(telemetry.col_px) > FILLED * sensor.columns
            )
            if spans and np.mean(~on_detector(telemetry, sensor)) <= FEW_OFF:
                return True
        return False

    def _image(self, start: Hypothesis, before: Trial) -> tuple[Trial, list[str]]:
        """Find which way round the image is, and its focal length; with the names of mirrors that do as well."""
        trials = [before]
        for candidate in self._candidates(start):
            if self.bench.late:
                break
            if candidate != before.hypothesis:
                trials.append(self._try(candidate))
        limited = self.bench.sensor.magnitude_limit is not None
        if limited and max(one.solved for one in trials) < SHARE * self._solvable:
            trials += [self._try(replace(one.hypothesis, limit=np.nan)) for one in trials if not self.bench.late]
        return self._choose(trials)

    def _candidates(self, start: Hypothesis) -> Iterator[Hypothesis]:
        """Return what the recognised exposures leave possible, and the mirrors where none is recognised."""
        plain = find_consensus(self.bench.recognise(start))
        swapped = find_consensus(self.bench.recognise(both(start, SWAPPED)))
        if plain is None and swapped is None:
            if (scaled := self._by_factor(start)) is not None:
                yield from self._with_focal_lengths(*scaled)
                return
            yield from (both(start, one) for one in MIRRORS.values())
            if self.bench.sample.quaternion is not None:
                yield from (both(start, one) for one in CONVENTIONS)
            return
        if plain is not None:
            kinds = list(MIRRORS.values()) if plain.mirrored else [Hypothesis()]
            yield from self._with_focal_lengths([both(start, one) for one in kinds], plain.focal_ratio)
        if swapped is not None and self._brings_on(start):
            others = [one for one in MIRRORS.values() if one is not SWAPPED] if swapped.mirrored else [Hypothesis()]
            kinds = [both(both(start, SWAPPED), one) for one in others]
            yield from self._with_focal_lengths(kinds, swapped.focal_ratio)

    def _by_factor(self, start: Hypothesis) -> tuple[list[Hypothesis], float] | None:
        """Return ways round of the image and the true focal length over the file's, where it is about half or double."""
        self.bench.looks_up_deg = self.bench.field_deg  # the table that is loaded: another takes seconds to make
        for factor in FACTORS:
            scaled = both(start, Hypothesis(focal_ratio=factor))
            found = find_consensus(self.bench.recognise(scaled, MOST_FOR_FACTORS))
            if found is not None:
                kinds = list(MIRRORS.values()) if found.mirrored else [Hypothesis()]
                return [both(start, one) for one in kinds], factor * found.focal_ratio
        self.bench.looks_up_deg = None
        return None

    def _with_focal_lengths(self, kinds: list[Hypothesis], ratio: float) -> Iterator[Hypothesis]:
        """Return hypotheses that keep the file's focal length, where that may do, and with the one recognised."""
        if abs(ratio - 1) < FIELD_ERROR:
            yield from (one for one in kinds if one.names)
        if abs(ratio - 1) > SURE_RATIO:
            yield from (both(one, Hypothesis(("focal_length",), focal_ratio=ratio)) for one in kinds)

    def _brings_on(self, start: Hypothesis) -> bool:
        """Whether exchanging rows and columns brings detections onto the detector: of those off it, most of at least a few."""
        off = ~self.bench.on_detector(start)
        return bool(off.sum() > FEWEST and self.bench.on_detector(both(start, SWAPPED))[off].mean() > 0.5)

    def _choose(self, trials: list[Trial]) -> tuple[Trial, list[str]]:
        """Choose the trial that explains most, of alike ones the simplest; the files as they stand unless another is better."""
        most = max(trials, key=lambda one: one.stars)
        good = [one for one in trials if one.stars >= BETTER * most.stars and one.solved >= BETTER * most.solved]
        if trials[0] in good:
            return trials[0], []
        off = [self._off_detector(one) for one in good]
        good = [one for one, share in zip(good, off, strict=True) if share <= min(off) + FEW_OFF]
        fewest = min(len(one.hypothesis.names) for one in good)
        good = [one for one in good if len(one.hypothesis.names) == fewest]
        alike = [one for one in good if one.stars >= ALIKE * max(other.stars for other in good)]
        agreeing = [self._quaternion_share(one) for one in alike]
        alike = [one for one, share in zip(alike, agreeing, strict=True) if share >= max(agreeing) - 0.2]
        noise = min(_noise(one) for one in alike)
        least = min(_chi2(one) for one in alike)
        alike = [one for one in alike if _chi2(one) - least < CLEAR_CHI2 * noise]
        named = {name for one in alike[1:] for name in one.hypothesis.names} - set(alike[0].hypothesis.names)
        return alike[0], [name for name in MIRRORS if name in named]

    def _off_detector(self, trial: Trial) -> float:
        """Share of the detections that lie off the detector."""
        return float(np.mean(~on_detector(trial.telemetry, trial.sensor)))

    def _focal_length(self, best: Trial) -> Trial:
        """Take the focal length from the stars where it is a cause, or where the file's is farther off than any launch puts it."""
        agreement, sensor = best.agreement, best.sensor
        if agreement is None:
            return best
        place = CAMERA_MODELS[sensor.camera_model].place(Role.FOCAL)
        given, fitted = self.bench.sensor.initial[place], agreement.x[place]
        far = abs(fitted / given - 1) > FAR_FOCAL and abs(fitted - given) > 3 * sensor.typical_sigma[place]
        if "focal_length" not in best.hypothesis.names and not far:
            return best
        rest = tuple(name for name in best.hypothesis.names if name != "focal_length")
        refined = self._try(replace(best.hypothesis, focal_ratio=float(fitted / given), names=(*rest, "focal_length")))
        return refined if refined.stars >= ALIKE * best.stars else best

    def _magnitude_limit(self, best: Trial) -> Trial:
        """Find a limit that lets clearly more stars match than the file's."""
        if self.bench.sensor.magnitude_limit is None:
            return best
        plain = self._try(replace(best.hypothesis, limit=np.nan))
        faintest = self._faintest(max(best, plain, key=lambda one: one.stars))
        if faintest is None:
            return best
        given = replace(best.hypothesis, limit=None, names=_without(best.hypothesis, "magnitude_limit"))
        as_given = best if best.hypothesis.limit is None else self._try(given)
        limit = round(faintest + 0.3, 1)
        mended = self._try(replace(given, limit=limit, names=(*given.names, "magnitude_limit")))
        gained = mended.stars - as_given.stars
        if as_given.stars < BETTER * mended.stars and gained > 3 * np.sqrt(mended.stars):
            return mended
        return as_given

    def _faintest(self, trial: Trial) -> float | None:
        """Magnitude of the faintest stars that matched, but for one in fifty."""
        index = self.bench.catalogue.find_index(trial.matches.star_id[trial.matches.star_id > 0])
        return float(np.percentile(self.bench.catalogue.magnitude[index], 98)) if len(index) else None

    # What bends the result.

    def _directions(self) -> Hypothesis:
        """Tell which kind the directions of the file are, by the catalogue."""
        telemetry, catalogue = self.bench.sample, self.bench.catalogue
        declared = self.bench.sensor.declared.directions
        if telemetry.ra_rad is None or telemetry.dec_rad is None or telemetry.star_id is None:
            return Hypothesis()
        index = catalogue.find_index(telemetry.star_id)
        rows = np.flatnonzero((telemetry.star_id > 0) & (index >= 0) & np.isfinite(telemetry.ra_rad))
        if len(rows) < FEWEST_STARS or self.bench.timeless:
            return Hypothesis()
        told = unit_vectors(telemetry.ra_rad[rows], telemetry.dec_rad[rows])
        velocity = None if telemetry.velocity_m_s is None else telemetry.velocity_m_s[rows]
        seen = apparent_directions(catalogue, index[rows], self.bench.times[rows], velocity)
        years = {"J1991.25": 0.0, "J2000": 8.75}
        resting = {name: _resting(catalogue, index[rows], year) for name, year in years.items()}
        of_j2000 = min(float(np.nanmedian(_apart(told, one))) for one in resting.values()) < SAME_PLACE_RAD
        of_date = float(np.nanmedian(_apart(told, seen))) < SAME_PLACE_RAD
        if of_j2000 and not of_date and declared != "j2000":
            return Hypothesis(("j2000_directions",), directions="j2000")
        if of_date and not of_j2000 and declared == "j2000":
            return Hypothesis(("j2000_directions",), directions="apparent")
        return Hypothesis()

    def _quaternion_share(self, trial: Trial) -> float:
        """Share of the solved exposures whose attitude the file gives, in whichever order and sense it gives them best."""
        if self.bench.sample.quaternion is None:
            return 0.0
        return max(self._agreeing(trial, one.mapping) for one in (Hypothesis(), *CONVENTIONS))

    def _agreeing(self, trial: Trial, convention: TelemetryMapping) -> float:
        valid, quaternion = trial.matches.valid, self.bench.sample.quaternion
        if quaternion is None:
            return 0.0
        given = convention.turned(quaternion[self.bench.exposures.start])[valid]
        known = np.isfinite(given).all(axis=1)
        if not known.any():
            return 0.0
        off = rotation_vector(turn(trial.matches.quaternion[valid][known], conjugate(given[known])))
        return float(np.mean(np.linalg.norm(off, axis=1) < AGREE_RAD))

    def _quaternions(self, best: Trial) -> Trial:
        """Find the order and sense of the file's quaternions by the attitudes that matched."""
        if self.bench.sample.quaternion is None or best.solved < FEWEST:
            return best
        plain = TelemetryMapping()
        shares = [self._agreeing(best, one.mapping) for one in CONVENTIONS]
        found = CONVENTIONS[int(np.argmax(shares))]
        if self._agreeing(best, plain) >= 0.5 or max(shares) < 0.8:
            return best
        mapping = replace(best.hypothesis.mapping, quaternion_order="xyzw", quaternion_sense="icrs_to_detector")
        bare = replace(best.hypothesis, mapping=mapping)
        return self._try(both(bare, found))

    def _epoch(self, best: Trial) -> Trial:
        """Find the shift of time under which the matched stars are where the catalogue has them."""
        telemetry = best.telemetry
        own = telemetry.ra_rad is not None and bool(np.isfinite(telemetry.ra_rad).any())
        if self.bench.timeless or telemetry.time_utc is None or best.agreement is None or own:
            return best
        shifts = [0.0, *(sign * one for one in EPOCHS_S.values() for sign in (1, -1))]
        shifts += [years * YEAR_S for years in range(-60, 61, 2) if years]
        shifts += [month * YEAR_S / 12 for month in range(-11, 12) if month]
        chi2 = np.full(len(shifts), np.inf)
        for k, shift in enumerate(shifts):
            if self.bench.late:
                return best
            chi2[k] = self._chi2_shifted(best, shift)
        noise2 = max(1.0, float(np.min(chi2)) / max(best.agreement.dof, 1))
        least = int(np.argmin(chi2))
        if (chi2[0] - chi2[least]) / noise2 < 2 * CLEAR_CHI2:
            return best
        named = [k for k in range(1, 9) if (chi2[k] - chi2[least]) / noise2 < FREE_CHI2]
        chosen = min(named, key=lambda k: chi2[k]) if named else least
        found = Hypothesis(("wrong_epoch",), mapping=TelemetryMapping(time_shift_s=float(shifts[chosen])))
        mended = self._try(both(best.hypothesis, found))
        return mended if mended.stars >= ALIKE * best.stars else best

    def _chi2_shifted(self, trial: Trial, shift_s: float) -> float:
        """chi2 of the matched stars seen at another time, through the air of a site where there is one.

        Every parameter of the camera is free: what the file holds fixed and is not so would pass for another season's aberration.
        """
        telemetry, matches = trial.telemetry, trial.matches
        sensor = replace(trial.sensor, free=CAMERA_MODELS[trial.sensor.camera_model].parameter_names)
        times = (self.bench.times if telemetry.time_utc is None else telemetry.time_utc) + np.timedelta64(
            round(shift_s * 1e6), "us"
        )
        if np.any((times < EARLIEST) | (times >= LATEST)):  # no file has such times, nor does the Earth's ephemeris
            return np.inf
        named, velocity = np.maximum(matches.star_id, 0), telemetry.velocity_m_s
        try:
            s_i = star_directions(named, None, None, times, velocity, self.bench.catalogue, sensor.site)
        except RefusedInputError:  # no camera stood on the ground then
            return np.inf
        scale = self.bench.settings.initial_sigma_scale
        near = None if trial.agreement is None else trial.agreement.w
        found = fit_directions(telemetry, sensor, named > 0, s_i, matches.exposure_start, scale, near)
        return np.inf if found is None else found.chi2

    def _origin(self, best: Trial) -> Trial:
        """Find an origin other than the centre of the first pixel."""
        origin = self._origin_by_edges(best) or self._origin_by_attitude(best) or self._origin_by_stars(best)
        if origin is None:
            return best
        found = Hypothesis(("half_pixel",), mapping=TelemetryMapping(origin_px=origin))
        mended = self._try(both(best.hypothesis, found))
        return mended if mended.stars >= ALIKE * best.stars else best

    def _origin_by_edges(self, best: Trial) -> float | None:
        """One pixel, where detections lie past the last pixel and none on the first half."""
        mapping, sample, sensor = best.hypothesis.mapping, self.bench.sample, self.bench.sensor
        row, col = (sample.col_px, sample.row_px) if mapping.swapped_axes else (sample.row_px, sample.col_px)
        past = [values - (size - 0.5) for values, size in ((row, sensor.rows), (col, sensor.columns))]
        noise = 3 * sensor.centroid_sigma_px
        over = sum(int(np.sum((one > min(noise, 0.4)) & (one <= 1.0))) for one in past)
        beyond = any(bool((one > 1.0).any()) for one in past)
        before = sum(int(np.sum(values < 0.5)) for values in (row, col))
        return 1.0 if over >= 3 and not beyond and not before else None

    def _origin_by_attitude(self, best: Trial) -> float | None:
        """Origin by which the attitudes matched look past those that the file gives, along both axes of the detector alike."""
        valid, sensor = best.matches.valid, best.sensor
        if best.telemetry.quaternion is None or valid.sum() <= FEWEST:
            return None
        given = best.telemetry.quaternion[self.bench.exposures.start][valid]
        ahead = np.einsum("eab,ecb->eac", to_matrix(best.matches.quaternion[valid]), to_matrix(given))[:, :, 2]
        ahead = ahead[np.isfinite(ahead[:, 0]) & (ahead[:, 2] > np.cos(AGREE_RAD))]
        if len(ahead) <= FEWEST:
            return None
        camera = CAMERA_MODELS[sensor.camera_model]
        off = camera.focal_px(sensor.initial, sensor.pixel_pitch_m) * triad(ahead, sensor.parity)[:, :2]
        mean = np.median(off, axis=0)
        scatter = 1.2533 * 1.4826 * np.median(np.abs(off - mean), axis=0) / np.sqrt(len(off))
        spread = np.hypot(scatter, sensor.typical_sigma[list(camera.principal_places)])
        sides = _sides(best.hypothesis.mapping)

        def chi2(origin: float) -> float:
            return float(np.sum(((mean - origin * sides) / spread) ** 2))

        origin = min(ORIGINS_PX, key=chi2)
        return origin if chi2(0.0) - chi2(origin) > CLEAR_CHI2 and chi2(origin) < FREE_CHI2 else None

    def _origin_by_stars(self, best: Trial) -> float | None:
        sensor, camera = best.sensor, CAMERA_MODELS[best.sensor.camera_model]
        found = fit_camera(best.telemetry, sensor, best.matches, 1.0)
        if found is None:
            return None
        places = list(camera.principal_places)
        noise2 = found.noise**2
        at = {origin: found.chi2_at(_moved(sensor, best, origin)) for origin in ORIGINS_PX}
        origin = min(at, key=lambda one: at[one])
        if (found.chi2 - at[origin]) / noise2 < CLEAR_CHI2:
            return None
        free = found.chi2_free(places)
        return origin if (at[origin] - free) / noise2 < FREE_CHI2 else None

    # What is told.

    def _unknown(self, before: Trial, start: Hypothesis) -> Diagnosis:
        names = [*(["no_time"] if self._wants_time(before) else []), *start.names, "unknown"]
        n = len(self.bench.exposures)
        causes = [FoundCause(name=name, exposures_solved=before.solved, exposures=n) for name in names]
        return self._make_diagnosis(before, before, causes, mended=False)

    def _wants_time(self, before: Trial) -> bool:
        """Whether stars need a time that the telemetry has not."""
        telemetry = before.telemetry
        if not self.bench.timeless:
            return False
        if telemetry.star_id is None or telemetry.ra_rad is None:
            return telemetry.ra_rad is None
        named = telemetry.star_id > 0
        return bool(np.isnan(telemetry.ra_rad[named]).any()) or not named.any()

    def _diagnosis(self, before: Trial, best: Trial, alternatives: list[str]) -> Diagnosis:
        names = [*(["no_time"] if self._wants_time(before) else []), *best.hypothesis.names] or ["none"]
        n = len(self.bench.exposures)
        causes = [FoundCause(name=name, exposures_solved=best.solved, exposures=n) for name in names]
        causes += [
            FoundCause(name=name, exposures_solved=best.solved, exposures=n, alternative=True) for name in alternatives
        ]
        return self._make_diagnosis(before, best, causes, mended=True)

    def _make_diagnosis(self, before: Trial, best: Trial, causes: list[FoundCause], *, mended: bool) -> Diagnosis:
        mapping = best.hypothesis.mapping
        found = Diagnosis(
            sensor=self.bench.sensor.name,
            causes=causes,
            sentence="",
            tried=[
                Tried(what=describe(one.hypothesis), exposures_solved=one.solved, stars=one.stars)
                for one in self.trials
            ],
            exposures=len(self.bench.exposures),
            of_exposures=self.of_exposures,
            exposures_solved_before=0 if self._wants_time(before) else before.solved,
            exposures_solved=best.solved if mended else before.solved,
            log10_chance=best.log10_chance if mended else None,
            cut_short=self.bench.cut_short,
            off_detector=self._off_detector(before),
            sensor_document=sensor_document(best.hypothesis.mend(self.bench.sensor)) if mended else None,
            mapping=mapping.document() if mended and mapping.changes else None,
        )
        return replace(found, sentence=say(found, best, self.bench.sensor))


def _without(hypothesis: Hypothesis, name: str) -> tuple[str, ...]:
    return tuple(one for one in hypothesis.names if one != name)


#: Other orders and senses of a quaternion than the telemetry format's.
CONVENTIONS = [
    Hypothesis(("quaternion_order",), mapping=mapping)
    for mapping in (
        TelemetryMapping(quaternion_sense="detector_to_icrs"),
        TelemetryMapping(quaternion_order="wxyz"),
        TelemetryMapping(quaternion_order="wxyz", quaternion_sense="detector_to_icrs"),
    )
]


def _sides(mapping: TelemetryMapping) -> FloatArray:
    """Which way an origin moves row and column, (2,): the other way where they are counted from the other edge."""
    return np.array([-1.0 if mapping.flipped_rows else 1.0, -1.0 if mapping.flipped_columns else 1.0])


def _moved(sensor: Sensor, best: Trial, origin_px: float) -> FloatArray:
    """The principal point as telemetry of another origin has it, in typical sigmas off the file's, (n_parameters,)."""
    places = list(CAMERA_MODELS[sensor.camera_model].principal_places)
    mu = np.zeros(len(sensor.initial))
    mu[places] = origin_px * _sides(best.hypothesis.mapping) / sensor.typical_sigma[places]
    return mu


def _chi2(trial: Trial) -> float:
    return np.inf if trial.agreement is None else trial.agreement.chi2


def _noise(trial: Trial) -> float:
    return 1.0 if trial.agreement is None else trial.agreement.noise**2


def _apart(one: FloatArray, other: FloatArray) -> FloatArray:
    """Angles (n,) between unit vectors, rad, exact where they are small."""
    return np.asarray(np.linalg.norm(one - other, axis=1))


def _resting(catalogue: Catalogue, index: IntArray, years: float) -> FloatArray:
    """Catalogue places (n, 3) with proper motion for some years from J1991.25, seen by an observer at rest in the barycentre."""
    ra, dec = catalogue.ra_rad[index], catalogue.dec_rad[index]
    east = catalogue.pm_ra_cosdec_rad_yr[index] * years / np.cos(dec)
    return unit_vectors(ra + east, dec + catalogue.pm_dec_rad_yr[index] * years)
