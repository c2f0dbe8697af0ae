"""Simulated stars for measurements: arcs of random fields, real skies, views for every peer, and files of any length.

Each is two exposures a frame of twelve stars over the first ST-16 of E Table III, with its noise, unless it says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
from scipy.spatial.transform import Rotation

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.problem import build_problem, whiten_at
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import ArcSet
from boresight.simulation.sensors import (
    ST16_MAGNITUDE_LIMIT,
    WU_COLUMNS,
    WU_IMPLIED_SIGMA_PX,
    WU_PIXEL_PITCH_M,
    WU_ROWS,
    WU_TRUTH,
    st16_sensor,
    st16_truth,
)
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import Catalogue
from boresight.sky.guide_stars import guide_stars
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor
from boresight.telemetry.writing import ROW_GROUP

STARS, EXPOSURES_A_FRAME = 12, 2
SENSOR = 1
BLEND_RAD = 1e-3
TIME = np.datetime64("2026-10-01T00:00:00", "us")
SAMPLE_PERIOD_S = 40
#: Frames whose stars are drawn; a longer set repeats their fields with noise and times of its own.
FIELDS = 500
#: Frames drawn more than asked for, in place of those with a star off the detector.
SPARE = 20
#: Frames of a file drawn at a time.
CHUNK = 4096


def synthetic(frames: int, rng: np.random.Generator) -> ArcSet:
    """Whitened arcs of uniform star fields; attitudes are left out, for arcs do not see them."""
    sensor, truth = st16_sensor(SENSOR), st16_truth(SENSOR)
    counts = np.full(frames * EXPOSURES_A_FRAME, STARS)
    size = (sensor.rows, sensor.columns)
    arcs = uniform_field(INVERTED_WANG, truth, size, sensor.pixel_pitch_m, counts, sensor.centroid_sigma_px, rng)
    arcs = replace(arcs, frame=np.arange(frames), frame_start=np.arange(frames + 1) * EXPOSURES_A_FRAME)
    return arcsets.whiten(arcs, arcsets.angular_sigma(INVERTED_WANG, sensor.initial, arcs))[0]


def wu_field(counts: IntArray, rng: np.random.Generator, noise_px: float = WU_IMPLIED_SIGMA_PX) -> ArcSet:
    """Whitened arcs of exposures of so many stars each over W's detector, one a frame."""
    arcs = uniform_field(PINHOLE_RADIAL, WU_TRUTH, (WU_ROWS, WU_COLUMNS), WU_PIXEL_PITCH_M, counts, noise_px, rng)
    return arcsets.whiten(arcs, arcsets.angular_sigma(PINHOLE_RADIAL, WU_TRUTH, arcs))[0]


def uniform_field(
    camera: CameraModel, truth: FloatArray, size: tuple[int, int], pitch: float, counts: IntArray, noise_px: float,
    rng: np.random.Generator,
) -> ArcSet:  # fmt: skip
    """Arcs of exposures of so many stars each, uniform over the detector, one exposure a frame."""
    star_start = np.concatenate([[0], np.cumsum(counts)])
    n = int(star_start[-1])
    row, col = rng.uniform(0, size[0] - 1, n), rng.uniform(0, size[1] - 1, n)
    s_i = camera.directions(truth, row, col, pitch)
    places, _ = arcsets.order(star_start, s_i)
    noise = noise_px * rng.normal(size=(2, n))
    return ArcSet(
        camera=camera, pitch=pitch, frame=np.arange(len(counts)), frame_start=np.arange(len(counts) + 1),
        star_start=star_start, row_px=(row + noise[0])[places], col_px=(col + noise[1])[places], sigma_px=np.full(n, noise_px),
        s_i=np.ascontiguousarray(s_i[places]), source_row=places, phi=np.empty(0), band=np.empty((0, 5)),
    )  # fmt: skip


def star_frames(
    frames: int, sensor: Sensor, truth: FloatArray, catalogue: Catalogue, rng: np.random.Generator
) -> Telemetry:
    """Draw a set of real stars, every one named, with times and without attitudes.

    An attitude is drawn until the true camera shows `STARS` stars down to the ST-16's limit; the brightest of them are detected,
    so undetected fainter ones stand between them as they do in flight.
    """
    hip = guide_stars(catalogue, ST16_MAGNITUDE_LIMIT, BLEND_RAD).hip
    star = catalogue.find_index(hip)
    s_i = apparent_directions(catalogue, star, np.full(len(star), TIME), None)
    chosen = list[tuple[IntArray, FloatArray, FloatArray]]()
    while len(chosen) < frames:
        seen = _seen(sensor, truth, s_i, catalogue.magnitude[star], rng)
        if len(seen[0]) == STARS:
            chosen.append(seen)
    stars, row, col = (np.repeat(np.array(column), EXPOSURES_A_FRAME, axis=0) for column in zip(*chosen, strict=True))
    place = np.stack([row, col])
    row_px, col_px = (place + sensor.centroid_sigma_px * rng.normal(size=place.shape)).reshape(2, -1)
    frame = np.repeat(np.arange(frames), EXPOSURES_A_FRAME * STARS)
    exposure = np.tile(np.repeat(np.arange(EXPOSURES_A_FRAME), STARS), frames)
    time_utc = TIME + frame * np.timedelta64(SAMPLE_PERIOD_S, "s")
    return Telemetry(frame, exposure, row_px, col_px, time_utc=time_utc, star_id=hip[stars].ravel())


def _seen(
    sensor: Sensor, truth: FloatArray, s_i: FloatArray, magnitude: FloatArray, rng: np.random.Generator
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Brightest stars on the detector at one random attitude, at most `STARS`, and where they fall."""
    s_d = s_i @ Rotation.random(rng=rng).as_matrix().T
    ahead = np.flatnonzero(s_d[:, 2] > 0.9)
    row, col = CAMERA_MODELS[sensor.camera_model].project(truth, s_d[ahead], sensor.pixel_pitch_m)
    on = np.flatnonzero((row > 0) & (row < sensor.rows - 1) & (col > 0) & (col < sensor.columns - 1))
    brightest = on[np.argsort(magnitude[ahead[on]])[:STARS]]
    return ahead[brightest], row[brightest], col[brightest]


def repeated_fields(frames: int, sensor: Sensor, catalogue: Catalogue, seed: int) -> Telemetry:
    """Draw a set of named stars, with times and without directions, whose fields repeat after `FIELDS` frames."""
    rng = np.random.default_rng(seed)
    few = star_frames(min(frames, FIELDS), replace(sensor, centroid_sigma_px=0.0), st16_truth(SENSOR), catalogue, rng)
    rows_of_frame = len(few) // min(frames, FIELDS)
    row = np.arange(frames * rows_of_frame) % len(few)
    frame = np.repeat(np.arange(frames), rows_of_frame)
    noise = sensor.centroid_sigma_px * rng.normal(size=(2, len(row)))
    return Telemetry(
        frame, few.exposure[row], few.row_px[row] + noise[0], few.col_px[row] + noise[1],
        time_utc=TIME + (frame % FIELDS) * np.timedelta64(SAMPLE_PERIOD_S, "s"),
        star_id=None if few.star_id is None else few.star_id[row],
    )  # fmt: skip


@dataclass(frozen=True)
class Views:
    """One set of views of equally many stars, in arc order; a view is an exposure, what a camera calibrator calls an image.

    `arcs` are not yet whitened, `magnitude` (n_views, n) is for peers that ask for brightness, `sensor` is where every peer starts,
    and `truth` (n_parameters,), SI, made the centroids.
    """

    arcs: ArcSet
    magnitude: FloatArray
    sensor: Sensor
    truth: FloatArray

    @property
    def camera(self) -> CameraModel:
        """The sensor's camera model."""
        return CAMERA_MODELS[self.sensor.camera_model]

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return self.arcs.n_frames

    @property
    def pixels(self) -> FloatArray:
        """(n_views, n, 2) centroids as row and column."""
        return np.stack([self.arcs.row_px, self.arcs.col_px], axis=-1).reshape(-1, STARS, 2)

    @property
    def stars(self) -> FloatArray:
        """(n_views, n, 3) catalogue directions."""
        return self.arcs.s_i.reshape(-1, STARS, 3)

    def whitened(self) -> ArcSet:
        """Return the arcs with R at the ground calibration."""
        return whiten_at(self.arcs, self.camera, self.sensor.initial)

    def first(self, frames: int) -> Views:
        """Return the first frames of the set, or the whole."""
        frames = min(frames, self.n_frames)
        return replace(self, arcs=self.arcs.frames(0, frames), magnitude=self.magnitude[: frames * EXPOSURES_A_FRAME])


def simulated_views(frames: int, seed: int, catalogue: Catalogue) -> Views:
    """Simulate one set; a frame whose noise carries a star off the detector is left out."""
    sensor, truth = st16_sensor(SENSOR), st16_truth(SENSOR)
    drawn = star_frames(frames + SPARE, sensor, truth, catalogue, np.random.default_rng([SENSOR, seed]))
    on = (np.abs(drawn.row_px - (sensor.rows - 1) / 2) < sensor.rows / 2) & (
        np.abs(drawn.col_px - (sensor.columns - 1) / 2) < sensor.columns / 2
    )
    of_frame = EXPOSURES_A_FRAME * STARS
    full = np.flatnonzero(on.reshape(-1, of_frame).all(axis=1))[:frames]
    rows = (full[:, None] * of_frame + np.arange(of_frame)).ravel()
    columns = ("frame", "exposure", "row_px", "col_px", "time_utc", "star_id")
    telemetry = Telemetry(**{name: getattr(drawn, name)[rows] for name in columns})
    arcs = build_problem(telemetry, sensor, catalogue).arcs.whole()
    if telemetry.star_id is None or len(arcs.row_px) != len(telemetry):
        raise ValueError(f"Expected every star in the problem / Received {len(arcs.row_px)} of {len(telemetry)}")
    star = catalogue.find_index(telemetry.star_id[arcs.source_row])
    return Views(arcs, catalogue.magnitude[star].reshape(-1, STARS), sensor, truth)


def write_synthetic(path: Path, frames: int, seed: int = 1) -> None:
    """Write a Parquet file of so many frames in constant memory: uniform stars, each with its direction, at random attitudes.

    Chunk k is drawn from the seed (seed, k), so that a longer file begins with the rows of a shorter one.
    """
    with arrow_parquet.ParquetWriter(path, _rows(0, 0, seed).schema, compression="snappy") as writer:
        for first in range(0, frames, CHUNK):
            writer.write_table(_rows(first, min(CHUNK, frames - first), seed), row_group_size=ROW_GROUP)


def _rows(first: int, frames: int, seed: int) -> pa.Table:
    """Draw the rows of so many frames from number `first` on."""
    rng = np.random.default_rng([seed, first // CHUNK])
    sensor, exposures = st16_sensor(SENSOR), frames * EXPOSURES_A_FRAME
    n = exposures * STARS
    row, col = rng.uniform(0, sensor.rows - 1, n), rng.uniform(0, sensor.columns - 1, n)
    s_d = CAMERA_MODELS[sensor.camera_model].directions(st16_truth(SENSOR), row, col, sensor.pixel_pitch_m)
    turns = Rotation.random(exposures, rng=rng).as_matrix() if exposures else np.empty((0, 3, 3))
    s_i = (s_d.reshape(exposures, STARS, 3) @ turns).reshape(n, 3)
    noise = sensor.centroid_sigma_px * rng.normal(size=(2, n))
    return pa.table(
        {
            "frame": np.repeat(np.arange(first, first + frames), EXPOSURES_A_FRAME * STARS),
            "exposure": np.tile(np.repeat(np.arange(EXPOSURES_A_FRAME), STARS), frames),
            "row_px": row + noise[0],
            "col_px": col + noise[1],
            "ra_deg": np.degrees(np.arctan2(s_i[:, 1], s_i[:, 0])) % 360,
            "dec_deg": np.degrees(np.arcsin(np.clip(s_i[:, 2], -1, 1))),
        }
    )
