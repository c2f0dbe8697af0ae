"""Findings about order and time, and about whole columns: temperature, noise, and columns nobody interprets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight.telemetry.quality.inputs import Finding, QualityInputs, Severity, counted, marked_rows, row_numbers
from boresight.telemetry.sampling import GAP_FACTOR, Intervals, compute_sampling
from boresight.telemetry.schema import IMAGE_COLUMNS

_WIDE_TEMPERATURE_C = 10.0


def wide_temperature(inputs: QualityInputs) -> Finding | None:
    """Find a set over which the temperature changes so much that one focal length cannot hold."""
    temperature_c = inputs.telemetry.temperature_c
    if temperature_c is None or np.isnan(temperature_c).all():
        return None
    spread = float(np.nanmax(temperature_c) - np.nanmin(temperature_c))
    if spread <= _WIDE_TEMPERATURE_C:
        return None
    sentence = f"The temperature changes by {spread:.1f} °C within the set, which changes the focal length."
    return Finding("TEMPERATURE_RANGE", "CAUTION", sentence, int(np.count_nonzero(~np.isnan(temperature_c))))


def partial_noise(inputs: QualityInputs) -> Finding | None:
    """Find rows without a standard deviation in a file that gives them."""
    sigma_px = inputs.telemetry.sigma_px
    absent = np.zeros(0, dtype=np.bool_) if sigma_px is None else np.isnan(sigma_px)
    said = f"no sigma_px: the sensor's {inputs.sensor.centroid_sigma_px:g} px is used."
    return marked_rows(inputs, "SIGMA_MISSING", "NORMAL", absent, ("row has", "rows have"), said)


def unknown_columns(inputs: QualityInputs) -> Finding | None:
    """Find columns that neither the contract nor the extraction from images names."""
    names = [name for name in inputs.telemetry.unknown if name not in IMAGE_COLUMNS]
    if not names:
        return None
    what = counted(len(names), "column of another name is", "columns of other names are")
    sentence = f"{what} kept but not used: {', '.join(names[:20])}."
    return Finding("UNKNOWN_COLUMNS", "NORMAL", sentence, len(names))


_CLOCK_SET = np.datetime64("1990-01-01", "us")
_MOST_OF_SPAN = 0.5


def frames_descend(inputs: QualityInputs) -> Finding | None:
    """Find frames that do not ascend."""
    frame = inputs.telemetry.frame
    descends = np.diff(frame, prepend=frame[:1]) < 0
    said = "back to an earlier frame: sort the rows by frame."
    return marked_rows(inputs, "FRAME_ORDER", "SERIOUS", descends, ("row goes", "rows go"), said)


def times_descend(inputs: QualityInputs) -> Finding | None:
    """Find times that run backwards."""
    time_utc = inputs.telemetry.time_utc
    if time_utc is None:
        return None
    timed = np.flatnonzero(~inputs.untimed)
    back = np.zeros(len(time_utc), dtype=np.bool_)
    back[timed[1:]] = np.diff(time_utc[timed]) < np.timedelta64(0, "us")
    if not back.any():
        return None
    sentence = (
        f"Time decreases at {counted(int(back.sum()), 'row', 'rows')}: check time_utc, or the order of the frames."
    )
    return Finding("TIME_ORDER", "CAUTION", sentence, int(back.sum()), row_numbers(inputs, back))


def times_vary_in_exposure(inputs: QualityInputs) -> Finding | None:
    """Find rows whose time is not that of their exposure's first row."""
    time_utc = inputs.telemetry.time_utc
    if time_utc is None:
        return None
    first = time_utc[inputs.exposures.start][inputs.exposures.of_entry]
    varies: NDArray[np.bool_] = (time_utc != first) & ~inputs.untimed & ~np.isnat(first)
    nouns = ("row of an exposure has", "rows of an exposure have")
    said = "another time than its first row: an exposure is one image, check exposure numbers and times."
    return marked_rows(inputs, "TIME_VARIES", "CAUTION", varies, nouns, said)


def times_missing(inputs: QualityInputs) -> Finding | None:
    """Find rows that need a time for their catalogue direction and have none."""
    needed = inputs.from_catalogue
    missing = needed & inputs.untimed
    severity: Severity = "SERIOUS" if missing.sum() == needed.sum() else "CAUTION"
    said = "not used because time_utc is missing, which a direction from the catalogue needs: give the time, or ra_deg and dec_deg."
    return marked_rows(inputs, "TIME_MISSING", severity, missing, ("matched star is", "matched stars are"), said)


def clock_unset(inputs: QualityInputs) -> Finding | None:
    """Find times before 1990, as a clock shows that was never set."""
    time_utc = inputs.telemetry.time_utc
    early = np.zeros(0, dtype=np.bool_) if time_utc is None else time_utc < _CLOCK_SET
    if not early.any():
        return None
    severity: Severity = "SERIOUS" if (early & inputs.from_catalogue).any() else "CAUTION"
    said = "dated before 1990; the clock was probably not set. Star directions for that time would be wrong: correct time_utc."
    return marked_rows(inputs, "CLOCK_UNSET", severity, early, ("row is", "rows are"), said)


def sampling_gaps(inputs: QualityInputs) -> Finding | None:
    """Find gaps in time between frames; one that is most of the span makes a set of two epochs."""
    sampling = compute_sampling(inputs)
    if sampling is None or not len(sampling.gaps):
        return None
    after = np.zeros(len(inputs.telemetry), dtype=np.bool_)
    after[sampling.entry[sampling.gaps + 1]] = True
    return gaps_finding((sampling.interval_s, sampling.median_s, sampling.gaps), row_numbers(inputs, after))


def gaps_finding(intervals: Intervals, rows: tuple[int, ...]) -> Finding | None:
    """The finding of gaps among intervals; `rows` are those after the first of them."""
    interval_s, median_s, gaps = intervals
    if not len(gaps):
        return None
    count, longest_s = len(gaps), float(interval_s[gaps].max())
    severity: Severity = "CAUTION" if longest_s > _MOST_OF_SPAN * interval_s.sum() else "NORMAL"
    what = counted(count, "interval between frames exceeds", "intervals between frames exceed")
    sentence = (
        f"{what} {GAP_FACTOR:g} times the median of {median_s:,g} s; the longest is {longest_s:,g} s. If no "
        "eclipse or slew explains this, check that the downlink is complete."
    )
    return Finding("GAPS", severity, sentence, count, rows)
