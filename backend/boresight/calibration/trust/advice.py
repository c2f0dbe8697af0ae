"""What the trust numbers ask a person to do: the sentences worth telling, the gravest first."""

from __future__ import annotations

from collections.abc import Iterator

from boresight.calibration.calibration import ResidualAgainst, ResidualDependence, Trust
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


def trust_advice(trust: Trust) -> list[str]:
    """Collect the sentences that call for something, from the object that `trust_view` gives."""
    return [*_of_geometry(trust), *_of_the_estimate(trust), *_of_the_model(trust), *_of_spare_parameters(trust)]


def _of_geometry(trust: Trust) -> Iterator[str]:
    """A mirrored detector is graver than anything else."""
    sentence = trust.unavailable.get("residuals", "")
    if sentence in OTHER_PARITY.values():
        yield sentence


def _of_the_estimate(trust: Trust) -> Iterator[str]:
    """Halves that differ, and sigmas below the bound."""
    halves, efficiency = trust.two_halves, trust.efficiency
    if halves is not None and halves.chi2.p < UNLIKELY:
        yield halves.sentence
    if efficiency is not None and efficiency.overall_ratio < TOO_SMALL:
        yield efficiency.sentence


def _of_the_model(trust: Trust) -> Iterator[str]:
    """A model that does not fit; drift and stars can only be judged under one that does."""
    against, spline = trust.residual_against or ResidualAgainst(), trust.residual_spline
    if spline is not None and spline.structure:
        yield spline.sentence
    if any(_uneven(against, ("radius",))):
        yield from _uneven(against, ("radius",))
        yield MISFIT
        return
    yield from _of_time(trust, against)
    if trust.suspects and trust.stars_sentence is not None:
        yield trust.stars_sentence
    yield from _uneven(against, ("magnitude",))


def _of_time(trust: Trust, against: ResidualAgainst) -> Iterator[str]:
    """Drift, and innovations that keep no bounds."""
    white, over_time = trust.whiteness, trust.nis_over_time
    if white is not None and not white.white:
        yield white.sentence
    yield from _uneven(against, ("temperature", "time"))
    if over_time is not None and not over_time.consistent:
        yield over_time.sentence


def _of_spare_parameters(trust: Trust) -> Iterator[str]:
    """Parameters the data do not ask for; one alone may have started near its truth by luck."""
    if sum(not entry.needed for entry in trust.drop_one or ()) >= SEVERAL and trust.drop_one_sentence is not None:
        yield trust.drop_one_sentence


def _uneven(against: ResidualAgainst, names: tuple[str, ...]) -> list[str]:
    """Sentences of the quantities that the residual depends on."""
    found: list[ResidualDependence | None] = [getattr(against, name) for name in names]
    return [one.sentence for one in found if one is not None and not one.even]
