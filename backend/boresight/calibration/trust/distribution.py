"""How residuals over their own sigmas are distributed: against the normal curve, by histogram and by quantiles, and their outliers.

Under right sigmas and Gaussian centroids every component z (`pixel_residuals`) is a standard normal. Quantiles are taken at normal
deviates q_i spaced evenly; a sample quantile at p = Phi(q) has, with n values and the density phi, the sigma

    sqrt(p (1 - p) / n) / phi(q)                                              (Kendall & Stuart, vol. 1, 14.10).

Tails are judged beyond `TAIL` spreads: so scaled, understated noise alone is no heavy tail. The number of components out there is
binomial; its two-sided p-value below 1 % calls the tails heavy or light. (Residuals of one exposure share its attitude, which
makes them a little dependent; at the 1 % level that is well below what a wrong match does.)
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import bdtr, bdtrc, ndtr

from boresight.arrays import FloatArray
from boresight.calibration.trust.field import before
from boresight.calibration.trust.fitted_set import FittedSet, Unavailable, nested, probability
from boresight.calibration.trust.residuals import LEAST_SHARE, StarResiduals

EDGES = np.linspace(-6.0, 6.0, 49)
DEVIATES = np.linspace(-4.0, 4.0, 81)
TAIL = 3.0
UNLIKELY = 0.01
FEWEST = 50
MOST_OUTLIERS = 200
#: Spreads beyond which a single star is listed: one in 16,000 components by chance.
OUTLIER = 4.0


def residual_distribution(fitted: FittedSet, found: StarResiduals) -> dict[str, Any]:
    """Histogram before and after, quantiles after, and the verdict on the tails."""
    z = found.z[found.known].ravel()
    if len(z) < FEWEST:
        raise Unavailable(f"A distribution needs {FEWEST} residuals; there are {len(z)}.")
    p = ndtr(DEVIATES)
    seen = np.minimum(p, 1 - p) * len(z) >= 0.5  # no sample quantile is beyond the sample
    density = np.exp(-(DEVIATES[seen] ** 2) / 2) / np.sqrt(2 * np.pi)
    beyond = int(np.sum(np.abs(z) > TAIL * found.spread))
    share = 2 * float(ndtr(-TAIL))
    p_tail = two_sided(beyond, len(z), share)
    return {
        "edges": nested(EDGES),
        "before": _histogram(_before_z(fitted, found)),
        "after": _histogram(z),
        "normal": nested(DEVIATES[seen]),
        "quantile": nested(np.quantile(z, p[seen])),
        "sigma_of_quantile": nested(np.sqrt(p[seen] * (1 - p[seen]) / len(z)) / density),
        "count": len(z),
        "mean": float(z.mean()),
        "sigma": float(z.std()),
        "spread": found.spread,
        "beyond_share": beyond / len(z),
        "expected_share": share,
        "p_tail": p_tail,
        "normal_tails": p_tail >= UNLIKELY,
        "sentence": _sentence(z, found.spread, beyond / len(z), share, p_tail),
    }


def _before_z(fitted: FittedSet, found: StarResiduals) -> FloatArray:
    """Components over their sigmas at the sensor's own parameters, (n,)."""
    r, M = before(fitted, found)
    share = np.maximum(np.diagonal(M, axis1=1, axis2=2), LEAST_SHARE)
    z = r / (found.arcs.sigma_px[:, None] * np.sqrt(share))
    return np.asarray(z[np.isfinite(z).all(axis=1)].ravel())


def _histogram(z: FloatArray) -> dict[str, Any]:
    """Counts of the bins, and of what lies beyond them."""
    return {
        "counts": np.histogram(z, EDGES)[0].tolist(),
        "below": int(np.sum(z < EDGES[0])),
        "above": int(np.sum(z > EDGES[-1])),
    }


def two_sided(count: int, n: int, share: float) -> float:
    """How likely a binomial count so far out is, on either side."""
    low, high = float(bdtr(count, n, share)), float(bdtrc(count - 1, n, share)) if count else 1.0
    return min(1.0, 2 * min(low, high))


def _sentence(z: FloatArray, spread: float, share: float, expected: float, p: float) -> str:
    """The verdict in words."""
    size = f"Of {len(z)} residuals {share:.2%} lie beyond {TAIL:g} times their spread of {spread:.2f} sigmas"
    if p >= UNLIKELY:
        return f"{size}, {expected:.2%} are expected: their tails are those of the normal curve ({probability(p)})."
    if share > expected:
        return f"{size}, {expected:.2%} are expected ({probability(p)}): some stars are wrong; look at the outliers."
    return f"{size}, {expected:.2%} are expected ({probability(p)}): something cut the largest off, such as a narrow match gate."


def residual_outliers(fitted: FittedSet, found: StarResiduals) -> dict[str, Any]:
    """Single sightings beyond `OUTLIER` spreads along either axis, the worst first, at most `MOST_OUTLIERS`."""
    size = np.where(found.known, np.abs(found.z).max(axis=1), 0.0) / max(found.spread, 1.0)
    out = np.flatnonzero(size > OUTLIER)
    shown = out[np.argsort(-size[out], kind="stable")][:MOST_OUTLIERS]
    arcs, telemetry = found.arcs, fitted.telemetry
    rows, expected = arcs.source_row[shown], int(found.known.sum()) * 4 * float(ndtr(-OUTLIER))
    return {
        "frame": found.frame[shown].tolist(),
        "exposure": telemetry.exposure[rows].tolist(),
        "star_id": None if telemetry.star_id is None else telemetry.star_id[rows].tolist(),
        "row_px": nested(arcs.row_px[shown]),
        "col_px": nested(arcs.col_px[shown]),
        "d_row_px": nested(found.r[shown, 0]),
        "d_col_px": nested(found.r[shown, 1]),
        "normalised": nested(size[shown]),
        "rows": fitted.problem.sensor.rows,
        "columns": fitted.problem.sensor.columns,
        "limit": OUTLIER,
        "stars_in_all": int(found.known.sum()),
        "in_all": len(out),
        "expected": expected,
        "sentence": (
            f"{len(out)} of {int(found.known.sum())} matched stars lie beyond {OUTLIER:g} sigmas of their residual; chance "
            f"puts {expected:.1f} there."
        ),
    }
