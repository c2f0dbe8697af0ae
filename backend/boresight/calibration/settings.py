"""The choices of a calibration, as a document a person can read and a machine can check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from boresight.errors import RefusedInputError
from boresight.estimation.filters import FILTERS

METHODS = ("batch", *FILTERS)
VARIANTS = ("no-q", "q")
MATCHES = ("given",)


@dataclass(frozen=True)
class CalibrationSettings:
    """What to estimate and how.

    Parameters
    ----------
    method
        `batch`, or a filter of `estimation.filters.FILTERS`.
    variant
        `no-q` holds the parameters constant; `q` adds process noise between frames, to follow drift.
    free
        Names of the parameters to estimate; None takes the sensor's own list.
    match
        `given`: the star identities of the file.
    minimum_stars
        Exposures with fewer matched stars are left out (E: N_min = 4).
    max_iterations
        Of the batch estimator.
    linearisations
        Most linearisations a frame of a filter; 1 is the filter as printed, which is over-confident.
    process_noise_sigma
        Of `q`: standard deviation added a frame, in typical sigmas.
    initial_sigma_scale
        Standard deviation of a filter's start, in typical sigmas.
    replay_frames_per_s
        Pace at which a filter takes frames in, to watch a downlink as it would come; 0 is as fast as the machine can.
    """

    method: str = "batch"
    variant: str = "no-q"
    free: tuple[str, ...] | None = None
    match: str = "given"
    minimum_stars: int = 4
    max_iterations: int = 50
    linearisations: int = 6
    process_noise_sigma: float = 0.02
    initial_sigma_scale: float = 10.0
    replay_frames_per_s: float = 0.0

    @property
    def sequential(self) -> bool:
        """Whether a filter runs."""
        return self.method in FILTERS

    @classmethod
    def parse(cls, document: Mapping[str, Any]) -> CalibrationSettings:
        """Read settings from a JSON document, absent keys taking their defaults.

        Raises
        ------
        RefusedInputError
            For an unknown key or a value outside its range; names it and says what is allowed.
        """
        known = {field.name for field in fields(cls)}
        for key in document:
            if key not in known:
                raise RefusedInputError(f"Setting {key!r} is unknown; choose from {', '.join(sorted(known))}.")
        values = dict(document)
        if values.get("free") is not None:
            values["free"] = _names(values["free"])
        settings = cls(**values)
        settings.check()
        return settings

    def check(self) -> None:
        """Refuse values outside their range, one sentence each."""
        _choice("method", self.method, METHODS)
        _choice("variant", self.variant, VARIANTS)
        _choice("match", self.match, MATCHES)
        _whole("minimum_stars", self.minimum_stars, 4, 1000)
        _whole("max_iterations", self.max_iterations, 1, 10_000)
        _whole("linearisations", self.linearisations, 1, 100)
        _number("process_noise_sigma", self.process_noise_sigma, 0.0, 10.0)
        _number("initial_sigma_scale", self.initial_sigma_scale, 1e-3, 1e4)
        _number("replay_frames_per_s", self.replay_frames_per_s, 0.0, 1e6)

    def document(self) -> dict[str, Any]:
        """Return the settings as JSON values, every key present."""
        values = asdict(self)
        values["free"] = None if self.free is None else list(self.free)
        return values


def _names(value: Any) -> tuple[str, ...]:
    """Read a list of parameter names."""
    if not isinstance(value, list | tuple) or not value or not all(isinstance(name, str) for name in value):
        raise RefusedInputError("Setting 'free' must be a list of at least one parameter name, or left out.")
    return tuple(value)


def _choice(name: str, value: Any, allowed: tuple[str, ...]) -> None:
    """Refuse a word that is not among those allowed."""
    if value not in allowed:
        raise RefusedInputError(f"Setting {name!r} is {value!r}; choose from {', '.join(allowed)}.")


def _whole(name: str, value: Any, lowest: int, highest: int) -> None:
    """Refuse what is not a whole number in its range."""
    if not isinstance(value, int) or isinstance(value, bool) or not lowest <= value <= highest:
        raise RefusedInputError(f"Setting {name!r} is {value!r}; give a whole number from {lowest} to {highest}.")


def _number(name: str, value: Any, lowest: float, highest: float) -> None:
    """Refuse what is not a number in its range, NaN included."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not lowest <= value <= highest:
        raise RefusedInputError(f"Setting {name!r} is {value!r}; give a number from {lowest:g} to {highest:g}.")
