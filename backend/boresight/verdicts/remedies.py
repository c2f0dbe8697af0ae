"""What can be done about a result's doubts: each remedy that another run can try, with the settings that it changes.

Remedies follow from what the result says in numbers and names, its weak directions, its causes, its suspects and its status, and
never from the sentences that tell a person of them. Each opens a launch form that is filled in, and nothing runs by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from boresight.calibration.advice import STRAIGHT, is_overconfident, to_hold
from boresight.calibration.calibration import Calibration
from boresight.calibration.trust.advice import OF_THE_LENS
from boresight.estimation.statistics.observability import WEAK
from boresight.verdicts.numbers import count, quantity

#: More iterations than the form begins with, for a fit that was still moving.
MORE_ITERATIONS = 200
_MATCH_AGAIN = ("Clone with the stars matched again", {"match": "rematch"})
_FOLLOW = ("Clone as a filter with process noise", {"method": "sqrf", "variant": "q"})
_NOISE = ("Clone with noise from the data", {"noise_model": "from-data"})
#: What the button that answers a cause says, and its settings.
OF_CAUSES: Mapping[str, tuple[str, dict[str, str]]] = {
    **dict.fromkeys(("drift", "trend", "time", "temperature"), _FOLLOW),
    **dict.fromkeys(("magnitude", "colour", "phase", "noise"), _NOISE),
    "identities": _MATCH_AGAIN,
    "tails": ("Clone with the robust loss by stars", {"robust": "stars"}),
}
MOST_STARS_NAMED = 20


@dataclass(frozen=True)
class Remedy:
    """Something to try.

    `label`: of its button. `settings`: what the launch form begins with in place of the run's own. `free`: parameters to free,
    where that is what changes. `part`: the part of the run's page that leads on, where no run does.
    """

    label: str
    settings: Mapping[str, str] = field(default_factory=dict)
    free: tuple[str, ...] | None = None
    part: str = ""


def list_remedies(result: Calibration | None) -> list[Remedy]:
    """List what may be tried, each once, what answers the gravest doubt first."""
    if result is None or result.status in {"running", "too_few_stars"}:
        return []
    found = [
        *_remedy_status(result),
        *_remedy_causes(result),
        *_remedy_suspects(result),
    ]
    weak = list(_remedy_weak_directions(result))
    found += weak or _remedy_spare(result)
    settings = result.inputs.settings
    return list(
        {
            one.label: one
            for one in found
            if one.free is not None or one.part or any(str(getattr(settings, k)) != v for k, v in one.settings.items())
        }.values()
    )


def _remedy_status(result: Calibration) -> Iterator[Remedy]:
    if result.status == "max_iterations":
        yield Remedy("Clone with more iterations", {"max_iterations": str(MORE_ITERATIONS)})
    if result.status == "diverged":
        yield Remedy(*_MATCH_AGAIN)
    nis = result.nis
    if result.variant is None or nis is None or nis.mean is None or nis.upper is None:
        return
    if is_overconfident(nis.mean, nis.upper, result.chi2_per_dof or 0.0):
        yield Remedy("Clone as a batch", {"method": "batch"})


def _remedy_causes(result: Calibration) -> Iterator[Remedy]:
    for cause in result.causes:
        if cause.name in OF_THE_LENS:
            yield Remedy("Choose a model", part="distortion")
        elif cause.name in OF_CAUSES:
            yield Remedy(*OF_CAUSES[cause.name])


def _remedy_suspects(result: Calibration) -> Iterator[Remedy]:
    suspects = result.trust.suspects if result.trust else []
    if suspects and len(suspects) <= MOST_STARS_NAMED:
        stars = ",".join(map(str, sorted({*result.inputs.settings.leave_out_stars, *suspects})))
        words = "this star" if len(suspects) == 1 else f"these {count(len(suspects))} stars"
        yield Remedy(f"Leave out {words}", {"leave_out_stars": stars})


def _remedy_spare(result: Calibration) -> Iterator[Remedy]:
    """Hold the parameter that costs least, where the data give no evidence that it changed."""
    entries = (result.trust.drop_one if result.trust else None) or []
    spare = [one for one in entries if not one.needed and one.settled]
    if spare and result.status != "diverged" and len(result.free) > 1:
        least = min(spare, key=lambda one: one.chi2_increase).name
        yield Remedy(
            f"Clone with {quantity(least, result).symbol} held fixed",
            free=tuple(name for name in result.free if name != least),
        )


def _remedy_weak_directions(result: Calibration) -> Iterator[Remedy]:
    """Hold so few parameters that every direction of the others is known, and so well that no curvature shows where one did."""
    seen = result.observability
    if seen is None or not seen.singular_values or result.status == "diverged":
        return
    s, V = np.array(seen.singular_values, float), np.array(seen.right_singular_vectors, float)
    if V.shape != (len(s), len(result.free)):
        return
    held = to_hold((V.T * s**2) @ V, STRAIGHT if "curved" in result.advice_codes else WEAK)
    if not held or len(held) == len(result.free):
        return
    names = [result.free[place] for place in held]
    symbols = [quantity(name, result).symbol for name in names]
    free = tuple(name for name in result.free if name not in names)
    yield Remedy(f"Clone with {', '.join(symbols)} held fixed", free=free)
