"""Telemetry and sky made into arcs: which rows take part, in what order, and what was left out and why.

A row takes part when it lies on the detector and has a direction (its own, or its star's from the catalogue). An exposure
takes part when at least N_min = 4 of its rows do (E section II-C) and not all of them lie on a line. Everything left out is counted
with its reason, so that nothing disappears silently.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from boresight.arrays import FloatArray, IntArray, TimeArray
from boresight.calibration.calibration import LeftOut
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.cameras.model import corners
from boresight.estimation import MINIMUM_STARS
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import ArcSet
from boresight.estimation.stored_arcs import Arcs
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import star_directions
from boresight.telemetry.quality.detector import matched_rows, on_detector
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

UNMATCHED_REASON = "not matched to a catalogue star"
STAR_REASONS = (
    UNMATCHED_REASON,
    "no direction: number not in the catalogue, or no time",
    "centroid outside the detector",
)
COLLINEAR_REASON = "all usable stars lie on one line"


def too_few_reason(minimum_stars: int) -> str:
    """Say why an exposure with fewer stars takes no part."""
    return f"fewer than {minimum_stars} usable stars"


@dataclass(frozen=True)
class Problem:
    """A telemetry set ready for estimation.

    `sensor`: whose telemetry it is. `arcs`: stars in order, in memory or in files; `phi` and `band` are filled by `whiten_at`.
    `time_utc`: (n_frames,) time of each frame that takes part, or None. `frames_in_set`: frames in the telemetry, taking part
    or not. `left_out`: what takes no part.
    """

    sensor: Sensor
    arcs: Arcs
    time_utc: TimeArray | None
    frames_in_set: int
    left_out: tuple[LeftOut, ...]
    _whitened_at: dict[bytes, Arcs] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def camera(self) -> CameraModel:
        """Its camera model."""
        return CAMERA_MODELS[self.sensor.camera_model]

    @cached_property
    def _plausible(self) -> FloatArray:
        """(2, n_parameters) lowest and highest values that are not absurd."""
        return np.array(self.camera.plausible).T

    @cached_property
    def _corners(self) -> tuple[FloatArray, FloatArray]:
        return corners(self.sensor.rows, self.sensor.columns)

    def whitened(self, x: FloatArray) -> Arcs:
        """Return the arcs with R taken at state x (n_parameters,); those of the last state asked for are kept."""
        key = np.asarray(x, np.float64).tobytes()
        arcs = self._whitened_at.get(key)
        if arcs is None:
            arcs = self.arcs.each(whiten_part, self.camera.name, x)
            self._whitened_at.clear()
            self._whitened_at[key] = arcs
        return arcs

    def can_be(self, x: FloatArray) -> bool:
        """Whether a state (n_parameters,) is one that can be: inside its ranges, with a direction for every corner."""
        low, high = self._plausible
        if not ((low <= x) & (x <= high)).all():
            return False
        return bool(np.isfinite(self.camera.directions(x, *self._corners, self.sensor.pixel_pitch_m)).all())

    def find_place(self, frame: IntArray) -> IntArray:
        """Places (n,) of frame numbers (n,) among those that take part."""
        return np.asarray(np.searchsorted(self.arcs.frame, frame))

    def get_times(self, frame: IntArray) -> TimeArray | None:
        """Times (n,) of frames (n,), NaT of those that take no part; None where the set has none."""
        return None if self.time_utc is None else times_at(frame, self.arcs.frame, self.time_utc)


def times_at(frame: IntArray, known: IntArray, times: TimeArray) -> TimeArray:
    """Times (n,) of frames (n,) among known ones (m,) in their order with theirs (m,); NaT of the others."""
    place = np.minimum(np.searchsorted(known, frame), max(len(known) - 1, 0))
    unknown = np.datetime64("NaT", "us")
    return np.where(known[place] == frame, times[place], unknown) if len(known) else np.full(len(frame), unknown)


def whiten_at(arcs: ArcSet, camera: CameraModel, x: FloatArray) -> ArcSet:
    """Fill a set's catalogue arcs and R at state x."""
    return whiten_part(arcs, camera.name, x)


def whiten_part(arcs: ArcSet, camera_model: str, x: FloatArray) -> ArcSet:
    """The same of any part of a set, the camera by its name: for `Arcs.each`."""
    return arcsets.whiten(arcs, arcsets.angular_sigma(CAMERA_MODELS[camera_model], x, arcs))[0]


#: Frames that tell the parity.
PARITY_FRAMES = 1024


def find_parity(arcs: Arcs, x: FloatArray, stated: int) -> int:
    """Parity under which most of the first frames are no mirror image of their stars: a wrong one in the file refuses none."""
    same = sum(arcs.frames(0, min(arcs.n_frames, PARITY_FRAMES)).over_blocks(_handedness_of_block, x))
    return stated if same == 0 else int(np.sign(same))


def _handedness_of_block(block: ArcSet, x: FloatArray) -> int:
    """How many more exposures of one block have their first three stars the right way round in D than not."""
    three = block.star_start[:-1, None] + np.arange(3)
    s = block.camera.directions(x, block.row_px[three.ravel()], block.col_px[three.ravel()], block.pitch)
    turns = np.linalg.det(s.reshape(-1, 3, 3)) * np.linalg.det(block.s_i[three])
    return int(np.sign(turns[np.isfinite(turns)]).sum())


def build_problem(
    telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue, minimum_stars: int = MINIMUM_STARS
) -> Problem:
    """Choose and order the stars of a telemetry set.

    Raises RefusedInputError when matched rows can be given no direction at all, see `sky.directions`.
    """
    s_i = star_directions(
        telemetry.star_id, telemetry.ra_rad, telemetry.dec_rad, telemetry.time_utc, telemetry.velocity_m_s, catalogue,
        telemetry.site,
    )  # fmt: skip
    return make_problem_of_directions(telemetry, sensor, s_i, minimum_stars)


def make_problem_of_directions(telemetry: Telemetry, sensor: Sensor, s_i: FloatArray, minimum_stars: int) -> Problem:
    """The same of a whole set whose directions (n_rows, 3) are there already."""
    problem = make_problem(telemetry, sensor, s_i, minimum_stars)
    return replace(problem, left_out=added(problem.left_out))


def added(items: Iterable[LeftOut]) -> tuple[LeftOut, ...]:
    """Add what was left out for the same reason, in the order of `make_problem`, which names every reason; drop what was not."""
    counts: dict[tuple[str, str], int] = {}
    for item in items:
        counts[item.what, item.reason] = counts.get((item.what, item.reason), 0) + item.count
    return tuple(LeftOut(what=what, count=count, reason=reason) for (what, reason), count in counts.items() if count)


def make_problem(telemetry: Telemetry, sensor: Sensor, s_i: FloatArray, minimum_stars: int) -> Problem:
    """Choose and order the stars of a set with these directions (n_rows, 3); every reason is counted, also where it is 0."""
    rows, left_out = _usable_rows(telemetry, sensor, s_i)
    rows, few = _full_exposures(telemetry, rows, minimum_stars)
    arcs, collinear = _ordered(telemetry, sensor, s_i, rows)
    left_out += [
        LeftOut(what="exposures", count=few, reason=too_few_reason(minimum_stars)),
        LeftOut(what="exposures", count=collinear, reason=COLLINEAR_REASON),
    ]
    first_rows = arcs.source_row[arcs.star_start[arcs.frame_start[:-1]]]
    return Problem(
        sensor=sensor,
        arcs=arcs,
        time_utc=None if telemetry.time_utc is None else telemetry.time_utc[first_rows],
        frames_in_set=len(np.unique(telemetry.frame)),
        left_out=tuple(left_out),
    )


def _usable_rows(telemetry: Telemetry, sensor: Sensor, s_i: FloatArray) -> tuple[IntArray, list[LeftOut]]:
    """Rows on the detector with a direction, and the counts of the others."""
    on = on_detector(telemetry, sensor)
    seen, off = np.isfinite(s_i[:, 0]), ~on & matched_rows(telemetry)
    unmatched = np.zeros(len(telemetry), bool) if telemetry.star_id is None else telemetry.star_id <= 0
    groups = (unmatched, ~seen & ~unmatched & ~off, off)
    counted = zip(groups, STAR_REASONS, strict=True)
    left_out = [LeftOut(what="stars", count=int(np.sum(rows)), reason=reason) for rows, reason in counted]
    return np.flatnonzero(on & seen), left_out


def _exposure_starts(frame: IntArray, exposure: IntArray) -> IntArray:
    """First place of each run of equal (frame, exposure), and the end, (n_exposures + 1,)."""
    if len(frame) == 0:
        return np.zeros(1, np.int64)
    new = np.flatnonzero((np.diff(frame) != 0) | (np.diff(exposure) != 0)) + 1
    return np.concatenate([[0], new, [len(frame)]]).astype(np.int64)


def _full_exposures(telemetry: Telemetry, rows: IntArray, minimum_stars: int) -> tuple[IntArray, int]:
    """Keep the rows of exposures with enough stars; returns them and the number of exposures left out."""
    starts = _exposure_starts(telemetry.frame[rows], telemetry.exposure[rows])
    counts = np.diff(starts)
    n_exposures = len(_exposure_starts(telemetry.frame, telemetry.exposure)) - 1
    full = counts >= minimum_stars
    return rows[np.repeat(full, counts)], n_exposures - int(full.sum())


def _ordered(telemetry: Telemetry, sensor: Sensor, s_i: FloatArray, rows: IntArray) -> tuple[ArcSet, int]:
    """Order the stars of each exposure and drop the collinear exposures; returns the arcs (unwhitened) and their number."""
    starts = _exposure_starts(telemetry.frame[rows], telemetry.exposure[rows])
    places, fatness = arcsets.order(starts, s_i[rows])
    fat = fatness > arcsets.COLLINEAR
    rows = rows[places][np.repeat(fat, np.diff(starts))]
    starts = _exposure_starts(telemetry.frame[rows], telemetry.exposure[rows])
    frames, frame_start = np.unique(telemetry.frame[rows[starts[:-1]]], return_index=True)
    sigma_px = np.full(len(rows), sensor.centroid_sigma_px)
    if telemetry.sigma_px is not None:
        given = telemetry.sigma_px[rows]
        sigma_px = np.where(np.isfinite(given), given, sigma_px)
    arcs = ArcSet(
        camera=CAMERA_MODELS[sensor.camera_model],
        pitch=sensor.pixel_pitch_m,
        frame=frames,
        frame_start=np.append(frame_start, len(starts) - 1).astype(np.int64),
        star_start=starts,
        row_px=telemetry.row_px[rows],
        col_px=telemetry.col_px[rows],
        sigma_px=sigma_px,
        s_i=np.ascontiguousarray(s_i[rows]),
        source_row=rows,
        phi=np.empty(0),
        band=np.empty((0, 5)),
    )
    return arcs, int((~fat).sum())
