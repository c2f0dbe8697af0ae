"""How much a test tries: enough to fail where something is wrong, and with `--full` what can be waited for once."""

from __future__ import annotations

_full = [False]


def choose(*, full: bool) -> None:
    """Say whether the tests take their time."""
    _full[0] = full


def effort(few: int, many: int) -> int:
    """Return how many examples, requests or runs a test makes."""
    return many if _full[0] else few
