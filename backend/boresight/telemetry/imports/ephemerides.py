"""Velocity from two-line elements or an OEM, attitude from an AEM: what telemetry lacks and flight dynamics has.

Two-line elements are propagated by SGP4 (the library `sgp4`), whose frame TEME has the true equator of date and the mean equinox:

    v_GCRS = NPB^T R_3(-E) v_TEME        NPB = `erfa.pnm06a`, E = equation of the equinoxes, `erfa.ee06a`

and both turn so slowly that they are taken once an hour. An OEM gives velocities at its epochs; between them runs a cubic spline
of each component, never over the seam of two segments. What the spline is worth is measured on the file: a spline through every
second state misses those left out by e, and one through all by about e / 16.

CCSDS quaternions turn axes: the matrix M(q) of 504.0-B has M_12 = 2 (q_1 q_2 + q_3 q_c), so that they are the conjugates of
Hamilton's, which are used here. Attitudes in between are interpolated at a constant rate (slerp).

The key-value form (KVN) of both messages is read here, and no other: of the readers on PyPI `oem` (MIT) knows no AEM, and
`ccsds-ndm` is under the GPL. References: CCSDS 502.0-B-3, CCSDS 504.0-B-2; Vallado et al., AIAA 2006-6753.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import erfa
import numpy as np

from boresight.arrays import DAY_US, BoolArray, FloatArray, TimeArray
from boresight.errors import Fault, RefusedInputError
from boresight.estimation.attitude import conjugate
from boresight.telemetry.imports.times import parse_times, utc_to_tai
from boresight.telemetry.read.compression import expanded, first_bytes
from boresight.telemetry.read.formats import read_bytes, read_text
from boresight.telemetry.read.limits import LIMITS

if TYPE_CHECKING:
    from sgp4.api import Satrec

MOST_BYTES, MOST_LINES = 64_000_000, 1_000_000
#: Days between elements and the stars beyond which the file is taken for a wrong one; what SGP4 loses along the track in a day.
OLDEST_ELEMENTS_DAYS, LOST_M_S_PER_DAY = 30.0, 3.0
_INERTIAL = ("EME2000", "ICRF", "GCRF", "J2000", "GCRS", "ICRS")
_LINE_1, _LINE_2 = re.compile(r"^1 [ 0-9A-Z]{5}[A-Z ] "), re.compile(r"^2 [ 0-9A-Z]{5} ")
_HOUR = np.timedelta64(1, "h")
_FASTEST_KM_S = 299_792.458


@dataclass(frozen=True)
class Orbit:
    """A satellite's velocity over time.

    `covers`: from when until when. `velocity`: (n,) UTC to (n, 3) GCRS, metres a second, and the (n,) mask of times it covers.
    """

    name: str
    covers: tuple[np.datetime64, np.datetime64]
    velocity: Callable[[TimeArray], tuple[FloatArray, BoolArray]]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Attitudes:
    """Quaternions over time, Hamilton, ICRS to the frame of a body.

    `time_utc`: (n,), ascending. `quaternion`: (n, 4). `segment`: (n,) stretches over whose seams nothing is interpolated.
    `longest_gap_s`: between two that are interpolated; None where the file says itself how.
    """

    name: str
    time_utc: TimeArray
    quaternion: FloatArray
    segment: np.ndarray
    longest_gap_s: float | None = None

    def at(self, time_utc: TimeArray) -> FloatArray:
        """Return (n, 4) at (n,) times, NaN where there is none."""
        found = np.full((len(time_utc), 4), np.nan)
        if not len(self.time_utc):
            return found
        after = np.searchsorted(self.time_utc, time_utc, side="left")
        exact = (after < len(self.time_utc)) & (self.time_utc[np.minimum(after, len(self.time_utc) - 1)] == time_utc)
        found[exact] = self.quaternion[after[exact]]
        between = np.flatnonzero((after > 0) & (after < len(self.time_utc)) & ~exact & ~np.isnat(time_utc))
        a, b = after[between] - 1, after[between]
        gap_us = (self.time_utc[b] - self.time_utc[a]).astype(np.int64)
        near = self.segment[a] == self.segment[b]
        if self.longest_gap_s is not None:
            near &= gap_us <= self.longest_gap_s * 1e6
        share = (time_utc[between] - self.time_utc[a]).astype(np.int64) / np.maximum(gap_us, 1)
        found[between[near]] = slerp(self.quaternion[a], self.quaternion[b], share)[near]
        return found


def slerp(p: FloatArray, q: FloatArray, share: FloatArray) -> FloatArray:
    """Return (n, 4) rotations at (n,) shares of the way from p to q, at a constant rate over the shorter way."""
    cosine = np.sum(p * q, axis=-1)
    q, cosine = np.where(cosine[:, None] < 0, -q, q), np.abs(cosine)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    small = angle < 1e-8
    sine = np.where(small, 1.0, np.sin(angle))
    first = np.where(small, 1 - share, np.sin((1 - share) * angle) / sine)
    second = np.where(small, share, np.sin(share * angle) / sine)
    mixed = first[:, None] * p + second[:, None] * q
    return np.asarray(mixed / np.linalg.norm(mixed, axis=-1, keepdims=True))


def read_orbit(path: Path, name: str) -> Orbit:
    """Read two-line elements or an OEM, told apart by their first lines."""
    lines = _read_lines(path, name)
    if any(line.startswith("CCSDS_OEM_VERS") for line in lines[:20]):
        return _read_oem(name, lines)
    for first, second in pairwise(lines):
        if _LINE_1.match(first) and _LINE_2.match(second):
            return _read_elements(name, first, second)
    raise RefusedInputError(
        f"{name} is neither two-line elements nor an OEM in key-value form: give one of them as the orbit."
    )


def is_aem(path: Path) -> bool:
    """Say whether a file calls itself an AEM, also one that is compressed by gzip."""
    return path.is_file() and b"CCSDS_AEM_VERS" in first_bytes(path, 4096)


def _read_lines(path: Path, name: str) -> list[str]:
    with expanded(path, name, LIMITS) as place:
        return _read_expanded(place, name)


def _read_expanded(path: Path, name: str) -> list[str]:
    if path.is_file() and path.stat().st_size > MOST_BYTES:
        raise RefusedInputError(f"{name} is over {MOST_BYTES / 1e6:,.0f} MB: give the part that covers the telemetry.")
    lines = read_text(name, read_bytes(path, name)).decode().split("\n")
    if len(lines) > MOST_LINES:
        raise RefusedInputError(f"{name} has over {MOST_LINES:,} lines: give the part that covers the telemetry.")
    return lines


def _read_elements(name: str, first: str, second: str) -> Orbit:
    from sgp4.api import Satrec  # noqa: PLC0415 - loaded with the first elements
    from sgp4.io import verify_checksum  # noqa: PLC0415 - as above

    try:
        verify_checksum(first.rstrip(), second.rstrip())
        satellite = Satrec.twoline2rv(first.rstrip(), second.rstrip())
    except ValueError as error:
        raise RefusedInputError(
            f"{name}: the two-line elements cannot be read ({error}): copy both lines completely."
        ) from error
    epoch = np.datetime64("1949-12-31T00:00:00", "us") + np.timedelta64(
        round((satellite.jdsatepoch - 2433281.5) * DAY_US), "us"
    )
    epoch = epoch + np.timedelta64(round(satellite.jdsatepochF * DAY_US), "us")
    reach = np.timedelta64(round(OLDEST_ELEMENTS_DAYS * DAY_US), "us")

    def velocity(time_utc: TimeArray) -> tuple[FloatArray, BoolArray]:
        near = np.asarray(np.abs(time_utc - epoch) <= reach)  # false of NaT
        found = np.full((len(time_utc), 3), np.nan)
        if near.any():
            found[near] = _propagated(satellite, time_utc[near])
        return found, near

    note = (
        f"Velocity by SGP4 from elements of {str(epoch)[:19]}Z; its error grows by about {LOST_M_S_PER_DAY:g} m/s per day "
        "between the elements and the observations (2 mas of aberration)."
    )
    return Orbit(name, (epoch - reach, epoch + reach), velocity, (note,))


def _propagated(satellite: Satrec, time_utc: TimeArray) -> FloatArray:
    """Return (n, 3) velocities in GCRS, metres a second."""
    known, place = np.unique(time_utc, return_inverse=True)
    days = (known - np.datetime64("2000-01-01T00:00:00", "us")).astype(np.int64)
    jd, fraction = 2451544.5 + days // 86_400_000_000, (days % 86_400_000_000) / DAY_US
    error, _, km_s = satellite.sgp4_array(jd.astype(np.float64), fraction)
    km_s[error != 0] = np.nan
    return np.asarray((teme_to_gcrs(km_s, known) * 1e3)[place])


def teme_to_gcrs(vector: FloatArray, time_utc: TimeArray) -> FloatArray:
    """Turn (n, 3) vectors of true equator and mean equinox of (n,) UTC into GCRS."""
    hours, place = np.unique(time_utc.astype("datetime64[h]"), return_inverse=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        days = (
            utc_to_tai((hours + _HOUR / 2).astype("datetime64[us]")) - np.datetime64("2000-01-01T12:00:00", "us")
        ).astype(np.int64) / DAY_US + 32.184 / 86400
        to_true, equinoxes = erfa.pnm06a(2451545.0, days), erfa.ee06a(2451545.0, days)
    turns = np.stack([erfa.rz(-angle, np.eye(3)) for angle in np.atleast_1d(equinoxes)])
    matrices = np.swapaxes(to_true, -1, -2) @ turns
    return np.asarray(np.einsum("nij,nj->ni", matrices[place], vector))


@dataclass
class Segment:
    """A segment of a CCSDS message: its metadata, and its lines of data with their rows."""

    metadata: dict[str, str] = field(default_factory=dict)
    data: list[tuple[int, list[str]]] = field(default_factory=list)


def _segments(name: str, lines: list[str]) -> Iterator[Segment]:  # noqa: C901 - one branch a keyword of the form
    """Yield the segments of an OEM or AEM in key-value form."""
    segment, is_metadata, is_covariance = Segment(), False, False
    for row, line in enumerate(lines, start=1):
        text = line.strip()
        if not text or text.startswith("COMMENT"):
            continue
        match text:
            case "META_START":
                if segment.metadata:
                    yield segment
                segment, is_metadata, is_covariance = Segment(), True, False
            case "META_STOP":
                is_metadata = False
            case "COVARIANCE_START" | "COVARIANCE_STOP":
                is_covariance = text.endswith("START")
            case "DATA_START" | "DATA_STOP":
                pass
            case _ if "=" in text:
                if is_metadata:
                    key, _, value = text.partition("=")
                    segment.metadata[key.strip()] = value.strip()
            case _ if segment.metadata and not is_metadata and not is_covariance:
                segment.data.append((row, text.split()))
            case _ if not is_covariance:
                fault = Fault(row, None, "is neither KEY = value nor data of a segment")
                raise RefusedInputError(f"{name}: {fault}: give the message in key-value form.", (fault,))
    if not segment.metadata:
        raise RefusedInputError(f"{name} has no segment: give the message in key-value form, with META_START.")
    yield segment


def _numbers(name: str, segment: Segment, least: int) -> tuple[TimeArray, FloatArray]:
    """Return a segment's (n,) times and the first numbers (n, least) of its lines."""
    moments = parse_times([cells[0] for _, cells in segment.data], segment.metadata.get("TIME_SYSTEM", ""), name)
    values = np.full((len(segment.data), least), np.nan)
    for place, (_, cells) in enumerate(segment.data):
        with suppress(ValueError):  # a word, or too few of them
            values[place] = [float(cell) for cell in cells[1 : least + 1]]
    wrong = np.flatnonzero(np.isnat(moments) | ~np.isfinite(values).all(axis=1))
    if len(wrong):
        fault = Fault(segment.data[wrong[0]][0], None, f"does not contain a time and {least} numbers")
        raise RefusedInputError(f"{name}: {fault}: correct the line.", (fault,))
    early = np.flatnonzero(moments[1:] <= moments[:-1]) + 1
    if len(early):
        fault = Fault(
            segment.data[early[0]][0], None, f"{moments[early[0]]} does not come after {moments[early[0] - 1]}"
        )
        raise RefusedInputError(f"{name}: {fault}: sort the segment by time.", (fault,))
    if len(moments) < 2:
        raise RefusedInputError(f"{name} has a segment of fewer than two lines: give the complete message.")
    return moments, values


def _span(name: str, metadata: Mapping[str, str], time_utc: TimeArray) -> tuple[np.datetime64, np.datetime64]:
    """Return from when until when a segment may be used."""
    system = metadata.get("TIME_SYSTEM", "")
    begins, ends = time_utc[0], time_utc[-1]
    if "USEABLE_START_TIME" in metadata:
        begins = max(begins, _moment(metadata["USEABLE_START_TIME"], system, name))
    if "USEABLE_STOP_TIME" in metadata:
        ends = min(ends, _moment(metadata["USEABLE_STOP_TIME"], system, name))
    return begins, ends


def _moment(text: str, system: str, name: str) -> np.datetime64:
    """Return the one time of a member of the metadata."""
    moment: np.datetime64 = parse_times([text], system, name)[0]
    if np.isnat(moment):
        raise RefusedInputError(f"{name}: {text} is not a time: write it as 2026-03-01T12:00:00.")
    return moment


def _read_oem(name: str, lines: list[str]) -> Orbit:
    pieces = [_piece(name, segment) for segment in _segments(name, lines)]
    covers = min(piece.begins for piece in pieces), max(piece.ends for piece in pieces)

    def velocity(time_utc: TimeArray) -> tuple[FloatArray, BoolArray]:
        found, covered = np.full((len(time_utc), 3), np.nan), np.zeros(len(time_utc), dtype=np.bool_)
        for piece in pieces:
            inside = (time_utc >= piece.begins) & (time_utc <= piece.ends) & ~covered
            found[inside] = piece.at(time_utc[inside])
            covered |= inside
        return found, covered

    worth = max(piece.sigma_m_s for piece in pieces)
    first, last = (str(moment)[:19] for moment in covers)
    note = f"Velocity from the OEM between {first}Z and {last}Z, interpolated to about {worth:.2g} m/s."
    return Orbit(name, covers, velocity, (note,))


@dataclass(frozen=True)
class _Piece:
    """A segment of an OEM: velocities in GCRS by seconds since its first epoch."""

    begins: np.datetime64
    ends: np.datetime64
    origin: np.datetime64
    seconds: FloatArray
    m_s: FloatArray

    def at(self, time_utc: TimeArray) -> FloatArray:
        """Return (n, 3) velocities at times inside."""
        return _spline(self.seconds, self.m_s, (time_utc - self.origin).astype(np.int64) / 1e6)

    @property
    def sigma_m_s(self) -> float:
        """How far the spline may be off, told by every second state."""
        if len(self.seconds) < 5:
            return float(np.max(np.linalg.norm(np.diff(self.m_s, axis=0), axis=1)))
        missed = _spline(self.seconds[::2], self.m_s[::2], self.seconds[1:-1:2]) - self.m_s[1:-1:2]
        return float(np.max(np.linalg.norm(missed, axis=1))) / 16


def _spline(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - loaded with the first OEM

    return np.asarray(CubicSpline(x, y)(at))


def _piece(name: str, segment: Segment) -> _Piece:
    metadata = segment.metadata
    if metadata.get("CENTER_NAME", "").upper() not in {"EARTH", "EARTH BARYCENTER"}:
        raise RefusedInputError(
            f"{name} is about {metadata.get('CENTER_NAME', 'no body')}: give velocities about the Earth, CENTER_NAME = EARTH."
        )
    frame = metadata.get("REF_FRAME", "").upper()
    if frame not in {*_INERTIAL, "TEME"}:
        raise RefusedInputError(
            f"{name}: REF_FRAME {frame or 'is missing'}: velocities are read in {', '.join(_INERTIAL)} or TEME: write the OEM in "
            "one of these, because velocities in a rotating frame do not give aberration."
        )
    time_utc, states = _numbers(name, segment, 6)
    fast = np.any(np.abs(states[:, 3:]) > _FASTEST_KM_S, axis=1)
    if np.any(fast):
        fault = Fault(segment.data[int(np.argmax(fast))][0], None, "has a velocity above that of light")
        raise RefusedInputError(f"{name}: {fault}: write velocities in km/s.", (fault,))
    m_s = states[:, 3:] * 1e3
    m_s = teme_to_gcrs(m_s, time_utc) if frame == "TEME" else m_s
    begins, ends = _span(name, metadata, time_utc)
    return _Piece(begins, ends, time_utc[0], (time_utc - time_utc[0]).astype(np.int64) / 1e6, m_s)


def read_aem(path: Path, name: str, longest_gap_s: float) -> Attitudes:
    """Read an AEM whose attitudes are quaternions between an inertial frame and a body."""
    moments, quaternions, numbers, is_told = [], [], [], True
    for number, segment in enumerate(_segments(name, _read_lines(path, name))):
        metadata = segment.metadata
        kind = metadata.get("ATTITUDE_TYPE", "").upper()
        if not kind.startswith("QUATERNION"):
            raise RefusedInputError(f"{name}: ATTITUDE_TYPE {kind or 'is missing'}: write it as QUATERNION.")
        time_utc, values = _numbers(name, segment, 4)
        begins, ends = _span(name, metadata, time_utc)
        inside = (time_utc >= begins) & (time_utc <= ends)
        q = values if metadata.get("QUATERNION_TYPE", "LAST").upper() == "LAST" else values[:, [1, 2, 3, 0]]
        lengths = np.linalg.norm(q, axis=1)
        if np.any(np.abs(lengths - 1) > 0.01):
            row = segment.data[int(np.argmax(np.abs(lengths - 1)))][0]
            raise RefusedInputError(
                f"{name}: row {row}: the quaternion's length is {np.max(lengths):.4g}, not 1: correct it."
            )
        q = q / lengths[:, None]
        moments.append(time_utc[inside])
        quaternions.append((conjugate(q) if _leads_to_body(name, metadata) else q)[inside])
        numbers.append(np.full(int(np.count_nonzero(inside)), number))
        is_told = is_told and "INTERPOLATION_METHOD" in metadata
    time_utc = np.concatenate(moments)
    order = np.argsort(time_utc, kind="stable")
    return Attitudes(
        name, time_utc[order], np.concatenate(quaternions)[order], np.concatenate(numbers)[order],
        None if is_told else longest_gap_s,
    )  # fmt: skip


def _leads_to_body(name: str, metadata: Mapping[str, str]) -> bool:
    """Say whether a segment's rotations lead from the inertial frame to the body."""
    first, second = metadata.get("REF_FRAME_A", "").upper(), metadata.get("REF_FRAME_B", "").upper()
    if (first in _INERTIAL) == (second in _INERTIAL):
        raise RefusedInputError(
            f"{name}: REF_FRAME_A {first or 'is missing'} and REF_FRAME_B {second or 'is missing'}: write one of them as "
            f"{' or '.join(_INERTIAL)}, the other as a body."
        )
    return (first in _INERTIAL) == (metadata.get("ATTITUDE_DIR", "A2B").upper() == "A2B")
