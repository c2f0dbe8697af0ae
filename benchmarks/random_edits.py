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

import json
import math
import os
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
from click.testing import CliRunner

from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import parse_calibration
from boresight.calibration.options import ALL as METHODS
from boresight.calibration.options import OPTIONS, CalibrationSettings
from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.cameras import CAMERA_MODELS
from boresight.cli import main as boresight_command
from boresight.cli.output import json_option, write_json
from boresight.errors import RefusedInputError
from boresight.figures import FIGURES, Trace
from boresight.figures.report import render_report
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import wu_sensor
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.sky.directions import star_directions
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor, parse_sensor, sensor_document
from boresight.telemetry.writing import write_csv
from boresight.verdicts.gates import parse_profile
from boresight.verdicts.gates.assessed_set import ground_set
from boresight.verdicts.gates.assessment import assess

FRAMES, VALIDATION_FRAMES = 24, 12
SEED = 20_260_101
SHOWN_EVERY, DOOR_EVERY = 50, 25
#: Share of the cases in which what any reader refuses is mended, for the estimators to meet the rest.
TIDIED = 0.65
SLOW_S = 20.0
STATUSES = {"converged", "max_iterations", "rank_deficient", "diverged", "too_few_stars"}
VECTORS = (("q_x", "q_y", "q_z", "q_w"), ("vx_km_s", "vy_km_s", "vz_km_s"), ("ra_deg", "dec_deg"))


def number(text: str) -> float:
    """Read a cell; NaN where it is no number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def whole(text: str, change: Callable[[int], int]) -> str:
    """Change a whole number; a cell that is none stays."""
    return str(change(int(number(text)))) if math.isfinite(number(text)) else text


class Table(dict[str, list[str]]):
    """The cells of a file, as texts by column."""

    @property
    def rows(self) -> range:
        """All rows."""
        return range(len(next(iter(self.values()))) if self else 0)

    def take(self, rows: Iterable[int]) -> None:
        """Keep these rows, in this order."""
        kept = list(rows)
        for name, cells in self.items():
            self[name] = [cells[row] for row in kept]

    def put(self, name: str, rows: Iterable[int], value: str | Callable[[int], str]) -> None:
        """Write a value into some rows of a column, if it is there."""
        for row in rows if name in self else ():
            self[name][row] = value if isinstance(value, str) else value(row)

    def change(self, name: str, rows: Iterable[int], change: Callable[[float], float]) -> None:
        """Change the numbers of a column in some rows."""
        self.put(name, rows, lambda row: repr(change(number(self[name][row]))) if self[name][row] else "")

    def groups(self, *names: str) -> list[list[int]]:
        """Rows that share these columns, frame and exposure if none are named."""
        found: dict[tuple[str, ...], list[int]] = {}
        for row in self.rows:
            found.setdefault(
                tuple(self[name][row] for name in names or ("frame", "exposure") if name in self), []
            ).append(row)
        return list(found.values())

    def some(self, rng: np.random.Generator) -> list[int]:
        """Draw rows: one, a few, or half."""
        n = len(self.rows)
        size = min(n, int(rng.choice([1, 1, 3, 10, max(1, n // 2)])))
        return sorted(rng.choice(n, size=size, replace=False).tolist()) if n else []

    def all_or_some(self, rng: np.random.Generator, share: float) -> Iterable[int]:
        """All rows in a share of the cases, else some."""
        return self.rows if rng.random() < share else self.some(rng)

    def column(self, rng: np.random.Generator) -> str:
        """Draw a column; empty of a table without any."""
        return str(rng.choice(list(self))) if self else ""


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

UNSEEN = ("32349", "1", "11767", "120404", "999999999", "9223372036854775807", "-7", "3.0", "2.5", "HIP 3", "")
TIMES = ("", "1850-01-01T00:00:00Z", "2099-12-31T23:59:59Z", "3000-01-01T00:00:00Z", "2026-10-01", "yesterday", "0", "1.6e9",
         "2026-10-01T00:00:00+14:00", "0001-01-01T00:00:00Z", "9999-12-31T23:59:59Z", "2026-02-30T00:00:00Z")  # fmt: skip
UNITS = (1e-12, 2.2e-6, 1e-3, math.pi / 180, 0.1, 10.0, 180 / math.pi, 1e3, 1e6, 1e12)
CONSTANTS = ("0", "1", "-1", "1e-300", "1e300", "971.5", "1295.5", "", "90", "-90", "360")
EXTREMES = ("nan", "NaN", "inf", "-inf", "1e308", "-1e308", "1e-308", "5e-324", "-0.0", "0", "1e17", "abc", "", "1,5", "0x10",
            "9223372036854775808", "١٢", "\x00", "'=1+1")  # fmt: skip
UNKNOWN = ("note", "Frame", " row_px", "time", "q_v", "ORC", "é", "frame ")


def another_star(rng: np.random.Generator, table: Table) -> None:
    """One star, or some, are another that was seen nowhere else."""
    star = str(rng.choice(UNSEEN))
    table.put("star_id", table.some(rng), star)


def stars_exchanged(rng: np.random.Generator, table: Table) -> None:
    """Some identities change places; in their exposure or anywhere."""
    if "star_id" in table:
        rows = table.some(rng)
        values = dict(zip(rows, [table["star_id"][row] for row in rng.permutation(rows).tolist()], strict=True))
        table.put("star_id", rows, values.__getitem__)


def stars_shuffled(rng: np.random.Generator, table: Table) -> None:
    """All identities are shuffled."""
    if "star_id" in table:
        table["star_id"] = [table["star_id"][row] for row in rng.permutation(len(table.rows))]


def stars_absent(rng: np.random.Generator, table: Table) -> None:
    """No star is named, or all but a few."""
    word, kept, n = str(rng.choice(["", "0", "-1"])), int(rng.choice([0, 0, 1, 3, 5])), len(table.rows)
    keep = set(rng.choice(n, size=min(kept, n), replace=False).tolist())
    table.put("star_id", [row for row in table.rows if row not in keep], word)


def stars_alike(rng: np.random.Generator, table: Table) -> None:
    """All are the same star, everywhere or in an exposure."""
    found = table.groups()
    rows = table.rows if rng.random() < 0.3 else found[int(rng.integers(len(found)))] if found else ()
    table.put("star_id", rows, next(filter(None, table.get("star_id", [])), "32349"))


def few_named(rng: np.random.Generator, table: Table) -> None:
    """Each exposure names three to five stars."""
    most = int(rng.integers(3, 6))
    table.put("star_id", [row for rows in table.groups() for row in rows[most:]], "")


def some_times(rng: np.random.Generator, table: Table) -> None:
    """Some rows have another time."""
    stamp = str(rng.choice(TIMES))
    table.put("time_utc", table.some(rng), stamp)


def one_time(rng: np.random.Generator, table: Table) -> None:
    """All rows have one time, or none."""
    table.put("time_utc", table.rows, str(rng.choice(TIMES)))


def times_shifted(rng: np.random.Generator, table: Table) -> None:
    """All times are of another year, or run backwards."""
    if "time_utc" in table:
        if rng.random() < 0.4:
            table["time_utc"].reverse()
        else:
            year = str(rng.choice(["1900", "1950", "1991", "2000", "2099", "2101"]))
            table["time_utc"] = [year + value[4:] if value else "" for value in table["time_utc"]]


def sign(rng: np.random.Generator, table: Table) -> None:
    """A column changes its sign, everywhere or in some rows."""
    name = table.column(rng)
    table.change(name, table.all_or_some(rng, 0.6), lambda value: -value)


def unit(rng: np.random.Generator, table: Table) -> None:
    """A column is in another unit."""
    factor, name = float(rng.choice(UNITS)), table.column(rng)
    table.change(name, table.all_or_some(rng, 0.7), lambda value: value * factor)


def offset(rng: np.random.Generator, table: Table) -> None:
    """A column is moved: half a pixel, a corner, Kelvin, or a flip over the detector."""
    step, name = float(rng.choice([0.5, 1.0, -100.0, 273.15, 1e4])), table.column(rng)
    side = -1 if rng.random() < 0.3 else 1
    table.change(name, table.rows, lambda value: step + side * value)


def order(rng: np.random.Generator, table: Table) -> None:
    """Rows come in another order: any, backwards, or by another column."""
    how = rng.random()
    if how < 0.25:
        table.take(rng.permutation(len(table.rows)).tolist())
    elif how < 0.5:
        table.take(reversed(table.rows))
    elif how < 0.8:  # inside their exposures, which is harmless
        table.take(row for rows in table.groups() for row in rng.permutation(rows).tolist())
    elif name := table.column(rng):
        table.take(sorted(table.rows, key=lambda row: table[name][row]))


def frame_numbers(rng: np.random.Generator, table: Table) -> None:
    """Frames are numbered otherwise: from elsewhere, with gaps, all alike, each row its own."""
    if "frame" in table:
        how = int(rng.integers(6))
        start, step = [(0, 0), (0, 0), (-50, 1), (2**40, 1), (0, 1_000_003), (2**62, 1)][how]
        if how < 2:
            table.put("frame", table.rows, lambda row: str(row * how))
        else:
            table.put("frame", table.rows, lambda row: whole(table["frame"][row], lambda n: n * step + start))


def exposure_numbers(rng: np.random.Generator, table: Table) -> None:
    """Exposures are numbered otherwise."""
    how = int(rng.integers(4))
    table.put("exposure", table.rows, lambda row: ["0", str(row), str(row % 5), f"{2**50 + row}"][how])


def gap(rng: np.random.Generator, table: Table) -> None:
    """Rows, exposures or whole frames are missing."""
    how = rng.random()
    if how < 0.3:
        table.take(np.flatnonzero(rng.random(len(table.rows)) > rng.choice([0.02, 0.3, 0.8, 0.97])).tolist())
    else:
        found, share = table.groups("frame") if how < 0.7 else table.groups(), rng.choice([0.1, 0.5, 0.9])
        table.take(sorted(row for rows in found if rng.random() > share for row in rows))


def single(rng: np.random.Generator, table: Table) -> None:
    """One frame, one exposure, one star or one row is all there is."""
    how, n = int(rng.integers(5)), len(table.rows)
    if n and how == 0:
        table.take([int(rng.integers(n))])
    elif n and how == 1 and "star_id" in table:
        star = table["star_id"][int(rng.integers(n))]
        table.take([row for row in table.rows if table["star_id"][row] == star])
    elif n:
        found = [table.groups("frame"), table.groups(), [[0], *table.groups("exposure")]][how - 2]
        table.take(sorted(found[int(rng.integers(len(found)))]))


def few_stars(rng: np.random.Generator, table: Table) -> None:
    """Every exposure keeps its first few detections."""
    most = int(rng.integers(1, 6))
    table.take(sorted(row for rows in table.groups() for row in rows[:most]))


def repeated(rng: np.random.Generator, table: Table) -> None:
    """Rows, frames or the whole set come twice."""
    n, how = len(table.rows), rng.random()
    if how < 0.5:
        twice = set(table.some(rng))
        table.take(row for row in range(n) for _ in range(1 + (row in twice)))
    elif how < 0.8:
        table.take([row for rows in table.groups("frame") for row in rows * int(rng.integers(1, 3))])
    else:
        table.take([*range(n), *range(n)])
        table.put("frame", range(n, 2 * n), lambda row: whole(table["frame"][row], lambda frame: frame + 1_000_000))


def dropped(rng: np.random.Generator, table: Table) -> None:
    """A column is missing."""
    if len(table) > 1:
        del table[table.column(rng)]


def swapped(rng: np.random.Generator, table: Table) -> None:
    """Two columns have each other's values."""
    pairs = [("row_px", "col_px"), ("ra_deg", "dec_deg"), ("q_x", "q_w"), ("vx_km_s", "vz_km_s"), ("frame", "exposure")]
    known = rng.random() < 0.7
    first, second = pairs[int(rng.integers(len(pairs)))] if known else (table.column(rng), table.column(rng))
    if first in table and second in table:
        table[first], table[second] = table[second], table[first]


def constant(rng: np.random.Generator, table: Table) -> None:
    """A column has one value."""
    if name := table.column(rng):
        value = str(rng.choice(CONSTANTS)) if rng.random() < 0.7 or not table.rows else table[name][0]
        table.put(name, table.rows, value)


def extreme(rng: np.random.Generator, table: Table) -> None:
    """Some cells hold what is no measurement, or an extreme one."""
    name, value = table.column(rng), str(rng.choice(EXTREMES))
    table.put(name, table.some(rng), value)


def places(rng: np.random.Generator, table: Table) -> None:
    """Centroids are where they hardly can be: on a line, in a point, on whole pixels, at corners, far off, or far too noisy."""
    how = int(rng.integers(8))

    def moved(name: str, row: int) -> str:
        value = number(table[name][row])
        return repr(
            float([
                100.0 + row % 20 * 10, 971.5, round(value) if math.isfinite(value) else value, 0.0 if row % 2 else 1943.0,
                value + 5 * (row == 7), value + 1e5 * (row == 7), value + 40 * rng.normal(), value + 1e-9 * rng.normal(),
            ][how])
        )  # fmt: skip

    for name in ("row_px", "col_px"):
        table.put(name, table.rows, partial(moved, name))


def noise(rng: np.random.Generator, table: Table) -> None:
    """The stated noise is another: none, tiny, huge, or of one star alone."""
    value = str(rng.choice(["0", "1e-12", "1e-6", "50", "1e6", "", "-1"]))
    table.put("sigma_px", table.all_or_some(rng, 0.6), value)


def attitude(rng: np.random.Generator, table: Table) -> None:
    """The quaternion is none, unscaled, in another order, or another frame's."""
    names, how = VECTORS[0], int(rng.integers(4))
    if all(name in table for name in names):
        values = [table[name] for name in names]
        moved = rng.permutation(len(table.rows)) if how == 3 else table.rows
        for place, name in enumerate(names):
            if how == 1:
                table.change(name, table.rows, lambda value: 7 * value)
            else:
                table[name] = [["0"] * len(moved), [], values[place - 1], [values[place][row] for row in moved]][how]


def velocity(rng: np.random.Generator, table: Table) -> None:
    """The satellite flies at another speed: in m/s, at half of light's, beyond it, or not at all."""
    factor = float(rng.choice([0.0, 1e3, 2e4, 1e5, -1.0]))
    for name in VECTORS[1]:
        table.change(name, table.rows, lambda value: value * factor)


def unknown_column(rng: np.random.Generator, table: Table) -> None:
    """There is a column that the contract does not name."""
    table[str(rng.choice(UNKNOWN))] = ["7"] * len(table.rows)


def two_halves(rng: np.random.Generator, table: Table) -> None:
    """From some row on, everything is of another sensor: mirrored, and turned."""
    start = int(rng.integers(len(table.rows) + 1))
    table.change("row_px", table.rows[start:], lambda value: 1943.0 - value)


def nothing(rng: np.random.Generator, table: Table) -> None:
    """No row is left, or nothing changes."""
    if rng.random() < 0.3:
        table.take([])


EDITS: tuple[Edit, ...] = (
    another_star, another_star, stars_exchanged, stars_shuffled, stars_absent, stars_alike, few_named, some_times, one_time,
    times_shifted, sign, sign, unit, unit, offset, order, frame_numbers, exposure_numbers, gap, gap, single, single, few_stars,
    repeated, repeated, dropped, dropped, swapped, constant, constant, extreme, extreme, places, places, noise, attitude, velocity,
    unknown_column, two_halves, nothing,
)  # fmt: skip


def tidied(table: Table, sensor: Mapping[str, Any]) -> None:
    """Mend what every reader refuses, so that the rest of an edit comes as far as the estimators."""
    for names in VECTORS:  # of which one cannot be read
        if not all(name in table for name in names) or not all(_sound(table, names, row) for row in table.rows):
            for name in names:
                table.pop(name, None)
    for name in ("sigma_px", "magnitude", "temperature_c"):  # what holds no measurement
        values = [number(cell) for cell in table.get(name, [])]
        table.put(
            name, [row for row, v in enumerate(values) if not math.isfinite(v) or (name == "sigma_px" and v <= 0)], ""
        )
    places = ("frame", "exposure", "row_px", "col_px")
    if not all(name in table for name in places):
        return
    first: dict[tuple[float, ...], int] = {}  # rows on the detector, once each
    sides = (sensor["detector"]["rows"], sensor["detector"]["columns"])
    for row in table.rows:
        key = tuple(number(table[name][row]) for name in places)
        if all(map(math.isfinite, key)) and all(-0.5 <= at < n - 0.5 for at, n in zip(key[2:], sides, strict=True)):
            first.setdefault(key, row)
    table.take([row for _, row in sorted((key[:2], row) for key, row in first.items())])
    for rows in table.groups() if "star_id" in table else ():  # a star once an exposure
        stars: set[str] = set()
        for row in rows:
            star = table["star_id"][row]
            table["star_id"][row] = "" if star in stars or not star.isdecimal() else star
            stars.add(star)


def _sound(table: Table, names: tuple[str, ...], row: int) -> bool:
    """Whether a vector of a row is one that readers take."""
    texts = [table[name][row] for name in names]
    length = math.hypot(*map(number, texts))
    if names[0] == "q_x":
        return not any(texts) or abs(length - 1) < 1e-3
    return not any(texts) or length < (100 if names[0] == "vx_km_s" else 1000)


# --- the sensor and the choices


def another_sensor(
    rng: np.random.Generator, document: dict[str, Any], others: list[dict[str, Any]]
) -> tuple[str, dict[str, Any]]:
    """Choose the sensor file: mostly the right one, else a wrong or an odd one."""
    how, changed = int(rng.integers(26)), json.loads(json.dumps(document))
    names, initial, sigmas, detector = (
        list(document["initial"]),
        *(changed[k] for k in ("initial", "typical_sigma", "detector")),
    )
    if how == 0:
        return "wrong sensor", others[int(rng.integers(len(others)))]
    if how == 1:
        changed["parity"] = -changed["parity"]
    elif how == 2:
        initial["f_m"] *= float(rng.choice([0.5, 0.9, 1.02, 2.0]))
    elif how == 3:
        factor = float(rng.choice([1e-6, 1e-3, 1e3, 1e6]))
        changed["typical_sigma"] = {name: value * factor for name, value in sigmas.items()}
    elif how == 4:
        changed["centroid_sigma_px"] = float(rng.choice([1e-4, 1e-2, 10.0, 100.0]))
    elif how == 5:
        changed["magnitude_limit"] = float(rng.choice([-1.0, 1.0, 3.0, 8.0]))
    elif how == 6:
        detector["rows"], detector["columns"] = detector["columns"], detector["rows"]
    elif how == 7:
        changed["free"] = [str(rng.choice(names))]
    elif how == 8:
        name = str(rng.choice(names))
        initial[name] += float(rng.choice([-30.0, -5.0, 5.0, 30.0])) * sigmas[name]
    return (f"sensor {how}" if how <= 8 else ""), changed


Choices = list[tuple[str, float, list[Any]]]


def choices(rng: np.random.Generator, method: str, names: list[str]) -> dict[str, Any]:
    """Draw the settings of a calibration by a method; some exclude one another, and are refused."""
    drawn: dict[str, Any] = {"method": method, "match": str(rng.choice(["given", "rematch"]))}
    if method != "batch":
        drawn["variant"] = str(rng.choice(list(OPTIONS["variant"].words)))
    at_all: Choices = [
        ("free", 0.3, [names[:1], names[:3], names[-2:], [names[int(rng.integers(len(names)))]], names]),
        ("match_parameters", 0.15, ["baseline", "latest"]),
        ("match_rule", 0.15, ["flight"]),
        ("flight_tolerance_urad", 0.1, [0.1, 10.0, 1000.0, 1e5]),
        ("leave_out_doubles", 0.1, [True]),
        ("minimum_stars", 0.15, [4, 5, 8, 1000]),
        ("initial_sigma_scale", 0.15, [1e-3, 1.0, 100.0, 1e4]),
    ]
    in_batch: Choices = [
        ("max_iterations", 0.1, [1, 2]), ("error", 0.15, ["cosine"]), ("robust", 0.2, ["stars", "huber"]),
        ("huber_threshold", 0.1, [0.1, 10.0]),
    ]  # fmt: skip
    in_filters: Choices = [
        ("linearisations", 0.2, [1, 2, 100]), ("process_noise_sigma", 0.15, [0.0, 1.0, 10.0]),
        ("forgetting_factor", 0.15, [0.5, 0.9]),
    ]  # fmt: skip
    in_svd: Choices = [("star_model", 0.3, [1, 2, 3]), ("singular_values", 0.3, [[1], [2], [3], [1, 2], [1, 2, 3]])]
    gain: Choices = [("gain_form", 0.2, ["gain"])]
    some = at_all + (in_batch if method == "batch" else in_filters)
    for name, share, values in some + in_svd * (method == "svd") + gain * (method in {"svd", "angular"}):
        if rng.random() < share:
            drawn[name] = values[int(rng.integers(len(values)))]
    return drawn


# --- files


def read_table(path: Path) -> Table:
    """Read a good CSV as texts."""
    header, *lines = path.read_text().replace('"', "").splitlines()
    cells = [line.split(",") for line in lines]
    return Table({name: [row[place] for row in cells] for place, name in enumerate(header.split(","))})


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
            tables.append(read_table(path))
        bases.append(Base(scenario.sensor, *tables))
    return bases


def with_directions(telemetry: Telemetry, catalogue: Catalogue) -> Telemetry:
    """Give every matched row the apparent direction of its star."""
    s_i = star_directions(telemetry.star_id, None, None, telemetry.time_utc, telemetry.velocity_m_s, catalogue)
    ra, dec = np.arctan2(s_i[:, 1], s_i[:, 0]) % (2 * np.pi), np.arcsin(s_i[:, 2])
    return replace(telemetry, ra_rad=ra, dec_rad=dec)


def make_case(number_of_case: int, bases: list[Base], folder: Path, seed: int = SEED) -> Case:
    """Make a case: the same for its number and seed, whatever other cases there are."""
    rng = np.random.default_rng([seed, number_of_case])
    base = bases[int(rng.integers(len(bases)))]
    table, validation = (
        Table({name: [*cells] for name, cells in of.items()}) for of in (base.calibration, base.validation)
    )
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
    validation_set = spoilt is validation or rng.random() < 0.3
    path = folder / f"case-{number_of_case}"
    return Case(
        number=number_of_case,
        names=(*(edit.__name__ for edit in edits), *filter(None, [odd, "validation" if spoilt is validation else ""])),
        method=method, settings=settings, sensor=sensor, telemetry=written(table, path, form),
        validation=written(validation, path.with_name(f"{path.name}-validation"), form) if validation_set else None,
        in_pieces=bool(rng.random() < 0.1),
    )  # fmt: skip


def run(case: Case, catalogue: Catalogue, cache: Path | None) -> Ended:
    """Calibrate a case as the command line does."""
    began = time.perf_counter()

    def ended(kind: str, words: str, document: dict[str, Any] | None = None) -> Ended:
        return Ended(case, kind, words, time.perf_counter() - began, document)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            document = calibrated(case, catalogue, cache)
            wrong = find_faults(document)
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
    validation_set = None if case.validation is None else TelemetryFile(case.validation).opened()
    return calibrate(
        TelemetryFile(case.telemetry, **most).opened(),
        parse_sensor(case.sensor),
        catalogue,
        CalibrationSettings.parse(case.settings),
        validation=validation_set,
        cache_folder=cache,
    ).to_dict()


def find_faults(document: Mapping[str, Any]) -> list[str]:
    """What is wrong with a result."""
    read, advice, found = json.loads(orjson.dumps(document)), document["advice"], []
    if document["status"] not in STATUSES:
        found.append(f"status {document['status']}")
    if document["status"] != "converged" and not advice:
        found.append(f"{document['status']} without advice")
    if document["status"] == "converged":
        if None in read["parameters"].values():
            found.append("converged with parameters that are no numbers")
        if bad := [name for name in document["free"] if read["sigma"][name] is None or not document["sigma"][name] > 0]:
            found.append(f"converged with no sigma of {', '.join(bad)}{'' if advice else ' and without advice'}")
        if any(None in row for row in read["covariance"]["matrix"]):
            found.append("converged with a covariance that is no matrix of numbers")
    if not all(isinstance(sentence, str) and sentence.strip() for sentence in advice):
        found.append("advice that is no sentence")
    return found


def list_options(case: Case, sensor_file: Path) -> list[str]:
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
    done = CliRunner().invoke(boresight_command, list_options(case, sensor_file))
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
    found = parse_calibration(result)
    render_report(found)
    for figure in FIGURES.values():
        orjson.dumps(figure.draw([Trace("edited", found)]).to_plotly_json(), option=orjson.OPT_SERIALIZE_NUMPY)
        figure.table(found)
    if result["status"] not in {"diverged", "too_few_stars"} and result["camera_model"] in CAMERA_MODELS:
        assess(found, sensor, ground_set(sensor), parse_profile({}))


@click.command(help=__doc__)
@click.option("--edits", default=2000)
@click.option("--seed", default=SEED)
@click.option("--only", default="", help="Numbers of cases, as 17,230.")
@click.option("--from", "first", default=0)
@json_option
def main(*, edits: int, seed: int, only: str, first: int, json_file: str | None) -> None:
    """Run the cases that were asked for and print what came of them; exit code 1 where there is a defect."""
    numbers = [int(text) for text in only.split(",")] if only else range(first, edits)
    began, kinds, statuses, defects, slowest_s = time.perf_counter(), Counter[str](), Counter[str](), [], 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["BORESIGHT_DATA_FOLDER"] = name  # the command line's own catalogue is the one made here
        catalogue = load_catalogue(folder / "catalogue")
        bases = good_sets(catalogue, folder)
        for case_number in numbers:
            case = make_case(case_number, bases, folder, seed)
            end = run(case, catalogue, folder / "catalogue")
            if case_number % DOOR_EVERY == 0 and (wrong := through_the_door(case, folder / "sensor.json")) is not None:
                end = replace(end, kind="defect", words=wrong)
            case.telemetry.unlink()
            told = {"case": case_number, "edits": case.names, "settings": case.settings, "words": end.words}
            kinds.update([end.kind, f"{case.method}: {end.kind}"])
            statuses.update([end.words] if end.kind == "result" else [])
            defects += [told] if end.kind == "defect" else []
            slowest_s = max(slowest_s, end.seconds)
            if end.kind == "defect" or only or end.seconds > SLOW_S:
                print(f"--- {end.kind} {end.seconds:.1f} s {told}", file=sys.stderr, flush=True)
    found = {
        "edits": len(numbers),
        "seconds": round(time.perf_counter() - began, 1),
        "kinds": dict(sorted(kinds.items())),
    }
    found |= {"statuses": dict(statuses.most_common()), "slowest_s": round(slowest_s, 2), "defects": defects}
    write_json(found, json_file or "-")
    sys.exit(bool(defects))


if __name__ == "__main__":
    main()
