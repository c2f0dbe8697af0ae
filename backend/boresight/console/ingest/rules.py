"""The rules of a policy, each declared once: form, REST schema and dry run come from here."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from boresight.errors import RefusedInputError


@dataclass(frozen=True)
class Rule:
    """One rule: its default, unit, bounds (None: it is a word), title and sentence."""

    name: str
    default: Any
    title: str
    sentence: str
    unit: str = ""
    low: float | None = None
    high: float | None = None

    @property
    def whole(self) -> bool:
        """Whether it is a whole number."""
        return isinstance(self.default, int)


def _rule(
    default: Any, title: str, sentence: str, unit: str = "", low: float | None = None, high: float | None = None
) -> Any:
    return field(
        default=default, metadata={"title": title, "sentence": sentence, "unit": unit, "low": low, "high": high}
    )


@dataclass(frozen=True)
class PolicyRules:
    """How new telemetry of a sensor is read, calibrated and judged, and how much of it at most."""

    profile: str = _rule(
        "", "Mapping profile", "Profile used to import files; if none, files must already be in telemetry format."
    )
    preset: str = _rule("first-calibration", "Preset", "Settings of the calibration of each file.")
    false_alarm_rate: float = _rule(
        0.001,
        "False-alarm rate",
        "Probability that a decision is requested for a set although nothing has changed.",
        "",
        1e-9,
        0.05,
    )
    confirmations: int = _rule(
        1,
        "Consecutive sets",
        "Number of consecutive sets outside the baseline before a decision is requested.",
        "sets",
        1,
        20,
    )
    least_stars: int = _rule(
        200, "Minimum stars", "A set with fewer stars in its fit is not judged.", "stars", 4, 10_000_000
    )
    sets_per_day: int = _rule(24, "Maximum sets per day", "The policy is paused if more files arrive.", "sets", 1, 1000)
    requests_per_week: int = _rule(
        3, "Maximum requests per week", "The policy is paused if more requests are prepared.", "requests", 1, 100
    )
    failures_in_row: int = _rule(
        3,
        "Consecutive failures",
        "Number of consecutive files refused or not judged after which the policy is paused.",
        "files",
        1,
        100,
    )
    oldest_days: float = _rule(
        400.0, "Oldest data", "The policy is paused by data older than this, or from the future.", "d", 1.0, 20_000.0
    )

    feed: str = _rule(
        "",
        "Archive",
        "Source from which telemetry is pulled by the mapping profile; if none, files are sent by REST or placed in the watched "
        "folder.",
    )
    pull_minutes: int = _rule(10, "Pull every", "Interval between requests to the archive.", "min", 1, 1440)
    settle_minutes: int = _rule(
        10,
        "A pass is over after",
        "If no new row arrives for this time, the rows received are taken as one set.",
        "min",
        1,
        1440,
    )
    longest_hours: int = _rule(24, "Longest set", "A pass that lasts longer is split.", "h", 1, 720)
    lookback_hours: int = _rule(
        48, "Look-back", "Rows that arrive up to this long after the newest set are still accepted.", "h", 1, 720
    )

    def to_dict(self) -> dict[str, Any]:
        """Write the rules as JSON."""
        return asdict(self)


RULES = {item.name: Rule(item.name, item.default, **item.metadata) for item in fields(PolicyRules)}


def parse_rules(document: Mapping[str, Any]) -> PolicyRules:
    """Read rules from JSON or a form; what is left out is at its default."""
    if strange := sorted(set(document) - set(RULES)):
        raise RefusedInputError(f"A policy has no rule {strange[0][:40]!r}; choose from {', '.join(RULES)}.")
    return PolicyRules(**{name: _read(RULES[name], value) for name, value in document.items()})


def _read(rule: Rule, given: Any) -> Any:
    if rule.low is None or rule.high is None:
        if not isinstance(given, str) or len(given) > 64:
            raise RefusedInputError(f"{rule.title} is a name of up to 64 characters; choose one from the list.")
        return given.strip()
    kind = "a whole number" if rule.whole else "a number"
    wanted = f"{rule.title} must be {kind} from {rule.low:g} to {rule.high:g}"
    try:
        value = float(given) if not isinstance(given, bool) else math.nan
    except (TypeError, ValueError):
        value = math.nan
    if not rule.low <= value <= rule.high or (rule.whole and value != int(value)):
        raise RefusedInputError(f"{wanted}, not {str(given)[:40]!r}; correct it.")
    return int(value) if rule.whole else value
