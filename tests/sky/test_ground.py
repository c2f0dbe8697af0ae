"""The observer on the ground: erfa's whole chain as the independent form, known facts, the loop beside it, tables and their age."""

from dataclasses import replace

import erfa
import numpy as np
import pytest

from boresight.calibration.assumptions import list_assumptions
from boresight.calibration.corrections import put_right
from boresight.calibration.readout import ReadoutCorrection
from boresight.errors import RefusedInputError
from boresight.estimation.attitude import to_quaternion
from boresight.site import SITE_FIELDS, Site
from boresight.sky import ground
from boresight.sky.apparent import C_AU_DAY, C_M_S, aberrated, days_since_j2000, earth_state
from boresight.sky.directions import star_directions
from boresight.sky.guide_stars import GuideStars, ObserverMotion, observer_motion
from boresight.sky.matching import Detections, match
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import parse_sensor, sensor_document

ARCSEC = np.pi / 180 / 3600
SITE = Site(52.22, 4.42, 10.0, 1010.0, 15.0, 0.7, 0.55)
NIGHT = np.datetime64("2019-07-29T20:47:26", "us") + np.arange(0, 4, 2) * np.timedelta64(1, "h")


def at(moments):
    return (moments - np.datetime64("2000-01-01T12:00:00", "us")).astype(np.int64) / 86400e6


def observed(ra, dec, moments, site=SITE):
    """Directions of stars at rest and far away, (n, 3), seen from a site at moments (n,)."""
    s = erfa.s2c(ra, dec)
    v = earth_state(days_since_j2000(moments))[1] / C_AU_DAY + ground.velocity_at(site, moments) / C_M_S
    return ground.refracted_at(aberrated(s, v), site, moments)


def test_zenith_distances_are_those_of_erfas_whole_chain_from_catalogue_to_telescope():
    rng = np.random.default_rng(1)
    moments = np.repeat(NIGHT, 200)
    ra, dec = rng.uniform(0, 2 * np.pi, len(moments)), np.arcsin(rng.uniform(-1, 1, len(moments)))
    ut1_minus_utc, x, y = ground.earth_orientation(at(moments))
    _, distance, *_ = erfa.atco13(
        ra, dec, 0, 0, 0, 0, 2451545.0, at(moments), ut1_minus_utc, np.radians(SITE.longitude_deg), np.radians(SITE.latitude_deg),
        SITE.height_m, x, y, *ground.air(SITE),
    )  # fmt: skip
    high = distance < np.radians(80)
    elevation = ground.elevation_deg(observed(ra, dec, moments), SITE, moments)
    off = np.radians(90 - elevation[high]) - distance[high]
    assert high.sum() > 100
    assert np.abs(off).max() < 0.02 * ARCSEC  # light deflection by the Sun, which we leave out


def test_refraction_is_58_arcsec_at_45_degrees_and_towards_the_zenith():
    view = ground.view_from(SITE, NIGHT[:1])
    high = view.direction(np.array([1.0]), np.radians([45.0]))
    bent = ground.refracted(high, view)
    lift = np.arccos(view.zenith[0] @ high[0]) - np.arccos(view.zenith[0] @ bent[0])
    assert 55 * ARCSEC < lift < 60 * ARCSEC
    assert abs(np.cross(view.zenith[0], high[0]) @ bent[0]) < 1e-9
    np.testing.assert_allclose(
        bent - high, ground.lift(high, view.zenith, view.A, view.B), atol=0.1 * ARCSEC
    )  # to first order


def test_without_air_nothing_is_bent_and_the_site_still_moves():
    vacuum = replace(SITE, pressure_hpa=0.0)
    s = erfa.s2c(np.array([1.0]), np.array([0.7]))
    np.testing.assert_allclose(ground.refracted_at(s, vacuum, NIGHT[:1]), s, atol=1e-12)
    speed = np.linalg.norm(ground.velocity_at(vacuum, NIGHT), axis=1)
    np.testing.assert_allclose(speed, 465.1 * np.cos(np.radians(52.22)), rtol=3e-3)  # of the Earth's rotation there


def test_a_place_that_is_only_supposed_has_its_zenith_within_half_a_degree():
    latitude, longitude = np.radians([52.22, 4.42])
    place = erfa.s2c(longitude, latitude)[None]
    supposed = ground.zeniths_from(place, NIGHT)[:, 0]
    true = ground.view_from(SITE, NIGHT).zenith
    assert np.degrees(np.arccos(np.sum(supposed * true, axis=1))).max() < 0.5


def test_the_matching_loop_bends_a_star_as_erfa_does():
    moments, ra = NIGHT[:1], np.array([4.0, 4.1, 4.15, 4.2, 4.05])
    dec = np.array([0.3, 0.35, 0.25, 0.32, 0.38])
    place = erfa.s2c(ra, dec)
    order = np.argsort(place[:, 2])
    stars = GuideStars(np.arange(1, 6), place[order], np.zeros((5, 3)), np.zeros(5), 1e-3)
    years = (days_since_j2000(moments) - (2448349.0625 - 2451545.0)) / 365.25
    motion = observer_motion(moments, None, SITE)
    motion = ObserverMotion(years, np.zeros((1, 3)), motion.beta, motion.air)
    seen = observed(ra[order], dec[order], np.repeat(moments, 5))
    middle = seen.mean(axis=0) / np.linalg.norm(seen.mean(axis=0))
    x = np.cross([0.0, 0.0, 1.0], middle)
    x /= np.linalg.norm(x)
    C = np.stack([x, np.cross(middle, x), middle])
    detections = Detections(
        frame_start=np.array([0, 1]), row_start=np.array([0, 5]), s=seen @ C.T, G=np.zeros((5, 3, 1)),
        sigma_rad=np.full(5, 1e-6), star_id=np.zeros(5, np.int64), given_s=np.full((5, 3), np.nan), own=np.zeros(5, np.bool_),
        quaternion=to_quaternion(C[None]), time_s=np.zeros(1),
    )  # fmt: skip
    found = match(detections, stars, motion, 0.3, 4)
    assert found.star_id.tolist() == [1, 2, 3, 4, 5]
    np.testing.assert_allclose(found.s_i, seen, atol=1e-9)


def test_given_directions_are_as_observed_and_those_of_the_catalogue_are_bent(catalogue):
    hip = catalogue.hip[:3]
    rows = np.repeat(NIGHT[:1], 3)
    bent = star_directions(hip, None, None, rows, None, catalogue, SITE)
    plain = star_directions(hip, None, None, rows, None, catalogue)
    assert (np.linalg.norm(bent - plain, axis=1) > 1e-6).all()
    ra, dec = np.arctan2(plain[:, 1], plain[:, 0]), np.arcsin(plain[:, 2])
    np.testing.assert_allclose(star_directions(hip, ra, dec, rows, None, catalogue, SITE), plain, atol=1e-12)


def sensor(document, **fields):
    return parse_sensor({**document, **fields})


@pytest.fixture
def document():
    return {
        "name": "Tripod", "detector": {"rows": 768, "columns": 1024, "pixel_pitch_m": 6.9e-6}, "camera_model": "pinhole_radial",
        "parity": -1, "centroid_sigma_px": 0.1,
        "initial": {"s": 1.0, "f_m": 0.035, "u0_px": 511.5, "v0_px": 383.5, "k1": 0.0, "k2": 0.0},
        "typical_sigma": {"s": 2e-4, "f_m": 3e-4, "u0_px": 10.0, "v0_px": 10.0, "k1": 0.01, "k2": 0.1},
    }  # fmt: skip


def test_a_site_is_read_written_and_every_fault_in_it_told_at_once(document):
    given = {"latitude_deg": 52.2, "longitude_deg": 4.4, "pressure_hpa": 1010.0}
    read = sensor(document, site=given)
    assert sensor_document(read)["site"] == given
    assert read.site.assumed == ["height_m", "temperature_c", "relative_humidity", "wavelength_um"]
    with pytest.raises(RefusedInputError) as refusal:
        sensor(document, site={"latitude": 5, "longitude_deg": 400, "presure_hpa": 1})
    told = " ".join(map(str, refusal.value.faults))
    assert len(refusal.value.faults) == 4
    assert "mean latitude_deg" in told
    assert "mean pressure_hpa" in told
    with pytest.raises(RefusedInputError):
        sensor(document, site=given, declared={"refraction": "none"})
    assert all(one.sentence for one in SITE_FIELDS.values())


def test_the_pressure_that_nobody_gave_is_that_of_the_height():
    low, high = (ground.refraction_constants(Site(0.0, 0.0, height))[0] for height in (0.0, 5_500.0))
    assert 275e-6 < low < 290e-6
    assert 0.48 < high / low < 0.55


def at_site(document, catalogue, site=None, given=False, **declared):
    rows = np.repeat(NIGHT[:1], 3)
    s = star_directions(catalogue.hip[:3], None, None, rows, None, catalogue)
    telemetry = Telemetry(
        frame=np.zeros(3, np.int64), exposure=np.zeros(3, np.int64), row_px=np.array([1.0, 2, 3]), col_px=np.array([4.0, 5, 6]),
        time_utc=rows, star_id=catalogue.hip[:3],
        ra_rad=np.arctan2(s[:, 1], s[:, 0]) if given else None, dec_rad=np.arcsin(s[:, 2]) if given else None,
    )  # fmt: skip
    described = sensor(document, site=(site or SITE).document(), declared=declared)
    right = put_right(telemetry, described, catalogue)
    made = {
        one.name: one
        for one in list_assumptions(right, right, described, catalogue, described.initial, ReadoutCorrection())
    }
    return telemetry, right, made


@pytest.mark.parametrize(
    ("declared", "bent"), [({}, False), ({"refraction": "uncorrected"}, True), ({"directions": "j2000"}, True)]
)
def test_directions_of_a_file_are_bent_where_they_are_said_to_lack_it(document, catalogue, declared, bent):
    telemetry, right, made = at_site(document, catalogue, given=True, **declared)
    moved = np.abs(right.dec_rad - telemetry.dec_rad).max()
    assert (moved > 1e-5) == bent
    assert made["refraction"].declared == bent


def test_a_calibration_says_what_it_assumed_of_site_and_air_and_what_an_error_does(document, catalogue):
    known = at_site(document, catalogue)[2]
    assert known["refraction"].declared
    assert known["satellite_velocity"].declared
    unsure = at_site(document, catalogue, Site(52.22, 4.42))[2]["refraction"]
    assert not unsure.declared
    assert "ppm" in unsure.sentence
    assert all(name in unsure.sentence for name in ("pressure_hpa", "temperature_c"))


def test_the_tables_of_the_earths_rotation_are_read_offline_with_their_age(document, catalogue):
    tables = ground.earth_tables()
    assert tables.measured_to < tables.predicted_to
    assert np.abs(tables.ut1_minus_utc_s).max() < 1.0
    days = np.array([6209.4999, 6209.5001])  # across the leap second at the end of 2016
    before, after = ground.earth_orientation(days)[0]
    assert after - before == pytest.approx(1.0, abs=1e-3)
    assert str(tables.measured_to) in at_site(document, catalogue)[2]["earth_rotation"].sentence
    beyond = float((tables.predicted_to - np.datetime64("2000-01-01")) / np.timedelta64(1, "D")) + 4000
    assert np.isfinite(ground.earth_orientation(np.array([beyond]))[0]).all()


def test_times_before_utc_are_refused():
    with pytest.raises(RefusedInputError, match="time_utc"):
        ground.view_from(SITE, np.array(["-6000-01-01"], "datetime64[us]"))
