"""The gates of an alignment: enough pairs, residuals as large as they say, known well enough, and no change that is not in it.

They are judged as the gates of a parameter set are (`judgement`), by limits that a profile may change. The default limit of the
angles is that of a tracker of arcseconds; nobody but the mission knows how well it must know its frames. A trend that is not in the
alignment is measured by the chance of its chi-square: below one in a hundred a person judges, below one in ten thousand it fails.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from boresight.calibration.alignment.result import AXES, Alignment
from boresight.errors import RefusedInputError
from boresight.verdicts.gates.judgement import GateReport, judge
from boresight.verdicts.gates.measurements import Gate, Measurement, absent, answer, ends
from boresight.verdicts.gates.profile import Profile, parse_profile

#: Chances of a trend's chi-square without a trend.
SURE, NOTICED = 1e-4, 1e-2


def _measure_pairs(found: Alignment) -> Measurement:
    return Measurement(float(found.pairs_used), f"{found.pairs_used:,} of {found.pairs:,} pairs take part.")


def _measure_removed(found: Alignment) -> Measurement:
    removed = found.pairs - found.pairs_used
    return Measurement(removed / found.pairs, f"{removed:,} of {found.pairs:,} pairs were left out as too far off.")


def _measure_chi_square(found: Alignment) -> Measurement:
    test = found.test
    if test.ratio is None or test.lower is None or test.upper is None:
        return absent("Too few pairs to compare them with each other: give more.")
    inside = "inside" if test.lower <= test.ratio <= test.upper else "outside"
    return Measurement(
        test.ratio,
        f"The scatter of the pairs is {test.ratio**0.5:.3g} times the predicted value, {inside} the 95 % bounds for valid data.",
        bounds=ends((test.lower, test.upper)),
    )


def _worst(sigma: list[float], sentence: str) -> Measurement:
    worst = max(range(3), key=lambda axis: sigma[axis])
    return Measurement(sigma[worst], f"The least well known angle is about {AXES[worst]}{sentence}")


def _measure_load(found: Alignment) -> Measurement:
    return _worst(found.to_load.sigma_arcsec, ", if it is loaded together with these parameters.")


def _measure_frames(found: Alignment) -> Measurement:
    return _worst(
        found.sigma_with_misfit_arcsec, ", including the cameras' errors, which another calibration could change."
    )


def _measure_trend(kind: str, unknown: str) -> Callable[[Alignment], Measurement]:
    def measure(found: Alignment) -> Measurement:
        beside = [one for one in found.tests if one.kind == kind]
        modelled = {one.name for one in found.terms}
        left = [one for one in beside if one.name not in modelled]
        if not left:
            if any(one.kind == kind for one in found.terms):
                return answer("PASS", f"The alignment already models its change with {kind}; there is nothing to test.")
            return absent(unknown)
        return Measurement(
            left[-1].p,
            f"A change with {kind} beyond what the alignment models would lower chi-square by {left[-1].fall:.3g} for three "
            "degrees of freedom; this gate measures the probability of that occurring by chance.",
        )

    return measure


def _measure_cameras(found: Alignment) -> Measurement:
    for side in (found.a, found.b):
        if side.parameters == "none":
            return answer("FAIL", f"The parameters of {side.name} have no covariance: give a calibration.")
    for side in (found.a, found.b):
        if side.parameters == "typical":
            return answer("MARGINAL", f"{side.name} was solved with its sensor file's parameters: calibrate it first.")
    return answer("PASS", "The covariance of every camera takes part.")


ALIGNMENT_GATES = {
    gate.name: gate
    for gate in (
        Gate(
            "pairs", "Pairs", "How many pairs of attitudes take part?", "above", "pairs",
            measure=_measure_pairs, limit=3.0, marginal=20.0,
        ),
        Gate(
            "removed-pairs", "Removed pairs", "What share of the pairs was left out as too far off?", "below", "of pairs",
            highest=1.0, measure=_measure_removed, limit=0.25, marginal=0.05,
        ),
        Gate(
            "pair-scatter", "χ² of pairs per degree of freedom",
            "Is the scatter of the pairs as predicted by the stars and the reference?", "around", lowest=1.0,
            measure=_measure_chi_square, limit=9.0, marginal=1.1,
        ),
        Gate(
            "angles", "Worst known angle, to load", "How well is the worst of the three angles known, one sigma?",
            "below", "arcsec", measure=_measure_load, limit=60.0, marginal=20.0,
        ),
        Gate(
            "angles-between-frames", "Worst known angle, between frames",
            "How well is the worst angle known if the cameras are recalibrated, one sigma?", "below", "arcsec",
            measure=_measure_frames, marginal=300.0,
        ),
        Gate(
            "temperature-trend", "Change with temperature", "Is there a change with temperature that the alignment does not model?",
            "above", "chance", highest=1.0, limit=SURE, marginal=NOTICED,
            measure=_measure_trend(
                "temperature", "Temperature is unknown or hardly changed: include passes at other temperatures."
            ),
        ),
        Gate(
            "time-trend", "Change with time", "Is there a change with time that the alignment does not model?",
            "above", "chance", highest=1.0, limit=SURE, marginal=NOTICED,
            measure=_measure_trend("time", "The pairs lie within half an hour: include a longer time."),
        ),
        Gate(
            "cameras", "Cameras", "Do the covariances of both cameras take part?", "met", measure=_measure_cameras,
        ),
    )
}  # fmt: skip


def parse_alignment_profile(document: Mapping[str, Any] | None = None) -> Profile:
    """Read a profile of these gates; what it leaves out is as by default."""
    return parse_profile(document or {}, ALIGNMENT_GATES)


def measure_alignment(found: Alignment) -> dict[str, Measurement]:
    """Measure what the gates ask of an alignment, by gate."""
    return {gate.name: _measure_gate(gate, found) for gate in ALIGNMENT_GATES.values()}


def _measure_gate(gate: Gate, found: Alignment) -> Measurement:
    try:
        return gate.measure(found)
    except RefusedInputError as refusal:
        return absent(str(refusal))


def judge_alignment(found: Alignment, profile: Profile | None = None) -> GateReport:
    """Answer every gate of an alignment."""
    return judge(profile or parse_alignment_profile(), measure_alignment(found), ALIGNMENT_GATES)
