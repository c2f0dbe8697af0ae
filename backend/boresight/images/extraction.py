"""From a set of images to telemetry: what all have in common is learned from some, then each is extracted by itself.

Each image is a frame of one exposure; frames are numbered from 0 in the order of time where every image has one, else in the
order in which they were given. The rows carry beside the contract's columns what the image says of each star: flux and its
sigma, peak, background, whether it is saturated, the covariance of its centroid, the image's name and the SHA-256 of its bytes.
`psf_sigma_px` is the width of the set's window: matching leaves out stars whose neighbours in the catalogue blend with them.

The magnitude is the instrument's: -2.5 log10(flux) plus one number for the whole set, such that its faintest stars have the
sensor's magnitude limit. It orders stars by brightness and finds false matches; it is no photometry.
"""

from __future__ import annotations

import csv
import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import pyarrow as pa

from boresight.arrays import FloatArray, IntArray
from boresight.errors import Fault, RefusedInputError
from boresight.images.detection import LOOKED_AT, REASONS, Common, DetectionOptions, Detections, Look, detect, learn
from boresight.images.limits import LIMITS, ImageLimits, ImageSource
from boresight.images.reading import Image, read_image, read_size
from boresight.telemetry.data_sheets import LensAndDetector
from boresight.telemetry.declarations import ImageFormat
from boresight.telemetry.new_sensor import complete, describe_sensor
from boresight.telemetry.schema import IMAGE_COLUMNS, Telemetry
from boresight.telemetry.sensors import Sensor

T = TypeVar("T")
#: Told (message, share of the work that is done).
Report = Callable[[str, float | None], None]
#: Share of the stars that are fainter than the magnitude limit is taken to be.
FAINTEST_SHARE = 0.05
DEFAULT_LIMIT = 6.0
MOST_FAULTS = 20
NO_TIME = np.datetime64("NaT", "us")
MOST_TIMES_BYTES = 10_000_000
#: Stars of an image from which on it can be recognised.
FEWEST_STARS = 4


@dataclass(frozen=True)
class ExtractedImage:
    """What became of one image: its frame, stars, what was left out by reason, and the pixels under trails."""

    name: str
    sha256: str
    frame: int
    time_utc: str | None
    time_source: str
    stars: int
    saturated: int
    left_out: dict[str, int]
    trail_pixels: int


@dataclass(frozen=True)
class Extraction:
    """The telemetry of a set of images, and how it came about.

    `images`: by frame. `sentences`: what was found and what was assumed.
    """

    telemetry: Telemetry
    images: list[ExtractedImage]
    common: Common
    sentences: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _Read:
    """How every image of a set is read."""

    sensor: Sensor
    raw: ImageFormat
    times: Mapping[str, np.datetime64] | None
    limits: ImageLimits

    def __call__(self, source: ImageSource) -> Image:
        return read_image(source.path, self.sensor, self.raw, name=source.name, times=self.times, limits=self.limits)


def extract(
    sources: Sequence[ImageSource],
    sensor: Sensor,
    options: DetectionOptions,
    *,
    raw: ImageFormat | None = None,
    times: Mapping[str, np.datetime64] | None = None,
    processes: int = 1,
    report: Report | None = None,
    limits: ImageLimits = LIMITS,
) -> Extraction:
    """Extract the stars of images.

    Parameters
    ----------
    sources
        The images, all of one sensor.
    sensor
        Says their size, and what their files do not say.
    options
        How stars are looked for.
    raw
        How numbers without a header are read, instead of what the sensor says.
    times
        Mid-exposure by file name.
    processes
        That extract at the same time.

    Raises
    ------
    RefusedInputError
        When an image cannot be used, each named, or when there is no star on any of them.
    """
    _refuse_set(sources, times, limits)
    say = report or (lambda _message, _share: None)
    read = _Read(sensor, raw or sensor.image, times, limits)
    white_dn, gain = options.saturation_dn or read.raw.saturation_dn, options.gain_e_per_dn or read.raw.gain_e_per_dn
    say("looking at images", 0.0)
    looks: list[Look] = []
    for image in _read_some(sources, read):
        white_dn, gain = white_dn or image.white_dn, gain or image.gain_e_per_dn
        looks.append(Look(image.dn))
    chosen = DetectionOptions(options.threshold, options.most_stars, gain, white_dn)
    common = learn(looks, chosen, white_dn)
    del looks, image
    found = _extract_all(sources, partial(_extract_one, read=read, common=common, options=chosen), processes, say)
    return assemble(found, sensor, common)


def sensor_of_images(
    sources: Sequence[ImageSource],
    known: LensAndDetector,
    raw: ImageFormat | None = None,
    limits: ImageLimits = LIMITS,
    subject: str = "The new sensor",
) -> Sensor:
    """Describe a sensor as large as its images, of which nothing else need be known, so that they can be extracted.

    Raises RefusedInputError when the first image cannot be read, or is raw numbers and nobody says how many rows and columns.
    """
    _refuse_set(sources, None, limits)
    whole = complete(known, subject)
    if whole.rows is None or whole.columns is None:
        size = read_size(sources[0].path, sources[0].name, limits)
        if size is None:
            raise RefusedInputError(f"{sources[0].name} contains raw numbers without a shape: give rows and columns.")
        whole = replace(whole, rows=size[0], columns=size[1])
    lens = replace(
        whole,
        sheet=None,
        name=f"{sources[0].name} or as given",
        parity=None,
        pixel_pitch_um=1.0,
        focal_length_mm=None,
        field_of_view_deg=20.0,
    )
    found = describe_sensor(lens, subject).sensor
    return found if raw is None else replace(found, image=raw)


def extract_apart(
    sources: Sequence[ImageSource], sensor: Sensor, options: DetectionOptions, *, seconds: float, limits: ImageLimits
) -> Extraction:
    """Extract as `extract` does, in a process of its own that ends when the time is over: a server goes on answering meanwhile."""
    work = partial(extract, sources, sensor, options, limits=limits)
    return run_apart(work, seconds, f"The extraction of {len(sources):,} images {{}}: send fewer images at once.")


def run_apart(work: Callable[[], T], seconds: float, refusal: str) -> T:
    """Run what can be pickled in a process of its own; `refusal` has a place for what became of it when the time is over."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        running = pool.submit(work)
        try:
            return running.result(seconds)
        except (TimeoutError, BrokenProcessPool) as error:
            for process in list(pool._processes.values()):  # noqa: SLF001 - a pool has no way to end what computes
                process.kill()
            late = isinstance(error, TimeoutError)
            said = f"took longer than {seconds:g} s" if late else "needed more memory than is available"
            raise RefusedInputError(refusal.format(said)) from error


def _refuse_set(sources: Sequence[ImageSource], times: Mapping[str, np.datetime64] | None, limits: ImageLimits) -> None:
    """Refuse too few or too many images, and two of one name."""
    if not sources:
        raise RefusedInputError("No image was given: name FITS, PNG, TIFF or raw files.")
    if len(sources) > limits.images:
        raise RefusedInputError(
            f"{len(sources):,} images were given, at most {limits.images:,} are accepted at once: split the set."
        )
    names = [source.name for source in sources]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise RefusedInputError(f"Two images are called {twice}: name each once, or give them different names.")
    if times is not None and (absent := [name for name in names if name not in times]):
        others = f" and {len(absent) - 1:,} others" if len(absent) > 1 else ""
        raise RefusedInputError(
            f"The list of times lacks {absent[0]}{others}: add a row for each image.",
            code="times-missing",
        )


def _read_some(sources: Sequence[ImageSource], read: _Read) -> Iterator[Image]:
    """Read images that stand for all, one after the other, as evenly as their number allows, within a budget of pixels."""
    most = max(1, min(LOOKED_AT, read.limits.pixels // (read.sensor.rows * read.sensor.columns)))
    places = np.unique(np.linspace(0, len(sources) - 1, min(len(sources), most)).round().astype(int))
    return (read(sources[place]) for place in places)


@dataclass(frozen=True)
class FoundStars:
    """The stars of one image."""

    place: int
    name: str
    sha256: str
    time_utc: np.datetime64
    time_source: str
    stars: Detections
    temperature_c: float | None = None
    notes: tuple[str, ...] = ()


def _extract_one(
    place: int, source: ImageSource, *, read: _Read, common: Common, options: DetectionOptions
) -> FoundStars | RefusedInputError:
    """Extract one image; a refusal is an answer, so that every image that cannot be used is named."""
    try:
        image = read(source)
    except RefusedInputError as refusal:
        return RefusedInputError(str(refusal))
    stars = detect(image.dn, common, options)
    return FoundStars(
        place, image.name, image.sha256, image.time_utc, image.time_source, stars, image.temperature_c, image.notes
    )


def _extract_all(
    sources: Sequence[ImageSource],
    one: Callable[[int, ImageSource], FoundStars | RefusedInputError],
    processes: int,
    say: Report,
) -> list[FoundStars]:
    """Extract every image; refuses all that cannot be used at once."""
    answers: dict[int, FoundStars | RefusedInputError] = {}
    for place, answer in _answers(sources, one, min(processes, len(sources))):
        answers[place] = answer
        say(f"extracting stars, {len(answers):,} of {len(sources):,} images", len(answers) / len(sources))
    ordered = [answers[place] for place in range(len(sources))]
    refused = [answer for answer in ordered if isinstance(answer, RefusedInputError)]
    if refused:
        faults = tuple(Fault(None, None, str(one_of_them)) for one_of_them in refused[:MOST_FAULTS])
        more = f" (and {len(refused) - 1} more images)" if len(refused) > 1 else ""
        raise RefusedInputError(f"{refused[0]}{more}", faults)
    return [answer for answer in ordered if isinstance(answer, FoundStars)]


def _answers(
    sources: Sequence[ImageSource], one: Callable[[int, ImageSource], FoundStars | RefusedInputError], processes: int
) -> Iterator[tuple[int, FoundStars | RefusedInputError]]:
    """Yield the answers as they come."""
    if processes <= 1:
        for place, source in enumerate(sources):
            yield place, one(place, source)
        return
    # a process that is forked from one with threads may never wake
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        waiting = {pool.submit(one, place, source): place for place, source in enumerate(sources)}
        try:
            for done in as_completed(waiting):
                yield waiting[done], done.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def assemble(found: list[FoundStars], sensor: Sensor, common: Common) -> Extraction:
    """Put the images into one telemetry set, in the order of time where each has one."""
    times = np.array([one.time_utc for one in found], dtype="datetime64[us]")
    timed = not np.isnat(times).any()
    if timed:
        found = [found[place] for place in np.argsort(times, kind="stable")]
    images = [_describe(frame, one) for frame, one in enumerate(found)]
    if not any(image.stars for image in images):
        raise RefusedInputError(
            "No star above the threshold was found in any image: lower --threshold, or check an image (--pictures) for clouds and "
            "focus."
        )
    telemetry = _make_telemetry(found, sensor, common)
    return Extraction(telemetry, images, common, _sentences(found, images, common, timed))


def _describe(frame: int, one: FoundStars) -> ExtractedImage:
    return ExtractedImage(
        name=one.name,
        sha256=one.sha256,
        frame=frame,
        time_utc=None if np.isnat(one.time_utc) else f"{one.time_utc}Z",
        time_source=one.time_source,
        stars=len(one.stars),
        saturated=int(one.stars.saturated.sum()),
        left_out=one.stars.left_out,
        trail_pixels=one.stars.trail_pixels,
    )


def _make_telemetry(found: list[FoundStars], sensor: Sensor, common: Common) -> Telemetry:
    counts = [len(one.stars) for one in found]
    frame = np.repeat(np.arange(len(found), dtype=np.int64), counts)
    flux = _joined(found, "flux_dn")
    magnitude = -2.5 * np.log10(np.maximum(flux, 1e-3))
    limit = DEFAULT_LIMIT if sensor.magnitude_limit is None else sensor.magnitude_limit
    magnitude += limit - np.quantile(magnitude, 1.0 - FAINTEST_SHARE)
    times = np.repeat(np.array([one.time_utc for one in found], dtype="datetime64[us]"), counts)
    temperatures = [np.nan if one.temperature_c is None else one.temperature_c for one in found]
    covariance = np.concatenate([one.stars.covariance for one in found])
    texts = {
        "image": _repeated([one.name for one in found], frame),
        "image_sha256": _repeated([one.sha256 for one in found], frame),
        **{name: _texts(_joined(found, name)) for name in IMAGE_COLUMNS[2:7]},
        "saturated": _texts(_joined(found, "saturated").astype(np.int64)),
        **{name: _texts(covariance[:, k]) for k, name in enumerate(IMAGE_COLUMNS[8:])},
    }
    return Telemetry(
        frame=frame,
        exposure=np.zeros(len(frame), dtype=np.int64),
        row_px=_joined(found, "row_px"),
        col_px=_joined(found, "col_px"),
        time_utc=None if np.isnat(times).all() else times,
        magnitude=magnitude,
        sigma_px=_joined(found, "sigma_px"),
        temperature_c=None if np.isnan(temperatures).all() else np.repeat(temperatures, counts),
        psf_sigma_px=np.full(len(frame), common.window.sigma_px),
        unknown=texts,
    )


def _joined(found: list[FoundStars], name: str) -> FloatArray:
    return np.concatenate([getattr(one.stars, name) for one in found])


def _texts(values: FloatArray) -> pa.ChunkedArray:
    """Write numbers as telemetry keeps columns of its own: texts."""
    return pa.chunked_array([pa.array([f"{value:.7g}" for value in values.tolist()], pa.string())])


def _repeated(names: list[str], frame: IntArray) -> pa.ChunkedArray:
    return pa.chunked_array([pa.array([names[k] for k in frame.tolist()], pa.string())])


def _sentences(found: list[FoundStars], images: list[ExtractedImage], common: Common, timed: bool) -> list[str]:
    """Say what was found and what was assumed."""
    stars, width = sum(image.stars for image in images), common.window.sigma_px
    said = [f"{len(images):,} images gave {stars:,} stars; a star is {width:.2f} px wide (one sigma)."]
    few = [image.name for image in images if image.stars < FEWEST_STARS]
    if few:
        said.append(
            f"{len(few):,} images (including {few[0]}) have fewer than {FEWEST_STARS} stars and cannot be recognised."
        )
    if common.bad.any():
        said.append(
            f"{np.count_nonzero(common.hot):,} hot and {np.count_nonzero(common.dead):,} dead pixels were found in "
            f"{common.looked_at} images and are not used."
        )
    if not common.stars_move:
        said.append(
            "The stars do not move between these images, so hot pixels can be detected only by their sharpness: move the "
            "field between images."
        )
    counts = {reason: sum(image.left_out.get(reason, 0) for image in images) for reason in REASONS}
    left_out = ", ".join(f"{count:,} {reason}" for reason, count in counts.items() if count)
    if left_out:
        said.append(f"Left out: {left_out}.")
    said.append(_say_gain(common))
    return [*said, *_say_times(found, timed), *(note for one in found for note in one.notes)][:MOST_FAULTS]


def _say_gain(common: Common) -> str:
    if common.gain_e_per_dn is None:
        return "The stars show no photon noise, so sigma_px includes only the noise of the sky: give --gain if it is known."
    if not common.gain_estimated:
        return f"The gain is {common.gain_e_per_dn:.4g} electrons per DN, as given."
    narrow = (
        " These stars are so narrow that it is too low, and sigma_px too large."
        if common.window.sigma_px < 0.95
        else ""
    )
    return (
        f"The gain was estimated from the images, {common.gain_e_per_dn:.3g} electrons per DN (accurate to some tens of "
        "percent): give --gain "
        f"if it is known.{narrow}"
    )


def _say_times(found: list[FoundStars], timed: bool) -> list[str]:
    sources = sorted({one.time_source for one in found if one.time_source})
    said = [f"Times are from {', '.join(sources)}."] if sources else []
    if timed:
        return said
    without = sum(bool(np.isnat(one.time_utc)) for one in found)
    untimed = (
        f"{without:,} images have no time: their frames keep the given order, and catalogue positions are used without "
        "aberration and proper motion; give --times."
    )
    return [*said, untimed]


def read_times(path: Path) -> dict[str, np.datetime64]:
    """Read a list of times: CSV with the columns `image` and `time_utc`, mid-exposure.

    Raises
    ------
    RefusedInputError
        When it cannot be read; names the row.
    """
    try:
        if path.stat().st_size > MOST_TIMES_BYTES:
            raise RefusedInputError(f"{path.name} is too large for a list of times: give one row per image.")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise RefusedInputError(
            f"{path.name} cannot be read as text: give a CSV with the columns image and time_utc."
        ) from error
    rows = csv.DictReader(text.splitlines())
    if not {"image", "time_utc"} <= set(rows.fieldnames or ()):
        raise RefusedInputError(f"{path.name} lacks the columns image and time_utc: name them in its first row.")
    times: dict[str, np.datetime64] = {}
    for number, row in enumerate(rows, start=2):
        time: np.datetime64 = NO_TIME
        with suppress(ValueError):
            time = np.datetime64(str(row["time_utc"]).strip().removesuffix("Z"), "us")
        if np.isnat(time):
            raise RefusedInputError(
                f"{path.name}: row {number}, column time_utc: {str(row['time_utc'])[:40]!r} is not a time: write "
                "2026-11-24T22:01:05.25Z."
            )
        times[str(row["image"]).strip()] = time
    return times
