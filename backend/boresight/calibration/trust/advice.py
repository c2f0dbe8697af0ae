"""What the trust numbers ask a person to do: the sentences worth telling, the likeliest cause first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from boresight.calibration.calibration import Cause, Trust
from boresight.calibration.trust.residuals import OTHER_PARITY

#: The claimed sigmas over the bound below which they are too small to be honest.
TOO_SMALL = 0.97
#: So many spare parameters mean a set too small for the model rather than a lucky start.
SEVERAL = 2
#: Causes of which the stars' own sentence says more, for it names them.
OF_STARS = ("places", "identities")


def cause_advice(trust: Trust, causes: Sequence[Cause]) -> list[str]:
    """Say what explains the tests that noticed something; it comes before all other advice."""
    return [*_of_geometry(trust), *_of_causes(trust, causes)]


def trust_advice(trust: Trust) -> list[str]:
    """Collect what else in the trust calls for something."""
    return [*_of_the_estimate(trust), *_of_spare_parameters(trust)]


def _of_geometry(trust: Trust) -> Iterator[str]:
    """A mirrored detector is graver than anything else."""
    sentence = trust.unavailable.get("residuals", "")
    if sentence in OTHER_PARITY.values():
        yield sentence


def _of_causes(trust: Trust, causes: Sequence[Cause]) -> Iterator[str]:
    """What explains the tests that noticed something, the likeliest first."""
    for place, cause in enumerate(causes):
        opening = (
            "Besides: " if place else f"Likeliest cause ({cause.likelihood:.0%}): " if cause.likelihood < 0.995 else ""
        )
        yield f"{opening}{cause.sentence} {cause.remedy}"
        if cause.name in OF_STARS and trust.suspects and trust.stars_sentence is not None:
            yield trust.stars_sentence


def _of_the_estimate(trust: Trust) -> Iterator[str]:
    """Sigmas below the bound."""
    efficiency = trust.efficiency
    if efficiency is not None and efficiency.overall_ratio < TOO_SMALL:
        yield efficiency.sentence


def _of_spare_parameters(trust: Trust) -> Iterator[str]:
    """Parameters the data do not ask for; one alone may have started near its truth by luck."""
    if sum(not entry.needed for entry in trust.drop_one or ()) >= SEVERAL and trust.drop_one_sentence is not None:
        yield trust.drop_one_sentence
