"""Apparent directions: a plain derivation, known facts of the sky, the theory of aberration; and which direction each row takes.

What these tests do not prove: light deflection by the Sun and perspective acceleration, which are left out by design.
"""

import time

import erfa
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.sky.apparent import aberrated, apparent_directions, days_since_j2000, earth_state
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import star_directions
from tests.effort import effort
from tests.refusals import has_code
from tests.strategies import unit_vectors

ARCSEC = np.pi / 180 / 3600
C_M_S = 299792458.0
C_AU_DAY = 173.1446326846693


def moment(text):
    return np.datetime64(text, "us")


def angle(one, other):
    return np.arctan2(np.linalg.norm(np.cross(one, other), axis=-1), np.sum(one * other, axis=-1))


def star_at(ra_rad, dec_rad, parallax_arcsec=0.0, pm_ra_arcsec=0.0, pm_dec_arcsec=0.0):
    one = np.ones(1)
    return Catalogue(
        hip=np.array([1]),
        ra_rad=ra_rad * one,
        dec_rad=dec_rad * one,
        parallax_rad=parallax_arcsec * ARCSEC * one,
        pm_ra_cosdec_rad_yr=pm_ra_arcsec * ARCSEC * one,
        pm_dec_rad_yr=pm_dec_arcsec * ARCSEC * one,
        magnitude=one,
        solution_type=np.array([5]),
        colour_bv=one,
    )


def plain_directions(catalogue, index, time_utc, velocity_m_s):
    days, place = np.unique(days_since_j2000(time_utc), return_inverse=True)
    years = (days[place] - (2448349.0625 - 2451545.0)) / 365.25
    _, barycentric = (parts[place] for parts in erfa.epv00(2451545.0, days))
    ra, dec = catalogue.ra_rad[index], catalogue.dec_rad[index]
    p = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)
    east = np.stack([-np.sin(ra), np.cos(ra), np.zeros_like(ra)], axis=-1)
    north = np.cross(p, east)
    motion = catalogue.pm_ra_cosdec_rad_yr[index, None] * east + catalogue.pm_dec_rad_yr[index, None] * north
    seen = p + years[:, None] * motion - catalogue.parallax_rad[index, None] * barycentric["p"]
    seen /= np.linalg.norm(seen, axis=-1, keepdims=True)
    v = barycentric["v"] / C_AU_DAY + velocity_m_s / C_M_S
    v2 = np.sum(v * v, axis=-1, keepdims=True)
    gamma = 1.0 / np.sqrt(1.0 - v2)
    along = np.sum(seen * v, axis=-1, keepdims=True)
    boosted = seen + (gamma - 1.0) * along * v / v2 + gamma * v
    return boosted / np.linalg.norm(boosted, axis=-1, keepdims=True)


def test_directions_equal_the_plain_derivation_all_over_the_catalogue(catalogue):
    rng = np.random.default_rng(1)
    index = np.arange(0, len(catalogue), effort(10, 1))
    times = moment("2015-01-01") + rng.integers(0, int(15 * 365.25 * 86400e6), effort(1_000, len(index)))
    time_utc = rng.choice(times, len(index))
    velocity = rng.normal(size=(len(index), 3)) * 4e3
    seen = apparent_directions(catalogue, index, time_utc, velocity)
    assert angle(seen, plain_directions(catalogue, index, time_utc, velocity)).max() < 2e-4 * ARCSEC
    np.testing.assert_allclose(np.linalg.norm(seen, axis=1), 1.0, rtol=1e-14)


@settings(max_examples=30, deadline=None)
@given(days=st.lists(st.floats(-36000.0, 36000.0), min_size=1, max_size=20))
def test_the_earth_between_nodes_is_where_the_series_has_it(days):
    days = np.array(days)
    position_au, velocity_au_day = earth_state(days)
    _, barycentric = erfa.epv00(2451545.0, days)
    assert np.abs(position_au - barycentric["p"]).max() < 1e-9
    assert np.abs(velocity_au_day - barycentric["v"]).max() * C_M_S / C_AU_DAY < 1e-4  # m/s


def test_annual_aberration_carries_a_star_of_the_ecliptic_pole_around_20_5_arcsec():
    obliquity = np.radians(23.4392911)
    pole = star_at(np.radians(270.0), np.pi / 2 - obliquity)
    time_utc = moment("2024-01-01") + np.arange(366) * np.timedelta64(86400_000000, "us")
    still = np.array([0.0, -np.sin(obliquity), np.cos(obliquity)])
    shift = angle(apparent_directions(pole, np.zeros(366, dtype=np.int64), time_utc, None), still) / ARCSEC
    assert shift.mean() == pytest.approx(20.496, abs=0.02)
    assert 0.2 < shift.max() - shift.min() < 0.8  # eccentricity of the orbit, and the Sun's own motion


def test_a_low_orbit_adds_5_arcsec_towards_the_observers_motion():
    star = star_at(0.0, 0.0)
    time_utc, index = np.array([moment("2024-06-01")]), np.array([0])
    without = apparent_directions(star, index, time_utc, None)
    within = apparent_directions(star, index, time_utc, np.array([[0.0, 0.0, 7500.0]]))
    assert angle(without, within)[0] / ARCSEC == pytest.approx(5.16, abs=0.01)
    assert aberrated(np.array([[1.0, 0.0, 0.0]]), np.array([0.0, 1e-4, 0.0]))[0, 1] == pytest.approx(1e-4, rel=1e-3)


def test_parallax_swings_alpha_centauri_by_twice_its_0_75_arcsec(deep_catalogue):
    hip = np.array([71683])
    k = int(deep_catalogue.find_index(hip)[0])
    time_utc = moment("2020-01-01") + np.arange(366) * np.timedelta64(86400_000000, "us")
    ra, dec = deep_catalogue.ra_rad[k], deep_catalogue.dec_rad[k]
    near = star_at(ra, dec, parallax_arcsec=deep_catalogue.parallax_rad[k] / ARCSEC)
    index = np.zeros(len(time_utc), dtype=np.int64)
    swing = apparent_directions(near, index, time_utc, None) - apparent_directions(
        star_at(ra, dec), index, time_utc, None
    )
    spread = np.linalg.norm(swing[:, None] - swing[None], axis=-1).max() / ARCSEC
    assert spread == pytest.approx(2 * 0.7548, abs=0.03)


@pytest.mark.parametrize(
    ("hip", "arcsec_a_year"),
    [(87937, 10.36), (71683, 3.71), (32349, 1.34)],
    ids=["Barnard's star", "alpha Centauri", "Sirius"],
)
def test_proper_motion_is_that_of_the_textbook(deep_catalogue, hip, arcsec_a_year):
    index = np.repeat(deep_catalogue.find_index(np.array([hip])), 2)
    time_utc = np.array([moment("2000-03-01T00:00:00"), moment("2020-03-01T00:00:00")])  # the Earth in the same place
    then, now = apparent_directions(deep_catalogue, index, time_utc, None)
    assert angle(then, now) / ARCSEC / 20.0 == pytest.approx(arcsec_a_year, abs=0.015)
    assert hip != 87937 or (now - then)[2] / ARCSEC / 20 == pytest.approx(10.33, abs=0.05)  # Barnard's star goes north


def test_a_star_near_the_pole_moves_by_its_true_angle():
    polar = star_at(1.0, np.radians(89.9), pm_ra_arcsec=1.0)
    time_utc = np.array([moment("2001-01-01"), moment("2021-01-01")])
    then, now = apparent_directions(polar, np.zeros(2, dtype=np.int64), time_utc, None)
    assert angle(then, now) / ARCSEC / 20 == pytest.approx(1.0, abs=0.01)


@given(s=unit_vectors(), t=unit_vectors(), direction=unit_vectors())
def test_aberration_stretches_arcs_by_a_ten_thousandth_of_their_length(s, t, direction):
    v = 1e-4 * direction
    arc = angle(s, t)
    change = angle(*aberrated(np.stack([s, t]), v)) - arc
    # to first order the change is -v.(s + t) tan(arc / 2), and |s + t| = 2 cos(arc / 2)
    assert abs(change) <= 2e-4 * np.sin(arc / 2) + 2e-8 * arc + 1e-15
    if arc < 2.0:
        assert change == pytest.approx(-np.dot(v, s + t) * np.tan(arc / 2), abs=2e-8 * arc + 1e-15)


def test_rows_without_star_time_or_velocity_have_no_direction():
    star = star_at(0.3, 0.2)
    time_utc = np.array([moment("2024-01-01"), moment("2024-01-01"), moment("NaT"), moment("2024-01-01")])
    velocity = np.array([[0.0, 0.0, 1.0]] * 3 + [[np.nan] * 3])
    seen = apparent_directions(star, np.array([0, -1, 0, 0]), time_utc, velocity)
    assert np.isnan(seen).all(axis=1).tolist() == [False, True, True, True]
    assert apparent_directions(star, np.empty(0, np.int64), np.empty(0, "datetime64[us]"), None).shape == (0, 3)


def test_half_a_million_rows_at_forty_thousand_times_take_a_fraction_of_a_second(catalogue):
    n = 480_000
    index = np.random.default_rng(3).integers(0, len(catalogue), n)
    time_utc = moment("2024-01-01") + np.repeat(np.arange(40_000), 12) * 500_000
    begin = time.process_time()
    apparent_directions(catalogue, index, time_utc, np.full((n, 3), 4000.0))
    assert time.process_time() - begin < 2.0  # of processor time: what else the machine does does not count


TIME = np.full(4, np.datetime64("2024-01-01", "us"))
IDS = np.array([32349, 0, 55203, 71683])  # Sirius, unmatched, not in the catalogue, alpha Centauri
RA = np.radians([10.0, 20.0, 30.0, np.nan])
DEC = np.radians([-5.0, 0.0, 5.0, np.nan])
GIVEN = np.column_stack([np.cos(DEC) * np.cos(RA), np.cos(DEC) * np.sin(RA), np.sin(DEC)])


def test_the_files_direction_replaces_the_catalogues_and_unmatched_rows_have_none(catalogue):
    directions = star_directions(IDS, RA, DEC, TIME, None, catalogue)
    np.testing.assert_array_equal(directions[[0, 2]], GIVEN[[0, 2]])
    assert np.isnan(directions[1]).all()
    expected = apparent_directions(catalogue, catalogue.find_index(IDS[3:]), TIME[3:], None)
    np.testing.assert_array_equal(directions[3:], expected)
    np.testing.assert_array_equal(star_directions(None, RA, DEC, None, None, catalogue), GIVEN)


NONE_FIRST = np.where(np.arange(4) == 0, np.datetime64("NaT", "us"), TIME)


@pytest.mark.parametrize(
    ("rows", "given_too", "times", "known"),
    [
        (4, False, TIME, [True, False, False, True]),  # unknown stars have none
        (4, False, NONE_FIRST, [False, False, False, True]),  # nor has a row without time
        (3, True, None, [True, False, True]),  # times are not asked for where no row needs them
    ],
)
def test_rows_have_a_direction_where_star_and_time_or_the_file_give_one(catalogue, rows, given_too, times, known):
    own = (RA[:rows], DEC[:rows]) if given_too else (None, None)
    directions = star_directions(IDS[:rows], *own, times, None, catalogue)
    assert np.isfinite(directions).all(axis=1).tolist() == known


def test_the_satellites_velocity_is_that_of_the_row(catalogue):
    velocity = np.zeros((4, 3))
    velocity[3] = 7500.0, 0.0, 0.0
    still, moving = (star_directions(IDS, None, None, TIME, v, catalogue) for v in (None, velocity))
    np.testing.assert_array_equal(still[0], moving[0])
    assert np.linalg.norm(moving[3] - still[3]) > 1e-6


@pytest.mark.parametrize("times", [None, np.full(4, np.datetime64("NaT", "us"))], ids=["no column", "no cell"])
def test_catalogue_directions_without_any_time_or_any_star_are_refused(catalogue, times):
    with pytest.raises(RefusedInputError, match=r"2 matched.*time_utc.*--times"):
        star_directions(IDS, None, None, times, None, catalogue)
    with pytest.raises(RefusedInputError, check=has_code("no-star-numbers")):
        star_directions(None, None, None, TIME, None, catalogue)
