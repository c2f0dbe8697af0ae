"""Where the paper's text and its numbers, or its numbers and ours, do not say the same: each with the figures.

Every finding is an object: `title`, what the `text` says, and the `sentences` that hold the numbers against it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight.simulation.sensors import ST16_PIXEL_PITCH_M, TYPICAL_SIGMA
from boresight.studies.enright import printed
from boresight.studies.enright.estimators import ESTIMATORS, SPARSE_EVERY
from boresight.studies.enright.matching_findings import matching_findings
from boresight.studies.enright.pooled import Pooled, Record, mean
from boresight.studies.enright.sentences import (
    Finding,
    by_sensor,
    described,
    finding,
    over_bound,
    statistics,
    validation_urad,
)  # fmt: skip
from boresight.studies.enright.tables import NAMES, URAD_PER_RAD, reduced_excess


def findings(pooled: Pooled) -> list[Finding]:
    """Return every finding; none needs a particular sensor."""
    about_estimators = (_reduced_model, _as_printed, _weak_direction, _unscented, _cosine, _condition, _initial_error)
    return [make(pooled) for make in about_estimators] + matching_findings(pooled)


def _percent(shares: dict[str, float]) -> str:
    return ", ".join(f"{name} {100 * share:+.0f} %" for name, share in shares.items())


def _reduced_model(pooled: Pooled) -> Finding:
    ours = [reduced_excess(pooled, sensor) for sensor in pooled.sensors]
    batch = [excess["batch"] for excess in ours if "batch" in excess]
    theirs = f"Table V itself, row 1R against row 1: {_percent(printed.reduced_excess())}."
    here = f"Here, sensor {pooled.sensors[0]}: {_percent(ours[0])}"
    spread = f"by the batch over {len(batch)} sensors {100 * min(batch):+.0f} to {100 * max(batch):+.0f} %."
    nees = statistics(pooled, "reduced-batch")["nees"]
    claims = (
        f" The reduced batch claims a covariance whose NEES is {nees['mean']:.3g} where 3 is expected." if nees else ""
    )
    return finding(
        "The reduced model (f, m₀, n₀) is far worse than the text says",
        "III-B: “RMS errors from the reduced order models are between 5% and 13% higher”.",
        (theirs, f"{here}; {spread}{claims}"),
    )


def _as_printed(pooled: Pooled) -> Finding:
    errors = {key: mean(pooled.firsts(key), validation_urad) for key in ("no-q", "printed")}
    rms = f"Mean validation RMS: {errors['printed']:.1f} µrad with one linearisation, {errors['no-q']:.1f} µrad with more."
    corrected = (
        "Equations 25, 26, 83, 84, 87 and 88 are corrected in both: as printed, their signs and shapes make no filter."
    )
    return finding(
        "A filter with one linearisation a frame claims too much, and RMS does not show it",
        "III-B: the SQRF No-Q filters “come very close to that of the batch estimator”; excess error is laid to slow convergence.",
        (f"{described(pooled, 'printed')}. {described(pooled, 'no-q')}.", rms, corrected),
    )


def _weak_direction(pooled: Pooled) -> Finding:
    n0, a1 = NAMES.index("n0_px"), NAMES.index("a1_rad")
    slope = ST16_PIXEL_PITCH_M / 16e-3 * TYPICAL_SIGMA[n0] / TYPICAL_SIGMA[a1]
    found = [_correlation(record, "n0_px", "a1_rad") for record in pooled.firsts("batch")]
    theirs = f"Table III has the same sign for both in {len(printed.same_sign('n0_px', 'a1_rad'))} of 6 sensors."
    weak = f"Arcs see least the direction a₁ = (pixel / f) δn₀, {slope:+.2f} typical sigmas of a₁ for one of n₀"
    return finding(
        "n₀ and a₁ move in the same direction, not in opposite ones",
        "III-A: “In Sensor-2 and Sensor-4 we see opposite motions in n₀ and a₁”.",
        (theirs, f"{weak}; the correlation of their errors here is {min(found):+.3f} to {max(found):+.3f}."),
    )


def _correlation(record: Record, first: str, second: str) -> float:
    names, P = record["covariance"]["names"], np.array(record["covariance"]["matrix"])
    i, j = names.index(first), names.index(second)
    return float(P[i, j] / np.sqrt(P[i, i] * P[j, j]))


def _unscented(pooled: Pooled) -> Finding:
    keys = ("ekf", "ukf", "ukf-sparse", "printed")
    ratio = {key: over_bound(pooled, key) for key in keys}
    errors = ", ".join(f"{ESTIMATORS[key].label} {mean(pooled.firsts(key), validation_urad):.2f} µrad" for key in keys)
    paired = _paired(pooled, "ukf", "ekf")
    low, high = np.percentile(paired, (5, 95))
    pairs = (
        f"Set by set the UKF's error is {np.median(paired):.3f} times the EKF's (5 to 95 %: {low:.3f} to {high:.3f})"
    )
    smaller = f"smaller in {np.sum(paired < 1)} of {len(paired)} sets."
    once = f"The EKF that linearises a frame once, as the paper's did: {described(pooled, 'printed')}."
    sparse = f"A UKF without the time for full rate, on every {SPARSE_EVERY}rd frame: {described(pooled, 'ukf-sparse')}"
    lost = f"the lost frames alone cost √{SPARSE_EVERY} = {np.sqrt(SPARSE_EVERY):.2f}."
    against = {key: "better" if ratio["ukf-sparse"] < ratio[key] else "worse" for key in ("printed", "ekf")}
    trade = f"It is {against['printed']} than the EKF that linearises once and {against['ekf']} than the EKF that linearises again"
    return finding(
        "UKF against EKF, the paper's open question",
        "IV: “The optimal solution is not self-evident, but well worth investigating.”",
        (
            f"At full rate: {described(pooled, 'ekf')}. {described(pooled, 'ukf')}. {pairs}, {smaller}",
            f"{once} {sparse}; {lost} {trade}.",
            f"Mean validation RMS, which tells them apart least: {errors}.",
        ),
    )


def _paired(pooled: Pooled, key: str, other: str) -> NDArray[np.float64]:
    """Ratio of two estimators' errors on the sets where both converged; 1 where there is none."""
    found = zip(pooled.of(key), pooled.of(other), strict=True)
    squares = [(one["squared_over_bound"], two["squared_over_bound"]) for one, two in found]
    known = [one / two for one, two in squares if one is not None and two is not None]
    return np.sqrt(known or [1.0])


def _cosine(pooled: Pooled) -> Finding:
    errors = {key: mean(pooled.firsts(key), validation_urad) for key in ("batch", "cosine")}
    ratios = {key: over_bound(pooled, key) for key in errors}
    excess = 100 * (ratios["cosine"] / ratios["batch"] - 1)
    cost = f"The unweighted cosine's errors are {excess:+.0f} % against the arc's, what leaving out R costs included"
    return finding(
        "What the cosine of the arc costs",
        "II-B: the cosine error “introduces arbitrary and unjustified weights”; the paper gives no figure.",
        (
            f"{described(pooled, 'cosine')}. {described(pooled, 'batch')}.",
            f"{cost}; validation RMS {errors['cosine']:.2f} against {errors['batch']:.2f} µrad.",
        ),
    )


def _condition(pooled: Pooled) -> Finding:
    records, (low, high) = pooled.firsts("batch"), printed.CONDITION_NUMBERS
    plain = [record["plain_condition_number"] for record in records]
    inside = sum(low <= number <= high for number in plain)
    whitened = by_sensor(records, [record["condition_number"] for record in records])
    unscaled = np.log10([_unscaled_condition(record["observability"]) for record in records])
    return finding(
        "Condition numbers",
        f"II-C: scaling brings the condition number from about 10¹⁴ to around {low:.0f} to {high:.0f}.",
        (
            f"Here, of the scaled Jacobian, by sensor {by_sensor(records, plain)}: {inside} of {len(plain)} in that range.",
            f"Of the Jacobian whitened by R, whose inverse square is the covariance: {whitened}.",
            f"Without scaling 10^{unscaled.min():.1f} to 10^{unscaled.max():.1f}, b₄ in m⁻⁴ and b₂ in m⁻² (erratum to Table II).",
        ),
    )


def _unscaled_condition(observed: Record) -> float:
    """Condition number of the Jacobian in SI units, from its scaled singular values and vectors."""
    values, vectors = np.array(observed["singular_values"]), np.array(observed["right_singular_vectors"])
    singular = np.linalg.svd(values[:, None] * vectors / TYPICAL_SIGMA, compute_uv=False)
    return float(singular[0] / singular[-1])


def _initial_error(pooled: Pooled) -> Finding:
    theirs = {sensor: values[3] for sensor, values in printed.TABLE_IV.items()}
    ours = {
        record["sensor"]: record["calibration"]["rms_arc_rad"]["initial"] * URAD_PER_RAD
        for record in pooled.firsts("batch")
    }
    said = ", ".join(f"{sensor}: {error / theirs[sensor]:.2f}" for sensor, error in ours.items())
    unknown = "Where it is far from 1 the real ground calibration was not nominal, or other pairs were used; neither is given."
    return finding(
        "Table IV's initial errors are smaller than Table III's changes make them from a nominal start",
        "Table IV gives initial errors of 83 to 423 µrad for the changes of Table III.",
        (
            f"Our initial error over the printed one, by sensor: {said}.",
            unknown,
        ),
    )
