"""One frame of a run: every detection with its star, where each parameter set puts that star, and the attitude of each exposure.

The residual is centroid minus projection under the exposure's best attitude at those parameters (`pixel_residuals`), so each set of
parameters is judged at its best. Its sigma is that of centroid noise alone, what is left of it after the attitude took its
part and, under a batch's new parameters, after the parameters took theirs; a filter's covariance is not that of this fit, so
there the second part, below 1 % in a set of a hundred frames, stays in. Under the old parameters normalised residuals are
large by as much as these are wrong.

Attitude conventions: `quaternion` is x y z w, Hamilton, ICRS to the right-handed detector triad (`boresight`); RA and Dec are of
the boresight, the z axis; roll is the position angle of the x axis (increasing rows) there, from north through east; sigmas
are about the axes x, y, z of the triad, from centroid noise at these parameters.

Catalogue stars that an exposure should show and did not: projected by its attitude under the run's parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.evaluation.pixel_residuals import PixelResiduals, pixel_residuals
from boresight.calibration.frames.frame_stars import FrameStars, exposure_words, frame_stars
from boresight.calibration.frames.frame_states import MatchedFrame, Read, RunStates, State, match_frame
from boresight.calibration.matching.detections import centroid_sigma_px, cone_rad
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation.arcs import ArcSet
from boresight.estimation.attitude import to_quaternion, triad, turns_from
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry, select_rows
from boresight.telemetry.sensors import Sensor

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
    s_i = apparent_directions(catalogue, star, np.repeat(here.time_utc[:1], len(star)), velocity)
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


ARCSEC = float(np.degrees(1.0) * 3600)
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
        "time_utc": _time(part, 0),
        "temperature_c": None if part.temperature_c is None else _number(part.temperature_c[0]),
        "match": states.settings.match,
        "why_no_new": None
        if states.new is not None
        else "The run has no parameters of its own to show this frame under.",
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
    """First row of each exposure, and the end."""
    new = np.flatnonzero(np.diff(part.exposure)) + 1
    return np.concatenate([[0], new, [len(part)]]).astype(np.int64)


def _time(part: Telemetry, row: int) -> str | None:
    """When a row was taken, ISO 8601."""
    if part.time_utc is None or np.isnat(part.time_utc[row]):
        return None
    return f"{part.time_utc[row]}Z"


def _number(value: Any) -> float | None:
    """A number, or null."""
    return float(value) if np.isfinite(value) else None


def _exposure(
    states: RunStates, found: MatchedFrame, part: Telemetry, stars: FrameStars, rows: slice, catalogue: Catalogue
) -> dict[str, Any]:
    """Describe one exposure, rows of the frame."""
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
        "time_utc": _time(here, 0),
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
    return f"{kept} of its detections {'is' if kept == 1 else 'are'} matched and an attitude needs {FEWEST}{because}"


def _arcs(here: Telemetry, sensor: Sensor, s_i: FloatArray, placed: IntArray) -> ArcSet:
    """The stars of an exposure that have a direction, in the shape that residuals are taken of; it has no arcs."""
    return ArcSet(
        model=CAMERA_MODELS[sensor.camera_model].kernel,
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
        "magnitude": None if here.magnitude is None else _number(here.magnitude[i]),
        "star_id": star_id or None,
        "catalogue_magnitude": _number(stars.magnitude[row]),
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
    arcsec = np.linalg.norm(np.linalg.pinv(seen.inverse), axis=1) * ARCSEC  # (n, 2) of a pixel along rows, columns
    sigma = arcs.sigma_px[:, None] * np.sqrt(np.maximum(np.diagonal(seen.M, axis1=1, axis2=2), LEAST_SHARE))
    predicted = np.column_stack([arcs.row_px, arcs.col_px]) - seen.r
    measured_s = camera.directions(state.x, arcs.row_px, arcs.col_px, arcs.pitch)
    predicted_s = camera.directions(state.x, *predicted.T, arcs.pitch)
    apart = 2 * np.arcsin(np.minimum(np.linalg.norm(measured_s - predicted_s, axis=1) / 2, 1.0)) * ARCSEC
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
        turn = (turns_from(given, quaternion[None])[0] * ARCSEC).tolist()
    return {
        "quaternion": quaternion.tolist(),
        **pointing(C),
        "covariance_rad2": P.tolist(),
        "sigma_arcsec": (np.sqrt(np.diag(P)) * ARCSEC).tolist(),
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
