"""Findings about stars: matches, numbers, magnitudes, directions."""

from __future__ import annotations

import numpy as np

from boresight.estimation import MINIMUM_STARS
from boresight.telemetry.quality.inputs import Finding, QualityInputs, Severity, counted, marked_rows, row_numbers
from boresight.telemetry.schema import MAGNITUDES

_MANY_UNMATCHED = 0.5
_MANY_EXPOSURES = 0.2
_MAGNITUDE_MISMATCH = 2.0
_ENOUGH_MAGNITUDES = 20
#: Spread across over spread along, below which a calibration calls stars collinear too.
_LINE = 0.005


def nothing_matched(inputs: QualityInputs) -> Finding | None:
    """Find a set in which no row names a star."""
    if inputs.matched.any():
        return None
    sentence = (
        "No row gives a star number, so calibrations must recognise the stars themselves. Diagnose the set to see whether that "
        "works, or add star_id (Hipparcos numbers), or ra_deg and dec_deg."
    )
    return Finding("NO_MATCHES", "SERIOUS", sentence, len(inputs.telemetry))


def few_stars(inputs: QualityInputs) -> Finding | None:
    """Find exposures with fewer usable stars than an exposure needs."""
    few = inputs.usable_per_exposure < MINIMUM_STARS
    count, exposures = int(few.sum()), len(few)
    if not count:
        return None
    severity: Severity = "CAUTION" if count > _MANY_EXPOSURES * exposures else "NORMAL"
    has, is_ = ("has", "is") if count == 1 else ("have", "are")
    sentence = f"{count:,} of {exposures:,} exposures {has} fewer than {MINIMUM_STARS} usable stars and {is_} not used."
    if count == exposures:
        severity = "SERIOUS"
        sentence = (
            f"Every exposure has fewer than {MINIMUM_STARS} usable stars with a number, so a calibration must recognise the "
            "stars itself: diagnose the set to see whether that works."
        )
    marked = np.zeros(len(inputs.telemetry), dtype=np.bool_)
    marked[inputs.exposures.start[few]] = True
    return Finding("FEW_STARS", severity, sentence, count, row_numbers(inputs, marked))


def on_one_line(inputs: QualityInputs) -> Finding | None:
    """Find exposures whose usable stars all lie on one line, where arcs say nothing across it."""
    full = inputs.usable_per_exposure >= MINIMUM_STARS
    width, length = inputs.spread_per_exposure
    line = full & (width <= _LINE * length)
    count, exposures = int(line.sum()), int(full.sum())
    if not count:
        return None
    what = counted(count, "exposure has all its usable stars", "exposures have all their usable stars")
    sentence = f"{what} on one line and {'is' if count == 1 else 'are'} not used: send other fields."
    marked = np.zeros(len(inputs.telemetry), dtype=np.bool_)
    marked[inputs.exposures.start[line]] = True
    severity: Severity = "SERIOUS" if count == exposures else "CAUTION"
    return Finding("ON_ONE_LINE", severity, sentence, count, row_numbers(inputs, marked))


def many_unmatched(inputs: QualityInputs) -> Finding | None:
    """Find a set of which most rows are unmatched."""
    unmatched = ~inputs.matched
    count, rows = int(unmatched.sum()), len(unmatched)
    if count <= _MANY_UNMATCHED * rows or count == rows:
        return None
    sentence = f"{count:,} of {rows:,} detections ({count / rows:.0%}) are unmatched and not used: check the matching."
    return Finding("UNMATCHED", "CAUTION", sentence, count, row_numbers(inputs, unmatched))


def unknown_numbers(inputs: QualityInputs) -> Finding | None:
    """Find stars that neither the catalogue knows nor the file gives a direction for."""
    unknown = inputs.unknown & ~inputs.directed
    said = "not used, because the catalogue does not have the star: correct star_id, or give ra_deg and dec_deg."
    return marked_rows(inputs, "UNKNOWN_STARS", "CAUTION", unknown, ("row is", "rows are"), said)


def unknown_but_directed(inputs: QualityInputs) -> Finding | None:
    """Find stars that the catalogue does not have but whose direction the file gives."""
    unknown = inputs.unknown & inputs.directed
    nouns, said = (
        ("row names a star", "rows name stars"),
        "unknown to the catalogue: the direction in the file is used.",
    )
    return marked_rows(inputs, "UNKNOWN_STARS_WITH_DIRECTION", "NORMAL", unknown, nouns, said)


def absurd_magnitudes(inputs: QualityInputs) -> Finding | None:
    """Find magnitudes that no detected star has, as written for want of a measurement."""
    magnitude = inputs.telemetry.magnitude
    if magnitude is None:
        return None
    absurd = (magnitude < MAGNITUDES[0]) | (magnitude > MAGNITUDES[1])
    said = "outside {:g} to {:g}: leave the cell empty where there is no measurement.".format(*MAGNITUDES)
    return marked_rows(inputs, "MAGNITUDE_RANGE", "CAUTION", absurd, ("magnitude lies", "magnitudes lie"), said)


def mismatched_magnitudes(inputs: QualityInputs) -> Finding | None:
    """Find matches to a star much brighter or fainter than what was seen, the usual sign of a false match."""
    magnitude, index = inputs.telemetry.magnitude, inputs.index
    if magnitude is None or index is None or inputs.catalogue is None:
        return None
    known = (index >= 0) & (magnitude >= MAGNITUDES[0]) & (magnitude <= MAGNITUDES[1])
    if known.sum() < _ENOUGH_MAGNITUDES:
        return None
    difference = np.full(len(magnitude), np.nan)
    difference[known] = magnitude[known] - inputs.catalogue.magnitude[index[known]]
    suspect = np.abs(difference - np.nanmedian(difference)) > _MAGNITUDE_MISMATCH
    nouns = ("matched star differs", "matched stars differ")
    by = f"in brightness by more than {_MAGNITUDE_MISMATCH:g} magnitudes from the catalogue"
    return marked_rows(
        inputs, "MAGNITUDE_MISMATCH", "CAUTION", suspect, nouns, f"{by}, as false matches do: check the matching."
    )


def velocity_missing(inputs: QualityInputs) -> Finding | None:
    """Find directions from the catalogue that lack the satellite's aberration."""
    needed = inputs.from_catalogue
    if not needed.any() or inputs.sensor.declared.satellite_velocity == "negligible":
        return None
    if inputs.telemetry.velocity_m_s is None:
        sentence = (
            "The file gives no satellite velocity: up to 5 arcsec of aberration in a low orbit stay in the star directions, "
            "and stretch a 20 degree field by up to 2 arcsec; give vx_km_s, vy_km_s and vz_km_s."
        )
        return Finding("VELOCITY_MISSING", "CAUTION", sentence, int(needed.sum()))
    said = "not used because the satellite velocity is missing: give it in every row."
    nouns = ("matched star is", "matched stars are")
    return marked_rows(inputs, "VELOCITY_MISSING", "CAUTION", needed & inputs.unmoving, nouns, said)
