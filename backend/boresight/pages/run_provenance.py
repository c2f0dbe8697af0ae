"""Where a run's numbers come from: addresses, versions, and the command that computes them again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from boresight.figures.command_line import calibrate_command
from boresight.pages.formats import short_hash
from boresight.store.tables import Run, TelemetrySet
from boresight.verdicts.numbers import MISSING, count, duration


def provenance_of(run: Run, result: Mapping[str, Any] | None) -> list[tuple[str, Any]]:
    """Lay out the addresses and versions that make the run again what it was."""
    inputs = (result or {}).get("inputs") or {}
    hashes = [(f"{name} SHA-256", _hash(value)) for name, value in _flat(inputs.get("sha256s") or {})]
    versions = ", ".join(f"{name} {value}" for name, value in (inputs.get("versions") or {}).items())
    timing = ", ".join(f"{name.replace('_', ' ')} {duration(value)}" for name, value in _timing(result))
    left_out = ", ".join(
        f"{count(part['count'])} {part['what']}: {part['reason']}" for part in (result or {}).get("left_out") or ()
    )
    return [
        *hashes,
        ("Left out", left_out or MISSING),
        ("Result SHA-256", short_hash(run.result_sha256) if run.result_sha256 else MISSING),
        ("Versions", versions or MISSING),
        ("Time spent", timing or MISSING),
    ]


def _timing(result: Mapping[str, Any] | None) -> list[tuple[str, float]]:
    return [(name, value) for name, value in ((result or {}).get("timing_s") or {}).items() if value is not None]


def _flat(hashes: Mapping[str, Any] | Sequence[str]) -> list[tuple[str, Any]]:
    return list(hashes.items()) if isinstance(hashes, Mapping) else [("input", value) for value in hashes]


def _hash(value: Any) -> Markup | str:
    return short_hash(str(value)) if value else MISSING


def command_of(run: Run, data: TelemetrySet, validation: TelemetrySet | None) -> str:
    """Write the command line that computes this run again from the files that the page offers."""
    files = data.name, f"run-{run.id}.sensor.json"
    words = calibrate_command(*files, run.settings, validation.name if validation else None, f"run-{run.id}.json")
    return " \\\n  ".join(words)
