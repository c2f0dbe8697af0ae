"""Residuals over the detector, before and after: means of cells with their sigmas, so that noise is not read as structure.

Before are the residuals at the sensor's own parameters, after those at the best fit, each under its own best attitude. The mean
of a cell's n residuals has along each axis the sigma

    sigma_of_mean = sqrt(sum sigma_i^2 M_i) / n

with M_i the share of a star's own error that is left in its residual (`pixel_residuals`), times the residuals' spread at the best
fit where that exceeds one. Squares of means over sigmas, summed over cells and axes, are held against chi-square. The fit has
taken some freedom out of them, so chance alone calls fewer than 1 % of sets uneven. The rms of a cell shows where centroids
are noisier.

How residuals over their own sigmas are distributed: against the normal curve, by histogram and by quantiles, and their outliers.

Under right sigmas and Gaussian centroids every component z (`pixel_residuals`) is a standard normal. Quantiles are taken at normal
deviates q_i spaced evenly; a sample quantile at p = Phi(q) has, with n values and the density phi, the sigma

    sqrt(p (1 - p) / n) / phi(q)                                              (Kendall & Stuart, vol. 1, 14.10).

Tails are judged beyond `TAIL` spreads: so scaled, understated noise alone is no heavy tail. The number of components out there is
binomial about a share that the spread s, known from the n residuals too, moves: with T the limit, q = 2 Phi(-T), m = 0.67449 the
median of |z| and phi the density, the count's variance is by the influence of each residual on s

    n V,    V = q (1 - q) + 4 T^2 phi(T)^2 / (16 m^2 phi(m)^2) - T phi(T) q / (m phi(m))                    (Hampel 1974),

`INFLATION` = V / q (1 - q) = 1.3 times that of a binomial count; so count and n are taken as so many times fewer.

Residual against radius, magnitude, temperature, time, colour, row, column and pixel phase: what the camera model or the noise model
leaves out.

The quantity is the residual along the outward radius, r . rho / |rho|: a wrong focal length or distortion moves stars along it,
and no attitude can hide that. Against row and column and the phase within a pixel it is the residual along the rows, or
along the columns: a readout line after line, and centroids drawn to pixel centres. A bin's mean has the sigma

    sigma_of_mean = sqrt(sum sigma_i^2 M_rr) / count,

with M_rr the radial share of a star's own error (`residuals`), times the residuals' spread where that exceeds one. The squares of
the means over their sigmas, summed over bins, are compared with chi-square of as many degrees of freedom. The fit has taken some
freedom out of them, so chance alone calls fewer than 1 % of sets uneven; of the last five, which are for looking at and are
tested together elsewhere, fewer than 1 % by all of them. Bins hold equally many stars.

Reference: F. R. Hampel, "The influence curve and its role in robust estimation", J. Am. Stat. Assoc. 69, 1974.
"""

from __future__ import annotations

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.calibration import (
    RESIDUAL_UNITS,
    FieldOfResiduals,
    Histogram,
    ResidualAgainst,
    ResidualDependence,
    ResidualDistribution,
    ResidualField,
    ResidualOutliers,
)
from boresight.calibration.evaluation.pixel_residuals import FreeCovariance, pixel_residuals
from boresight.calibration.trust.fitted_set import UNLIKELY, FittedSet, Unavailable, nested, probability
from boresight.calibration.trust.residuals import LEAST_SHARE, StarResiduals
from boresight.estimation.statistics.special import bdtr, bdtrc, chdtrc, ndtr
from boresight.telemetry.schema import MAGNITUDES, TEMPERATURES_C, within

#: Cells along the longer side.
FEWEST_CELLS, MOST_CELLS = 4, 16
#: Stars that a cell holds on average, where the set is large enough for that.
STARS_A_CELL = 15
#: Stars that a cell needs for a mean.
LEAST_STARS = 4


def residual_field(fitted: FittedSet, found: StarResiduals) -> ResidualField:
    """Cells over the whole detector, with their residuals before and after."""
    sensor, arcs = fitted.problem.sensor, found.arcs
    row_edges, col_edges = cell_edges(sensor.rows, sensor.columns, int(found.known.sum()))
    cell = find_cells(arcs.row_px, arcs.col_px, row_edges, col_edges)
    spread = max(found.spread, 1.0)
    r, M = before(fitted, found)
    was = _binned(r, M, arcs.sigma_px * spread, cell, row_edges, col_edges)
    after = _binned(found.r, found.M, arcs.sigma_px * spread, cell, row_edges, col_edges)
    if after is None:
        raise Unavailable(f"No cell of the detector has {LEAST_STARS} stars: add frames.")
    return ResidualField(
        row_edges_px=nested(row_edges),
        col_edges_px=nested(col_edges),
        frames_used=arcs.n_frames,
        even=after.p >= UNLIKELY,
        sentence=_field_sentence(was, after),
        before=was,
        after=after,
    )


def before(fitted: FittedSet, found: StarResiduals) -> tuple[FloatArray, FloatArray]:
    """Residuals (n_stars, 2) and shares (n_stars, 2, 2) at the sensor's own parameters, taken as known."""
    if fitted.computed.get("before of") is not found:
        fitted.computed.update({"before of": found, "before": _before(fitted, found)})
    answer: tuple[FloatArray, FloatArray] = fitted.computed["before"]
    return answer


def _before(fitted: FittedSet, found: StarResiduals) -> tuple[FloatArray, FloatArray]:
    """The same, computed."""
    n = len(fitted.parameters.free)
    known = FreeCovariance(fitted.parameters.free, fitted.parameters.scale, np.zeros((n, n)))
    sensor = fitted.problem.sensor
    seen = pixel_residuals(fitted.problem.camera, sensor.initial, found.arcs, sensor.parity, known)
    return seen.r, seen.M


def cell_edges(rows: int, columns: int, n_stars: int) -> tuple[FloatArray, FloatArray]:
    """Edges of square cells, or nearly so, in pixels: as many as the stars fill."""
    longer, shorter = max(rows, columns), min(rows, columns)
    along = np.sqrt(n_stars / STARS_A_CELL * longer / shorter)
    many = int(np.clip(round(float(along)), FEWEST_CELLS, MOST_CELLS))
    few = max(1, round(many * shorter / longer))
    n_rows, n_columns = (few, many) if columns >= rows else (many, few)
    return np.linspace(-0.5, rows - 0.5, n_rows + 1), np.linspace(-0.5, columns - 0.5, n_columns + 1)


def find_cells(row_px: FloatArray, col_px: FloatArray, row_edges: FloatArray, col_edges: FloatArray) -> IntArray:
    """Number of the cell of each place (n,), row after row."""
    i = np.clip(np.searchsorted(row_edges, row_px, side="right") - 1, 0, len(row_edges) - 2)
    j = np.clip(np.searchsorted(col_edges, col_px, side="right") - 1, 0, len(col_edges) - 2)
    return np.asarray(i * (len(col_edges) - 1) + j)


def _binned(
    r: FloatArray, M: FloatArray, sigma_px: FloatArray, cell: IntArray, row_edges: FloatArray, col_edges: FloatArray
) -> FieldOfResiduals | None:
    """Means with sigmas and rms of cells, and whether they are noise; None where no cell has stars enough."""
    known = np.isfinite(r[:, 0])
    shape = (len(row_edges) - 1, len(col_edges) - 1)
    of, r = cell[known], r[known]
    variance = sigma_px[known, None] ** 2 * np.maximum(np.diagonal(M[known], axis1=1, axis2=2), LEAST_SHARE)
    count = np.bincount(of, minlength=shape[0] * shape[1])
    filled = count >= LEAST_STARS
    if not filled.any():
        return None
    safe = np.maximum(count, 1)
    mean, of_mean, rms = (
        np.stack([_summed(values[:, k], of, count) for k in (0, 1)]) for values in (r, variance, r**2)
    )
    mean, of_mean, rms = mean / safe, np.sqrt(of_mean) / safe, np.sqrt(rms.mean(axis=0) / safe)
    chi2 = float(np.sum((mean[:, filled] / of_mean[:, filled]) ** 2))
    cells = [nested(np.where(filled, values, np.nan).reshape(shape)) for values in (*mean, *of_mean, rms)]
    return FieldOfResiduals(
        count=count.reshape(shape).tolist(),
        mean_row_px=cells[0],
        mean_col_px=cells[1],
        sigma_row_px=cells[2],
        sigma_col_px=cells[3],
        rms_px=cells[4],
        rms_in_all_px=float(np.sqrt(np.mean(r**2))),
        chi2=chi2,
        dof=2 * int(filled.sum()),
        p=float(chdtrc(2 * int(filled.sum()), chi2)),
    )


def _summed(values: FloatArray, of: IntArray, count: IntArray) -> FloatArray:
    """Sums over cells."""
    return np.asarray(np.bincount(of, values, minlength=len(count)))


def _field_sentence(before: FieldOfResiduals | None, after: FieldOfResiduals) -> str:
    was = "" if before is None else f"{before.rms_in_all_px:.3g} px before and "
    size = f"Residuals are {was}{after.rms_in_all_px:.3g} px after (RMS per axis)"
    if after.p >= UNLIKELY:
        return f"{size}; they have no pattern over the detector beyond noise ({probability(after.p)})."
    return (
        f"{size}; they have a pattern over the detector that noise does not explain ({probability(after.p)}): "
        "the camera model does not have this distortion, or some stars are matched wrongly."
    )


EDGES = np.linspace(-6.0, 6.0, 49)
DEVIATES = np.linspace(-4.0, 4.0, 81)
TAIL = 3.0
#: Variance of the count beyond it over a binomial one's.
INFLATION = 1.295
FEWEST = 50
MOST_OUTLIERS = 200
#: Spreads beyond which a single star is listed: one in 16,000 components by chance.
OUTLIER = 4.0


def residual_distribution(fitted: FittedSet, found: StarResiduals) -> ResidualDistribution:
    """Histogram before and after, quantiles after, and the verdict on the tails."""
    z = found.z[found.known].ravel()
    if len(z) < FEWEST:
        raise Unavailable(f"A distribution needs {FEWEST} residuals, and there are {len(z)}: add frames.")
    p = ndtr(DEVIATES)
    seen = np.minimum(p, 1 - p) * len(z) >= 0.5  # no sample quantile is beyond the sample
    density = np.exp(-(DEVIATES[seen] ** 2) / 2) / np.sqrt(2 * np.pi)
    beyond = int(np.sum(np.abs(z) > TAIL * found.spread))
    share = 2 * float(ndtr(-TAIL))
    p_tail = two_sided(round(beyond / INFLATION), round(len(z) / INFLATION), share)
    return ResidualDistribution(
        edges=nested(EDGES),
        before=_histogram(_before_z(fitted, found)),
        after=_histogram(z),
        normal=nested(DEVIATES[seen]),
        quantile=nested(np.quantile(z, p[seen])),
        sigma_of_quantile=nested(np.sqrt(p[seen] * (1 - p[seen]) / len(z)) / density),
        count=len(z),
        mean=float(z.mean()),
        sigma=float(z.std()),
        spread=found.spread,
        beyond_share=beyond / len(z),
        expected_share=share,
        p_tail=p_tail,
        normal_tails=p_tail >= UNLIKELY,
        sentence=_tails_sentence(z, found.spread, beyond / len(z), share, p_tail),
    )


def _before_z(fitted: FittedSet, found: StarResiduals) -> FloatArray:
    """Components over their sigmas at the sensor's own parameters, (n,)."""
    r, M = before(fitted, found)
    share = np.maximum(np.diagonal(M, axis1=1, axis2=2), LEAST_SHARE)
    z = r / (found.arcs.sigma_px[:, None] * np.sqrt(share))
    return np.asarray(z[np.isfinite(z).all(axis=1)].ravel())


def _histogram(z: FloatArray) -> Histogram:
    """Counts of the bins, and of what lies beyond them."""
    return Histogram(
        counts=np.histogram(z, EDGES)[0].tolist(),
        below=int(np.sum(z < EDGES[0])),
        above=int(np.sum(z > EDGES[-1])),
    )


def two_sided(count: int, n: int, share: float) -> float:
    """How likely a binomial count so far out is, on either side."""
    low, high = float(bdtr(count, n, share)), float(bdtrc(count - 1, n, share)) if count else 1.0
    return min(1.0, 2 * min(low, high))


def _tails_sentence(z: FloatArray, spread: float, share: float, expected: float, p: float) -> str:
    size = f"{share:.2%} of {len(z)} residuals exceed {TAIL:g} times their standard deviation of {spread:.2f} sigmas"
    if p >= UNLIKELY:
        return f"{size}, {expected:.2%} are expected: the tails are normal ({probability(p)})."
    if share > expected:
        return f"{size}, {expected:.2%} are expected ({probability(p)}): some stars are wrong; check the outliers."
    return f"{size}, {expected:.2%} are expected ({probability(p)}): something removed the largest, such as a narrow match gate."


def residual_outliers(fitted: FittedSet, found: StarResiduals) -> ResidualOutliers:
    """Single sightings beyond `OUTLIER` spreads along either axis, the worst first, at most `MOST_OUTLIERS`."""
    size = np.where(found.known, np.abs(found.z).max(axis=1), 0.0) / max(found.spread, 1.0)
    out = np.flatnonzero(size > OUTLIER)
    shown = out[np.argsort(-size[out], kind="stable")][:MOST_OUTLIERS]
    arcs, telemetry = found.arcs, fitted.telemetry
    rows, expected = arcs.source_row[shown], int(found.known.sum()) * 4 * float(ndtr(-OUTLIER))
    return ResidualOutliers(
        frame=found.frame[shown].tolist(),
        exposure=telemetry.exposure[rows].tolist(),
        star_id=None if telemetry.star_id is None else telemetry.star_id[rows].tolist(),
        row_px=nested(arcs.row_px[shown]),
        col_px=nested(arcs.col_px[shown]),
        d_row_px=nested(found.r[shown, 0]),
        d_col_px=nested(found.r[shown, 1]),
        normalised=nested(size[shown]),
        rows=fitted.problem.sensor.rows,
        columns=fitted.problem.sensor.columns,
        limit=OUTLIER,
        stars_in_all=int(found.known.sum()),
        in_all=len(out),
        expected=expected,
        sentence=(
            f"{len(out)} of {int(found.known.sum())} matched stars have residuals beyond {OUTLIER:g} sigmas; "
            f"{expected:.1f} are expected by chance."
        ),
    )


MOST_BINS = 12
FEWEST_IN_A_BIN = 20
#: Quantities along an axis of the detector, with the component of the residual that is held against them.
ALONG = {"row": 0, "column": 1, "row_phase": 0, "column_phase": 1}
#: Those judged at a fifth of `UNLIKELY`.
LOOKED_AT = ("colour", *ALONG)
ABSENT = {
    "colour": "The catalogue gives no B−V of these stars.",
    "magnitude": "The telemetry gives no magnitude.",
    "temperature": "The telemetry gives no temperature.",
    "time": "The telemetry gives no time.",
}


def residual_against(fitted: FittedSet, found: StarResiduals) -> tuple[ResidualAgainst, dict[str, str]]:
    """One entry a quantity, and for those that are null why."""
    known, spread = found.known, max(found.spread, 1.0)
    away, radius = _outward(fitted, found)
    parts = [_component(found, along, spread) for along in (away, *(np.broadcast_to(e, away.shape) for e in np.eye(2)))]
    entries: dict[str, ResidualDependence] = {}
    missing: dict[str, str] = {}
    for name, values in _quantities(fitted, found, radius).items():
        if values is None or not np.isfinite(values).any():
            missing[name] = ABSENT[name]
            continue
        usable = known & np.isfinite(values)
        residual, sigma = parts[ALONG[name] + 1 if name in ALONG else 0]
        if (entry := _in_bins(name, values[usable], residual[usable], sigma[usable])) is not None:
            entries[name] = entry
        else:
            missing[name] = (
                f"The set is too small, or its {_spell(name)} varies too little, to form two bins of {FEWEST_IN_A_BIN} stars."
            )
    return ResidualAgainst(**entries), missing


def _spell(name: str) -> str:
    return name.replace("_", " ")


def _component(found: StarResiduals, along: FloatArray, spread: float) -> tuple[FloatArray, FloatArray]:
    """Residuals (n_stars,) along unit vectors (n_stars, 2), with their sigmas."""
    share = np.maximum(np.einsum("ni,nij,nj->n", along, found.M, along), LEAST_SHARE)
    return np.sum(along * found.r, axis=1), found.arcs.sigma_px * np.sqrt(share) * spread


def _outward(fitted: FittedSet, found: StarResiduals) -> tuple[FloatArray, FloatArray]:
    """Unit vectors away from the principal point (n_stars, 2), and the distance from it, pixels."""
    row, col = fitted.problem.camera.principal_point(fitted.x)
    away = np.stack([found.arcs.row_px - row, found.arcs.col_px - col], axis=-1)
    radius = np.hypot(away[:, 0], away[:, 1])
    return away / np.maximum(radius, 1e-9)[:, None], radius


def _quantities(fitted: FittedSet, found: StarResiduals, radius: FloatArray) -> dict[str, FloatArray | None]:
    """What the residual is held against, (n_stars,) each; None where the telemetry lacks it."""
    telemetry, rows = fitted.telemetry, found.arcs.source_row
    hours = None
    if telemetry.time_utc is not None:
        time = telemetry.time_utc[rows]
        hours = (time - np.nanmin(time)) / np.timedelta64(1, "h") if not np.isnat(time).all() else None
    return {
        "radius": radius,
        "magnitude": None if telemetry.magnitude is None else within(telemetry.magnitude[rows], MAGNITUDES),
        "temperature": None
        if telemetry.temperature_c is None
        else within(telemetry.temperature_c[rows], TEMPERATURES_C),
        "time": hours,
        "colour": _colour(fitted, rows),
        "row": found.arcs.row_px,
        "column": found.arcs.col_px,
        "row_phase": _phase(found.arcs.row_px),
        "column_phase": _phase(found.arcs.col_px),
    }


def _phase(place_px: FloatArray) -> FloatArray:
    """Place within a pixel (n,), from its centre, -0.5 to 0.5."""
    return np.asarray(place_px - np.round(place_px))


def _colour(fitted: FittedSet, rows: IntArray) -> FloatArray | None:
    """B-V (n,) of rows, NaN where it is not known; None where no star has one."""
    star_id, catalogue = fitted.telemetry.star_id, fitted.catalogue
    if star_id is None or catalogue is None:
        return None
    place = catalogue.find_index(star_id[rows])
    if not (place >= 0).any():
        return None
    return np.where(place >= 0, catalogue.colour_bv[place], np.nan)


def _in_bins(name: str, values: FloatArray, residual: FloatArray, sigma: FloatArray) -> ResidualDependence | None:
    """Mean with its sigma, and rms, of equally full bins; None where there are not two."""
    bins = min(MOST_BINS, len(values) // FEWEST_IN_A_BIN)
    edges = np.unique(np.quantile(values, np.linspace(0, 1, bins + 1))) if bins >= 2 else values[:0]
    if len(edges) < 3:
        return None
    of = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    n = len(edges) - 1
    counts = np.bincount(of, minlength=n)
    safe = np.maximum(counts, 1)
    mean = np.bincount(of, residual, minlength=n) / safe
    of_mean = np.sqrt(np.bincount(of, sigma**2, minlength=n)) / safe
    rms = np.sqrt(np.bincount(of, residual**2, minlength=n) / safe)
    filled = counts > 0
    p = float(chdtrc(int(filled.sum()), np.sum((mean[filled] / of_mean[filled]) ** 2)))
    return ResidualDependence(
        edges=nested(edges),
        mean_px=nested(np.where(filled, mean, np.nan)),
        sigma_of_mean_px=nested(np.where(filled, of_mean, np.nan)),
        rms_px=nested(np.where(filled, rms, np.nan)),
        count=counts.tolist(),
        unit=RESIDUAL_UNITS[name],
        p=p,
        even=p >= _level(name),
        sentence=_against_sentence(name, float(np.abs(mean[filled]).max()), p),
    )


def _level(name: str) -> float:
    """Probability below which a residual is said to depend on a quantity."""
    return UNLIKELY / len(LOOKED_AT) if name in LOOKED_AT else UNLIKELY


def _against_sentence(name: str, largest: float, p: float) -> str:
    which = f"residual along the {'columns' if ALONG[name] else 'rows'}" if name in ALONG else "radial residual"
    if p >= _level(name):
        return f"The {which} does not depend on {_spell(name)}beyond noise ({probability(p)})."
    return (
        f"The {which} depends on {_spell(name)}: bins are up to {largest:.2g} px off, more than noise explains "
        f"({probability(p)})."
    )
