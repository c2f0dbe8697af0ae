"""The sensors of a campaign with what each is to do: its own order, on its newest sets unless others are named, or why not.

A sensor that cannot have a run, for want of telemetry say, is part of the campaign all the same, with the cause. Sensors
and sets are read at once, however many there are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from boresight.errors import BoresightError, NotFoundError, RefusedInputError
from boresight.services.orders import Order, ordered
from boresight.store import campaigns as rows
from boresight.store import sensors as sensor_rows
from boresight.store.sessions import Session
from boresight.store.tables import Sensor

MOST_SENSORS = 1000

Newest = Literal["newest"]


@dataclass(frozen=True)
class Member:
    """A sensor of a campaign and its sets: numbers, the newest in use, or for validation none."""

    sensor_id: int
    telemetry_set_id: int | Newest = "newest"
    validation_set_id: int | Newest | None = "newest"


@dataclass(frozen=True)
class Place:
    """A sensor of a campaign with what it is to do, or why it cannot."""

    sensor: Sensor
    order: Order | None
    refusal: str | None


def places_of(
    session: Session, members: Sequence[Member] | None, settings: Mapping[str, Any], label: str
) -> list[Place]:
    """Check every sensor's order.

    Parameters
    ----------
    members
        The sensors; None takes the whole fleet.

    Raises
    ------
    NotFoundError
        When there is no such sensor.
    RefusedInputError
        When there are too many sensors, one twice, or none that can have a run.
    """
    wanted = [Member(head.id) for head in sensor_rows.sensor_heads(session)] if members is None else list(members)
    ids = [member.sensor_id for member in wanted]
    _refuse_members(ids)
    fleet = {sensor.id: sensor for sensor in sensor_rows.sensors(session, ids)}
    if strange := [number for number in ids if number not in fleet]:
        raise NotFoundError(f"There is no sensor {strange[0]}; choose from the list.")
    newest = rows.newest_sets(session, ids)
    named = [(member, *_sets_of(member, newest)) for member in wanted]
    numbers = {number for _, *numbers in named for number in numbers if number is not None}
    held = rows.sets_numbered(session, numbers)  # while these are held, an order finds its own without a statement
    places = [
        _place(session, fleet[member.sensor_id], calibration, validation, settings, label)
        for member, calibration, validation in named
    ]
    del held
    if all(place.order is None for place in places):
        raise RefusedInputError(f"No sensor of the campaign can have a run. {places[0].refusal}")
    return places


def _refuse_members(ids: Sequence[int]) -> None:
    """Refuse twice the same sensor, none, or too many."""
    if not ids:
        raise RefusedInputError("A campaign needs at least one sensor; choose some.")
    if len(ids) > MOST_SENSORS:
        raise RefusedInputError(f"A campaign holds at most {MOST_SENSORS} sensors, not {len(ids)}; launch several.")
    if len(set(ids)) < len(ids):
        raise RefusedInputError("A sensor is in the campaign twice; name each once.")


def _sets_of(member: Member, newest: Mapping[tuple[int, str], int]) -> tuple[int | None, int | None]:
    """Return the numbers of a member's calibration and validation sets."""
    calibration, validation = member.telemetry_set_id, member.validation_set_id
    return (
        newest.get((member.sensor_id, "calibration")) if calibration == "newest" else calibration,
        newest.get((member.sensor_id, "validation")) if validation == "newest" else validation,
    )


def _place(
    session: Session,
    sensor: Sensor,
    calibration: int | None,
    validation: int | None,
    settings: Mapping[str, Any],
    label: str,
) -> Place:
    """Check one sensor's order; a refusal is its cause."""
    if calibration is None:
        return Place(sensor, None, f"{sensor.name} has no calibration set; upload one and launch it again.")
    try:
        return Place(sensor, ordered(session, sensor.id, calibration, settings, validation, label), None)
    except BoresightError as error:
        return Place(sensor, None, str(error))
