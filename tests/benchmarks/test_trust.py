"""The simulations of faults are right by other forms, and each fault changes what it says and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.trust import measure as part
from benchmarks.trust.faults import BY_NAME, CASES, FAULTS
from benchmarks.trust.measure import Answer, fit_likelihood, measure, notices
from benchmarks.trust.scenes import PINHOLE, ST16, quaternions, simulate, turns
from benchmarks.trust.tables import render
from boresight.cameras import CAMERA_MODELS
from boresight.sky.catalogue import load_catalogue
from boresight.sky.directions import star_directions

FRAMES = 6


@pytest.fixture
def scene():
    return simulate(ST16, FRAMES, np.random.default_rng(1))


@pytest.mark.parametrize("optics", [ST16, PINHOLE], ids=lambda optics: optics.camera)
def test_the_cameras_of_the_simulation_are_the_product_s(optics):
    row, col = (at.ravel() for at in np.meshgrid(*(np.linspace(1, size, 9) for size in optics.size)))
    s = CAMERA_MODELS[optics.camera].directions(optics.x, row, col, optics.pitch_m)
    np.testing.assert_allclose(optics.forward(optics.x, s), [row, col], atol=1e-6)


def test_rotations_and_quaternions_are_scipy_s():
    w = np.random.default_rng(2).normal(size=(50, 3))
    C = Rotation.from_quat(quaternions(turns(w)))
    np.testing.assert_allclose(C.as_matrix(), turns(w), atol=1e-12)
    np.testing.assert_allclose(turns(w[:1] * 1e-2), Rotation.from_rotvec(w[:1] * 1e-2).as_matrix(), atol=1e-9)


def test_told_directions_and_attitudes_put_every_star_where_it_is_measured_but_for_noise(scene):
    told = scene.telemetry()
    ra, dec = np.radians(told["ra_deg"]), np.radians(told["dec_deg"])
    s_i = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    q = np.column_stack([told[name] for name in ("q_x", "q_y", "q_z", "q_w")])
    row, col = ST16.forward(ST16.x, Rotation.from_quat(q).apply(s_i))
    np.testing.assert_allclose(np.column_stack([told["row_px"] - row, told["col_px"] - col]), scene.noise_px, atol=1e-6)


def test_the_catalogue_s_directions_at_the_told_time_and_velocity_are_those_that_were_seen(scene):
    told = scene.telemetry()
    velocity = 1e3 * np.column_stack([told[name] for name in ("vx_km_s", "vy_km_s", "vz_km_s")])
    s = star_directions(told["star_id"], None, None, told["time_utc"], velocity, load_catalogue(None))
    np.testing.assert_allclose(s, scene.s_i, atol=5e-6)  # parallaxes of near stars: a twenty-fifth of a pixel


def test_the_maximum_likelihood_fit_is_scipy_s_over_attitudes_and_parameters():
    scene = simulate(replace(PINHOLE, noise_px=0.1), 4, np.random.default_rng(3))
    scale = np.array(list(PINHOLE.typical_sigma.values()))
    n, measured = len(scale), scene.measured_px()

    def residuals(z):
        C = turns(z[n:].reshape(-1, 3))[scene.exposure_of]
        place = np.stack(scene.optics.forward(PINHOLE.x + z[:n] * scale, np.einsum("nij,nj->ni", C, scene.s)), axis=1)
        return ((measured - place) / 0.1).ravel()

    found = least_squares(
        residuals, np.zeros(n + 3 * len(scene.attitude)), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    x, information, chi2 = fit_likelihood(scene)
    scaled = information * np.outer(scale, scale)
    off = (x - PINHOLE.x) / scale - found.x[:n]
    assert off @ scaled @ off < 1e-4
    assert chi2 == pytest.approx(2 * found.cost, abs=1e-4)


def test_there_are_thirty_faults_besides_the_cases_each_at_three_rising_strengths():
    assert len(FAULTS) == 30
    assert len(BY_NAME) == len(CASES) + len(FAULTS)
    assert all(len(set(fault.strengths)) == 3 for fault in FAULTS)
    assert all(list(map(abs, fault.strengths)) == sorted(map(abs, fault.strengths)) for fault in FAULTS)


@pytest.mark.parametrize("name", BY_NAME)
def test_a_fault_changes_what_is_told_and_the_clean_set_stays_as_it_was(name):
    fault = BY_NAME[name]
    scene = simulate(fault.optics, fault.frames or FRAMES, np.random.default_rng(4), fault.exposures)
    before = {key: np.array(column) for key, column in scene.telemetry().items()}
    wrong = fault.change(scene, fault.strengths[-1], np.random.default_rng(5)).telemetry()
    changed = [key for key in wrong if key not in before or not np.array_equal(wrong[key], before[key])]
    assert bool(changed) == (name not in {"one_quarter", "sparse"})
    assert all(np.array_equal(column, before[key]) for key, column in scene.telemetry().items())
    assert all(len(column) == len(wrong["frame"]) for column in wrong.values())
    if "ra_deg" in wrong:
        size = np.array(fault.optics.size)
        off = np.maximum(
            -np.column_stack([wrong["row_px"], wrong["col_px"]]),
            np.column_stack([wrong["row_px"], wrong["col_px"]]) - size,
        )
        assert np.mean(off.max(axis=1) > 0) < 0.05


def test_only_what_the_clean_set_does_not_tell_is_noticed():
    clean = Answer(
        "converged",
        advice=("a",),
        tests=frozenset({"time"}),
        gates={"chi-square": "PASS", "assumptions": "NO-DATA"},
        level="caution",
    )
    assert notices(clean, clean) == {}
    told = replace(
        clean,
        advice=("a", "b"),
        tests=frozenset({"time", "colour"}),
        gates={"chi-square": "FAIL"},
        removed=2,
        level="serious",
    )
    assert notices(told, clean) == {
        "advice": ["b"], "tests": ["colour"], "gates": ["chi-square FAIL"], "verdict": ["serious"], "removed": ["stars"],
    }  # fmt: skip


def test_the_part_measures_a_clean_set_a_case_and_a_fault():
    found = measure(
        lambda *_: None, clean_sets=1, case_sets=1, fault_sets=1, frames=12, names=("tangential", "sigma_stated")
    )
    assert found["clean"]["methods"].keys() == part.METHODS.keys()
    assert found["clean"]["methods"]["batch"]["over_likelihood"] == pytest.approx(1, abs=0.2)
    case, *_, strong = found["rows"]
    assert (case["name"], strong["name"]) == ("tangential", "sigma_stated")
    assert case["shift"] > 1
    assert strong["noticed"]
    assert strong["gates"]
    page = render(found)
    assert all(words in page for words in ("1 clean sets", "Known cases", "1 faults", "noise above the stated"))


@pytest.mark.full
def test_on_clean_sets_batch_and_filter_err_as_maximum_likelihood_does_and_claim_what_they_err():
    found = measure(lambda *_: None, clean_sets=200, case_sets=0, fault_sets=0, names=("none",))["clean"]
    for one in found["methods"].values():
        low, _ = one["over_likelihood_interval"]
        assert low < 1.01
        assert abs(one["nees"] - one["parameters"]) < 4 * one["nees_sigma"]
