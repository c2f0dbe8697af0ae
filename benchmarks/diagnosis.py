"""Whether a diagnosis names what is wrong with a set: forty-eight wrong inputs, each mistake alone and in pairs (part `diagnosis`).

The sets are an ST-16's from orbit with real stars, false detections and no star named, once under its ground calibration and once
under one that knows its principal point; and the five real images of a ground camera, where they are at hand. Each input spoils
sensor file or telemetry. A diagnosis is right where the causes that it names together are the mistakes made; of a mirrored image
also where the mistake is one of those that it says stars cannot tell from the cause named. It has mended wrongly where it proposes
sensor file or mapping, and the whole set, matched again with these, names more than one star in a hundred otherwise than the truth,
has a focal length more than 1 % off, or anything is mended that was not spoiled. Beside it stands what a calibration says of the
same input without it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from benchmarks import ROOT, Report, held
from boresight.arrays import FloatArray, IntArray
from boresight.calibration.calibrate import calibrate
from boresight.calibration.diagnosis import explain
from boresight.calibration.diagnosis.diagnose import diagnose
from boresight.calibration.diagnosis.result import Diagnosis, FoundCause
from boresight.calibration.matching.rematch import ground_covariance, rematch
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import Role
from boresight.errors import RefusedInputError
from boresight.settings import read_settings
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_truth
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.mapping import parse_mapping
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor, parse_sensor, read_sensor

#: What stands for a diagnosis where a calibration is to ask none.
NOTHING_SAID = Diagnosis(sensor="", causes=[FoundCause(name="none", exposures_solved=0, exposures=0)], sentence="")
#: Of all inputs so many are to be diagnosed rightly, and none is to be mended wrongly.
GOAL, OF = 46, 48
#: What may be wrong by the focal length of a mended file, and stars named otherwise than the truth, of those matched.
FOCAL_ERROR, WRONG_STARS = 0.01, 0.01
REAL = Path(os.environ.get("BORESIGHT_REAL_SKY", ROOT.parent / "shared/data/real-sky"))
J2000_S = 946_728_000


@dataclass(frozen=True)
class Input:
    """A telemetry set and its sensor file; `truth`: (n_rows,) stars, 0 = unknown or none; `focal_m`: the true focal length."""

    telemetry: Telemetry
    sensor: Sensor
    truth: IntArray
    focal_m: float


Spoil = Callable[[Input, Catalogue], Input]


def told(one: Input, **changes: Any) -> Input:
    """Return an input with other telemetry."""
    return replace(one, telemetry=replace(one.telemetry, **changes))


def described(one: Input, **changes: Any) -> Input:
    """Return an input with another sensor file."""
    return replace(one, sensor=replace(one.sensor, **changes))


def _focal(ratio: float) -> Spoil:
    def spoil(one: Input, _: Catalogue) -> Input:
        x = one.sensor.initial.copy()
        x[CAMERA_MODELS[one.sensor.camera_model].place(Role.FOCAL)] *= ratio
        return described(one, initial=x)

    return spoil


def _origin(px: float) -> Spoil:
    return lambda one, _: told(one, row_px=one.telemetry.row_px + px, col_px=one.telemetry.col_px + px)


def _from_the_middle(one: Input, _: Catalogue) -> Input:
    row, col = ((size - 1.0) / 2.0 for size in (one.sensor.rows, one.sensor.columns))
    return told(one, row_px=one.telemetry.row_px - row, col_px=one.telemetry.col_px - col)


def _in_units_of(metres: float) -> Spoil:
    def spoil(one: Input, _: Catalogue) -> Input:
        units = one.sensor.pixel_pitch_m / metres
        return told(one, row_px=one.telemetry.row_px * units, col_px=one.telemetry.col_px * units)

    return spoil


def _limit(magnitude: float) -> Spoil:
    return lambda one, _: described(one, magnitude_limit=magnitude)


def _of_j2000(one: Input, catalogue: Catalogue) -> Input:
    """Name the true stars with their catalogue places of J2000.0."""
    index = catalogue.find_index(one.truth)
    known = (one.truth > 0) & (index >= 0)
    years = 8.75
    ra = catalogue.ra_rad[index] + years * catalogue.pm_ra_cosdec_rad_yr[index] / np.cos(catalogue.dec_rad[index])
    dec = catalogue.dec_rad[index] + years * catalogue.pm_dec_rad_yr[index]
    return told(
        one,
        star_id=np.where(known, one.truth, 0),
        ra_rad=np.where(known, ra, np.nan),
        dec_rad=np.where(known, dec, np.nan),
    )


def _turned(order: str) -> Spoil:
    def spoil(one: Input, _: Catalogue) -> Input:
        assert one.telemetry.quaternion is not None
        q = one.telemetry.quaternion
        return told(one, quaternion=np.roll(q, 1, axis=1) if order == "wxyz" else q * np.array([-1.0, -1.0, -1.0, 1.0]))

    return spoil


def _epoch(seconds: int) -> Spoil:
    def spoil(one: Input, _: Catalogue) -> Input:
        assert one.telemetry.time_utc is not None
        return told(one, time_utc=one.telemetry.time_utc - np.timedelta64(seconds, "s"))

    return spoil


#: Every mistake by a name of its own, with the cause that it is.
MISTAKES: dict[str, tuple[str, Spoil]] = {
    "parity": ("parity", lambda one, _: described(one, parity=-one.sensor.parity)),
    "swapped axes": (
        "swapped_axes",
        lambda one, _: told(one, row_px=one.telemetry.col_px, col_px=one.telemetry.row_px),
    ),
    "flipped rows": ("flipped_rows", lambda one, _: told(one, row_px=one.sensor.rows - 1 - one.telemetry.row_px)),
    "flipped columns": (
        "flipped_columns",
        lambda one, _: told(one, col_px=one.sensor.columns - 1 - one.telemetry.col_px),
    ),
    "origin half a pixel": ("half_pixel", _origin(0.5)),
    "origin one pixel": ("half_pixel", _origin(1.0)),
    "pixels from the middle": ("centred_origin", _from_the_middle),
    "millimetres": ("length_unit", _in_units_of(1e-3)),
    "micrometres": ("length_unit", _in_units_of(1e-6)),
    "focal length -40 %": ("focal_length", _focal(0.6)),
    "focal length +40 %": ("focal_length", _focal(1.4)),
    "focal length +7 %": ("focal_length", _focal(1.07)),
    "directions of J2000.0": ("j2000_directions", _of_j2000),
    "quaternion w x y z": ("quaternion_order", _turned("wxyz")),
    "quaternion inverse": ("quaternion_order", _turned("inverse")),
    "no time": ("no_time", lambda one, _: told(one, time_utc=None)),
    "seconds of J2000 as Unix's": ("wrong_epoch", _epoch(J2000_S)),
    "limit too bright": ("magnitude_limit", _limit(3.0)),
    "limit too faint": ("magnitude_limit", _limit(9.5)),
}
ORBIT, KNOWN, GROUND = "orbit", "orbit, principal point known", "real field"
#: What is read of every set: lengths of another unit, and another origin.
LENGTHS = ("pixels from the middle", "millimetres", "micrometres")
#: The inputs: the set, and the mistakes.
INPUTS: tuple[tuple[str, tuple[str, ...]], ...] = (
    *(
        (ORBIT, (name,))
        for name in MISTAKES
        if not name.startswith("origin") and name != "focal length +7 %" and name not in LENGTHS
    ),
    *((KNOWN, (name,)) for name in ("origin half a pixel", "origin one pixel")),
    *(
        (GROUND, (name,))
        for name in (
            "parity", "swapped axes", "flipped rows", "flipped columns", "origin half a pixel", "focal length -40 %",
            "focal length +40 %", "directions of J2000.0", "quaternion w x y z", "no time", "seconds of J2000 as Unix's",
            "limit too bright",
        )
    ),
    (ORBIT, ("parity", "focal length +40 %")),
    (ORBIT, ("parity", "no time")),
    (ORBIT, ("parity", "limit too bright")),
    (ORBIT, ("swapped axes", "focal length -40 %")),
    (ORBIT, ("parity", "swapped axes")),
    (ORBIT, ("flipped rows", "quaternion w x y z")),
    (ORBIT, ("focal length +7 %", "seconds of J2000 as Unix's")),
    (KNOWN, ("parity", "origin one pixel")),
    (GROUND, ("parity", "focal length +40 %")),
    (GROUND, ("swapped axes", "focal length -40 %")),
    (GROUND, ("parity", "no time")),
    (GROUND, ("parity", "directions of J2000.0")),
    (ORBIT, ("focal length +40 %", "no time")),
    (ORBIT, ("pixels from the middle",)),
    (ORBIT, ("millimetres",)),
    (GROUND, ("pixels from the middle",)),
    (GROUND, ("micrometres",)),
    (ORBIT, ("pixels from the middle", "millimetres")),
    (GROUND, ("pixels from the middle", "micrometres")),
    (ORBIT, ("parity", "micrometres")),
    (ORBIT, ("focal length +40 %", "pixels from the middle")),
)  # fmt: skip
#: Causes that mirror an image.
MIRRORING = {"parity", "swapped_axes", "flipped_rows", "flipped_columns"}


def make_sets(catalogue: Catalogue, frames: int, seed: int) -> dict[str, Input]:
    """Return the sets as they are, before anything is spoiled."""
    scenario = replace(calibration_scenario(1, frames), false_stars=1.0, blanked_share=0.0)
    telemetry = simulate(scenario, np.random.default_rng(seed), catalogue)
    truth, x = np.zeros(0, np.int64) if telemetry.star_id is None else telemetry.star_id, st16_truth(1)
    nameless = replace(telemetry, star_id=None)
    calibrated = replace(
        scenario.sensor, initial=x, typical_sigma=np.minimum(scenario.sensor.typical_sigma, _known(scenario.sensor))
    )
    sets = {
        ORBIT: Input(nameless, scenario.sensor, truth, float(x[0])),
        KNOWN: Input(nameless, calibrated, truth, float(x[0])),
    }
    if REAL.is_dir():
        sets[GROUND] = _ground(catalogue)
    return sets


def _known(sensor: Sensor) -> FloatArray:
    """Sigmas of a calibration that knows the principal point to a twentieth of a pixel."""
    sigma = 0.1 * sensor.typical_sigma
    sigma[list(CAMERA_MODELS[sensor.camera_model].principal_places)] = 0.05
    return sigma


def _ground(catalogue: Catalogue) -> Input:
    """The real field without names, with the attitudes that its own matching finds."""
    telemetry, sensor = read_telemetry(REAL / "esa-5-frames.csv"), read_sensor(REAL / "esa.sensor.json")
    settings = CalibrationSettings()
    found = rematch(
        telemetry, sensor, catalogue, sensor.initial, ground_covariance(sensor, settings.initial_sigma_scale), settings,
        read_settings().catalogue_folder,
    )  # fmt: skip
    quaternion = np.repeat(found.quaternion, np.diff(found.exposure_start), axis=0)
    truth = np.zeros(len(telemetry), np.int64) if telemetry.star_id is None else telemetry.star_id
    bare = replace(telemetry, star_id=None, ra_rad=None, dec_rad=None, quaternion=quaternion)
    return Input(bare, sensor, truth, 0.0353)


def measure(report: Report, *, frames: int = 30, seed: int = 1, inputs: int = OF) -> dict[str, Any]:
    """Diagnose the inputs, the first `inputs` of them."""
    folder = read_settings().catalogue_folder
    catalogue = load_catalogue(folder)
    sets = make_sets(catalogue, frames, seed)
    rows = list[dict[str, Any]]()
    chosen = [one for one in INPUTS if one[0] in sets][:inputs]
    for k, (name, mistakes) in enumerate(chosen):
        report(k / len(chosen), f"{name}: {' and '.join(mistakes)}")
        rows.append(judge(sets[name], name, mistakes, catalogue, folder))
    right, wrong = sum(row["right"] for row in rows), sum(row["wrongly_mended"] for row in rows)
    return {
        "inputs": rows,
        "right": right,
        "wrongly_mended": wrong,
        "of": len(rows),
        "solved_today": sum(row["today_solved"] for row in rows),
        "limits": {
            "diagnosed_rightly": held(GOAL if len(rows) == OF else len(rows) - 2, right, at_least=True),
            "wrongly_mended": held(0, wrong),
        },
    }


def judge(
    clean: Input, name: str, mistakes: Sequence[str], catalogue: Catalogue, folder: Path | None
) -> dict[str, Any]:
    """Spoil a set, diagnose it, and hold the diagnosis against what was done."""
    spoiled = spoil(clean, mistakes, catalogue)
    began = time.perf_counter()
    found = diagnose(spoiled.telemetry, spoiled.sensor, catalogue, cache_folder=folder)
    took_s = time.perf_counter() - began
    causes = {MISTAKES[one][0] for one in mistakes}
    today, solved = ask_today(spoiled, catalogue, folder)
    return {
        "set": name,
        "mistakes": list(mistakes),
        "causes": list(found.names),
        "alternatives": [one.name for one in found.causes if one.alternative],
        "exposures_solved": found.exposures_solved,
        "exposures": found.exposures,
        "right": is_right(found, causes),
        "wrongly_mended": mends_wrongly(found, spoiled, causes, catalogue, folder),
        "took_s": took_s,
        "sentence": found.sentence,
        "today": today,
        "today_solved": solved,
    }


def spoil(clean: Input, mistakes: Sequence[str], catalogue: Catalogue) -> Input:
    """Make mistakes, one after the other; in the order in which their mends are undone, exchanging axes last."""
    spoiled = clean
    for one in sorted(mistakes, key=lambda one: one == "swapped axes"):
        spoiled = MISTAKES[one][1](spoiled, catalogue)
    return spoiled


def is_right(found: Diagnosis, causes: set[str]) -> bool:
    """Whether the causes named are those; a mirror may be one of those that stars cannot tell apart."""
    named, alike = set(found.names), {one.name for one in found.causes if one.alternative}
    if named == causes:
        return True
    return named - MIRRORING == causes - MIRRORING and len(named) == len(causes) and causes - named <= alike


def mends_wrongly(
    found: Diagnosis, spoiled: Input, causes: set[str], catalogue: Catalogue, folder: Path | None
) -> bool:
    """Whether what is mended makes wrong stars, a wrong focal length, or touches what was right."""
    if found.sensor_document is None or found.fits:
        return False
    if not is_right(found, causes) and not set(found.names) <= causes:
        return True
    sensor = parse_sensor(found.sensor_document)
    focal = sensor.initial[CAMERA_MODELS[sensor.camera_model].place(Role.FOCAL)]
    if "focal_length" in found.names and abs(focal / spoiled.focal_m - 1) > FOCAL_ERROR:
        return True
    telemetry = spoiled.telemetry
    if found.mapping is not None:
        telemetry = parse_mapping(found.mapping).apply(telemetry, sensor)
    if telemetry.time_utc is None:
        return False
    settings = CalibrationSettings()
    P = ground_covariance(sensor, settings.initial_sigma_scale)
    star = rematch(replace(telemetry, star_id=None), sensor, catalogue, sensor.initial, P, settings, folder).star_id
    both = (star > 0) & (spoiled.truth > 0)
    return not both.any() or float(np.mean(star[both] != spoiled.truth[both])) > WRONG_STARS


def ask_today(spoiled: Input, catalogue: Catalogue, folder: Path | None) -> tuple[str, bool]:
    """What a calibration that asks no diagnosis says first of an input, and whether it ends well."""
    with mock.patch.object(explain, "diagnose", return_value=NOTHING_SAID):
        try:
            found = calibrate(spoiled.telemetry, spoiled.sensor, catalogue, CalibrationSettings(), cache_folder=folder)
        except RefusedInputError as error:
            return str(error), False
    return (found.advice or ["nothing"])[0], found.status == "converged"
