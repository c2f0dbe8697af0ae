"""Handmade calibration JSONs with every key of the contract: figures are tested without running an estimator."""

import numpy as np
import pytest

from tests.figures.examined import frame_observability, matching, shadow, trust

NAMES = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")
INITIAL = (0.016, 972.0, 1296.0, 1.2e8, -2.1e3, 0.001, -0.002, 1.0)
TYPICAL = (3.2e-5, 30.0, 25.0, 1.0e8, 1.0e3, 0.004, 0.004, 2.0e-4)
SHIFT = (-9.46, 0.39, 8.08, 0.67, -0.90, 3.58, -0.10, 2.97)
SENTENCE = (
    "m0 and a2 move together: the combination +0.72 m0, +0.69 a2 (typical sigmas) is known to 0.41 typical sigmas."
)


def named(values):
    return dict(zip(NAMES, (float(value) for value in values), strict=True))


def ending(rng):
    typical = np.array(TYPICAL)
    sigma = typical / np.array([120.0, 2.5, 2.8, 9.0, 11.0, 2.2, 2.0, 30.0])
    truth = np.array(INITIAL) + np.array(SHIFT) * typical
    final = truth + sigma * rng.normal(size=8)
    vectors, _ = np.linalg.qr(rng.normal(size=(8, 8)))
    singular = np.geomspace(300.0, 2.0, 8)
    radius = np.linspace(0.0, 1620.0, 82)
    change = 2e-9 * radius**3 - 0.015 * radius
    edges = np.linspace(0.0, 1500.0, 26)
    return {
        "schema": "boresight.calibration/1",
        "sensor": "ST16-4",
        "variant": "no-q",
        "camera_model": "inverted_wang",
        "free": list(NAMES),
        "parameters": named(final),
        "initial": named(INITIAL),
        "sigma": named(sigma),
        "typical_sigma": named(typical),
        "truth": named(truth),
        "units": dict(zip(NAMES, ("m", "px", "px", "m⁻⁴", "m⁻²", "rad", "rad", "1"), strict=True)),
        "symbols": dict(zip(NAMES, ("f", "m0", "n0", "b4", "b2", "a1", "a2", "g_y"), strict=True)),
        "delta_over_sigma": named((final - np.array(INITIAL)) / sigma),
        "covariance": {"names": list(NAMES), "matrix": np.diag(sigma**2).tolist()},
        "status": "converged",
        "advice": ["The principal point and the tilts trade against each other: do not read them one by one."],
        "iterations": 7,
        "frames": 200,
        "exposures": 400,
        "stars": 4466,
        "pairs": 7732,
        "rms_arc_rad": {"initial": 412.9e-6, "final": 82.6e-6},
        "chi2_per_dof": 1.01,
        "chi2": {"value": 7800.0, "dof": 7724, "lower": 7482.0, "upper": 7970.0, "consistent": True},
        "nis": {"mean": 19.1, "dof": 19.0, "lower": 18.2, "upper": 19.9, "consistent": True},
        "observability": {
            "singular_values": singular.tolist(),
            "condition_number": 150.0,
            "right_singular_vectors": vectors.T.tolist(),
            "parameter_names": list(NAMES),
            "sigma_of_direction": (1 / singular).tolist(),
            "weakest": {"direction": named(vectors[:, -1]), "sentence": SENTENCE},
        },
        "radial": {
            "radius_px": radius.tolist(),
            "difference_px": change.tolist(),
            "difference_arcsec": (change * 28.3).tolist(),
            "sigma_px": (0.02 + 4e-10 * radius**3).tolist(),
            "sigma_arcsec": ((0.02 + 4e-10 * radius**3) * 28.3).tolist(),
            "displacement_px": {"initial": (-3e-9 * radius**3).tolist(), "final": (change - 3e-9 * radius**3).tolist()},
            "data_radius_px": 1440.0,
            "counts": {"edges_px": edges.tolist(), "stars": rng.poisson(np.linspace(20, 330, 25)).tolist()},
        },
        "coverage": {
            "row_edges_px": np.linspace(-0.5, 1943.5, 10).tolist(),
            "col_edges_px": np.linspace(-0.5, 2591.5, 13).tolist(),
            "counts": np.where(rng.random((9, 12)) < 0.05, 0, rng.poisson(40, (9, 12))).tolist(),
        },
        "validation": {
            "rms_arc_rad": {"initial": 415.1e-6, "final": 84.9e-6},
            "availability": {"initial": 0.46, "final": 1.0},
            "matched_star_ratio": 2.7,
            "frames": 80,
        },
        "frame_observability": frame_observability(),
        "trust": trust(named(sigma)),
        "matching": matching(),
        "shadow": shadow(),
        "timing_s": {"read": 0.1, "fit": 0.9, "method": 0.4},
        "inputs": {
            "sha256s": {"telemetry": "ab" * 32, "sensor": "cd" * 32},
            "versions": {"boresight": "0.1.0", "numpy": "2.4.0"},
            "settings": {"method": "sqrf", "variant": "no-q", "free": None},
        },
    }


def sequential(n_frames=200, seed=4):
    rng = np.random.default_rng(seed)
    result = ending(rng)
    typical, k = np.array(TYPICAL), np.arange(1, n_frames + 1)[:, None]
    final_sigma = np.array(list(result["sigma"].values()))
    sigma = np.minimum(10 * typical, final_sigma * np.sqrt(n_frames / k))
    wander = np.cumsum(rng.normal(size=(n_frames, 8)), axis=0) / np.maximum(k, 1) ** 0.9
    value = np.array(list(result["parameters"].values())) + sigma * (wander - wander[-1])
    tail = 82.6e-6 + 300e-6 / k[:, 0] ** 1.3
    return result | {
        "method": "sqrf",
        "trace": None,
        "history": {
            "frame": list(range(n_frames)),
            "parameters": value.tolist(),
            "sigma": sigma.tolist(),
            "tail_rms_rad": tail.tolist(),
            "aggregate_rms_rad": (80e-6 + 120e-6 / k[:, 0]).tolist(),
            "nis": rng.chisquare(19, n_frames).tolist(),
            "nis_dof": [19] * n_frames,
            "time_utc": None,
        },
    }


def batch(seed=5, n_iterations=7):
    result = ending(np.random.default_rng(seed))
    final, sigma = (np.array(list(result[key].values())) for key in ("parameters", "sigma"))
    weight = (0.5 ** np.arange(n_iterations + 1) ** 2)[:, None]
    rms = 82.6e-6 + 330e-6 * weight[:, 0]
    return result | {
        "method": "batch",
        "nis": None,
        "history": None,
        "trace": {
            "iteration": list(range(n_iterations + 1)),
            "parameters": (final + weight * (np.array(INITIAL) - final)).tolist(),
            "sigma": np.tile(sigma, (n_iterations + 1, 1)).tolist(),
            "cost": (3900 + 1e6 * weight[:, 0]).tolist(),
            "damping": (1e-3 * 0.1 ** np.arange(n_iterations + 1)).tolist(),
            "rms_arc_rad": rms.tolist(),
        },
    }


@pytest.fixture(scope="session")
def sequential_result():
    return sequential()


@pytest.fixture(scope="session")
def batch_result():
    return batch()
