"""A rolling shutter is corrected with the rates that telemetry tells; what no data can show is listed as declared or assumed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from boresight.calibration.assumptions import list_assumptions
from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import UnseenDeparture
from boresight.calibration.corrections import Corrections, put_right, to_apparent
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.readout import (
    MOST_GAP_S,
    ReadoutCorrection,
    compute_rates,
    correct_readout,
    find_rates,
    find_speed_px_s,
)
from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.library.functions import assess
from boresight.simulation.scenes import calibration_scenario, parse_scenario, scenario_document, simulate
from boresight.simulation.sensors import st16_truth
from boresight.sky.apparent import apparent_directions
from boresight.telemetry.declarations import NOTHING_DECLARED, Declared, Readout
from boresight.telemetry.schema import Telemetry
from tests.calibration.sets import write_in_groups
from tests.effort import effort

#: 2 px from the first line to the last, with the orbit's rate: the sky moves along the rows.
ROLLING = Readout("rolling", 1.35e-4, "rows")


def scene(readout=ROLLING, frames=100, **changes):
    scenario = calibration_scenario(1, frames)
    return replace(scenario, sensor=replace(scenario.sensor, readout=readout), **changes)


def made(catalogue, seed=0, **changes):
    scenario = scene(**changes)
    return simulate(scenario, np.random.default_rng([11, seed]), catalogue), scenario.sensor


def places_of(telemetry):
    """Row and column of every identified star by frame, exposure and number."""
    columns = (telemetry.frame, telemetry.exposure, telemetry.star_id, telemetry.row_px, telemetry.col_px)
    return {(f, e, s): (row, col) for f, e, s, row, col in zip(*columns, strict=True) if s > 0}


@pytest.mark.parametrize("axis", ["rows", "columns"])
@pytest.mark.parametrize("line_time_s", [1.35e-4, -5e-5])
@pytest.mark.parametrize("parity", [1, -1])
def test_centroids_moved_back_are_those_of_a_global_shutter(catalogue, axis, line_time_s, parity):
    changes = {"centroid_sigma_px": 1e-6, "frames": 12, "false_stars": 0.0, "slew_rate_deg_s": 0.1}
    readout = Readout("rolling", line_time_s, axis)
    scenario = scene(readout, **changes)
    scenario = replace(scenario, sensor=replace(scenario.sensor, parity=parity))
    plain = replace(scenario, sensor=replace(scenario.sensor, readout=Readout("global")))
    rolling, still = (simulate(one, np.random.default_rng(5), catalogue) for one in (scenario, plain))
    rates = find_rates(rolling, scenario.sensor, catalogue, scenario.truth)
    moved, done = correct_readout(rolling, scenario.sensor, rates, scenario.truth)
    places, before, after = (places_of(one) for one in (still, rolling, moved))
    shared = places.keys() & before.keys()
    away = np.array([np.abs(np.subtract([*before[key], *after[key]], [*places[key], *places[key]])) for key in shared])
    assert len(away) > 100
    assert away[:, :2].max() > 0.5
    assert away[:, 2:].max() < 0.01  # a rate from two exposures a quarter of a second apart
    assert done.largest_px == pytest.approx(
        np.hypot(away[:, 0], away[:, 1]).max(), rel=0.15
    )  # of unidentified stars too
    assert (done.exposures, done.moved) == (24, 24)


def test_rates_are_those_of_a_turn_and_unknown_without_a_near_neighbour():
    w, t = np.array([2e-3, -1e-3, 5e-4]), np.array([0.0, 0.25, 40.0, 40.25, 80.0, 500.0])
    q = (Rotation.from_rotvec(w * t[:, None]) * Rotation.random(rng=np.random.default_rng(1))).as_quat()
    times = np.datetime64("2026-01-01", "us") + (t * 1e6).astype("timedelta64[us]")
    rates = compute_rates(q * np.sign(np.random.default_rng(2).normal(size=(6, 1))), times)
    np.testing.assert_allclose(rates[:5], np.tile(w, (5, 1)), rtol=1e-9)
    assert np.isnan(rates[5]).all()
    assert t[5] - t[4] > MOST_GAP_S
    assert np.isnan(compute_rates(q, np.full(6, np.datetime64("NaT", "us")))).all()
    assert np.isnan(compute_rates(q[:1], times[:1])).all()


def test_the_speed_of_a_star_is_its_rate_times_the_focal_length(catalogue):
    _, sensor = made(catalogue, frames=5)
    truth = st16_truth(1)
    at_centre = find_speed_px_s(sensor, truth, truth[1:2], truth[2:3], np.array([[0.0, 1e-3, 0.0]]))
    assert at_centre == pytest.approx(1e-3 * truth[0] / sensor.pixel_pitch_m, rel=0.01)


def errors(found, truth):
    d = np.array([found.parameters[name] for name in found.covariance.names]) - truth
    return d, float(d @ np.linalg.solve(np.array(found.covariance.matrix), d))


@pytest.mark.parametrize("match", ["rematch", pytest.param("given", marks=pytest.mark.full)])
def test_a_set_that_is_corrected_is_as_good_as_claimed_and_one_that_is_not_is_not_and_nothing_shows_it(
    catalogue, match
):
    n, truth = effort(2, 120), st16_truth(1)
    off, nees = [], {"quaternions": [], "stars": []}
    for seed in range(n):
        telemetry, sensor = made(catalogue, seed)
        settings = CalibrationSettings(match=match)
        blind = calibrate(telemetry, replace(sensor, readout=None), catalogue, settings)
        off.append(errors(blind, truth)[0][0] / truth[0] * 1e6)
        assert blind.chi2_per_dof == pytest.approx(1.0, abs=0.12)
        for source, given in (("quaternions", telemetry), ("stars", replace(telemetry, quaternion=None))):
            found = calibrate(given, sensor, catalogue, settings)
            assert source in found.assumptions[0].sentence
            # an exposure with too few stars for an attitude has no rate from them, and its neighbour has none either
            assert source == "stars" or not found.assumptions[0].left_in
            nees[source].append(errors(found, truth)[1])
    assert abs(np.mean(off)) > 700
    for values in nees.values():
        low, high = chi2.ppf([1e-3, 1 - 1e-3], 8 * n) / n
        assert low < np.mean(values) < high


def test_without_a_rate_the_readout_is_left_in_and_said(catalogue):
    telemetry, sensor = made(catalogue, frames=30)
    hourly = np.datetime64("2026-10-01", "us") + telemetry.frame.astype("timedelta64[h]")
    alone = replace(telemetry, time_utc=hourly, star_id=telemetry.star_id)
    rows = np.flatnonzero(telemetry.exposure == 0)
    picked = {name: getattr(alone, name)[rows] for name in vars(alone) if isinstance(getattr(alone, name), np.ndarray)}
    alone = replace(alone, **picked)
    assert find_rates(alone, sensor, catalogue, sensor.initial) is None
    found = calibrate(alone, sensor, catalogue, CalibrationSettings())
    assert found.assumptions[0].left_in
    assert put_right(alone, sensor, catalogue).row_px is alone.row_px


def test_a_large_file_is_corrected_as_a_set_in_memory_is(catalogue, tmp_path):
    telemetry, sensor = made(catalogue, frames=60)
    file = TelemetryFile(write_in_groups(telemetry, tmp_path, 100), large_rows=0, chunk_frames=20)
    settings = CalibrationSettings()
    whole = calibrate(telemetry, sensor, catalogue, settings)
    pieces = calibrate(file, sensor, catalogue, settings, scratch_folder=tmp_path)
    for name, sigma in whole.sigma.items():
        assert pieces.parameters[name] == pytest.approx(whole.parameters[name], abs=0.1 * sigma)
    assert "quaternions" in pieces.assumptions[0].sentence


def test_directions_of_j2000_become_apparent_ones(catalogue):
    scenario = calibration_scenario(1, 30)
    telemetry = simulate(scenario, np.random.default_rng(3), catalogue)
    named = telemetry.star_id > 0
    index = catalogue.find_index(np.where(named, telemetry.star_id, catalogue.hip[0]))
    years = 2000.0 - 1991.25
    ra = catalogue.ra_rad[index] + years * catalogue.pm_ra_cosdec_rad_yr[index] / np.cos(catalogue.dec_rad[index])
    dec = catalogue.dec_rad[index] + years * catalogue.pm_dec_rad_yr[index]
    given = replace(telemetry, ra_rad=np.where(named, ra, np.nan), dec_rad=np.where(named, dec, np.nan))
    right = to_apparent(given, catalogue)
    expected = apparent_directions(catalogue, index, telemetry.time_utc, telemetry.velocity_m_s)
    found = np.stack(
        [
            np.cos(right.dec_rad) * np.cos(right.ra_rad),
            np.cos(right.dec_rad) * np.sin(right.ra_rad),
            np.sin(right.dec_rad),
        ],
        axis=-1,
    )
    assert np.nanmax(np.linalg.norm(found - expected, axis=1)[named]) < 1e-8
    assert np.isnan(found[~named]).all()
    # a star that the catalogue does not have has aberration alone, within its motion of the other
    unknown = to_apparent(replace(given, star_id=np.where(named, 10**7 + telemetry.star_id, 0)), catalogue)
    assert 1e-6 < np.nanmax(np.abs(unknown.dec_rad - right.dec_rad)) < 3e-3
    with pytest.raises(RefusedInputError, match="add time_utc"):
        to_apparent(replace(given, time_utc=None), catalogue)
    declared = replace(scenario.sensor, declared=Declared("given", "j2000", "none"))
    settings = CalibrationSettings(match="given")
    plain = calibrate(telemetry, scenario.sensor, catalogue, settings)
    from_j2000 = calibrate(given, declared, catalogue, settings)
    for name, sigma in plain.sigma.items():
        assert from_j2000.parameters[name] == pytest.approx(plain.parameters[name], abs=0.05 * sigma)
    assert "J2000.0" in from_j2000.assumptions[2].value


def test_nothing_is_touched_where_nothing_is_declared_to_be_wrong(catalogue):
    telemetry, sensor = made(catalogue, frames=5, readout=Readout("rolling", 1e-4, corrected=True))
    assert Corrections(sensor, catalogue).apply(telemetry) is telemetry


def test_every_assumption_says_whether_it_was_declared_and_what_an_error_would_do(catalogue):
    telemetry, sensor = made(catalogue, frames=40, readout=None)
    undeclared = replace(sensor, declared=NOTHING_DECLARED)
    found = calibrate(replace(telemetry, velocity_m_s=None), undeclared, catalogue, CalibrationSettings())
    assert [(one.name, one.declared) for one in found.assumptions] == [
        ("readout", False), ("satellite_velocity", False), ("directions", True), ("decentring", False),
        ("centroids", False), ("refraction", False),
    ]  # fmt: skip
    assert "px" in found.assumptions[0].sentence
    assert all("sensor file" in one.sentence for one in found.assumptions if not one.declared)
    declared = replace(
        sensor,
        readout=Readout("global"),
        declared=Declared("given", "apparent", "uncorrected", None, "centred", "unbiased"),
    )
    made_of = {one.name: one for one in calibrate(telemetry, declared, catalogue, CalibrationSettings()).assumptions}
    assert all(one.declared for one in made_of.values())
    assert [name for name, one in made_of.items() if one.left_in] == ["refraction"]


def test_a_tilt_is_asked_of_a_camera_that_has_none_for_it_is_fitted_as_principal_point(catalogue):
    scenario = calibration_scenario(1, 60)
    sensor = replace(
        scenario.sensor, camera_model="pinhole_radial", free=("f_m", "u0_px", "v0_px"),
        initial=np.array([1.0, 0.016, 1296.0, 972.0, 0.0, 0.0]), typical_sigma=np.array([2e-4, 8e-6, 10.0, 10.0, 1e-2, 0.1]),
    )  # fmt: skip
    camera, rng = CAMERA_MODELS["pinhole_radial"], np.random.default_rng(1)
    n, a, f_px = 2400, 1e-3, 0.016 / sensor.pixel_pitch_m
    row, col = rng.uniform(0, sensor.rows - 1, n), rng.uniform(0, sensor.columns - 1, n)
    from_axis = np.stack([row - 972.0, col - 1296.0], axis=1)
    seen = np.stack([row, col], axis=1) + a * from_axis * from_axis[:, :1] / f_px  # tilted about the columns
    s = camera.directions(sensor.initial, row, col, sensor.pixel_pitch_m)
    turns = Rotation.random(n // 12, rng=rng).as_matrix()
    s_i = np.einsum("eij,enj->eni", turns, s.reshape(-1, 12, 3)).reshape(-1, 3)
    inside = (seen >= 0).all(axis=1) & (seen < [sensor.rows, sensor.columns]).all(axis=1)
    noise = 0.01 * rng.normal(size=(2, inside.sum()))
    telemetry = Telemetry(
        frame=np.repeat(np.arange(n // 12), 12)[inside], exposure=np.zeros(inside.sum(), int),
        row_px=seen[inside, 0] + noise[0], col_px=seen[inside, 1] + noise[1],
        star_id=np.arange(1, n + 1)[inside],
        ra_rad=np.arctan2(s_i[inside, 1], s_i[inside, 0]) % (2 * np.pi), dec_rad=np.arcsin(s_i[inside, 2]),
    )  # fmt: skip
    settings = CalibrationSettings(match="given")
    found = calibrate(telemetry, replace(sensor, centroid_sigma_px=0.01), catalogue, settings)
    assert abs(found.parameters["v0_px"] - 972.0) == pytest.approx(a * f_px, rel=0.1)  # 7.3 px
    assert abs(found.parameters["u0_px"] - 1296.0) < 0.3
    (tilt,) = (one for one in found.assumptions if one.name == "tilt")
    assert not tilt.declared
    assert "7.3 px" in tilt.sentence
    said = replace(sensor, centroid_sigma_px=0.01, declared=Declared(tilt="aligned"))
    (declared,) = (one for one in calibrate(telemetry, said, catalogue, settings).assumptions if one.name == "tilt")
    assert declared.declared


def test_a_centred_lens_is_assumed_aloud_where_tangential_distortion_that_matters_would_go_unnoticed(catalogue):
    telemetry, declared = made(catalogue, readout=Readout("global"), frames=40)
    sensor = replace(declared, declared=replace(declared.declared, decentring=None))
    found = calibrate(telemetry, sensor, catalogue, CalibrationSettings(match="given"))
    unseen = next(one for one in found.trust.unseen if one.name == "tangential")
    assert unseen.sigmas > 3
    (asked,) = (one for one in found.assumptions if one.name == "decentring")
    assert (asked.declared, asked.value) == (False, "none")
    assert unseen.parameter in asked.sentence
    said = calibrate(telemetry, declared, catalogue, CalibrationSettings(match="given")).assumptions
    assert next(one for one in said if one.name == "decentring").declared


def test_a_seam_that_no_test_sees_leaves_the_gate_of_assumptions_without_data_until_centroids_are_declared(catalogue):
    telemetry, declared = made(catalogue, readout=Readout("global"), frames=100)
    sensor = replace(declared, declared=replace(declared.declared, centroids=None))
    seamed = replace(telemetry, row_px=telemetry.row_px + 0.2 * (telemetry.row_px > sensor.rows / 2))
    found = calibrate(seamed, sensor, catalogue, CalibrationSettings(match="given"))
    assert [one.name for one in found.tests if one.noticed] == []
    (asked,) = (one for one in found.assumptions if not one.declared)
    assert asked.name == "centroids"
    most = max((one for one in found.trust.unseen if one.name != "tangential"), key=lambda one: one.sigmas)
    assert most.sigmas > 3
    assert most.parameter in asked.sentence
    assert next(one for one in found.trust.unseen if one.name == "seam").size_px > 0.2

    again = calibrate(seamed, declared, catalogue, CalibrationSettings(match="given"))
    gates = [next(gate for gate in assess(one, sensor).gates if gate.name == "assumptions") for one in (found, again)]
    assert [gate.status for gate in gates] == ["NO-DATA", "PASS"]


@pytest.mark.parametrize(
    ("sigmas", "value"), [((2.9, 0.4), "would be detected"), ((2.9, 3.1), "unbiased"), ((), "unbiased")]
)
def test_centroids_need_no_word_where_whatever_matters_would_be_noticed_and_none_is_known_of_a_small_set(
    sigmas, value, catalogue
):
    telemetry, sensor = made(catalogue, frames=3)
    sensor = replace(sensor, declared=replace(sensor.declared, centroids=None))
    found = {"tangential": 50.0, **dict(zip(("lens", "seam"), sigmas, strict=False))}  # a decentred lens is asked apart
    unseen = [UnseenDeparture(name=name, size_px=0.2, parameter="f_m", sigmas=far) for name, far in found.items()]
    said = list_assumptions(telemetry, telemetry, sensor, catalogue, sensor.initial, ReadoutCorrection(), unseen)
    (one,) = (one for one in said if one.name == "centroids")
    assert (one.value, one.declared) == (value, value == "would be detected")
    assert ("too small" in one.sentence) == (not sigmas)


def test_a_scenario_keeps_its_readout_and_slew():
    document = scenario_document(scene(slew_rate_deg_s=0.2))
    again = parse_scenario(document)
    assert (again.sensor.readout, again.slew_rate_deg_s) == (ROLLING, 0.2)
    assert scenario_document(again) == document
    with pytest.raises(RefusedInputError, match="slew_rate_deg_s"):
        parse_scenario({"sensor": 1, "slew_rate_deg_s": 100})
