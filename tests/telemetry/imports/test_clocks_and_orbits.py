"""Times of other clocks, velocities of SGP4 and OEM, attitudes of AEM: each against another program or the standard."""

import gzip
import warnings
from datetime import UTC
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import sgp4
from astropy import units as u
from astropy.coordinates import GCRS, TEME, CartesianRepresentation
from astropy.time import Time as AstropyTime
from astropy.utils import iers

from boresight.errors import RefusedInputError
from boresight.estimation.attitude import to_matrix
from boresight.telemetry.imports.ephemerides import read_aem, read_orbit, teme_to_gcrs
from boresight.telemetry.imports.profile import Time
from boresight.telemetry.imports.times import read_times, tai_to_utc, utc_to_tai
from boresight.telemetry.read.checks import Faults
from tests.telemetry.imports.conftest import VECTORS

MOMENTS = ["1975-03-04T05:06:07.5", "2016-12-31T23:59:59", "2017-01-01T00:00:00", "2026-11-20T01:02:03.25"]

ISS = (
    "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927\n"
    "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537\n"
)


def read(cells, **time):
    faults = Faults("clock")
    found = read_times(pa.array(cells), None, Time(column="T", **time), faults)
    faults.refuse()
    return found


def unix(t):
    """Seconds as computers count them: astropy stretches the day of a leap second."""
    return t.to_datetime(timezone=UTC).timestamp()


@pytest.mark.parametrize(
    ("system", "form", "of"),
    [
        ("tai", "iso", lambda t: t.tai.isot),
        ("j2000", "iso", lambda t: t.tt.isot),
        ("j2000", "seconds", lambda t: ((t.tt.jd1 - 2451545.0) + t.tt.jd2) * 86400),
        ("gps", "seconds", lambda t: t.gps),
        ("utc", "seconds", unix),
        ("utc", "milliseconds", lambda t: unix(t) * 1e3),
        ("utc", "mjd", lambda t: unix(t) / 86400 + 40587),
        ("tai", "jd", lambda t: t.tai.jd),
    ],
)
@pytest.mark.parametrize("moment", MOMENTS)
def test_a_clock_is_read_as_astropy_reads_it(system, form, of, moment):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cell = of(AstropyTime(moment, scale="utc", precision=9))
    found = read([str(cell) if form == "iso" else float(cell)], system=system, form=form)[0]
    within_us = 50 if form == "jd" else 20 if form == "mjd" else 1
    assert abs((found - np.datetime64(moment, "us")).astype(int)) <= within_us


def test_weeks_of_gps_and_counters_on_board():
    faults = Faults("clock")
    time = Time(column="T", week_column="W", system="gps", form="seconds")
    assert str(read_times(pa.array([1.5]), pa.array([1]), time, faults)[0]) == "1980-01-13T00:00:01.500000"
    found = read(
        [0, 200], system="on_board", form="seconds", epoch="2016-12-31T23:59:00Z", seconds_per_count=0.5, offset_s=0.25
    )
    assert [str(moment) for moment in found] == [
        "2016-12-31T23:59:00.250000",
        "2017-01-01T00:00:39.250000",
    ]  # a leap second between


def test_days_of_the_year_leap_seconds_and_nanoseconds_are_read():
    found = read(["2026-324T01:02:03.5Z", "2016-12-31T23:59:60.5Z", "2026-11-20T01:02:03.123456789Z"])
    assert [str(moment) for moment in found] == [
        "2026-11-20T01:02:03.500000", "2016-12-31T23:59:59.999999", "2026-11-20T01:02:03.123456"]  # fmt: skip


def test_utc_and_tai_are_one_anothers_inverse_over_fifty_years():
    rng = np.random.default_rng(5)
    utc = np.datetime64("1972-07-02", "us") + rng.integers(0, 54 * 365 * 86400, 400).astype("timedelta64[s]").astype(
        "timedelta64[us]"
    )
    assert np.all(tai_to_utc(utc_to_tai(utc)) == utc)


@pytest.mark.parametrize("cell", [1e30, -1e12, -3e11, 5e10])
def test_a_number_that_is_no_time_is_refused(cell):
    with pytest.raises(RefusedInputError):
        read([cell], system="gps", form="seconds")


def test_digits_of_another_script_are_no_date():
    with pytest.raises(RefusedInputError):
        read(["٢٠٢٤-001T00:00:00"], form="iso")


def test_teme_is_turned_as_astropy_turns_it():
    moments = np.array(["2010-05-01T10:59:00", "2020-03-04T03:10:00"], "datetime64[us]")
    vectors = np.array([[1.0, 7.0, 2.0], [0.0, 0.5, 7.5]])
    with (
        warnings.catch_warnings(),
        iers.conf.set_temp("auto_download", False),
        iers.conf.set_temp("auto_max_age", None),
    ):
        warnings.simplefilter("ignore")
        time = AstropyTime(moments.astype(str), scale="utc")
        place = TEME(CartesianRepresentation(vectors.T * 1000 * u.km), obstime=time)
        expected = place.transform_to(GCRS(obstime=time)).cartesian.xyz.to_value(u.km).T / 1000
    np.testing.assert_allclose(
        teme_to_gcrs(vectors, moments), expected, atol=1e-5
    )  # km/s: the Earth's own aberration, in a place


def test_elements_give_the_velocities_of_sgp4s_own_verification(tmp_path):
    folder = Path(sgp4.__file__).parent
    lines = (folder / "SGP4-VER.TLE").read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("1 06251U"))
    (tmp_path / "sat.tle").write_text(f"{lines[first][:69]}\n{lines[first + 1][:69]}\n")
    told = (folder / "tcppver.out").read_text().split("6251 xx\n")[1].splitlines()[:4]
    numbers = np.array([[float(cell) for cell in line.split()[:7]] for line in told])
    orbit = read_orbit(tmp_path / "sat.tle", "sat.tle")
    epoch = np.datetime64("2006-06-25", "us") + np.timedelta64(round(0.82412014 * 86400e6), "us")  # 06176.82412014
    moments = epoch + np.round(numbers[:, 0] * 60e6).astype("timedelta64[us]")
    found, covered = orbit.velocity(moments)
    assert np.all(covered)
    np.testing.assert_allclose(found, teme_to_gcrs(numbers[:, 4:7], moments) * 1e3, atol=0.01)
    assert not orbit.velocity(epoch + np.array([40], "timedelta64[D]"))[1][0]


@pytest.mark.parametrize(
    "damage", [lambda text: text.replace("2", "3", 1), lambda text: text[:60], lambda _: "hello\n"]
)
def test_elements_that_were_copied_wrongly_are_refused(tmp_path, damage):
    good = ISS
    (tmp_path / "sat.tle").write_text(good)
    read_orbit(tmp_path / "sat.tle", "sat.tle")
    (tmp_path / "sat.tle").write_text(damage(good))
    with pytest.raises(RefusedInputError):
        read_orbit(tmp_path / "sat.tle", "sat.tle")


def test_an_oem_is_interpolated_to_states_that_were_left_out(tmp_path):
    lines = (VECTORS / "leo-60s.oem").read_text().splitlines(keepends=True)
    data = [k for k, line in enumerate(lines) if line.startswith("2020-")]
    left_out = data[1:-1:2]
    (tmp_path / "half.oem").write_text("".join(line for k, line in enumerate(lines) if k not in left_out))
    orbit = read_orbit(tmp_path / "half.oem", "half.oem")
    moments = np.array([lines[k].split()[0] for k in left_out], "datetime64[us]")
    truth = np.array([[float(cell) for cell in lines[k].split()[4:7]] for k in left_out]) * 1e3
    found, covered = orbit.velocity(moments)
    assert np.all(covered)
    missed = np.linalg.norm(found - truth, axis=1).max()
    assert missed < 0.1  # m/s, of states two minutes apart: 0.1 milliarcseconds of aberration
    claimed = float(orbit.notes[0].rsplit("about ", 1)[1].split()[0])
    assert missed / 4 < claimed < missed * 20
    assert not orbit.velocity(np.array(["2020-06-01T13:00:01"], "datetime64[us]"))[1][0]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("= ICRF", "= ITRF2014"),
        ("= Earth", "= MARS"),
        ("= UTC", "= UT1"),
        ("6.077667602389965e-01", "x"),
        ("12:02:00.000000  -4.590", "11:02:00.000000  -4.590"),
    ],
)
def test_an_oem_that_does_not_say_the_velocity_about_the_earth_is_refused(tmp_path, old, new):
    text = (VECTORS / "leo-60s.oem").read_text()
    assert old in text
    (tmp_path / "bad.oem").write_text(text.replace(old, new, 1))
    with pytest.raises(RefusedInputError):
        read_orbit(tmp_path / "bad.oem", "bad.oem")


def test_an_aem_turns_axes_by_the_matrix_of_the_standard(tmp_path):
    found = read_aem(VECTORS / "example-2.aem", "example-2.aem", 10.0)
    assert len(found.time_utc) == 2  # the others lie outside the useable span
    q1, q2, q3, qc = np.array([0.42319, -0.45697, 0.23784, 0.74533])
    standard = np.array(
        [
            [q1 * q1 - q2 * q2 - q3 * q3 + qc * qc, 2 * (q1 * q2 + q3 * qc), 2 * (q1 * q3 - q2 * qc)],
            [2 * (q1 * q2 - q3 * qc), -q1 * q1 + q2 * q2 - q3 * q3 + qc * qc, 2 * (q2 * q3 + q1 * qc)],
            [2 * (q1 * q3 + q2 * qc), 2 * (q2 * q3 - q1 * qc), -q1 * q1 - q2 * q2 + q3 * q3 + qc * qc],
        ]
    )  # CCSDS 504.0-B, from frame A to frame B
    np.testing.assert_allclose(to_matrix(found.quaternion[0]), standard, atol=2e-5)
    text = (VECTORS / "example-2.aem").read_text().replace("A2B", "B2A")
    (tmp_path / "back.aem").write_text(text)
    back = read_aem(tmp_path / "back.aem", "back.aem", 10.0)
    np.testing.assert_allclose(to_matrix(back.quaternion[0]), standard.T, atol=2e-5)


@pytest.mark.parametrize(
    ("old", "new"),
    [("= QUATERNION\n", "= SPIN\n"), ("= EME2000", "= SC_BODY_2"), ("0.42319", "4.2319"), ("META_STOP", "META_STOPS")],
)
def test_an_aem_that_says_no_attitude_of_a_body_is_refused(tmp_path, old, new):
    text = (VECTORS / "example-2.aem").read_text()
    assert old in text
    (tmp_path / "bad.aem").write_text(text.replace(old, new, 1))
    with pytest.raises(RefusedInputError):
        read_aem(tmp_path / "bad.aem", "bad.aem", 10.0)


STARS = "T,X,Y\n2020-06-01T12:00:30Z,10,20\n2020-06-01T12:10:00Z,11,21\n"
TIMED = {"frames": {"by": "time"}, "row": {"column": "Y"}, "col": {"column": "X"}, "time": {"column": "T"}}


def test_velocities_of_an_orbit_and_attitudes_of_an_aem_come_into_the_telemetry(load, tmp_path):
    made = load(STARS, TIMED, orbit=VECTORS / "leo-60s.oem")
    speed = np.linalg.norm(made.telemetry.velocity_m_s, axis=1)
    assert np.all((speed > 7000) & (speed < 8000))
    assert made.record()["orbit"]["name"] == "leo-60s.oem"
    with pytest.raises(RefusedInputError) as refused:
        load(STARS.replace("12:10", "14:10"), TIMED, orbit=VECTORS / "leo-60s.oem")
    assert (refused.value.faults[0].row, refused.value.faults[0].column) == (3, "T")
    text = STARS.replace("2020-06-01T12:00:30Z", "1996-11-28T22:08:04.0555Z").replace(
        "2020-06-01T12:10:00Z", "1996-11-28T22:08:03.5555Z"
    )
    turned = load(text, TIMED, attitude=VECTORS / "example-2.aem").telemetry
    assert np.all(np.isfinite(turned.quaternion))
    for name in ("example-2.aem", "leo-60s.oem"):
        (tmp_path / f"{name}.gz").write_bytes(gzip.compress((VECTORS / name).read_bytes()))
    packed = load(text, TIMED, attitude=tmp_path / "example-2.aem.gz").telemetry
    np.testing.assert_array_equal(packed.quaternion, turned.quaternion)
    packed = load(STARS, TIMED, orbit=tmp_path / "leo-60s.oem.gz").telemetry
    np.testing.assert_array_equal(packed.velocity_m_s, made.telemetry.velocity_m_s)


@pytest.mark.parametrize("moment", ["", "3e11", "-3e11"])
def test_a_star_without_a_time_that_elements_reach_is_refused_by_its_row(load, tmp_path, moment):
    (tmp_path / "pass.tle").write_text(ISS)
    numbers = {"frames": {"by": "record"}, "time": {"column": "T", "form": "seconds"}}
    with pytest.raises(RefusedInputError) as refused:
        load(f"T,X,Y\n1221998400,1,2\n{moment},3,4\n", TIMED | numbers, orbit=tmp_path / "pass.tle")
    assert {(fault.row, fault.column) for fault in refused.value.faults} == {(3, "T")}


def test_an_oem_faster_than_light_is_refused_by_its_row(tmp_path):
    head = "CCSDS_OEM_VERS = 2.0\nMETA_START\nCENTER_NAME = EARTH\nREF_FRAME = ICRF\nTIME_SYSTEM = UTC\nMETA_STOP\n"
    (tmp_path / "fast.oem").write_text(f"{head}2020-01-01T00:00:00 1 2 3 1e307 5 6\n2020-01-01T00:01:00 1 2 3 4 5 6\n")
    with pytest.raises(RefusedInputError) as refused:
        read_orbit(tmp_path / "fast.oem", "fast.oem")
    assert refused.value.faults[0].row == 7
