"""What a calibration assumes that its data cannot show: declared, or named as assumed, with what an error in it would do.

Sizes, for a tracker whose half diagonal is theta and whose pixel is 1 / f_px radians: aberration by a velocity v turns a star by
v / c sin(angle to v), so the field is stretched by up to v / c: 2.5e-5 for 7.6 km/s, 1.0e-4 for the Earth's 29.8 km/s, which is
the change of focal length that would be fitted for it. Refraction R = 2.9e-4 tan z (Bennett, at the sea's level) stretches the
field by 2.9e-4 across the vertical and by 2.9e-4 / cos^2 z along it. A rolling shutter displaces stars by their speed times the
time of a readout. A decentred lens is nearly a principal point and a tilt besides; how much of it the tests of a set may miss, and
what that does, is computed (`trust.displacements`), and so it is for any other displacement that stays with a star's place on the
detector or its brightness: a seam between two halves of the readout, charge left behind along the rows, a window. A detector
tilted by a about an axis in it displaces a star at r from the principal point by a r (n.r) / f with n a unit vector; so does a
principal point that is a f off in the direction n, once the attitude has turned by a: for a camera without a tilt the one is the
other to second order in r / f, and no star tells which it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.calibration import Assumption, UnseenDeparture
from boresight.calibration.corrections import lacks_refraction
from boresight.calibration.readout import ReadoutCorrection, find_rates
from boresight.calibration.trust.trust_tests import MATTERS, TANGENTIAL, get_test_title
from boresight.cameras import CAMERA_MODELS, name_camera_with
from boresight.cameras.model import Role
from boresight.site import Site
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import star_directions
from boresight.sky.ground import air, earth_tables, elevation_deg, refraction_constants
from boresight.telemetry.declarations import DECLARATIONS
from boresight.telemetry.schema import Telemetry, select_rows
from boresight.telemetry.sensors import Sensor

#: A usual time of a rolling readout, and a usual rate, where the set tells none.
USUAL_READOUT_S, USUAL_RATE_DEG_S = 0.05, 0.06
#: A usual tilt of a detector.
USUAL_TILT_RAD = 1e-3
#: Rows that the speed of a set is found from.
MOST_ROWS = 20_000
WHERE = "declare it in the sensor file"


@dataclass(frozen=True)
class AirError:
    """What pressure and temperature may be off by: of a weather station, or where nobody gave them."""

    pressure_hpa: float
    temperature_c: float


KNOWN_AIR, UNKNOWN_AIR = AirError(1.0, 1.0), AirError(20.0, 10.0)
#: Elevation below which A tan Z + B tan^3 Z errs by more than 0.06 arcsec (`erfa.refco`).
FORMULA_DEG = 15.0
COLUMNS_OF_DIRECTIONS = ("star_id", "ra_rad", "dec_rad", "time_utc", "velocity_m_s")


def list_assumptions(
    telemetry: Telemetry,
    named: Telemetry,
    sensor: Sensor,
    catalogue: Catalogue,
    x: FloatArray,
    done: ReadoutCorrection,
    unseen: Sequence[UnseenDeparture] = (),
) -> list[Assumption]:
    """List what a calibration assumes.

    `telemetry`: the set, or a part, as it came; `named`: with matched stars. `x`: (n_parameters,) result. `done`: about the
    readout. `unseen`: what its tests may miss.
    """
    corner_px = np.hypot(sensor.rows, sensor.columns) / 2
    made = [
        _readout(named, sensor, catalogue, x, done),
        *(make(telemetry, sensor, float(corner_px)) for make in (_velocity, _directions)),
        *_tilt(sensor, x),
        *_decentring(sensor, unseen),
        _centroids(sensor, unseen),
    ]
    if sensor.site is None:
        return [*made, _refraction(telemetry, sensor, float(corner_px))]
    if telemetry.ra_rad is not None and not lacks_refraction(sensor):
        air_above = _refraction_given(sensor)
    else:
        air_above = _refraction_above(sensor.site, named, catalogue, float(corner_px))
    return [*made, air_above, _earth_rotation(telemetry)]


def _readout(
    telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue, x: FloatArray, done: ReadoutCorrection
) -> Assumption:
    readout = sensor.readout
    if readout is None:
        speed, known = _speed_px_s(telemetry, sensor, catalogue, x)
        sentence = (
            f"The sensor file does not declare how the detector is read, so a global shutter is assumed. At {speed:.3g} px/s"
            f"{'' if known else f', {USUAL_RATE_DEG_S:g} °/s,'} a rolling shutter of {USUAL_READOUT_S * 1e3:.0f} ms would displace "
            f"stars by up to {speed * USUAL_READOUT_S:.2g} px, which the parameters would absorb without any trace in the "
            "residuals: "
            "declare `readout` in the sensor file."
        )
        return Assumption(name="readout", declared=False, value="global shutter", sentence=sentence)
    said = readout.words
    if not readout.is_in_centroids:
        return Assumption(name="readout", declared=True, value=said, sentence=f"Declared: {said}.")
    if not done.moved:
        sentence = (
            f"Declared: {said}. It cannot be corrected because the rate is unknown, so the effect remains in the centroids and in "
            "the parameters: give time_utc and quaternions, or exposures less than a minute apart with identified stars."
        )
        return Assumption(name="readout", declared=True, value=f"{said}: left in", sentence=sentence, left_in=True)
    left = done.exposures - done.moved
    sentence = (
        f"Declared: {said}. Centroids of {done.moved:,} of {done.exposures:,} exposures were moved back to the first line's time, "
        f"by up to {done.largest_px:.3g} px at {done.rate_deg_s:.3g} °/s, with rates from {done.source}"
        + (f"; {left:,} without a rate are unchanged." if left else ".")
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
    if sensor.site is not None:
        sentence = "The site's own velocity, up to 0.3 arcsec of diurnal aberration, is computed from its position."
        return Assumption(name=name, declared=True, value="of the site", sentence=sentence)
    if word == "negligible" or (word == "given" and telemetry.ra_rad is not None):
        return Assumption(name=name, declared=True, value=word, sentence=f"Declared. {_words(name, word)}.")
    opening = (
        "Declared as given, but this telemetry has none" if word else "The telemetry gives no velocity of the satellite"
    )
    sentence = (
        f"{opening}, so zero velocity is assumed. In low orbit, 5 arcsec of aberration would stretch the field by up to 25 ppm, "
        f"{25e-6 * corner_px:.2g} px at the corner, and would be absorbed by the focal length: give vx_km_s, vy_km_s and vz_km_s, "
        f"or {WHERE}."
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
        "Directions in the telemetry are assumed to be apparent. If they are of J2000.0, 20 arcsec of aberration would stretch "
        f"the field by up to 100 ppm, {100e-6 * corner_px:.2g} px at the corner, and would be absorbed by the focal length: "
        f"{WHERE}."
    )
    return Assumption(name=name, declared=False, value="apparent", sentence=sentence)


def _refraction(telemetry: Telemetry, sensor: Sensor, corner_px: float) -> Assumption:  # noqa: ARG001 - one signature for all
    name, word = "refraction", sensor.declared.refraction
    size = f"at least 290 ppm, {290e-6 * corner_px:.2g} px at the corner, and more toward the horizon"
    if word == "uncorrected":
        sentence = (
            f"Declared: images from the ground with refraction left in. It changes the scale by {size}, which is "
            "included in these parameters: give `site` in the sensor file, or do not use the parameters in space."
        )
        return Assumption(name=name, declared=True, value=word, sentence=sentence, left_in=True)
    if word is not None:
        return Assumption(name=name, declared=True, value=word, sentence=f"Declared. {_words(name, word)}.")
    sentence = (
        f"No refraction is assumed, as in space. For images from the ground it would change the scale by {size}: {WHERE}, or give "
        "its `site`."
    )
    return Assumption(name=name, declared=False, value="none", sentence=sentence)


def _tilt(sensor: Sensor, x: FloatArray) -> list[Assumption]:
    """That the detector is square to the axis: of cameras that have no tilt."""
    camera, name, word = CAMERA_MODELS[sensor.camera_model], "tilt", sensor.declared.tilt
    if not DECLARATIONS[name].is_asked(camera):
        return []
    if word is not None:
        return [Assumption(name=name, declared=True, value=word, sentence=f"Declared. {_words(name, word)}.")]
    moved_px = USUAL_TILT_RAD * camera.focal_px(x, sensor.pixel_pitch_m)
    sentence = (
        f"The camera model has no tilt, so a detector square to the optical axis is assumed. A tilt of "
        f"{USUAL_TILT_RAD * 1e3:g} mrad would be fitted as a principal point {moved_px:.2g} px off, without any trace in the "
        f"residuals and with almost none in the directions of stars: calibrate with a model that has it, such as "
        f"{name_camera_with(Role.TILT)}, or {WHERE}."
    )
    return [Assumption(name=name, declared=False, value="none", sentence=sentence)]


def _decentring(sensor: Sensor, unseen: Sequence[UnseenDeparture]) -> list[Assumption]:
    """That the lens is centred: of cameras without tangential terms, where their tests may miss what matters."""
    name, word = "decentring", sensor.declared.decentring
    if not DECLARATIONS[name].is_asked(CAMERA_MODELS[sensor.camera_model]):
        return []
    if word is not None:
        return [Assumption(name=name, declared=True, value=word, sentence=f"Declared. {_words(name, word)}.")]
    most = next((one for one in unseen if one.name == TANGENTIAL), None)
    if most is None:
        how = "and the effect of undetected tangential distortion is unknown"
    elif most.sigmas is None:
        how = f"and tangential distortion cannot be separated from {most.parameter}"
    else:
        how = (
            f"tangential distortion of {most.size_px:.2g} px at the corner would go undetected in one of ten such sets, and "
            f"would shift {most.parameter} by {most.sigmas:.2g} claimed sigmas"
        )
        if most.sigmas <= MATTERS:
            said = f"Significant tangential distortion would be detected: {how}."
            return [Assumption(name=name, declared=True, value="would be detected", sentence=said)]
    sentence = (
        f"The camera model has no tangential terms, so a centred lens is assumed; {how}: calibrate with a model that has "
        f"them, such as {name_camera_with(Role.DECENTRING)}, or {WHERE}."
    )
    return [Assumption(name=name, declared=False, value="none", sentence=sentence)]


def _centroids(sensor: Sensor, unseen: Sequence[UnseenDeparture]) -> Assumption:
    """That no centroid is displaced for good by less than the tests see; a decentred lens is asked apart."""
    name, word = "centroids", sensor.declared.centroids
    if word is not None:
        return Assumption(name=name, declared=True, value=word, sentence=f"Declared. {_words(name, word)}.")
    moves = {one.sigmas: one for one in unseen if one.name != TANGENTIAL and one.sigmas is not None}
    if not moves:
        how = "This set is too small, or was not tested, so the effect of undetected displacements on the parameters is unknown"
    else:
        most = moves[max(moves)]
        how = (
            f"Of the kind “{get_test_title(most.name).lower()}”, {most.size_px:.2g} px at most would go undetected in one of ten "
            f"such sets and would shift {most.parameter} by {most.sigmas:.2g} claimed sigmas"
        )
        if max(moves) <= MATTERS:
            said = f"Significant displacements that depend on position or brightness would be detected. {how}."
            return Assumption(name=name, declared=True, value="would be detected", sentence=said)
    sentence = (
        "Centroids are assumed to have no systematic displacements with position or brightness, caused for example by readout "
        f"seams, charge left behind or the window. {how}: measure them, for example on flat fields or with a star moved over the "
        f"detector, and {WHERE}."
    )
    return Assumption(name=name, declared=False, value="unbiased", sentence=sentence)


def _refraction_given(sensor: Sensor) -> Assumption:
    """What directions of the telemetry of a sensor on the ground are taken to hold."""
    known = sensor.declared.refraction == "corrected"
    sentence = "Directions in the telemetry are assumed to include refraction already" + (
        ", as declared." if known else f": {WHERE} (`refraction` corrected), or uncorrected to have it added."
    )
    return Assumption(name="refraction", declared=known, value="in the directions given", sentence=sentence)


def _refraction_above(site: Site, named: Telemetry, catalogue: Catalogue, corner_px: float) -> Assumption:
    """What was made of the air above a site, and what an error of pressure or temperature does at the lowest star."""
    pressure, temperature, humidity, wavelength = air(site)
    assumed = [one for one in site.assumed if one != "height_m" or site.pressure_hpa is None]
    lowest = _lowest_deg(site, named, catalogue)
    off = UNKNOWN_AIR if {"pressure_hpa", "temperature_c"} & set(assumed) else KNOWN_AIR
    by_pressure, by_temperature = (
        abs(_stretch(changed, lowest) - _stretch(site, lowest))
        for changed in (
            replace(site, pressure_hpa=pressure + off.pressure_hpa, temperature_c=temperature),
            replace(site, pressure_hpa=pressure, temperature_c=temperature + off.temperature_c),
        )
    )
    sentence = (
        f"Stars are observed through the atmosphere at {site.latitude_deg:.4g}°, {site.longitude_deg:.4g}° east, {pressure:.4g} "
        "hPa, "
        f"{temperature:.3g} °C, humidity {humidity:.2g}, {wavelength:.2g} µm"
        + (f" ({', '.join(assumed)}: usual values, because none were given)" if assumed else "")
        + f". At {lowest:.0f}° above the horizon, the lowest here, it shrinks the field by {_stretch(site, lowest) * 1e6:.0f} ppm; "
        f"{off.pressure_hpa:g} hPa more changes it by {by_pressure * 1e6:.2g} ppm, {by_pressure * corner_px:.2g} px at the corner, "
        f"{off.temperature_c:g} °C by {by_temperature * 1e6:.2g} ppm"
        + (f": {WHERE}, under `site`." if assumed else ".")
        + (f" Below {FORMULA_DEG:g}° the formula has errors of arcseconds." if lowest < FORMULA_DEG else "")
    )
    value = "computed from the site" + (f", {', '.join(assumed)} assumed" if assumed else "")
    return Assumption(name="refraction", declared=not assumed, value=value, sentence=sentence)


def _stretch(site: Site, elevation_deg: float) -> float:
    """By what share air shrinks the field along the vertical, the slope of A tan Z + B tan^3 Z."""
    A, B = refraction_constants(site)
    tangent2 = np.tan(np.radians(90.0 - elevation_deg)) ** 2
    return float((A + 3 * B * tangent2) * (1 + tangent2))


def _lowest_deg(site: Site, named: Telemetry, catalogue: Catalogue) -> float:
    """How high the lowest star of a set stands, degrees; 45 where nothing tells."""
    step = max(1, len(named) // MOST_ROWS)
    rows = np.arange(0, len(named), step)
    part = {one: None if getattr(named, one) is None else getattr(named, one)[rows] for one in COLUMNS_OF_DIRECTIONS}
    if part["time_utc"] is None:
        return 45.0
    s = star_directions(**part, catalogue=catalogue, site=site)
    found = elevation_deg(s, site, part["time_utc"])
    return float(np.nanmin(found)) if np.isfinite(found).any() else 45.0


def _earth_rotation(telemetry: Telemetry) -> Assumption:
    """How far the tables of the Earth's rotation, its pole and leap seconds reach, beside the set's time."""
    tables, time_utc = earth_tables(), telemetry.time_utc
    known = None if time_utc is None else time_utc[~np.isnat(time_utc)]
    last = None if known is None or not len(known) else known.max().astype("datetime64[D]")
    value = f"tables of the IERS measured to {tables.measured_to}, predicted to {tables.predicted_to}"
    leap = f"leap seconds are known until {tables.leap_seconds_to}"
    if last is None or last <= tables.measured_to:
        sentence = f"The Earth's rotation and pole are measured: {value}; {leap}."
    elif last <= tables.predicted_to:
        days = int((last - tables.measured_to) / np.timedelta64(1, "D"))
        sentence = (
            f"The Earth's rotation and pole are predicted {days} days beyond the measurements: {value}; {leap}. That changes "
            "the zenith by about 0.1 arcsec, which is negligible; a newer astropy-iers-data has the measured values."
        )
    else:
        sentence = (
            f"The set ends {last}, after the last table of the Earth's rotation: {value}; {leap}. The last values are used, and "
            "the zenith may be off by arcseconds, which is negligible for refraction: install a newer astropy-iers-data."
        )
    return Assumption(name="earth_rotation", declared=True, value=value, sentence=sentence)
