"""A plan of pointings as a document, from a sensor, what is known of it, and what the plan has to keep."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation.statistics.observability import WEAK, observability
from boresight.simulation.pointings import (
    MEASURES,
    Candidates,
    Constraints,
    Criterion,
    Plan,
    exposure_information,
    plan_pointings,
    spread_over_sky,
)

if TYPE_CHECKING:
    import pyarrow as pa

    from boresight.calibration.calibration import Calibration
    from boresight.sky.catalogue import Catalogue
    from boresight.telemetry.sensors import Sensor

#: Pointings over the sky and rolls of each, where no list of candidates is given.
POINTINGS, ROLLS = 600, 8
CANDIDATE_COLUMNS = ("ra_deg", "dec_deg", "roll_deg")
MOST_CANDIDATES, MOST_MINUTES = 50_000, 1440.0


@dataclass(frozen=True, kw_only=True)
class Pointing:
    """One pointing of a plan: when its dwell begins, the turn before it, where it looks, and how many stars it sees.

    `roll_deg`: angle from celestial north to the axis of rows, positive towards east. `quaternion`: ICRS to the right-handed
    triad (rows, columns, boresight), scalar last. `weakest`: one sigma of the weakest direction after it, in typical sigmas.
    """

    start_utc: str
    slew_s: float
    dwell_s: float
    ra_deg: float
    dec_deg: float
    roll_deg: float
    quaternion: list[float]
    stars: int
    weakest: float


@dataclass(frozen=True, kw_only=True)
class PointingPlan:
    """What to observe next: `pointings` in order, and what a calibration of them will know.

    `sigma_before`, `sigma_after`: one sigma of each free parameter, SI; None before where nothing is known. `minutes_to_gate`:
    until every direction is known to half a typical sigma, the gate's limit; None where the plan does not reach it.
    """

    sensor: str
    criterion: Criterion
    start_utc: str
    minutes: float
    candidates: int
    pointings: list[Pointing]
    sigma_before: dict[str, float | None]
    sigma_after: dict[str, float]
    weakest_before: float
    weakest_after: float
    minutes_to_gate: float | None
    sentence: str
    schema: str = field(default="boresight.plan/1", init=False)

    def to_dict(self) -> dict[str, Any]:
        """Return the document that `boresight plan --json` writes."""
        return {"schema": self.schema} | asdict(self)

    def to_table(self) -> pa.Table:
        """Return the pointings as a table, a row each."""
        import pyarrow as pa  # noqa: PLC0415 - loaded where a plan is written

        rows = [asdict(one) for one in self.pointings]
        for row in rows:
            row |= dict(zip(("q_x", "q_y", "q_z", "q_w"), row.pop("quaternion"), strict=True))
        names = ("start_utc", "slew_s", "dwell_s", *CANDIDATE_COLUMNS, "q_x", "q_y", "q_z", "q_w", "stars", "weakest")
        return pa.table({name: [row[name] for row in rows] for name in names})

    def to_csv(self) -> bytes:
        """Return the pointings as CSV."""
        import pyarrow as pa  # noqa: PLC0415 - as above
        from pyarrow import csv  # noqa: PLC0415 - as above

        sink = pa.BufferOutputStream()
        csv.write_csv(self.to_table(), sink, csv.WriteOptions(quoting_style="needed"))
        return bytes(sink.getvalue())


def parse_candidates(angles_deg: Sequence[FloatArray], named: Callable[[int], str]) -> Candidates:
    """Return attitudes by their columns of degrees; refuses what is no angle, at the place that `named` says of its index."""
    angles = []
    for column, values, most in zip(CANDIDATE_COLUMNS, angles_deg, (360.0, 90.0, 360.0), strict=True):
        wrong = np.flatnonzero(~(np.abs(values) <= most))
        if len(wrong):
            raise RefusedInputError(
                f"{named(int(wrong[0]))}: {column} is {values[wrong[0]]:g}: write degrees within ±{most:g}."
            )
        angles.append(np.radians(values))
    return Candidates(*angles)


def check_constraints(constraints: Constraints) -> None:
    """Refuse times, rates and angles that make no plan, naming the first."""
    limits = {
        "minutes": (0.1, MOST_MINUTES),
        "dwell_s": (0.1, 86_400.0),
        "exposure_s": (0.01, constraints.dwell_s),
        "slew_deg_s": (1e-3, 90.0),
        "settle_s": (0.0, 3_600.0),
        "sun_deg": (0.0, 120.0),
        "moon_deg": (0.0, 120.0),
        "earth_deg": (0.0, 90.0),
        "visits": (1, 1_000),
    }
    for name, (low, high) in limits.items():
        value = getattr(constraints, name)
        if not low <= value <= high:
            raise RefusedInputError(f"{name} is {value:g}: choose {low:g} to {high:g}.")


def make_plan(
    sensor: Sensor,
    known: Calibration | None,
    candidates: Candidates | None,
    constraints: Constraints,
    criterion: str,
    catalogue: Catalogue,
) -> PointingPlan:
    """Plan pointings for a sensor; `known`: what was calibrated before."""
    check_constraints(constraints)
    if criterion not in MEASURES:
        raise RefusedInputError(f"There is no criterion {criterion[:20]!r}: choose D or A.")
    camera = CAMERA_MODELS[sensor.camera_model]
    names = sensor.free if known is None else tuple(known.covariance.names)
    x, A_0 = _known(sensor, known, names)
    free = np.array([camera.parameter_names.index(name) for name in names])
    candidates = candidates or spread_over_sky(POINTINGS, ROLLS)
    scale = sensor.typical_sigma[free]
    A_1, stars = exposure_information(candidates, sensor, x, free, scale, catalogue)
    plan = plan_pointings(candidates, A_1, A_0, constraints, "D" if criterion == "D" else "A")
    if not len(plan.place):
        raise RefusedInputError(
            "No candidate pointing can be observed: each is too near the Sun, the Moon or the Earth, has too few stars, or takes "
            "longer "
            "than the available time: give smaller angles, more minutes, or other candidates."
        )
    return _write(sensor, names, scale, candidates, stars, constraints, criterion, plan, known=known is not None)


def _known(sensor: Sensor, known: Calibration | None, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the state where information is taken, and what is known before (n_free, n_free), in typical sigmas."""
    camera = CAMERA_MODELS[sensor.camera_model]
    if known is None:
        # without distortion, tilt and decentring, principal point and tilt are one rotation: a real lens has some of each
        neutral = np.array([one.neutral or 0.0 for one in camera.parameters])
        x = np.where(sensor.initial == neutral, sensor.initial + sensor.typical_sigma, sensor.initial)
        return x, np.eye(len(names)) / CalibrationSettings().initial_sigma_scale ** 2
    if known.camera_model != sensor.camera_model or not known.is_usable:
        raise RefusedInputError(
            f"The calibration uses {known.camera_model} and ended {known.status}: give a converged calibration with "
            f"{sensor.camera_model}."
        )
    scale = sensor.typical_sigma[[camera.parameter_names.index(name) for name in names]]
    x = np.array([known.parameters[name] for name in camera.parameter_names])
    P = np.array(known.reliable_covariance, np.float64) / np.outer(scale, scale)
    return x, np.asarray(np.linalg.inv(P))


def _say_when_below(to_gate: float | None) -> str:
    """Say when the weakest direction is below the gate's limit, in minutes; nothing where it is not."""
    if to_gate is None:
        return ""
    return f" and is below the gate limit of {WEAK:g} {f'after {to_gate:.1f} minutes' if to_gate else 'from the beginning'}"


def _write(  # noqa: PLR0913 - what a plan is written from
    sensor: Sensor,
    names: tuple[str, ...],
    scale: FloatArray,
    candidates: Candidates,
    stars: IntArray,
    constraints: Constraints,
    criterion: str,
    plan: Plan,
    *,
    known: bool,
) -> PointingPlan:
    start = constraints.start_utc.astype("datetime64[ms]")
    begins = start + np.round(plan.start_s * 1e3).astype("timedelta64[ms]")
    weakest, sigma, at = plan.weakest, plan.sigma * scale, plan.place
    good = np.flatnonzero(weakest[1:] <= WEAK)
    to_gate = float(plan.start_s[good[0]] + constraints.dwell_s) / 60.0 if len(good) else None
    if weakest[0] <= WEAK:
        to_gate = 0.0
    took = float(plan.start_s[-1] + constraints.dwell_s) / 60.0
    symbols = CAMERA_MODELS[sensor.camera_model].symbols
    places = [CAMERA_MODELS[sensor.camera_model].parameter_names.index(name) for name in names]
    seen = observability(plan.A[-1], names, tuple(symbols[place] for place in places))
    sentence = (
        f"{len(at)} pointings in {took:.1f} minutes; the weakest direction improves from "
        f"{weakest[0]:.2g} to {weakest[-1]:.2g} typical sigmas"
        f"{_say_when_below(to_gate)}. Weakest at the end: {seen.sentence(len(names) - 1)}"
    )
    pointings = [
        Pointing(
            start_utc=f"{begins[k]}Z",
            slew_s=float(plan.slew_s[k]),
            dwell_s=constraints.dwell_s,
            ra_deg=float(np.degrees(candidates.ra_rad[place])),
            dec_deg=float(np.degrees(candidates.dec_rad[place])),
            roll_deg=float(np.degrees(candidates.roll_rad[place])),
            quaternion=candidates.quaternion[place].tolist(),
            stars=int(stars[place]),
            weakest=float(weakest[k + 1]),
        )
        for k, place in enumerate(at)
    ]
    return PointingPlan(
        sensor=sensor.name,
        criterion="D" if criterion == "D" else "A",
        start_utc=f"{start}Z",
        minutes=took,
        candidates=len(candidates),
        pointings=pointings,
        sigma_before=dict(zip(names, sigma[0].tolist() if known else [None] * len(names), strict=True)),
        sigma_after=dict(zip(names, sigma[-1].tolist(), strict=True)),
        weakest_before=float(weakest[0]),
        weakest_after=float(weakest[-1]),
        minutes_to_gate=to_gate,
        sentence=sentence,
    )
