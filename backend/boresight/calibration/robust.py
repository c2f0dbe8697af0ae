"""Huber's loss beside least squares: how many arcs it held back, and how far that moved the estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr

from boresight.arrays import FloatArray

#: Move from least squares, in sigmas of the estimate, from which it is called one.
MOVED = 1.0


@dataclass(frozen=True)
class Robustness:
    """Huber's loss beside least squares.

    Parameters
    ----------
    threshold
        In whitened sigmas.
    downweighted, arcs
        Arcs beyond it at the estimate, and all.
    x, x_without
        (n_parameters,) the estimate, and where least squares ends on the same arcs, SI.
    """

    threshold: float
    downweighted: int
    arcs: int
    x: FloatArray
    x_without: FloatArray


def robust_view(found: Robustness, names: Sequence[str], sigma: FloatArray) -> dict[str, Any]:
    """Write the `robust` object of the calibration JSON.

    Parameters
    ----------
    names
        All parameters of the camera, in order.
    sigma
        (n_parameters,) one-sigma of the estimate, SI; NaN where not estimated.
    """
    shift = (found.x - found.x_without) / np.where(sigma > 0, sigma, np.nan)
    share, expected = found.downweighted / found.arcs, 2 * float(ndtr(-found.threshold))
    return {
        "threshold": found.threshold,
        "downweighted": found.downweighted,
        "share": share,
        "expected_share": expected,
        "parameters_without": {name: float(x) for name, x in zip(names, found.x_without, strict=True)},
        "shift_in_sigma": {name: float(z) if np.isfinite(z) else None for name, z in zip(names, shift, strict=True)},
        "sentence": _sentence(found.downweighted, share, expected, dict(zip(names, shift, strict=True))),
    }


def _sentence(count: int, share: float, expected: float, shift: dict[str, float]) -> str:
    """Say what the loss did, against what it does to noise alone."""
    counted = (
        f"Huber's loss held back {count:,} arcs, {share:.1%} of them, where Gaussian noise alone gives {expected:.1%}"
    )
    moved = {name: z for name, z in shift.items() if np.isfinite(z)}
    if not moved:
        return f"{counted}."
    name = max(moved, key=lambda key: abs(moved[key]))
    if abs(moved[name]) < MOVED:
        return f"{counted}; least squares agrees within {abs(moved[name]):.1f} sigma."
    return (
        f"{counted}; it moved the estimate by up to {abs(moved[name]):.1f} sigma ({name}) from least squares: "
        "look for wrong matches before trusting either."
    )
