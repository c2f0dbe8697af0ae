"""A gate profile: the limits that a sensor's sets are held to, as a document that people edit.

Each gate has two thresholds. Beyond `limit` a set FAILs; between `marginal` and `limit` it is MARGINAL and a person judges.
Either may be null: such a threshold is never crossed. What a document leaves out is as in the default profile, so a
mission states only what it wants otherwise.

The default holds for any sensor, its thresholds being multiples of the sensor's own noise, pixels or shares. It blocks what is
surely broken or surely worse than the incumbent and leaves the rest to people:

- `chi-square` and `nis`, 1.1 and 9: the sigmas are about sqrt(value) off, so 5 % at the first and a factor of 3 at the second.
  Values inside the 95 % bounds of their degrees of freedom pass in any case (`judgement`).
- `lens-structure`, `stability`, `centroid-noise` and `identities`, 0 and 3 claimed sigmas: what a test of the model notices is for
  a person to judge, and what moves directions or parameters by more than 3 of the sigmas that the set claims fails it. What moves
  stars by less than a twentieth of their noise never does (`calibration.trust.trust_tests`).
- What few data cause (`arc-uncertainty`, `condition-number`, `weak-directions`, `coverage`) has no limit. A set of few frames is
  not good, but it is no defect, and nobody but the mission knows how good it must be.
- `parameter-shift` has none either. The first calibration on orbit moves everything, as far as 5,000 typical sigmas in W 4.1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from boresight.errors import RefusedInputError
from boresight.verdicts.gates.measurements import GATES, Gate

SCHEMA = "boresight.gate-profile/1"
FLAGS = ("critical", "waivable", "must_have_data", "observe_only")
THRESHOLDS = ("limit", "marginal")


@dataclass(frozen=True)
class Threshold:
    """What one gate allows."""

    name: str
    limit: float | None
    marginal: float | None
    direction: str
    critical: bool
    waivable: bool
    must_have_data: bool
    observe_only: bool


@dataclass(frozen=True)
class Profile:
    """The thresholds of every gate, in the gates' order."""

    thresholds: tuple[Threshold, ...]

    def document(self) -> dict[str, Any]:
        """Return the profile as JSON, every key present."""
        return {"schema": SCHEMA, "gates": [asdict(threshold) for threshold in self.thresholds]}


def default_thresholds(gate: Gate) -> dict[str, Any]:
    """Return what a gate allows where no profile says it."""
    return {
        "name": gate.name,
        "limit": gate.limit,
        "marginal": gate.marginal,
        "direction": gate.direction,
        "critical": gate.critical,
        "waivable": not gate.critical,
        "must_have_data": gate.critical,
        "observe_only": False,
    }


DEFAULT_PROFILE: dict[str, Any] = {"schema": SCHEMA, "gates": [default_thresholds(gate) for gate in GATES.values()]}


def parse_profile(document: Mapping[str, Any], gates: Mapping[str, Gate] = GATES) -> Profile:
    """Read a profile of some gates; gates and keys that are left out are as by default."""
    for key in document:
        if key not in {"schema", "gates"}:
            raise RefusedInputError(f"A gate profile has no key {key!r}: give `gates`, a list.")
    if document.get("schema", SCHEMA) != SCHEMA:
        raise RefusedInputError(f"The profile's schema is {document['schema']!r}: write {SCHEMA!r}, or omit it.")
    given = _by_name(document.get("gates", []), gates)
    return Profile(tuple(_threshold(gate, given.get(name, {})) for name, gate in gates.items()))


def _by_name(entries: Any, gates: Mapping[str, Gate]) -> dict[str, Mapping[str, Any]]:
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        raise RefusedInputError("`gates` is not a list of objects: give one object per gate, with its name.")
    given: dict[str, Mapping[str, Any]] = {}
    for entry in entries:
        name = entry.get("name")
        if not isinstance(name, str) or name not in gates:
            raise RefusedInputError(f"There is no gate {name!r}; choose from {', '.join(gates)}.")
        if name in given:
            raise RefusedInputError(f"The gate {name} is given twice: give it once.")
        given[name] = entry
    return given


def _threshold(gate: Gate, given: Mapping[str, Any]) -> Threshold:
    """Join what is given with the default, and check it."""
    default = default_thresholds(gate)
    for key in given:
        if key not in default:
            raise RefusedInputError(f"Gate {gate.name} has no key {key!r}; choose from {', '.join(default)}.")
    threshold = Threshold(**{**default, **given})
    _check_fixed(gate, threshold)
    for key in FLAGS:
        if not isinstance(getattr(threshold, key), bool):
            raise RefusedInputError(f"{gate.name}: {key} is {getattr(threshold, key)!r}; give true or false.")
    _check_critical(gate, threshold)
    limit, marginal = (_number(gate, key, getattr(threshold, key)) for key in THRESHOLDS)
    threshold = replace(threshold, limit=limit, marginal=marginal)
    _check_order(threshold)
    return threshold


def _check_fixed(gate: Gate, threshold: Threshold) -> None:
    """Refuse another direction than the gate's, and a number for what has none."""
    if threshold.direction != gate.direction:
        raise RefusedInputError(
            f"{gate.name}: direction is {threshold.direction!r}, but it is always {gate.direction!r}; omit it."
        )
    if gate.direction == "met" and (threshold.limit, threshold.marginal) != (None, None):
        raise RefusedInputError(f"{gate.name}: this gate has no limit or marginal, it is met or not met; omit them.")


def _number(gate: Gate, key: str, value: Any) -> float | None:
    """Return a threshold in the gate's unit; 2 and 2.0 are one profile."""
    if value is None:
        return None
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not number or not gate.lowest <= value <= gate.highest:
        raise RefusedInputError(
            f"{gate.name}: {key} is {value!r}; give a number from {gate.lowest:g} to {gate.highest:g}, or null for none."
        )
    return float(value)


def _check_order(threshold: Threshold) -> None:
    """Refuse a marginal that lies beyond the limit: nothing would ever be MARGINAL."""
    limit, marginal = threshold.limit, threshold.marginal
    if limit is None or marginal is None:
        return
    if marginal < limit if threshold.direction == "above" else marginal > limit:
        side = "at least" if threshold.direction == "above" else "at most"
        raise RefusedInputError(
            f"{threshold.name}: marginal is {marginal:g} and the limit {limit:g}; give a marginal of {side} the limit."
        )


def _check_critical(gate: Gate, threshold: Threshold) -> None:
    """Refuse to soften a gate that nobody may pass by."""
    if threshold.critical != gate.critical:
        word = "critical" if gate.critical else "not critical"
        raise RefusedInputError(f"{gate.name}: it is {word} in every profile; omit `critical`.")
    if not gate.critical:
        return
    for key, needed in (("waivable", False), ("observe_only", False), ("must_have_data", True)):
        if getattr(threshold, key) is not needed:
            raise RefusedInputError(
                f"{gate.name}: {key} is {str(needed).lower()} in every profile, because the gate is critical; omit it."
            )
