"""What holds for every test: slow Monte Carlo only when asked for, and property tests without a stopwatch."""

from __future__ import annotations

import hypothesis
import pytest

# The first example of a property may compile kernels; how long one takes says nothing about it.
hypothesis.settings.register_profile("house", hypothesis.settings(), deadline=None)
hypothesis.settings.load_profile("house")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full", action="store_true", help="also run the tests marked `full`: slow Monte Carlo")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--full"):
        return
    skip = pytest.mark.skip(reason="slow Monte Carlo; run it with --full")
    for item in items:
        if "full" in item.keywords:
            item.add_marker(skip)
