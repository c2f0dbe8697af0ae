"""Every kind of advice by its code: what it is about. The guide `docs/how-to/respond-to-advice.md` has a section for each.

A sentence says what a person should know of these data; its code says to code and pages which kind of sentence it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, Self

#: A sentence on a cause has the code `CAUSE` with the cause's name.
CAUSE = "cause_"
ADVICE_KINDS = {
    "alignment_clock": "an alignment whose two clocks differ, or may",
    "alignment_covariance": "a side of an alignment whose parameters have no covariance",
    "alignment_parameters": "a side of an alignment without a calibration",
    "alignment_removed": "pairs of an alignment that were left out",
    "alignment_scatter": "pairs of an alignment that scatter",
    "alignment_temperature": "an alignment whose temperature dependence is unknown",
    "chi_square": "residuals that are larger or smaller than the noise says",
    "cosine": "what the cosine error costs",
    "coverage": "parts of the detector without stars",
    "curved": "a covariance that is wrong along the weakest direction",
    "diagnosis": "why a set barely matches",
    "distant_start": "one linearisation from a distant start",
    "diverged": "a fit that diverged",
    "drop_one": "parameters without evidence of a change",
    "efficiency": "sigmas below the bound",
    "few_frames": "a set of few frames",
    "filter_states": "a filter that tries impossible states",
    "gain_form": "a gain taken over fewer numbers",
    "ground_calibration": "parameters that were declared",
    "identities": "given identities that do not agree with the sensor",
    "judged_on": "a part of a large set that was judged",
    "large_change": "a large change from the start",
    "max_iterations": "a fit that had not converged",
    "minima": "another minimum",
    "misfit": "sigmas that misfit widens",
    "nis": "a filter that is over-confident",
    "nis_over_time": "innovations that change over the set",
    "off_detector": "stars outside the detector",
    "one_update": "a filter that used all frames at once",
    "overclaim": "a filter that claims too much information",
    "parity": "a mirrored detector",
    "prior": "how much of the result comes from a prior",
    "prior_contradicted": "data that contradict a prior",
    "rank_deficient": "parameters that these data do not determine",
    "removed": "identities that were removed",
    "residual_against": "a residual that depends on something",
    "residual_spline": "a smooth pattern that the camera model leaves",
    "robust": "what a robust loss changed",
    "running": "a run in progress",
    "stars": "stars that are suspect",
    "tests": "tests that found a deviation",
    "too_few_arcs": "no more arcs than parameters",
    "too_few_stars": "a set from which nothing could be estimated",
    "trend_coarse": "newer data that are too few",
    "trend_drift": "a baseline that is no longer valid",
    "trend_ground": "a baseline that was made on the ground",
    "trend_ground_shift": "calibrations that agree with one another but not with the ground calibration",
    "trend_halved": "newer data that would halve every sigma",
    "trend_jump": "a calibration that disagrees with all earlier ones",
    "trend_no_baseline": "a sensor without a baseline",
    "trend_no_data": "a baseline with no telemetry after it",
    "trend_old": "an old baseline",
    "trend_untested": "telemetry that was not calibrated yet",
    "trend_valid": "a baseline that is still valid",
    "two_halves": "halves of the set that differ",
    "validation_rms": "a validation set on which nothing improved",
    "variation": "parameters that vary between passes",
    "weakest_direction": "a weakly determined direction",
    "whiteness": "innovations that follow a pattern",
    "wrong_sensor": "telemetry that is probably of another sensor",
}


class Advice(str):
    """A sentence that knows of which kind it is, and what was found; no code where a result of an earlier version says none.

    `finding`: what was found, without how it is known and what to do; empty where the kind says it as well.
    """

    __slots__ = ("code", "finding")
    code: str
    finding: str

    def __new__(cls, sentence: str, code: str = "", finding: str = "") -> Self:
        """Make one of a kind that there is."""
        if code and code not in ADVICE_KINDS and not code.startswith(CAUSE):
            raise ValueError(f"Expected a code of ADVICE_KINDS. Received: {code!r}.")
        made = super().__new__(cls, sentence)
        made.code, made.finding = code, finding
        return made

    @classmethod
    def begin(cls, code: str, finding: str, rest: str) -> Self:
        """Make a sentence that begins with what was found."""
        return cls(f"{finding}{rest}", code, finding)


def make_advice(code: str, sentences: Iterable[str]) -> list[Advice]:
    """Give sentences their kind."""
    return [Advice(one, code) for one in sentences]


def with_codes(sentences: Iterable[str], codes: list[str]) -> list[Advice]:
    """Put sentences that were read beside their codes; one of a kind that this version does not know has none."""
    said = list(sentences)
    listed = codes if len(codes) == len(said) else [""] * len(said)
    return [
        one if isinstance(one, Advice) else Advice(one, code if code in ADVICE_KINDS or code.startswith(CAUSE) else "")
        for one, code in zip(said, listed, strict=True)
    ]


def list_codes(sentences: Iterable[str]) -> list[str]:
    """Return the code of each sentence."""
    return [one.code if isinstance(one, Advice) else "" for one in sentences]


class Advised(Protocol):
    """A result with advice, and the code of each sentence."""

    @property
    def advice(self) -> list[str]:
        """The sentences."""

    @property
    def advice_codes(self) -> list[str]:
        """The code of each."""


def join_codes(result: Advised) -> None:
    """Put what was read of a result's advice beside its codes; the result is frozen to everybody else."""
    said = with_codes(result.advice, result.advice_codes)
    object.__setattr__(result, "advice", said)
    object.__setattr__(result, "advice_codes", list_codes(said))
