"""How much a test tries: enough to fail where something is wrong, and with `--full` what can be waited for once."""

from collections.abc import Sequence
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
