"""Handmade parts of a result on matches: what the cycles left, and baseline and candidate flown side by side."""


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
