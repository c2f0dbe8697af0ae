"""A diagnosis in words: what was tried in a phrase, and what was found and is to be done in a sentence."""

from __future__ import annotations

import numpy as np

from boresight.calibration.advice_kinds import Advice
from boresight.calibration.diagnosis.result import CAUSES, MOST_OFF, Diagnosis
from boresight.calibration.diagnosis.trials import Hypothesis, Trial
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import Role
from boresight.telemetry.sensors import Sensor

MM_PER_M = 1e3


def describe(hypothesis: Hypothesis) -> str:
    """Name a hypothesis in a phrase."""
    mapping = hypothesis.mapping
    said = [
        "the other parity" if hypothesis.parity else "",
        "rows and columns swapped" if mapping.swapped_axes else "",
        "rows from the other edge" if mapping.flipped_rows else "",
        "columns from the other edge" if mapping.flipped_columns else "",
        f"origin {mapping.origin_px:g} px" if mapping.origin_px else "",
        "from the middle of the detector" if mapping.centred else "",
        f"lengths of {mapping.unit_px:.4g} px" if mapping.unit_px != 1 else "",
        f"focal length {100 * (hypothesis.focal_ratio - 1):+.2f} %" if hypothesis.focal_ratio != 1 else "",
        _limit(hypothesis.limit),
        f"directions as {hypothesis.directions}" if hypothesis.directions else "",
        f"quaternions {mapping.quaternion_order} {mapping.quaternion_sense}" if _turned(hypothesis) else "",
        f"times {_shift(mapping.time_shift_s)}" if mapping.time_shift_s else "",
    ]
    return ", ".join(part for part in said if part) or "the files as they are"


def _limit(limit: float | None) -> str:
    if limit is None:
        return ""
    return "magnitude limit by the number of stars" if np.isnan(limit) else f"magnitude limit {limit:g}"


def _turned(hypothesis: Hypothesis) -> bool:
    mapping = hypothesis.mapping
    return (mapping.quaternion_order, mapping.quaternion_sense) != ("xyzw", "icrs_to_detector")


def _shift(seconds: float) -> str:
    years = seconds / (365.25 * 86400)
    return f"{seconds:+,.0f} s ({years:+.1f} years)"


def say(found: Diagnosis, best: Trial, sensor: Sensor) -> str:
    """Say in a sentence what is wrong, how surely, and what to do."""
    looked = f"{found.exposures:,} exposures"
    if found.of_exposures > found.exposures:
        looked += f" of {found.of_exposures:,} tried"
    if found.fits:
        return f"Sensor file and telemetry match: {found.exposures_solved:,} of {looked} match as they are."
    if "unknown" in found.names:
        return _say_unknown(found, looked)
    parts = [_clause(name, best, sensor) for name in found.names]
    others = [CAUSES[cause.name] for cause in found.causes if cause.alternative]
    told = "; ".join(parts)
    if others:
        told += f" (or {' or '.join(others)}: stars alone cannot separate these)"
    if found.names == ("no_time",):
        return (
            f"{told[0].upper()}{told[1:]}. Everything else is correct: {found.exposures_solved:,} of {looked} match once this is "
            "ignored."
        )
    before = f"{found.exposures_solved_before:,} with the files as they are"
    return f"{told[0].upper()}{told[1:]}: corrected, {found.exposures_solved:,} of {looked} match, {before}."


def _say_unknown(found: Diagnosis, looked: str) -> str:
    known = [CAUSES[name] for name in found.names if name != "unknown"]
    told = f"{'; '.join(known)}. ".capitalize() if known else ""
    short = " (the search stopped at the time limit)" if found.cut_short else ""
    if found.off_detector > MOST_OFF and not {"centred_origin", "length_unit"} & set(found.names):
        return (
            f"{told}{100 * found.off_detector:.0f} % of the centroids are outside the detector of {found.sensor}, and none of the "
            f"tested corrections fixes this ({found.exposures_solved_before:,} of {looked} match as they are){short}: correct the "
            "detector's rows and columns, or say in a mapping profile how the file counts pixels."
        )
    told += (
        f"No tested correction makes enough of {looked} match ({found.exposures_solved_before:,} match unchanged){short}. Tested: "
        "parity, swapped or flipped axes, focal lengths from −40 % to +67 %, half and double, and the magnitude limit. A pixel "
        "origin of 0.5 or 1 would not prevent matching"
    )
    return (
        f"{told}: check that the centroids are stars (at least 4 per exposure, in pixels), and that sensor and telemetry share a "
        "camera, or let the stars propose a sensor file without a focal length: `boresight sensor new --telemetry FILE`."
    )


def _clause(name: str, best: Trial, sensor: Sensor) -> str:
    """Say what a cause is, with its number."""
    words = _CLAUSES.get(name)
    return CAUSES[name] if words is None else words(best, sensor)


def _parity_clause(best: Trial, _: Sensor) -> str:
    return f"the image is mirrored compared with the sensor file: parity {best.sensor.parity:+d} solves it"


def _origin_clause(best: Trial, _: Sensor) -> str:
    mapping = best.hypothesis.mapping
    origin = mapping.origin_px
    if mapping.centred:
        return f"the middle from which pixels are counted is {origin:g} px off the detector's"
    return f"pixels are counted from another origin: the centre of the first one is {origin:g}, not 0"


def _centre_clause(_: Trial, __: Sensor) -> str:
    return f"{CAUSES['centred_origin']}: in a mapping profile, origin centre"


def _unit_clause(best: Trial, sensor: Sensor) -> str:
    metres = best.hypothesis.mapping.unit_px * sensor.pixel_pitch_m
    unit = {-3: "millimetres", -6: "micrometres", 0: "metres"}[round(np.log10(metres))]
    return f"centroids are {unit}, not pixels: 1 of them is {best.hypothesis.mapping.unit_px:.4g} px"


def _limit_clause(best: Trial, sensor: Sensor) -> str:
    was, shown = sensor.magnitude_limit or 0.0, best.sensor.magnitude_limit or 0.0
    return f"the magnitude limit of {was:g} is too {'bright' if shown > was else 'faint'}; the stars indicate {shown:g}"


def _directions_clause(best: Trial, _: Sensor) -> str:
    return f"ra_deg and dec_deg are {'of J2000.0' if best.hypothesis.directions == 'j2000' else 'apparent'}: declare them so"


def _quaternion_clause(best: Trial, _: Sensor) -> str:
    mapping = best.hypothesis.mapping
    turned = "ICRS to detector" if mapping.quaternion_sense == "icrs_to_detector" else "detector to ICRS"
    return f"the quaternions are written {' '.join(mapping.quaternion_order)}, {turned}"


def _time_clause(best: Trial, _: Sensor) -> str:
    if best.telemetry.psf_sigma_px is not None:  # extracted from images
        return (
            "the images have no time, which is needed to compute catalogue directions: give --times FILE, CSV with image and "
            "time_utc"
        )
    return "the telemetry has no time, which is needed to compute catalogue directions: add time_utc (ISO 8601, UTC)"


def _epoch_clause(best: Trial, _: Sensor) -> str:
    return f"times are counted from another epoch: add {_shift(best.hypothesis.mapping.time_shift_s)}"


def _focal_clause(best: Trial, sensor: Sensor) -> str:
    camera = CAMERA_MODELS[sensor.camera_model]
    place, pitch = camera.place(Role.FOCAL), sensor.pixel_pitch_m
    focal, given = best.sensor.initial[place], sensor.initial[place]
    sigma = 0.0 if best.agreement is None else best.agreement.sigma[place] * best.agreement.noise
    mm = pitch * MM_PER_M / camera.focal_unit(pitch)
    spread = sigma * 10 * sensor.typical_sigma[place]
    return (
        f"the focal length is {focal * mm:.5g} ± {3 * spread * mm:.2g} mm (3 sigma), {100 * (focal / given - 1):+.3g} % "
        "off the sensor file's"
    )


_CLAUSES = {
    "parity": _parity_clause,
    "half_pixel": _origin_clause,
    "centred_origin": _centre_clause,
    "length_unit": _unit_clause,
    "focal_length": _focal_clause,
    "j2000_directions": _directions_clause,
    "quaternion_order": _quaternion_clause,
    "no_time": _time_clause,
    "wrong_epoch": _epoch_clause,
    "magnitude_limit": _limit_clause,
}


def advise(found: Diagnosis) -> list[Advice]:
    """What a calibration or a report says of a diagnosis: nothing where the files fit."""
    if found.fits:
        return []
    if "unknown" in found.names:
        return [Advice(found.sentence, "diagnosis")]
    said = f"{found.sentence} `boresight diagnose` and the page of a telemetry set write corrected files."
    return [Advice(said, "diagnosis")]
