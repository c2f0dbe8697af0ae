"""What a run would be, laid out to be read before it is queued: facts, predicted sigmas, and what differs from where one began."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from boresight.calibration.options import OPTIONS, CalibrationSettings, said, title_of
from boresight.verdicts.numbers import count, duration


@dataclass(frozen=True)
class Sigma:
    """A free parameter's predicted one-sigma beside what was known before, both SI; `share` is their ratio."""

    name: str
    predicted: float | None
    typical: float

    @property
    def share(self) -> float | None:
        """Predicted over typical sigma; above 1 the data add nothing."""
        return None if self.predicted is None else self.predicted / self.typical


@dataclass(frozen=True)
class DryRun:
    """What would run: facts to read, the forecast, and warnings to think about."""

    facts: Sequence[tuple[str, str]]
    warnings: Sequence[str]
    forecast: Mapping[str, Any] | None
    sigmas: Sequence[Sigma]

    @property
    def level(self) -> str:
        """How good the forecast is: normal where every direction is known, serious where nothing can be foretold."""
        if self.forecast is None or self.forecast["weak"] is None:
            return "serious"
        return "caution" if self.forecast["weak"] else "normal"


def dry_run_of(summary: Mapping[str, Any]) -> DryRun:
    """Lay out the service's dry-run summary."""
    free, forecast = summary["free"], summary["forecast"]
    facts = [
        ("Sensor", summary["sensor"]),
        ("Calibration set", summary["telemetry_set"]),
        ("Validation set", summary["validation_set"] or "none"),
        ("Method", title_of(summary["settings"]["method"])),
        ("Matches", said("match", summary["settings"]["match"])),
        ("Other choices", _other_choices(summary["settings"]) or "as usual"),
        ("Frames", count(summary["frames"])),
        ("Stars", count(summary["stars"])),
        ("Star pairs", f"about {count(summary['pairs'])}"),
        ("Free parameters", f"{len(free)}: {', '.join(free)}"),
        ("Expected duration", _expected(summary)),
    ]
    told = forecast or {"sigma": {}, "typical_sigma": {}}
    sigmas = [Sigma(name, value, told["typical_sigma"][name]) for name, value in told["sigma"].items()]
    return DryRun(facts, summary["warnings"], forecast, sigmas)


def _expected(summary: Mapping[str, Any]) -> str:
    """Write the expected duration with its spread, and how it is known."""
    low, high = map(duration, summary["predicted_range_s"])
    runs = summary["paced_by"]
    known = f"by the last {runs} of this method" if runs > 1 else "by the one run of this method"
    return f"about {duration(summary['predicted_s'])} ({low} to {high}, {known if runs else 'a guess before the first run'})"


def _other_choices(settings: Mapping[str, Any]) -> str:
    """List the settings that differ from the usual, apart from those with a line of their own."""
    usual = CalibrationSettings().document()
    named = {"method", "match", "free"}
    return ", ".join(
        f"{name} {settings[name]}" for name in usual if name not in named and settings[name] != usual[name]
    )


@dataclass(frozen=True)
class Difference:
    """A choice that is not what one began from, in words."""

    title: str
    before: str
    now: str


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[Difference]:
    """Compare two settings documents, choice by choice; absent ones are at their defaults."""
    usual = CalibrationSettings().document()
    return [
        Difference(
            OPTIONS[name].label, said(name, before.get(name, usual[name])), said(name, now.get(name, usual[name]))
        )
        for name in usual
        if before.get(name, usual[name]) != now.get(name, usual[name])
    ]
