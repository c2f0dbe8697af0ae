"""Noise from the data: how centroid noise and bias depend on magnitude, field angle, rate, pixel phase and colour.

The centroids of an exposure with attitude w and parameters x are, near an estimate (letters of `estimation.statistics.cramer_rao`),

    r = J dx + K w + D b + e,        e_i ~ N(0, sigma_i^2),        ln sigma_i = ln sigma_stated,i + g_i . theta

with r (2 a star) the residuals in pixels, D the columns of the bias and g_i the quantities that the noise may depend on, each less
its mean so that the level alone carries the mean:

    bias     sin, cos of 2 pi h phase, h = 1, 2, 3, of row and column apart       phase = centroid - floor(centroid)
             (B-V - mean) (p - p_0) / corner                                     lateral colour, radial
    noise    1, magnitude, (radius / corner)^2, speed over the detector

Attitude and parameters are eliminated, exposure by exposure and then together: with rows divided by sigma, N = (sum K^T K)^-1 and
X = [J D] less its part along K, the bias is the weighted least squares (X^T X)^-1 X^T r, and what is left, z, has

    E z_ia^2 = 1 - h_ia,        h = K N K^T + X (X^T X)^-1 X^T, the leverage of a component.

theta maximises the likelihood of the residuals with attitude, parameters and bias integrated out (restricted maximum likelihood,
Patterson & Thompson 1971), whose score and information for log sigma are

    score = sum_i g_i sum_a (z_ia^2 - 1 + h_ia)
    A = 2 sum_ij g_i g_j^T sum_ab (I - h)_ia,jb^2
      = 2 [sum_i g_i g_i^T sum_a (1 - 2 h_ia) + sum over exposures |sum_i g_i u_i u_i^T|^2],     u_i = K_i L,  N = L L^T,

the last line for the attitude's share, which alone joins the stars of an exposure; Fisher scoring takes it to rest. A star beyond
`CUT` spreads is left out: by chance one in two million is.

A term is needed where the hypothesis that it is none is rejected at 1 % for the whole family: Wald's chi-square theta^T P^-1
theta of as many degrees of freedom as it has coefficients, then Holm's correction over all terms. The curve against the phase is
that of the centroid as measured, E[bias | measured phase], since only that can be subtracted: noise smooths it, by exp(-(2 pi h
sigma)^2 / 2) at harmonic h. Of more than `MOST_FRAMES` frames only so many are looked at, pairs of neighbours evenly spaced, and
four times as many where the noise is applied.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.calibration.calibration import Noise, NoiseTerm
from boresight.calibration.evaluation.pixel_residuals import FreeCovariance, pixel_residuals
from boresight.calibration.readout import compute_rates, find_speed_px_s
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.arcs import ArcSet
from boresight.estimation.attitude import to_quaternion
from boresight.estimation.statistics.special import chdtrc
from boresight.kernels.noise import score_noise, take_rotations_out
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import MAGNITUDES, Telemetry, within
from boresight.telemetry.sensors import Sensor

MOST_FRAMES = 500
FEWEST_STARS = 200
#: Spreads beyond which a star is left out.
CUT = 5.0
#: Probability below which one term of all is needed by chance.
NEEDED = 0.01
HARMONICS = (1, 2, 3)
MOST_ROUNDS = 8
#: Largest logarithm of the factor by which noise may be other than stated.
LARGEST_EXPONENT = 30.0
#: Share of the largest eigenvalue below which a direction is not determined.
SINGULAR = 1e-10
#: Steps in sigmas below which the noise is at rest.
AT_REST = 0.02
#: Spread of a quantity, in its unit, below which nothing can depend on it.
LEAST_SPREAD = {"magnitude": 0.1, "field_angle": 0.02, "rate": 1e-3, "colour": 0.05}
LN10 = float(np.log(10.0))

#: Terms by name, with what their coefficients are in.
UNITS = {
    "level": "× stated",
    "magnitude": "decades per magnitude",
    "field_angle": "decades from centre to corner",
    "rate": "decades per (px/s)",
    "phase_row": "px",
    "phase_col": "px",
    "colour": "px per magnitude of B−V at the corner",
}
TITLES = {
    "level": "Noise level",
    "magnitude": "Noise against magnitude",
    "field_angle": "Noise against field angle",
    "rate": "Noise against rate",
    "phase_row": "Bias against pixel phase, rows",
    "phase_col": "Bias against pixel phase, columns",
    "colour": "Lateral colour",
}
#: Terms of the pixel phase, with the axis of the centroid that they move.
PHASE_AXES = {"phase_row": 0, "phase_col": 1}
NO_MAGNITUDE = "Neither telemetry nor catalogue gives these stars a magnitude."
NO_RATE = "The rate is not known: give time_utc and quaternions, or exposures less than a minute apart."
NO_COLOUR = "The catalogue gives no B−V of these stars: match with Hipparcos numbers."
UNIFORM = "The quantity is nearly constant in this set, so no dependence can be determined: add different scenes."
MOVED_BEFORE = "These centroids were corrected beforehand, so their places within the pixels are not known."
EVEN_PHASES = "The centroids lie at few places within their pixels, so no curve can be found: give them unrounded."


@dataclass(frozen=True)
class StarQuantities:
    """What noise and bias may depend on, NaN where unknown.

    `magnitude`, `radius`, `speed`, `colour`: (n,) magnitude, distance from the principal point over that of the farthest corner,
    pixels a second, B-V. `away`: (n, 2) offset from the principal point over the same. `row_px`, `col_px`: (n,) as measured on
    the detector; None where centroids were moved before.
    """

    magnitude: FloatArray
    radius: FloatArray
    away: FloatArray
    speed: FloatArray
    colour: FloatArray
    row_px: FloatArray | None
    col_px: FloatArray | None


def find_quantities(
    telemetry: Telemetry,
    rows: IntArray,
    sensor: Sensor,
    x: FloatArray,
    catalogue: Catalogue,
    w: FloatArray | None,
    measured: Telemetry | None,
) -> StarQuantities:
    """Find them of some rows (n,) of telemetry, under x (n_parameters,).

    `w`: (n, 3) rate of their exposures' attitude, rad/s, NaN where unknown. `measured`: the telemetry before anything moved it.
    """
    camera = CAMERA_MODELS[sensor.camera_model]
    row, col = camera.principal_point(x)
    ends = np.array([-0.5, sensor.rows - 0.5]) - row, np.array([-0.5, sensor.columns - 0.5]) - col
    corner = float(np.hypot(np.abs(ends[0]).max(), np.abs(ends[1]).max()))
    row_px, col_px = telemetry.row_px[rows], telemetry.col_px[rows]
    away = np.stack([row_px - row, col_px - col], axis=-1) / corner
    magnitude, colour = _read_catalogue(telemetry, rows, catalogue)
    if telemetry.magnitude is not None:
        own = within(telemetry.magnitude[rows], MAGNITUDES)
        magnitude = np.where(np.isfinite(own), own, magnitude)
    speed = np.full(len(rows), np.nan) if w is None else find_speed_px_s(sensor, x, row_px, col_px, w)
    places = (None, None) if measured is None else (measured.row_px[rows], measured.col_px[rows])
    return StarQuantities(magnitude, np.hypot(away[:, 0], away[:, 1]), away, speed, colour, *places)


def _read_catalogue(telemetry: Telemetry, rows: IntArray, catalogue: Catalogue) -> tuple[FloatArray, FloatArray]:
    """Magnitude and B-V of rows (n,) from the catalogue, NaN where it has none."""
    unknown = np.full(len(rows), np.nan)
    if telemetry.star_id is None or not len(catalogue):
        return unknown, unknown
    index = catalogue.find_index(telemetry.star_id[rows])
    place = np.maximum(index, 0)
    magnitude, colour = catalogue.magnitude[place], catalogue.colour_bv[place]
    return np.where(index >= 0, magnitude, np.nan), np.where(index >= 0, colour, np.nan)


Columns = Mapping[str, FloatArray]


@dataclass(frozen=True)
class Regressors:
    """Columns of the noise, (n,) each, and of the bias, (n, 2, k) each, by term; its centre; what is absent."""

    noise: Columns
    bias: Columns
    reference: Mapping[str, float]
    unavailable: Mapping[str, str]


def make_regressors(quantities: StarQuantities, kept: BoolArray) -> Regressors:
    """Centre the quantities of stars (n,) and leave out what nothing can depend on."""
    noise: dict[str, FloatArray] = {"level": np.ones(len(kept))}
    bias: dict[str, FloatArray] = {}
    reference: dict[str, float] = {}
    unavailable: dict[str, str] = {}
    for name, values, absent in (
        ("magnitude", quantities.magnitude, NO_MAGNITUDE),
        ("field_angle", quantities.radius**2, ""),
        ("rate", quantities.speed, NO_RATE),
        ("colour", quantities.colour, NO_COLOUR),
    ):
        known = kept & np.isfinite(values)
        if not known.any():
            unavailable[name] = absent
        elif values[known].std() < max(LEAST_SPREAD[name], 1e-3 * abs(float(values[known].mean()))):
            unavailable[name] = UNIFORM
        else:
            reference[name] = float(values[known].mean())
            centred = np.where(np.isfinite(values), values - reference[name], 0.0)
            if name == "colour":
                bias[name] = (centred[:, None] * quantities.away)[:, :, None]
            else:
                noise[name] = LN10 * centred
    for name, axis in PHASE_AXES.items():
        place = (quantities.row_px, quantities.col_px)[axis]
        if place is None:
            unavailable[name] = MOVED_BEFORE
            continue
        waves = phase_waves(place)
        if waves[kept].std(axis=0).min() < 0.3:
            unavailable[name] = EVEN_PHASES
            continue
        bias[name] = np.zeros((len(kept), 2, waves.shape[1]))
        bias[name][:, axis] = waves
    return Regressors(noise, bias, reference, unavailable)


def phase_waves(place_px: FloatArray) -> FloatArray:
    """Sine and cosine of the phase (n,) at each harmonic, (n, 2 n_harmonics): sin 1, cos 1, sin 2, ..."""
    angles = [2 * np.pi * h * place_px for h in HARMONICS]
    return np.stack([wave(angle) for angle in angles for wave in (np.sin, np.cos)], axis=-1)


PHASE_NAMES = tuple(f"{wave}_{h}" for h in HARMONICS for wave in ("sin", "cos"))


@dataclass(frozen=True)
class NoiseFit:
    """Coefficients of bias (q,) and noise (k,) with their covariances, and (n,) which stars they rest on."""

    b: FloatArray
    P_b: FloatArray
    theta: FloatArray
    P_theta: FloatArray


def fit_noise(
    r: FloatArray, J: FloatArray, K: FloatArray, D: FloatArray, g: FloatArray, sigma: FloatArray, star_start: IntArray
) -> NoiseFit:
    """Maximise the restricted likelihood, see the module.

    Parameters
    ----------
    r, J, K, D
        (n, 2), (n, 2, n_free), (n, 2, 3), (n, 2, q) in pixels; J may be less any part along K.
    g
        (n, k) quantities of the noise.
    sigma
        (n,) stated one-axis noise, pixels.
    star_start
        (n_exposures + 1,) first star of each exposure; each has two or more.
    """
    theta = np.zeros(g.shape[1])
    for _ in range(MOST_ROUNDS):
        weight = np.exp(np.clip(-g @ theta, -LARGEST_EXPONENT, LARGEST_EXPONENT)) / sigma
        b, P_b, score, A = _round(r, J, K, D, g, weight, star_start)
        P_theta = np.linalg.inv(A)
        step = np.clip(P_theta @ score, -1.0, 1.0)
        theta = theta + step
        if np.max(np.abs(step) / np.sqrt(np.diag(P_theta))) < AT_REST:
            break
    return NoiseFit(b, P_b, theta, np.asarray(P_theta))


def _round(
    r: FloatArray, J: FloatArray, K: FloatArray, D: FloatArray, g: FloatArray, weight: FloatArray, star_start: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Bias with its covariance, and score and information of the noise, under weights (n,)."""
    n, n_free, terms = len(r), J.shape[2], g.shape[1]
    L, X = np.empty((len(star_start) - 1, 3, 3)), np.empty((n, 2, n_free + D.shape[2] + 1))
    take_rotations_out(star_start, r, J, K, D, weight, L, X)
    flat = X.reshape(2 * n, -1)
    products, rows = flat.T @ flat, flat[:, :-1]
    if not np.isfinite(products).all():
        raise np.linalg.LinAlgError("the attitude of an exposure is not fully determined")
    G = _inverse(products[:-1, :-1])
    c = G @ products[:-1, -1]
    score, A = np.empty(terms), np.empty((terms, terms))
    score_noise(star_start, K, weight, L, g, X, rows @ G, c, score, A)
    return c[n_free:], G[n_free:, n_free:], score, A


def _inverse(A: FloatArray) -> FloatArray:
    """Inverse of an information over its determined directions, whatever the units of its rows."""
    scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
    values, vectors = np.linalg.eigh(A / np.outer(scale, scale))
    known = values > SINGULAR * values[-1]
    return np.asarray((vectors[:, known] / values[known]) @ vectors[:, known].T / np.outer(scale, scale))


def estimate_noise(
    arcs: ArcSet,
    sensor: Sensor,
    x: FloatArray,
    freedom: FreeCovariance,
    catalogue: Catalogue,
    telemetry: Telemetry,
    measured: Telemetry | None,
    most_frames: int = MOST_FRAMES,
) -> Noise:
    """Estimate every term at state x, none of them applied.

    Parameters
    ----------
    arcs
        The set; all exposures have four stars or more.
    freedom
        What the parameters may still be.
    telemetry
        The rows that `arcs` come from, with the stars that they were matched with.
    measured
        The same before anything moved its centroids; None where that is not known.
    most_frames
        Frames that are looked at.
    """
    if arcs.n_stars < FEWEST_STARS:
        few = f"There are {arcs.n_stars} stars; a noise model needs {FEWEST_STARS}: add frames."
        return Noise(unavailable=dict.fromkeys(UNITS, few))
    arcs = _thinned(arcs, most_frames)
    camera = CAMERA_MODELS[sensor.camera_model]
    seen = pixel_residuals(camera, x, arcs, sensor.parity, freedom)
    share = np.diagonal(seen.M, axis1=1, axis2=2)
    z = np.abs(seen.r) / (arcs.sigma_px[:, None] * np.sqrt(np.maximum(share, 1e-6)))
    known = np.isfinite(z).all(axis=1)
    spread = float(np.median(z[known])) / 0.67449 if known.any() else 1.0
    inside = known & (z.max(axis=1) <= CUT * max(spread, 1e-9))
    w = each(_rates(telemetry, arcs, seen.C), arcs.star_start)
    quantities = find_quantities(telemetry, arcs.source_row, sensor, x, catalogue, w, measured)
    return _fitted(arcs, seen.r, seen.rows.J, seen.rows.K, inside, quantities)


def _thinned(arcs: ArcSet, most: int) -> ArcSet:
    """At most so many of the frames, pairs of neighbours evenly spaced, for a rate needs a neighbour."""
    if arcs.n_frames <= most:
        return arcs
    taken = np.zeros(arcs.n_frames, np.bool_)
    first = np.linspace(0, arcs.n_frames - 2, most // 2).round().astype(np.int64)
    taken[first], taken[first + 1] = True, True
    return arcs.exposures(np.repeat(taken, np.diff(arcs.frame_start)))


def _rates(telemetry: Telemetry, arcs: ArcSet, C: FloatArray) -> FloatArray:
    """Rates (n_exposures, 3), rad/s, from the attitudes of the telemetry, else from C (n_exposures, 3, 3) of its stars."""
    if telemetry.time_utc is None:
        return np.full((arcs.n_exposures, 3), np.nan)
    first = arcs.source_row[arcs.star_start[:-1]]
    own = telemetry.quaternion
    return compute_rates(to_quaternion(C) if own is None else own[first], telemetry.time_utc[first])


def _fitted(
    arcs: ArcSet, r: FloatArray, J: FloatArray, K: FloatArray, inside: BoolArray, quantities: StarQuantities
) -> Noise:
    """Fit the terms to the stars inside the cut, of exposures that keep three of them."""
    counts = np.add.reduceat(inside, arcs.star_start[:-1], dtype=np.int64)
    inside = inside & np.repeat(counts >= 3, np.diff(arcs.star_start))
    starts = np.append(0, np.cumsum(counts[counts >= 3]))
    made = make_regressors(quantities, inside)
    g = np.stack(list(made.noise.values()), axis=-1)[inside]
    nothing = np.zeros((len(inside), 2, 0))
    D = np.concatenate([nothing, *made.bias.values()], axis=2)[inside]
    sigma = arcs.sigma_px[inside]
    if len(g) < FEWEST_STARS:
        few = (
            f"Only {len(g)} stars are within {CUT:g} standard deviations of their predicted positions; a noise model needs "
            f"{FEWEST_STARS}."
        )
        return Noise(unavailable=dict.fromkeys(UNITS, few))
    try:
        found = fit_noise(r[inside], J[inside] * arcs.sigma_px[inside][:, None, None], K[inside] * sigma[:, None, None],
                          D, g, sigma, starts)  # fmt: skip
    except np.linalg.LinAlgError:
        singular = "This fit is nearly singular: free fewer parameters."
        return Noise(unavailable=dict.fromkeys(UNITS, singular))
    return Noise(terms=_terms(found, made), unavailable=dict(made.unavailable))


def _terms(found: NoiseFit, made: Regressors) -> list[NoiseTerm]:
    """One term each, tested together."""
    parts: dict[str, tuple[FloatArray, FloatArray]] = {}
    for k, name in enumerate(made.noise):
        parts[name] = (found.theta[k : k + 1], found.P_theta[k : k + 1, k : k + 1])
    begin = 0
    for name, columns in made.bias.items():
        part = slice(begin, begin + columns.shape[2])
        parts[name], begin = (found.b[part], found.P_b[part, part]), part.stop
    p = [float(chdtrc(len(value), max(float(value @ np.linalg.solve(P, value)), 0.0))) for value, P in parts.values()]
    needed = [bool(one < NEEDED) for one in holm(p)]
    return [
        _term(name, value, P, one, is_needed, made.reference)
        for (name, (value, P)), one, is_needed in zip(parts.items(), p, needed, strict=True)
    ]


def holm(p: Sequence[float]) -> FloatArray:
    """Probabilities (n,) after Holm's correction for having made n tests."""
    order = np.argsort(p, kind="stable")
    times = len(p) - np.arange(len(p))
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(np.maximum.accumulate(np.asarray(p)[order] * times), 1.0)
    return adjusted


def _term(
    name: str, value: FloatArray, P: FloatArray, p: float, needed: bool, reference: Mapping[str, float]
) -> NoiseTerm:
    sigma = np.sqrt(np.diag(P))
    if name == "level":
        factor = float(np.exp(value[0]))
        coefficients, sigmas = {"factor": factor}, {"factor": factor * float(sigma[0])}
    else:
        names = PHASE_NAMES if name in PHASE_AXES else ("slope",)
        coefficients = dict(zip(names, value.tolist(), strict=True))
        sigmas = dict(zip(names, sigma.tolist(), strict=True))
    known: dict[str, float | None] = dict(sigmas)
    if name in reference:
        coefficients["reference"], known["reference"] = reference[name], None
    return NoiseTerm(
        name=name, unit=UNITS[name], coefficients=coefficients, sigma=known, probability=p, needed=needed, applied=False,
        sentence=_sentence(name, coefficients, known, p, needed),
    )  # fmt: skip


def _sentence(
    name: str,
    value: Mapping[str, float],
    sigma: Mapping[str, float | None],
    p: float,
    needed: bool,
    *,
    applied: bool = False,
) -> str:
    """Say the size of a term, and what was or is to be done about it."""
    main = "factor" if name == "level" else "slope"
    if name in PHASE_AXES:
        size = f"the bias varies by ±{phase_amplitude(value):.2g} px within a pixel"
    elif name == "level":
        size = f"the noise is {value[main]:.3f} ± {sigma[main]:.3f} times the stated noise"
    elif name == "colour":
        size = f"a star moves {value[main]:+.2g} ± {sigma[main]:.2g} px outward at the corner for each magnitude of B−V"
    else:
        size = f"the noise changes by {value[main]:+.2g} ± {sigma[main]:.2g} {UNITS[name]}"
    if not needed:
        return f"{TITLES[name]}: {size}; not significant."
    remedy = "applied" if applied else "use noise_model from-data, or state it in sigma_px"
    return f"{TITLES[name]}: {size}; significant (p = {p:.1g}): {remedy}."


def phase_amplitude(coefficients: Mapping[str, float]) -> float:
    """Largest bias of a phase curve, pixels."""
    waves = phase_waves(np.linspace(0, 1, 200, endpoint=False))
    return float(np.abs(waves @ np.array([coefficients[name] for name in PHASE_NAMES])).max())


def marked_as_applied(noise: Noise) -> Noise:
    """The same with the terms that are needed said to be applied."""
    return replace(
        noise,
        terms=[
            replace(
                term,
                applied=True,
                sentence=_sentence(term.name, term.coefficients, term.sigma, term.probability, True, applied=True),
            )
            if term.needed
            else term
            for term in noise.terms
        ],
    )


def apply_noise(
    telemetry: Telemetry, sensor: Sensor, terms: Sequence[NoiseTerm], quantities: StarQuantities
) -> Telemetry:
    """Subtract the bias of the applied terms from every centroid and put the noise that they say in place of the stated.

    `quantities`: of all rows. A row of which a quantity is unknown is taken to be an average one.
    """
    shift, dex = np.zeros((len(telemetry), 2)), np.zeros(len(telemetry))
    for term in (term for term in terms if term.applied):
        value = term.coefficients
        if term.name in PHASE_AXES:
            axis = PHASE_AXES[term.name]
            place = (quantities.row_px, quantities.col_px)[axis]
            if place is not None:
                shift[:, axis] += phase_waves(place) @ np.array([value[name] for name in PHASE_NAMES])
        elif term.name == "level":
            dex += np.log10(value["factor"])
        elif term.name == "colour":
            shift += (value["slope"] * _centred(quantities.colour, value))[:, None] * quantities.away
        else:
            values = {"magnitude": quantities.magnitude, "field_angle": quantities.radius**2, "rate": quantities.speed}
            dex += value["slope"] * _centred(values[term.name], value)
    stated = np.full(len(telemetry), sensor.centroid_sigma_px)
    if telemetry.sigma_px is not None:
        stated = np.where(np.isfinite(telemetry.sigma_px), telemetry.sigma_px, stated)
    return replace(
        telemetry,
        row_px=telemetry.row_px - shift[:, 0],
        col_px=telemetry.col_px - shift[:, 1],
        sigma_px=stated * 10.0**dex,
    )


def _centred(values: FloatArray, coefficients: Mapping[str, float]) -> FloatArray:
    return np.where(np.isfinite(values), values - coefficients["reference"], 0.0)


def each(values: FloatArray, start: IntArray) -> FloatArray:
    """Values of runs (n_runs, ...) given to each of their members, (n_stars, ...)."""
    return np.repeat(values, np.diff(start), axis=0)
