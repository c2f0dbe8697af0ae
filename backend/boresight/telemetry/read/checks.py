"""What a telemetry set must satisfy before any arithmetic; every fault is collected before the set is refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray
from boresight.errors import Fault, RefusedInputError
from boresight.telemetry.read.limits import LIMITS
from boresight.telemetry.schema import Exposures, Telemetry, find_exposures, repeats_within

MOST_FAULTS = 20
#: Faults that are met one by one are not looked for beyond so many: each costs some microseconds.
MOST_COUNTED = 100_000
_MOST_HELD = 50 * MOST_FAULTS


class Faults:
    """Faults of one input in the order of its rows."""

    def __init__(self, subject: str, first_row: int = 1) -> None:
        self.subject = subject
        self.first_row = first_row
        self.count = 0
        self._kept: list[Fault] = []
        self._last: int | None = None  # row from which on a fault is none of the first, once there are enough

    def add(self, detail: str, *, column: str | None = None, row: int | None = None) -> None:
        """Add one fault; `row` as an editor counts."""
        self.count += 1
        if self.count > MOST_COUNTED:
            self.refuse()
        if self._last is None or (row or 0) < self._last:
            self._keep([Fault(row, column, detail)])

    def add_entries(self, wrong: NDArray[np.bool_], column: str | None, detail: Callable[[int], str]) -> None:
        """Add a fault for every entry of the (n,) mask; `detail` writes the sentence of one entry."""
        entries = np.flatnonzero(wrong)
        self.count += len(entries)
        self._keep([Fault(entry + self.first_row, column, detail(entry)) for entry in entries[:MOST_FAULTS].tolist()])

    def absorb(self, other: Faults) -> None:
        """Take over the faults of another collection; at the same row they come after those that are here."""
        self.count += other.count
        self._keep(other._kept)

    def refuse(self) -> None:
        """Raise what was collected, if anything was."""
        if self.count:
            raise self.refusal()

    def refusal(self) -> RefusedInputError:
        """Return what `refuse` raises, of at least one fault."""
        kept = _first(self._kept)
        others = self.count - 1
        more = f" (and {others} more {'fault' if others == 1 else 'faults'})" if others else ""
        return RefusedInputError(f"{self.subject}: {kept[0]}{more}", tuple(kept))

    def _keep(self, faults: list[Fault]) -> None:
        """Hold faults, and of very many only those that can be among the first."""
        self._kept += faults
        if len(self._kept) > _MOST_HELD:
            self._kept = _first(self._kept)
            self._last = self._kept[-1].row or 0


def _first(faults: list[Fault]) -> list[Fault]:
    """Return the first twenty by row; those of one row in the order in which they came."""
    return sorted(faults, key=lambda fault: fault.row or 0)[:MOST_FAULTS]


_QUATERNION_TOLERANCE = 1e-3
_FASTEST_M_S = 100e3
_SIGMA_PX = (1e-6, 1e4)


class Checks:
    """Checks of a set that comes in parts of whole frames.

    Exposures lie within a frame, so a part has all that belongs together; only the order of the frames runs over the seams.
    """

    def __init__(self, subject: str, most_stars: int = LIMITS.stars) -> None:
        self._most_stars = most_stars
        self._order, self._torn, self._others = Faults(subject), Faults(subject), Faults(subject)
        self._last_frame: int | None = None

    @property
    def found(self) -> bool:
        """Whether there is something to refuse."""
        return bool(self._order.count or self._torn.count or self._others.count)

    def look_at(self, telemetry: Telemetry) -> None:
        """Collect every fault of the next part; nothing is raised here."""
        for faults in (self._order, self._torn, self._others):
            faults.first_row = telemetry.first_row
        exposures = find_exposures(telemetry)
        _check_order(telemetry, self._last_frame, self._order)
        self._last_frame = int(telemetry.frame[-1])
        _check_torn(telemetry, exposures, self._torn)
        _check_stars(telemetry, exposures, self._most_stars, self._others)
        _check_repeated_stars(telemetry, exposures, self._others)
        _check_repeated_centroids(telemetry, exposures, self._others)
        with np.errstate(over="ignore"):  # the length of what is beyond all numbers is infinite, and refused
            _check_directions(telemetry, self._others)
            _check_quaternions(telemetry, self._others)
            _check_velocities(telemetry, self._others)
        _check_noise(telemetry, self._others)

    def refuse(self) -> None:
        """Raise what was collected; an exposure counts as torn only where the frames are in order."""
        faults = self._order if self._order.count else self._torn
        faults.absorb(self._others)
        faults.refuse()


def _check_order(telemetry: Telemetry, last_frame: int | None, faults: Faults) -> None:
    """Find frames that descend, also from the last one of the part before."""
    frame = telemetry.frame
    before = np.append(frame[0] if last_frame is None else last_frame, frame[:-1])
    faults.add_entries(
        frame < before,
        "frame",
        lambda entry: f"frame {frame[entry]} follows frame {before[entry]}: sort the rows by frame",
    )


def _check_torn(telemetry: Telemetry, exposures: Exposures, faults: Faults) -> None:
    """Find exposures that are not one run of rows."""
    later, _ = repeats_within(np.zeros(len(exposures), dtype=np.int64), exposures.frame, exposures.exposure)
    torn = np.zeros(len(telemetry), dtype=np.bool_)
    torn[exposures.start[later]] = True
    faults.add_entries(
        torn,
        "exposure",
        lambda entry: (
            f"exposure {telemetry.exposure[entry]} of frame {telemetry.frame[entry]} was interrupted by another: "
            "sort the rows by frame and exposure"
        ),
    )


def _check_stars(telemetry: Telemetry, exposures: Exposures, most: int, faults: Faults) -> None:
    """Find exposures of more detections than can be compared with one another."""
    full = np.zeros(len(telemetry), dtype=np.bool_)
    full[exposures.start[exposures.count > most]] = True
    faults.add_entries(
        full,
        "exposure",
        lambda entry: (
            f"exposure {telemetry.exposure[entry]} of frame {telemetry.frame[entry]} has over {most:,} detections: raise the "
            "detection threshold, or number the exposures"
        ),
    )


def _check_repeated_stars(telemetry: Telemetry, exposures: Exposures, faults: Faults) -> None:
    """Find stars that are seen twice in an exposure."""
    if telemetry.star_id is None:
        return
    matched = np.flatnonzero(telemetry.star_id > 0)
    later, earlier = repeats_within(exposures.of_entry[matched], telemetry.star_id[matched])
    for entry, before in zip(matched[later].tolist(), matched[earlier].tolist(), strict=True):
        faults.add(
            f"star {telemetry.star_id[entry]} is already in row {before + faults.first_row} of this exposure: "
            "leave star_id empty where the match is wrong",
            row=entry + faults.first_row,
            column="star_id",
        )


def _check_repeated_centroids(telemetry: Telemetry, exposures: Exposures, faults: Faults) -> None:
    """Find detections of an exposure in the very same place."""
    later, earlier = repeats_within(exposures.of_entry, telemetry.row_px, telemetry.col_px)
    for entry, before in zip(later.tolist(), earlier.tolist(), strict=True):
        faults.add(
            f"the centroid is that of row {before + faults.first_row} in the same exposure: delete one of the two rows",
            row=entry + faults.first_row,
            column="row_px",
        )


def _check_directions(telemetry: Telemetry, faults: Faults) -> None:
    """Find directions given by half or out of range."""
    ra_rad, dec_rad = telemetry.ra_rad, telemetry.dec_rad
    if ra_rad is None or dec_rad is None:
        return
    _check_together(np.column_stack([ra_rad, dec_rad]), "ra_deg", "ra_deg and dec_deg", faults)
    ra_deg, dec_deg = np.degrees(ra_rad), np.degrees(dec_rad)
    faults.add_entries(
        (ra_deg < -180.0 - 1e-9) | (ra_deg > 360.0 + 1e-9),
        "ra_deg",
        lambda entry: f"{ra_deg[entry]:.9g} is not between -180 and 360: give degrees",
    )
    faults.add_entries(
        np.abs(dec_deg) > 90.0 + 1e-9,
        "dec_deg",
        lambda entry: f"{dec_deg[entry]:.9g} is not between -90 and 90: give degrees",
    )


def _check_quaternions(telemetry: Telemetry, faults: Faults) -> None:
    """Find quaternions given in part or not of unit length."""
    if telemetry.quaternion is None:
        return
    _check_together(telemetry.quaternion, "q_x", "q_x, q_y, q_z and q_w", faults)
    length = np.linalg.norm(telemetry.quaternion, axis=1)
    faults.add_entries(
        np.abs(length - 1.0) > _QUATERNION_TOLERANCE,
        "q_x",
        lambda entry: f"the quaternion's length is {length[entry]:.6g}, not 1: give a unit quaternion x, y, z, w",
    )


def _check_velocities(telemetry: Telemetry, faults: Faults) -> None:
    """Find velocities given in part or in metres per second."""
    if telemetry.velocity_m_s is None:
        return
    _check_together(telemetry.velocity_m_s, "vx_km_s", "vx_km_s, vy_km_s and vz_km_s", faults)
    speed = np.linalg.norm(telemetry.velocity_m_s, axis=1)
    faults.add_entries(
        speed > _FASTEST_M_S,
        "vx_km_s",
        lambda entry: f"the speed is {speed[entry] / 1e3:.6g} km/s: give kilometres a second, not metres",
    )


def _check_noise(telemetry: Telemetry, faults: Faults) -> None:
    """Find standard deviations that are none of a centroid's; of less, or more, no weight can be computed."""
    sigma_px = telemetry.sigma_px
    if sigma_px is None:
        return
    faults.add_entries(
        sigma_px <= 0.0,
        "sigma_px",
        lambda entry: f"{sigma_px[entry]:g} is not positive: give the standard deviation, or leave it empty",
    )
    low, high = _SIGMA_PX
    faults.add_entries(
        (sigma_px > 0.0) & ((sigma_px < low) | (sigma_px > high)),
        "sigma_px",
        lambda entry: (
            f"{sigma_px[entry]:g} is not between {low:g} and {high:g} pixels: check its unit, or leave it empty"
        ),
    )


def _check_together(values: FloatArray, column: str, group: str, faults: Faults) -> None:
    """Refuse rows of the (n_rows, n_columns) values that are given in part."""
    absent = np.isnan(values)
    given = absent.shape[1] - np.count_nonzero(absent, axis=1)
    partial = (given > 0) & (given < absent.shape[1])
    faults.add_entries(partial, column, lambda _: f"give all of {group}, or leave all empty")
