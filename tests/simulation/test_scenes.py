"""Simulated telemetry and fields are the catalogue seen through the true camera plus the noise asked for; orbits and scenarios."""

import json
import time
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from boresight.calibration.problem import build_problem
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.errors import NotFoundError, RefusedInputError
from boresight.estimation.metrics import rms
from boresight.simulation import scenes
from boresight.simulation.fields import GALACTIC_POLE_DEG, _attitudes, random_fields
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
from boresight.simulation.scenes import (
    calibration_scenario,
    parse_scenario,
    scenario_document,
    simulate,
    validation_scenario,
)
from boresight.simulation.sensors import (
    SENSOR_NUMBERS,
    WU_PIXEL_PITCH_M,
    WU_START,
    WU_TRUTH,
    st16_sensor,
    st16_truth,
    wu_sensor,
)
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import unit_vectors
from boresight.telemetry.sensors import sensor_document

numbers = st.sampled_from(SENSOR_NUMBERS)
with_catalogue = settings(max_examples=15, deadline=None)

ONE_IN_A_MILLION = 1e-6


def quiet(scenario, **changes):
    return replace(scenario, centroid_sigma_px=0.0, false_stars=0.0, blanked_share=0.0, **changes)


def simulated(scenario, catalogue):
    return simulate(scenario, np.random.default_rng(scenario.seed), catalogue)


def with_parity(scenario, parity):
    return replace(scenario, sensor=replace(scenario.sensor, parity=parity))


def expected_directions(telemetry, scenario, catalogue, rows):
    s_i = apparent_directions(
        catalogue, catalogue.find_index(telemetry.star_id[rows]), telemetry.time_utc[rows], telemetry.velocity_m_s[rows]
    )
    s_d = Rotation.from_quat(telemetry.quaternion[rows]).apply(s_i) * [1.0, scenario.sensor.parity, 1.0]
    return s_i, s_d


def read_columns(telemetry):
    columns = {field.name: getattr(telemetry, field.name) for field in fields(telemetry)}
    return {name: column for name, column in columns.items() if isinstance(column, np.ndarray)}


def noise_px(telemetry, scenario, catalogue):
    rows = np.flatnonzero(telemetry.star_id > 0)
    model, pitch = CAMERA_MODELS[scenario.sensor.camera_model], scenario.sensor.pixel_pitch_m
    _, s_d = expected_directions(telemetry, scenario, catalogue, rows)
    row_px, col_px = model.project(scenario.truth, s_d, pitch)
    return np.stack([telemetry.row_px[rows] - row_px, telemetry.col_px[rows] - col_px], axis=1), rows


@with_catalogue
@given(number=numbers, parity=st.sampled_from([-1, 1]), seed=st.integers(0, 2**32))
def test_without_noise_the_catalogue_projected_under_the_truth_gives_the_centroids(catalogue, number, parity, seed):
    scenario = with_parity(quiet(calibration_scenario(number, frames=5), seed=seed), parity)
    telemetry = simulated(scenario, catalogue)
    difference_px, rows = noise_px(telemetry, scenario, catalogue)
    assert len(rows) == len(telemetry)
    np.testing.assert_allclose(difference_px, 0.0, atol=1e-6)


@with_catalogue
@given(number=numbers, parity=st.sampled_from([-1, 1]))
def test_the_attitude_in_the_file_is_wahbas_solution_for_its_own_parity_and_no_attitude_explains_the_other(
    catalogue, number, parity
):
    scenario = with_parity(quiet(calibration_scenario(number, frames=2)), parity)
    telemetry = simulated(scenario, catalogue)
    first = np.flatnonzero((telemetry.frame == 0) & (telemetry.exposure == 0))
    s_i, _ = expected_directions(telemetry, scenario, catalogue, first)
    measured = CAMERA_MODELS[scenario.sensor.camera_model].directions(
        scenario.truth, telemetry.row_px[first], telemetry.col_px[first], scenario.sensor.pixel_pitch_m
    )
    wahba, loss = Rotation.align_vectors(measured * [1.0, parity, 1.0], s_i)
    assert loss < 1e-6  # its rounding; one pixel of noise would be 1e-4
    assert (wahba * Rotation.from_quat(telemetry.quaternion[first[0]]).inv()).magnitude() < 1e-9
    assert Rotation.align_vectors(measured * [1.0, -parity, 1.0], s_i)[1] > 0.01


@pytest.mark.parametrize("sigma_dex_per_mag", [0.0, 0.2])
@pytest.mark.parametrize("number", [2, 5])
def test_centroid_noise_has_the_variance_that_the_file_reports_and_grows_by_the_asked_decades(
    catalogue, number, sigma_dex_per_mag
):
    scenario = replace(calibration_scenario(number), sigma_dex_per_mag=sigma_dex_per_mag)
    telemetry = simulated(scenario, catalogue)
    difference_px, rows = noise_px(telemetry, scenario, catalogue)
    normalised = (difference_px / telemetry.sigma_px[rows, None]).ravel()
    low, high = stats.chi2.interval(1 - ONE_IN_A_MILLION, len(normalised))
    assert low < np.sum(normalised**2) < high
    assert abs(normalised.mean()) < 5.0 / np.sqrt(len(normalised))
    assert stats.kstest(normalised, "norm").pvalue > ONE_IN_A_MILLION
    fainter = catalogue.magnitude[catalogue.find_index(telemetry.star_id[rows])] - scenario.magnitude_limit
    expected = scenario.centroid_sigma_px * 10 ** (sigma_dex_per_mag * fainter)
    np.testing.assert_allclose(telemetry.sigma_px[rows], expected)


@with_catalogue
@given(rate=st.floats(0.0, 5.0), share=st.floats(0.0, 1.0), seed=st.integers(0, 2**32))
def test_false_stars_and_blanked_names_come_in_the_asked_number_and_false_stars_all_over_the_detector(
    catalogue, rate, share, seed
):
    scenario = replace(calibration_scenario(3, frames=50), false_stars=rate, blanked_share=0.0, seed=seed)
    telemetry = simulated(scenario, catalogue)
    false = telemetry.star_id == 0
    low, high = stats.poisson.interval(1 - ONE_IN_A_MILLION, rate * 100) if rate else (0, 0)
    assert low <= false.sum() <= high
    if false.sum() > 20:
        assert stats.kstest(telemetry.row_px[false], "uniform", args=(-0.5, 1944)).pvalue > ONE_IN_A_MILLION
        assert stats.kstest(telemetry.col_px[false], "uniform", args=(-0.5, 2592)).pvalue > ONE_IN_A_MILLION
    blanked = simulated(replace(scenario, false_stars=0.0, blanked_share=share), catalogue)
    low, high = stats.binom.interval(1 - ONE_IN_A_MILLION, len(blanked), share)
    assert low <= np.sum(blanked.star_id == 0) <= high


@pytest.mark.parametrize("number", SENSOR_NUMBERS)
def test_a_set_has_every_column_with_its_rows_in_contract_order_on_the_detector(catalogue, number):
    scenario = calibration_scenario(number, frames=40)
    telemetry = simulated(scenario, catalogue)
    columns = read_columns(telemetry)
    assert telemetry.ra_rad is None
    assert len(columns) == 11
    assert telemetry.unknown == {}
    assert all(len(column) == len(telemetry) for column in columns.values())
    assert all(np.all(np.isfinite(column)) for name, column in columns.items() if name != "time_utc")
    key = telemetry.frame * scenario.exposures + telemetry.exposure
    assert np.all(np.diff(key) >= 0)
    assert set(telemetry.frame) == set(range(40))
    assert np.all(np.diff(telemetry.time_utc) >= np.timedelta64(0))
    assert np.all((telemetry.row_px >= -0.5) & (telemetry.row_px <= 1943.5))
    assert np.all((telemetry.col_px >= -0.5) & (telemetry.col_px <= 2591.5))
    np.testing.assert_allclose(np.linalg.norm(telemetry.quaternion, axis=1), 1.0)


@pytest.fixture(scope="module")
def sets(catalogue):
    scenarios = {number: replace(calibration_scenario(number), false_stars=0.0) for number in SENSOR_NUMBERS}
    return {number: simulated(scenario, catalogue) for number, scenario in scenarios.items()}


def test_frames_are_a_sample_period_apart_and_their_exposures_a_quarter_second_with_eleven_stars_each(sets):
    steps_s = np.diff(np.unique(sets[1].time_utc)) / np.timedelta64(1, "us") / 1e6
    np.testing.assert_allclose(steps_s[::2], 0.25)
    assert np.all(steps_s[1::2] >= 39.74)
    assert np.median(steps_s[1::2]) == pytest.approx(39.75)
    assert sum(map(len, sets.values())) / (400 * len(sets)) == pytest.approx(10.8, abs=0.3)


@pytest.mark.parametrize("number", SENSOR_NUMBERS)
def test_no_star_is_listed_twice_in_an_exposure_and_no_two_are_closer_than_a_blend(catalogue, number):
    scenario = quiet(calibration_scenario(number))
    telemetry = simulated(scenario, catalogue)
    key = telemetry.frame * scenario.exposures + telemetry.exposure
    assert len(np.unique(np.stack([key, telemetry.star_id]), axis=1).T) == len(telemetry)
    for exposure in np.unique(key)[::20]:
        m, n = telemetry.row_px[key == exposure], telemetry.col_px[key == exposure]
        apart_px = np.hypot(m[:, None] - m, n[:, None] - n) + 1e9 * np.eye(len(m))
        assert apart_px.min() > 4.5


@pytest.mark.parametrize("number", SENSOR_NUMBERS)
def test_the_validation_set_is_later_shorter_and_mostly_of_other_stars(catalogue, number):
    calibration = simulated(calibration_scenario(number), catalogue)
    validation = simulated(validation_scenario(number), catalogue)
    assert validation.time_utc[0] - calibration.time_utc[-1] > np.timedelta64(2, "h")
    assert len(np.unique(validation.frame)) < 0.6 * len(np.unique(calibration.frame))
    seen_before = np.isin(validation.star_id[validation.star_id > 0], calibration.star_id)
    assert seen_before.mean() < 0.7


@with_catalogue
@given(number=numbers, seed=st.integers(0, 2**63 - 2))
def test_the_same_seed_gives_the_same_set_to_the_last_bit_and_another_another(catalogue, number, seed):
    scenario = replace(calibration_scenario(number, frames=4), seed=seed)
    first, second = (read_columns(simulated(scenario, catalogue)) for _ in range(2))
    assert first.keys() == second.keys()
    for name, column in first.items():
        np.testing.assert_array_equal(column, second[name])
    other = simulated(replace(scenario, seed=seed + 1), catalogue)
    assert not np.array_equal(first["row_px"][:10], other.row_px[:10])


def test_a_focal_drift_scales_the_image_with_temperature(catalogue):
    scenario = quiet(calibration_scenario(1, frames=30), focal_drift_m_per_c=1e-6)
    telemetry = simulated(scenario, catalogue)
    _, s_d = expected_directions(telemetry, scenario, catalogue, np.arange(len(telemetry)))
    model, pitch = CAMERA_MODELS[scenario.sensor.camera_model], scenario.sensor.pixel_pitch_m
    for exposure in np.unique(telemetry.time_utc)[::7]:
        rows = telemetry.time_utc == exposure
        x = scenario.truth.copy()
        x[0] += 1e-6 * (telemetry.temperature_c[rows][0] - 20.0)
        row_px, col_px = model.project(x, s_d[rows], pitch)
        np.testing.assert_allclose(telemetry.row_px[rows], row_px, atol=1e-6)
        np.testing.assert_allclose(telemetry.col_px[rows], col_px, atol=1e-6)
    assert np.ptp(telemetry.temperature_c) > 1.0


@pytest.mark.parametrize(
    ("changes", "words"), [({"pointing_rad": np.pi}, "0 of 10 frames"), ({"magnitude_limit": -5.0}, "magnitude_limit")]
)
def test_a_sensor_that_looks_at_the_earth_or_sees_no_star_is_refused(catalogue, changes, words):
    with pytest.raises(RefusedInputError, match=words):
        simulated(quiet(calibration_scenario(1, frames=10), **changes), catalogue)


def test_two_thousand_frames_take_less_than_three_seconds(catalogue):
    scenario = calibration_scenario(1, frames=2_000)
    start = time.perf_counter()
    telemetry = simulated(scenario, catalogue)
    assert time.perf_counter() - start < 3.0
    assert len(np.unique(telemetry.frame)) == 2_000


@pytest.mark.parametrize("number", SENSOR_NUMBERS)
def test_arcs_at_the_truth_have_the_noise_asked_for_and_at_the_ground_calibration_far_more(catalogue, number):
    scenario = calibration_scenario(number)
    problem = build_problem(simulated(scenario, catalogue), scenario.sensor, catalogue)
    at_truth = rms(problem.whitened(scenario.truth), scenario.truth)
    at_ground = rms(problem.whitened(scenario.sensor.initial), scenario.sensor.initial)
    assert at_truth == pytest.approx(83e-6, abs=3e-6)
    assert at_ground > 1.5 * at_truth


@pytest.fixture(scope="module")
def star_fields():
    rng = np.random.default_rng(5)
    s_i = rng.normal(size=(3000, 3))
    s_i /= np.linalg.norm(s_i, axis=1, keepdims=True)
    return random_fields(wu_sensor(), WU_TRUTH, s_i, 250, rng, minimum_stars=5)


def test_every_field_of_the_papers_sensor_has_its_stars_on_the_detector_and_enough_of_them(star_fields):
    sensor = wu_sensor(0.5)
    assert (sensor.rows, sensor.columns, sensor.centroid_sigma_px) == (1080, 1920, 0.5)
    assert np.array_equal(sensor.initial, WU_START)
    assert sensor.free == PINHOLE_RADIAL.parameter_names
    assert len(star_fields) == 250
    assert np.diff(star_fields.star_start).min() >= 5
    assert star_fields.star_start[-1] == len(star_fields.s_i) == len(star_fields.row_px) == len(star_fields.col_px)
    assert np.all((star_fields.row_px >= -0.5) & (star_fields.row_px <= 1079.5))
    assert np.all((star_fields.col_px >= -0.5) & (star_fields.col_px <= 1919.5))


def test_the_true_camera_gives_back_the_catalogues_angles_and_its_share_of_a_uniform_sky(star_fields):
    s_d = PINHOLE_RADIAL.directions(WU_TRUTH, star_fields.row_px, star_fields.col_px, WU_PIXEL_PITCH_M)
    for first, last in zip(star_fields.star_start[:20], star_fields.star_start[1:21], strict=True):
        seen, known = s_d[first:last], star_fields.s_i[first:last]
        assert np.allclose(seen @ seen.T, known @ known.T, atol=1e-12)
        handed = [np.linalg.det(one[:3]) for one in (seen, known)]
        assert np.isclose(handed[0], wu_sensor().parity * handed[1], atol=1e-12)
    corners = PINHOLE_RADIAL.solid_angle(
        WU_TRUTH, *np.mgrid[0:1080:20, 0:1920:20].reshape(2, -1) + 9.5, WU_PIXEL_PITCH_M
    )
    expected = 3000 * corners.sum() * 400 / (4 * np.pi)
    assert len(star_fields.s_i) / len(star_fields) == pytest.approx(expected, abs=4 * np.sqrt(expected / 250))


def test_attitudes_are_rotations_with_their_boresights_in_the_band_spread_evenly():
    rng = np.random.default_rng(2)
    C = np.concatenate([_attitudes(25.0, rng) for _ in range(20)])
    sine = C[:, 2] @ unit_vectors(*np.radians(GALACTIC_POLE_DEG))
    assert np.allclose(C @ C.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(C), 1)
    assert np.abs(sine).max() <= np.sin(np.radians(25))
    assert np.mean(sine**2) == pytest.approx(np.sin(np.radians(25)) ** 2 / 3, rel=0.05)
    assert np.abs(C[:, 0].mean(axis=0)).max() < 0.05


made = st.builds(
    lambda make, number, frames, rate, seed: replace(make(number, frames), false_stars=rate, seed=seed),
    st.sampled_from([calibration_scenario, validation_scenario]),
    st.sampled_from(SENSOR_NUMBERS),
    st.integers(1, 1000),
    st.floats(0.0, 10.0),
    st.integers(0, 2**63 - 1),
)


def assert_same(first, second):
    for field in fields(first):
        ours, theirs = getattr(first, field.name), getattr(second, field.name)
        if field.name == "sensor":
            assert sensor_document(ours) == sensor_document(theirs)
        elif field.name == "orbit":
            assert ours.start_utc == theirs.start_utc
            for name in ("altitude_m", "inclination_rad", "node_hour"):
                assert getattr(ours, name) == pytest.approx(getattr(theirs, name))
        elif isinstance(ours, str):
            assert ours == theirs
        else:
            np.testing.assert_allclose(ours, theirs)


@given(made)
def test_a_document_reads_back_as_the_scenario_it_was_written_from(scenario):
    document = json.loads(json.dumps(scenario_document(scenario)))
    assert_same(parse_scenario(document), scenario)


def test_the_example_on_the_modules_page_is_the_first_calibration_set():
    page = scenes.__doc__
    example = parse_scenario(json.loads(page[page.index("{") : page.rindex("}") + 1]))
    assert_same(replace(example, truth=st16_truth(1), seed=100), calibration_scenario(1))
    np.testing.assert_allclose(example.truth[:2], st16_truth(1)[:2])


def test_a_sensor_document_is_its_own_truth_unless_one_is_given():
    document = sensor_document(st16_sensor(2)) | {"name": "mine", "centroid_sigma_px": 0.2}
    scenario = parse_scenario({"sensor": document})
    np.testing.assert_array_equal(scenario.truth, scenario.sensor.initial)
    assert scenario.centroid_sigma_px == 0.2
    changed = parse_scenario({"sensor": document, "truth": {"g_y": 1.001}})
    assert changed.truth[7] == 1.001


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"sensor": 7}, "sensor"),
        ({"sensor": True}, "sensor"),
        ({"sensor": "ST16-1"}, "sensor"),
        ({"colour": 1}, "colour"),
        ({"truth": {"k1": 0.1}}, "truth"),
        ({"truth": {"f_m": "long"}}, "f_m"),
        ({"truth": {"f_m": float("nan")}}, "f_m"),
        ({"orbit": {"altitude_km": 100}}, "altitude_km"),
        ({"orbit": {"period_s": 100}}, "orbit"),
        ({"motion": "tumbling"}, "motion"),
        ({"motion": ["nadir"]}, "motion"),
        ({"pointing_deg": 1e4}, "pointing_deg"),
        ({"start_utc": "tomorrow"}, "start_utc"),
        ({"start_utc": "NaT"}, "start_utc"),
        ({"start_utc": "1850-01-01T00:00:00Z"}, "start_utc"),
        ({"frames": 0}, "frames"),
        ({"frames": 2.5}, "frames"),
        ({"frames": True}, "frames"),
        ({"exposures": 11}, "exposures"),
        ({"magnitude_limit": float("inf")}, "magnitude_limit"),
        ({"centroid_sigma_px": 0}, "centroid_sigma_px"),
        ({"blanked_share": 1.5}, "blanked_share"),
        ({"false_stars": -1}, "false_stars"),
        ({"seed": -1}, "seed"),
    ],
)
def test_a_wrong_value_is_refused_by_the_name_of_its_key(change, named):
    with pytest.raises(RefusedInputError, match=named):
        parse_scenario({"sensor": 1} | change)


@pytest.mark.parametrize("document", [[], "nadir", None, {}])
def test_a_document_without_a_sensor_is_refused(document):
    with pytest.raises(RefusedInputError, match="sensor"):
        parse_scenario(document)


def test_the_ground_calibration_and_the_truths_are_those_of_the_published_tables():
    sensor = st16_sensor(1)
    assert (sensor.rows, sensor.columns) == (1944, 2592)
    assert CAMERA_MODELS[sensor.camera_model].principal_point(sensor.initial) == (972.0, 1296.0)
    sigma_rad = np.sqrt(2.0) * sensor.centroid_sigma_px * sensor.pixel_pitch_m / sensor.initial[0]
    assert sigma_rad == pytest.approx(84.5e-6, abs=0.1e-6)
    f_m, _, _, b4_per_m4, b2_per_m2, *_ = st16_truth(2)
    assert f_m == pytest.approx(16.031e-3, abs=0.5e-6)
    assert b2_per_m2 == pytest.approx(-2.152e3, abs=0.02e3)
    assert b4_per_m4 == pytest.approx(1.370e8, abs=0.05e8)
    assert st16_truth(6)[2] - st16_sensor(6).initial[2] == pytest.approx(-9.81 * 30.0)


@pytest.mark.parametrize("number", SENSOR_NUMBERS)
def test_each_sensor_has_its_own_name_all_eight_parameters_free_and_a_set_by_its_number_alone(number):
    st16_sensor(number).initial[0] = st16_truth(number)[0] = 0.0  # changing one does not change the next
    sensor = st16_sensor(number)
    assert (sensor.name, sensor.initial[0]) == (f"ST16-{number}", pytest.approx(16.095e-3))
    assert sensor.free == CAMERA_MODELS[sensor.camera_model].parameter_names
    assert_same(parse_scenario({"sensor": number}), calibration_scenario(number))


@pytest.mark.parametrize("number", SENSOR_NUMBERS)
def test_every_truth_is_plausible_and_maps_the_whole_detector(number):
    sensor, truth = st16_sensor(number), st16_truth(number)
    model = CAMERA_MODELS[sensor.camera_model]
    low, high = np.transpose(model.plausible)
    assert np.all((truth >= low) & (truth <= high))
    row_px, col_px = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1943, 25), np.linspace(0, 2591, 25)))
    s_d = model.directions(truth, row_px, col_px, sensor.pixel_pitch_m)
    again = model.project(truth, s_d, sensor.pixel_pitch_m)
    np.testing.assert_allclose(again, (row_px, col_px), atol=1e-6)


@pytest.mark.parametrize("number", [0, 7, -1])
def test_a_sensor_that_table_iii_does_not_have_is_refused_with_the_choice(number):
    with pytest.raises(NotFoundError, match="1 to 6"):
        st16_sensor(number)
    with pytest.raises(NotFoundError, match="1 to 6"):
        st16_truth(number)


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
