"""What an audit record changed, as people read it: names instead of members, units instead of SI, times with their day.

A record keeps two documents, before and after. Shown is each member that differs, nested ones by the names on the way.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from boresight.pages.formats import day_of_year, instant
from boresight.verdicts.numbers import MISSING, parameter
from boresight.verdicts.quantities import QUANTITIES

LONGEST_VALUE = 120
HASH = re.compile(r"[0-9a-f]{64}")
HASH_DIGITS = 8
TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z")
UNITS = (("_px", "px"), ("_m", "m"), ("_rad", "rad"), ("_deg", "°"), ("_s", "s"), ("_bytes", "B"), ("_days", "d"))
NAMES = {
    "bound": "Bound",
    "camera_model": "Camera model",
    "covariance": "Covariance",
    "detector": "Detector",
    "four_eyes": "Four-eyes enforced",
    "free": "Free parameters",
    "ground_state": "On ground",
    "initial": "Initial",
    "must_change_password": "Must set a password of their own",
    "name": "Name",
    "onboard_state": "On board",
    "original_sha256": "File, SHA-256",
    "parameters": "Parameters",
    "purpose": "Purpose",
    "result_sha256": "Result, SHA-256",
    "roles": "Roles",
    "run_id": "Run",
    "sensor_id": "Sensor",
    "set_sha256": "Set, SHA-256",
    "incumbent_sha256": "Incumbent, SHA-256",
    "run_result_sha256": "Run's result, SHA-256",
    "profile_sha256": "Gate profile, SHA-256",
    "gate_report_sha256": "Gate report, SHA-256",
    "table_definition_sha256": "Table definition, SHA-256",
    "sha256": "SHA-256",
    "sigma": "Sigma",
    "state": "State",
    "typical_sigma": "Typical sigma",
}


@dataclass(frozen=True)
class Change:
    """One member of a document, before and after.

    Parameters
    ----------
    name
        Its way through the document, as `detector.rows`.
    before, after
        As printed.
    title, unit
        As people call it, and the unit of both values; empty where there is none.
    """

    name: str
    before: str
    after: str
    title: str = ""
    unit: str = ""


def changes(before: Mapping[str, Any] | None, after: Mapping[str, Any] | None) -> list[Change]:
    """Return the members that differ between two documents, in the order of the newer one."""
    old, new = dict(_leaves(before)), dict(_leaves(after))
    names = [*new, *(name for name in old if name not in new)]
    return [
        Change(name, _shown(name, old.get(name)), _shown(name, new.get(name)), title_of(name), unit_of(name))
        for name in names
        if old.get(name) != new.get(name)
    ]


def _leaves(document: Mapping[str, Any] | None, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Walk through a document's members, nested ones as `detector.rows`."""
    for name, value in (document or {}).items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def title_of(name: str) -> str:
    """Name a member as people do: `initial.f_m` is `Initial, f`."""
    *way, last = name.split(".")
    if last in QUANTITIES:
        return ", ".join([*(_word(part) for part in way), QUANTITIES[last].symbol])
    return ", ".join(_word(part) for part in (*way, last))


def _word(part: str) -> str:
    """Name one step of the way; a name that is not known loses its unit and its underscores."""
    if part in NAMES:
        return NAMES[part]
    bare = next((part.removesuffix(suffix) for suffix, _ in (*UNITS, ("_utc", "")) if part.endswith(suffix)), part)
    return (bare[:1].upper() + bare[1:]).replace("_", " ")


def unit_of(name: str) -> str:
    """Return the unit that a member is shown in."""
    last = name.rpartition(".")[2]
    if last in QUANTITIES:
        return QUANTITIES[last].unit
    return next((unit for suffix, unit in UNITS if last.endswith(suffix)), "")


def _shown(name: str, value: Any) -> str:
    """Print a member for people; a long one is cut."""
    if value is None:
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        last = name.rpartition(".")[2]
        return parameter(value, last) if last in QUANTITIES else _number(value)
    if isinstance(value, list) and all(isinstance(member, str) for member in value):
        return ", ".join(value) or "none"
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return _text(text)


def _number(value: float) -> str:
    """Print a number: counts whole, measures to seven digits."""
    return str(value) if isinstance(value, int) else f"{value:.7g}"


def _text(text: str) -> str:
    """Print a text: a time with its day of year, a hash by its first digits."""
    if HASH.fullmatch(text):
        return text[:HASH_DIGITS]
    if TIME.fullmatch(text):
        return day_of_year(instant(text))
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}…"
