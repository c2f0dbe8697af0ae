"""Lost in space: the attitude of an exposure of which nothing is known but its centroids, by `tetra3rs`.

The solver hashes patterns of four stars by the ratios of their arcs and verifies a candidate by its other stars. It is asked for an
attitude and nothing else: its catalogue (Gaia) and its camera fit take no part in any calibration, and which star is which
is decided by our own matching, which also throws out an attitude that was a coincidence.

It expects the pixels of an ideal camera. With s the direction of a star in the right-handed detector triad under the present
parameters, the pixel it is given is the pinhole's, so our distortion is out and only its error is left:

    (x, y) = F (s_x, s_y) / s_z        F = W / (2 tan(field / 2))        W = `WIDTH_PX`

Its camera axes (x along the image's columns, y along its rows, z out of the lens) are then our triad, and its matrix is C_di as
it stands. An answer by the mirror image of the field is refused: the sensor file says which way round the detector is.

Measured on 300 simulated frames of six ST-16 under their ground calibrations, with half a false star an exposure: 96.7 % are
solved, nearly all exposures of seven stars or more and none of four; of 569 answers none is wrong, and the worst is 0.09 deg off.

The table of patterns depends on the field of view alone. It takes seconds to make, so it is made once for each field (to
half a degree), kept in the catalogue's folder, and read in milliseconds after that.

`recognise` asks more: which way round the image is and what focal length it has, of a sensor file that may be wrong in both. The
ratios of a pattern's arcs know no scale, so a table with patterns of every size recognises fields from W_0 / 1.5 to 1.75 W_0
across; the focal length follows from the field that the solver finds, F_true / F = tan(W_0 / 2) / tan(W / 2). Measured on
six ST-16 and five real images: wrong by -40 to +67 %, upright or mirrored, as many are solved as with the right file.

Attitudes carried on from solved frames to those between and beyond them, at constant rate.

With C_a, C_b the attitudes of the two nearest solved frames at times t_a < t_b and q = (t - t_a) / (t_b - t_a),

    C(t) = exp(-q [phi]x) C_a,    exp(-[phi]x) = C_b C_a^T

which is a slerp between them and goes on beyond. A tracker that stares at the Earth turns four degrees a minute, so holding the
last attitude would not do; where the turn is not constant the answer is wrong, and the search that starts from it finds nothing.
"""

from __future__ import annotations

import os
import tempfile
import threading
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.cameras import CameraModel
from boresight.estimation.attitude import (
    conjugate,
    product,
    rotation_vector,
    to_quaternion,
    triad,
    vector_to_quaternion,
)

#: Four stars make a pattern.
FEWEST_STARS = 4
#: Detections of an exposure that are looked at, the brightest: more cost seconds and tell nothing more.
MOST_STARS = 300
WIDTH_PX = 1000.0
#: The field of view may be wrong by this share of itself where a sensor file is believed: ten times what a ground calibration
#: leaves. A field farther off is not recognised by `identify`; `recognise` looks for it from `NARROWEST` to `WIDEST` times.
FIELD_ERROR = 0.05
NARROWEST, WIDEST = 1 / 1.5, 1.75
#: Of tables with patterns of every size: fields of view stand in this ratio to one another, patterns a patch, patches a field.
_FIELD_RATIO, _PATTERNS, _PATCHES = 1.25, 50, 30
#: A star counts as the catalogue's within this share of the field, 0.08 deg on the ST-16, and a field as recognised
#: at this chance of a coincidence. A looser radius or a stricter chance solves fewer sparse fields, and none more surely.
MATCH_RADIUS, COINCIDENCE = 0.004, 0.01
#: Tolerance of the ratios of a pattern's arcs.
RATIO_ERROR = 0.003
#: Patterns kept for each patch of sky of 20 deg; narrower fields have more patches, and keep fewer, for the table to stay small.
PATTERNS_AT_20_DEG, FEWEST_PATTERNS = 500, 50
#: Patterns of an image tried before it is given up: work and not time, so that every machine gives the same answer.
MOST_TRIED = 200_000
#: Fields of view that are asked for, across the longer side: those that a sensor file may describe.
FIELDS_DEG = (0.1, 175.0)
_FIELD_STEP_DEG = 0.5
_making = threading.Lock()


def field_of_view_deg(camera: CameraModel, x: FloatArray, rows: int, columns: int, pitch: float) -> float:
    """Angle across the longer side of a detector of rows by columns under parameters x, through its middle."""
    middle_row, middle_column = (rows - 1) / 2, (columns - 1) / 2
    ends = camera.directions(
        x,
        np.array([-0.5, rows - 0.5, middle_row, middle_row]),
        np.array([middle_column, middle_column, -0.5, columns - 0.5]),
        pitch,
    )
    return float(np.degrees(np.arccos(np.clip([ends[0] @ ends[1], ends[2] @ ends[3]], -1.0, 1.0)).max()))


def identify(
    s_d: FloatArray, magnitude: FloatArray | None, parity: int, field_deg: float, cache_folder: Path | None
) -> FloatArray | None:
    """Find the attitude of one exposure.

    Parameters
    ----------
    s_d
        (n, 3) directions of all its detections in D under the present parameters.
    magnitude
        (n,) of any zero point, NaN where unknown; bright stars are tried first. None = as listed.
    parity
        Of the detector axes.
    field_deg
        Angle across the detector's longer side, see `field_of_view_deg`.
    cache_folder
        Where the table of patterns is kept; None keeps it for this process only.

    Returns
    -------
    (4,) quaternion x y z w, ICRS to the right-handed detector triad, good to some 0.1 deg; None when the field is not recognised.
    """
    pixels = _pixels(triad(s_d, parity), magnitude, field_deg)
    if len(pixels) < FEWEST_STARS:
        return None
    answer = _patterns(_FIELD_STEP_DEG * max(1, round(field_deg / _FIELD_STEP_DEG)), cache_folder).solve_from_centroids(
        pixels,
        fov_estimate_deg=field_deg,
        image_shape=(int(WIDTH_PX), int(WIDTH_PX)),
        fov_max_error_deg=FIELD_ERROR * field_deg,
        match_radius=MATCH_RADIUS,
        match_threshold=COINCIDENCE,
        solve_timeout_ms=None,
        max_patterns_checked=MOST_TRIED,
    )
    if not answer or answer.parity_flip:
        return None
    return to_quaternion(answer.rotation_matrix_icrs_to_camera)


@dataclass(frozen=True)
class Recognised:
    """What the image of one exposure is of: its attitude, which way round it is, and its focal length.

    `quaternion`: (4,) x y z w, ICRS to the detector triad; of no meaning where the image is mirrored. `mirrored`: whether it is the
    mirror image of the sky under the parity given. `focal_ratio`: true focal length over that given.
    """

    quaternion: FloatArray
    mirrored: bool
    focal_ratio: float


def prepare_recognition(field_deg: float, cache_folder: Path | None) -> None:
    """Load the table of patterns that `recognise` looks things up in, or make it, which takes seconds."""
    _patterns(_wide_field(field_deg), cache_folder, every_size=True)


def is_prepared(field_deg: float, cache_folder: Path | None) -> bool:
    """Whether the folder has the table of patterns that `recognise` looks things up in, so that reading it takes milliseconds."""
    return cache_folder is not None and _database_path(cache_folder, _wide_field(field_deg), every_size=True).is_file()


def recognise(
    s_d: FloatArray, magnitude: FloatArray | None, parity: int, field_deg: float, cache_folder: Path | None
) -> Recognised | None:
    """Find what one exposure sees when neither its parity nor its focal length is trusted.

    Parameters and refusals as in `identify`; None when the field is not recognised.
    """
    pixels = _pixels(triad(s_d, parity), magnitude, field_deg)
    if len(pixels) < FEWEST_STARS:
        return None
    answer = _patterns(_wide_field(field_deg), cache_folder, every_size=True).solve_from_centroids(
        pixels,
        fov_estimate_deg=field_deg,
        image_shape=(int(WIDTH_PX), int(WIDTH_PX)),
        fov_max_error_deg=(WIDEST - 1) * field_deg,
        match_radius=MATCH_RADIUS,
        match_threshold=COINCIDENCE,
        solve_timeout_ms=None,
        max_patterns_checked=MOST_TRIED,
    )
    if not answer:
        return None
    ratio = np.tan(np.radians(field_deg) / 2) / np.tan(np.radians(answer.fov_deg) / 2)
    return Recognised(to_quaternion(answer.rotation_matrix_icrs_to_camera), bool(answer.parity_flip), float(ratio))


def _wide_field(field_deg: float) -> float:
    """Round the widest field that is looked for up to one of few, so that alike sensors share a table."""
    widest = min(WIDEST * field_deg, FIELDS_DEG[1])
    return min(float(_FIELD_RATIO ** np.ceil(np.log(widest) / np.log(_FIELD_RATIO) - 1e-9)), FIELDS_DEG[1])


def _pixels(s: FloatArray, magnitude: FloatArray | None, field_deg: float) -> FloatArray:
    """Ideal pinhole pixels (n, 3) as x, y, brightness of the directions ahead, brightest first."""
    usable = np.isfinite(s).all(axis=1) & (s[:, 2] > 0)
    s = s[usable]
    faintness = np.arange(len(s), dtype=float) if magnitude is None else magnitude[usable]
    faintness = np.where(np.isfinite(faintness), faintness, np.nanmax(faintness, initial=0.0))
    order = np.argsort(faintness, kind="stable")[:MOST_STARS]
    focal_px = WIDTH_PX / (2 * np.tan(np.radians(field_deg) / 2))
    brightness = 1.0 / (1.0 + np.arange(len(order)))
    return np.column_stack([focal_px * s[order, :2] / s[order, 2:], brightness])


@lru_cache(maxsize=4)  # some 100 MB each
def _loaded(field_deg: float, cache_folder: Path | None, *, every_size: bool) -> Any:
    """Table of patterns for a field of view, or for every one below it: from the folder, or made now and kept there."""
    import tetra3rs  # noqa: PLC0415 - 10 ms that only those pay who are lost in space

    path = None if cache_folder is None else _database_path(cache_folder, field_deg, every_size=every_size)
    if path is not None and path.is_file():
        try:
            return tetra3rs.SolverDatabase.load_from_file(str(path))
        except (OSError, ValueError, RuntimeError):
            path.unlink(missing_ok=True)  # damaged: make it again
    if every_size:
        made = tetra3rs.SolverDatabase.generate_from_gaia(
            max_fov_deg=field_deg,
            min_fov_deg=field_deg * NARROWEST / (WIDEST * _FIELD_RATIO),
            pattern_max_error=RATIO_ERROR,
            patterns_per_lattice_field=_PATTERNS,
            lattice_field_oversampling=_PATCHES,
        )
    else:
        patterns = round(PATTERNS_AT_20_DEG * min(1.0, field_deg / 20.0) ** 2)
        made = tetra3rs.SolverDatabase.generate_from_gaia(
            max_fov_deg=field_deg,
            pattern_max_error=RATIO_ERROR,
            patterns_per_lattice_field=max(FEWEST_PATTERNS, patterns),
        )
    if path is not None:
        _keep(made, path)
    return made


def _database_path(cache_folder: Path, field_deg: float, *, every_size: bool) -> Path:
    """Return where a table of patterns is kept."""
    import tetra3rs  # noqa: PLC0415 - as above

    sizes = "fields-to" if every_size else "field"
    return Path(cache_folder) / f"patterns-tetra3rs-{tetra3rs.__version__}-{sizes}{field_deg:g}.bin"


def _patterns(field_deg: float, cache_folder: Path | None, *, every_size: bool = False) -> Any:
    """Return `_loaded`, made by one thread at a time."""
    with _making:
        return _loaded(field_deg, cache_folder, every_size=every_size)


def _keep(made: Any, path: Path) -> None:
    """Write under a temporary name and rename, so that no other process reads half a table."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".partial")
        os.close(handle)
    except OSError:
        return  # a read-only home: the next process makes it again
    try:
        made.save_to_file(temporary)
        Path(temporary).replace(path)
    except (OSError, RuntimeError):
        Path(temporary).unlink(missing_ok=True)


#: Frames are carried on at most so many sample periods.
FARTHEST = 4


def carried_on(
    frame_start: IntArray, time_s: FloatArray, valid: NDArray[np.bool_], C: FloatArray, lost: IntArray
) -> tuple[FloatArray, IntArray]:
    """Predict the attitudes of lost frames.

    Parameters
    ----------
    frame_start
        (n_frames + 1,) first exposure of each frame.
    time_s
        (n_frames,) seconds, NaN where unknown.
    valid, C
        (n_exposures,) which exposures are solved and (n_exposures, 3, 3) their attitudes.
    lost
        Frames without a solved exposure.

    Returns
    -------
    hint
        (n_exposures, 4) quaternions x y z w, NaN where nothing can be said.
    hinted
        The lost frames of which something can be.
    """
    hint = np.full((len(valid), 4), np.nan)
    frame = np.repeat(np.arange(len(frame_start) - 1), np.diff(frame_start))
    solved, place = np.unique(frame[valid], return_index=True)
    exposure = np.flatnonzero(valid)[place]
    timed = np.isfinite(time_s[solved])
    solved, exposure = solved[timed], exposure[timed]
    if len(solved) <= 1:  # a rate needs two frames
        return hint, np.empty(0, np.int64)
    reach = FARTHEST * float(np.nanmedian(np.diff(time_s)))
    hinted = []
    for k in lost[np.isfinite(time_s[lost])]:
        second = int(np.clip(np.searchsorted(solved, k), 1, len(solved) - 1))
        t = time_s[solved[[second - 1, second]]]
        if np.abs(t - time_s[k]).min() > reach or t[1] <= t[0]:
            continue
        share = float((time_s[k] - t[0]) / (t[1] - t[0]))
        hint[frame_start[k] : frame_start[k + 1]] = _turned(C[exposure[second - 1]], C[exposure[second]], share)
        hinted.append(k)
    return hint, np.array(hinted, np.int64)


def _turned(C_a: FloatArray, C_b: FloatArray, share: float) -> FloatArray:
    """Quaternion of C_a turned on by a share of the turn from C_a to C_b."""
    q_a, q_b = to_quaternion(C_a), to_quaternion(C_b)
    turn = rotation_vector(product(q_b, conjugate(q_a)))
    return product(vector_to_quaternion(share * turn), q_a)
