"""Good telemetry, edited at random and calibrated in every way: each ends in a result or in a sentence, or it is a defect.

    python -m benchmarks.random_edits --edits 2000 [--seed 20260101] [--only 17,230] [--json FILE]

An edit is what happens to files on their way: another star's number, a sign, a unit, an order, a gap, a repeat, a column lost,
swapped or constant, a value that is none, the wrong sensor. Each case makes one to three of them in a small simulated set,
writes it as CSV, JSON Lines or Parquet, and calibrates it by a method and with choices drawn by the case's own generator, so
that a case is the same whether run alone or among all. Every warning is an error here: a division by nothing is a defect even
where a number comes of it.

Of a result is asked: numbers and sigmas of a converged fit are finite and the sigmas positive, the document is JSON; of every
`SHOWN_EVERY`th the report and all figures are drawn and the gates judge it; and every `DOOR_EVERY`th case goes through the
command line too, which ends with 0 or with 1 and a line.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
from click.testing import CliRunner

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import ALL as METHODS
from boresight.calibration.options import OPTIONS, CalibrationSettings
from boresight.calibration.source import TelemetryFile
from boresight.cameras import CAMERA_MODELS
from boresight.cli import main as boresight_command
from boresight.errors import RefusedInputError
from boresight.figures import FIGURES, Trace
from boresight.figures.report import render_report
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import wu_sensor
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.sky.directions import star_directions
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor, parse_sensor, sensor_document
from boresight.telemetry.writers import write_csv
from boresight.verdicts.gates import parse_profile
from boresight.verdicts.gates.assessment import assess, ground_set

FRAMES, VALIDATION_FRAMES = 24, 12
SEED = 20_260_101
SHOWN_EVERY, DOOR_EVERY = 50, 25
#: Share of the cases in which what any reader refuses is mended, for the estimators to meet the rest.
TIDIED = 0.65
SLOW_S = 20.0

Table = dict[str, list[str]]
Edit = Callable[[np.random.Generator, Table], None]


@dataclass(frozen=True)
class Base:
    """A good set to edit: its calibration and validation table, and whose they are."""

    sensor: Sensor
    calibration: Table
    validation: Table


@dataclass(frozen=True)
class Case:
    """One edited set and how it is calibrated."""

    number: int
    names: tuple[str, ...]
    method: str
    settings: dict[str, Any]
    sensor: dict[str, Any]
    telemetry: Path
    validation: Path | None
    in_pieces: bool


@dataclass(frozen=True)
class Ended:
    """How a case ended: `result`, `refused` or `defect`; its status or sentence, and what was computed."""

    case: Case
    kind: str
    words: str
    seconds: float
    document: dict[str, Any] | None = None


# --- the edits


def rows_of(table: Table) -> int:
    """How many rows a table has."""
    return len(next(iter(table.values()))) if table else 0


def take(table: Table, rows: Any) -> None:
    """Keep these rows, in this order."""
    for name in table:
        table[name] = [table[name][row] for row in rows]


def some(rng: np.random.Generator, table: Table) -> list[int]:
    """Draw rows: one, a few, or half."""
    n = rows_of(table)
    size = min(n, int(rng.choice([1, 1, 3, 10, max(1, n // 2)])))
    return sorted(rng.choice(n, size=size, replace=False).tolist()) if n else []


def a_column(rng: np.random.Generator, table: Table) -> str | None:
    """Draw a column; None of a table without any."""
    return str(rng.choice(list(table))) if table else None


def number(text: str) -> float:
    """Read a cell; NaN where it is no number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def mapped(table: Table, name: str, rows: Any, change: Callable[[float], float]) -> None:
    """Change the numbers of a column in some rows."""
    if name in table:
        for row in rows:
            table[name][row] = repr(change(number(table[name][row]))) if table[name][row] else ""


def everywhere(table: Table) -> range:
    """All rows."""
    return range(rows_of(table))


def groups(table: Table, *names: str) -> list[list[int]]:
    """Rows that share these columns."""
    found: dict[tuple[str, ...], list[int]] = {}
    for row in everywhere(table):
        found.setdefault(tuple(table[name][row] for name in names if name in table), []).append(row)
    return list(found.values())


UNSEEN = ("32349", "1", "11767", "120404", "999999999", "9223372036854775807", "-7", "3.0", "2.5", "HIP 3", "")


def another_star(rng: np.random.Generator, table: Table) -> None:
    """One star, or some, are another that was seen nowhere else."""
    star = str(rng.choice(UNSEEN))
    for row in some(rng, table) if "star_id" in table else ():
        table["star_id"][row] = star


def stars_exchanged(rng: np.random.Generator, table: Table) -> None:
    """Some identities change places; in their exposure or anywhere."""
    if "star_id" not in table:
        return
    rows = some(rng, table)
    moved = rng.permutation(rows).tolist()
    values = [table["star_id"][row] for row in moved]
    for row, value in zip(rows, values, strict=True):
        table["star_id"][row] = value


def stars_shuffled(rng: np.random.Generator, table: Table) -> None:
    """All identities are shuffled."""
    if "star_id" in table:
        table["star_id"] = [table["star_id"][row] for row in rng.permutation(rows_of(table))]


def stars_absent(rng: np.random.Generator, table: Table) -> None:
    """No star is named, or all but a few."""
    if "star_id" not in table:
        return
    word, kept = str(rng.choice(["", "0", "-1"])), int(rng.choice([0, 0, 1, 3, 5]))
    keep = set(rng.choice(rows_of(table), size=min(kept, rows_of(table)), replace=False).tolist())
    table["star_id"] = [value if row in keep else word for row, value in enumerate(table["star_id"])]


def stars_alike(rng: np.random.Generator, table: Table) -> None:
    """All are the same star, everywhere or in an exposure."""
    if "star_id" not in table:
        return
    found = groups(table, "frame", "exposure")
    rows = everywhere(table) if rng.random() < 0.3 else found[int(rng.integers(len(found)))] if found else ()
    star = next((value for value in table["star_id"] if value), "32349")
    for row in rows:
        table["star_id"][row] = star


def few_named(rng: np.random.Generator, table: Table) -> None:
    """Each exposure names three to five stars."""
    if "star_id" not in table:
        return
    most = int(rng.integers(3, 6))
    for rows in groups(table, "frame", "exposure"):
        for row in rows[most:]:
            table["star_id"][row] = ""


TIMES = ("", "1850-01-01T00:00:00Z", "2099-12-31T23:59:59Z", "3000-01-01T00:00:00Z", "2026-10-01", "yesterday", "0", "1.6e9",
         "2026-10-01T00:00:00+14:00", "0001-01-01T00:00:00Z", "9999-12-31T23:59:59Z", "2026-02-30T00:00:00Z")  # fmt: skip


def some_times(rng: np.random.Generator, table: Table) -> None:
    """Some rows have another time."""
    stamp = str(rng.choice(TIMES))
    for row in some(rng, table) if "time_utc" in table else ():
        table["time_utc"][row] = stamp


def one_time(rng: np.random.Generator, table: Table) -> None:
    """All rows have one time, or none."""
    if "time_utc" in table:
        table["time_utc"] = [str(rng.choice(TIMES))] * rows_of(table)


def times_shifted(rng: np.random.Generator, table: Table) -> None:
    """All times are of another year, or run backwards."""
    if "time_utc" not in table:
        return
    if rng.random() < 0.4:
        table["time_utc"] = table["time_utc"][::-1]
    else:
        year = str(rng.choice(["1900", "1950", "1991", "2000", "2099", "2101"]))
        table["time_utc"] = [year + value[4:] if value else "" for value in table["time_utc"]]


def sign(rng: np.random.Generator, table: Table) -> None:
    """A column changes its sign, everywhere or in some rows."""
    if (name := a_column(rng, table)) is not None:
        mapped(table, name, everywhere(table) if rng.random() < 0.6 else some(rng, table), lambda value: -value)


UNITS = (1e-12, 2.2e-6, 1e-3, math.pi / 180, 0.1, 10.0, 180 / math.pi, 1e3, 1e6, 1e12)


def unit(rng: np.random.Generator, table: Table) -> None:
    """A column is in another unit."""
    factor = float(rng.choice(UNITS))
    if (name := a_column(rng, table)) is not None:
        mapped(table, name, everywhere(table) if rng.random() < 0.7 else some(rng, table), lambda value: value * factor)


def offset(rng: np.random.Generator, table: Table) -> None:
    """A column is moved: half a pixel, a corner, Kelvin, or a flip over the detector."""
    step, name = float(rng.choice([0.5, 1.0, -100.0, 273.15, 1e4])), a_column(rng, table)
    if name is not None:
        mapped(
            table,
            name,
            everywhere(table),
            (lambda value: step - value) if rng.random() < 0.3 else (lambda value: value + step),
        )


def order(rng: np.random.Generator, table: Table) -> None:
    """Rows come in another order: any, backwards, or by another column."""
    n, how = rows_of(table), rng.random()
    if how < 0.25:
        take(table, rng.permutation(n).tolist())
    elif how < 0.5:
        take(table, list(range(n))[::-1])
    elif how < 0.8:  # inside their exposures, which is harmless
        take(table, [row for rows in groups(table, "frame", "exposure") for row in rng.permutation(rows).tolist()])
    elif (name := a_column(rng, table)) is not None:
        take(table, sorted(range(n), key=lambda row: table[name][row]))


def frame_numbers(rng: np.random.Generator, table: Table) -> None:
    """Frames are numbered otherwise: from elsewhere, with gaps, all alike, each row its own."""
    if "frame" not in table:
        return
    how = int(rng.integers(6))
    if how == 0:
        table["frame"] = ["0"] * rows_of(table)
    elif how == 1:
        table["frame"] = [str(row) for row in everywhere(table)]
    else:
        start, step = [(-50, 1), (2**40, 1), (0, 1_000_003), (2**62, 1)][how - 2]
        table["frame"] = [
            str(int(number(value)) * step + start) if math.isfinite(number(value)) else value
            for value in table["frame"]
        ]


def exposure_numbers(rng: np.random.Generator, table: Table) -> None:
    """Exposures are numbered otherwise."""
    if "exposure" not in table:
        return
    how = int(rng.integers(4))
    for row in everywhere(table):
        table["exposure"][row] = ["0", str(row), str(row % 5), f"{2**50 + row}"][how]


def gap(rng: np.random.Generator, table: Table) -> None:
    """Rows, exposures or whole frames are missing."""
    n, how = rows_of(table), rng.random()
    if how < 0.3:
        take(table, np.flatnonzero(rng.random(n) > rng.choice([0.02, 0.3, 0.8, 0.97])).tolist())
    else:
        found = groups(table, "frame") if how < 0.7 else groups(table, "frame", "exposure")
        share = rng.choice([0.1, 0.5, 0.9])
        take(table, sorted(row for rows in found if rng.random() > share for row in rows))


def single(rng: np.random.Generator, table: Table) -> None:
    """One frame, one exposure, one star or one row is all there is."""
    how, n = int(rng.integers(5)), rows_of(table)
    if not n:
        return
    if how == 0:
        take(table, [int(rng.integers(n))])
    elif how == 1 and "star_id" in table:
        star = table["star_id"][int(rng.integers(n))]
        take(table, [row for row in everywhere(table) if table["star_id"][row] == star])
    else:
        found = [groups(table, "frame"), groups(table, "frame", "exposure"), [[0], *groups(table, "exposure")]][how - 2]
        take(table, sorted(found[int(rng.integers(len(found)))]))


def few_stars(rng: np.random.Generator, table: Table) -> None:
    """Every exposure keeps its first few detections."""
    most = int(rng.integers(1, 6))
    take(table, sorted(row for rows in groups(table, "frame", "exposure") for row in rows[:most]))


def repeated(rng: np.random.Generator, table: Table) -> None:
    """Rows, frames or the whole set come twice."""
    n, how = rows_of(table), rng.random()
    if how < 0.5:
        twice = set(some(rng, table))
        take(table, [row for row in range(n) for _ in range(1 + (row in twice))])
    elif how < 0.8:
        found = groups(table, "frame")
        take(table, [row for rows in found for row in rows * int(rng.integers(1, 3))])
    else:
        take(table, [*range(n), *range(n)])
        mapped(table, "frame", range(n, 2 * n), lambda value: value + 1e6)
        if "frame" in table:
            table["frame"] = [
                str(int(number(value))) if math.isfinite(number(value)) else value for value in table["frame"]
            ]


def dropped(rng: np.random.Generator, table: Table) -> None:
    """A column is missing."""
    if len(table) > 1 and (name := a_column(rng, table)) is not None:
        del table[name]


def swapped(rng: np.random.Generator, table: Table) -> None:
    """Two columns have each other's values."""
    pairs = [("row_px", "col_px"), ("ra_deg", "dec_deg"), ("q_x", "q_w"), ("vx_km_s", "vz_km_s"), ("frame", "exposure")]
    first, second = (
        pairs[int(rng.integers(len(pairs)))] if rng.random() < 0.7 else (a_column(rng, table), a_column(rng, table))
    )
    if first in table and second in table:
        table[first], table[second] = table[second], table[first]


CONSTANTS = ("0", "1", "-1", "1e-300", "1e300", "971.5", "1295.5", "", "90", "-90", "360")


def constant(rng: np.random.Generator, table: Table) -> None:
    """A column has one value."""
    if (name := a_column(rng, table)) is not None:
        value = str(rng.choice(CONSTANTS)) if rng.random() < 0.7 or not rows_of(table) else table[name][0]
        table[name] = [value] * rows_of(table)


EXTREMES = ("nan", "NaN", "inf", "-inf", "1e308", "-1e308", "1e-308", "5e-324", "-0.0", "0", "1e17", "abc", "", "1,5", "0x10",
            "9223372036854775808", "١٢", "\x00", "'=1+1")  # fmt: skip


def extreme(rng: np.random.Generator, table: Table) -> None:
    """Some cells hold what is no measurement, or an extreme one."""
    if (name := a_column(rng, table)) is not None:
        value = str(rng.choice(EXTREMES))
        for row in some(rng, table):
            table[name][row] = value


def places(rng: np.random.Generator, table: Table) -> None:
    """Centroids are where they hardly can be: on a line, in a point, on whole pixels, at corners, far off, or far too noisy."""
    how = int(rng.integers(8))
    for name in ("row_px", "col_px"):
        if name not in table:
            continue
        for row in everywhere(table):
            value = number(table[name][row])
            table[name][row] = repr(
                float([
                    100.0 + row % 20 * 10, 971.5, round(value) if math.isfinite(value) else value, 0.0 if row % 2 else 1943.0,
                    value + 5 * (row == 7), value + 1e5 * (row == 7), value + 40 * rng.normal(), value + 1e-9 * rng.normal(),
                ][how])
            )  # fmt: skip


def noise(rng: np.random.Generator, table: Table) -> None:
    """The stated noise is another: none, tiny, huge, or of one star alone."""
    value = str(rng.choice(["0", "1e-12", "1e-6", "50", "1e6", "", "-1"]))
    if "sigma_px" in table:
        for row in everywhere(table) if rng.random() < 0.6 else some(rng, table):
            table["sigma_px"][row] = value


def attitude(rng: np.random.Generator, table: Table) -> None:
    """The quaternion is none, unscaled, in another order, or another frame's."""
    names, how = [f"q_{axis}" for axis in "xyzw"], int(rng.integers(4))
    if not all(name in table for name in names):
        return
    if how == 0:
        for name in names:
            table[name] = ["0"] * rows_of(table)
    elif how == 1:
        for name in names:
            mapped(table, name, everywhere(table), lambda value: 7 * value)
    elif how == 2:
        values = [table[name] for name in names]
        for name, column in zip(names, [values[3], *values[:3]], strict=True):
            table[name] = column
    else:
        moved = rng.permutation(rows_of(table))
        for name in names:
            table[name] = [table[name][row] for row in moved]


def velocity(rng: np.random.Generator, table: Table) -> None:
    """The satellite flies at another speed: in m/s, at half of light's, beyond it, or not at all."""
    factor = float(rng.choice([0.0, 1e3, 2e4, 1e5, -1.0]))
    for name in ("vx_km_s", "vy_km_s", "vz_km_s"):
        mapped(table, name, everywhere(table), lambda value: value * factor)


def unknown_column(rng: np.random.Generator, table: Table) -> None:
    """There is a column that the contract does not name."""
    table[str(rng.choice(["note", "Frame", " row_px", "time", "q_v", "ORC", "é", "frame "]))] = ["7"] * rows_of(table)


def two_halves(rng: np.random.Generator, table: Table) -> None:
    """From some row on, everything is of another sensor: mirrored, and turned."""
    start = int(rng.integers(rows_of(table) + 1))
    mapped(table, "row_px", range(start, rows_of(table)), lambda value: 1943.0 - value)


def nothing(rng: np.random.Generator, table: Table) -> None:
    """No row is left, or nothing changes."""
    if rng.random() < 0.3:
        take(table, [])


EDITS: tuple[Edit, ...] = (
    another_star, another_star, stars_exchanged, stars_shuffled, stars_absent, stars_alike, few_named, some_times, one_time,
    times_shifted, sign, sign, unit, unit, offset, order, frame_numbers, exposure_numbers, gap, gap, single, single, few_stars,
    repeated, repeated, dropped, dropped, swapped, constant, constant, extreme, extreme, places, places, noise, attitude, velocity,
    unknown_column, two_halves, nothing,
)  # fmt: skip


def tidied(table: Table, sensor: Mapping[str, Any]) -> None:
    """Mend what every reader refuses, so that the rest of an edit comes as far as the estimators."""
    _without_odd_vectors(table)
    if all(name in table for name in ("frame", "exposure", "row_px", "col_px")):
        _without_odd_cells(table)
        _without_odd_rows(table, sensor["detector"])
        _without_repeated_stars(table)


def _without_odd_vectors(table: Table) -> None:
    """Leave out quaternions, velocities and directions of which one cannot be read."""
    for names in (("q_x", "q_y", "q_z", "q_w"), ("vx_km_s", "vy_km_s", "vz_km_s"), ("ra_deg", "dec_deg")):
        if not all(name in table for name in names) or not all(_sound(table, names, row) for row in everywhere(table)):
            for name in names:
                table.pop(name, None)


def _without_odd_cells(table: Table) -> None:
    """Empty optional cells that hold no measurement."""
    for name in ("sigma_px", "magnitude", "temperature_c"):
        for row in everywhere(table) if name in table else ():
            if not math.isfinite(value := number(table[name][row])) or (name == "sigma_px" and value <= 0):
                table[name][row] = ""


def _without_odd_rows(table: Table, detector: Mapping[str, Any]) -> None:
    """Sort the rows, those left out that are off the detector or come twice."""
    kept, seen = [], set()
    for row in everywhere(table):
        frame, exposure, *place = (number(table[name][row]) for name in ("frame", "exposure", "row_px", "col_px"))
        on = all(-0.5 <= value < detector[side] - 0.5 for value, side in zip(place, ("rows", "columns"), strict=True))
        key = (frame, exposure, *place)
        if on and all(map(math.isfinite, key)) and key not in seen:
            kept.append((frame, exposure, row))
            seen.add(key)
    take(table, [row for _, _, row in sorted(kept)])


def _without_repeated_stars(table: Table) -> None:
    """Let each exposure name a star once."""
    for rows in groups(table, "frame", "exposure") if "star_id" in table else ():
        stars: set[str] = set()
        for row in rows:
            star = table["star_id"][row]
            table["star_id"][row] = "" if star in stars or not star.isdecimal() else star
            stars.add(star)


def _sound(table: Table, names: tuple[str, ...], row: int) -> bool:
    """Whether a vector of a row is one that readers take."""
    length = math.hypot(*(number(table[name][row]) for name in names))
    texts = [table[name][row] for name in names]
    if names[0] == "q_x":
        return not any(texts) or abs(length - 1) < 1e-3
    return not any(texts) or length < (100 if names[0] == "vx_km_s" else 1000)


# --- the sensor and the choices


def another_sensor(
    rng: np.random.Generator, document: dict[str, Any], others: list[dict[str, Any]]
) -> tuple[str, dict[str, Any]]:
    """Choose the sensor file: mostly the right one, else a wrong or an odd one."""
    how = int(rng.integers(26))
    names = list(document["initial"])
    changed = json.loads(json.dumps(document))
    if how == 0:
        return "wrong sensor", others[int(rng.integers(len(others)))]
    if how == 1:
        changed["parity"] = -changed["parity"]
    elif how == 2:
        changed["initial"]["f_m"] *= float(rng.choice([0.5, 0.9, 1.02, 2.0]))
    elif how == 3:
        factor = float(rng.choice([1e-6, 1e-3, 1e3, 1e6]))
        changed["typical_sigma"] = {name: value * factor for name, value in changed["typical_sigma"].items()}
    elif how == 4:
        changed["centroid_sigma_px"] = float(rng.choice([1e-4, 1e-2, 10.0, 100.0]))
    elif how == 5:
        changed["magnitude_limit"] = float(rng.choice([-1.0, 1.0, 3.0, 8.0]))
    elif how == 6:
        detector = changed["detector"]
        detector["rows"], detector["columns"] = detector["columns"], detector["rows"]
    elif how == 7:
        changed["free"] = [str(rng.choice(names))]
    elif how == 8:
        name = str(rng.choice(names))
        changed["initial"][name] += float(rng.choice([-30.0, -5.0, 5.0, 30.0])) * changed["typical_sigma"][name]
    else:
        return "", changed
    return f"sensor {how}", changed


def choices(rng: np.random.Generator, method: str, names: list[str]) -> dict[str, Any]:
    """Draw the settings of a calibration by a method; some exclude one another, and are refused."""
    drawn: dict[str, Any] = {"method": method, "match": str(rng.choice(["given", "rematch"]))}
    if method != "batch":
        drawn["variant"] = str(rng.choice(list(OPTIONS["variant"].words)))

    def maybe(name: str, share: float, *values: Any) -> None:
        if rng.random() < share:
            drawn[name] = values[int(rng.integers(len(values)))]

    maybe("free", 0.3, names[:1], names[:3], names[-2:], [names[int(rng.integers(len(names)))]], names)
    maybe("match_parameters", 0.15, "baseline", "latest")
    maybe("match_rule", 0.15, "flight")
    maybe("flight_tolerance_urad", 0.1, 0.1, 10.0, 1000.0, 1e5)
    maybe("leave_out_doubles", 0.1, True)
    maybe("minimum_stars", 0.15, 4, 5, 8, 1000)
    maybe("initial_sigma_scale", 0.15, 1e-3, 1.0, 100.0, 1e4)
    if method == "batch":
        maybe("max_iterations", 0.1, 1, 2)
        maybe("error", 0.15, "cosine")
        maybe("robust", 0.2, "huber")
        maybe("huber_threshold", 0.1, 0.1, 10.0)
    else:
        maybe("linearisations", 0.2, 1, 2, 100)
        maybe("process_noise_sigma", 0.15, 0.0, 1.0, 10.0)
        maybe("forgetting_factor", 0.15, 0.5, 0.9)
    if method == "svd":
        maybe("star_model", 0.3, 1, 2, 3)
        maybe("singular_values", 0.3, [1], [2], [3], [1, 2], [1, 2, 3])
    if method in {"svd", "angular"}:
        maybe("gain_form", 0.2, "gain")
    return drawn


# --- files


def table_of(path: Path) -> Table:
    """Read a good CSV as texts."""
    header, *lines = path.read_text().replace('"', "").splitlines()
    cells = [line.split(",") for line in lines]
    return {name: [row[place] for row in cells] for place, name in enumerate(header.split(","))}


def written(table: Table, path: Path, form: str) -> Path:
    """Write a table as a file of a format; a cell that is a number is one where the format has numbers."""
    path = path.with_suffix(f".{form}")
    names, rows = list(table), zip(*table.values(), strict=True)
    if form == "csv":
        path.write_text("\n".join(map(",".join, [names, *rows])) + "\n")
    elif form == "jsonl":
        lines = (dict(zip(names, map(_typed, row), strict=True)) for row in rows)
        path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    else:
        columns = {name: [_typed(cell) for cell in cells] for name, cells in table.items()}
        arrow_parquet.write_table(pa.table({name: _array(cells) for name, cells in columns.items()}), path)
    return path


def _typed(cell: str) -> Any:
    """Read a cell as JSON would hold it."""
    if not cell:
        return None
    try:
        return int(cell) if cell.lstrip("-").isdecimal() and cell.isascii() else float(cell)
    except ValueError:
        return cell


def _array(cells: list[Any]) -> pa.Array:
    """Make a column, of numbers where all are and else of texts."""
    try:
        return pa.array(cells)
    except (pa.ArrowInvalid, pa.ArrowTypeError, OverflowError):
        return pa.array([None if cell is None else str(cell) for cell in cells])


# --- the cases


def good_sets(catalogue: Catalogue, folder: Path) -> list[Base]:
    """Simulate what is edited: an ST-16 with every optional column, the same with directions of its own, and a pinhole camera."""
    st16, lens = calibration_scenario(4, FRAMES), wu_sensor()
    rng = np.random.default_rng(SEED)
    other = replace(st16, sensor=lens, truth=lens.initial + 0.5 * lens.typical_sigma, magnitude_limit=5.2)
    bases = []
    for number, scenario in enumerate((st16, st16, other)):
        tables = []
        for frames in (FRAMES, VALIDATION_FRAMES):
            telemetry = simulate(replace(scenario, frames=frames), rng, catalogue)
            path = folder / f"good-{number}-{frames}.csv"
            write_csv(with_directions(telemetry, catalogue) if number == 1 else telemetry, path)
            tables.append(table_of(path))
        bases.append(Base(scenario.sensor, *tables))
    return bases


def with_directions(telemetry: Telemetry, catalogue: Catalogue) -> Telemetry:
    """Give every matched row the apparent direction of its star."""
    s_i = star_directions(telemetry.star_id, None, None, telemetry.time_utc, telemetry.velocity_m_s, catalogue)
    ra, dec = np.arctan2(s_i[:, 1], s_i[:, 0]) % (2 * np.pi), np.arcsin(s_i[:, 2])
    return replace(telemetry, ra_rad=ra, dec_rad=dec)


def case_of(number_of_case: int, bases: list[Base], folder: Path, seed: int = SEED) -> Case:
    """Make a case: the same for its number and seed, whatever other cases there are."""
    rng = np.random.default_rng([seed, number_of_case])
    base = bases[int(rng.integers(len(bases)))]
    table = {name: list(cells) for name, cells in base.calibration.items()}
    validation = {name: list(cells) for name, cells in base.validation.items()}
    edits = [EDITS[int(rng.integers(len(EDITS)))] for _ in range(int(rng.choice([1, 1, 1, 2, 2, 3])))]
    spoilt = validation if rng.random() < 0.1 else table
    for edit in edits:
        edit(rng, spoilt)
    if rng.random() < TIDIED:
        tidied(spoilt, sensor_document(base.sensor))
    others = [sensor_document(other.sensor) for other in bases if other.sensor.name != base.sensor.name]
    odd, sensor = another_sensor(rng, sensor_document(base.sensor), others)
    method = METHODS[number_of_case % len(METHODS)]
    settings = choices(rng, method, list(base.sensor.free))
    form = str(rng.choice(["csv", "csv", "csv", "jsonl", "parquet"]))
    held_out = spoilt is validation or rng.random() < 0.3
    return Case(
        number=number_of_case,
        names=(
            *(edit.__name__ for edit in edits),
            *([odd] if odd else []),
            *(["validation"] if spoilt is validation else []),
        ),
        method=method,
        settings=settings,
        sensor=sensor,
        telemetry=written(table, folder / f"case-{number_of_case}", form),
        validation=written(validation, folder / f"case-{number_of_case}-validation", form) if held_out else None,
        in_pieces=bool(rng.random() < 0.1),
    )


def run(case: Case, catalogue: Catalogue, cache: Path | None) -> Ended:
    """Calibrate a case as the command line does."""
    began = time.perf_counter()

    def ended(kind: str, words: str, document: dict[str, Any] | None = None) -> Ended:
        return Ended(case, kind, words, time.perf_counter() - began, document)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            document = calibrated(case, catalogue, cache)
            wrong = faults_of(document)
            if not wrong and case.number % SHOWN_EVERY == 0:
                shown(document, parse_sensor(case.sensor))
    except RefusedInputError as error:
        return ended("refused", str(error)) if str(error) else ended("defect", "a refusal without a sentence")
    except Exception:  # noqa: BLE001 - finding these is the purpose
        return ended("defect", traceback.format_exc())
    return ended("defect", "; ".join(wrong), document) if wrong else ended("result", document["status"], document)


def calibrated(case: Case, catalogue: Catalogue, cache: Path | None) -> dict[str, Any]:
    """Read the files and calibrate."""
    most: dict[str, Any] = {"large_rows": 1, "chunk_frames": 7} if case.in_pieces else {}
    held_out = None if case.validation is None else TelemetryFile(case.validation).opened()
    return calibrate(
        TelemetryFile(case.telemetry, **most).opened(),
        parse_sensor(case.sensor),
        catalogue,
        CalibrationSettings.parse(case.settings),
        validation=held_out,
        cache_folder=cache,
    )


def faults_of(document: Mapping[str, Any]) -> list[str]:
    """What is wrong with a result."""
    found = []
    read = json.loads(orjson.dumps(document))
    names, sigma = document["free"], document["sigma"]
    if document["status"] not in {"converged", "max_iterations", "rank_deficient", "diverged", "too_few_stars"}:
        found.append(f"status {document['status']}")
    if document["status"] != "converged" and not document["advice"]:
        found.append(f"{document['status']} without advice")
    if document["status"] == "converged":
        if any(value is None for value in read["parameters"].values()):
            found.append("converged with parameters that are no numbers")
        bad = [name for name in names if read["sigma"][name] is None or not sigma[name] > 0]
        if bad and not document["advice"]:
            found.append(f"converged with no sigma of {', '.join(bad)} and without advice")
        elif bad:
            found.append(f"converged with no sigma of {', '.join(bad)}")
        matrix = read["covariance"]["matrix"]
        if any(value is None for row in matrix for value in row):
            found.append("converged with a covariance that is no matrix of numbers")
    if not all(isinstance(sentence, str) and sentence.strip() for sentence in document["advice"]):
        found.append("advice that is no sentence")
    return found


def options_of(case: Case, sensor_file: Path) -> list[str]:
    """Write a case as the words of `boresight calibrate`."""
    sensor_file.write_text(json.dumps(case.sensor))
    words = ["calibrate", str(case.telemetry), "--sensor", str(sensor_file)]
    for name, value in case.settings.items():
        word = f"--{name.removesuffix('_sigma').replace('_', '-')}"
        if isinstance(value, bool):
            words += [word] * value
        else:
            words += [word, ",".join(map(str, value)) if isinstance(value, list) else str(value)]
    return words if case.validation is None else [*words, "--validate", str(case.validation)]


def through_the_door(case: Case, sensor_file: Path) -> str | None:
    """Calibrate a case by the command line in this process; returns what is wrong with how it ended."""
    done = CliRunner().invoke(boresight_command, options_of(case, sensor_file))
    if "unexpected" in done.output or "Traceback" in done.output or "Warning" in done.output:
        return f"the command line broke down: {done.output[-2000:]}"
    told = [line for line in done.stderr.splitlines() if not line.startswith("  ")]  # a fault a line is indented
    in_a_line = bool(told) and told[-1].startswith("boresight: ")
    of_usage = done.exit_code == 2 and "Error: " in done.stderr  # settings that exclude one another
    if done.exit_code == 0 or (done.exit_code == 1 and in_a_line) or of_usage:
        return None
    return f"exit code {done.exit_code}: {done.output[-2000:]}"


def shown(document: dict[str, Any], sensor: Sensor) -> None:
    """Draw and judge a result as report, pages and `assess` do; what is read is what the file holds."""
    result = json.loads(orjson.dumps(document))
    render_report(result)
    for figure in FIGURES.values():
        orjson.dumps(figure.draw([Trace("edited", result)]).to_plotly_json(), option=orjson.OPT_SERIALIZE_NUMPY)
        figure.table(result)
    if result["status"] not in {"diverged", "too_few_stars"} and result["camera_model"] in CAMERA_MODELS:
        assess(result, sensor, ground_set(sensor), parse_profile({}))


def told(ends: list[Ended], seconds: float) -> dict[str, Any]:
    """Count how cases ended, by method and by what was done to them."""
    by_method = {method: dict(Counter(end.kind for end in ends if end.case.method == method)) for method in METHODS}
    return {
        "edits": len(ends),
        "seconds": round(seconds, 1),
        "kinds": dict(Counter(end.kind for end in ends)),
        "by_method": by_method,
        "statuses": dict(Counter(end.words for end in ends if end.kind == "result").most_common()),
        "slowest_s": round(max((end.seconds for end in ends), default=0.0), 2),
        "defects": [
            {"case": end.case.number, "edits": end.case.names, "settings": end.case.settings, "words": end.words}
            for end in ends
            if end.kind == "defect"
        ],
    }


def main() -> int:
    """Run the cases that were asked for and print what came of them; exit code 1 where there is a defect."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--edits", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", default="", help="numbers of cases, as 17,230")
    parser.add_argument("--from", dest="first", type=int, default=0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    numbers = [int(text) for text in options.only.split(",")] if options.only else range(options.first, options.edits)
    began, ends = time.perf_counter(), list[Ended]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["BORESIGHT_DATA_FOLDER"] = name  # the command line's own catalogue is the one made here
        catalogue = load_catalogue(folder / "catalogue")
        bases = good_sets(catalogue, folder)
        for case_number in numbers:
            case = case_of(case_number, bases, folder, options.seed)
            end = run(case, catalogue, folder / "catalogue")
            if case_number % DOOR_EVERY == 0 and (wrong := through_the_door(case, folder / "sensor.json")) is not None:
                end = replace(end, kind="defect", words=wrong)
            ends.append(replace(end, document=None))
            case.telemetry.unlink()
            if ends[-1].kind == "defect" or options.only or ends[-1].seconds > SLOW_S:
                end = ends[-1]
                print(
                    f"--- {case_number} {end.kind} {end.seconds:.1f} s {case.names} {case.settings}\n{end.words}",
                    flush=True,
                )
    summary = told(ends, time.perf_counter() - began)
    if options.json is not None:
        options.json.write_text(json.dumps(summary, indent=2) + "\n")
    print(json.dumps({key: value for key, value in summary.items() if key != "defects"}, indent=2))
    return int(bool(summary["defects"]))


if __name__ == "__main__":
    sys.exit(main())
