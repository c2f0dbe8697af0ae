"""Words that findings and answers share: what an estimator's sets say, in one clause with its intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from boresight.studies.enright.estimators import ESTIMATORS
from boresight.studies.enright.pooled import Pooled, Record
from boresight.studies.enright.tables import URAD_PER_RAD

Finding = dict[str, Any]


def finding(title: str, text: str, sentences: Sequence[str]) -> Finding:
    """Write a finding: what it is about, what the paper's text says, and the sentences that hold figures against it."""
    return {"title": title, "text": text, "sentences": list(sentences)}


def statistics(pooled: Pooled, key: str) -> Record:
    """Return the pooled statistics of one estimator."""
    return next(found for found in pooled.statistics() if found["estimator"] == key)


def described(pooled: Pooled, key: str) -> str:
    """Write NEES and ratio to the bound of an estimator, with their intervals."""
    found = statistics(pooled, key)
    nees, ratio = found["nees"], found["ratio_to_bound"]
    words = [ESTIMATORS[key].label]
    if found["converged"] < found["sets"]:
        words.append(f"{found['converged']} of {found['sets']} sets converged")
    if nees is not None:
        spread = f"median {nees['median']:.4g}; {nees['lower']:.1f} to {nees['upper']:.1f} expected"
        words.append(f"NEES {nees['mean']:.4g} ({spread})")
    if ratio is not None:
        spread = f"{ratio['lower']:.2f} to {ratio['upper']:.2f}; median {ratio['median']:.2f}"
        words.append(f"error {ratio['value']:.2f} times the Cramér-Rao bound ({spread})")
    return ", ".join(words)


def over_bound(pooled: Pooled, key: str) -> float:
    """Ratio of errors to the bound; infinite where no set converged."""
    ratio = statistics(pooled, key)["ratio_to_bound"]
    return float(ratio["value"]) if ratio is not None else float("inf")


def validation_urad(record: Record) -> float:
    """RMS arc error on the validation set, µrad."""
    return float(record["validation"]["rms_arc_rad"]["final"]) * URAD_PER_RAD


def listed(sensors: Sequence[int]) -> str:
    """Name sensors."""
    return "sensor " + ", ".join(map(str, sensors)) if sensors else "no sensor"


def by_sensor(records: Sequence[Record], numbers: Sequence[float | None], decimals: int = 0) -> str:
    """Write a number of each sensor, a dash where there is none."""
    written = ("–" if number is None else f"{number:.{decimals}f}" for number in numbers)
    return ", ".join(f"{record['sensor']}: {text}" for record, text in zip(records, written, strict=True))
