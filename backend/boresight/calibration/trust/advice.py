"""What the trust numbers ask a person to do: the sentences worth telling, the gravest first."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from boresight.calibration.trust.residuals import OTHER_PARITY

#: The claimed sigmas over the bound below which they are too small to be honest.
TOO_SMALL = 0.97
#: Chance of halves so far apart below which a person should hear of it; one set in forty is beyond its 95 % bound.
UNLIKELY = 0.01
#: So many spare parameters mean a set too small for the model rather than a lucky start.
SEVERAL = 2
MISFIT = (
    "A camera model that leaves a radial residual hides what else there may be: free more parameters before drift, time and "
    "stars are judged."
)


def trust_advice(trust: Mapping[str, Any]) -> list[str]:
    """Collect the sentences that call for something, from the object that `trust_view` gives."""
    return [*_of_geometry(trust), *_of_the_estimate(trust), *_of_the_model(trust), *_of_spare_parameters(trust)]


def _of_geometry(trust: Mapping[str, Any]) -> Iterator[str]:
    """A mirrored detector is graver than anything else."""
    sentence = trust["unavailable"].get("residuals", "")
    if sentence in OTHER_PARITY.values():
        yield sentence


def _of_the_estimate(trust: Mapping[str, Any]) -> Iterator[str]:
    """Halves that differ, and sigmas below the bound."""
    halves, efficiency = trust["two_halves"], trust["efficiency"]
    if halves is not None and halves["chi2"]["p"] < UNLIKELY:
        yield halves["sentence"]
    if efficiency is not None and efficiency["overall_ratio"] < TOO_SMALL:
        yield efficiency["sentence"]


def _of_the_model(trust: Mapping[str, Any]) -> Iterator[str]:
    """A model that does not fit; drift and stars can only be judged under one that does."""
    against, spline = trust["residual_against"] or {}, trust["residual_spline"]
    if spline is not None and spline["structure"]:
        yield spline["sentence"]
    if any(_uneven(against, ("radius",))):
        yield from _uneven(against, ("radius",))
        yield MISFIT
        return
    yield from _of_time(trust, against)
    if trust["suspects"]:
        yield trust["stars_sentence"]
    yield from _uneven(against, ("magnitude",))


def _of_time(trust: Mapping[str, Any], against: Mapping[str, Any]) -> Iterator[str]:
    """Drift, and innovations that keep no bounds."""
    white, over_time = trust["whiteness"], trust["nis_over_time"]
    if white is not None and not white["white"]:
        yield white["sentence"]
    yield from _uneven(against, ("temperature", "time"))
    if over_time is not None and not over_time["consistent"]:
        yield over_time["sentence"]


def _of_spare_parameters(trust: Mapping[str, Any]) -> Iterator[str]:
    """Parameters the data do not ask for; one alone may have started near its truth by luck."""
    if sum(not entry["needed"] for entry in trust["drop_one"] or ()) >= SEVERAL:
        yield trust["drop_one_sentence"]


def _uneven(against: Mapping[str, Any], names: tuple[str, ...]) -> list[str]:
    """Sentences of the quantities that the residual depends on."""
    return [against[name]["sentence"] for name in names if against.get(name) is not None and not against[name]["even"]]
