"""Findings about whole columns: temperature, noise, and columns nobody interprets."""

from __future__ import annotations

import numpy as np

from boresight.telemetry.quality.inputs import Finding, QualityInputs, counted, row_numbers

_WIDE_TEMPERATURE_C = 10.0


def wide_temperature(inputs: QualityInputs) -> Finding | None:
    """Find a set over which the temperature changes so much that one focal length cannot hold."""
    temperature_c = inputs.telemetry.temperature_c
    if temperature_c is None or np.isnan(temperature_c).all():
        return None
    spread = float(np.nanmax(temperature_c) - np.nanmin(temperature_c))
    if spread <= _WIDE_TEMPERATURE_C:
        return None
    sentence = f"Temperature changes by {spread:.1f} degrees within the set, and focal length with it."
    return Finding("TEMPERATURE_RANGE", "CAUTION", sentence, int(np.count_nonzero(~np.isnan(temperature_c))))


def partial_noise(inputs: QualityInputs) -> Finding | None:
    """Find rows without a standard deviation in a file that gives them."""
    sigma_px = inputs.telemetry.sigma_px
    absent = np.zeros(0, dtype=np.bool_) if sigma_px is None else np.isnan(sigma_px)
    if not absent.any():
        return None
    used_px = inputs.sensor.centroid_sigma_px
    sentence = f"{counted(int(absent.sum()), 'row has', 'rows have')} no sigma_px: the sensor's {used_px:g} px is used."
    return Finding("SIGMA_MISSING", "NORMAL", sentence, int(absent.sum()), row_numbers(inputs, absent))


def unknown_columns(inputs: QualityInputs) -> Finding | None:
    """Find columns that the contract does not name."""
    names = list(inputs.telemetry.unknown)
    if not names:
        return None
    what = counted(len(names), "column of another name is", "columns of other names are")
    sentence = f"{what} kept but not used: {', '.join(names[:20])}."
    return Finding("UNKNOWN_COLUMNS", "NORMAL", sentence, len(names))
