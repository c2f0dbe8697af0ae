"""What a calibration assumes that its data cannot show: declared, or named as assumed, with what an error in it would do.

Sizes, for a tracker whose half diagonal is theta and whose pixel is 1 / f_px radians: aberration by a velocity v turns a star by
v / c sin(angle to v), so the field is stretched by up to v / c: 2.5e-5 for 7.6 km/s, 1.0e-4 for the Earth's 29.8 km/s, which is
the change of focal length that would be fitted for it. Refraction R = 2.9e-4 tan z (Bennett, at the sea's level) stretches the
field by 2.9e-4 across the vertical and by 2.9e-4 / cos^2 z along it. A rolling shutter displaces stars by their speed times the
time of a readout.
"""

from __future__ import annotations

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.calibration import Assumption
from boresight.calibration.readout import ReadoutCorrection, find_rates
from boresight.cameras import CAMERA_MODELS
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.declarations import DECLARATIONS
from boresight.telemetry.schema import Telemetry, select_rows
from boresight.telemetry.sensors import Sensor

#: A usual time of a rolling readout, and a usual rate, where the set tells none.
USUAL_READOUT_S, USUAL_RATE_DEG_S = 0.05, 0.06
#: Rows that the speed of a set is found from.
MOST_ROWS = 20_000
WHERE = "declare it in the sensor file"


def list_assumptions(
    telemetry: Telemetry,
    named: Telemetry,
    sensor: Sensor,
    catalogue: Catalogue,
    x: FloatArray,
    done: ReadoutCorrection,
) -> list[Assumption]:
    """List what a calibration assumes.

    `telemetry`: the set, or a part, as it came; `named`: with matched stars. `x`: (n_parameters,) result. `done`: about the
    readout.
    """
    corner_px = np.hypot(sensor.rows, sensor.columns) / 2
    return [
        _readout(named, sensor, catalogue, x, done),
        *(make(telemetry, sensor, float(corner_px)) for make in (_velocity, _directions, _refraction)),
    ]


def _readout(
    telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue, x: FloatArray, done: ReadoutCorrection
) -> Assumption:
    readout = sensor.readout
    if readout is None:
        speed, known = _speed_px_s(telemetry, sensor, catalogue, x)
        sentence = (
            f"Nobody declared how the detector is read, so a global shutter is assumed. At {speed:.3g} px/s"
            f"{'' if known else f', {USUAL_RATE_DEG_S:g} °/s,'} a rolling shutter of {USUAL_READOUT_S * 1e3:.0f} ms would displace "
            f"stars by up to {speed * USUAL_READOUT_S:.2g} px, which parameters take up with no sign in the residuals: "
            "declare `readout` in the sensor file."
        )
        return Assumption(name="readout", declared=False, value="global shutter", sentence=sentence)
    said = readout.words
    if not readout.is_in_centroids:
        return Assumption(name="readout", declared=True, value=said, sentence=f"Declared: {said}.")
    if not done.moved:
        sentence = (
            f"Declared: {said}. No rate is known to correct it with, so it stays in the centroids and in the parameters: give "
            "time_utc and quaternions, or exposures less than a minute apart with identified stars."
        )
        return Assumption(name="readout", declared=True, value=f"{said}: left in", sentence=sentence, left_in=True)
    left = done.exposures - done.moved
    sentence = (
        f"Declared: {said}. Centroids of {done.moved:,} of {done.exposures:,} exposures were moved back to the first line's time, "
        f"by up to {done.largest_px:.3g} px at {done.rate_deg_s:.3g} °/s, with rates from {done.source}"
        + (f"; {left:,} exposures have no rate and stay as they are." if left else ".")
    )
    return Assumption(
        name="readout", declared=True, value=f"{said}: corrected here", sentence=sentence, left_in=left > 0
    )


def _speed_px_s(telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue, x: FloatArray) -> tuple[float, bool]:
    """Median speed of stars over the detector, pixels a second, and whether it is of this set."""
    focal_px = CAMERA_MODELS[sensor.camera_model].focal_px(x, sensor.pixel_pitch_m)
    some = select_rows(telemetry, slice(0, min(len(telemetry), MOST_ROWS)))
    rates = find_rates(some, sensor, catalogue, x)
    if rates is None:
        return focal_px * float(np.radians(USUAL_RATE_DEG_S)), False
    across = np.hypot(rates.w[rates.known, 0], rates.w[rates.known, 1])
    return focal_px * float(np.median(across)), True


def _words(name: str, word: str) -> str:
    return f"{DECLARATIONS[name].title}: {word}, {DECLARATIONS[name].words[word]}"


def _velocity(telemetry: Telemetry, sensor: Sensor, corner_px: float) -> Assumption:
    name, word = "satellite_velocity", sensor.declared.satellite_velocity
    if telemetry.velocity_m_s is not None:
        return Assumption(
            name=name, declared=True, value="given", sentence="The telemetry gives the satellite's velocity."
        )
    if word == "negligible" or (word == "given" and telemetry.ra_rad is not None):
        return Assumption(name=name, declared=True, value=word, sentence=f"Declared. {_words(name, word)}.")
    opening = (
        "Declared as given, yet this telemetry has none" if word else "The telemetry gives no velocity of the satellite"
    )
    sentence = (
        f"{opening}, so none is assumed. In a low orbit 5 arcsec of aberration would stretch the field by up to 25 ppm, "
        f"{25e-6 * corner_px:.2g} px at the corner, and be fitted as focal length: give vx_km_s, vy_km_s and vz_km_s, or {WHERE}."
    )
    return Assumption(name=name, declared=False, value="none", sentence=sentence)


def _directions(telemetry: Telemetry, sensor: Sensor, corner_px: float) -> Assumption:
    name, word = "directions", sensor.declared.directions
    if word == "j2000" and telemetry.ra_rad is not None:
        sentence = (
            "Declared as of J2000.0: apparent directions were computed with proper motion, parallax and aberration."
        )
        return Assumption(name=name, declared=True, value="apparent, computed from J2000.0", sentence=sentence)
    if telemetry.ra_rad is None:
        sentence = "The telemetry gives no directions: apparent ones are computed from the catalogue."
        return Assumption(name=name, declared=True, value="computed from the catalogue", sentence=sentence)
    if word is not None:
        return Assumption(name=name, declared=True, value=word, sentence=f"Declared. {_words(name, word)}.")
    sentence = (
        "Directions that the telemetry gives are assumed to be apparent. If they are of J2000.0, 20 arcsec of aberration stretch "
        f"the field by up to 100 ppm, {100e-6 * corner_px:.2g} px at the corner, and are fitted as focal length: {WHERE}."
    )
    return Assumption(name=name, declared=False, value="apparent", sentence=sentence)


def _refraction(telemetry: Telemetry, sensor: Sensor, corner_px: float) -> Assumption:  # noqa: ARG001 - one signature for all
    name, word = "refraction", sensor.declared.refraction
    size = f"at least 290 ppm, {290e-6 * corner_px:.2g} px at the corner, and more toward the horizon"
    if word == "uncorrected":
        sentence = (
            f"Declared: images from the ground with refraction left in. It changes the scale by {size}, and is in these "
            "parameters: correct directions for it, or do not use them for a sensor in space."
        )
        return Assumption(name=name, declared=True, value=word, sentence=sentence, left_in=True)
    if word is not None:
        return Assumption(name=name, declared=True, value=word, sentence=f"Declared. {_words(name, word)}.")
    sentence = f"No refraction is assumed, as in space. Of images from the ground it would change the scale by {size}: {WHERE}."
    return Assumption(name=name, declared=False, value="none", sentence=sentence)
