"""How two parameter sets do on a telemetry set: RMS on common pairs, availability, matched stars (E section III).

With the matches given in the file, both parameter sets are judged on the very same star pairs, the common pairs of E section II-B;
a frame is available when it has an exposure with enough matched stars, whatever the parameters, and the matched star ratio is 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.calibration.problem import Problem, weighed
from boresight.estimation.metrics import rms

FloatArray = NDArray[np.float64]


def evaluate(problem: Problem, x_initial: FloatArray, x_final: FloatArray) -> dict[str, Any]:
    """Compare two states (n_parameters,) on one problem, as the contract's `validation` object.

    Parameters
    ----------
    problem
        A set with at least one usable exposure; `arcs.phi` need not be filled.

    Returns
    -------
    dict with `rms_arc_rad`, `availability`, `matched_star_ratio`, `frames`, `stars`, `common_pairs`.
    """
    arcs = weighed(problem.arcs, problem.camera, x_initial)
    share = arcs.n_frames / problem.frames_in_set
    return {
        "rms_arc_rad": {"initial": rms(arcs, x_initial), "final": rms(arcs, x_final)},
        "availability": {"initial": share, "final": share},
        "matched_star_ratio": 1.0,
        "frames": problem.frames_in_set,
        "stars": arcs.n_stars,
        "common_pairs": arcs.n_arcs,
    }
