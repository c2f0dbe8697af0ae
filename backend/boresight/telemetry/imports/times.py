"""Times of other clocks as UTC.

    TAI = GPS + 19 s            TT = TAI + 32.184 s            UTC = TAI - (leap seconds so far, `erfa.taiutc`)

GPS counts from 1980-01-06, TAI from 1958-01-01 and TT, here, from J2000 = 2000-01-01T12:00, all without leap seconds; UTC numbers
are Unix times, which leave them out. An on-board counter is a clock without leap seconds, set by the UTC at which it was 0.
A time within a leap second becomes the last microsecond before the next day: telemetry has no 61st second.

Julian dates are held in one double, good to 40 microseconds.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence

import erfa
import numpy as np
import pyarrow as pa

from boresight.arrays import DAY_US, FloatArray, TimeArray
from boresight.errors import RefusedInputError
from boresight.telemetry.imports.profile import Time, TimeForm, TimeSystem
from boresight.telemetry.read.checks import EARLIEST, LATEST, Faults, floats, times

_US = {"days": DAY_US, "seconds": 1e6, "milliseconds": 1e3, "microseconds": 1.0, "nanoseconds": 1e-3}
_EPOCHS: dict[TimeSystem, str] = {
    "utc": "1970-01-01T00:00:00",
    "tai": "1958-01-01T00:00:00",
    "gps": "1980-01-06T00:00:00",
    "j2000": "2000-01-01T12:00:00",
    "on_board": "2000-01-01T12:00:00",
}
#: TAI minus the clock, microseconds.
_AHEAD_US: dict[TimeSystem, int] = {"tai": 0, "gps": 19_000_000, "j2000": -32_184_000, "on_board": 0}
_MJD_ZERO = np.datetime64("1858-11-17T00:00:00", "us")
_JD_OF_MJD_ZERO = 2_400_000.5
_MIDNIGHT, _JD_OF_MIDNIGHT = np.datetime64("2000-01-01T00:00:00", "us"), 2_451_544.5
_DAY_US = 86_400_000_000
_WEEK_S = 604_800.0
_ORDINAL = re.compile(r"^\s*([0-9]{4})-?([0-9]{3})(?=[T ])")
_LEAP = re.compile(r":60(\.\d*)?(?=Z|[+-]|\s*$)")
#: The farthest that a number of microseconds may be before and after its epoch: the years 1900 to 2100 are looked for afterwards,
#: and leap seconds are not told before the year -4799.
_FARTHEST_BEFORE_US, _FARTHEST_US = 1e17, 4e17


def read_times(cells: pa.Array, week: pa.Array | None, time: Time, faults: Faults) -> TimeArray:
    """Return a column as (n,) UTC, NaT where empty; what is no time becomes a fault of `time.column`."""
    name = time.column or ""
    if time.form == "iso":
        clock = times(pa.chunked_array([_plain_iso(cells)]), name, faults)
    else:
        values, _ = floats(pa.chunked_array([cells]), name, faults)
        if week is not None:
            weeks, _ = floats(pa.chunked_array([week]), time.week_column or "", faults)
            values = values + weeks * _WEEK_S * 1e6 / _US.get(time.form, 1e6)
        clock = _read_numbers(values, time.form, time.system, time.seconds_per_count)
        faults.add_entries(
            np.isnat(clock) & np.isfinite(values),
            name,
            lambda entry: f"{values[entry]:.9g} is not a time of this form: check its unit",
        )
    found = to_utc(clock, time)
    late = (found < EARLIEST) | (found >= LATEST)
    if time.form != "iso":
        faults.add_entries(
            late,
            name,
            lambda entry: (
                f"gives {found[entry]}, which is not between the years 1900 and 2100: check unit, system and epoch"
            ),
        )
    return found


def read_constant(text: str, time: Time, what: str) -> np.datetime64:
    """Return the one time of a file."""
    faults = Faults(what)
    clock = times(pa.chunked_array([_plain_iso(pa.array([text]))]), "time", faults)
    faults.refuse()
    return to_utc(clock, time)[0]  # type: ignore[no-any-return]


def to_utc(clock: TimeArray, time: Time) -> TimeArray:
    """Return (n,) readings of a clock as UTC."""
    offset = np.timedelta64(round(time.offset_s * 1e6), "us")
    if time.system == "utc":
        return np.asarray(clock + offset)
    tai = clock + np.timedelta64(_AHEAD_US[time.system], "us")
    if time.system == "on_board":
        start = read_constant(time.epoch or "", Time(constant=time.epoch), "time.epoch")
        tai = tai - np.datetime64(_EPOCHS["on_board"], "us") + utc_to_tai(np.array([start]))[0]
    return tai_to_utc(np.asarray(tai)) + offset


def _read_numbers(values: FloatArray, form: TimeForm, system: TimeSystem, seconds_per_count: float) -> TimeArray:
    """Return numbers as readings of their clock, NaT where none."""
    if form in {"jd", "mjd"}:
        epoch, us = _MJD_ZERO, (values - (_JD_OF_MJD_ZERO if form == "jd" else 0.0)) * DAY_US
    else:
        epoch = np.datetime64(_EPOCHS[system], "us")
        us = values * (_US[form] * (seconds_per_count if system == "on_board" else 1.0))
    good = (us > -_FARTHEST_BEFORE_US) & (us < _FARTHEST_US)  # false of NaN
    return np.where(
        good, epoch + np.where(good, np.round(us), 0.0).astype("timedelta64[us]"), np.datetime64("NaT", "us")
    )


def tai_to_utc(tai: TimeArray) -> TimeArray:
    """Return (n,) TAI as UTC, NaT where NaT."""
    known = np.unique(tai[~np.isnat(tai)])
    if not len(known):
        return tai.astype("datetime64[us]")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)  # years after the table's last leap second
        year, month, day, clock = erfa.d2dtf("UTC", 6, *erfa.taiutc(*_two_part(known)))
    is_leap = clock["s"] == 60
    second = np.where(is_leap, 59, clock["s"])
    micro = np.where(is_leap, 999_999, clock["f"])
    months = (12 * (year - 1970).astype(np.int64) + month - 1).astype("timedelta64[M]") + np.datetime64(0, "M")
    days = months.astype("datetime64[D]") + (day - 1).astype("timedelta64[D]")
    us = ((clock["h"].astype(np.int64) * 60 + clock["m"]) * 60 + second) * 1_000_000 + micro
    utc = days.astype("datetime64[us]") + us.astype("timedelta64[us]")
    found = np.full(tai.shape, np.datetime64("NaT", "us"))
    found[~np.isnat(tai)] = utc[np.searchsorted(known, tai[~np.isnat(tai)])]
    return found


def utc_to_tai(utc: TimeArray) -> TimeArray:
    """Return (n,) UTC, none NaT, as TAI."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        months = utc.astype("datetime64[M]")
        month = months.astype(np.int64) % 12 + 1
        day = (utc.astype("datetime64[D]") - months.astype("datetime64[D]")).astype(np.int64) + 1
        share = (utc - utc.astype("datetime64[D]")).astype("timedelta64[us]").astype(np.int64) / _DAY_US
        ahead = np.asarray(erfa.dat(utc.astype("datetime64[Y]").astype(np.int64) + 1970, month, day, share))
    return np.asarray(utc + np.round(ahead * 1e6).astype("timedelta64[us]"))


def _two_part(moments: TimeArray) -> tuple[FloatArray, FloatArray]:
    """Return (n,) times as Julian dates in two parts, midnight and the fraction of the day."""
    us = (moments - _MIDNIGHT).astype(np.int64)
    return (_JD_OF_MIDNIGHT + us // _DAY_US).astype(np.float64), (us % _DAY_US) / _DAY_US


def _plain_iso(cells: pa.Array) -> pa.Array:
    """Return ISO texts with days of the year as months and days, and no 61st second; each text is looked at once."""
    if not pa.types.is_string(cells.type) and not pa.types.is_large_string(cells.type):
        return cells
    coded = cells.dictionary_encode()
    plain = pa.array([_calendar(text) for text in coded.dictionary.to_pylist()], pa.string())
    return pa.DictionaryArray.from_arrays(coded.indices, plain).cast(pa.string())


def _calendar(text: str) -> str:
    text = _LEAP.sub(":59.999999", text)
    if (found := _ORDINAL.match(text)) and 1 <= int(found.group(2)) <= 366 and int(found.group(1)) > 0:
        day = np.datetime64(f"{found.group(1)}-01-01") + np.timedelta64(int(found.group(2)) - 1, "D")
        return f"{day}{text[found.end() :]}"
    return text


def tell_leap_seconds(time: Time) -> list[str]:
    """Return a sentence on the leap seconds that a conversion took into account."""
    if time.system == "utc":
        return []
    last = erfa.leap_seconds.get()[-1]
    return [f"Times become UTC with the leap seconds up to that of {last['year']}-{last['month']:02d}-01."]


def parse_times(texts: Sequence[str], system: str, what: str) -> TimeArray:
    """Return CCSDS times (n,) in one of the systems that are read here as UTC, NaT where a text is none."""
    names: dict[str, TimeSystem] = {"UTC": "utc", "TAI": "tai", "GPS": "gps", "TT": "j2000"}
    if system not in names:
        raise RefusedInputError(f"{what}: TIME_SYSTEM {system} is not read: write it in UTC, TAI, GPS or TT.")
    clock = times(pa.chunked_array([_plain_iso(pa.array(texts, pa.string()))]), "time", Faults(what))
    known = (clock >= EARLIEST) & (clock < LATEST)
    return to_utc(np.where(known, clock, np.datetime64("NaT")), Time(column="time", system=names[system]))
