"""The launch form as text: what was typed, what is usual, and the settings document that both make.

Only the choices that the method has go into the document, so that a form without scripts, which sends them all, is read alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from urllib.parse import urlencode

from starlette.datastructures import FormData, QueryParams

from boresight.api.numbers import row_number
from boresight.calibration.settings import CalibrationSettings
from boresight.errors import RefusedInputError
from boresight.estimation.filters import IN_EITHER_FORM
from boresight.pages.forms import texts_of
from boresight.pages.methods import is_sequential


def _text(value: Any) -> str:
    """Write a setting as its field shows it."""
    if isinstance(value, bool):
        return "on" if value else ""
    if isinstance(value, list):
        return ",".join(map(str, value))
    return f"{value:.15g}" if isinstance(value, int | float) else str(value or "")


def typed_settings(document: Mapping[str, Any]) -> dict[str, str]:
    """Write the settings of a run as the form's fields show them."""
    return {name: _text(value) for name, value in document.items() if name in _SETTINGS}


_SETTINGS = frozenset(CalibrationSettings().document()) - {"free"}
DEFAULTS = typed_settings(CalibrationSettings().document())
#: Fields that the address says in other words: `sensor`, `set`, a `method` that there is, and `free-<sensor>`.
_BEGINNINGS = frozenset({"sensor_id", "telemetry_set_id", "method", "free"})
#: Fields behind "More options"; one that differs from the usual opens them.
ADVANCED = (
    "match_parameters", "match_rule", "flight_tolerance_urad", "leave_out_doubles", "minimum_stars", "max_iterations", "error",
    "robust", "huber_threshold", "forgetting_factor", "initial_sigma_scale", "gain_form",
)  # fmt: skip


@dataclass(frozen=True)
class Typed:
    """The form as it was typed: text, so that a refused form comes back as it was."""

    sensor_id: str = ""
    telemetry_set_id: str = ""
    validation_set_id: str = ""
    method: str = DEFAULTS["method"]
    variant: str = DEFAULTS["variant"]
    match: str = DEFAULTS["match"]
    match_parameters: str = DEFAULTS["match_parameters"]
    match_rule: str = DEFAULTS["match_rule"]
    flight_tolerance_urad: str = DEFAULTS["flight_tolerance_urad"]
    leave_out_doubles: str = DEFAULTS["leave_out_doubles"]
    minimum_stars: str = DEFAULTS["minimum_stars"]
    max_iterations: str = DEFAULTS["max_iterations"]
    error: str = DEFAULTS["error"]
    robust: str = DEFAULTS["robust"]
    huber_threshold: str = DEFAULTS["huber_threshold"]
    linearisations: str = DEFAULTS["linearisations"]
    process_noise_sigma: str = DEFAULTS["process_noise_sigma"]
    forgetting_factor: str = DEFAULTS["forgetting_factor"]
    initial_sigma_scale: str = DEFAULTS["initial_sigma_scale"]
    star_model: str = DEFAULTS["star_model"]
    singular_values: str = DEFAULTS["singular_values"]
    gain_form: str = DEFAULTS["gain_form"]
    replay_frames_per_s: str = DEFAULTS["replay_frames_per_s"]
    label: str = ""
    free: Mapping[int, Sequence[str]] = field(default_factory=dict)

    def under(self, settings: Mapping[str, Any]) -> Typed:
        """Return the form with other settings, data and label as typed; free parameters too where the settings name none."""
        free = dict(self.free)
        if settings.get("free") and (sensor_id := row_number(self.sensor_id)) is not None:
            free[sensor_id] = list(settings["free"])
        return replace(self, **typed_settings(settings), free=free)

    def amended(self, address: QueryParams) -> Typed:
        """Return the form with what an address says of it, by the names of its fields; an empty `free-<sensor>` frees none.

        An address that says the validation set is the form's own, and says all the data; else its set is only a beginning.
        """
        said = {
            name: address[name] for name in self.__dataclass_fields__ if name in address and name not in _BEGINNINGS
        }
        if "validation_set_id" in address:
            named = {"sensor_id": address.get("sensor", ""), "telemetry_set_id": address.get("set", "")}
            said |= {name: value for name, value in named.items() if value.isdecimal()}
        free = {
            sensor: [name for name in address.getlist(f"free-{sensor}") if name]
            if f"free-{sensor}" in address
            else names
            for sensor, names in self.free.items()
        }
        return replace(self, **said, free=free)

    @property
    def query(self) -> str:
        """The fields as an address's query, for the page to tell what was changed since."""
        texts = [(name, getattr(self, name)) for name in self.__dataclass_fields__ if name not in _BEGINNINGS]
        ticks = [(f"free-{sensor}", name) for sensor, names in self.free.items() for name in names]
        return urlencode([*texts, *ticks])

    @property
    def advanced(self) -> bool:
        """Whether a choice behind "More options" differs from the usual."""
        return any(getattr(self, name) != DEFAULTS[name] for name in ADVANCED)

    def settings(self) -> dict[str, Any]:
        """Return the settings document of the calibration.

        Raises
        ------
        RefusedInputError
            When a number cannot be read; says which.
        """
        free = list(self.free.get(whole(self.sensor_id, "sensor"), ()))
        if not free:
            raise RefusedInputError("No parameter is free: tick at least one to estimate.")
        return {**self.settings_of_any(), "free": free}

    def settings_of_any(self) -> dict[str, Any]:
        """Return the settings document for whatever sensor, whose own parameters are free; refuses as `settings`."""
        document: dict[str, Any] = {
            "method": self.method,
            "minimum_stars": whole(self.minimum_stars, "smallest number of stars"),
            **self._matching(),
        }
        return document | (self._of_filter() if is_sequential(self.method) else self._of_batch())

    def _matching(self) -> dict[str, Any]:
        """Return how stars are identified and judged."""
        tolerance = self.flight_tolerance_urad.strip()
        return {
            "match": self.match,
            "match_rule": self.match_rule,
            "leave_out_doubles": bool(self.leave_out_doubles),
            "flight_tolerance_urad": decimal(tolerance, "flight tolerance") if tolerance else None,
        }

    def _of_batch(self) -> dict[str, Any]:
        """Return the choices that only the batch has."""
        return {
            "max_iterations": whole(self.max_iterations, "number of iterations"),
            "error": self.error,
            "robust": self.robust,
            "huber_threshold": decimal(self.huber_threshold, "Huber threshold"),
        }

    def _of_filter(self) -> dict[str, Any]:
        """Return the choices that only a filter has."""
        document = {
            "variant": self.variant,
            "match_parameters": self.match_parameters,
            "linearisations": whole(self.linearisations, "number of linearisations"),
            "forgetting_factor": decimal(self.forgetting_factor, "forgetting factor"),
            "initial_sigma_scale": decimal(self.initial_sigma_scale, "sigma of the start"),
            "replay_frames_per_s": decimal(self.replay_frames_per_s, "replay pace"),
        }
        if self.variant != "no-q":
            document["process_noise_sigma"] = decimal(self.process_noise_sigma, "drift a frame")
        return document | self._of_reference()

    def _of_reference(self) -> dict[str, Any]:
        """Return the choices that only the filters on singular values and on all pairs have."""
        document: dict[str, Any] = {"gain_form": self.gain_form} if self.method in IN_EITHER_FORM else {}
        if self.method == "svd":
            document["star_model"] = whole(self.star_model, "star model")
            document["singular_values"] = [whole(k, "singular value") for k in self.singular_values.split(",")]
        return document


def whole(text: str, name: str) -> int:
    """Read a whole number."""
    number = row_number(text)
    if number is None:
        raise RefusedInputError(f"The {name} {text.strip()[:20]!r} is not a whole number; type one, such as 6.")
    return number


def decimal(text: str, name: str) -> float:
    """Read a number; a comma stands for a point, as many keyboards have it."""
    try:
        return float(text.strip().replace(",", ".") or "0")
    except ValueError as error:
        raise RefusedInputError(f"The {name} {text.strip()!r} is not a number; type one, such as 0.02.") from error


def typed_form(form: FormData) -> Typed:
    """Read the form as typed; free parameters are those of the sensors whose boxes are ticked."""
    text = texts_of(form)
    named = {name: text.get(name, "") for name in Typed.__dataclass_fields__ if name != "free"}
    ticked = {name: name.removeprefix("free-") for name in form if name.startswith("free-")}
    numbered = {name: row_number(number) for name, number in ticked.items()}
    free = {number: list(map(str, form.getlist(name))) for name, number in numbered.items() if number is not None}
    return Typed(**{**DEFAULTS, **{name: value for name, value in named.items() if value}}, free=free)
