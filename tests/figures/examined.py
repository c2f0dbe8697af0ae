"""Handmade parts of a result with every key of the contract: trust, matching and shadow, for figures, report and pages."""

import numpy as np

from boresight.figures.example_calibration import get_example_calibrations

NAMES = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")
FLAGS = {3: ["double"], 7: ["solution type"]}


def grid(rng, offset, spread):
    rows, cols = np.linspace(0, 1943, 15), np.linspace(0, 2591, 20)
    radius = np.hypot(*np.meshgrid(rows - 972, cols - 1296, indexing="ij")) / 1620
    return rows.tolist(), cols.tolist(), offset + spread * (radius**3 + 0.1 * rng.normal(size=radius.shape))


def bins(rng, low, high, unit):
    count = rng.poisson(300, 8)
    rms = rng.uniform(0.09, 0.11, 8)
    mean = rng.normal(size=8) * rms / np.sqrt(count)
    return {
        "edges": np.linspace(low, high, 9).tolist(),
        "mean_px": mean.tolist(),
        "sigma_of_mean_px": (rms / np.sqrt(count)).tolist(),
        "rms_px": rms.tolist(),
        "count": count.tolist(),
        "even": True,
        "sentence": "The radial residual does not depend on it, as far as the noise lets one see.",
        "unit": unit,
    }


def stars(rng, n_stars=40):
    z = np.sort(np.abs(rng.normal(size=n_stars)))[::-1]
    z[:2] = (9.1, 5.2)
    sightings = rng.integers(5, 200, n_stars)
    return [
        {
            "star_id": 1000 + 17 * i,
            "sightings": int(sightings[i]),
            "mean_residual_px": float(abs(z[i]) * 0.1 / np.sqrt(sightings[i])),
            "rms_px": float(rng.uniform(0.08, 0.13)),
            "z": float(z[i]),
            "suspect": i < 2,
            "flags": FLAGS.get(i, []),
        }
        for i in range(n_stars)
    ]


def nis_over_time(rng, n_frames):
    nis = rng.chisquare(19, n_frames) / 19
    lower, upper = 0.469, 1.729
    return {
        "frame": list(range(n_frames)),
        "nis_per_dof": nis.tolist(),
        "lower": [lower] * n_frames,
        "upper": [upper] * n_frames,
        "outside_share": float(np.mean((nis < lower) | (nis > upper))),
        "expected_share": 0.05,
        "consistent": True,
        "sentence": "As many frames are outside their bounds as chance alone puts there.",
    }


def residuals(rng, n_stars):
    row, col = rng.uniform(0, 1943, n_stars), rng.uniform(0, 2591, n_stars)
    noise = 0.1 * rng.normal(size=(2, n_stars))
    return {
        "row_px": row.tolist(),
        "col_px": col.tolist(),
        "d_row_px": (noise[0] + 0.15 * (row < 200)).tolist(),
        "d_col_px": noise[1].tolist(),
        "star_id": rng.integers(1, 100_000, n_stars).tolist(),
        "frame": rng.integers(0, 200, n_stars).tolist(),
    }


def residual_field(rng, edge_px=0.1):
    shape = (12, 16)
    sigma = 0.1 / np.sqrt(40)

    def side(wrong):
        return {
            "count": np.full(shape, 40).tolist(),
            "mean_row_px": (sigma * rng.normal(size=shape) + wrong).tolist(),
            "mean_col_px": (sigma * rng.normal(size=shape)).tolist(),
            "sigma_row_px": np.full(shape, sigma).tolist(),
            "sigma_col_px": np.full(shape, sigma).tolist(),
            "rms_px": rng.uniform(0.09, 0.11, shape).tolist(),
            "rms_in_all_px": float(np.hypot(0.1, np.std(wrong))),
            "chi2": 380.0,
            "dof": 384,
            "p": 0.5,
        }

    after = np.zeros(shape)
    after[0] = edge_px
    return {
        "row_edges_px": np.linspace(-0.5, 1943.5, 13).tolist(),
        "col_edges_px": np.linspace(-0.5, 2591.5, 17).tolist(),
        "frames_used": 200,
        "even": True,
        "sentence": "What is left has no pattern over the detector that the noise lets one see.",
        "before": side(np.linspace(-3, 3, 12)[:, None] * np.ones(16)),
        "after": side(after),
    }


def residual_distribution(rng, n=4000):
    z, normal = rng.normal(size=n), np.linspace(-3, 3, 61)
    edges = np.linspace(-6, 6, 49)
    return {
        "edges": edges.tolist(),
        "before": {"counts": np.histogram(10 * z, edges)[0].tolist(), "below": 1000, "above": 1010},
        "after": {"counts": np.histogram(z, edges)[0].tolist(), "below": 0, "above": 0},
        "normal": normal.tolist(),
        "quantile": (normal * 1.01).tolist(),
        "sigma_of_quantile": (0.02 * np.exp(normal**2 / 5)).tolist(),
        "count": n,
        "mean": 0.01,
        "sigma": 1.01,
        "spread": 1.0,
        "beyond_share": 0.0028,
        "expected_share": 0.0027,
        "p_tail": 0.8,
        "normal_tails": True,
        "sentence": "The tails are those of the normal curve.",
    }


def residual_outliers(rng, n=5):
    return {
        "frame": rng.integers(0, 200, n).tolist(),
        "exposure": [0] * n,
        "star_id": rng.integers(1, 100_000, n).tolist(),
        "row_px": rng.uniform(0, 1943, n).tolist(),
        "col_px": rng.uniform(0, 2591, n).tolist(),
        "d_row_px": [0.5] * n,
        "d_col_px": [0.0] * n,
        "normalised": np.linspace(6, 4.1, n).tolist(),
        "rows": 1944,
        "columns": 2592,
        "limit": 4.0,
        "stars_in_all": 4466,
        "in_all": n,
        "expected": 0.6,
        "sentence": f"{n} of 4466 matched stars lie beyond 4 sigmas of their residual; chance puts 0.6 there.",
    }


def drop_one():
    worth = dict(zip(NAMES, (9.5e4, 3.0e3, 4.1e3, 55.0, 920.0, 310.0, 2.0, 260.0), strict=True))
    return [
        {
            "name": name,
            "chi2_increase": rise,
            "rms_arc_rad": 82.6e-6 * (1 + 1e-5 * rise),
            "shift_in_sigma_of_others": float(np.sqrt(rise)),
            "needed": rise > 6.63,
        }
        for name, rise in worth.items()
    ]


def trust(sigma, n_frames=200, seed=6):
    rng = np.random.default_rng(seed)
    rows, cols, arc_sigma = grid(rng, 0.3, 0.4)
    further = [0, 50, 100, 200, 400, 800, 1600]
    return {
        "arc_sigma_map": {"row_px": rows, "col_px": cols, "sigma_arcsec": np.abs(arc_sigma).tolist(), "arc_deg": 4.0},
        "two_halves": {
            "names": list(NAMES),
            "difference_in_sigma": rng.normal(size=8).tolist(),
            "chi2": {"value": 6.1, "dof": 8, "lower": 2.2, "upper": 17.5, "consistent": True},
            "map": {"row_px": rows, "col_px": cols, "difference_arcsec": grid(rng, -0.2, 0.5)[2].tolist()},
            "sentence": "The two halves agree within their uncertainty.",
        },
        "efficiency": {
            "names": list(NAMES),
            "cramer_rao_sigma": {name: sigma[name] / 1.03 for name in NAMES},
            "ratio": dict.fromkeys(NAMES, 1.03),
            "overall_ratio": 1.02,
            "sentence": "The claimed sigmas are within 3 % of the Cramér-Rao bound.",
        },
        "more_data": {
            "frames": 200,
            "further_frames": further,
            "sigma": {name: [float(sigma[name] * np.sqrt(200 / (200 + n))) for n in further] for name in NAMES},
            "sentence": "Four times the frames would halve every sigma.",
        },
        "drop_one": drop_one(),
        "drop_one_sentence": "The tilt a2 is not needed by these data.",
        "nis_over_time": nis_over_time(rng, n_frames),
        "whiteness": {
            "lags": list(range(1, 21)),
            "autocorrelation": (0.07 * rng.normal(size=20)).tolist(),
            "bound": 0.139,
            "name": "f_m",
            "ljung_box": {"value": 18.2, "dof": 20, "p": 0.57},
            "white": True,
            "sentence": "The residuals of different frames are independent.",
        },
        "stars": stars(rng),
        "suspects": [1000, 1017],
        "stars_sentence": "2 of 412 stars stand beside their catalogue places: flag them, or leave them out.",
        "stars_in_all": 412,
        "residual_against": {
            "radius": bins(rng, 0, 1600, "px"),
            "magnitude": bins(rng, 1.5, 6.0, "mag"),
            "temperature": None,
            "time": bins(rng, 0, 86_400, "s"),
        },
        "residuals": residuals(rng, min(2000, 10 * n_frames)),
        "residual_field": residual_field(np.random.default_rng(9)),
        "residual_distribution": residual_distribution(np.random.default_rng(10)),
        "residual_outliers": residual_outliers(np.random.default_rng(11)),
        "worst_frames": get_example_calibrations()["filter"]["trust"]["worst_frames"],
        "unavailable": {"residual_against.temperature": "The telemetry has no temperatures."},
    }


def frame_observability(n_frames=120):
    rng = np.random.default_rng(8)
    levels = {
        "model_1": 1.5e-5, "model_2": 1.3e-5, "model_3": 6.6e-6, "model_4": 6.3e-6,
        "sigma_1": 2.5e-7, "sigma_2": 2.2e-6, "sigma_3": 1.9e-6,
    }  # fmt: skip
    shares = {
        "arcs": 0.99, "angular": 0.99, "model_1": 0.98, "model_2": 0.98, "model_3": 0.97, "model_4": 0.91,
        "sigma_1": None, "sigma_2": 0.59, "sigma_3": 0.31, "sigma_123": 0.91,
    }  # fmt: skip
    return {
        "frame": list(range(n_frames)),
        "frames_used": n_frames,
        "frames": 200,
        "minimum_singular_value": {
            name: [None if k % 10 == 7 else float(level * rng.uniform(0.5, 2)) for k in range(n_frames)]
            for name, level in levels.items()
        },
        "information": [
            {
                "reference": name,
                "share": share,
                "least_share": share and share - 0.02,
                "least": share and "m0_px",
            }
            for name, share in shares.items()
        ],
        "sentence": "Of the information in these centroids arcs keep 99 %; σ1 adds nothing to them.",
    }


def matching():
    return {
        "given": 2233,
        "kept": 2201,
        "added": 2265,
        "removed": 32,
        "matched": 4466,
        "cycles": [
            {"cycle": 1, "matched": 4401, "changed": 2297, "rms_arc_rad": 84.1e-6},
            {"cycle": 2, "matched": 4466, "changed": 65, "rms_arc_rad": 82.6e-6},
            {"cycle": 3, "matched": 4466, "changed": 0, "rms_arc_rad": 82.6e-6},
        ],
        "rested": True,
        "tolerance_px": {"median": 0.62, "p95": 1.4},
        "row_reasons": {"no catalogue star is near": 61, "two catalogue stars are near": 12},
        "removed_reasons": {"two catalogue stars are near": 32},
        "renamed": 0,
        "exposure_reasons": {"valid": 398, "fewer than three stars matched": 2},
        "starts": {"given matches": 371, "other exposure": 24, "neighbouring frame": 5},
        "flagged": {"doubles": 41, "unreliable": 3, "left_out": 0},
        "flight": {
            "tolerance_rad": 4.2e-4,
            "availability": {"initial": 0.46, "final": 1.0},
            "matched_stars": {"initial": 1650, "final": 4460},
        },
    }


def shadow(n_frames=40, lost=(7,), gained=(1, 2, 3)):
    def side(valid, matched):
        return {"valid": valid, "matched": matched if valid else 0, "reason": None if valid else "too few stars"}

    frames = [
        {
            "frame": k,
            "time_utc": None,
            "baseline": side(k not in gained, 4 + k % 9),
            "candidate": side(k not in lost, 12 + k % 9),
            "lost": [1, 2] if k in lost else [],
            "gained": [3],
        }
        for k in range(n_frames)
    ]
    sentence = "The candidate solves 3 frames that the baseline loses, and loses 1."
    summary = {"baseline_only": len(lost), "candidate_only": len(gained), "sentence": sentence}
    return {"calibration": None, "validation": {"frames": frames, "frames_in_set": n_frames, "summary": summary}}
