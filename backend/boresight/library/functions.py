"""The functions of the library: what the commands do, on files, tables and arrays, with typed answers.

Each prepares what a door prepares: the settings of the environment, the folder of compiled kernels, which is the same for command,
library, workers and server, the star catalogue, and the threads to compute on.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, TypeVar, Unpack, cast

from boresight.calibration.options import OPTIONS, TEXTS, CalibrationSettings
from boresight.errors import RefusedInputError
from boresight.library.progress import Report, Wanted, reporting
from boresight.settings import Settings, read_settings, use_kernel_folder

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from boresight.arrays import FloatArray
    from boresight.calibration.exports import ExposureAttitude
    from boresight.calibration.telemetry_pieces import TelemetryFile
    from boresight.library.alignment import Alignment
    from boresight.library.choice import Choice
    from boresight.library.diagnosis import Diagnosis
    from boresight.library.inputs import (
        ParameterSource,
        SensorSource,
        TelemetrySource,
        TelemetrySources,
    )
    from boresight.library.keywords import CalibrationKeywords, ChoiceKeywords, EvaluationKeywords
    from boresight.library.pointings import PointingPlan
    from boresight.library.references import ProfileSource, ReferenceSource
    from boresight.library.results import (
        Assessment,
        Calibration,
        CameraFile,
        Evaluation,
        Extraction,
        Matches,
        NewSensor,
        Quality,
        Simulation,
    )
    from boresight.sky.catalogue import Catalogue
    from boresight.telemetry.data_sheets import Known, LensAndDetector
    from boresight.telemetry.imports.mapping import Imported
    from boresight.telemetry.schema import Telemetry
    from boresight.telemetry.sensors import Sensor

BUILT_IN = tuple(f"st16-{number}" for number in range(1, 7))
VALIDATION_DELAY_H = 6
#: Settings of a calibration that choosing a camera, and an evaluation, take.
OF_A_CHOICE, OF_AN_EVALUATION = ("match", "minimum_stars"), ("match", "flight_tolerance_urad")
P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class _Prepared:
    """The settings, catalogue and threads of a function."""

    settings: Settings
    report: Report

    def load_catalogue(self) -> Catalogue:
        from boresight.sky.catalogue import load_catalogue

        self.report("loading the star catalogue", None)
        return load_catalogue(self.settings.catalogue_folder)


def use_kernels() -> None:
    """Point Numba to the folder of compiled kernels, also where the caller has loaded Numba before."""
    use_kernel_folder(read_settings())
    if "numba" in sys.modules and "boresight.kernels" not in sys.modules:
        sys.modules["numba"].config.reload_config()


def _on_kernels(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function so that it sets the folder of kernels before it loads anything that compiles."""

    @functools.wraps(function)
    def called(*arguments: P.args, **named: P.kwargs) -> T:
        use_kernels()
        return function(*arguments, **named)

    return called


@contextmanager
def _prepared(progress: Wanted, message: str) -> Iterator[_Prepared]:
    """Read the settings, and compute on the machine's threads."""
    from boresight.estimation.blocks import computing_on

    settings = read_settings()
    with reporting(progress, message) as report, computing_on(settings.computing_threads):
        yield _Prepared(settings, report)


def parse_choices(choices: Mapping[str, Any]) -> CalibrationSettings:
    """Read the choices of a calibration; names and numbers of a list may be one text with commas."""
    chosen = CalibrationSettings.parse(
        {
            name: _split(name, value) if isinstance(value, str) else value
            for name, value in choices.items()
            if value is not None
        }
    )
    for name in choices:
        option = OPTIONS[name]
        if not option.counts_under(chosen.method) and getattr(chosen, name) != option.default:
            raise RefusedInputError(
                f"Setting {name!r} does not apply to method {chosen.method!r}: omit it, or use one of the methods "
                f"{', '.join(option.methods)}.",
                code="setting-of-another-method",
            )
    return chosen


def _split(name: str, text: str) -> Any:
    kind = OPTIONS[name].kind if name in OPTIONS else "word"
    if kind not in {*TEXTS, "wholes", "stars"}:
        return text
    parts = [part.strip() for part in text.split(",") if part.strip()]
    return [int(part) if part.isdecimal() else part for part in parts] if kind not in TEXTS else parts


def _refuse_others(function: str, settings: Mapping[str, Any], taken: tuple[str, ...]) -> None:
    """Refuse settings of a calibration that a function does not take."""
    for name, value in settings.items():
        if value is not None and name in OPTIONS and name not in taken:
            raise RefusedInputError(
                f"{function} takes no setting {name!r}: omit it, or choose from {', '.join(taken)}.",
                code="unknown-setting",
            )


@_on_kernels
def calibrate(
    telemetry: TelemetrySources,
    sensor: SensorSource,
    *,
    validate: TelemetrySource | None = None,
    prior: ParameterSource | None = None,
    progress: Wanted = None,
    **settings: Unpack[CalibrationKeywords],
) -> Calibration:
    """Estimate a sensor's camera parameters from the stars it saw.

    Parameters
    ----------
    telemetry
        A file (CSV, JSON Lines, Parquet), a DataFrame or Arrow table, a mapping of column names to arrays (n_rows,), or telemetry
        of this library. One row a star: `frame`, `exposure`, `row_px`, `col_px`, and what else the telemetry format names, in the
        units of the names: pixels with (0, 0) at the centre of the top-left pixel, degrees ICRS, quaternions ICRS to detector.
        A list of these is one joint calibration of all.
    sensor
        A sensor file, what one says, or a sensor of this library.
    validate
        Telemetry that takes no part, to check the result by.
    prior
        A former calibration of the sensor, which this one starts from with its covariance; telemetry that it holds counts once.
    progress
        True shows progress, False nothing; a function is called with (message, share). If omitted, progress is shown in terminals
        and notebooks.
    settings
        The choices of a calibration by name, as `method="sqrf", free="f_m,b2_per_m2"`; `help(boresight.calibrate)` lists them.

    Returns
    -------
    The calibration. A numeric failure is its `status` with `advice`, no exception.

    Raises
    ------
    RefusedInputError
        When something cannot be used: one sentence, with row and column where it has them.
    """
    from boresight.library.inputs import list_sources, open_passes, open_telemetry, read_any_sensor, read_prior
    from boresight.library.results import Calibration

    chosen = parse_choices(settings)
    with _prepared(progress, "reading the telemetry") as prepared:
        from boresight.calibration.calibrate import calibrate as estimate

        limits, folder = prepared.settings.telemetry_limits, prepared.settings.catalogue_folder
        stars, described = open_passes(telemetry, limits), read_any_sensor(sensor)
        several = list_sources(telemetry)
        roles = (
            {"telemetry": several[0]}
            if len(several) == 1
            else {f"telemetry_{number}": one for number, one in enumerate(several, 1)}
        )
        validation = None if validate is None else open_telemetry(validate, limits)
        former = None if prior is None else read_prior(prior)
        catalogue = prepared.load_catalogue()
        prepared.report("building arcs and loading the compiled loops", None)
        found = estimate(
            stars,
            described,
            catalogue,
            chosen,
            validation=validation,
            prior=former,
            sha256s=_hash_files({**roles, "sensor": sensor, "validation": validate, "prior": prior}),
            report=None if progress is False else lambda step: prepared.report(step.message, step.fraction),
            cache_folder=folder,
        )
    return Calibration.of(found)


@_on_kernels
def choose(
    telemetry: TelemetrySource,
    sensor: SensorSource,
    *,
    validate: TelemetrySource | None = None,
    progress: Wanted = None,
    **settings: Unpack[ChoiceKeywords],
) -> Choice:
    """Choose the least camera model that suffices for telemetry: every model and its terms, tested on the same stars.

    Parameters as `calibrate`; of its settings `match` and `minimum_stars` count. `validate` is what candidates are held out
    against; if omitted, frames of the telemetry are.
    """
    from boresight.library.choice import Choice
    from boresight.library.inputs import open_telemetry, read_any_sensor

    _refuse_others("choose", settings, OF_A_CHOICE)
    chosen = parse_choices(settings)
    with _prepared(progress, "reading the telemetry") as prepared:
        from boresight.calibration.choice.choose import choose as find

        limits = prepared.settings.telemetry_limits
        stars, described = open_telemetry(telemetry, limits), read_any_sensor(sensor)
        validation = None if validate is None else open_telemetry(validate, limits)
        found = find(
            stars,
            described,
            prepared.load_catalogue(),
            chosen,
            validation=validation,
            report=prepared.report,
            cache_folder=prepared.settings.catalogue_folder,
        )
    return Choice.of(found)


@_on_kernels
def diagnose(telemetry: TelemetrySource, sensor: SensorSource, *, progress: Wanted = None) -> Diagnosis:
    """Find why telemetry does not match its sensor file: what is wrong with either, verified by matching with it mended.

    Arguments as `calibrate`. Up to 40 exposures, spread over the telemetry, are looked at.
    """
    from boresight.library.diagnosis import Diagnosis
    from boresight.library.inputs import open_telemetry, read_any_sensor

    with _prepared(progress, "reading the telemetry") as prepared:
        from boresight.calibration.diagnosis.diagnose import diagnose as find

        stars = open_telemetry(telemetry, prepared.settings.telemetry_limits)
        found = find(
            stars,
            read_any_sensor(sensor),
            prepared.load_catalogue(),
            cache_folder=prepared.settings.catalogue_folder,
            report=prepared.report,
        )
    return Diagnosis.of(found)


@_on_kernels
def match(
    telemetry: TelemetrySource,
    sensor: SensorSource,
    *,
    parameters: ParameterSource | None = None,
    leave_out_doubles: bool = False,
    blends: str = "leave-out",
    flight: bool = False,
    progress: Wanted = None,
) -> Matches:
    """Match the stars of telemetry again.

    Parameters
    ----------
    telemetry, sensor, progress
        As `calibrate`.
    parameters
        A calibration, or parameters by name, to match with; the sensor's own if omitted.
    leave_out_doubles
        Leave out double stars and stars with unreliable astrometry.
    blends
        "leave-out" or "keep" stars whose centroid neighbours draw, where `psf_sigma_px` is known.
    flight
        Keep only what the simulated check of the flight code accepts.
    """
    from boresight.library.inputs import read_any_parameters, read_any_sensor
    from boresight.library.results import Matches, parse_report

    chosen = CalibrationSettings.parse({"match": "rematch", "leave_out_doubles": leave_out_doubles, "blends": blends})
    with _prepared(progress, "reading the telemetry") as prepared:
        from boresight.calibration.corrections import put_right
        from boresight.calibration.matching.match_report import match_report, matched_stars
        from boresight.calibration.matching.matched_frames import apply_flight_check
        from boresight.calibration.matching.rematch import ground_covariance, rematch

        described = read_any_sensor(sensor)
        x, P = (described.initial, None) if parameters is None else read_any_parameters(parameters, described)
        stars, off, catalogue = read_set(telemetry, described, prepared)
        stars = put_right(stars, described, catalogue, x)
        prepared.report("matching the stars", None)
        P = ground_covariance(described, chosen.initial_sigma_scale) if P is None else P
        matches = rematch(stars, described, catalogue, x, P, chosen, prepared.settings.catalogue_folder)
        seen = apply_flight_check(stars, described, matches, x, chosen) if flight else None
        document = match_report(stars, described, matches, seen)
        advice = document["advice"] + off.sentences()
        if 2 * matches.valid.sum() < len(matches.valid):
            from boresight.calibration.diagnosis.explain import explain

            prepared.report("finding out why so few stars match", None)
            folder = prepared.settings.catalogue_folder
            advice = explain(stars, described, catalogue, chosen, folder, prepared.report, advice=advice)
        document |= {"advice": advice, "stars_off_detector": off.document()}
        matched = replace(stars, star_id=matched_stars(matches, seen)[0])
    found: Matches = parse_report(Matches, document, telemetry=matched)
    return found


@_on_kernels
def evaluate(
    telemetry: TelemetrySource,
    sensor: SensorSource,
    parameters: ParameterSource,
    *,
    against: ParameterSource | None = None,
    shadow: bool = False,
    progress: Wanted = None,
    **settings: Unpack[EvaluationKeywords],
) -> Evaluation:
    """Compare two parameter sets on telemetry: availability, matched stars, RMS on common pairs.

    Parameters
    ----------
    telemetry, sensor, progress
        As `calibrate`.
    parameters
        A calibration, or parameters by name: `final`.
    against
        What it is compared with: `initial`; the sensor's own parameters if omitted.
    shadow
        Also list the frames that one of the two would lose.
    settings
        Of those of a calibration, `match` and `flight_tolerance_urad` count.
    """
    from boresight.calibration.calibration import StarsOffDetector, parse_part
    from boresight.library.inputs import read_any_parameters, read_any_sensor
    from boresight.library.results import Evaluation

    _refuse_others("evaluate", settings, OF_AN_EVALUATION)
    chosen = parse_choices(settings)
    with _prepared(progress, "reading the telemetry") as prepared:
        import numpy as np

        from boresight.calibration.corrections import put_right
        from boresight.calibration.evaluation import bootstrap
        from boresight.calibration.evaluation.evaluate import evaluate_matched_frames, shadow_view
        from boresight.calibration.matching.matched_frames import match_under_states

        described = read_any_sensor(sensor)
        states = [
            (described.initial, None) if against is None else read_any_parameters(against, described),
            read_any_parameters(parameters, described),
        ]
        stars, off, catalogue = read_set(telemetry, described, prepared)
        stars = put_right(stars, described, catalogue, states[-1][0])
        prepared.report("matching the stars under both parameter sets", None)
        folder = prepared.settings.catalogue_folder
        initial, final = match_under_states(stars, described, catalogue, states, chosen, folder)
        rng = np.random.default_rng(bootstrap.SEED)
        found = evaluate_matched_frames(stars, described, initial, final, chosen, rng)
        return Evaluation(
            **{item.name: getattr(found, item.name) for item in fields(found)},
            sensor=described.name,
            stars_off_detector=parse_part(StarsOffDetector, off.document(), RefusedInputError),
            advice=off.sentences(),
            shadow=shadow_view(stars, initial, final) if shadow else None,
        )


def extract(  # noqa: PLR0913 - each is a choice of its own
    images: Sequence[str | os.PathLike[str]],
    sensor: SensorSource,
    *,
    threshold: float = 8.0,
    most_stars: int = 200,
    gain_e_per_dn: float | None = None,
    saturation_dn: float | None = None,
    raw: Mapping[str, Any] | None = None,
    times: str | os.PathLike[str] | None = None,
    processes: int | None = None,
    progress: Wanted = None,
) -> Extraction:
    """Extract telemetry from images: FITS, PNG, TIFF or raw numbers, each a frame.

    Parameters
    ----------
    images, sensor, progress
        Paths of the images, and as `calibrate`.
    threshold
        Signal-to-noise ratio of the faintest star, of the filter matched to a star.
    most_stars
        Of an image, the brightest.
    gain_e_per_dn, saturation_dn
        Electrons a DN, and where a pixel is full; else as the sensor or the images say, or estimated.
    raw
        How raw numbers are read: `bits`, `byte_order`, `header_bytes`, instead of the sensor's `image`.
    times
        CSV with the columns `image` and `time_utc`, mid-exposure, instead of what the images say.
    processes
        Number of processes that extract at the same time; one per core if omitted.

    Returns
    -------
    The telemetry, with centroids, `sigma_px`, magnitudes and what else the images say of each star.

    Raises
    ------
    RefusedInputError
        When images cannot be used; names each.
    """
    from boresight.calibration.calibration import to_plain
    from boresight.images import extraction, reading
    from boresight.images.detection import DetectionOptions
    from boresight.images.limits import ImageSource
    from boresight.library.inputs import read_any_sensor
    from boresight.library.results import Extraction

    described = read_any_sensor(sensor)
    settings = read_settings()
    options = DetectionOptions(threshold, most_stars, gain_e_per_dn, saturation_dn)
    with reporting(progress, "reading the images") as report:
        found = extraction.extract(
            [ImageSource(Path(one), Path(one).name) for one in images],
            described,
            options,
            raw=None if raw is None else reading.parse_raw({**described.image.document(), **raw}),
            times=None if times is None else extraction.read_times(Path(times)),
            processes=processes or settings.computing_threads,
            report=report,
            limits=settings.image_limits,
        )
    common = found.common
    document = {
        "schema": "boresight.extraction/1",
        "sensor": described.name,
        "frames": len(found.images),
        "stars": len(found.telemetry),
        "star_sigma_px": common.window.sigma_px,
        "phase_error_px": common.window.phase_error_px,
        "gain_e_per_dn": common.gain_e_per_dn,
        "gain_estimated": common.gain_estimated,
        "saturation_dn": common.saturation_dn,
        "hot_pixels": int(common.hot.sum()),
        "dead_pixels": int(common.dead.sum()),
        "images": [to_plain(one) for one in found.images],
        "sentences": found.sentences,
    }
    return Extraction(telemetry=found.telemetry, images=found.images, sentences=found.sentences, document=document)


@_on_kernels
def new_sensor(
    images: Sequence[str | os.PathLike[str]] | None = None,
    telemetry: TelemetrySource | None = None,
    *,
    extraction: Mapping[str, Any] | None = None,
    progress: Wanted = None,
    **known: Unpack[Known],
) -> NewSensor:
    """Make a whole sensor file of what a data sheet says, or propose one from stars alone.

    Parameters
    ----------
    images, telemetry
        Images of the night sky, or centroids, whose fields are recognised: neither a focal length nor a field of view is needed,
        and names count for nothing. One of them at most.
    extraction
        The choices of `extract` by name, as `{"threshold": 6.0}`.
    progress
        As `calibrate`.
    known
        What is known: `rows`, `columns`, `pixel_pitch_um`, `focal_length_mm` or `field_of_view_deg`, `sheet`, `camera_model`,
        `parity`, `centroid_sigma_px`, `magnitude_limit`, `site`, `name`.

    Returns
    -------
    The sensor file with a reason for each number, and of a proposal what was solved.

    Raises
    ------
    RefusedInputError
        When numbers are missing or make no sense, each told, or no star field is recognised, with what was tried and what to do.
    """
    from boresight.library.inputs import open_telemetry
    from boresight.library.results import NewSensor
    from boresight.telemetry.data_sheets import LensAndDetector
    from boresight.telemetry.declarations import parse_site
    from boresight.telemetry.new_sensor import describe_sensor, join_refusals
    from boresight.telemetry.read.checks import Faults

    faults = Faults("The new sensor")
    place = parse_site(known.get("site"), faults)
    numbers: dict[str, Any] = {name: value for name, value in known.items() if name != "site"}
    lens = LensAndDetector(**numbers, site=place)
    if images is not None and telemetry is not None:
        raise RefusedInputError("A sensor is proposed from images or from telemetry: give one of them.")
    if images is None and telemetry is None:
        try:
            described = describe_sensor(lens)
        except RefusedInputError as refusal:
            raise join_refusals(faults, refusal) from refusal
        faults.refuse()
        return NewSensor.of(described)
    faults.refuse()
    with _prepared(progress, "reading the images" if telemetry is None else "reading the telemetry") as prepared:
        from boresight.calibration.proposal import propose

        sentences: list[str] = []
        stars: Telemetry | TelemetryFile
        if telemetry is None:
            stars, lens, sentences = _extract_for(images or (), lens, extraction or {}, prepared)
        else:
            stars = open_telemetry(telemetry, prepared.settings.telemetry_limits)
        found = propose(
            stars,
            prepared.load_catalogue(),
            lens,
            of_images=telemetry is None,
            cache_folder=prepared.settings.catalogue_folder,
            report=prepared.report,
        )
    return NewSensor.of(found.described, found, sentences)


def _extract_for(
    images: Sequence[str | os.PathLike[str]], lens: LensAndDetector, choices: Mapping[str, Any], prepared: _Prepared
) -> tuple[Telemetry, LensAndDetector, list[str]]:
    """Extract images of which no sensor file says anything: their telemetry, the camera with their size, what was assumed."""
    from boresight.images import extraction, reading
    from boresight.images.limits import ImageSource

    sources = [ImageSource(Path(one), Path(one).name) for one in images]
    raw = None if choices.get("raw") is None else reading.parse_raw(choices["raw"])
    sized = extraction.sensor_of_images(sources, lens, raw, prepared.settings.image_limits)
    found = extract(images, sized, progress=prepared.report, **choices)
    return found.telemetry, replace(lens, rows=sized.rows, columns=sized.columns), found.sentences


@_on_kernels
def draw_images(
    images: Sequence[str | os.PathLike[str]],
    sensor: SensorSource,
    found: Extraction | Matches,
    folder: Path,
    *,
    parameters: ParameterSource | None = None,
    raw: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Draw each image with its stars over it, and of matches with residuals under the parameters, as SVG; returns the files."""
    import numpy as np

    from boresight.images import picture, reading
    from boresight.library.inputs import read_any_parameters, read_any_sensor
    from boresight.library.results import Extraction

    described, telemetry = read_any_sensor(sensor), found.telemetry
    x = described.initial if parameters is None else read_any_parameters(parameters, described)[0]
    away = None if isinstance(found, Extraction) else _find_residuals(found, described, x)
    named = np.array(telemetry.unknown["image"].to_pylist())
    saturated = np.array(telemetry.unknown["saturated"].to_pylist()) == "1"
    form = None if raw is None else reading.parse_raw({**described.image.document(), **raw})
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for path in map(Path, images):
        rows = np.flatnonzero(named == path.name)
        stars = picture.StarsOfImage(
            telemetry.row_px[rows],
            telemetry.col_px[rows],
            saturated[rows],
            None if away is None or telemetry.star_id is None else telemetry.star_id[rows],
            None if away is None else away[rows, 0],
            None if away is None else away[rows, 1],
        )
        written.append(folder / f"{path.name}.svg")
        image = reading.read_image(path, described, form, limits=read_settings().image_limits)
        written[-1].write_text(picture.draw_svg(image.dn, stars, path.name), encoding="utf-8")
    return written


def _find_residuals(found: Matches, sensor: Sensor, x: FloatArray) -> FloatArray:
    """Centroids less predicted places (n, 2), rows and columns, under each exposure's attitude; NaN where unmatched."""
    import numpy as np

    from boresight.cameras import CAMERA_MODELS
    from boresight.estimation.attitude import to_matrix
    from boresight.sky.catalogue import load_catalogue
    from boresight.sky.ground import observed_directions

    telemetry = found.telemetry
    away = np.full((len(telemetry), 2), np.nan)
    catalogue = load_catalogue(read_settings().catalogue_folder)
    if telemetry.star_id is None:
        return away
    for exposure in found.document["exposures"]:
        of_frame = (telemetry.frame == exposure["frame"]) & (telemetry.star_id > 0)
        rows = np.flatnonzero(of_frame)
        if exposure["quaternion"] is None or not len(rows):
            continue
        star = catalogue.find_index(telemetry.star_id[rows])
        time = np.datetime64("1991-04-02", "us") if telemetry.time_utc is None else telemetry.time_utc[rows[0]]
        s_i = observed_directions(catalogue, star, np.repeat(time, len(rows)), None, telemetry.site)
        s_d = s_i @ to_matrix(np.array(exposure["quaternion"])).T
        s_d[:, 1] *= sensor.parity
        row, col = CAMERA_MODELS[sensor.camera_model].project(x, s_d, sensor.pixel_pitch_m)
        away[rows] = np.column_stack([telemetry.row_px[rows] - row, telemetry.col_px[rows] - col])
    return away


@_on_kernels
def check(telemetry: TelemetrySource, sensor: SensorSource, *, progress: Wanted = None) -> Quality:
    """Report on the quality of telemetry: counts, gaps, coverage, magnitudes, matches. Arguments as `calibrate`."""
    from boresight.library.inputs import iterate_telemetry, read_any_sensor
    from boresight.library.results import Finding, Quality, parse_report
    from boresight.telemetry.quality.report import QualityParts

    settings = read_settings()
    with reporting(progress, "reading the telemetry") as report:
        from boresight.telemetry.readers import read_chunks

        prepared = _Prepared(settings, report)
        described, catalogue = read_any_sensor(sensor), prepared.load_catalogue()
        parts = QualityParts(described, catalogue)
        for part in iterate_telemetry(telemetry, settings.telemetry_limits, read_chunks):
            parts.add(part)
            report(f"reading the telemetry, up to frame {part.frame[-1]}", None)
        document = _diagnosed(parts.report(), telemetry, described, catalogue, prepared)
    found: Quality = parse_report(Quality, document)
    return replace(found, findings=[Finding(**one) for one in document["findings"]])


def _diagnosed(
    document: dict[str, Any], telemetry: TelemetrySource, sensor: Sensor, catalogue: Catalogue, prepared: _Prepared
) -> dict[str, Any]:
    """Return a quality report with a diagnosis, where what the set names does not match its sensor file by itself."""
    from boresight.calibration.diagnosis.diagnose import diagnose as find
    from boresight.calibration.diagnosis.diagnose import match_as_they_stand
    from boresight.calibration.diagnosis.explain import add_to_report
    from boresight.library.inputs import open_telemetry

    stars = open_telemetry(telemetry, prepared.settings.telemetry_limits)
    prepared.report("matching a sample of the stars", None)
    if document["usable_exposures"] and match_as_they_stand(stars, sensor, catalogue):
        return document
    found = find(stars, sensor, catalogue, cache_folder=prepared.settings.catalogue_folder, report=prepared.report)
    return add_to_report(document, found)


@_on_kernels
def assess(
    calibration: ParameterSource,
    sensor: SensorSource,
    *,
    validate: TelemetrySource | None = None,
    against: ParameterSource | None = None,
    profile: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    progress: Wanted = None,
) -> Assessment:
    """Hold a calibration against limits and against the baseline.

    Parameters
    ----------
    calibration
        A calibration of this library, its JSON or the file of it.
    sensor, progress
        As `calibrate`.
    validate
        Held-out telemetry; the calibration's own validation if omitted.
    against
        The baseline's parameters; the sensor's if omitted.
    profile
        Gate profile, as a file or its content; the default limits if omitted.
    """
    from boresight.calibration.calibration import to_plain
    from boresight.calibration.parameter_file import read_document
    from boresight.library.inputs import as_path, read_any_calibration, read_any_sensor, read_parameter_document
    from boresight.library.results import Assessment

    with _prepared(progress, "reading the calibration") as prepared:
        from boresight.verdicts.gates import parse_profile
        from boresight.verdicts.gates.assessed_set import ground_set, read_incumbent
        from boresight.verdicts.gates.assessment import assess

        described = read_any_sensor(sensor)
        limits = parse_profile(
            {}
            if profile is None
            else profile
            if isinstance(profile, Mapping)
            else read_document(as_path(profile, "a gate profile, as file or mapping"), "a gate profile")
        )
        candidate = read_any_calibration(calibration)
        incumbent = (
            ground_set(described) if against is None else read_incumbent(read_parameter_document(against), described)
        )
        frames = None
        if validate is not None:
            stars, _, catalogue = read_set(validate, described, prepared)
            frames = stars, catalogue
        prepared.report("measuring and judging", None)
        report = assess(candidate, described, incumbent, limits, frames)
    return Assessment(
        sensor=described.name,
        verdict=report.verdict,
        words=report.words,
        blocking=report.blocking,
        gates=report.gates,
        document={**to_plain(report), "sensor": described.name},
    )


@_on_kernels
def align(  # noqa: PLR0913 - two sides, each with its own
    a: TelemetrySource,
    b: TelemetrySource | None = None,
    *,
    sensor_a: SensorSource,
    sensor_b: SensorSource | None = None,
    parameters_a: ParameterSource | None = None,
    parameters_b: ParameterSource | None = None,
    reference: ReferenceSource | None = None,
    reference_profile: ProfileSource | None = None,
    reference_sigma_arcsec: float | None = None,
    reference_bias_arcsec: float = 0.0,
    profile: Mapping[str, Any] | None = None,
    progress: Wanted = None,
    **options: Any,
) -> Alignment:
    """Estimate the constant rotation from tracker A to tracker B, or to a reference, from what both saw at the same times.

    Parameters
    ----------
    a, b
        Telemetry of the two trackers, as `calibrate`; `b` is omitted if there is a reference.
    sensor_a, sensor_b
        Their sensors.
    parameters_a, parameters_b
        Their calibrations, with covariance; if omitted, the sensor's own parameters at their typical spread.
    reference
        Attitudes of a gyro, payload or body in place of `b`, ICRS to it: an AEM, a table with `time_utc`, `q_x`, `q_y`, `q_z`,
        `q_w` and perhaps `sigma_arcsec` (or one an axis, `sigma_x_arcsec` and so on) and `temperature_c`, or telemetry, whose
        quaternions are taken. The rotation is then C_SD, S being the reference's frame.
    reference_profile
        Mapping profile that names other columns and conventions of time and quaternion.
    reference_sigma_arcsec, reference_bias_arcsec
        One sigma of each attitude where the table does not say it, 10 where nobody does, and of an error that all of them share.
    profile
        Limits of the gates, by name, instead of the default ones.
    progress
        As `calibrate`.
    options
        `tolerance_s`, `longest_gap_s`, `rate_deg_s`, `temperature_of`, `reference_temperature_c`, `temperature`, `drift`,
        `robust`, as `boresight align --help` tells them.

    Raises
    ------
    RefusedInputError
        When no attitudes are at the same time, or one side has none.
    """
    from boresight.calibration.alignment.align import AlignmentOptions, align_sides
    from boresight.library.alignment import Alignment
    from boresight.library.inputs import read_any_sensor, read_camera_parameters
    from boresight.library.references import read_any_reference
    from boresight.verdicts.gates.alignment import judge_alignment, parse_alignment_profile

    if unknown := set(options) - {one.name for one in fields(AlignmentOptions)}:
        raise RefusedInputError(f"An alignment has no {min(unknown)!r}: choose an option that `help(align)` lists.")
    if (b is None) == (reference is None):
        raise RefusedInputError("Two frames are aligned: give the telemetry of B, or a reference, and not both.")
    if b is not None and sensor_b is None:
        raise RefusedInputError("The sensor of B is missing: give `sensor_b` (--sensor-b).")
    chosen, limits = AlignmentOptions(**options), parse_alignment_profile(profile)
    with _prepared(progress, "reading the telemetry") as prepared:
        from boresight.calibration.alignment.sides import make_camera, tracker_side

        def tracker(telemetry: TelemetrySource, source: SensorSource, known: ParameterSource | None) -> Any:
            described = read_any_sensor(source)
            camera = make_camera(described, None if known is None else read_camera_parameters(known, described))
            stars, _, catalogue = read_set(telemetry, described, prepared)
            prepared.report(f"matching the stars of {described.name}", None)
            settings = CalibrationSettings(match="rematch")
            return tracker_side(stars, described, camera, catalogue, settings, prepared.settings.catalogue_folder)

        side_a = tracker(a, sensor_a, parameters_a)
        side_b = (
            read_any_reference(
                cast("Any", reference), reference_profile, reference_sigma_arcsec, reference_bias_arcsec,
                prepared.settings.telemetry_limits,
            )
            if b is None
            else tracker(b, cast("Any", sensor_b), parameters_b)
        )  # fmt: skip
        prepared.report("aligning", None)
        found = align_sides(side_a, side_b, chosen)
    return Alignment.of(found, judge_alignment(found, limits))


@_on_kernels
def plan(
    sensor: SensorSource,
    start: str,
    minutes: float,
    *,
    calibration: ParameterSource | None = None,
    candidates: str | os.PathLike[str] | None = None,
    criterion: str = "A",
    orbit: Mapping[str, float] | None = None,
    progress: Wanted = None,
    **constraints: float,
) -> PointingPlan:
    """Plan the next observations: pointings and rolls that reduce the largest uncertainties most per minute.

    Parameters
    ----------
    sensor
        As `calibrate`.
    start, minutes
        When it begins, UTC in ISO 8601, and how long it may take.
    calibration
        The prior knowledge; if omitted, ten typical sigmas of each free parameter of the sensor file, at a lens that has one
        typical sigma of the distortion, tilt and decentring that the file has none of.
    candidates
        CSV of attitudes that may be chosen: ra_deg, dec_deg, roll_deg; if omitted, pointings over the whole sky.
    criterion
        `A`, the sum of variances in typical sigmas, or `D`, the volume of the confidence region.
    orbit
        `altitude_km`, `inclination_deg` and `node_hour` of a circular orbit around the Earth; the Earth is not considered if
        omitted.
    progress
        As `calibrate`.
    constraints
        `dwell_s`, `exposure_s`, `slew_deg_s`, `settle_s`, `sun_deg`, `moon_deg`, `earth_deg`, `visits`, as
        `boresight plan --help` tells them.

    Raises
    ------
    RefusedInputError
        When nothing can be observed under these constraints, or one of them makes no sense.
    """
    from boresight.library import pointings
    from boresight.library.inputs import read_any_calibration, read_any_sensor
    from boresight.simulation.plans import make_plan
    from boresight.simulation.pointings import Constraints
    from boresight.simulation.scenes import parse_orbit, parse_start

    described = read_any_sensor(sensor)
    known = None if calibration is None else read_any_calibration(calibration)
    if unknown := set(constraints) - {one.name for one in fields(Constraints)}:
        raise RefusedInputError(f"A plan has no {min(unknown)!r}: choose a constraint that `help(plan)` lists.")
    begins = parse_start(start)
    circle = None if orbit is None else parse_orbit(orbit, begins)
    wanted = Constraints(start_utc=begins, minutes=minutes, orbit=circle, **cast("Any", constraints))
    listed = None if candidates is None else pointings.read_candidates(Path(candidates))
    with _prepared(progress, "planning") as prepared:
        found = make_plan(described, known, listed, wanted, criterion, prepared.load_catalogue())
    return pointings.PointingPlan.of(found)


@_on_kernels
def simulate(
    scenario: str | os.PathLike[str] | Mapping[str, Any] = "st16-1",
    *,
    frames: int | None = None,
    seed: int | None = None,
    progress: Wanted = None,
) -> Simulation:
    """Simulate telemetry whose truth is known.

    Parameters
    ----------
    scenario
        `st16-1` to `st16-6`, a scenario file, or what one says: at least its `sensor`.
    frames
        Frames of the calibration set, instead of the scenario's.
    seed
        Seed of the noise, instead of the scenario's.
    progress
        As `calibrate`.
    """
    import numpy as np

    from boresight.calibration.calibration import Values
    from boresight.library.results import Simulation
    from boresight.simulation import scenes

    calibration, validation = make_scenarios(scenario, frames, seed)
    with reporting(progress, "simulating") as report:
        catalogue = _Prepared(read_settings(), report).load_catalogue()
        sets = []
        for purpose, one in (("calibration", calibration), ("validation", validation)):
            report(f"simulating the {purpose} set, {one.frames:,} frames", None)
            sets.append(scenes.simulate(one, np.random.default_rng(one.seed), catalogue))
    document = scenes.scenario_document(calibration)
    return Simulation(
        sensor=calibration.sensor,
        telemetry=sets[0],
        validation=sets[1],
        truth=Values(document["truth"]),
        scenario=document,
    )


@_on_kernels
def simulate_images(
    scenario: str | os.PathLike[str] | Mapping[str, Any], frames: int, folder: str | os.PathLike[str]
) -> list[Path]:
    """Write FITS images of the first frames of a scenario, seen from orbit, into a folder; returns the files.

    Parameters
    ----------
    scenario
        As `simulate`.
    frames
        How many; each is one image.
    folder
        Where they are written; it is made.
    """
    import numpy as np

    from boresight.library.inputs import as_path
    from boresight.simulation import images
    from boresight.sky.catalogue import load_catalogue

    place = as_path(folder, "the path of a folder")
    one, _ = make_scenarios(scenario, frames, None)
    optics = images.Optics()
    made = images.simulate_images(
        one, optics, np.random.default_rng(one.seed), load_catalogue(read_settings().catalogue_folder)
    )
    return images.write_images(place, made, optics)


def make_scenarios(
    scenario: str | os.PathLike[str] | Mapping[str, Any], frames: int | None, seed: int | None
) -> tuple[Any, Any]:
    """Return the scenario of a calibration set, and that of the validation set that goes with it."""
    import numpy as np

    from boresight.library.inputs import SCENARIO_FORMS, as_path
    from boresight.simulation.scenes import calibration_scenario, parse_scenario, parse_whole, validation_scenario

    if isinstance(scenario, str) and scenario in BUILT_IN:
        number = BUILT_IN.index(scenario) + 1
        first, second = calibration_scenario(number), validation_scenario(number)
    else:
        first = parse_scenario(
            scenario if isinstance(scenario, Mapping) else _read_scenario(as_path(scenario, SCENARIO_FORMS))
        )
        start = first.orbit.start_utc + np.timedelta64(VALIDATION_DELAY_H, "h")
        second = replace(first, orbit=replace(first.orbit, start_utc=start), seed=first.seed + 1)
    if frames is not None:
        first = replace(first, frames=parse_whole("frames", frames))
    if seed is not None:
        begins = parse_whole("seed", seed)
        first, second = replace(first, seed=begins), replace(second, seed=begins + 1)
    return first, second


def _read_scenario(path: Path) -> Any:
    import orjson

    try:
        return orjson.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise RefusedInputError(
            f"{path} is neither a file nor a built-in scenario: choose from {', '.join(BUILT_IN)}."
        ) from error
    except orjson.JSONDecodeError as error:
        raise RefusedInputError(f"{path} is not JSON ({error}): give a scenario as one JSON object.") from error
    except OSError as error:
        raise RefusedInputError(
            f"{path} cannot be read ({error.strerror}): check the name and its permissions."
        ) from error


@_on_kernels
def export_camera(
    parameters: ParameterSource,
    sensor: SensorSource,
    to: str,
    *,
    telemetry: TelemetrySource | None = None,
    allow_px: float | None = None,
    residual: bool = False,
    suffix: str | None = None,
    progress: Wanted = None,
) -> CameraFile:
    """Write a camera as a file of another program, with the largest misfit over the detector.

    Parameters
    ----------
    parameters, sensor
        As `evaluate`.
    to
        The format: `opencv`, `ros`, `mrcal`, `colmap`, `tetra3`, `cedar`, `giant-brown`, `giant-owen`, `fits-sip` or `fits-tpv`.
    telemetry
        What a format with something for each exposure takes the attitudes from, by matching its stars again.
    allow_px
        Maximum misfit; the format's share of the sensor's `centroid_sigma_px` if omitted.
    residual
        Follow the residual spline of the calibration too.
    suffix
        Ending of the file's name, for formats of several spellings.

    Raises
    ------
    RefusedInputError
        When the format cannot follow the camera within the misfit allowed, or lacks what it needs.
    """
    from boresight.calibration.exports import Source, export_document, find_format
    from boresight.library.inputs import describe_source, read_any_sensor, read_parameter_document
    from boresight.library.results import CameraFile

    form, described = find_format(to), read_any_sensor(sensor)
    document = read_parameter_document(parameters)
    source = Source(describe_source(parameters), _hash_parameters(parameters, document), described)

    def attitudes(x: FloatArray, P: FloatArray | None) -> Sequence[ExposureAttitude]:
        return () if telemetry is None else _find_attitudes(telemetry, described, x, P, progress)

    content, told = export_document(
        form, document, source, residual=residual, allowed_px=allow_px, suffix=suffix, exposures=attitudes
    )
    return CameraFile(content=content, document=told, misfit_px=told["misfit_px"]["max"])


def _hash_parameters(source: ParameterSource, document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a file of parameters, as `sha256sum` says it, else of the document's canonical JSON."""
    import orjson

    if isinstance(source, str | os.PathLike):
        return _hash_files({"parameters": source})["parameters"]
    return hashlib.sha256(orjson.dumps(document, option=orjson.OPT_SORT_KEYS)).hexdigest()


def _find_attitudes(
    telemetry: TelemetrySource, sensor: Sensor, x: FloatArray, P: FloatArray | None, progress: Wanted
) -> Sequence[ExposureAttitude]:
    """Match telemetry under parameters and list the attitudes of its exposures."""
    with _prepared(progress, "reading the telemetry") as prepared:
        from boresight.calibration.corrections import put_right
        from boresight.calibration.exports.attitudes import list_attitudes
        from boresight.calibration.matching.rematch import ground_covariance, rematch

        chosen = CalibrationSettings(match="rematch")
        stars, _, catalogue = read_set(telemetry, sensor, prepared)
        stars = put_right(stars, sensor, catalogue, x)
        prepared.report("matching the stars", None)
        P = ground_covariance(sensor, chosen.initial_sigma_scale) if P is None else P
        return list_attitudes(
            stars, rematch(stars, sensor, catalogue, x, P, chosen, prepared.settings.catalogue_folder)
        )


@_on_kernels
def load(source: str | os.PathLike[str] | Mapping[str, Any]) -> Calibration:
    """Read a calibration that was saved, by `Calibration.save`, `boresight calibrate --json` or a server."""
    from boresight.library.inputs import read_any_calibration
    from boresight.library.results import Calibration

    return Calibration.of(read_any_calibration(source))


@_on_kernels
def draw(
    source: ParameterSource | Mapping[str, ParameterSource],
    name: str,
    *,
    theme: Literal["light", "dark", "contrast"] = "light",
) -> go.Figure:
    """Draw a figure of a calibration, or of several over one another: {label: calibration}.

    Parameters
    ----------
    source
        A calibration, its JSON or the file of it; or several by label.
    name
        One of `Calibration.figures`.
    theme
        `light` is white paper, `dark` and `contrast` are the console's.
    """
    from boresight.figures.notebook import draw as draw_figure
    from boresight.library.inputs import read_any_calibration

    if isinstance(source, Mapping) and "schema" not in source:
        return draw_figure({label: read_any_calibration(one) for label, one in source.items()}, name, theme=theme)
    return draw_figure(read_any_calibration(source), name, theme=theme)


@_on_kernels
def read_telemetry(source: TelemetrySource) -> Telemetry:
    """Read telemetry into arrays, SI, held against the rules of the format. `source` as `calibrate` takes it."""
    from boresight.library.inputs import read_in_memory
    from boresight.telemetry import readers

    limits = read_settings().telemetry_limits
    if isinstance(source, str | os.PathLike):
        return readers.read_telemetry(Path(source), limits=limits)
    return read_in_memory(source, limits)


@_on_kernels
def import_telemetry(
    files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    profile: ProfileSource,
    *,
    sensor: SensorSource | None = None,
    orbit: str | os.PathLike[str] | None = None,
    attitude: str | os.PathLike[str] | None = None,
    time: str | None = None,
) -> Imported:
    """Make telemetry of what another program wrote, by a mapping profile.

    Parameters
    ----------
    files
        One file or several of one sensor in the order of time: CSV, JSON Lines, Parquet, FITS, VOTable, text tables, JSON.
    profile
        The name of a built-in profile, a profile's file, or what one says.
    sensor
        For lengths, and for pixels that are counted from the detector's middle.
    orbit
        Two-line elements or an OEM, where the files have no velocity.
    attitude
        An AEM, or a table of quaternions that the profile names, where the files have no attitude.
    time
        ISO 8601: when the files were taken, where they do not say it.

    Returns
    -------
    The telemetry with the record of how it was made; every function that takes telemetry takes it.

    Raises
    ------
    RefusedInputError
        When a file does not fit the profile: one sentence, with row and column of that file.
    """
    from boresight.library.inputs import read_any_sensor
    from boresight.library.references import read_any_profile
    from boresight.telemetry.imports.mapping import SourceFile, import_files

    def named(path: str | os.PathLike[str]) -> SourceFile:
        return SourceFile(Path(path), Path(path).name)

    paths = [files] if isinstance(files, str | os.PathLike) else list(files)
    return import_files(
        [named(path) for path in paths],
        read_any_profile(profile),
        sensor=None if sensor is None else read_any_sensor(sensor),
        orbit=None if orbit is None else named(orbit),
        attitude=None if attitude is None else named(attitude),
        time=time,
        limits=read_settings().telemetry_limits,
    )


@_on_kernels
def read_sensor(source: SensorSource) -> Sensor:
    """Read a sensor: a file, or what one says."""
    from boresight.library.inputs import read_any_sensor

    return read_any_sensor(source)


def read_set(telemetry: TelemetrySource, sensor: Sensor, prepared: _Prepared) -> tuple[Telemetry, Any, Catalogue]:
    """Read a telemetry set, its detections outside the detector, and the catalogue for its directions."""
    from boresight.telemetry.quality.detector import OffDetectorError, check_against_sensor

    stars, catalogue = read_telemetry(telemetry), prepared.load_catalogue()
    try:
        return stars, check_against_sensor(stars, sensor), catalogue
    except OffDetectorError as error:
        from boresight.calibration.diagnosis.explain import explain_refusal

        raise explain_refusal(error, stars, sensor, catalogue, prepared.settings.catalogue_folder) from error


def _hash_files(sources: Mapping[str, Any]) -> dict[str, str]:
    """Return the content addresses of those inputs that are files."""
    addresses = {}
    for role, source in sources.items():
        if isinstance(source, str | os.PathLike):
            with Path(source).open("rb") as file:
                addresses[role] = hashlib.file_digest(file, "sha256").hexdigest()
        elif (record := getattr(source, "record", None)) is not None:  # what was imported: the files that it came from
            told = record()
            addresses[role], addresses[f"{role}_profile"] = told["sources"][0]["sha256"], told["profile"]["sha256"]
    return addresses


def _with_settings(function: Callable[..., Any], names: tuple[str, ...]) -> None:
    """Show the settings of a calibration in a function's signature and help, where they are declared once."""
    signature = inspect.signature(function)
    shown = [parameter for parameter in signature.parameters.values() if parameter.kind is not parameter.VAR_KEYWORD]
    keyword = inspect.Parameter.KEYWORD_ONLY
    shown += [inspect.Parameter(name, keyword, default=OPTIONS[name].default) for name in names]
    function.__signature__ = signature.replace(parameters=shown)  # type: ignore[attr-defined]  # what `help` looks at
    lines = "\n".join(f"    {name}\n        {OPTIONS[name].sentence} {OPTIONS[name].range}." for name in names)
    function.__doc__ = f"{inspect.cleandoc(function.__doc__ or '')}\n\nSettings\n--------\n{inspect.cleandoc(lines)}\n"


_with_settings(calibrate, tuple(OPTIONS))
_with_settings(choose, OF_A_CHOICE)
_with_settings(evaluate, OF_AN_EVALUATION)
