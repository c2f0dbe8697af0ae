"""Orbits obey mechanics, motions obey Table I, and what is kept is usable sky."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.simulation.orbits import (
    EARTH_RADIUS_M,
    MOTIONS,
    MU_M3_S2,
    SLEW_RATE_RAD_S,
    SUN_EXCLUSION_RAD,
    Orbit,
    attitude,
    state,
    sun_direction,
    usable,
)

START = np.datetime64("2026-10-01T00:00:00", "us")

orbits = st.builds(
    Orbit,
    altitude_m=st.floats(400e3, 900e3),
    inclination_rad=st.floats(1.6, 1.75),
    node_hour=st.floats(0.0, 24.0),
    start_utc=st.just(START),
)
motions = st.sampled_from(sorted(MOTIONS))
pointings = st.floats(0.0, 1.2)


def sun_synchronous(node_hour=10.5):
    return Orbit(570e3, np.radians(97.8), node_hour, START)


@given(orbits)
def test_the_orbit_is_a_circle_and_its_velocity_the_derivative_of_position(orbit):
    t_s = np.linspace(0.0, 20_000.0, 50)
    position, velocity, normal = state(orbit, t_s)
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), EARTH_RADIUS_M + orbit.altitude_m, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1) ** 2 * orbit.radius_m, MU_M3_S2, rtol=1e-9)
    np.testing.assert_allclose(np.einsum("ij,ij->i", position, velocity), 0.0, atol=1.0)
    np.testing.assert_allclose(np.einsum("ij,ij->i", position, normal), 0.0, atol=1e-6)
    slope = (state(orbit, t_s + 0.5)[0] - state(orbit, t_s - 0.5)[0]) / 1.0
    np.testing.assert_allclose(slope, velocity, atol=3.0)  # the node's drift, left out of the velocity, is under 2 m/s


@pytest.mark.parametrize(("altitude_km", "inclination_deg"), [(570, 97.8), (620, 98.4), (730, 97.7), (670, 98.0)])
def test_the_orbits_of_table_i_follow_the_sun_within_a_tenth(altitude_km, inclination_deg):
    orbit = Orbit(altitude_km * 1e3, np.radians(inclination_deg), 10.5, START)
    drift_deg_day = np.degrees(orbit.node_drift_rad_s) * 86_400
    assert drift_deg_day == pytest.approx(360 / 365.2422, rel=0.1)


def test_the_ascending_node_has_its_local_hour_at_the_start():
    for node_hour in (6.0, 12.0, 22.5):
        node = state(sun_synchronous(node_hour), np.zeros(1))[0][0]
        sun = sun_direction(np.array([START]))[0]
        hours = 12.0 + np.degrees(np.arctan2(node[1], node[0]) - np.arctan2(sun[1], sun[0])) / 15.0
        assert hours % 24.0 == pytest.approx(node_hour)


@pytest.mark.parametrize(
    ("instant", "ra_deg", "dec_deg"),
    [("2000-03-20T07:35", 0.0, 0.0), ("2000-06-21T01:48", 90.0, 23.44), ("2000-12-21T13:37", 270.0, -23.44)],
)
def test_the_sun_stands_where_equinox_and_solstices_put_it(instant, ra_deg, dec_deg):
    ra, dec = np.radians([ra_deg, dec_deg])
    expected = [np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]
    np.testing.assert_allclose(sun_direction(np.array([np.datetime64(instant, "us")]))[0], expected, atol=5e-4)


@given(orbits, motions, pointings)
def test_every_attitude_is_a_right_handed_rotation(orbit, motion, pointing_rad):
    C = attitude(motion, orbit, np.linspace(0.0, 10_000.0, 40), pointing_rad)
    np.testing.assert_allclose(C @ C.transpose(0, 2, 1), np.broadcast_to(np.eye(3), C.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(C), 1.0, atol=1e-12)


@given(orbits, motions, pointings)
def test_no_motion_turns_faster_than_a_star_tracker_follows(orbit, motion, pointing_rad):
    t_s = np.arange(0.0, 3_000.0, 0.5)
    z = attitude(motion, orbit, t_s, pointing_rad)[:, 2]
    step_rad = np.linalg.norm(np.diff(z, axis=0), axis=1)
    assert np.degrees(step_rad.max()) / 0.5 < 2.0


@given(st.floats(0.1, 1.2))
def test_nadir_pointing_keeps_its_angle_from_the_zenith_leans_away_from_the_sun_and_sweeps_once_an_orbit(pointing_rad):
    orbit, t_s = sun_synchronous(), np.linspace(0.0, 6_000.0, 100)
    position, _, normal = state(orbit, t_s)
    z = attitude("nadir", orbit, t_s, pointing_rad)[:, 2]
    np.testing.assert_allclose(np.einsum("ij,ij->i", z, position / orbit.radius_m), np.cos(pointing_rad), atol=1e-12)
    sunward = normal @ sun_direction(orbit.times_utc(np.zeros(1)))[0]
    assert np.all(np.einsum("ij,ij->i", z, normal) * sunward < 0.0)
    period_s = 2.0 * np.pi / orbit.mean_motion_rad_s
    z = attitude("nadir", orbit, np.array([0.0, period_s / 2.0, period_s]), np.radians(45.0))[:, 2]
    assert z[0] @ z[2] == pytest.approx(1.0, abs=1e-5)
    assert z[0] @ z[1] == pytest.approx(0.0, abs=1e-3)  # 45 deg to either side of the orbit normal


def test_slews_run_at_their_rate_along_a_great_circle_and_holds_stay_near_their_target():
    t_s = np.arange(0.0, 2_000.0, 10.0)
    z = attitude("slew", sun_synchronous(), t_s, 0.3)[:, 2]
    angle = np.arccos(np.einsum("ij,ij->i", z[1:], z[:-1]))
    np.testing.assert_allclose(angle, 10.0 * SLEW_RATE_RAD_S, rtol=1e-6)
    assert np.linalg.svd(z, compute_uv=False)[2] < 1e-9
    z = attitude("hold_and_slew", sun_synchronous(), np.arange(0.0, 900.0, 10.0), 0.0)[:, 2]
    first, second = z[:30], z[45:75]
    assert np.degrees(np.arccos(first @ first.mean(axis=0)).max()) < 3.0
    assert np.degrees(np.arccos(first[0] @ second[0])) > 15.0


@given(orbits, motions, pointings)
def test_kept_instants_are_sunlit_with_sun_and_earth_outside_the_field_of_view(orbit, motion, pointing_rad):
    t_s = np.arange(0.0, 12_000.0, 60.0)
    z = attitude(motion, orbit, t_s, pointing_rad)[:, 2]
    kept = usable(orbit, t_s, z)
    position, sun = state(orbit, t_s)[0][kept], sun_direction(orbit.times_utc(t_s))[kept]
    assert np.all(np.einsum("ij,ij->i", z[kept], sun) <= np.cos(SUN_EXCLUSION_RAD))
    corner_rad = np.radians(15.0)
    to_limb = np.arccos(np.clip(-np.einsum("ij,ij->i", z[kept], position) / orbit.radius_m, -1.0, 1.0))
    assert np.all(to_limb - np.arcsin(EARTH_RADIUS_M / orbit.radius_m) > corner_rad)
    nearest_m = np.linalg.norm(np.cross(position, sun), axis=1)
    assert np.all((np.einsum("ij,ij->i", position, sun) >= 0.0) | (nearest_m >= EARTH_RADIUS_M))


def test_a_third_of_a_noon_orbit_is_lost_to_eclipse():
    t_s = np.linspace(0.0, 2.0 * np.pi / sun_synchronous().mean_motion_rad_s, 2_000)
    orbit = sun_synchronous(12.0)
    away_from_all = state(orbit, t_s)[2]  # the orbit normal: Sun and Earth are both far off
    lost = 1.0 - usable(orbit, t_s, away_from_all).mean()
    assert lost == pytest.approx(np.arcsin(EARTH_RADIUS_M / orbit.radius_m) / np.pi, abs=0.01)
