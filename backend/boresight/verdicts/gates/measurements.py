"""The gates: what each asks, in which unit, which side of a limit is good, and the function that measures it.

A measurement is a value with its interval, or why there is none; it knows no limit, so a profile that is tried on past sets judges
exactly what was measured of them. A gate whose function is refused what it needs has no data, with the refusal as its sentence.

The parameter shift is the largest, over the parameters, of |x_i - x0_i| / sigma_i with

    sigma_i^2 = P_ii + P0_ii + (typical_i / 10)^2,

the variance of the difference of two independent estimates and a floor. Without the floor a set of a million stars, whose
sigmas are a thousandth of the typical ones, would be thousands of sigmas from any other for what no camera model holds.
Two estimates that share data differ by less than this says; the gate is then only slower to speak.

The arc uncertainty follows from the set's covariance alone (`trust.arc_map`), so it is had for every set, and for the
incumbent beside it: at the worst place of the detector, in pixels of the centre. The coverage counts the regions, 6 rows by 8
columns of the detector, in which there was at least one star; where there was none the model is a guess.

What no data can show is asked of the operator, in the sensor file: a set passes the gate of assumptions once all of it is
declared, is MARGINAL where something declared was left in the data, and has no data until then, which warns and does not block.

A table on board holds parameters as float32 or as whole numbers with a scale. Rounding each to its nearest step moves directions,
and nothing on the ground would show it: every number here is float64.

What the gates look at: a set, what it is compared with, the run behind it, and validation frames seen under both.

==========  ================================================================================================
direction   a value v passes a limit L when
==========  ================================================================================================
`below`     v <= L
`above`     v >= L
`around`    1 / L <= v <= L: a ratio that should be 1, off by no more than the factor L
`met`       it is met; there is no number to limit
==========  ================================================================================================

Critical gates ask whether the numbers are numbers of this sensor at all: nobody can waive them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from boresight.arrays import ARCSEC_PER_RAD, FloatArray
from boresight.calibration.calibration import Calibration, ChiSquareTest, Covariance, InnovationTest, TrustTest
from boresight.calibration.matching.verification import MANY_REMOVED
from boresight.calibration.process_noise import LAST_FRAMES, explains_chi2
from boresight.calibration.trust.causes import get_cause_gate
from boresight.calibration.trust.efficiency import field_arc_sigma
from boresight.calibration.trust.trust_tests import MATTERS, get_test_gate
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.errors import RefusedInputError
from boresight.estimation.filters import FILTERS
from boresight.estimation.statistics.observability import WEAK
from boresight.telemetry.sensors import Sensor
from boresight.uplink import table_definition
from boresight.verdicts.gates.assessed_set import INCOMPLETE, AssessedSet

Ends = tuple[float | None, float | None]


@dataclass(frozen=True)
class Score:
    """One score of validation frames with its 95 % interval, and the baseline's."""

    value: float | None
    interval: Ends | None = None
    incumbent: float | None = None


@dataclass(frozen=True)
class ValidationScores:
    """Scores of validation frames under both sets, by the name of the gate that asks for it, and of how many frames."""

    frames: int
    of_gate: Mapping[str, Score]


@dataclass(frozen=True)
class GateInputs:
    """Everything a verdict rests on; `made_with`: the sensor as it was when the run was launched."""

    sensor: Sensor
    candidate: AssessedSet
    incumbent: AssessedSet | None
    result: Calibration | None = None
    made_with: Sensor | None = None
    validation: ValidationScores | None = None
    no_validation: str = ""
    definition: Mapping[str, Any] | None = None

    @property
    def camera(self) -> CameraModel:
        """The sensor's camera model."""
        return CAMERA_MODELS[self.sensor.camera_model]

    @property
    def names(self) -> tuple[str, ...]:
        """Its parameters, in order."""
        return self.camera.parameter_names

    @property
    def x(self) -> FloatArray:
        """(n_parameters,) the set's parameters, SI; refuses as `parse_parameters`."""
        return self.candidate.state[0]

    def spread(self, covariance: Covariance | None) -> FloatArray:
        """Spread a covariance over all parameters, (n_parameters, n_parameters) SI, 0 for those that were held fixed."""
        if covariance is None:
            raise RefusedInputError(INCOMPLETE)
        places = [self.names.index(name) for name in covariance.names]
        P = np.zeros((len(self.names),) * 2)
        P[np.ix_(places, places)] = np.asarray(covariance)
        return P

    @property
    def pixel_rad(self) -> float:
        """What one pixel sees at the centre of the registered sensor."""
        return 1.0 / self.camera.focal_px(self.sensor.initial, self.sensor.pixel_pitch_m)


IS_INCUMBENT = "There is no other set to compare with: this set is the baseline, or the sensor has no baseline."
#: Share of the typical spread from unit to unit below which no difference of parameters counts in sigmas.
FLOOR = 0.1
#: Relative difference of a sigma from the root of its variance that rounding explains.
ROUNDING = 1e-6
ROWS, COLUMNS = 6, 8
NO_RUN = "The set was declared with the sensor; no run measured this."
ENDED = {
    "converged": ("PASS", "The estimate converged."),
    "max_iterations": (
        "MARGINAL",
        "The estimate had not converged at its last iteration: allow more iterations, or free fewer parameters.",
    ),
    "ground calibration": ("PASS", "A ground calibration is declared; there was nothing to estimate."),
}
NO_DEFINITION = "There is no table definition: an administrator or analyst adds it under the sensor's table on board."


@dataclass(frozen=True)
class Measurement:
    """What was measured for one gate."""

    value: float | None
    sentence: str
    interval: Ends | None = None
    bounds: Ends | None = None
    incumbent: float | None = None
    met: str | None = None


def absent(sentence: str) -> Measurement:
    """Return a measurement of nothing, with why and what to do."""
    return Measurement(None, sentence)


def answer(met: str, sentence: str) -> Measurement:
    """Return the answer of a gate that has no number."""
    return Measurement(None, sentence, met=met)


def ends(pair: Sequence[float | None] | None) -> Ends | None:
    """Return an interval as a pair, None for an end that is not known; one that is known at neither end is none."""
    low, high = (None if end is None or not math.isfinite(end) else float(end) for end in pair or (None, None))
    return None if low is None and high is None else (low, high)


def _measure_score(name: str, inputs: GateInputs) -> Measurement:
    if inputs.validation is None:
        return absent(inputs.no_validation)
    score, frames = inputs.validation.of_gate[name], inputs.validation.frames
    if score.value is None:
        return absent(f"None of the {frames:,} held-out frames gives this number: choose frames with more stars.")
    return Measurement(
        score.value, f"On {frames:,} held-out frames.", interval=score.interval, incumbent=score.incumbent
    )


def _measure_against_incumbent(name: str, inputs: GateInputs) -> Measurement:
    if inputs.incumbent is None:
        return absent(IS_INCUMBENT)
    return _measure_score(name, inputs)


def _measure_rms_in_noise(inputs: GateInputs) -> Measurement:
    """Take the RMS in multiples of what the stated centroid noise alone would cause in an arc, sqrt(2) sigmas of a pixel."""
    measured = _measure_score("validation-rms", inputs)
    if measured.value is None:
        return measured
    noise = float(np.sqrt(2) * inputs.sensor.centroid_sigma_px * inputs.pixel_rad)
    low, high = measured.interval or (None, None)
    return Measurement(
        measured.value / noise,
        f"{measured.value * 1e6:.4g} µrad, where the stated noise of an arc is {noise * 1e6:.4g}. {measured.sentence}",
        interval=ends((None if low is None else low / noise, None if high is None else high / noise)),
        incumbent=None if measured.incumbent is None else measured.incumbent / noise,
    )


def measure_finite(inputs: GateInputs) -> Measurement:
    """Ask for a plausible number for every parameter, and for a finite one or none for every sigma."""
    try:
        inputs.x  # noqa: B018 - reading it is the check
    except RefusedInputError as refusal:
        return answer("FAIL", str(refusal))
    sigma = inputs.candidate.sigma
    bad = [name for name in inputs.names if not _is_sigma(sigma.get(name))]
    if bad:
        return answer("FAIL", f"The sigma of {', '.join(bad)} is not a positive number: calibrate again.")
    return answer("PASS", "Every parameter is a finite number in its model's range.")


def _is_sigma(value: float | None) -> bool:
    return value is None or (math.isfinite(value) and value >= 0)


def measure_covariance(inputs: GateInputs) -> Measurement:
    """Ask for a symmetric, positive definite covariance whose roots are the sigmas."""
    stated = inputs.candidate.covariance
    try:
        P = inputs.spread(stated)
    except (RefusedInputError, ValueError):
        stated = None
    if stated is None:
        return answer("FAIL", "The covariance is not names and a square matrix of numbers: calibrate again.")
    places = [inputs.names.index(name) for name in stated.names]
    if not places:
        return answer("FAIL", "There is no covariance, so no sigma can be trusted: calibrate again with more frames.")
    return _measure_matrix(inputs, P[np.ix_(places, places)], [inputs.names[place] for place in places])


def _measure_matrix(inputs: GateInputs, P: np.ndarray, names: list[str]) -> Measurement:
    """Judge the covariance of the free parameters (n_free, n_free)."""
    variance = np.diag(P)
    if not np.isfinite(P).all() or (variance <= 0).any():
        return answer("FAIL", "The covariance has a variance that is not a positive number: calibrate again.")
    correlation = P / np.sqrt(np.outer(variance, variance))
    if not np.allclose(correlation, correlation.T, rtol=0, atol=ROUNDING):
        return answer("FAIL", "The covariance is not symmetric: calibrate again.")
    least = float(np.linalg.eigvalsh((correlation + correlation.T) / 2)[0])
    if least <= 0:
        return answer(
            "FAIL", f"The covariance is not positive definite (least eigenvalue {least:.2g}): free fewer parameters."
        )
    roots = dict(zip(names, np.sqrt(variance), strict=True))
    off = [name for name, root in roots.items() if _differs(inputs.candidate.sigma.get(name), root)]
    if off:
        return answer("FAIL", f"The sigma of {', '.join(off)} is not the root of its variance: calibrate again.")
    return answer("PASS", f"Symmetric and positive definite; least eigenvalue of the correlations {least:.2g}.")


def _differs(sigma: float | None, root: float) -> bool:
    return sigma is not None and sigma != 0 and abs(sigma - root) > 1e-3 * root


def measure_sensor(inputs: GateInputs) -> Measurement:
    """Ask whether set, run and sensor speak of one camera."""
    candidate, here = inputs.candidate, inputs.sensor
    if candidate.sensor not in (None, here.name):
        return answer(
            "FAIL", f"The set belongs to the sensor {candidate.sensor}, not to {here.name}: choose the right one."
        )
    if candidate.camera_model != here.camera_model:
        return answer(
            "FAIL",
            f"The set is of the camera model {candidate.camera_model}, the sensor of {here.camera_model}.",
        )
    made = inputs.made_with
    if made is None:
        return answer("PASS", f"Set and sensor agree: {here.name}, {here.camera_model}.")
    if any(getattr(made, name) != getattr(here, name) for name in ("rows", "columns", "pixel_pitch_m", "parity")):
        return answer("FAIL", f"Detector or parity of {here.name} differ from those of the run: run it again.")
    return answer(
        "PASS",
        f"Set, run and sensor agree: {here.name}, {here.camera_model}, {here.rows:,} × {here.columns:,} px.",
    )


def sigma_of_difference(variance: Any, typical: Any) -> FloatArray:
    """Return the sigmas of the differences of two sets from the sum of both variances, which `FLOOR` keeps from being nothing."""
    return np.asarray(np.sqrt(variance + (FLOOR * typical) ** 2))


def measure_parameter_shift(inputs: GateInputs) -> Measurement:
    """Measure the largest shift from the baseline, in sigmas of the difference."""
    if inputs.incumbent is None:
        return absent("There is no baseline to compare it with.")
    x_0 = inputs.incumbent.state[0]
    P, P_0 = (inputs.spread(one.reliable_covariance) for one in (inputs.candidate, inputs.incumbent))
    sigma = sigma_of_difference(np.diag(P) + np.diag(P_0), inputs.sensor.typical_sigma)
    shift = (inputs.x - x_0) / sigma
    i = int(np.argmax(np.abs(shift)))
    moved = sum(np.abs(shift) > 3)
    return Measurement(
        float(abs(shift[i])),
        f"{inputs.names[i]} changed most, by {shift[i]:+.1f} σ of the difference (both sets' sigmas with misfit); "
        f"{moved} of {len(shift)} parameters changed by more than 3 σ.",
    )


def measure_convergence(inputs: GateInputs) -> Measurement:
    """Ask whether the estimate came to rest."""
    status = str(inputs.candidate.status)
    return answer(
        *ENDED.get(status, ("FAIL", f"The run ended {status.replace('_', ' ')}: its numbers are not an estimate."))
    )


def measure_chi_square(inputs: GateInputs) -> Measurement:
    """Measure the residuals against the stated noise."""
    result = inputs.result
    if result is None or result.chi2_per_dof is None or result.chi2 is None:
        return absent(NO_RUN if result is None else "The run stored no chi-square: run it again.")
    why = LAST_FRAMES if explains_chi2(result) else ""
    return _around_one(result.chi2_per_dof, result.chi2, "The residuals", why)


def measure_nis(inputs: GateInputs) -> Measurement:
    """Measure a filter's innovations against what it expected; a batch has residuals in their place."""
    result = inputs.result
    if result is None or result.nis is None or result.nis.mean is None:
        return absent(NO_RUN if result is None else "The run stored no innovations: run it again.")
    what = "The innovations" if result.method in FILTERS else "A batch has no innovations; its residuals"
    return _around_one(result.nis.mean, result.nis, what)


def _around_one(value: float, test: ChiSquareTest | InnovationTest, what: str, why: str = "") -> Measurement:
    """Describe a mean square beside its 95 % bounds, and why it is there."""
    if test.lower is None or test.upper is None:
        return absent(INCOMPLETE)
    inside = "inside" if test.lower <= value <= test.upper else "outside"
    factor = f"{np.sqrt(value):.3g}"
    size = "as large as expected" if factor == "1" else f"{factor} times the expected size"
    return Measurement(
        float(value),
        f"{what} are {size}, {inside} the 95 % bounds for valid sets{f': {why}' if why else ''}.",
        bounds=(test.lower, test.upper),
    )


#: What a finding counts whose error in claimed sigmas is not known.
UNKNOWN_SIZE = 1.0
#: Tests that tell the size of a cause that is no displacement.
OF_STARS = ("outliers",)
#: And at least, so that what was noticed is never taken for nothing.
LEAST_SIZE = 1e-3
#: Share of removed identities beyond which the rest is in doubt: NEES was measured within its bounds up to as many gross outliers.
MOST_REMOVED = 0.1
NO_TESTS = "The run made no tests of the model: clone it and run it again to get them."


def measure_model_tests(name: str, inputs: GateInputs) -> Measurement:
    """Measure the largest error that the noticed tests of a gate tell of, in claimed sigmas; 0 where none noticed anything.

    What a cause explains counts once, for the gate of the cause and with the cause's own size.
    """
    if inputs.result is None or not inputs.result.tests:
        return absent(NO_RUN if inputs.result is None else NO_TESTS)
    made = sum(get_test_gate(test.name) == name for test in inputs.result.tests)
    found = [(size, sentence) for gate, size, sentence in _findings(inputs.result) if gate == name]
    if not made:
        return absent("None of these tests can be made with this set: add frames, times or magnitudes.")
    if not found:
        return Measurement(0.0, f"None of {made} tests shows such an error (joint false-alarm rate 1 %).")
    return Measurement(max(LEAST_SIZE, *(size for size, _ in found)), " ".join(sentence for _, sentence in found))


def measure_identities(inputs: GateInputs) -> Measurement:
    """Measure what wrong stars or directions do, and how many of the proposed identities were removed."""
    measured, of = measure_model_tests("identities", inputs), inputs.result.removed_of if inputs.result else None
    if of is None or of.removed <= MANY_REMOVED * of.proposed:
        return measured
    share = of.removed / of.proposed
    sentence = (
        f"{of.removed:,} of {of.proposed:,} proposed identities, {share:.1%}, contradict the other stars and were removed: the "
        "file's identification is faulty; match the stars again (match 'rematch')."
    )
    if share > MOST_REMOVED:
        return answer(
            "FAIL",
            f"{sentence} If more than {MOST_REMOVED:.0%} are removed, the remaining identities cannot be trusted either.",
        )
    if measured.value:
        return replace(measured, sentence=f"{sentence} {measured.sentence}")
    return answer("MARGINAL", sentence)


def _findings(result: Calibration) -> Iterator[tuple[str, float, str]]:
    """Gate, size in claimed sigmas and sentence of every cause, and of every noticed test that no cause explains."""
    noticed = {test.name: test for test in result.tests if test.noticed}
    for cause in result.causes:
        own = [
            noticed[name] for name in (cause.name, *OF_STARS) if name in noticed and name in (cause.name, *cause.tests)
        ]
        yield get_cause_gate(cause.name), _size(own), cause.sentence
    explained = {name for cause in result.causes for name in cause.tests}
    for name in noticed.keys() - explained:
        yield get_test_gate(name), _size([noticed[name]]), noticed[name].sentence


def _size(tests: Sequence[TrustTest]) -> float:
    known = [test.effect for test in tests if test.effect is not None]
    return known[0] if known else UNKNOWN_SIZE


def measure_arc_uncertainty(inputs: GateInputs) -> Measurement:
    """Measure what the covariance does to an arc at the worst place of the detector."""
    worst, degrees = _worst_arc(inputs, inputs.candidate)
    incumbent = None
    if inputs.incumbent is not None:
        incumbent = _worst_arc(inputs, inputs.incumbent)[0] / inputs.pixel_rad
    return Measurement(
        worst / inputs.pixel_rad,
        f"An arc of {degrees:.2g}° may be {worst * ARCSEC_PER_RAD:.2g} arcsec off (1 sigma) at the worst place of the detector.",
        incumbent=incumbent,
    )


def _worst_arc(inputs: GateInputs, known: AssessedSet) -> tuple[float, float]:
    """Largest sigma of an arc over the detector, rad, and the length of the arcs, degrees."""
    sigma, length = field_arc_sigma(inputs.sensor, known.state[0], inputs.spread(known.reliable_covariance))
    return float(np.nanmax(sigma)), float(np.degrees(length))


def measure_condition_number(inputs: GateInputs) -> Measurement:
    """Measure how unevenly the data see the parameters."""
    seen = inputs.result.observability if inputs.result else None
    if seen is None or seen.condition_number is None:
        return absent(
            NO_RUN if inputs.result is None else "The data do not determine one direction: free fewer parameters."
        )
    return Measurement(seen.condition_number, f"Largest over smallest of {len(seen.singular_values)} singular values.")


def measure_weak_directions(inputs: GateInputs) -> Measurement:
    """Measure how well the weakest direction is known, and name it."""
    seen = inputs.result.observability if inputs.result else None
    if seen is None or not seen.sigma_of_direction:
        return absent(NO_RUN if inputs.result is None else "The run stored no observability: run it again.")
    spread = [sigma for sigma in seen.sigma_of_direction if sigma is not None]
    if len(spread) < len(seen.sigma_of_direction):
        return absent("The data do not determine one direction: free fewer parameters.")
    return Measurement(max(spread), seen.weakest.sentence)


def measure_coverage(inputs: GateInputs) -> Measurement:
    """Measure in how many regions of the detector there were stars."""
    seen = inputs.result.coverage if inputs.result else None
    if seen is None:
        return absent(NO_RUN if inputs.result is None else "The run stored no coverage: run it again.")
    counts = np.array(seen.counts)
    regions = counts.reshape(ROWS, counts.shape[0] // ROWS, COLUMNS, counts.shape[1] // COLUMNS).sum(axis=(1, 3))
    held = int((regions > 0).sum())
    return Measurement(
        held / regions.size,
        f"{held} of {regions.size} regions ({counts.size // regions.size} cells of the coverage figure each) contain stars "
        f"(at most {regions.max():,}){'; elsewhere the model is extrapolated' if held < regions.size else ''}.",
    )


def measure_quantisation(inputs: GateInputs) -> Measurement:
    """Measure how far directions move when the table's number format rounds the parameters."""
    if inputs.definition is None:
        return absent(NO_DEFINITION)
    parameters = dict(zip(inputs.names, map(float, inputs.x), strict=True))
    try:
        definition = table_definition.parse_definition(inputs.definition, inputs.sensor)
        held = table_definition.quantised(definition, parameters)
    except RefusedInputError as refusal:
        return answer("FAIL", f"The table on board cannot hold this set: {refusal}")
    effect = table_definition.quantisation_effect(inputs.camera, inputs.sensor, parameters, held)
    return Measurement(
        float(effect["max_px"]),
        f"The table's number format changes directions by up to {effect['max_arcsec']:.2g} arcsec over the detector.",
    )


def measure_assumptions(inputs: GateInputs) -> Measurement:
    """Ask whether what the data cannot show was declared, and whether any of it was left in."""
    made = inputs.result.assumptions if inputs.result else []
    if not made:
        return absent(NO_RUN if inputs.result is None else "The run stored no assumptions: run it again.")
    undeclared = [one.sentence for one in made if not one.declared]
    if undeclared:
        return absent(f"{' '.join(undeclared)} Then run again.")
    left_in = [one.sentence for one in made if one.left_in]
    if left_in:
        return answer("MARGINAL", " ".join(left_in))
    declared = "; ".join(f"{one.name.replace('_', ' ')}: {one.value}" for one in made)
    return answer("PASS", f"What the data cannot show is declared: {declared}.")


@dataclass(frozen=True)
class Gate:
    """One question that a parameter set is asked, what measures it, and its thresholds in the default profile."""

    name: str
    title: str
    question: str
    direction: str
    measure: Callable[[Any], Measurement] = field(kw_only=True)
    unit: str = ""
    lowest: float = 0.0
    highest: float = 1e15
    critical: bool = False
    limit: float | None = None
    marginal: float | None = None

    @property
    def is_share(self) -> bool:
        """Tell whether its number is a share of a whole, which ends at 1."""
        return self.highest == 1.0


GATES = {
    gate.name: gate
    for gate in (
        Gate(
            "finite",
            "Finite values",
            "Is every parameter a plausible number?",
            "met",
            critical=True,
            measure=measure_finite,
        ),
        Gate(
            "covariance",
            "Covariance",
            "Is the covariance symmetric and positive definite, and do the sigmas match it?",
            "met",
            critical=True,
            measure=measure_covariance,
        ),
        Gate(
            "sensor",
            "Right sensor",
            "Is it of this sensor, camera model and detector?",
            "met",
            critical=True,
            measure=measure_sensor,
        ),
        Gate("convergence", "Convergence", "Did the estimate converge?", "met", measure=measure_convergence),
        Gate(
            "validation-rms",
            "Validation RMS",
            "How large are the arc errors on validation frames, in multiples of the stated noise of an arc?",
            "below",
            "× noise",
            measure=_measure_rms_in_noise,
            limit=3.0,
            marginal=1.5,
        ),
        Gate(
            "validation-rms-incumbent",
            "Validation RMS vs baseline",
            "What is the ratio of the validation RMS to the baseline's, on the same arcs?",
            "below",
            "× baseline",
            measure=partial(_measure_against_incumbent, "validation-rms-incumbent"),
            limit=1.05,
            marginal=1.05,
        ),
        Gate(
            "availability",
            "Availability",
            "In what share of the validation frames would the flight code find an attitude?",
            "above",
            "of frames",
            highest=1.0,
            measure=partial(_measure_score, "availability"),
            limit=0.25,
            marginal=0.9,
        ),
        Gate(
            "availability-incumbent",
            "Availability vs baseline",
            "How does availability change compared with the baseline? Below 0, frames are lost.",
            "above",
            "of frames",
            lowest=-1.0,
            highest=1.0,
            measure=partial(_measure_against_incumbent, "availability-incumbent"),
            limit=-0.02,
            marginal=-0.02,
        ),
        Gate(
            "matched-stars",
            "Matched stars",
            "How many matches per validation frame would the flight code accept?",
            "above",
            "per frame",
            measure=partial(_measure_score, "matched-stars"),
            limit=2.0,
            marginal=6.0,
        ),
        Gate(
            "matched-stars-incumbent",
            "Matched stars vs baseline",
            "How does the number of matched stars per frame change compared with the baseline? Below 0, stars are lost.",
            "above",
            "per frame",
            lowest=-1000.0,
            measure=partial(_measure_against_incumbent, "matched-stars-incumbent"),
            limit=-0.3,
            marginal=-0.3,
        ),
        Gate(
            "chi-square",
            "χ² per degree of freedom",
            "Are the residuals as large as the stated noise?",
            "around",
            lowest=1.0,
            measure=measure_chi_square,
            limit=9.0,
            marginal=1.1,
        ),
        Gate(
            "lens-structure",
            "Lens structure",
            "How large is the effect, in noise σ, of a deviation found by the lens, skew or readout tests?",
            "below",
            "noise σ",
            measure=partial(measure_model_tests, "lens-structure"),
            limit=MATTERS,
            marginal=0.0,
        ),
        Gate(
            "stability",
            "Stability",
            "How large is the effect, in noise σ, of a change with time or temperature found by a test?",
            "below",
            "noise σ",
            measure=partial(measure_model_tests, "stability"),
            limit=MATTERS,
            marginal=0.0,
        ),
        Gate(
            "centroid-noise",
            "Centroid noise",
            "How large is the effect, in noise σ, of a noise, pixel phase, brightness or colour error found by a test?",
            "below",
            "noise σ",
            measure=partial(measure_model_tests, "centroid-noise"),
            limit=MATTERS,
            marginal=0.0,
        ),
        Gate(
            "identities",
            "Identities and directions",
            "How large is the effect, in noise σ, of wrong stars or directions found by a test?",
            "below",
            "noise σ",
            measure=measure_identities,
            limit=MATTERS,
            marginal=0.0,
        ),
        Gate(
            "nis",
            "Innovations (NIS)",
            "Are a filter's sigmas right?",
            "around",
            lowest=1.0,
            measure=measure_nis,
            limit=9.0,
            marginal=1.1,
        ),
        Gate(
            "parameter-shift",
            "Parameter shift",
            "How far is it from the baseline, in sigmas of the difference?",
            "below",
            "σ of the difference",
            measure=measure_parameter_shift,
            marginal=15.0,  # of the difference's own sigmas, not of typical ones as `FAR_TYPICAL_SIGMAS`
        ),
        Gate(
            "arc-uncertainty",
            "Arc uncertainty",
            "What is the uncertainty of an arc at the worst place of the detector, from the covariance alone?",
            "below",
            "px",
            measure=measure_arc_uncertainty,
            marginal=0.5,
        ),
        Gate(
            "condition-number",
            "Condition number",
            "How unevenly do the data determine the parameters?",
            "below",
            measure=measure_condition_number,
            marginal=1e5,
        ),
        Gate(
            "weak-directions",
            "Weakest direction",
            "How well is the weakest combination of parameters known, in typical sigmas?",
            "below",
            "typical σ",
            measure=measure_weak_directions,
            marginal=WEAK,
        ),
        Gate(
            "coverage",
            "Detector coverage",
            "What share of the detector's 48 regions contains stars?",
            "above",
            "of regions",
            highest=1.0,
            measure=measure_coverage,
            marginal=0.7,
        ),
        Gate(
            "quantisation",
            "Quantisation",
            "How much does the number format on board change a direction, anywhere on the detector?",
            "below",
            "px",
            measure=measure_quantisation,
            limit=0.1,
            marginal=0.01,
        ),
        Gate(
            "assumptions",
            "Assumptions",
            "Are the properties that no data can show declared: readout, satellite velocity, directions, refraction, lens and "
            "centroids?",
            "met",
            measure=measure_assumptions,
        ),
    )
}


def measure(inputs: GateInputs) -> dict[str, Measurement]:
    """Measure everything that the gates ask, by gate."""
    return {gate.name: _measure_gate(gate.measure, inputs) for gate in GATES.values()}


def _measure_gate(function: Callable[[GateInputs], Measurement], inputs: GateInputs) -> Measurement:
    """Measure for one gate; what cannot be had is absent, with the reason."""
    try:
        return _finite(function(inputs))
    except RefusedInputError as refusal:
        return absent(str(refusal))
    except (AttributeError, LookupError, TypeError, ValueError, np.linalg.LinAlgError):
        return absent(INCOMPLETE)


def _finite(measured: Measurement) -> Measurement:
    """Return a measurement whose value is a number, or none at all."""
    if measured.value is not None and not np.isfinite(measured.value):
        return absent(f"This is not a finite number for this set. {measured.sentence}")
    if measured.incumbent is not None and not np.isfinite(measured.incumbent):
        return replace(measured, incumbent=None)
    return measured
