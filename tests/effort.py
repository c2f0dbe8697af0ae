"""How much a test tries: enough to fail where something is wrong, and with `--full` what can be waited for once."""

from collections.abc import Iterator, Sequence
from typing import Any

import pytest

_full = [False]


def choose(*, full: bool) -> None:
    _full[0] = full


def effort(few: int, many: int) -> int:
    return many if _full[0] else few


def few_of(values: Sequence[Any], few: int) -> list[Any]:
    """The values of a parametrised test, of which all but the first `few` are tried with `--full`."""
    return [*values[:few], *(pytest.param(value, marks=pytest.mark.full) for value in values[few:])]


def beyond_few(items: Sequence[pytest.Item]) -> Iterator[pytest.Item]:
    """The cases of tests marked `few(count)` that are left to `--full`: what stays is chosen evenly among the others."""
    tests: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("few") and "full" not in item.keywords:
            tests.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for cases in tests.values():
        (count,) = (mark.args[0] for mark in cases[0].iter_markers("few"))
        kept = {place * len(cases) // count for place in range(count)}
        yield from (case for place, case in enumerate(cases) if place not in kept)
