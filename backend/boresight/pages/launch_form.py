"""The launch form as text: what was typed, what is usual, and the settings document that both make.

Only the choices that the method has go into the document, so that a form without scripts, which sends them all, is read alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any
from urllib.parse import urlencode

from starlette.datastructures import FormData, QueryParams

from boresight.api.numbers import row_number
from boresight.calibration.options import OPTIONS, CalibrationSettings, text_of
from boresight.errors import RefusedInputError
from boresight.pages.forms import texts_of

#: The choices that have a field each; free parameters have one a sensor.
FIELDS = tuple(name for name in OPTIONS if name != "free")


def typed_settings(document: Mapping[str, Any]) -> dict[str, str]:
    """Write the settings of a run as the form's fields show them."""
    return {name: text_of(document[name]) for name in FIELDS if name in document}


DEFAULTS = typed_settings(CalibrationSettings().document())


@dataclass(frozen=True)
class Typed:
    """The form as it was typed: text, so that a refused form comes back as it was; a setting is `typed[name]`."""

    sensor_id: str = ""
    telemetry_set_id: str = ""
    validation_set_id: str = ""
    label: str = ""
    chosen: Mapping[str, str] = field(default_factory=lambda: DEFAULTS)
    free: Mapping[int, Sequence[str]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> str:
        """Return what was typed for a setting."""
        return self.chosen[name]

    def with_settings(self, texts: Mapping[str, str]) -> Typed:
        """Return the form with other texts for some settings."""
        return replace(self, chosen={**self.chosen, **texts})

    def under(self, settings: Mapping[str, Any]) -> Typed:
        """Return the form with other settings, data and label as typed; free parameters too where the settings name none."""
        free = dict(self.free)
        if settings.get("free") and (sensor_id := row_number(self.sensor_id)) is not None:
            free[sensor_id] = list(settings["free"])
        return replace(self.with_settings(typed_settings(settings)), free=free)

    def amended(self, address: QueryParams) -> Typed:
        """Return the form with what an address says of it, by the names of its fields; an empty `free-<sensor>` frees none.

        An address that says the validation set is the form's own, and says all the data; else its set is only a beginning.
        """
        said: dict[str, Any] = {name: address[name] for name in ("validation_set_id", "label") if name in address}
        if "validation_set_id" in address:
            named = {"sensor_id": address.get("sensor", ""), "telemetry_set_id": address.get("set", "")}
            said |= {name: value for name, value in named.items() if value.isdecimal()}
        free = {
            sensor: [name for name in address.getlist(f"free-{sensor}") if name]
            if f"free-{sensor}" in address
            else names
            for sensor, names in self.free.items()
        }
        texts = {name: address[name] for name in FIELDS if name in address and name != "method"}
        return replace(self.with_settings(texts), **said, free=free)

    @property
    def query(self) -> str:
        """The fields as an address's query, for the page to tell what was changed since."""
        texts = [("validation_set_id", self.validation_set_id), ("label", self.label)]
        texts += [(name, self[name]) for name in FIELDS if name != "method"]
        ticks = [(f"free-{sensor}", name) for sensor, names in self.free.items() for name in names]
        return urlencode([*texts, *ticks])

    @property
    def advanced(self) -> bool:
        """Whether a choice behind "More options" differs from the usual."""
        return any(self[name] != DEFAULTS[name] for name in FIELDS if not OPTIONS[name].usual)

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
        method = self["method"]
        mine = [name for name in FIELDS if name == "method" or method in OPTIONS[name].methods]
        if self["variant"] == "no-q" and "process_noise_sigma" in mine:
            mine.remove("process_noise_sigma")
        return {name: OPTIONS[name].read(self[name]) for name in mine}


def whole(text: str, name: str) -> int:
    """Read a whole number."""
    number = row_number(text)
    if number is None:
        raise RefusedInputError(f"The {name} {text.strip()[:20]!r} is not a whole number; type one, such as 6.")
    return number


def typed_form(form: FormData) -> Typed:
    """Read the form as typed; free parameters are those of the sensors whose boxes are ticked."""
    text = texts_of(form)
    ticked = {name: name.removeprefix("free-") for name in form if name.startswith("free-")}
    numbered = {name: row_number(number) for name, number in ticked.items()}
    free = {number: list(map(str, form.getlist(name))) for name, number in numbered.items() if number is not None}
    about: dict[str, Any] = {item.name: text[item.name] for item in fields(Typed) if text.get(item.name)}
    chosen = {**DEFAULTS, **{name: text[name] for name in FIELDS if text.get(name)}}
    return Typed(**{**about, "chosen": chosen, "free": free})
