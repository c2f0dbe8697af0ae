"""One frame of a run: every detection with its star, where each parameter set puts that star, and the attitude of each exposure.

The residual is centroid minus projection under the exposure's best attitude at those parameters (`pixel_residuals`), so each set of
parameters is judged at its best. Its sigma is that of centroid noise alone, what is left of it after the attitude took its
part and, under a batch's new parameters, after the parameters took theirs; a filter's covariance is not that of this fit, so
there the second part, below 1 % in a set of a hundred frames, stays in. Under the old parameters normalised residuals are
large by as much as these are wrong.

Attitude conventions: `quaternion` is x y z w, Hamilton, ICRS to the right-handed detector triad (`boresight`); RA and Dec are of
the boresight, the z axis; roll is the position angle of the x axis (increasing rows) there, from north through east; sigmas
are about the axes x, y, z of the triad, from centroid noise at these parameters.

A frame is shown under two states: old are the sensor's parameters when the run was launched, new those of its result. With
`match` "rematch" a run keeps no matches, so the frame is matched again here, on its own: what the stars of a frame say of the
parameters serves that frame alone (`sky.matching`), so the answer is the run's, but for a frame that could only be started from a
neighbour's attitude; for such a one its neighbours are matched too. A filter matched each frame with what it knew by then; here
its last parameters are taken. Catalogue stars that an exposure should show and did not are projected by its attitude under the
run's parameters.

Every detection is one of these, and says why.

==========  ==================================================================================================
used        matched, and in the arcs that the run was fitted to
left out    matched, but its exposure takes no part, or its centroid is off the detector
rejected    the file names a star for it that matching, or the flight code's check, does not accept
unmatched   no star was found for it, and the file names none
==========  ==================================================================================================

An attitude rests on the used and the left out stars that lie on the detector. A rejected one has a place all the same, where
the star that the file names would be: how far away that is says why it was rejected.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import ARCSEC_PER_RAD, BoolArray, FloatArray, IntArray, known_or_none
from boresight.calibration.calibration import Calibration, Covariance
from boresight.calibration.corrections import with_directions
from boresight.calibration.estimate import Parameters
from boresight.calibration.evaluation.pixel_residuals import FreeCovariance, PixelResiduals, pixel_residuals
from boresight.calibration.matching.match_report import NOT_ACCEPTED
from boresight.calibration.matching.matched import Dataset, Matched
from boresight.calibration.matching.rematch import Matches, centroid_sigma_px, cone_rad, given_stars
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation.arcs import ArcSet
from boresight.estimation.attitude import to_quaternion, triad, turns_from
from boresight.sky.catalogue import Catalogue
from boresight.sky.ground import observed_directions
from boresight.sky.guide_stars import phrases
from boresight.sky.matching import EXPOSURE_REASONS, OFF_DETECTOR, ROW_REASONS, STARTS
from boresight.telemetry.quality.detector import on_detector
from boresight.telemetry.schema import Telemetry, select_rows, time_text
from boresight.telemetry.sensors import Sensor
from boresight.telemetry.working_table import find_image

#: Frames on either side that are matched too where a frame alone gives nothing to start from.
NEIGHBOURS = 10


@dataclass(frozen=True)
class State:
    """Parameters to show a frame under.

    `x`: (n_parameters,) SI.
    """

    x: FloatArray
    freedom: FreeCovariance


@dataclass(frozen=True)
class RunStates:
    """What a run's calibration JSON says of its states.

    `P`: (n_free, n_free) covariance of the new ones in typical sigmas.
    """

    sensor: Sensor
    settings: CalibrationSettings
    parameters: Parameters
    old: State
    new: State | None
    P: FloatArray
    noise: float


def read_run_states(result: Calibration, sensor: Sensor, settings: CalibrationSettings) -> RunStates:
    """Read the states of a run."""
    names = CAMERA_MODELS[sensor.camera_model].parameter_names
    wanted = sensor.free if settings.free is None else settings.free
    free = np.array([place for place, name in enumerate(names) if name in wanted], np.int64)
    scale = sensor.typical_sigma[free]
    P = _covariance(result.covariance, [names[place] for place in free], scale, settings.initial_sigma_scale)
    nothing = FreeCovariance(free, scale, np.zeros_like(P))
    # only a batch's covariance is that of this very fit, see `frame_view`
    fitted = nothing if settings.sequential else FreeCovariance(free, scale, _known(result.covariance, P))
    x = _estimate(result, names)
    excess = 1.0 if settings.sequential else max(1.0, result.chi2_per_dof or 1.0)
    return RunStates(
        sensor=sensor,
        settings=settings,
        parameters=Parameters(free, scale),
        old=State(sensor.initial, nothing),
        new=None if x is None else State(x, fitted),
        P=P * excess,
        noise=float(np.sqrt(excess)),
    )


def _estimate(result: Calibration, names: tuple[str, ...]) -> FloatArray | None:
    """The result's parameters, (n_parameters,); None where there are none to show anything under."""
    known = [value for name in names if (value := result.parameters.get(name)) is not None]
    if len(known) < len(names) or result.status == "diverged":
        return None
    return np.array(known, np.float64)


def _covariance(known: Covariance, names: list[str], scale: FloatArray, start: float) -> FloatArray:
    """Covariance of the free parameters in typical sigmas; one that the result does not know is as uncertain as at the start."""
    P = np.eye(len(names)) * start**2
    places = [names.index(name) for name in known.names if name in names]
    if places and len(places) == len(known.names):
        matrix = np.array(known.matrix, np.float64) / np.outer(scale[places], scale[places])
        P[np.ix_(places, places)] = matrix
    return P


def _known(known: Covariance, P: FloatArray) -> FloatArray:
    """The same as far as data decided it; zero where the result leaves a parameter open."""
    return P if len(known.names) == len(P) else np.zeros_like(P)


Read = Callable[[int], tuple[Telemetry, slice]]


@dataclass(frozen=True)
class MatchedFrame:
    """A frame as matched under both states; each is of `rows` of `telemetry`, which may hold neighbours too."""

    telemetry: Telemetry
    rows: slice
    old: Matched
    new: Matched


def match_frame(states: RunStates, read: Read, catalogue: Catalogue, cache_folder: Path | None) -> MatchedFrame:
    """Match a frame under both states, with its neighbours where it cannot be matched alone."""
    found = _matched(states, *read(0), catalogue, cache_folder)
    if not (_rematched(states, found.telemetry) and _lost(found)):
        return found
    return _matched(states, *read(NEIGHBOURS), catalogue, cache_folder)


def _rematched(states: RunStates, telemetry: Telemetry) -> bool:
    """Whether stars are identified again; a file that gives directions but names no stars keeps its own."""
    return states.settings.match == "rematch" and not (telemetry.star_id is None and telemetry.ra_rad is not None)


def _lost(found: MatchedFrame) -> bool:
    """Whether no exposure of the frame is valid under the new state."""
    of_frame = found.new.matches.frame == found.telemetry.frame[found.rows.start]
    return not bool(np.any(found.new.matches.reason[of_frame] == 0))


def _matched(
    states: RunStates, telemetry: Telemetry, rows: slice, catalogue: Catalogue, cache_folder: Path | None
) -> MatchedFrame:
    """Match some frames under both states."""
    settings = states.settings if _rematched(states, telemetry) else replace(states.settings, match="given")
    telemetry = with_directions(telemetry, states.sensor, catalogue)
    sets = Dataset(telemetry, states.sensor, catalogue, states.parameters, settings, cache_folder)
    old = sets.at_start()
    with_old = states.new is None or (settings.sequential and settings.matched_with == "baseline")
    new = old if with_old or states.new is None else sets.at_covariance(states.new.x, states.P, states.noise)
    return MatchedFrame(telemetry, rows, old, new)


USED, LEFT_OUT, REJECTED, UNMATCHED = "used", "left out", "rejected", "unmatched"


@dataclass(frozen=True)
class FrameStars:
    """The detections of a frame in file order; leading dimension n_rows.

    `s_i`: (n_rows, 3) apparent direction, of a rejected star that of the named one.
    """

    star_id: IntArray
    given_id: IntArray
    old_id: IntArray
    s_i: FloatArray
    magnitude: FloatArray
    kept: BoolArray
    fate: list[str]
    reason: list[str | None]
    flags: list[list[str]]


def frame_stars(found: MatchedFrame, sensor: Sensor, catalogue: Catalogue, minimum_stars: int) -> FrameStars:
    """Tell what became of each detection."""
    telemetry, rows, new = found.telemetry, found.rows, found.new
    given, given_s, _ = given_stars(telemetry, catalogue)
    matched = _matched_rows(new)
    star_id = np.where(matched, new.matches.star_id, 0)[rows]
    s_i = np.where(matched[:, None], new.matches.s_i, given_s)[rows]
    off = ~on_detector(telemetry, sensor)[rows]
    used = np.isin(np.arange(rows.start, rows.stop), new.problem.arcs.whole().source_row)
    matched = matched[rows]
    off &= matched | (given[rows] > 0)
    fate = np.select([used, matched | off, given[rows] > 0], [USED, LEFT_OUT, REJECTED], UNMATCHED).tolist()
    few = f"its exposure has fewer than {minimum_stars} usable stars, or they all lie on one line"
    reasons = [
        None if used[k] else ROW_REASONS[OFF_DETECTOR] if off[k] else few if matched[k] else why
        for k, why in enumerate(_why_unmatched(new, given)[rows])
    ]
    return FrameStars(
        star_id=star_id,
        given_id=given[rows],
        old_id=np.where(_matched_rows(found.old), found.old.matches.star_id, 0)[rows],
        s_i=s_i,
        magnitude=_magnitudes(catalogue, np.where(star_id > 0, star_id, given[rows])),
        kept=matched & ~off & np.isfinite(s_i[:, 0]),
        fate=fate,
        reason=reasons,
        flags=[phrases(int(flag)) for flag in _flags(new)[rows]],
    )


def _matched_rows(seen: Matched) -> BoolArray:
    """(n_rows,) which detections have a star that counts: a direction, and not taken out by the flight code's rule."""
    known = np.isfinite(seen.matches.s_i[:, 0])
    if not isinstance(seen.matches, Matches) or seen.telemetry.star_id is None:
        return known
    return np.asarray(known & (seen.telemetry.star_id > 0))


def _magnitudes(catalogue: Catalogue, star_id: IntArray) -> FloatArray:
    """Catalogue magnitudes of stars by number, Hp, NaN where unknown."""
    index = catalogue.find_index(star_id)
    return np.where(index >= 0, catalogue.magnitude[index], np.nan)


def _why_unmatched(seen: Matched, given: IntArray) -> NDArray[np.object_]:
    """(n_rows,) phrases for detections without a star."""
    if isinstance(seen.matches, Matches):
        phrase = np.array(ROW_REASONS, object)[seen.matches.row_reason]
        return np.where(seen.matches.star_id > 0, NOT_ACCEPTED, phrase)
    return np.where(
        given > 0, "no direction: its number is not in the catalogue, or it has no time", "the file gives no star"
    )


def _flags(seen: Matched) -> NDArray[np.int8]:
    """(n_rows,) flags of the matched stars; those of given matches were not looked up."""
    if isinstance(seen.matches, Matches):
        return seen.matches.flags
    return np.zeros(len(seen.telemetry), np.int8)


def exposure_words(seen: Matched, k: int) -> tuple[str, str | None]:
    """Where the attitude of exposure k came from, and why matching does not call it valid, None where it does."""
    if not isinstance(seen.matches, Matches):
        return "given matches", None
    reason = int(seen.matches.reason[k])
    return STARTS[seen.matches.start[k]], EXPOSURE_REASONS[reason] if reason else None


MOST_SHOWN = 60
#: A detection so near to where a star should be is taken for its image, whatever it was matched with.
NEAR_PX = 5.0


def undetected(here: Telemetry, states: RunStates, C: FloatArray, catalogue: Catalogue) -> list[dict[str, Any]]:
    """Stars within the sensor's limit that lie on the detector and have no detection near them, the brightest first.

    `C`: (3, 3) attitude, ICRS to the triad.
    """
    sensor, limit = states.sensor, states.sensor.magnitude_limit
    if here.time_utc is None or np.isnat(here.time_utc[0]) or limit is None:
        return []
    x = (states.new or states.old).x
    star = _in_the_cone(catalogue, C[2], cone_rad(sensor, x), limit)
    velocity = None if here.velocity_m_s is None else np.repeat(here.velocity_m_s[:1], len(star), axis=0)
    time_utc = np.repeat(here.time_utc[:1], len(star))
    s_i = observed_directions(catalogue, star, time_utc, velocity, sensor.site)
    row, col = CAMERA_MODELS[sensor.camera_model].project(x, triad(s_i @ C.T, sensor.parity), sensor.pixel_pitch_m)
    inside = (row >= -0.5) & (row <= sensor.rows - 0.5) & (col >= -0.5) & (col <= sensor.columns - 0.5)
    inside[inside] &= ~_near_a_detection(row[inside], col[inside], here)
    order = np.flatnonzero(inside)[np.argsort(catalogue.magnitude[star[inside]])][:MOST_SHOWN]
    return [
        {
            "star_id": int(catalogue.hip[star[k]]),
            "magnitude": float(catalogue.magnitude[star[k]]),
            "row_px": float(row[k]),
            "col_px": float(col[k]),
        }
        for k in order.tolist()
    ]


def _in_the_cone(catalogue: Catalogue, axis: FloatArray, cone: float, limit: float) -> IntArray:
    """Places in the catalogue of bright stars about an axis; a star moves less than the cone's margin since its epoch."""
    bright = np.flatnonzero(catalogue.magnitude <= limit)
    ra, dec = catalogue.ra_rad[bright], catalogue.dec_rad[bright]
    cosine = np.cos(dec) * (np.cos(ra) * axis[0] + np.sin(ra) * axis[1]) + np.sin(dec) * axis[2]
    return np.asarray(bright[cosine >= np.cos(cone)])


def _near_a_detection(row: FloatArray, col: FloatArray, here: Telemetry) -> NDArray[np.bool_]:
    """(n,) which places have a detection near them."""
    apart = np.hypot(row[:, None] - here.row_px, col[:, None] - here.col_px)
    return np.asarray(apart.min(axis=1) < NEAR_PX)


#: Stars that an attitude needs; the calibration asks for more.
FEWEST = 2
#: Least share of its own error that a star's residual is taken to hold; below, the exposure is the star's own.
LEAST_SHARE = 1e-6
ONE_DIRECTION = "its matched stars lie in one direction, or the field is mirrored: check the sensor's parity"


def frame_view(states: RunStates, read: Read, catalogue: Catalogue, cache_folder: Path | None = None) -> dict[str, Any]:
    """Describe a frame under the old and the new parameters."""
    telemetry, rows = read(0)
    part = select_rows(telemetry, rows)
    head = {
        "frame": int(part.frame[0]),
        "time_utc": time_text(part, 0),
        "temperature_c": None if part.temperature_c is None else known_or_none(part.temperature_c[0]),
        "image": None if (image := find_image(part, 0)) is None else asdict(image),
        "match": states.settings.match,
        "why_no_new": None if states.new is not None else "The run has no parameters to show this frame with.",
    }
    try:
        found = match_frame(states, read, catalogue, cache_folder)
    except RefusedInputError as refusal:
        return head | {"exposures": [], "why_nothing": str(refusal)}
    stars = frame_stars(found, states.sensor, catalogue, states.settings.minimum_stars)
    part = select_rows(found.telemetry, found.rows)
    starts = _starts(part)
    exposures = [_exposure(states, found, part, stars, slice(int(a), int(b)), catalogue) for a, b in pairwise(starts)]
    return head | {"exposures": exposures, "why_nothing": None}


def _starts(part: Telemetry) -> IntArray:
    new = np.flatnonzero(np.diff(part.exposure)) + 1
    return np.concatenate([[0], new, [len(part)]]).astype(np.int64)


def _exposure(
    states: RunStates, found: MatchedFrame, part: Telemetry, stars: FrameStars, rows: slice, catalogue: Catalogue
) -> dict[str, Any]:
    k = int(np.searchsorted(found.new.matches.exposure_start, found.rows.start + rows.start))
    start, why_invalid = exposure_words(found.new, k)
    here = select_rows(part, rows)
    placed = np.flatnonzero(np.isfinite(stars.s_i[rows, 0]))
    kept = stars.kept[rows][placed]
    arcs = _arcs(here, states.sensor, stars.s_i[rows], placed)
    why = _why_none(int(kept.sum()), why_invalid, stars.reason[rows])
    seen = {
        name: None if why or state is None else _residuals(states.sensor, state, arcs, kept)
        for name, state in (("old", states.old), ("new", states.new))
    }
    best = seen["new"] or seen["old"]
    table = [_star(stars, here, states.sensor, rows.start + i, i) for i in range(len(here))]
    for name, state in (("old", states.old), ("new", states.new)):
        view = seen[name]
        if view is not None and state is not None:
            _add_residuals(table, name, placed, arcs, view, states.sensor, state)
    return {
        "exposure": int(here.exposure[0]),
        "time_utc": time_text(here, 0),
        "detections": len(here),
        "matched": int(np.sum(stars.kept[rows])),
        "used": stars.fate[rows].count("used"),
        "start": start,
        "why_invalid": why_invalid,
        "why_no_attitude": why or (None if best else ONE_DIRECTION),
        "attitude": {
            name: None if view is None else _attitude(view, arcs, kept, here, table, name)
            for name, view in seen.items()
        },
        "stars": table,
        "undetected": [] if best is None else undetected(here, states, best.C[0], catalogue),
    }


def _why_none(kept: int, why_invalid: str | None, reasons: list[str | None]) -> str | None:
    """Why an exposure has no attitude, None where it may have one."""
    if kept >= FEWEST:
        return None
    said = why_invalid or next((reason for reason in reasons if reason), None)
    because = f": {said}" if said else ""
    return f"only {kept} of its detections {'is' if kept == 1 else 'are'} matched; an attitude needs {FEWEST}{because}"


def _arcs(here: Telemetry, sensor: Sensor, s_i: FloatArray, placed: IntArray) -> ArcSet:
    """The stars of an exposure that have a direction, in the shape that residuals are taken of; it has no arcs."""
    return ArcSet(
        camera=CAMERA_MODELS[sensor.camera_model],
        pitch=sensor.pixel_pitch_m,
        frame=here.frame[:1],
        frame_start=np.array([0, 1]),
        star_start=np.array([0, len(placed)]),
        row_px=here.row_px[placed],
        col_px=here.col_px[placed],
        sigma_px=centroid_sigma_px(here, sensor)[placed],
        s_i=np.ascontiguousarray(s_i[placed]),
        source_row=placed,
        phi=np.empty(0),
        band=np.empty((0, 5)),
    )


def _residuals(sensor: Sensor, state: State, arcs: ArcSet, kept: NDArray[np.bool_]) -> PixelResiduals | None:
    """Residuals under a state, None where the stars give no attitude."""
    try:
        seen = pixel_residuals(CAMERA_MODELS[sensor.camera_model], state.x, arcs, sensor.parity, state.freedom, kept)
    except np.linalg.LinAlgError:
        return None
    return seen if np.isfinite(seen.C).all() else None


def _star(stars: FrameStars, here: Telemetry, sensor: Sensor, row: int, i: int) -> dict[str, Any]:
    """What is known of a detection without an attitude; `row` is its place in the frame, `i` in the exposure."""
    star_id = int(stars.star_id[row])
    return {
        "row": row,
        "row_px": float(here.row_px[i]),
        "col_px": float(here.col_px[i]),
        "sigma_px": float(centroid_sigma_px(here, sensor)[i]),
        "magnitude": None if here.magnitude is None else known_or_none(here.magnitude[i]),
        "star_id": star_id or None,
        "catalogue_magnitude": known_or_none(stars.magnitude[row]),
        "given_star_id": int(stars.given_id[row]) or None,
        "old_star_id": int(stars.old_id[row]) or None,
        "fate": stars.fate[row],
        "reason": stars.reason[row],
        "flags": stars.flags[row],
        "old": None,
        "new": None,
    }


def _add_residuals(
    table: list[dict[str, Any]],
    name: str,
    placed: IntArray,
    arcs: ArcSet,
    seen: PixelResiduals,
    sensor: Sensor,
    state: State,
) -> None:
    """Put what a state says into the stars that have a place under it."""
    camera = CAMERA_MODELS[sensor.camera_model]
    arcsec = (
        np.linalg.norm(np.linalg.pinv(seen.inverse), axis=1) * ARCSEC_PER_RAD
    )  # (n, 2) of a pixel along rows, columns
    sigma = arcs.sigma_px[:, None] * np.sqrt(np.maximum(np.diagonal(seen.M, axis1=1, axis2=2), LEAST_SHARE))
    predicted = np.column_stack([arcs.row_px, arcs.col_px]) - seen.r
    measured_s = camera.directions(state.x, arcs.row_px, arcs.col_px, arcs.pitch)
    predicted_s = camera.directions(state.x, predicted[:, 0], predicted[:, 1], arcs.pitch)
    apart = 2 * np.arcsin(np.minimum(np.linalg.norm(measured_s - predicted_s, axis=1) / 2, 1.0)) * ARCSEC_PER_RAD
    for j, i in enumerate(placed.tolist()):
        if not np.isfinite(seen.r[j]).all():
            continue
        table[i][name] = {
            "row_px": float(predicted[j, 0]),
            "col_px": float(predicted[j, 1]),
            "d_px": seen.r[j].tolist(),
            "sigma_px": sigma[j].tolist(),
            "d_arcsec": (seen.r[j] * arcsec[j]).tolist(),
            "sigma_arcsec": (sigma[j] * arcsec[j]).tolist(),
            "apart_arcsec": float(apart[j]),
            "normalised": (seen.r[j] / sigma[j]).tolist(),
        }


def _attitude(
    seen: PixelResiduals,
    arcs: ArcSet,
    kept: NDArray[np.bool_],
    here: Telemetry,
    table: list[dict[str, Any]],
    name: str,
) -> dict[str, Any]:
    """An exposure's attitude, in every way of writing it, with its sigmas and its fit."""
    C, P = seen.C[0], seen.attitude_covariance[0]
    quaternion = to_quaternion(C)
    z = (seen.r / arcs.sigma_px[:, None])[kept]
    given = None if here.quaternion is None else here.quaternion[0]
    turn = None
    if given is not None and np.isfinite(given).all():
        turn = (turns_from(given, quaternion[None])[0] * ARCSEC_PER_RAD).tolist()
    return {
        "quaternion": quaternion.tolist(),
        **pointing(C),
        "covariance_rad2": P.tolist(),
        "sigma_arcsec": (np.sqrt(np.diag(P)) * ARCSEC_PER_RAD).tolist(),
        "stars": int(kept.sum()),
        "rms_px": float(np.sqrt(np.mean(seen.r[kept] ** 2))),
        "chi2": float(np.sum(z**2)),
        "dof": 2 * int(kept.sum()) - 3,
        "worst_row": _worst(table, name),
        "from_telemetry_arcsec": turn,
    }


def pointing(C: FloatArray) -> Mapping[str, float]:
    """RA, Dec and roll, degrees, of an attitude C (3, 3), ICRS to the triad; see the top of this file."""
    x, z = C[0], C[2]
    ra, dec = np.arctan2(z[1], z[0]), np.arcsin(np.clip(z[2], -1.0, 1.0))
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    roll = np.arctan2(x @ east, x @ np.cross(z, east))
    return {
        "ra_deg": float(np.degrees(ra) % 360),
        "dec_deg": float(np.degrees(dec)),
        "roll_deg": float(np.degrees(roll) % 360),
    }


def _worst(table: list[dict[str, Any]], name: str) -> int | None:
    """Row of the star that attitudes rest on with the longest normalised residual."""
    sizes = [
        (max(abs(value) for value in star[name]["normalised"]), star["row"])
        for star in table
        if star[name] is not None and star["fate"] in {"used", "left out"}
    ]
    return max(sizes)[1] if sizes else None
