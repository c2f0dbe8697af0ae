"""The data that the launch form offers: which sensors to choose from, and of which of them it holds the sets and parameters.

Of a small fleet the form holds them all, and a script shows those of the sensor that is chosen. Of a fleet with more sensors
or sets than fit a page it holds those of the one sensor: another is found by name and chosen, and the form is asked for again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from urllib.parse import urlencode

from starlette.datastructures import QueryParams

from boresight.errors import NotFoundError
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.pages.launch_form import Typed, typed_settings
from boresight.services import runs, sensors, telemetry_sets
from boresight.services.presets import Offer
from boresight.services.sensors import Choices
from boresight.store.sessions import Session
from boresight.store.tables import Sensor, TelemetrySet

MOST_SETS = 100
LONGEST_NUMBER = 9  # digits of a row's number
OF_A_SENSOR = ("set", "validation_set_id")  # what an address says of the data besides the sensor


@dataclass(frozen=True)
class Origin:
    """Where the form began: the address's own words, as far as they name something."""

    sensor: int | None = None
    set_id: int | None = None
    clone: int | None = None
    method: str = ""
    preset: Offer | None = None
    find: str = ""

    @property
    def kept(self) -> dict[str, str]:
        """What an address says of it; what is sought aside."""
        named = {"sensor": self.sensor, "set": self.set_id, "clone": self.clone, "method": self.method}
        key = self.preset.key if self.preset else None
        return {name: str(value) for name, value in {**named, "preset": key}.items() if value}

    @property
    def query(self) -> str:
        """The same as an address's query."""
        return urlencode(self.kept | ({"find": self.find} if self.find else {}))

    def with_preset(self, key: str) -> str:
        """The address's query with a preset, whose method takes the place of the one named."""
        named = {"sensor": self.sensor, "set": self.set_id, "clone": self.clone, "preset": key, "find": self.find}
        return urlencode({name: value for name, value in named.items() if value})


@dataclass(frozen=True)
class Offered:
    """What the form offers.

    Parameters
    ----------
    choices
        The sensors to choose from.
    fleet
        Those whose sets and parameters the form holds.
    sets
        The sets in use of these, newest first.
    is_whole
        Whether the form holds every sensor, and none has to be asked for.
    """

    choices: Choices
    fleet: Sequence[Sensor]
    sets: Sequence[TelemetrySet]
    is_whole: bool

    @property
    def shown(self) -> int | None:
        """The sensor whose sets and parameters alone the form holds."""
        return None if self.is_whole or not self.fleet else self.fleet[0].id


def offer(session: Session, find: str, sensor_id: int | None, set_ids: Sequence[str] = ()) -> Offered:
    """Read what a form offers that is about a sensor, by default the first by name, and names these sets."""
    choices = sensors.choices(session, find=find, keep=[] if sensor_id is None else [sensor_id])
    if choices.is_all:
        sets = telemetry_sets.list_telemetry_sets(session, limit=MOST_SETS + 1)
        if len(sets) <= MOST_SETS:
            return Offered(choices, sensors.list_sensors(session), sets, is_whole=True)
    if not choices.names:  # nothing holds what is sought
        choices = replace(choices, names=dict(list(sensors.choices(session).names.items())[:1]))
    chosen = next(number for number in (sensor_id, *choices.names) if number is not None and number in choices.names)
    sets = telemetry_sets.list_telemetry_sets(session, sensor_id=chosen, limit=MOST_SETS)
    older = _older(session, set_ids, chosen, {known.id for known in sets})
    return Offered(choices, sensors.list_sensors(session, [chosen]), [*sets, *older], is_whole=False)


def _older(session: Session, set_ids: Sequence[str], sensor_id: int, known: set[int]) -> Iterator[TelemetrySet]:
    """Yield the sets named that are the sensor's and in use, but not among the newest."""
    for number in {number for text in set_ids for number in _number(text)} - known:
        try:
            row = telemetry_sets.get_telemetry_set(session, number)
        except NotFoundError:
            continue
        if row.sensor_id == sensor_id and row.archived_utc is None:
            yield row


def _number(text: str) -> list[int]:
    """Read a row's number where there is one."""
    return [int(text)] if text.isdecimal() and len(text) <= LONGEST_NUMBER else []


def sensor_meant(session: Session, origin: Origin, address: Mapping[str, str]) -> int | None:
    """Return the sensor that a form is about that begins there; None where nothing says which."""
    of_set = origin.set_id is not None and origin.clone is None and "validation_set_id" not in address
    if origin.sensor is not None and not of_set:
        return origin.sensor
    if origin.clone is not None:
        return runs.get_run(session, origin.clone).sensor_id
    if origin.set_id is not None:
        return telemetry_sets.get_telemetry_set(session, origin.set_id).sensor_id
    return None


def sets_of_clone(session: Session, origin: Origin) -> list[str]:
    """Return the numbers of the sets of the run that the form began from, which may be older than all that it offers besides."""
    if origin.clone is None:
        return []
    run = runs.get_run(session, origin.clone)
    return [str(number) for number in (run.telemetry_set_id, run.validation_set_id) if number is not None]


def found_alone(offered: Offered, address: QueryParams) -> str | None:
    """Return the query of the form about the only sensor that is found; None where it is about that one, or several are found."""
    choices = offered.choices
    alone = list(choices.names)[-1] if choices.find and choices.found == choices.fitting == 1 else None
    if offered.is_whole or choices.is_all or alone in {None, offered.shown}:
        return None
    kept = [(name, text) for name, text in address.multi_items() if not _of_sensor(name)]
    return urlencode([*kept, ("sensor", alone)])


def _of_sensor(name: str) -> bool:
    """Whether a part of the address holds for one sensor only."""
    return name in {"sensor", *OF_A_SENSOR} or name.startswith("free-")


def first_choice(
    session: Session, fleet: Sequence[Sensor], clone: int | None, sensor_id: int | None, set_id: int | None
) -> Typed:
    """Fill the form anew: from a run to clone, with a set, or with a sensor's newest sets, by default the first one's."""
    free = {sensor.id: free_of(sensor) for sensor in fleet}
    if clone is None and set_id is not None:
        return Typed(**_sets_with(session, set_id), free=free)
    if clone is None:
        return Typed(**newest_sets(session, fleet[0].id if sensor_id is None and fleet else sensor_id), free=free)
    run = runs.get_run(session, clone)
    free[run.sensor_id] = list(run.settings.get("free") or free.get(run.sensor_id) or [])
    data: dict[str, Any] = {
        "sensor_id": str(run.sensor_id),
        "telemetry_set_id": str(run.telemetry_set_id),
        "validation_set_id": str(run.validation_set_id or ""),
    }
    if sensor_id not in {None, run.sensor_id}:
        data = newest_sets(session, sensor_id)
    return Typed(**data, label=run.label, free=free).with_settings(typed_settings(run.settings))


def about_its_sensor(session: Session, typed: Typed) -> Typed:
    """Return a form with the newest sets of the sensor that it names and that sensor's own free parameters."""
    fleet = sensors.list_sensors(session, _number(typed.sensor_id))
    free = {sensor.id: free_of(sensor) for sensor in fleet}
    return replace(typed, **newest_sets(session, next(iter(free), None)), free=free)


def newest_sets(session: Session, sensor_id: int | None) -> dict[str, Any]:
    """Choose the newest set of either purpose for a sensor."""
    if sensor_id is None:
        return {}
    newest = {known.purpose: str(known.id) for known in telemetry_sets.sets_of(session, [sensor_id], newest=1)}
    return {
        "sensor_id": str(sensor_id),
        "telemetry_set_id": newest.get("calibration", ""),
        "validation_set_id": newest.get("validation", ""),
    }


def _sets_with(session: Session, set_id: int) -> dict[str, Any]:
    """Choose this set for its purpose, and the newest of its sensor for the other."""
    known = telemetry_sets.get_telemetry_set(session, set_id)
    place = "telemetry_set_id" if known.purpose == "calibration" else "validation_set_id"
    return {**newest_sets(session, known.sensor_id), place: str(known.id)}


def free_of(sensor: Sensor) -> list[str]:
    """Return the parameters that a sensor's file frees; all where it names none."""
    return list(sensor.document.get("free") or names_of(sensor))


def names_of(sensor: Sensor) -> tuple[str, ...]:
    """Return the names of a sensor's parameters."""
    return CAMERA_MODELS[sensor.document["camera_model"]].parameter_names
