"""Calibrations with every member: the stored example, and what it happens not to have (doubts, gaps, long histories)."""

import numpy as np

from boresight.calibration.calibration import parse_calibration
from boresight.figures.example_calibration import get_example_calibrations

EXAMPLE = get_example_calibrations()["filter"].to_dict()
FLAGS = {3: ["double"], 7: ["solution type"]}


def nis_over_time(rng, n_frames):
    nis = rng.chisquare(19, n_frames) / 19
    bounds = {"lower": [0.469] * n_frames, "upper": [1.729] * n_frames}
    found = {"frame": list(range(n_frames)), "nis_per_dof": nis.tolist(), "points_in_all": n_frames}
    return EXAMPLE["trust"]["nis_over_time"] | found | bounds


def residual_field(edge_sigmas=10):
    """What is left is off by so many sigmas in the first row of cells."""
    field = EXAMPLE["trust"]["residual_field"]
    after = field["after"]
    edge = [None if sigma is None else edge_sigmas * sigma for sigma in after["sigma_row_px"][0]]
    return field | {"after": after | {"mean_row_px": [edge, *after["mean_row_px"][1:]]}}


def residual_outliers(rng, n=5):
    """More of them than the example's, which has none."""
    places = {"row_px": rng.uniform(0, 1943, n).tolist(), "col_px": rng.uniform(0, 2591, n).tolist()}
    whose = {"frame": rng.integers(0, 200, n).tolist(), "star_id": rng.integers(1, 100_000, n).tolist()}
    size = {"d_row_px": [0.5] * n, "d_col_px": [0.0] * n, "normalised": np.linspace(6, 4.1, n).tolist()}
    return EXAMPLE["trust"]["residual_outliers"] | places | whose | size | {"exposure": [0] * n, "in_all": n}


def trust(n_frames=200, seed=6):
    rng, found = np.random.default_rng(seed), EXAMPLE["trust"]
    stars = [
        star
        | {"star_id": 1000 + 17 * i, "z": 9.1 if i == 0 else star["z"], "suspect": i < 2, "flags": FLAGS.get(i, [])}
        for i, star in enumerate(found["stars"][:40])
    ]
    return found | {
        "drop_one": [entry | {"needed": entry["name"] != "a2_rad"} for entry in found["drop_one"]],
        "drop_one_sentence": "The tilt a2 is not needed by these data.",
        "nis_over_time": nis_over_time(rng, n_frames),
        "stars": stars,
        "suspects": [1000, 1017],
        "stars_sentence": "2 stars are off their catalogue positions: flag them, or leave them out.",
        "residual_against": found["residual_against"] | {"temperature": None},
        "residual_field": residual_field(),
        "residual_outliers": residual_outliers(rng),
        "unavailable": {"residual_against.temperature": "The telemetry has no temperatures."},
    }


def frame_observability(n_frames=120):
    """Every curve has its gaps, and the first value alone leaves a parameter open."""
    rng, found = np.random.default_rng(8), EXAMPLE["frame_observability"]
    curves = {
        name: [None if k % 10 == 7 else float(rng.uniform(2e-6, 8e-6)) for k in range(n_frames)]
        for name in found["minimum_singular_value"]
    }
    frames = {"frame": list(range(n_frames)), "frames_used": n_frames, "frames": 200}
    shares = [one | ({"share": None} if one["reference"] == "sigma_1" else {}) for one in found["information"]]
    return found | frames | {"minimum_singular_value": curves, "information": shares}


def matching():
    cycles = [(4401, 4466, 2297, 84.1e-6), (4466, 4466, 65, 82.6e-6), (4466, 4466, 0, 82.6e-6)]
    names = ("cycle", "matched", "rematched", "changed", "rms_arc_rad")
    flight = {"availability": {"initial": 0.46, "final": 1.0}, "matched_stars": {"initial": 1650, "final": 4460}}
    return EXAMPLE["matching"] | {
        "given": 2233,
        "kept": 2201,
        "added": 2265,
        "removed": 32,
        "matched": 4466,
        "cycles": [dict(zip(names, (k, *cycle), strict=True)) for k, cycle in enumerate(cycles, 1)],
        "row_reasons": {"no catalogue star is near": 61, "two catalogue stars are near": 12},
        "removed_reasons": {"two catalogue stars are near": 32},
        "exposure_reasons": {"valid": 398, "fewer than three stars matched": 2},
        "starts": {"given matches": 371, "other exposure": 24, "neighbouring frame": 5},
        "flagged": {"doubles": 41, "unreliable": 3, "left_out": 0},
        "flight": {"tolerance_rad": 4.2e-4, **flight},
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
    sentence = "The new parameters solve 3 frames that the old ones lose, and lose 1."
    summary = {
        "baseline_only": len(lost),
        "candidate_only": len(gained),
        "both": n_frames - len(lost) - len(gained),
        "neither": 0,
        "stars_lost": 2 * len(lost),
        "stars_gained": n_frames,
        "p": 0.625,
        "sentence": sentence,
    }
    found = {"frames": frames, "frames_in_set": n_frames, "flight_tolerance_rad": 4.2e-4, "summary": summary}
    return {"calibration": None, "validation": found}


def examined(method):
    """Return the example by a method as a run over 200 frames that leaves doubts."""
    return parse_calibration(examined_document(method))


def examined_document(method):
    result = get_example_calibrations()[method].to_dict()
    truth = {name: value + 0.5 * result["sigma"][name] for name, value in result["parameters"].items()}
    moved = {
        name: (value - result["initial"][name]) / result["sigma"][name] for name, value in result["parameters"].items()
    }
    flown = {"availability": {"initial": 0.46, "final": 1.0}, "matched_star_ratio": 2.7}
    validation = {key: value for key, value in result["validation"].items() if key != "intervals"} | flown
    return result | {
        "truth": truth,
        "delta_over_sigma": moved,
        "advice": ["The data cannot separate the principal point from the tilts: use them together, not one by one."],
        "frames": 200,
        "rms_arc_rad": {"initial": 412.9e-6, "final": 82.6e-6},
        "validation": validation,
        "evaluation": None,
        "frame_observability": frame_observability(),
        "trust": trust(),
        "matching": matching(),
        "shadow": shadow(),
        "timing_s": {"fit": 0.9, "method": 0.4},
        "inputs": result["inputs"] | {"sha256s": {"telemetry": "ab" * 32, "sensor": "cd" * 32}},
    }


def sequential(n_frames=200, seed=4):
    rng, result = np.random.default_rng(seed), examined_document("filter")
    typical, final_sigma, final = (
        np.array([result[key][name] for name in result["free"]]) for key in ("typical_sigma", "sigma", "parameters")
    )
    k = np.arange(1, n_frames + 1)[:, None]
    sigma = np.minimum(10 * typical, final_sigma * np.sqrt(n_frames / k))
    wander = np.cumsum(rng.normal(size=(n_frames, 8)), axis=0) / np.maximum(k, 1) ** 0.9
    history = {
        "frame": list(range(n_frames)),
        "parameters": (final + sigma * (wander - wander[-1])).tolist(),
        "sigma": sigma.tolist(),
        "tail_rms_rad": (82.6e-6 + 300e-6 / k[:, 0] ** 1.3).tolist(),
        "aggregate_rms_rad": (80e-6 + 120e-6 / k[:, 0]).tolist(),
        "nis": rng.chisquare(19, n_frames).tolist(),
        "nis_dof": [19] * n_frames,
        "time_utc": None,
    }
    return parse_calibration(result | {"history": history})
