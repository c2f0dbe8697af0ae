"""The choices of a calibration, as a document a person can read and a machine can check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from boresight.errors import RefusedInputError
from boresight.estimation.filters import FILTERS, GAIN_FORMS, IN_EITHER_FORM
from boresight.estimation.singular_values import CHOSEN, STAR_MODELS, VALUES, Selection

METHODS = ("batch", *FILTERS)
VARIANTS = ("no-q", "q", "no-refit")
MATCHES = ("given", "rematch")
MATCH_PARAMETERS = ("latest", "baseline")
MATCH_RULES = ("statistical", "flight")
ERRORS = ("arclength", "cosine")
ROBUST = ("none", "huber")
CHOICES = {
    "method": METHODS,
    "variant": VARIANTS,
    "match": MATCHES,
    "match_parameters": MATCH_PARAMETERS,
    "match_rule": MATCH_RULES,
    "error": ERRORS,
    "robust": ROBUST,
    "gain_form": GAIN_FORMS,
}


@dataclass(frozen=True)
class CalibrationSettings:
    """What to estimate and how.

    Parameters
    ----------
    method
        `batch`, or a filter of `estimation.filters.FILTERS`.
    variant
        Of a filter: `no-q` holds the parameters constant; `q` adds process noise between frames, to follow drift;
        `no-refit` is `q` with the matches that the baseline parameters give, never made again with better ones.
    free
        Names of the parameters to estimate; None takes the sensor's own list.
    match
        `given`: the star identities of the file; `rematch`: stars are identified again as parameters improve.
    match_parameters
        Of a filter that matches again: with its `latest` parameters, or with the `baseline` it started from.
    match_rule
        `statistical`: the tolerance of a match follows from centroid noise and the parameters' covariance; `flight`: the
        fixed one of the flight software.
    flight_tolerance_urad
        Largest disagreement of an arc that the flight software accepts; None is five sigmas of an arc.
    leave_out_doubles
        Whether double stars and stars with unreliable astrometry take no part.
    minimum_stars
        Exposures with fewer matched stars are left out (E: N_min = 4).
    max_iterations
        Of the batch estimator.
    error
        `arclength`, or of the batch `cosine`: the cosine of the arc, unweighted, which is worse and stands for comparison.
    robust
        `none`, or of the batch `huber`: arcs beyond `huber_threshold` count by their distance and not its square.
    huber_threshold
        Of `huber`, in whitened sigmas; 1.345 keeps 95 % of the efficiency under Gaussian noise.
    linearisations
        Most linearisations a frame of a filter; 1 is the filter as printed, which is over-confident.
    process_noise_sigma
        Of `q` and `no-refit`: standard deviation added a frame, in typical sigmas.
    forgetting_factor
        Of a filter: the share of its information that it carries from frame to frame; 1 forgets nothing.
    initial_sigma_scale
        Standard deviation of a filter's start, in typical sigmas.
    star_model
        Of `svd`: which star combinations are measured, 1 to 4; see `estimation.singular_values`.
    singular_values
        Of `svd`: which singular values of each, some of 1, 2, 3; any two hold what all three do.
    gain_form
        Of `svd` and `angular`: `information`, or `gain` for the update as W prints it, slower and with the same result.
    replay_frames_per_s
        Pace at which a filter takes frames in, to watch a downlink as it would come; 0 is as fast as the machine can.
    """

    method: str = "batch"
    variant: str = "no-q"
    free: tuple[str, ...] | None = None
    match: str = "rematch"
    match_parameters: str = "latest"
    match_rule: str = "statistical"
    flight_tolerance_urad: float | None = None
    leave_out_doubles: bool = False
    minimum_stars: int = 4
    max_iterations: int = 50
    error: str = "arclength"
    robust: str = "none"
    huber_threshold: float = 1.345
    linearisations: int = 6
    process_noise_sigma: float = 0.02
    forgetting_factor: float = 1.0
    initial_sigma_scale: float = 10.0
    star_model: int = 4
    singular_values: tuple[int, ...] = (2, 3)
    gain_form: str = "information"
    replay_frames_per_s: float = 0.0

    @property
    def sequential(self) -> bool:
        """Whether a filter runs."""
        return self.method in FILTERS

    @property
    def matched_with(self) -> str:
        """Which parameters a filter matches each frame with: the variant `no-refit` allows none but the baseline."""
        return "baseline" if self.variant == "no-refit" else self.match_parameters

    @property
    def process_noise(self) -> float:
        """Standard deviation that a filter adds a frame, in typical sigmas; 0 where the parameters are constant."""
        return 0.0 if self.variant == "no-q" else self.process_noise_sigma

    @property
    def selection(self) -> Selection:
        """Which singular values of which combinations `svd` measures."""
        return Selection(self.star_model, self.singular_values)

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
        if "singular_values" in values:
            values["singular_values"] = _singular_values(values["singular_values"])
        settings = cls(**values)
        settings.check()
        return settings

    def check(self) -> None:
        """Refuse values outside their range and choices that exclude one another, one sentence each."""
        for name, allowed in CHOICES.items():
            _choice(name, getattr(self, name), allowed)
        _yes_or_no("leave_out_doubles", self.leave_out_doubles)
        _whole("minimum_stars", self.minimum_stars, 4, 1000)
        _whole("star_model", self.star_model, STAR_MODELS[0], STAR_MODELS[-1])
        _singular_values(self.singular_values)
        _whole("max_iterations", self.max_iterations, 1, 10_000)
        _whole("linearisations", self.linearisations, 1, 100)
        _number("process_noise_sigma", self.process_noise_sigma, 0.0, 10.0)
        _number("forgetting_factor", self.forgetting_factor, 0.5, 1.0)
        _number("huber_threshold", self.huber_threshold, 0.1, 10.0)
        if self.flight_tolerance_urad is not None:
            _number("flight_tolerance_urad", self.flight_tolerance_urad, 0.1, 1e5)
        _number("initial_sigma_scale", self.initial_sigma_scale, 1e-3, 1e4)
        _number("replay_frames_per_s", self.replay_frames_per_s, 0.0, 1e6)
        self._check_together()

    def _check_together(self) -> None:
        """Refuse choices that the method does not have, rather than leave them without effect."""
        if self.sequential and self.robust != "none":
            raise RefusedInputError("Robust loss is the batch's: choose method 'batch', or set 'robust' to 'none'.")
        if self.sequential and self.error != "arclength":
            raise RefusedInputError("The cosine error is the batch's: choose method 'batch', or error 'arclength'.")
        if self.error == "cosine" and self.robust != "none":
            raise RefusedInputError("The cosine error has no weights to be robust by: set 'robust' to 'none'.")
        if not self.sequential and self.forgetting_factor < 1:
            raise RefusedInputError(
                f"A forgetting factor is a filter's: choose from {', '.join(FILTERS)}, or leave 'forgetting_factor' at 1."
            )
        self._check_reference()

    def _check_reference(self) -> None:
        """Refuse choices of the filters of W for any other method."""
        if self.method != "svd" and self.selection != CHOSEN:
            raise RefusedInputError("Star model and singular values are of method 'svd': choose it, or leave them out.")
        if self.method not in IN_EITHER_FORM and self.gain_form != "information":
            raise RefusedInputError(
                f"The gain form is of methods {' and '.join(IN_EITHER_FORM)}: choose one, or leave 'gain_form' out."
            )

    def document(self) -> dict[str, Any]:
        """Return the settings as JSON values, every key present."""
        values = asdict(self)
        values["free"] = None if self.free is None else list(self.free)
        values["singular_values"] = list(self.singular_values)
        return values


def _names(value: Any) -> tuple[str, ...]:
    """Read a list of parameter names."""
    if not isinstance(value, list | tuple) or not value or not all(isinstance(name, str) for name in value):
        raise RefusedInputError("Setting 'free' must be a list of at least one parameter name, or left out.")
    return tuple(value)


def _singular_values(value: Any) -> tuple[int, ...]:
    """Read some of the three singular values, in ascending order."""
    listed = isinstance(value, list | tuple) and all(type(k) is int and k in VALUES for k in value)
    if not listed or not value or len(set(value)) < len(value):
        raise RefusedInputError(f"Setting 'singular_values' is {value!r}; give some of 1, 2, 3, as [2, 3].")
    return tuple(sorted(value))


def _choice(name: str, value: Any, allowed: tuple[str, ...]) -> None:
    """Refuse a word that is not among those allowed."""
    if value not in allowed:
        raise RefusedInputError(f"Setting {name!r} is {value!r}; choose from {', '.join(allowed)}.")


def _yes_or_no(name: str, value: Any) -> None:
    """Refuse what is not true or false."""
    if not isinstance(value, bool):
        raise RefusedInputError(f"Setting {name!r} is {value!r}; give true or false.")


def _whole(name: str, value: Any, lowest: int, highest: int) -> None:
    """Refuse what is not a whole number in its range."""
    if not isinstance(value, int) or isinstance(value, bool) or not lowest <= value <= highest:
        raise RefusedInputError(f"Setting {name!r} is {value!r}; give a whole number from {lowest} to {highest}.")


def _number(name: str, value: Any, lowest: float, highest: float) -> None:
    """Refuse what is not a number in its range, NaN included."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not lowest <= value <= highest:
        raise RefusedInputError(f"Setting {name!r} is {value!r}; give a number from {lowest:g} to {highest:g}.")
