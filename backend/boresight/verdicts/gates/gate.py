"""The gates: what each asks, in which unit, and which side of a limit is good.

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

from dataclasses import dataclass

DIRECTIONS = ("below", "above", "around", "met")


@dataclass(frozen=True)
class Gate:
    """One question that a parameter set is asked."""

    name: str
    title: str
    question: str
    direction: str
    unit: str = ""
    lowest: float = 0.0
    highest: float = 1e15
    critical: bool = False


GATES = {
    gate.name: gate
    for gate in (
        Gate("finite", "Finite values", "Is every parameter a plausible number?", "met", critical=True),
        Gate(
            "covariance",
            "Covariance",
            "Is the covariance symmetric and positive definite, and are the sigmas its own?",
            "met",
            critical=True,
        ),
        Gate("sensor", "Right sensor", "Is it of this sensor, camera model and detector?", "met", critical=True),
        Gate("convergence", "Convergence", "Did the estimate come to rest?", "met"),
        Gate(
            "validation-rms",
            "Validation RMS",
            "How large are the arc errors on held-out frames, in multiples of the stated noise of an arc?",
            "below",
            "× noise",
        ),
        Gate(
            "validation-rms-incumbent",
            "Validation RMS, to incumbent",
            "How large are they beside the incumbent's, on the very same arcs?",
            "below",
            "× incumbent",
        ),
        Gate(
            "availability",
            "Availability",
            "In which share of the held-out frames would the flight code find an attitude?",
            "above",
            "of frames",
            highest=1.0,
        ),
        Gate(
            "availability-incumbent",
            "Availability, to incumbent",
            "By which share of the frames does that change? Below 0 frames are lost.",
            "above",
            "of frames",
            lowest=-1.0,
            highest=1.0,
        ),
        Gate(
            "matched-stars",
            "Matched stars",
            "How many matches a held-out frame would the flight code accept?",
            "above",
            "a frame",
        ),
        Gate(
            "matched-stars-incumbent",
            "Matched stars, to incumbent",
            "How many more than with the incumbent? Below 0 stars are lost.",
            "above",
            "a frame",
            lowest=-1000.0,
        ),
        Gate(
            "chi-square",
            "χ² per degree of freedom",
            "Are the residuals as large as the stated noise?",
            "around",
            lowest=1.0,
        ),
        Gate("nis", "Innovations (NIS)", "Is a filter as sure as it may be?", "around", lowest=1.0),
        Gate("parameter-shift", "Parameter shift", "How far is it from the incumbent, in sigmas?", "below", "σ"),
        Gate(
            "arc-uncertainty",
            "Arc uncertainty",
            "How far wrong may an arc be at the worst place of the detector, by the covariance alone?",
            "below",
            "px",
        ),
        Gate("condition-number", "Condition number", "How unevenly do the data see the parameters?", "below"),
        Gate(
            "weak-directions",
            "Weakest direction",
            "How well is the weakest combination of parameters known, in typical sigmas?",
            "below",
            "typical σ",
        ),
        Gate(
            "coverage",
            "Detector coverage",
            "In which share of the detector's 48 regions were stars?",
            "above",
            "of regions",
            highest=1.0,
        ),
        Gate(
            "quantisation",
            "Quantisation",
            "How far does the number format on board move a direction, anywhere on the detector?",
            "below",
            "px",
        ),
    )
}
