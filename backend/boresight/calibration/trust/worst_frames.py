"""The frames that the best fit explains worst, to be looked at one by one.

Frame k has the chi-square e_k^T e_k of m_k arcs, of which its own pull on the parameters took l_k (`ground`): it is compared with
chi-square of m_k - l_k degrees of freedom. So that frames of few and of many stars stand in one order, it is turned into a normal
deviate (Wilson & Hilferty 1931), good to a tenth of a sigma at four, from five degrees of freedom on:

    deviate = ((chi2 / dof)^(1/3) - (1 - 2 / (9 dof))) / sqrt(2 / (9 dof)).

Reference: Wilson, Hilferty, "The distribution of chi-square", PNAS 17, 1931.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtr

from boresight.arrays import FloatArray
from boresight.calibration.trust.ground import Ground, Unavailable, nested

MOST_SHOWN = 200
#: Deviate beyond which a frame is called badly explained: one in 740 by chance.
BAD = 3.0


def worst_frames(ground: Ground) -> dict[str, Any]:
    """At most `MOST_SHOWN` frames, the worst first."""
    chi2, dof = ground.sums.chi2, ground.sums.dof
    judged = np.flatnonzero(dof >= 1)
    if not len(judged):
        raise Unavailable("One frame alone determines the parameters, so none can be judged by the rest: add frames.")
    deviate = deviates(chi2[judged], dof[judged])
    order = np.argsort(-deviate, kind="stable")[:MOST_SHOWN]
    shown, bad, expected = judged[order], int(np.sum(deviate > BAD)), len(judged) * float(ndtr(-BAD))
    return {
        "frame": ground.arcs.frame[shown].tolist(),
        "chi2_per_dof": nested(chi2[shown] / dof[shown]),
        "dof": nested(dof[shown]),
        "deviation": nested(deviate[order]),
        "frames_in_all": len(judged),
        "beyond": bad,
        "expected_beyond": expected,
        "sentence": (
            f"{bad} of {len(judged)} frames {'is' if bad == 1 else 'are'} explained worse than {BAD:g} sigmas allow "
            f"({expected:.1f} expected by chance); the worst is frame {ground.arcs.frame[shown[0]]}."
        ),
    }


def deviates(chi2: FloatArray, dof: FloatArray) -> FloatArray:
    """Chi-squares (n,) of so many degrees of freedom (n,) as normal deviates."""
    spread = 2 / (9 * dof)
    return np.asarray((np.cbrt(chi2 / dof) - (1 - spread)) / np.sqrt(spread))
